"""pymavlink uploads missions again and again: pymavlink_uploads.py CONNECTION SYSTEM ITEMS ROUNDS SOURCE

Repeats an unanswered MISSION_COUNT every 1.5 s, as ground stations do, and of all uploads one of which nothing more was heard
for 20 s, as their operators do. Prints "results" with the result of each upload (0: accepted, None: no answer).
"""
import sys

from pymavlink_gcs import Gcs, say


def upload(g, items):
    for _ in range(30):
        g.m.mav.mission_count_send(g.system, 1, len(items), 0)
        answer = g.wait(["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], for_us(g), timeout=1.5, wanted=False)
        if answer is not None:
            break
    while answer is not None and answer.get_type() != "MISSION_ACK":
        g.m.mav.send(items[answer.seq])
        answer = g.wait(["MISSION_REQUEST", "MISSION_REQUEST_INT", "MISSION_ACK"], for_us(g), timeout=20, wanted=False)
    return None if answer is None else answer.type


def for_us(g):
    return lambda m: m.target_system in (0, g.m.mav.srcSystem)


def main(address, system, count, rounds, source):
    g = Gcs(address, system, source)
    items = [g.item(0, 22, 473977420, 85455940, 12)]
    items += [g.item(n, 16, 473977420 + n, 85455940, 12) for n in range(1, count)]
    results = [upload(g, items) for _ in range(rounds)]
    if None in results:
        results[results.index(None)] = upload(g, items)
    say("results", results)


if __name__ == "__main__":
    main(sys.argv[1], *map(int, sys.argv[2:]))
