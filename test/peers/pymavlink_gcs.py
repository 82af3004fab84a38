"""pymavlink as a ground station: pymavlink_gcs.py CONNECTION FIRMWARE SYSTEM PARAMETER [SOURCE]

With SIGNING_KEY (64 hexadecimal digits) in the environment it signs, and accepts only frames that are signed with that key.
This needs MAVLINK20=1, because MAVLink 1 has no signatures.

Prints one line per finding ("name value"); exits 0 after a complete flight. SOURCE is its own system id.
CONNECTION is pymavlink's, or unix:PATH for the gateway's mavlink.sock (see length_prefixed.py).
"""
import os
import sys
import time

from pymavlink import mavutil

from length_prefixed import LengthPrefixed

ARM, TAKEOFF, SET_MODE, LAND = 400, 22, 176, 21


class Gcs:
    def __init__(self, address, system, source):
        if address.startswith("unix:"):
            self.m = LengthPrefixed(address[5:], source)
        else:
            self.m = mavutil.mavlink_connection(address, source_system=source, source_component=190, dialect="ardupilotmega")
        key = os.environ.get("SIGNING_KEY")
        if key:
            self.m.setup_signing(bytes.fromhex(key), sign_outgoing=True, allow_unsigned_callback=lambda *_: False, link_id=7)
        self.system = system
        self.beat_at = 0
        heard = self.wait("HEARTBEAT")
        self.px4 = heard.autopilot == mavutil.mavlink.MAV_AUTOPILOT_PX4

    def wait(self, kinds, test=lambda _m: True, timeout=300, wanted=True):
        kinds = [kinds] if isinstance(kinds, str) else kinds
        end = time.time() + timeout
        while time.time() < end:
            if time.time() - self.beat_at > 0.5:
                self.m.mav.heartbeat_send(6, 8, 0, 0, 4)
                self.beat_at = time.time()
            x = self.m.recv_match(blocking=True, timeout=0.2)
            if x is not None and x.get_type() in kinds and x.get_srcSystem() == self.system and x.get_srcComponent() == 1 and test(x):
                return x
        if wanted:
            raise SystemExit("timeout: no %s" % kinds)

    def command(self, command, *params, tries=20):
        p = list(params) + [0] * (7 - len(params))
        for _ in range(tries):
            self.m.mav.command_long_send(self.system, 1, command, 0, *p)
            ack = self.wait("COMMAND_ACK", lambda a: a.command == command, 5, wanted=False)
            if ack is not None and ack.result == 0:
                return ack
            time.sleep(0.2)
        raise SystemExit("command %d: %s" % (command, ack))

    def params(self):
        self.m.mav.param_request_list_send(self.system, 1)
        values, count, index = {}, None, set()
        while count is None or len(index) < count:
            p = self.wait("PARAM_VALUE", timeout=1, wanted=False)
            if p is None:
                # What was lost on the way is asked for again, a few at a time: mavp2p keeps 64 frames of a burst.
                if count is None:
                    self.m.mav.param_request_list_send(self.system, 1)
                else:
                    for missing in sorted(set(range(count)) - index)[:20]:
                        self.m.mav.param_request_read_send(self.system, 1, b"", missing)
                continue
            values[p.param_id] = p
            if p.param_index < 65535:
                index.add(p.param_index)
                count = p.param_count
        return values, count

    # A ground station repeats what is not answered.
    def asked(self, send, kinds, test=lambda _m: True):
        for _ in range(200):
            send()
            answer = self.wait(kinds, test, 1.5, wanted=False)
            if answer is not None:
                return answer
        raise SystemExit("timeout: no %s" % kinds)

    # A vehicle that has heard no item for a while gives up without a word; then the operator tries once more.
    def upload(self, items):
        kinds = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
        for _ in range(2):
            r = self.asked(lambda: self.m.mav.mission_count_send(self.system, 1, len(items), 0), kinds)
            while r is not None:
                if r.get_type() != "MISSION_ACK":
                    self.m.mav.send(items[r.seq])
                # On a busy machine an item may be requested and sent twice. The second one is refused
                # (MAV_MISSION_INVALID_SEQUENCE, 13), and the upload goes on.
                elif r.type != 13:
                    return r.type
                r = self.wait(kinds, timeout=20, wanted=False)
        raise SystemExit("timeout: no %s" % kinds)

    def download(self):
        mav = self.m.mav
        count = self.asked(lambda: mav.mission_request_list_send(self.system, 1, 0), "MISSION_COUNT").count
        items = []
        for seq in range(count):
            request = lambda: mav.mission_request_int_send(self.system, 1, seq, 0)
            items.append(self.asked(request, "MISSION_ITEM_INT", lambda i: i.seq == seq))
        mav.mission_ack_send(self.system, 1, 0, 0)
        return items

    def item(self, seq, command, lat, lon, alt, frame=6):
        return self.m.mav.mission_item_int_encode(self.system, 1, seq, frame, command, 0, 1, 0, 0, 0, 0, lat, lon, alt, 0)


def say(name, value):
    print("%s %s" % (name, value), flush=True)


def main(address, firmware, system, parameter, source=255):
    g = Gcs(address, system, source)
    say("system", g.system)
    home = g.wait("GLOBAL_POSITION_INT", lambda p: p.lat != 0)
    say("lat", "%.4f" % (home.lat / 1e7))
    say("battery", g.wait("SYS_STATUS").voltage_battery > 5000)

    values, count = g.params()
    say("params", count)
    value = values[parameter].param_value + 1.5
    g.m.mav.param_set_send(g.system, 1, parameter.encode(), value, values[parameter].param_type)
    # On a busy machine an answer to the list may still be on its way, with the old value.
    say("set", g.wait("PARAM_VALUE", lambda p: p.param_id == parameter and p.param_value == value, 30, wanted=False) is not None)

    first = [] if g.px4 else [g.item(0, 16, home.lat, home.lon, 0, 0)]
    n = len(first)
    items = first + [g.item(n, 22, home.lat, home.lon, 12), g.item(n + 1, 16, home.lat + 3000, home.lon, 15), g.item(n + 2, LAND, home.lat, home.lon, 0)]
    # On a busy machine the vehicle repeats its requests, each is answered, and the vehicle gives up (C2).
    for _ in range(10):
        result = g.upload(items)
        if result not in (1, 15):
            break
    say("upload", result)
    back = g.download()
    say("mission", [i.command for i in back])
    say("same", all((a.x, a.y, a.z) == (b.x, b.y, b.z) for a, b in list(zip(items, back))[n:]))

    g.wait("SYS_STATUS", lambda s: s.onboard_control_sensors_health & 0x10000000)
    if not g.px4:
        g.command(SET_MODE, 1, 4)
    g.command(ARM, 1)
    g.wait("HEARTBEAT", lambda h: h.base_mode & 128)
    say("arm", "armed")
    msl = g.wait("GLOBAL_POSITION_INT").alt / 1000
    nan = float("nan")
    if g.px4:
        g.command(TAKEOFF, 0, 0, 0, nan, nan, nan, msl + 10)
    else:
        g.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 10)
    g.wait("GLOBAL_POSITION_INT", lambda p: p.relative_alt > 8500)
    say("takeoff", "ten metres")
    g.command(LAND, 0, 0, 0, nan if g.px4 else 0)
    g.wait("HEARTBEAT", lambda h: not h.base_mode & 128)
    say("land", "disarmed")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4], *map(int, sys.argv[5:]))
