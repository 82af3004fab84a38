"""MAVProxy as a ground station: mavproxy_gcs.py MASTER FIRMWARE SYSTEM PARAMETER [SOURCE]

With SIGNING_PASSPHRASE in the environment it signs with that passphrase, and finally sends the vehicle another key.

Types an operator's commands, reads MAVProxy's output, and prints one line per finding ("name value"); exits 0 after a complete
flight.
"""
import os
import re
import subprocess
import sys
import tempfile
import threading
import time

MODULES = "cmdlong,param,mode,arm,wp,rc,link,misc,signing,battery"


class Proxy:
    def __init__(self, master, source, folder):
        program = os.path.join(os.path.dirname(sys.executable), "mavproxy.py")
        self.output, self.at = "", 0
        self.process = subprocess.Popen(
            [sys.executable, "-u", program, "--master=%s" % master, "--source-system=%d" % source, "--state-basedir=%s" % folder,
             "--default-modules=%s" % MODULES, "--nowait", "--streamrate=4", "--force-connected"],
            stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, cwd=folder, text=True, bufsize=0,
            env=dict(os.environ, HOME=folder, TERM="dumb"))
        threading.Thread(target=self.read, daemon=True).start()

    def read(self):
        while True:
            got = os.read(self.process.stdout.fileno(), 4096).decode(errors="replace")
            if not got:
                return
            self.output += got

    def type(self, line, again=False):
        if not again:
            self.at = len(self.output)
        self.process.stdin.write(line + "\n")

    def saw(self, pattern, seconds):
        end = time.time() + seconds
        while True:
            late = time.time() >= end or self.process.poll() is not None
            # What came while we slept counts, too.
            found = re.search(pattern, self.output[self.at :])
            if found or late:
                return found
            time.sleep(0.05)

    def see(self, pattern, seconds=300):
        found = self.saw(pattern, seconds)
        if not found:
            raise SystemExit("never saw %s; MAVProxy said:\n%s" % (pattern, self.output[-4000:]))
        return found

    def until(self, line, pattern, tries=300, each=1.0):
        """Types a line until the answer has come. A change is printed once, maybe between two tries, so all output since the
        first try is searched."""
        for n in range(tries):
            self.type(line, again=n > 0)
            found = self.saw(pattern, each)
            if found:
                return found
        raise SystemExit("%s: never saw %s; MAVProxy said:\n%s" % (line, pattern, self.output[-4000:]))

    def end(self):
        self.process.kill()
        self.process.wait()


def say(name, value):
    print("%s %s" % (name, value), flush=True)


def main(master, firmware, system, parameter, source=255):
    with tempfile.TemporaryDirectory() as folder:
        proxy = Proxy(master, source, folder)
        try:
            flight(proxy, firmware, system, parameter, folder)
        finally:
            proxy.end()


def flight(p, firmware, system, parameter, folder):
    passphrase = os.environ.get("SIGNING_PASSPHRASE")
    if passphrase:
        p.type("signing key %s" % passphrase)
    p.see(r"(?i)received (\d+) parameters|Detected vehicle %d:1" % system)
    p.type("vehicle %d" % system)
    say("system", system)
    lat = float(p.until("status GLOBAL_POSITION_INT", r"lat : (-?\d+)").group(1)) / 1e7
    lon = float(p.until("status GLOBAL_POSITION_INT", r"lon : (-?\d+)").group(1)) / 1e7
    say("lat", "%.4f" % lat)
    say("battery", int(p.until("status SYS_STATUS", r"voltage_battery : (\d+)").group(1)) > 5000)

    count = p.until("param status", r"Have ([1-9]\d*)/\1 params").group(1)
    say("params", count)
    value = float(p.until("param show %s" % parameter, parameter + r"\s+(-?\d[\d.]*)").group(1))
    p.type("param set %s %f" % (parameter, value + 1.5))
    p.until("param fetch %s" % parameter, r"%s = %s" % (parameter, re.escape("%.6f" % (value + 1.5))))
    say("set", True)

    # Not before: with it MAVProxy asks for the parameters by FTP once, which a vehicle with a key does not hear yet.
    p.type("module load ftp")
    # Its first question is an operation that not every vehicle knows; after UnknownCommand it asks the older one.
    say("files", p.until("ftp list /", r"Total size ([\d.]+) kByte", 20, 5.0).group(1))

    rows = [(16, 0, lat, lon, 0.0), (22, 3, lat, lon, 12.0), (16, 3, lat + 0.0003, lon, 15.0), (21, 3, lat, lon, 0.0)]
    up, down = os.path.join(folder, "up.txt"), os.path.join(folder, "down.txt")
    with open(up, "w") as f:
        f.write("QGC WPL 110\n")
        for n, (command, frame, x, y, z) in enumerate(rows):
            f.write("%d\t%d\t%d\t%d\t0\t0\t0\t0\t%.8f\t%.8f\t%.6f\t1\n" % (n, n == 0, frame, command, x, y, z))
    # On a busy machine the vehicle repeats its questions, MAVProxy answers each, and the vehicle gives up (C2).
    for _ in range(10):
        p.type("wp load %s" % up)
        if not p.see(r"Got MISSION_ACK: TYPE_MISSION: (ACCEPTED|ERROR|OPERATION_CANCELLED)|Sent all \d+ waypoints").group(1) in ("ERROR", "OPERATION_CANCELLED"):
            break
    # A vehicle that still waits for the last item's acknowledgement refuses the list, and MAVProxy asks once.
    p.until("wp save %s" % down, r"Saved \d+ waypoints", 30, 10.0)
    with open(down) as f:
        back = [line.split("\t") for line in f.read().splitlines()[1:]]
    say("mission", [int(row[3]) for row in back])
    say("same", all(abs(float(a[8]) - b[2]) < 2e-7 and abs(float(a[10]) - b[4]) < 0.01 for a, b in list(zip(back, rows))[1:]))

    # MAVProxy's own mode command does not work with PX4 (its modes are tuples there): commands do.
    if firmware == "ardupilot":
        p.until("mode GUIDED", r"Mode GUIDED", 20)
    p.until("arm throttle", r"ARMED|COMPONENT_ARM_DISARM: ACCEPTED", 60, 2.0)
    say("arm", "armed")
    p.until("takeoff 10", r"NAV_TAKEOFF: ACCEPTED", 20, 2.0)
    high = 8500 if firmware == "ardupilot" else 1800
    for _ in range(120):
        found = p.until("status GLOBAL_POSITION_INT", r"relative_alt : (-?\d+)")
        if int(found.group(1)) > high:
            break
        time.sleep(0.3)
    else:
        raise SystemExit("it did not climb:\n%s" % p.output[-2000:])
    say("takeoff", "climbed")
    p.until("mode LAND" if firmware == "ardupilot" else "long NAV_LAND 0 0 0 0 0 0 0", r"Mode LAND|NAV_LAND: ACCEPTED", 20, 2.0)
    for _ in range(200):
        found = p.until("status HEARTBEAT", r"base_mode : (\d+)")
        if not int(found.group(1)) & 128:
            break
        time.sleep(0.3)
    else:
        raise SystemExit("it is still armed:\n%s" % p.output[-2000:])
    say("land", "disarmed")
    if passphrase:
        p.type("signing setup another")
        p.see("Sent secret_key")


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4], *map(int, sys.argv[5:]))
