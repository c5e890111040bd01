"""Trials: what an experiment varies, listed, crossed, repeated, shuffled or read from a file.

A factor is the experiment's own (`speed_m_s`, `location`) or, with a dotted name, overrides the profile for that
trial (`plant.noise_scale`, `detectors.contact.sample_hz`).
"""

import csv
import itertools
import math
import random
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from config.source import ProfileError, flatten
from drivers.core.settings import Settings

Factor = str | bool | int | float


def _plain(value: Any) -> Any:
    if not isinstance(value, Factor) or (isinstance(value, float) and not math.isfinite(value)):
        raise ValueError("must be a finite number, text, true or false")
    return value


def _dotted(table: Any) -> Any:
    return dict(flatten(table)) if isinstance(table, Mapping) else table


TRIALS_MAX = 100_000
"""Most trials of one run. Assumption: a trial of a second each would take more than a day."""

PlainValue = Annotated[Any, AfterValidator(_plain)]
Factors = Annotated[dict[str, PlainValue], BeforeValidator(_dotted)]
"""Flat, with dotted names; nested tables are taken as well."""


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


class TrialsSettings(Settings):
    """Which trials a profile asks for: every row of the list with every combination of the grid."""

    order: Literal["listed", "shuffled"] = "listed"
    """`shuffled` runs them in an order that the seed decides; numbers and results stay as listed."""

    repeats: int = Field(default=1, ge=1, le=10_000)
    """How often each combination is run."""

    reconnects: int = Field(default=0, ge=0, le=1000)
    """How many trials may be repeated after a device failed, where every mover was seen standing still: all devices are
    opened and identified anew, and the trial begins again, from home and with a new baseline."""

    list: Sequence[Factors] = Field(default_factory=lambda: [{}])
    """Rows of factors."""

    grid: Annotated[dict[str, Sequence[PlainValue]], BeforeValidator(_dotted)] = Field(default_factory=dict)
    """Values of factors that are crossed with each other and with every row; the last one varies fastest."""

    @model_validator(mode="after")
    def _countable(self) -> Self:
        count = self.repeats * len(self.list) * math.prod(len(values) for values in self.grid.values())
        if not 0 < count <= TRIALS_MAX:
            crossed = " x ".join(str(len(values)) for values in self.grid.values()) or "no grid"
            raise ValueError(
                f"{count} trials (list of {len(self.list)}, grid of {crossed}, {self.repeats} repeats):"
                f" a run has 1 to {TRIALS_MAX}; add a row or value, vary less, or divide it into several profiles"
            )
        twice = [name for name in self.grid if any(name in row for row in self.list)]
        if twice:
            raise ValueError(f"{', '.join(twice)}: a factor is either in the list or in the grid")
        return self

    def trials(self, seed: int | None = None) -> Sequence[Trial]:
        """All of them, in the order in which they are run; as they are listed without a seed."""
        cells = [
            dict(zip(self.grid, values, strict=True)) for values in itertools.product(*self.grid.values())
        ]
        rows = [{**row, **cell} for row in self.list for cell in cells]
        repeated = itertools.product(rows, range(1, self.repeats + 1))
        trials = [Trial(number, row, repeat) for number, (row, repeat) in enumerate(repeated, start=1)]
        if self.order == "shuffled" and seed is not None:
            random.Random(seed).shuffle(trials)
        return trials


def chosen(
    trials: Sequence[Trial], numbers: Sequence[int], shard: Sequence[int] | None = None
) -> list[Trial]:
    """The trials with these numbers, all where there are none; and of them every n-th from the i-th on.

    Raises:
        ProfileError: there is no such trial.
    """
    known = {trial.id for trial in trials}
    for number in numbers:
        if number not in known:
            raise ProfileError(
                f"--only {number}: no such trial; the profile has 1 to {max(known, default=0)}"
            )
    found = [trial for trial in trials if not numbers or trial.id in numbers]
    return found[shard[0] - 1 :: shard[1]] if shard else found


def distinct(trials: Sequence[Trial]) -> list[Trial]:
    """The first trial of each combination of factors: repetitions left out."""
    return [same[0] for same in alike(trials)]


def of_each_value(trials: Sequence[Trial]) -> list[Trial]:
    """As few trials as show each value of each factor, the first that have it: not every combination."""
    seen: set[tuple[str, Any]] = set()
    found = []
    for trial in trials:
        values = {("", None), *trial.factors.items()}
        if not values <= seen:
            found.append(trial)
            seen |= values
    return found


def alike(trials: Sequence[Trial]) -> list[list[Trial]]:
    """Trials by their combination of factors: each with its repetitions."""
    found: dict[str, list[Trial]] = {}
    for trial in trials:
        found.setdefault(repr(sorted(trial.factors.items())), []).append(trial)
    return list(found.values())


def read_csv(path: str | Path) -> dict[str, dict[str, Factor]]:
    """Rows of factors from a CSV file whose header names them.

    A cell that reads as a number is one; `true` and `false` are truth values, anything else is text.

    Returns:
        The rows by where they stand, for errors.

    Raises:
        ProfileError: no such file, no header, a column without a name or twice, a row that is longer or
            shorter than the header, an empty cell: one line with file, row (the header is row 1) and column.
    """
    rows = {}
    try:
        with Path(path).open(encoding="utf-8-sig", newline="") as file:
            table = csv.DictReader(file, strict=True, skipinitialspace=True, restval="")
            _check_header(path, table.fieldnames or [])
            for cells in table:
                place = f"{path}: row {table.line_num}"
                rows[place] = _row(place, cells)
    except (csv.Error, UnicodeDecodeError) as error:
        raise ProfileError(f"{path}: no CSV in UTF-8: {error}; save it as CSV (UTF-8)") from None
    except OSError as error:
        raise ProfileError(f"{path}: cannot be read: {error.strerror}") from None
    if not rows:
        raise ProfileError(f"{path}: no trials; each row under the header is one")
    return rows


def _check_header(path: str | Path, header: Sequence[str]) -> None:
    names = [name.strip() for name in header]
    for name in names or [""]:
        if not all(name.split(".")) or set(name) & {";", "\t"} or names.count(name) > 1:
            raise ProfileError(
                f"{path}: row 1: {name!r} is no name of a factor, or twice there; write one in each column, with"
                " commas between them and decimal points: location,speed_m_s"
            )


def _row(label: str, cells: Mapping[str, str]) -> dict[str, Factor]:
    wrong = next((name for name, cell in cells.items() if name is None or not cell.strip()), "")
    if wrong != "":
        place = "more cells than names" if wrong is None else f"column {wrong.strip()}: empty"
        raise ProfileError(f"{label}, {place}; every trial needs one value for each factor")
    return {name.strip(): _cell(cell.strip()) for name, cell in cells.items()}


def _cell(text: str) -> Factor:
    if text in ("true", "false"):
        return text == "true"
    with suppress(ValueError):
        return int(text) if text.lstrip("+-").isdecimal() and text.isascii() else float(text)
    return text
