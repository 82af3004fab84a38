"""QGroundControl's conversation with vehicles: qgc_gcs.py CONNECTION SYSTEM,SYSTEM,... [SOURCE [look]]

QGroundControl itself needs a screen. This script repeats its conversation as known from its sources: a heartbeat each second
as 255/190; for each vehicle, all at once, AUTOPILOT_VERSION, PROTOCOL_VERSION, AVAILABLE_MODES and COMPONENT_METADATA by
REQUEST_MESSAGE, with three tries of three seconds per command; a request for the parameters by FTP; all parameters, the
missing ones in batches of ten; mission, fence and rally points; data streams or message intervals; the list of logs. With
`look` it saves no plans, like a second operator. A UDP connection listens, and answers each sender at its address.

Prints one line per finding ("SYSTEM.name value") and exits 0 when all conversations are complete.
"""
import os
import sys
import time

os.environ["MAVLINK20"] = "1"
from pymavlink import mavutil  # noqa: E402

REQUEST_MESSAGE, SET_INTERVAL = 512, 511
VERSION, PROTOCOL, MODES, METADATA = 148, 300, 435, 397
RESULTS = {0: "accepted", 2: "denied", 3: "unsupported", 4: "failed"}
FENCE, RALLY = 5001, 5100


class Wait:
    def __init__(self, test, seconds):
        self.test, self.seconds = test, seconds


