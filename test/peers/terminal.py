"""Leaves the shell of `aerie remote` in each way that its terminal knows: terminal.py PROGRAM ARGUMENT ...

Prints a line for each way as soon as the shell is gone. Status 1: one of them did not end it, and what the terminal showed.
"""
import os
import pty
import select
import signal
import sys
import time

PROMPT = b")1> "
WAYS = {
    "exit()": lambda pid, fd: os.write(fd, b"exit()\r"),
    "Ctrl-C twice": lambda pid, fd: (os.write(fd, b"\x03"), read(fd, b"BREAK"), os.write(fd, b"\x03")),
    "closed terminal": lambda pid, fd: os.close(fd),
    "SIGHUP": lambda pid, fd: os.kill(pid, signal.SIGHUP),
    "SIGTERM": lambda pid, fd: os.kill(pid, signal.SIGTERM),
    "SIGKILL": lambda pid, fd: os.kill(pid, signal.SIGKILL),
}
PATIENCE = 120


def read(fd, expected=None):
    """Reads until a text has come, or without one until the terminal ends."""
    seen, end = b"", time.monotonic() + PATIENCE
    while expected is None or expected not in seen:
        if not select.select([fd], [], [], max(0, end - time.monotonic()))[0]:
            sys.exit(f"the terminal waits, and shows {seen!r}")
        try:
            data = os.read(fd, 4096)
        except OSError:
            data = b""
        if not data:
            return expected is None or sys.exit(f"the shell ended with {seen!r}")
        seen += data


for name, leave in WAYS.items():
    pid, fd = pty.fork()
    if pid == 0:
        # As a terminal starts it, also if these tests were started to go on without one.
        signal.signal(signal.SIGHUP, signal.SIG_DFL)
        os.execvp(sys.argv[1], sys.argv[1:])
    read(fd, PROMPT)
    leave(pid, fd)
    if name != "closed terminal":
        read(fd)
        os.close(fd)
    os.waitpid(pid, 0)
    print(name, flush=True)
