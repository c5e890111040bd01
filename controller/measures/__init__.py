"""From a trial's recording to its row in trials.csv: one module per experiment."""

from collections.abc import Mapping
from importlib import import_module
from typing import TYPE_CHECKING, NamedTuple

from controller.registry import EXPERIMENTS

if TYPE_CHECKING:
    from controller.recording.reader import Run


class Column(NamedTuple):
    """A column of trials.csv, declared once under its name, which ends in the SI unit of its values.

    Attributes:
        meaning: What its values are; that of an instant of the trial begins with `when`. Empty cells are what did not
            occur, or is not known.
        digits: Decimals that a section prints, in the unit that is shown; None prints four significant digits.
    """

    meaning: str
    digits: int | None = None


def meanings_of(run: "Run") -> dict[str, str]:
    """What a run's experiment declares of its columns, by name."""
    return {name: each.meaning for name, each in columns_of(str(run.manifest.get("experiment"))).items()}


def columns_of(experiment: str) -> Mapping[str, Column]:
    """What a shipped experiment declares of its columns; nothing of another."""
    kind = EXPERIMENTS.get(experiment)
    columns: Mapping[str, Column] = import_module(kind.measures).COLUMNS if kind else {}
    return columns
