"""Plots how the cost of a gateway grows with its vehicles, from what `bin/bench fleet --out fleet.json` has written:

    python3 -m venv plot && plot/bin/pip install matplotlib
    plot/bin/python apps/aerie/bench/support/plot_fleet.py fleet.json docs/img/fleet.png
"""

import json
import sys

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plot

rows = json.load(open(sys.argv[1]))
vehicles = rows["vehicles"]
count = [row["vehicles"] for row in vehicles]
figure, (cpu, memory, delay) = plot.subplots(1, 3, figsize=(11, 3.2), layout="constrained")

cpu.plot(count, [row["cpu"] for row in vehicles], "o-", label="gateway")
cpu.plot(count, [row["cpu_nats"] for row in vehicles], "s-", label="nats-server")
cpu.set(title="CPU, % of one core", ylim=0)
cpu.legend()

memory.plot(count, [row["kb"] for row in vehicles], "o-")
memory.axhline(400, color="grey", ls=":")
memory.set(title="Memory, kB per vehicle", ylim=0)

for key, aim, colour in [("store", 5, "C0"), ("nats", 10, "C1")]:
    delay.plot(count, [row[key][1] for row in vehicles], "o-", color=colour, label=f"frame to {key}, p99")
    delay.axhline(aim, color=colour, ls=":")
delay.set(title="Delay, ms", yscale="log")
delay.legend()

for axes in (cpu, memory, delay):
    axes.set_xlabel("vehicles, 50 frames/s each")
    axes.grid(alpha=0.3)
figure.savefig(sys.argv[2], dpi=110)
