"""Reads the gateway's state.sock as a user's script does: state_reader.py PATH TEXTS

Prints the vehicles, their modes, and the rate of each one's lines, from the times in them.
"""
import json
import socket
import sys

sock = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
sock.connect(sys.argv[1])
times, modes = {}, set()
for line in sock.makefile():
    state = json.loads(line)
    if state["vehicle"] is None:  # none is there yet
        continue
    times.setdefault(state["vehicle"], []).append(state["timestamp"])
    modes.add(str(state["mode"]))
    if all(len(t) > int(sys.argv[2]) for t in times.values()):
        break
print("vehicles", " ".join(sorted(times)))
print("modes", " ".join(sorted(modes)))
for t in list(times.values())[:1]:
    print("hz %.2f" % ((len(t) - 1) / (t[-1] - t[0])))
