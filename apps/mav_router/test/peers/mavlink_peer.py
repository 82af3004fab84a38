#!/usr/bin/env python3
"""A pymavlink peer: sends a heartbeat and COUNT numbered ATTITUDE frames as system SYSTEM over CONNECTION, tells on
standard output what it hears, one line each, and ends with its standard input.

    mavlink_peer.py CONNECTION SYSTEM COUNT [wait] [hold]

With `wait` it sends when it has heard something: a server knows its client only then. With `hold` it opens its connection
when a line comes on its standard input.
"""
import os
import select
import sys

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402

connection, system, count = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])
wait, hold = "wait" in sys.argv[4:], "hold" in sys.argv[4:]


def tell(*words):
    print(*words, flush=True)


def send(link):
    link.mav.heartbeat_send(2, 3, 81, 0, 4)
    for n in range(1, count + 1):
        link.mav.attitude_send(n, 0.1, 0.2, 0.3, 0.0, 0.0, 0.0)
        if n % 50 == 0:
            select.select([], [], [], 0.002)


def run():
    tell("starting")
    if hold and not os.read(0, 100):
        return
    link = mavutil.mavlink_connection(connection, source_system=system, source_component=1, autoreconnect=True)
    tell("connected", *([link.port.getsockname()[1]] if connection.startswith("udpin:") else []))
    waiting = wait
    if not waiting:
        send(link)

    while not select.select([sys.stdin], [], [], 0)[0]:
        message = link.recv_match(blocking=True, timeout=0.1)
        if message is None:
            continue
        tell("heard", message.get_type(), message.get_srcSystem(), message.get_srcComponent())
        if waiting:
            waiting = False
            send(link)


try:
    run()
except BrokenPipeError:
    # Who started us is gone; nothing is left to be said, not even at exit.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
