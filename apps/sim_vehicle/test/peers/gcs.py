"""A ground station made of pymavlink, used by the tests against a simulated vehicle.

gcs.py CONNECTION SCENARIO: prints one line per finding ("name value"), exits 0 when the scenario was gone through.
"""
import sys
import time

from pymavlink import mavutil

ARM, TAKEOFF, SET_MODE, LAND = 400, 22, 176, 21


class Gcs:
    def __init__(self, address):
        self.m = mavutil.mavlink_connection(address, source_system=255, source_component=190, dialect="ardupilotmega")
        self.beat_at = 0
        # A vehicle that waits for the first message would wait for ever.
        if address.startswith("udpout"):
            self.m.mav.heartbeat_send(6, 8, 0, 0, 4)
        self.heard = self.wait("HEARTBEAT", lambda h: h.get_srcSystem() != 255)
        self.system = self.heard.get_srcSystem()
        self.px4 = self.heard.autopilot == mavutil.mavlink.MAV_AUTOPILOT_PX4

    def beat(self):
        if time.time() - self.beat_at > 0.5:
            self.m.mav.heartbeat_send(6, 8, 0, 0, 4)
            self.beat_at = time.time()

    def wait(self, kinds, test=lambda _m: True, timeout=300, wanted=True):
        kinds = [kinds] if isinstance(kinds, str) else kinds
        end = time.time() + timeout
        while time.time() < end:
            self.beat()
            x = self.m.recv_match(blocking=True, timeout=0.2)
            if x is not None and x.get_type() in kinds and test(x):
                return x
        if wanted:
            raise SystemExit("timeout: no %s" % kinds)

    def ask(self, send, kinds, test=lambda _m: True):
        """Asks again while no answer comes: a busy machine's socket loses some."""
        for _ in range(12):
            send()
            x = self.wait(kinds, test, timeout=5, wanted=False)
            if x is not None:
                return x
        raise SystemExit("timeout: no %s" % kinds)

    def command(self, command, *params, acks=1):
        p = list(params) + [0] * (7 - len(params))
        sent = []

        def send():
            sent.append(1)
            self.m.mav.command_long_send(self.system, 1, command, 0, *p)

        ours = lambda a: a.command == command
        results = [self.ask(send, "COMMAND_ACK", ours).result]
        while len(results) < acks:
            results.append(self.wait("COMMAND_ACK", ours, 60).result)
        # What was asked twice is answered twice, unless it was lost; the next command must not get that answer.
        for _ in range((len(sent) - 1) * acks):
            self.wait("COMMAND_ACK", ours, 10, wanted=False)
        return results

    def params(self):
        self.m.mav.param_request_list_send(self.system, 1)
        values, count = {}, None
        while count is None or len([k for k in values if k != "_HASH_CHECK"]) < count:
            p = self.wait("PARAM_VALUE", timeout=2, wanted=False)
            if p is None:
                # A busy machine's socket loses parts of the burst.
                self.m.mav.param_request_list_send(self.system, 1)
                continue
            values[p.param_id] = p.param_value
            count = p.param_count
        return values, count

    def upload(self, items):
        count = lambda: self.m.mav.mission_count_send(self.system, 1, len(items), 0)
        kinds = ["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"]
        r = self.ask(count, kinds)
        while True:
            if r.get_type() == "MISSION_ACK":
                # "Invalid sequence": an item came twice because it was asked for twice; the upload goes on.
                if r.type != mavutil.mavlink.MAV_MISSION_INVALID_SEQUENCE:
                    return r.type
            else:
                self.m.mav.send(items[r.seq])
            r = self.wait(kinds, timeout=60)

    def download(self):
        count = self.ask(lambda: self.m.mav.mission_request_list_send(self.system, 1, 0), "MISSION_COUNT").count
        items = []
        for seq in range(count):
            send = lambda: self.m.mav.mission_request_int_send(self.system, 1, seq, 0)
            items.append(self.ask(send, "MISSION_ITEM_INT", lambda i: i.seq == seq))
        self.m.mav.mission_ack_send(self.system, 1, 0, 0)
        return items

    def item(self, seq, command, lat, lon, alt, frame=3):
        return self.m.mav.mission_item_int_encode(self.system, 1, seq, frame, command, 0, 1, 0, 0, 0, 0, lat, lon, alt, 0)


