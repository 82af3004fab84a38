"""Plots what `bin/bench fleet --out FILE` or `bin/bench console --out FILE` has written: how the cost grows with the vehicles.

    python3 -m venv plot && plot/bin/pip install matplotlib
    plot/bin/python test_kit/bench/support/plot.py fleet.json docs/img/fleet.png
"""

import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plot

rows = json.load(open(sys.argv[1]))


def lines(axes, some, key, **style):
    axes.plot([row["vehicles"] for row in some], [row[key] for row in some], "o-", **style)


def console(rows):
    figure, (cpu, delay) = plot.subplots(1, 2, figsize=(8, 3.2), layout="constrained")
    for viewers in sorted({row["viewers"] for row in rows if row["viewers"] > 0}):
        some = [row for row in rows if row["viewers"] == viewers]
        label = f"{viewers} viewer{'s' if viewers > 1 else ''}"
        lines(cpu, some, "cpu", label=label)
        lines(delay, some, "mode_p99_ms", label=label)
    cpu.set(title="CPU, % of one core", ylim=0)
    delay.set(title="A change of mode at the viewer, p99 ms", ylim=0)
    return figure, "vehicles, five changes a second each"


def fleet(rows):
    figure, (cpu, memory, delay) = plot.subplots(1, 3, figsize=(11, 3.2), layout="constrained")
    lines(cpu, rows, "cpu", label="gateway")
    lines(cpu, rows, "cpu_nats", label="nats-server")
    cpu.set(title="CPU, % of one core", ylim=0)
    lines(memory, rows, "kb", label="without the recorder's ring")
    memory.axhline(400, color="grey", ls=":")
    memory.set(title="Memory, kB per vehicle", ylim=0)
    for key, aim, colour in [("store", 5, "C0"), ("nats", 10, "C1")]:
        p99 = [{"vehicles": row["vehicles"], "p99": row[key][1]} for row in rows]
        lines(delay, p99, "p99", color=colour, label=f"frame to {key}, p99")
        delay.axhline(aim, color=colour, ls=":")
    delay.set(title="Delay, ms", yscale="log")
    return figure, "vehicles, 50 frames/s each"


figure, label = console(rows) if isinstance(rows, list) else fleet(rows["vehicles"])
for axes in figure.axes:
    axes.set_xlabel(label)
    axes.grid(alpha=0.3)
    axes.legend()
figure.savefig(sys.argv[2], dpi=110)
