"""systemd for one service of Type=notify, where systemd does not run: by its rules for the main process (sd_notify(3), systemd.service(5)).

usage: service_manager.py PROGRAM [WORD ...]

- Only the main process is listened to (NotifyAccess=main). By MAINPID it names another one of the service.
- The end of the main process starts the service again after a second (Restart=always); that of another process does nothing.
- SIGTERM ends the main process, and then whatever is left. Processes whose parents are gone are its children, as those of a control
  group are systemd's.

Prints a line for each thing that happens.
"""
import ctypes
import os
import signal
import socket
import struct
import sys
import time

PR_SET_CHILD_SUBREAPER = 36
notify = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
# Without a folder, so that a service in a root of its own finds it.
path = f"@aerie-service-manager-{os.getpid()}"
notify.bind(path.replace("@", "\0"))
notify.setsockopt(socket.SOL_SOCKET, socket.SO_PASSCRED, 1)
notify.settimeout(0.02)
ctypes.CDLL(None).prctl(PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)
main = None
stopping = False


def say(*words):
    print("manager:", *words, flush=True)


def start():
    global main
    main = os.fork()
    if main == 0:
        os.environ.update(NOTIFY_SOCKET=path, WATCHDOG_USEC="30000000", WATCHDOG_PID=str(os.getpid()))
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        os.execv(sys.argv[1], sys.argv[1:])
    say("started", main)


def parent(pid):
    try:
        with open(f"/proc/{pid}/stat") as stat:
            return int(stat.read().rsplit(")", 1)[1].split()[1])
    except OSError:
        return 0


def ours(pid):
    while pid > 1 and pid != os.getpid():
        pid = parent(pid)
    return pid == os.getpid()


def hear():
    global main
    try:
        data, extra, _flags, _from = notify.recvmsg(4096, socket.CMSG_SPACE(12))
    except TimeoutError:
        return
    sender = struct.unpack("3i", extra[0][2])[0]
    for line in data.decode().splitlines():
        key, _, value = line.partition("=")
        if key in ("WATCHDOG", "STATUS"):
            continue
        if sender != main:
            say("not from the main process:", line)
        elif key == "MAINPID" and ours(int(value)):
            main = int(value)
            say("main process", main)
        else:
            say("heard", line)


def reap():
    try:
        pid, status = os.waitpid(-1, os.WNOHANG)
    except ChildProcessError:
        return False
    if pid and pid == main:
        say("the main process ended", pid, os.waitstatus_to_exitcode(status))
        if stopping:
            return False
        time.sleep(1)
        start()
    elif pid:
        say("a process ended", pid)
    return True


def stop(_signal, _frame):
    global stopping
    stopping = True
    os.kill(main, signal.SIGTERM)


signal.signal(signal.SIGTERM, stop)
start()
while True:
    hear()
    if not reap():
        break
say("stopped")
