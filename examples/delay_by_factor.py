"""One dot a trial: a measured column against a factor, successes and others in two colours.

    PYTHONPATH=. .venv/bin/python examples/delay_by_factor.py [RUN [COLUMN [FACTOR]]]     # latest delay_s speed_m_s

Writes COLUMN_by_FACTOR.png. Needs a run that has both columns, as `run.py run mock/transient` leaves.
"""

import sys

import matplotlib.pyplot as plt

from touchbench import open_run

name, column, factor = [*sys.argv[1:], *["latest", "delay_s", "speed_m_s"][len(sys.argv) - 1 :]]
run = open_run(name)
if missing := [each for each in (column, factor) if each not in run.table or run.table[each].isna().all()]:
    sys.exit(
        f"{name}: no trial has a {missing[0]}; its columns: {', '.join(run.table.dropna(axis='columns', how='all'))}"
    )
table = run.table.dropna(subset=[column])
units = table.attrs["units"]

figure, axes = plt.subplots(figsize=(6, 3.5), layout="constrained")
good = table.apply(run.succeeded, axis=1)
for chosen, label, colour in ((good, "success", "#0072b2"), (~good, "no success", "#d55e00")):
    axes.plot(table[factor][chosen], table[column][chosen], "o", alpha=0.6, color=colour, label=label)
middle = table[good].groupby(factor)[column].median()
axes.plot(middle.index, middle, "k_", markersize=16, label="median of the successes")
axes.set(xlabel=f"{factor}, {units.get(factor, '')}", ylabel=f"{column}, {units.get(column, '')}")
axes.set_title(
    f"{run.manifest['profile']['name']}, {run.manifest['bench']} bench, n = {len(table)}", fontsize=10
)
axes.legend(fontsize=8)
figure.savefig(f"{column}_by_{factor}.png", dpi=150)
print(middle.to_string())
