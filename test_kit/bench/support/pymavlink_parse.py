"""Times pymavlink on the bytes of a file: framing, CRC and decoding, which it does in one.

Usage: pymavlink_parse.py FILE ROUNDS FOUND. Prints best, median and 99th percentile of the ns per frame, and writes the frames
that it found to FOUND.
"""

import sys
import time

from pymavlink.dialects.v20 import all as dialect

data = open(sys.argv[1], "rb").read()
times = []
for _ in range(int(sys.argv[2])):
    parser = dialect.MAVLink(None)
    parser.robust_parsing = True
    found = []
    start = time.perf_counter_ns()
    for at in range(0, len(data), 1400):
        found.extend(parser.parse_buffer(data[at : at + 1400]) or [])
    times.append(time.perf_counter_ns() - start)
frames = [m for m in found if m.get_type() != "BAD_DATA"]
times.sort()
count = max(len(frames), 1)
print(times[0] / count, times[len(times) // 2] / count, times[min(len(times) - 1, len(times) * 99 // 100)] / count)
open(sys.argv[3], "wb").write(b"".join(bytes(m.get_msgbuf()) for m in frames))
