#!/usr/bin/env python3
"""The other end of a serial cable, over a PTY.

Standard input and output carry packets: two bytes of length, big-endian, one letter, data. In: `w` write, `x` pull the
cable, `o` plug in again. Out: `n` the device's name, `d` data from the device's user. Ends with its input.
"""
import os
import pty
import select
import struct
import sys
import termios
import tty

master = None


def tell(letter, data=b""):
    try:
        os.write(1, struct.pack(">H", len(data) + 1) + letter + data)
    except BrokenPipeError:
        # Who started us is gone.
        os._exit(0)


def plug_in():
    global master
    master, slave = pty.openpty()
    tty.setraw(slave, termios.TCSANOW)
    name = os.ttyname(slave)
    # The user's end closes and opens as it likes; held open here so that the line exists without it.
    globals()["held"] = slave
    tell(b"n", name.encode())


def pull():
    global master
    os.close(globals()["held"])
    os.close(master)
    master = None


def exactly(n):
    data = b""
    while len(data) < n:
        more = os.read(0, n - len(data))
        if not more:
            sys.exit(0)
        data += more
    return data


plug_in()
while True:
    watched = [0] + ([master] if master is not None else [])
    ready, _, _ = select.select(watched, [], [])
    if 0 in ready:
        packet = exactly(struct.unpack(">H", exactly(2))[0])
        if packet[:1] == b"w":
            data = packet[1:]
            while data:
                data = data[os.write(master, data):]
        elif packet[:1] == b"x":
            pull()
            continue
        elif packet[:1] == b"o":
            plug_in()
            continue
    if master is not None and master in ready:
        tell(b"d", os.read(master, 4096))
