"""A ground station with pymavlink: pymavlink_peer.py list|file|mission PORT [ITEMS TIMEOUT_S]

list: PARAM_REQUEST_LIST, and after a second of silence the missing ones by index, ten at a time. Prints "list NUMBER SECONDS".
file: all parameters by pymavlink's own mavftp, `@PARAM/param.pck`. Prints "file NUMBER SECONDS".
mission: an upload and a download with the time-outs of the mission protocol (1.5 s, 250 ms for items, 5 repetitions). Prints
"upload SECONDS" and "download SECONDS", or "failed" in place of the seconds.
"""
import os
import sys
import tempfile
import time

from pymavlink import mavftp, mavutil

what, port = sys.argv[1:3]
m = mavutil.mavlink_connection("udpin:127.0.0.1:" + port, source_system=255, source_component=190, dialect="ardupilotmega")
m.wait_heartbeat()
SYSTEM = m.target_system


def by_list():
    values, count = {}, None
    m.mav.param_request_list_send(SYSTEM, 1)
    silent = time.time()
    while count is None or len(values) < count:
        p = m.recv_match(type="PARAM_VALUE", blocking=True, timeout=0.05)
        if p is not None:
            silent = time.time()
            count = p.param_count
            if p.param_index != 65535:
                values[p.param_index] = p.param_value
        elif time.time() - silent > 1:
            silent = time.time()
            if count is None:
                m.mav.param_request_list_send(SYSTEM, 1)
            else:
                for index in [i for i in range(count) if i not in values][:10]:
                    m.mav.param_request_read_send(SYSTEM, 1, b"", index)
    return count


def by_file():
    path = os.path.join(tempfile.mkdtemp(), "params")
    ftp = mavftp.MAVFTP(m, target_system=SYSTEM, target_component=1)
    ftp.cmd_getparams([path])
    ftp.process_ftp_reply("getparams", timeout=120)
    with open(path, encoding="utf-8") as file:
        return len([line for line in file if line.strip() and not line.startswith("#")])


def item(seq):
    m.mav.mission_item_int_send(SYSTEM, 1, seq, 3, 22 if seq == 1 else 16, 0, 1, 0, 0, 0, 0,
                                473977420 + 10 * seq, 85455940 + 7 * seq, 20, 0)


def exchange(send, kinds, test, wait, until):
    for _ in range(6):
        send()
        end = time.time() + wait
        while time.time() < min(end, until):
            got = m.recv_match(type=kinds, blocking=True, timeout=max(0.001, min(end, until) - time.time()))
            if got is not None and test(got):
                return got
    return None


def upload(items, until):
    send, wait, last = (lambda: m.mav.mission_count_send(SYSTEM, 1, items, 0)), 1.5, -1
    kinds = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
    while time.time() < until:
        got = exchange(send, kinds, lambda g: g.get_type() != "MISSION_ACK" or (g.type == 0 and last == items - 1), wait, until)
        if got is None:
            return False
        if got.get_type() == "MISSION_ACK":
            return True
        last = got.seq
        send, wait = (lambda seq=got.seq: item(seq)), 0.25
    return False


def download(items, until):
    count = exchange(lambda: m.mav.mission_request_list_send(SYSTEM, 1, 0), ["MISSION_COUNT"], lambda _g: True, 1.5, until)
    if count is None:
        return False
    for seq in range(count.count):
        send = lambda seq=seq: m.mav.mission_request_int_send(SYSTEM, 1, seq, 0)
        if exchange(send, ["MISSION_ITEM_INT"], lambda g: g.seq == seq, 0.25, until) is None:
            return False
    m.mav.mission_ack_send(SYSTEM, 1, 0, 0)
    return count.count == items


if what == "mission":
    items, timeout = int(sys.argv[3]), float(sys.argv[4])
    for name, run in [("upload", upload), ("download", download)]:
        start = time.time()
        done = run(items, start + timeout)
        print(name, "%.3f" % (time.time() - start) if done else "failed", flush=True)
else:
    start = time.time()
    print(what, by_list() if what == "list" else by_file(), time.time() - start)
