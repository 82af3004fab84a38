"""Uploads and downloads a mission with pymavlink, with the time-outs of the mission protocol (1.5 s, 250 ms for items, 5 repetitions).

mission_peer.py PORT ITEMS TIMEOUT_S: prints "upload SECONDS" and "download SECONDS", or "failed" in place of the seconds.
"""
import sys
import time

from pymavlink import mavutil

PORT, ITEMS, TIMEOUT = int(sys.argv[1]), int(sys.argv[2]), float(sys.argv[3])
m = mavutil.mavlink_connection("udpin:127.0.0.1:%d" % PORT, source_system=255, source_component=190, dialect="ardupilotmega")
m.wait_heartbeat()
SYSTEM = m.target_system


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


def upload(until):
    send, wait, last = (lambda: m.mav.mission_count_send(SYSTEM, 1, ITEMS, 0)), 1.5, -1
    kinds = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
    while time.time() < until:
        got = exchange(send, kinds, lambda g: g.get_type() != "MISSION_ACK" or (g.type == 0 and last == ITEMS - 1), wait, until)
        if got is None:
            return False
        if got.get_type() == "MISSION_ACK":
            return True
        last = got.seq
        send, wait = (lambda seq=got.seq: item(seq)), 0.25
    return False


def download(until):
    count = exchange(lambda: m.mav.mission_request_list_send(SYSTEM, 1, 0), ["MISSION_COUNT"], lambda _g: True, 1.5, until)
    if count is None:
        return False
    for seq in range(count.count):
        if exchange(lambda: m.mav.mission_request_int_send(SYSTEM, 1, seq, 0), ["MISSION_ITEM_INT"], lambda g: g.seq == seq, 0.25, until) is None:
            return False
    m.mav.mission_ack_send(SYSTEM, 1, 0, 0)
    return count.count == ITEMS


for name, run in [("upload", upload), ("download", download)]:
    start = time.time()
    done = run(start + TIMEOUT)
    print(name, "%.3f" % (time.time() - start) if done else "failed", flush=True)