class Vehicle:
    """The conversation with one vehicle: a generator that is given what it waits for, None when it did not come."""

    def __init__(self, link, system, heartbeat, source, look):
        self.mav, self.system, self.source, self.look = link.mav, system, source, look
        self.px4 = heartbeat.autopilot == 12
        self.found, self.done, self.at = {}, False, None
        self.steps = self.talk()
        self.wait = next(self.steps)
        self.until = time.time() + self.wait.seconds

    def hear(self, message):
        if message.get_type() == "GLOBAL_POSITION_INT" and message.lat:
            self.at = message
        if not self.done and self.wait.test(message):
            self.go_on(message)

    def tick(self):
        if not self.done and time.time() > self.until:
            self.go_on(None)

    def go_on(self, message):
        try:
            self.wait = self.steps.send(message)
            self.until = time.time() + self.wait.seconds
        except StopIteration:
            self.done = True

    def say(self, name, value):
        self.found[name] = value
        print("%d.%s %s" % (self.system, name, value), flush=True)

    def talk(self):
        # Every vehicle has it, on a busy machine later than its acknowledgement.
        yield from self.message("version", VERSION, "AUTOPILOT_VERSION", 60)
        yield from self.message("protocol", PROTOCOL, "PROTOCOL_VERSION")
        yield from self.message("modes", MODES, "AVAILABLE_MODES")
        yield from self.message("metadata", METADATA, "COMPONENT_METADATA")
        yield from self.streams()
        yield from self.ftp()
        yield from self.params()
        while self.at is None:
            yield Wait(lambda m: m.get_type() == "GLOBAL_POSITION_INT", 5)
        lat, lon = self.at.lat, self.at.lon
        corners = [(lat + a * 20000, lon + b * 20000) for a, b in ((1, 1), (1, -1), (-1, -1), (-1, 1))]
        yield from self.plan("mission", 0, [(16, 0, lat, lon, 30.0), (16, 0, lat + 2000, lon, 30.0)])
        yield from self.plan("fence", 1, [(FENCE, 4, x, y, 0.0) for x, y in corners])
        yield from self.plan("rally", 2, [(RALLY, 0, lat + n * 1000, lon, 40.0) for n in (1, 2)])
        yield from self.logs()

    def command(self, command, *params):
        """Three times, three seconds each; the result's word, or silent."""
        p = list(params) + [0] * (7 - len(params))
        for n in range(3):
            self.mav.command_long_send(self.system, 1, command, n, *p)
            ack = yield Wait(lambda m: self.acks(m, command), 3)
            if ack is not None:
                return RESULTS.get(ack.result, ack.result)
        return "silent"

    def acks(self, m, command):
        return m.get_type() == "COMMAND_ACK" and m.command == command and m.target_system in (0, self.source)

    def message(self, name, id, kind, late=3):
        """The answer and the message may come in any order; what is accepted and does not come is not asked for again.

        `late`: how long (s) after its acceptance the message is waited for.
        """
        p = [id, 0, 0, 0, 0, 0, 0]
        ack = message = None
        for n in range(3):
            self.mav.command_long_send(self.system, 1, REQUEST_MESSAGE, n, *p)
            while ack is None or (ack.result == 0 and message is None):
                x = yield Wait(lambda m: m.get_type() == kind or self.acks(m, REQUEST_MESSAGE), 3 if ack is None else late)
                if x is None:
                    break
                if x.get_type() == "COMMAND_ACK":
                    ack = x
                else:
                    message = x
            if ack is not None:
                break
        self.say(name, "came" if message is not None else "silent" if ack is None else RESULTS.get(ack.result, ack.result))

    def streams(self):
        if self.px4:
            self.say("interval", (yield from self.command(SET_INTERVAL, 30, 100000)))
        else:
            for stream, rate in ((1, 2), (2, 2), (3, 2), (6, 3), (10, 10), (11, 10), (12, 3)):
                self.mav.request_data_stream_send(self.system, 1, stream, rate, 1)
        # Rates by the vehicle's own clock; the first ones may still be of the time before.
        times = []
        while len(times) < 40:
            x = yield Wait(lambda m: m.get_type() == "ATTITUDE", 10)
            if x is None:
                break
            times.append(x.time_boot_ms)
        gaps = sorted(b - a for a, b in zip(times[10:], times[11:]))
        self.say("attitude_ms", gaps[len(gaps) // 2] if gaps else "silent")

    def ftp(self):
        # OpenFileRO of ArduPilot's parameter file. What does not know FTP says nothing, and parameters go the long way.
        name = b"@PARAM/param.pck"
        payload = bytes([0, 0, 0, 4, len(name), 0, 0, 0, 0, 0, 0, 0]) + name
        for _ in range(10):
            self.mav.file_transfer_protocol_send(0, self.system, 1, list(payload.ljust(251, b"\0")))
            opened = yield Wait(lambda m: m.get_type() == "FILE_TRANSFER_PROTOCOL", 1)
            if opened is not None:
                # TerminateSession, or the next station waits for it.
                close = bytes([1, 0, opened.payload[2], 1, 0, 0, 0, 0, 0, 0, 0, 0])
                self.mav.file_transfer_protocol_send(0, self.system, 1, list(close.ljust(251, b"\0")))
                return self.say("ftp", "answered")
        self.say("ftp", "silent")

    def params(self):
        have, count, asked, lost, lists = {}, None, 0, set(), 1
        self.mav.param_request_list_send(self.system, 1)
        while count is None or len(have) < count:
            p = yield Wait(lambda m: m.get_type() == "PARAM_VALUE", 2)
            if p is None and count is None:
                lists += 1
                self.mav.param_request_list_send(self.system, 1)
            elif p is None:
                gaps = sorted(set(range(count)) - set(have))[:10]
                asked += len(gaps)
                for n in gaps:
                    self.mav.param_request_read_send(self.system, 1, b"", n)
            elif p.param_index < 65535:
                count = p.param_count
                # As a radio would lose it: every seventh, once.
                if p.param_index % 7 == 3 and p.param_index not in lost:
                    lost.add(p.param_index)
                else:
                    have[p.param_index] = p.param_id
        self.say("params", len(have) == count and count > 150)
        # On a busy machine the list may come twice, and the second fills the gaps of the first.
        self.say("gaps", (lists > 1 or asked >= len(lost)) and len(lost) > 20)

    def plan(self, name, kind, rows):
        """Up, as an operator's save would, and down again, as each start does."""
        if self.look:
            return self.say(name, (yield from self.down(kind, None)))
        first = [] if self.px4 or kind else [(16, 0, self.at.lat, self.at.lon, 0.0)]
        rows = first + rows
        uploading = lambda m: m.get_type() in ("MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK") and m.mission_type == kind
        self.mav.mission_count_send(self.system, 1, len(rows), kind)
        tries = 0
        while True:
            x = yield Wait(uploading, 5)
            # No answer, an item that was requested and sent twice (MAV_MISSION_INVALID_SEQUENCE), or an upload that the vehicle gave
            # up (ERROR, OPERATION_CANCELLED), because on a busy machine it repeats its request while the answer is on its way. The
            # upload is repeated when the vehicle has nothing more to say of it.
            if x is None or (x.get_type() == "MISSION_ACK" and x.type in (1, 13, 15)):
                tries += 1
                if tries > 10:
                    return self.say(name, "no answer" if x is None else "refused %d" % x.type)
                while x is not None:
                    x = yield Wait(uploading, 3)
                self.mav.mission_count_send(self.system, 1, len(rows), kind)
            elif x.get_type() == "MISSION_ACK":
                if x.type != 0:
                    return self.say(name, "refused %d" % x.type)
                break
            else:
                command, p1, lat, lon, alt = rows[x.seq]
                self.mav.mission_item_int_send(self.system, 1, x.seq, 3 if kind != 1 else 0, command, 0, 1, p1, 0, 0, 0, lat, lon, alt, kind)
        self.say(name, (yield from self.down(kind, rows)))

    def down(self, kind, rows):
        count, back, tries = None, [], 0
        while count is None or len(back) < count:
            if tries > 5:
                return "no answer"
            if count is None:
                self.mav.mission_request_list_send(self.system, 1, kind)
                x = yield Wait(lambda m: m.get_type() == "MISSION_COUNT" and m.mission_type == kind, 2)
                count = x and x.count
            else:
                self.mav.mission_request_int_send(self.system, 1, len(back), kind)
                x = yield Wait(lambda m: m.get_type() == "MISSION_ITEM_INT" and m.mission_type == kind and m.seq == len(back), 2)
                if x is not None:
                    back.append((x.command, x.x, x.y))
            tries = tries + 1 if x is None else 0
        self.mav.mission_ack_send(self.system, 1, 0, kind)
        if rows is None:
            return "came"
        skip = 1 if kind == 0 and not self.px4 else 0
        return "same" if back[skip:] == [(c, x, y) for c, _p, x, y, _z in rows[skip:]] else "other %s" % back

    def logs(self):
        for _ in range(3):
            self.mav.log_request_list_send(self.system, 1, 0, 0xFFFF)
            entry = yield Wait(lambda m: m.get_type() == "LOG_ENTRY", 2)
            if entry is not None:
                return self.say("logs", entry.num_logs)
        self.say("logs", "silent")


def main(address, systems, source=255, look=False):
    link = mavutil.mavlink_connection(address, source_system=source, source_component=190, dialect="ardupilotmega")
    vehicles, beat_at, strangers, end = {}, 0, 0, time.time() + 500
    print("listening", flush=True)
    while time.time() < end:
        if time.time() - beat_at >= 1:
            link.mav.heartbeat_send(6, 8, 192, 0, 4)
            beat_at = time.time()
        m = link.recv_match(blocking=True, timeout=0.05)
        for vehicle in vehicles.values():
            vehicle.tick()
        if m is None or m.get_srcComponent() != 1:
            pass
        elif m.get_srcSystem() in vehicles:
            # Another station's answers are for it alone.
            if m.get_type() == "COMMAND_ACK" and m.target_system not in (0, source):
                strangers += 1
            vehicles[m.get_srcSystem()].hear(m)
        elif m.get_type() == "HEARTBEAT" and m.get_srcSystem() in systems:
            vehicles[m.get_srcSystem()] = Vehicle(link, m.get_srcSystem(), m, source, look)
        if len(vehicles) == len(systems) and all(v.done for v in vehicles.values()):
            print("strangers", strangers)
            return
    raise SystemExit("not at an end: %s" % {s: v.found for s, v in vehicles.items()})


if __name__ == "__main__":
    main(sys.argv[1], [int(s) for s in sys.argv[2].split(",")], *map(int, sys.argv[3:4]), look=sys.argv[4:] == ["look"])
