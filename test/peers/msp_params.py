"""The parameters of a vehicle that speaks MSP, read and set by a ground station: msp_params.py mavsdk|qgc|script URL SYSTEM NAME=VALUE...

`mavsdk` is MAVSDK, `script` pymavlink's own mavset, which is also MAVProxy's. QGroundControl itself needs a screen: `qgc` has the rules of its
ParameterManager for every autopilot but ArduPilot. A value is the member of a union of four bytes that its type names; a set is acknowledged by a
PARAM_VALUE with the same name, type and value.

Prints "all" with a JSON object of what it shows, after a reading, and "set:NAME" for each that it sets.
"""
import json
import os
import struct
import sys
import time

os.environ["MAVLINK20"] = "1"

MEMBERS = {1: "B", 2: "b", 3: "<H", 4: "<h", 5: "<I", 6: "<i", 9: "<f"}


def say(name, value):
    print("%s %s\n" % (name, value), end="", flush=True)


def until(what, fun, seconds=120):
    end = time.time() + seconds
    while time.time() < end:
        value = fun()
        if value is not None:
            return value
        time.sleep(0.05)
    raise SystemExit("timeout: %s" % what)


def pymavlink(url, system, changes, script):
    from pymavlink import mavparm, mavutil

    link = mavutil.mavlink_connection(url, source_system=255, source_component=190)
    link.target_system, link.target_component = system, 1

    def hear(kind, seconds):
        return link.recv_match(type=kind, blocking=True, timeout=seconds)

    def union(message):
        member = MEMBERS[message.param_type]
        return struct.unpack(member, struct.pack("<f", message.param_value)[: struct.calcsize(member)])[0]

    until("the vehicle", lambda: (lambda m: m if m and m.get_srcSystem() == system else None)(hear("HEARTBEAT", 1)))
    link.mav.param_request_list_send(system, 1)
    have, count = {}, None
    while count is None or len(have) < count:
        message = hear("PARAM_VALUE", 30)
        if message is None:
            raise SystemExit("%s of %s parameters" % (len(have), count))
        if message.param_index < 65535:
            have[message.param_id], count = message, message.param_count
    say("all", json.dumps({name: union(m) for name, m in have.items()}))

    for name, value in changes:
        if script:
            # It writes the name in capitals, the number as a float, and takes any PARAM_VALUE of the name.
            say("set:%s" % name, mavparm.MAVParmDict().mavset(link, name, value))
            continue
        kind = have[name].param_type
        number, = struct.unpack("<f", struct.pack(MEMBERS[kind], value).ljust(4, b"\0"))
        for attempt in range(3):
            link.mav.param_set_send(system, 1, name.encode(), number, kind)
            message = hear("PARAM_VALUE", 3)
            if message and (message.param_id, message.param_type, union(message)) == (name, kind, value):
                say("set:%s" % name, True)
                break


def mavsdk(url, system_id, changes):
    from mavsdk.component_type import ComponentType
    from mavsdk.mavsdk import Configuration, Mavsdk
    from mavsdk.plugins.param.param import Param

    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    sdk.add_any_connection(url)
    find = lambda: next((s for s in sdk.get_systems() if s.get_system_id() == system_id and s.has_autopilot()), None)  # noqa: E731
    params = Param(until("the vehicle", find))

    def attempt():
        everything = params.get_all_params()
        shown = {p.name: p.value for p in everything.int_params + everything.float_params}
        return shown or None

    say("all", json.dumps(until("parameters", attempt)))
    for name, value in changes:
        if isinstance(value, int):
            params.set_param_int(name, value)
            say("set:%s" % name, params.get_param_int(name) == value)
        else:
            params.set_param_float(name, value)
            say("set:%s" % name, params.get_param_float(name) == value)


if __name__ == "__main__":
    kind, url, system = sys.argv[1], sys.argv[2], int(sys.argv[3])
    wanted = [(n, json.loads(v)) for n, v in (a.split("=") for a in sys.argv[4:])]
    if kind == "mavsdk":
        mavsdk(url, system, wanted)
    else:
        pymavlink(url, system, wanted, kind == "script")
    sys.stdout.flush()
    os._exit(0)
