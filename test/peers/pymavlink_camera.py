"""pymavlink as a ground station of a camera: pymavlink_camera.py CONNECTION SYSTEM COMPONENT [refused]

With "refused" it sets one parameter, and prints what it is answered. Otherwise it reads the camera's parameters by PARAM_EXT and sets three of them: one that it takes, one that it works on, and one that it does not support.
pymavlink gives char[128] as text up to the first NUL, so the values are read from the payload. Prints one line per finding
("name value").
"""
import struct
import sys
import time

from pymavlink import mavutil

UINT8, UINT16, UINT32 = 1, 3, 5
ACCEPTED, UNSUPPORTED, IN_PROGRESS = 0, 1, 3
FORMATS = {1: "<B", 2: "<b", 3: "<H", 4: "<h", 5: "<I", 6: "<i", 7: "<Q", 8: "<q", 9: "<f", 10: "<d"}


class Camera:
    def __init__(self, address, system, component):
        self.m = mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="common")
        self.target = (system, component)
        self.beat_at = 0

    def wait(self, kind, test=lambda _m: True):
        end = time.time() + 120
        while time.time() < end:
            if time.time() - self.beat_at > 0.5:
                self.m.mav.heartbeat_send(6, 8, 0, 0, 4)
                self.beat_at = time.time()
            x = self.m.recv_match(type=kind, blocking=True, timeout=0.2)
            if x is not None and (x.get_srcSystem(), x.get_srcComponent()) == self.target and test(x):
                return x
        raise SystemExit("timeout: no %s" % kind)

    def value(self, message):
        # Count and index, of two bytes each, are before the texts; trailing zeros are not sent.
        at = 10 + (4 if message.get_type() == "PARAM_EXT_VALUE" else 0) + 16
        raw = bytes(message.get_msgbuf()[at:])[: 128].ljust(128, b"\0")
        return struct.unpack_from(FORMATS[message.param_type], raw)[0] if message.param_type in FORMATS else raw.rstrip(b"\0")

    def set(self, name, kind, number):
        self.m.mav.param_ext_set_send(*self.target, name, struct.pack(FORMATS[kind], number), kind)
        return self.wait("PARAM_EXT_ACK", lambda a: a.param_id == name.decode())


camera = Camera(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
print("type", camera.wait("HEARTBEAT").type)
if "refused" in sys.argv:
    ack = camera.set(b"CAM_ISO", UINT32, 0x02000100)
    print("set", ack.param_result, ack.param_type)
    sys.exit(0)
camera.m.mav.param_ext_request_list_send(*camera.target)
values = {}
while True:
    p = camera.wait("PARAM_EXT_VALUE")
    values[p.param_id] = camera.value(p)
    if len(values) == p.param_count:
        break
for name, value in values.items():
    print(name, value)
ack = camera.set(b"CAM_ISO", UINT32, 0x02000100)
print("set", ack.param_result, camera.value(ack))
ack = camera.set(b"CAM_MODE", UINT8, 9)
print("unsupported", ack.param_result, camera.value(ack))
print("begun", camera.set(b"CAM_FORMAT", UINT16, 512).param_result)
ack = camera.wait("PARAM_EXT_ACK", lambda a: a.param_id == "CAM_FORMAT" and a.param_result != IN_PROGRESS)
print("done", ack.param_result, camera.value(ack))
