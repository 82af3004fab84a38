"""Times YAMSPy on the replies in a file, from memory: framing, checksum and decoding.

Usage: yamspy_parse.py FILE ROUNDS. Prints best, median and 99th percentile of the ns per frame.
"""

import io
import sys
import time

from yamspy import MSPy

data = open(sys.argv[1], "rb").read()


def run():
    board = MSPy(device="none", loglevel="ERROR", logfilename=None)
    # Where it would read from the serial port.
    source = io.BytesIO(data)

    def read(size=1):
        # Where there is no more it would turn for ever.
        found = source.read(size)
        if len(found) < size:
            raise EOFError
        return found

    board.conn.read = read
    frames = 0
    start = time.perf_counter_ns()
    while True:
        try:
            handler = board.receive_msg()
        except EOFError:
            break
        if not handler["packet_error"]:
            frames += 1
            try:
                board.process_recv_data(handler)
            except Exception:
                pass  # layouts of newer firmware than it knows
    return (time.perf_counter_ns() - start) / max(frames, 1)


times = sorted(run() for _ in range(int(sys.argv[2])))
print(times[0], times[len(times) // 2], times[min(len(times) - 1, len(times) * 99 // 100)])
