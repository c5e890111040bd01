"""Trials: what an experiment varies, listed, crossed, repeated, shuffled or read from a file.

A factor is the experiment's own (`speed_m_s`, `location`) or, with a dotted name, overrides the profile for that
trial (`plant.noise_scale`, `detectors.contact.sample_hz`).
"""

from __future__ import annotations

import csv
import itertools
import math
import random
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, Field, model_validator

from config.source import ProfileError, flatten
from drivers.core.settings import Settings

Factor = str | bool | int | float


def _plain(value: Any) -> Any:
    if not isinstance(value, Factor):
        raise ValueError("must be a number, text, true or false")
    return value


TRIALS_MAX = 100_000
"""Most trials of one run. Assumption: a trial of a second each would take more than a day."""

PlainValue = Annotated[Any, AfterValidator(_plain)]


class TrialsSettings(Settings):
    """Which trials a profile asks for: every row of the list with every combination of the grid."""

    order: Literal["listed", "shuffled"] = "listed"
    """`shuffled` runs them in an order that the seed decides; numbers and results stay as listed."""

    repeats: int = Field(default=1, ge=1, le=10_000)
    """How often each combination is run."""

    list: tuple[dict[str, PlainValue], ...] = ({},)
    """Rows of factors."""

    grid: dict[str, tuple[PlainValue, ...]] = Field(default_factory=dict)
    """Values of factors that are crossed with each other and with every row; the last one varies fastest."""

    @model_validator(mode="after")
    def _countable(self) -> Self:
        count = self.repeats * len(self.list) * math.prod(len(values) for values in self.grid.values())
        if count > TRIALS_MAX:
            crossed = " x ".join(str(len(values)) for values in self.grid.values()) or "no grid"
            raise ValueError(
                f"{count} trials (list of {len(self.list)}, grid of {crossed}, {self.repeats} repeats):"
                f" a run has {TRIALS_MAX} at the most; vary less, or divide it into several profiles"
            )
        return self


@dataclass(frozen=True, slots=True)
class Trial:
    """One run of the experiment.

    Attributes:
        id: Number in the listed order, from 1: the key of the trial's noise and of its row in the results.
        factors: Flat, with dotted names where they override the profile.
        repeat: Which repetition of these factors this is, from 1.
    """

    id: int
    factors: Mapping[str, Any] = field(default_factory=dict)
    repeat: int = 1

    @property
    def own(self) -> dict[str, Any]:
        """The experiment's own factors."""
        return {name: value for name, value in self.factors.items() if "." not in name}

    @property
    def overrides(self) -> dict[str, Any]:
        """The factors that override the profile, dotted."""
        return {name: value for name, value in self.factors.items() if "." in name}


def trials_from(rows: Iterable[Mapping[str, Any]], repeats: int = 1) -> list[Trial]:
    """Trials from rows of factors, in their order.

    Args:
        rows: Nested or dotted factors, one mapping for each combination.
        repeats: How often each is run, one after the other.

    Example:
        >>> [trial.id for trial in trials_from([{"speed_m_s": 0.002}, {"speed_m_s": 0.004}], repeats=2)]
        [1, 2, 3, 4]
    """
    factors = [dict(flatten(row)) for row in rows]
    repeated = ((row, repeat) for row in factors for repeat in range(1, repeats + 1))
    return [Trial(number, row, repeat) for number, (row, repeat) in enumerate(repeated, start=1)]


def combinations(settings: TrialsSettings) -> list[dict[str, Any]]:
    """Every row of the list with every combination of the grid."""
    crossed = [
        dict(zip(settings.grid, values, strict=True)) for values in itertools.product(*settings.grid.values())
    ]
    return [{**row, **cell} for row in settings.list for cell in crossed]


def in_order(trials: Sequence[Trial], order: str, seed: int) -> list[Trial]:
    """The trials as they are to be run; their numbers stay."""
    ordered = list(trials)
    if order == "shuffled":
        random.Random(seed).shuffle(ordered)
    return ordered