def say(name, value):
    print("%s %s" % (name, value), flush=True)


def ready(g):
    g.wait("SYS_STATUS", lambda s: s.onboard_control_sensors_health & 0x10000000)


def ardupilot(g):
    values, count = g.params()
    say("params", count)
    say("RTL_ALT", values["RTL_ALT"])
    ready(g)
    say("takeoff_refused", g.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 20))
    say("unknown", g.command(31999))
    home = g.wait("GLOBAL_POSITION_INT", lambda p: p.lat != 0)
    items = [
        g.item(0, 16, home.lat, home.lon, 0, 0),
        g.item(1, 22, 0, 0, 20),
        g.item(2, 16, home.lat + 3000, home.lon, 20),
        g.item(3, 20, 0, 0, 0),
    ]
    say("upload", g.upload(items))
    back = g.download()
    say("mission", [(i.seq, i.command) for i in back])
    say("same", all((a.x, a.y) == (b.x, b.y) for a, b in zip(items[1:], back[1:])))
    say("mode", g.command(SET_MODE, 1, 4))
    say("arm", g.command(ARM, 1))
    g.wait("HEARTBEAT", lambda h: h.base_mode & 128)
    say("takeoff", g.command(TAKEOFF, 0, 0, 0, 0, 0, 0, 15))
    g.wait("GLOBAL_POSITION_INT", lambda p: p.relative_alt > 14000)
    g.m.mav.set_position_target_global_int_send(0, g.system, 1, 6, 0xFF8, home.lat + 3000, home.lon, 15, *([0] * 8))
    g.wait("GLOBAL_POSITION_INT", lambda p: abs(p.lat - home.lat - 3000) < 200)
    say("goto", "reached")
    say("disarm_in_air", g.command(ARM, 0))
    say("land", g.command(SET_MODE, 1, 9))
    g.wait("STATUSTEXT", lambda t: t.text == "Disarming motors")
    g.wait("HEARTBEAT", lambda h: not h.base_mode & 128)
    say("landed", "disarmed")


def px4(g):
    values, count = g.params()
    say("params", count)
    say("hash", "_HASH_CHECK" in values)
    ready(g)
    say("unknown", g.command(31999))
    say("offboard_while_disarmed", g.command(SET_MODE, 1, 6, 0, acks=2))
    say("mode", g.command(SET_MODE, 1, 4, 3, acks=2))
    say("arm", g.command(ARM, 1))
    say("armed_text", repr(g.wait("STATUSTEXT", lambda t: t.text.startswith("Armed")).text))
    home = g.wait("HOME_POSITION")
    nan = float("nan")
    say("takeoff", g.command(TAKEOFF, 0, 0, 0, nan, nan, nan, home.altitude / 1000 + 12))
    g.wait("GLOBAL_POSITION_INT", lambda p: p.relative_alt > 11000)
    g.wait("HEARTBEAT", lambda h: h.custom_mode == 50593792)
    say("offboard_refused", g.command(SET_MODE, 1, 6, 0, acks=2))
    say("disarm_in_air", g.command(ARM, 0))
    say("land", g.command(LAND, 0, 0, 0, nan, nan, nan, nan))
    g.wait("STATUSTEXT", lambda t: t.text.startswith("Disarmed by landing"))
    g.wait("HEARTBEAT", lambda h: not h.base_mode & 128)
    say("landed", "disarmed")


if __name__ == "__main__":
    gcs = Gcs(sys.argv[1])
    say("system", gcs.system)
    {"ardupilot": ardupilot, "px4": px4}[sys.argv[2]](gcs)
    say("bad", gcs.m.mav.total_receive_errors)
