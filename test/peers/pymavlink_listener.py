"""pymavlink as a ground station that only looks: pymavlink_listener.py CONNECTION SYSTEM

Prints what a vehicle is, as "name value" lines: type, autopilot, mode (of AVAILABLE_MODES), pitch in degrees, volts, satellites, text.
"""
import math
import sys
import time

from pymavlink import mavutil

address, system = sys.argv[1], int(sys.argv[2])
link = mavutil.mavlink_connection(address, source_system=250, source_component=190, dialect="all")
modes, found = {}, {}
wanted = {"type", "mode", "pitch", "volts", "satellites"}
end, asked_at = time.time() + 60, 0.0

while time.time() < end and (not wanted <= set(found) or found["mode"] is None):
    if time.time() - asked_at > 1:
        link.mav.heartbeat_send(6, 8, 0, 0, 4)
        # All modes.
        link.mav.command_long_send(system, 1, 512, 0, 435, 0, 0, 0, 0, 0, 0)
        asked_at = time.time()
    m = link.recv_match(blocking=True, timeout=0.2)
    if m is None or m.get_srcSystem() != system:
        continue
    kind = m.get_type()
    if kind == "HEARTBEAT":
        found.update(type=m.type, autopilot=m.autopilot, armed=bool(m.base_mode & 128), mode=modes.get(m.custom_mode))
    elif kind == "AVAILABLE_MODES":
        modes[m.custom_mode] = m.mode_name
    elif kind == "ATTITUDE":
        found["pitch"] = round(math.degrees(m.pitch))
    elif kind == "BATTERY_STATUS":
        found["volts"] = m.voltages[0] / 1000
    elif kind == "GPS_RAW_INT":
        found["satellites"] = m.satellites_visible

for name, value in sorted(found.items()):
    print(name, value, flush=True)
