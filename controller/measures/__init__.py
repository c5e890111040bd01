"""From a trial's recording to its row in trials.csv: one module per experiment.

`COLUMNS` of each declares its columns once: a name, which ends in the SI unit of its values, and what they are; that of
an instant of the trial begins with `when`. Empty cells are what did not occur, or is not known.
"""

from collections.abc import Mapping
from importlib import import_module

from controller.registry import EXPERIMENTS


def columns_of(experiment: object) -> Mapping[str, str]:
    """What a shipped experiment declares of its columns, by name; nothing of another."""
    kind = EXPERIMENTS.get(str(experiment))
    columns: Mapping[str, str] = import_module(kind.measures).COLUMNS if kind else {}
    return columns
