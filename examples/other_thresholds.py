"""What other thresholds would have done, from the recorded statistic alone: false alarms against delay.

    PYTHONPATH=. .venv/bin/python examples/other_thresholds.py [RUN [DETECTOR]]     # latest contact

Writes other_thresholds.png. A threshold is taken as a multiple of the recorded one's distance from the statistic's
median before the contact. Needs a simulated run, whose trials have the true time of contact. The statistic ends where
the trial was stopped: a lower threshold can be judged, a higher one only where the trial went on.
"""

import sys

import matplotlib.pyplot as plt
import numpy as np

from touchbench import open_run

name, detector = [*sys.argv[1:], *["latest", "contact"][len(sys.argv) - 1 :]]
run = open_run(name)
shares = np.linspace(0.2, 1.0, 33)
false, delays_ms = np.zeros(len(shares)), [[] for _ in shares]
trials = run.table.dropna(subset=["truth_contact_s"])
for _, trial in trials.iterrows():
    reading = run.signal(int(trial["trial"]), f"detector.{detector}").to_pandas().dropna()
    before = reading.index < trial["truth_contact_s"]
    if not before.any():
        continue
    middle = reading["statistic"][before].median()
    height = (reading["statistic"] - middle) / (reading["threshold"] - middle)
    for place, share in enumerate(shares):
        crossed = height.index[height >= share]
        if len(crossed) and crossed[0] < trial["truth_contact_s"]:
            false[place] += 1
        elif len(crossed):
            delays_ms[place].append(1e3 * (crossed[0] - trial["truth_contact_s"]))

figure, (upper, lower) = plt.subplots(2, sharex=True, figsize=(6, 4.5), layout="constrained")
upper.step(shares, 100.0 * false / len(trials), where="mid", color="#d55e00")
upper.set(ylabel="false alarms, %", ylim=(0, None))
medians = [np.median(found) if found else np.nan for found in delays_ms]
lower.plot(shares, medians, color="#0072b2")
lower.set(ylabel="median delay, ms", xlabel="threshold, relative to the one of the run")
upper.set_title(
    f"{detector} of {run.manifest['profile']['name']}, {run.manifest['bench']} bench, n = {len(trials)}",
    fontsize=10,
)
figure.savefig("other_thresholds.png", dpi=150)
