#!/usr/bin/env python3
"""A pymavlink peer that signs: a vehicle that sends a heartbeat ten times a second, takes SETUP_SIGNING as flight
controllers do, and tells on standard output what it hears and whether pymavlink found its signature right.

    signing_peer.py CONNECTION SYSTEM LINK_ID [PASSPHRASE]

With a passphrase it signs from the start. It ends with its standard input.
"""
import hashlib
import os
import select
import sys

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402

connection, system, link_id = sys.argv[1], int(sys.argv[2]), int(sys.argv[3])


def tell(*words):
    print(*words, flush=True)


def sign_with(link, key):
    # Whatever has no right signature is not heard.
    link.setup_signing(bytes(key), sign_outgoing=True, allow_unsigned_callback=lambda mav, message_id: False, link_id=link_id)


def run():
    link = mavutil.mavlink_connection(connection, source_system=system, source_component=1)
    if len(sys.argv) > 4:
        sign_with(link, hashlib.sha256(sys.argv[4].encode()).digest())
    tell("connected")
    while not select.select([sys.stdin], [], [], 0)[0]:
        link.mav.heartbeat_send(2, 3, 81, 0, 4)
        message = link.recv_match(blocking=True, timeout=0.1)
        if message is None or message.get_type() == "BAD_DATA":
            continue
        if message.get_type() == "SETUP_SIGNING" and message.target_system == system:
            if any(message.secret_key):
                sign_with(link, message.secret_key)
                tell("key taken")
            else:
                link.disable_signing()
                tell("key given up")
        else:
            tell("heard", message.get_type(), message.get_srcSystem(), "signed" if message.get_signed() else "unsigned")


try:
    run()
except BrokenPipeError:
    # Who started us is gone; nothing is left to be said, not even at exit.
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
