"""A serial line between a pseudo terminal and a simulated flight controller's TCP port: msp_line.py PORT BAUD

Each byte takes ten bits of the line in each direction. Prints "pty PATH", and for each line of input "line REQUESTS BYTES_TO BYTES_FROM": what has gone to
the flight controller since the start, and what came from it.
"""
import os
import re
import selectors
import socket
import sys
import time
import tty


class Way:
    """One direction of the line: what was put on it comes out when its last byte has passed."""

    def __init__(self, baud):
        self.byte, self.free, self.waiting, self.bytes = 10 / baud, 0.0, [], 0

    def put(self, data, now):
        self.free = max(self.free, now) + len(data) * self.byte
        self.bytes += len(data)
        self.waiting.append((self.free, data))

    def due(self, now):
        out = b""
        while self.waiting and self.waiting[0][0] <= now:
            out += self.waiting.pop(0)[1]
        return out


def main(port, baud):
    master, slave = os.openpty()
    tty.setraw(slave)
    peer = socket.create_connection(("127.0.0.1", port))
    peer.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    to, back, requests = Way(baud), Way(baud), 0
    chosen = selectors.DefaultSelector()
    for file in (master, peer, sys.stdin):
        chosen.register(file, selectors.EVENT_READ)
    print("pty " + os.ttyname(slave), flush=True)
    while True:
        now = time.monotonic()
        if out := to.due(now):
            peer.sendall(out)
        if out := back.due(now):
            os.write(master, out)
        times = [way.waiting[0][0] for way in (to, back) if way.waiting]
        for key, _ in chosen.select(max(min(times) - time.monotonic(), 0) if times else None):
            now = time.monotonic()
            if key.fileobj is peer:
                data = peer.recv(65536)
                if not data:
                    return
                back.put(data, now)
            elif key.fileobj == master:
                data = os.read(master, 65536)
                requests += len(re.findall(rb"\$[MX]<", data))
                to.put(data, now)
            elif not sys.stdin.readline():
                return
            else:
                print("line %d %d %d" % (requests, to.bytes, back.bytes), flush=True)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
