"""A pymavlink connection over the gateway's mavlink.sock: a 4-byte little-endian length before each frame, both ways.

It is an example for users' scripts and needs only pymavlink's parser and encoder.
"""
import select
import socket
import struct
import time

from pymavlink.dialects.v20 import ardupilotmega as mavlink


class LengthPrefixed:
    def __init__(self, path, source_system=255, source_component=190):
        self.sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        self.sock.connect(path)
        self.buffer = b""
        self.mav = mavlink.MAVLink(self, srcSystem=source_system, srcComponent=source_component)
        self.mav.robust_parsing = True

    def write(self, frame):
        self.sock.sendall(struct.pack("<I", len(frame)) + frame)

    def _frame(self, timeout):
        """The next frame, None when it does not come in time."""
        end = time.time() + timeout
        while True:
            if len(self.buffer) >= 4:
                (length,) = struct.unpack_from("<I", self.buffer)
                assert length <= 280, "not a frame: %d bytes" % length
                if len(self.buffer) >= 4 + length:
                    frame, self.buffer = self.buffer[4 : 4 + length], self.buffer[4 + length :]
                    return frame
            left = end - time.time()
            if left <= 0 or not select.select([self.sock], [], [], left)[0]:
                return None
            data = self.sock.recv(65536)
            if not data:
                raise SystemExit("the gateway closed the socket")
            self.buffer += data

    def recv_match(self, blocking=True, timeout=1.0):
        frame = self._frame(timeout)
        if frame is None:
            return None
        messages = self.mav.parse_buffer(frame)
        assert messages and len(messages) == 1, "one frame in each piece"
        return messages[0]
