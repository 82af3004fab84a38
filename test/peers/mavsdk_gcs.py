"""MAVSDK as a ground station: mavsdk_gcs.py URL FIRMWARE SYSTEM PARAMETER

Prints one line per finding ("name value"); exits 0 after a complete flight.
"""
import sys
import threading
import time

from mavsdk.mavsdk import Configuration, Mavsdk
from mavsdk.component_type import ComponentType
from mavsdk.connection_result import ConnectionResult
from mavsdk.plugins.action.action import Action
from mavsdk.plugins.mission_raw.mission_raw import MissionItem, MissionRaw
from mavsdk.plugins.param.param import Param
from mavsdk.plugins.telemetry.telemetry import Telemetry


def say(name, value):
    # One write: MAVSDK's server logs into the same pipe.
    print("%s %s\n" % (name, value), end="", flush=True)


def until(what, fun, seconds=300):
    end = time.time() + seconds
    while time.time() < end:
        value = fun()
        if value:
            return value
        time.sleep(0.05)
    raise SystemExit("timeout: %s" % what)


def retried(what, fun, tries=10):
    """A step that the vehicle may refuse for a moment (not ready yet)."""
    for n in range(tries):
        try:
            return fun()
        except Exception as error:
            if n == tries - 1:
                raise SystemExit("%s: %s" % (what, error))
            time.sleep(1)


def item(seq, command, lat, lon, alt, frame=6):
    return MissionItem(seq, frame, command, int(seq == 0), 1, 0.0, 0.0, 0.0, float("nan") if command in (16, 22) else 0.0, lat, lon, alt, 0)


def main(url, firmware, system_id, parameter):
    sdk = Mavsdk(Configuration.create_with_component_type(ComponentType.GROUND_STATION))
    result = sdk.add_any_connection(url)
    if result != ConnectionResult.SUCCESS:
        raise SystemExit("no connection: %s" % result)
    system = until("vehicle %d" % system_id, lambda: next((s for s in sdk.get_systems() if s.get_system_id() == system_id and s.has_autopilot()), None))
    say("systems", sorted(s.get_system_id() for s in sdk.get_systems()))

    telemetry = Telemetry(system)
    position = until("a position", lambda: (lambda p: p if abs(p.latitude_deg) > 1 else None)(telemetry.position()))
    say("lat", "%.4f" % position.latitude_deg)
    battery = []
    handle = telemetry.subscribe_battery(lambda *args: battery.append(args[0]))
    say("battery", until("a battery", lambda: battery)[0].voltage_v > 5)
    telemetry.unsubscribe_battery(handle)
    until("a position that is good enough", lambda: telemetry.health().is_global_position_ok, 90)

    params = Param(system)
    everything = retried("parameters", params.get_all_params)
    say("params", len(everything.int_params) + len(everything.float_params))
    before = retried("one parameter", lambda: params.get_param_float(parameter))
    retried("setting it", lambda: params.set_param_float(parameter, before + 1.5))
    say("set", retried("reading it back", lambda: params.get_param_float(parameter)) == before + 1.5)

    missions = MissionRaw(system)
    lat, lon = int(position.latitude_deg * 1e7), int(position.longitude_deg * 1e7)
    first = [item(0, 16, lat, lon, 0.0, 0)] if firmware == "ardupilot" else []
    items = first + [
        item(len(first), 22, lat, lon, 12.0),
        item(len(first) + 1, 16, lat + 3000, lon, 15.0),
        item(len(first) + 2, 21, lat, lon, 0.0),
    ]
    retried("mission upload", lambda: missions.upload_mission(items))
    back = retried("mission download", missions.download_mission)
    say("mission", [i.command for i in back])
    say("same", all((a.seq, a.command, a.x, a.y, round(a.z, 2)) == (b.seq, b.command, b.x, b.y, round(b.z, 2)) for a, b in list(zip(items, back))[len(first):]))

    action = Action(system)
    action.set_takeoff_altitude(10.0)
    retried("arm", action.arm, 30)
    until("armed", telemetry.armed)
    say("arm", "armed")
    retried("takeoff", action.takeoff)
    until("ten metres", lambda: telemetry.position().relative_altitude_m > 8.5)
    say("takeoff", telemetry.in_air())
    retried("land", action.land)
    until("disarmed", lambda: not telemetry.armed(), 90)
    say("land", "disarmed")
    threading.Timer(10, lambda: __import__("os")._exit(0)).start()
    sdk.destroy()


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4])
    sys.stdout.flush()
    __import__("os")._exit(0)
