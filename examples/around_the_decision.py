"""Every trial's signal laid over one another, time zero at what really happened: what does a detector have to see?

    PYTHONPATH=. .venv/bin/python examples/around_the_decision.py [RUN [STREAM]]     # latest board.load_cell

Writes around_the_decision.png. Needs a simulated run, whose trials have the true time of contact.
"""

import sys

import matplotlib.pyplot as plt

from touchbench import open_run

name, stream = [*sys.argv[1:], *["latest", "board.load_cell"][len(sys.argv) - 1 :]]
run = open_run(name)
figure, axes = plt.subplots(figsize=(7, 3.5), layout="constrained")
for _, trial in run.table.dropna(subset=["truth_contact_s", "detect_s"]).iterrows():
    signal = run.signal(int(trial["trial"]), stream)
    contact_s, detect_s = trial["truth_contact_s"], trial["detect_s"]
    near = signal.between(contact_s - 0.1, contact_s + 0.3).to_pandas()
    colour = "#0072b2" if run.succeeded(trial) else "#d55e00"
    axes.plot(1e3 * (near.index - contact_s), near.iloc[:, 0], color=colour, alpha=0.4, linewidth=0.8)
    axes.axvline(1e3 * (detect_s - contact_s), color=colour, alpha=0.4, linewidth=0.8, ymax=0.06)
axes.axvline(0.0, color="k", linewidth=1)
axes.set(
    xlabel="time after the true contact, ms (ticks at the bottom: decisions)",
    ylabel=f"{stream}, {signal.unit}",
)
axes.set_title(f"{run.manifest['profile']['name']}, {run.manifest['bench']} bench", fontsize=10)
figure.savefig("around_the_decision.png", dpi=150)