def only(trials: Sequence[Trial], numbers: Sequence[int]) -> list[Trial]:
    """The trials with these numbers.

    Raises:
        ProfileError: there is no such trial.
    """
    known = {trial.id for trial in trials}
    for number in numbers:
        if number not in known:
            raise ProfileError(
                f"--only {number}: no such trial; the profile has 1 to {max(known, default=0)}"
            )
    return [trial for trial in trials if trial.id in numbers]


def chosen(trials: Sequence[Trial], numbers: Sequence[int], shard: Sequence[int] | None) -> list[Trial]:
    """The trials with these numbers, all where there are none; and of them every n-th from the i-th on.

    Raises:
        ProfileError: there is no such trial.
    """
    found = only(trials, numbers) if numbers else list(trials)
    return found[shard[0] - 1 :: shard[1]] if shard else found


def distinct(trials: Sequence[Trial]) -> list[Trial]:
    """The first trial of each combination of factors: repetitions left out."""
    return [same[0] for same in alike(trials)]


def alike(trials: Sequence[Trial]) -> list[list[Trial]]:
    """Trials by their combination of factors: each with its repetitions."""
    found: dict[str, list[Trial]] = {}
    for trial in trials:
        found.setdefault(repr(sorted(trial.factors.items())), []).append(trial)
    return list(found.values())


def read_csv(path: str | Path) -> tuple[list[dict[str, Factor]], list[str]]:
    """Rows of factors from a CSV file whose header names them.

    A cell that reads as a number is one; `true` and `false` are truth values, anything else is text.

    Returns:
        The rows, and for each where it stands, for errors.

    Raises:
        ProfileError: no such file, no header, a column without a name or twice, a row that is longer or
            shorter than the header, an empty cell, NaN or infinity: one line with file, row (the header is
            row 1) and column.
    """
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            lines = csv.reader(file, strict=True, skipinitialspace=True)
            header = [name.strip() for name in next(lines, [])]
            _check_header(path, header)
            rows, labels = [], []
            for cells in lines:
                label = f"{path}: row {lines.line_num}"
                if cells:
                    rows.append(_row(label, header, cells))
                    labels.append(label)
    except UnicodeDecodeError as error:
        raise ProfileError(f"{path}: byte {error.start}: no UTF-8 text; save it as CSV (UTF-8)") from None
    except csv.Error as error:
        raise ProfileError(f"{path}: row {lines.line_num}: no CSV: {error}") from None
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror}") from None
    if not rows:
        raise ProfileError(f"{path}: no trials; each row under the header is one")
    return rows, labels


def _check_header(path: str | Path, header: Sequence[str]) -> None:
    if not header:
        raise ProfileError(f"{path}: empty; the first row names the factors, for example: location,speed_m_s")
    for place, name in enumerate(header, start=1):
        if not all(name.split(".")):
            raise ProfileError(f"{path}: row 1, column {place}: '{name}' is no name of a factor")
        if ";" in name or "\t" in name:
            raise ProfileError(
                f"{path}: row 1: {name!r}: write commas between the columns, and decimal points"
            )
        if header.index(name) != place - 1:
            raise ProfileError(f"{path}: row 1, column {place}: '{name}' is there twice")


def _row(label: str, header: Sequence[str], cells: Sequence[str]) -> dict[str, Factor]:
    if len(cells) != len(header):
        raise ProfileError(f"{label}: {len(cells)} cells, but the header names {len(header)} factors")
    return {name: _cell(f"{label}, column {name}", cell) for name, cell in zip(header, cells, strict=True)}


def _cell(label: str, text: str) -> Factor:
    cell = text.strip()
    if not cell:
        raise ProfileError(f"{label}: empty; every trial needs a value")
    if cell in ("true", "false"):
        return cell == "true"
    try:
        number = float(cell)
    except ValueError:
        return cell
    if not math.isfinite(number):
        raise ProfileError(f"{label} = {cell}: must be finite")
    return int(cell) if cell.lstrip("+-").isdecimal() and cell.isascii() else number
