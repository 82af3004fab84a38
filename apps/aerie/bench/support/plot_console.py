"""Plots what viewers of the fleet's page cost a gateway, from what `bin/bench console --out console.json` has written:

    python3 -m venv plot && plot/bin/pip install matplotlib
    plot/bin/python apps/aerie/bench/support/plot_console.py console.json docs/img/console.png
"""

import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plot

rows = [row for row in json.load(open(sys.argv[1])) if row["viewers"] > 0]
figure, (cpu, delay) = plot.subplots(1, 2, figsize=(8, 3.2), layout="constrained")

for viewers in sorted({row["viewers"] for row in rows}):
    some = [row for row in rows if row["viewers"] == viewers]
    label = f"{viewers} viewer{'s' if viewers > 1 else ''}"
    cpu.plot([row["vehicles"] for row in some], [row["cpu"] for row in some], "o-", label=label)
    delay.plot([row["vehicles"] for row in some], [row["mode_p99_ms"] for row in some], "o-", label=label)

cpu.set(title="CPU, % of one core", ylim=0)
delay.set(title="A change of mode at the viewer, p99 ms", ylim=0)
for axes in (cpu, delay):
    axes.set_xlabel("vehicles, five changes a second each")
    axes.grid(alpha=0.3)
    axes.legend()
figure.savefig(sys.argv[2], dpi=110)
