"""pymavlink as a ground station that is told what to send: pymavlink_commands.py CONNECTION SYSTEM

Reads a line of JSON for each message, and prints "answer JSON" when the vehicle has answered it:

  {"long": [COMMAND, P1, ...]}                      COMMAND_LONG; null is NaN
  {"int": [COMMAND, FRAME, P1, P2, P3, P4, X, Y, Z]}  COMMAND_INT
  {"send": MESSAGE, "fields": {...}}                any other message; with "stream": true 30 times a second until the next one like it

The answer has "ack", the result of COMMAND_ACK or null, and "text", the first STATUSTEXT that begins with "refused" or null.
It waits for the acknowledgement of a command, for two seconds only with "silent": true, and with "refused": true for that text.
"""
import json
import queue
import sys
import threading
import time

from pymavlink import mavutil


class Peer:
    def __init__(self, address, system):
        self.m = mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="all")
        self.system = system
        self.stream = None
        self.beat_at = self.send_at = 0
        self.orders = queue.Queue()

    def step(self):
        """Sends what is due, and returns the next message of the vehicle, or None."""
        now = time.time()
        if now >= self.beat_at:
            self.m.mav.heartbeat_send(6, 8, 0, 0, 4)
            self.beat_at = now + 0.5
        if self.stream and now >= self.send_at:
            self.stream()
            self.send_at = now + 0.03
        x = self.m.recv_match(blocking=True, timeout=0.02)
        return x if x is not None and x.get_srcSystem() == self.system else None

    def command(self, order):
        nan = float("nan")
        if "long" in order:
            command, *p = [nan if v is None else v for v in order["long"]]
            self.m.mav.command_long_send(self.system, 1, command, 0, *(p + [0] * (7 - len(p))))
        else:
            command, frame, *p = [nan if v is None else v for v in order["int"]]
            self.m.mav.command_int_send(self.system, 1, frame, command, 0, 0, *p[:4], int(p[4]), int(p[5]), p[6])
        return command

    def send(self, order):
        fields = dict(order["fields"])
        message = getattr(self.m.mav, order["send"] + "_encode")
        names = message.__code__.co_varnames[1 : message.__code__.co_argcount]
        for name, value in (("target_system", self.system), ("target_component", 1), ("target", self.system)):
            if name in names:
                fields[name] = value
        self.m.mav.send(message(**fields))
        self.stream = (lambda: self.m.mav.send(message(**fields))) if order.get("stream") else None

    def obey(self, order):
        command = None if "send" in order else self.command(order)
        if command is None:
            self.send(order)
        refused = order.get("refused", False)
        end = time.time() + (2 if order.get("silent") and not refused else 30)
        ack = text = None
        while time.time() < end and (command is not None and ack is None or refused and text is None):
            x = self.step()
            if x is None:
                continue
            if x.get_type() == "COMMAND_ACK" and x.command == command and x.result != 5:
                ack = x.result
            if x.get_type() == "STATUSTEXT" and x.text.startswith("refused"):
                text = text or x.text
        if refused:
            self.stream = None
        return {"ack": ack, "text": text}

    def read_orders(self):
        for line in sys.stdin:
            self.orders.put(json.loads(line))


def main(address, system):
    peer = Peer(address, system)
    while True:
        x = peer.step()
        if x is not None and x.get_type() == "HEARTBEAT":
            break
    threading.Thread(target=peer.read_orders, daemon=True).start()
    while True:
        try:
            order = peer.orders.get_nowait()
        except queue.Empty:
            peer.step()
            continue
        print("answer " + json.dumps(peer.obey(order)), flush=True)


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]))
