"""What was recorded of one trial: the same class while it runs and when it is read again."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import lacking
from drivers.core.messages import Floats, SampleBlock

if TYPE_CHECKING:
    from pandas import DataFrame
    from xarray import DataArray

DETECTOR = "detector."
"""Begins the streams of what detectors held against their thresholds: `detector.NAME`, statistic and threshold."""

BIN_S = 0.02
"""Of what a detector reads the least and the largest in a bin of time are kept, s: a hundred a second, and all of
what comes more seldom."""

PLOT_S = 0.05
"""The same of what people plot: forty messages a second, each of which costs more than a block of raw samples."""


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of bench time."""

    t0_s: float
    t1_s: float


@dataclass(frozen=True, slots=True)
class Gap(Span):
    """Lost samples: from the last one before to the first one after, and how many are missing."""

    samples: int


@dataclass(frozen=True, slots=True, repr=False)
class Series:
    """One stream of one trial.

    Attributes:
        times_s: Bench time of each sample, shape (n,).
        values: In `unit`, shape (n, channels).
        unit: Unit of the values, "" where nothing was recorded.
        skipped: Where it had no subscriber: no loss.
        name: Of the stream, `board.load_cell`.
    """

    times_s: Floats
    values: Floats
    unit: str = ""
    gaps: tuple[Gap, ...] = ()
    skipped: tuple[Span, ...] = ()
    name: str = ""

    def __len__(self) -> int:
        return len(self.times_s)

    def __repr__(self) -> str:
        span = f", {self.times_s[0]:.3f} to {self.times_s[-1]:.3f} s" if len(self) else ""
        gaps = f", {len(self.gaps)} gaps" if self.gaps else ""
        return f"Series({self.name}, {self.unit}: {len(self)} samples of {self.values.shape[1]}{span}{gaps})"

    @property
    def rate_hz(self) -> float:
        """Of the usual step in time between two samples; NaN of fewer."""
        return 1.0 / float(np.median(np.diff(self.times_s))) if len(self) > 1 else math.nan

    @property
    def channels(self) -> list[str]:
        """Names of the channels: of a detector what its reading has, else the stream's own, numbered."""
        if self.name.startswith(DETECTOR):
            return ["statistic", "threshold"][: self.values.shape[1]]
        several = self.values.shape[1] > 1
        return [f"{self.name}.{number}" if several else self.name for number in range(self.values.shape[1])]

    def to_pandas(self) -> DataFrame:
        """A column for each channel, by bench time `t_s`, s; `attrs["units"]` has the unit of each."""
        import pandas as pd

        frame = pd.DataFrame(self.values, pd.Index(self.times_s, name="t_s"), self.channels)
        frame.attrs["units"] = {"t_s": "s", **dict.fromkeys(self.channels, self.unit)}
        return frame

    def to_xarray(self) -> DataArray:
        """An array of (t_s, channel); `attrs["units"]` of it and of its time as xarray and pint read them.

        Raises:
            ImportError: xarray is not installed.
        """
        try:
            import xarray
        except ImportError as error:
            raise ImportError("; ".join(lacking("xarray", "xarray"))) from error
        time = ("t_s", self.times_s, {"units": "s"})
        coordinates, attrs = {"t_s": time, "channel": self.channels}, {"units": self.unit}
        return xarray.DataArray(self.values, coordinates, ("t_s", "channel"), name=self.name, attrs=attrs)

    def between(self, t0_s: float, t1_s: float) -> Series:
        """The samples with t0_s <= t < t1_s, and the gaps and skipped spans that touch them."""
        inside = (self.times_s >= t0_s) & (self.times_s < t1_s)
        return Series(
            self.times_s[inside],
            self.values[inside],
            self.unit,
            tuple(gap for gap in self.gaps if gap.t0_s < t1_s and gap.t1_s > t0_s),
            tuple(span for span in self.skipped if span.t0_s < t1_s and span.t1_s > t0_s),
            self.name,
        )


class TrialRecording:
    """Blocks and skipped spans of one trial, stream by stream, in the order in which they came."""

    def __init__(self, trial: int, factors: Mapping[str, object] | None = None) -> None:
        self.trial = trial
        self.factors = dict(factors or {})
        self._blocks: dict[str, list[SampleBlock]] = {}
        self._skipped: dict[str, list[Span]] = {}
        # the last that was asked for, of so many blocks and skipped spans
        self._joined: tuple[tuple[str, int, int], Series] | None = None

    @property
    def streams(self) -> Sequence[str]:
        """Names of the streams of which anything was recorded, sorted."""
        return sorted(self._blocks)

    def add(self, block: SampleBlock) -> None:
        """Append a block to its stream."""
        self._blocks.setdefault(block.stream, []).append(block)

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Note that a stream had no subscriber from `t0_s` to `t1_s`."""
        self._skipped.setdefault(stream, []).append(Span(t0_s, t1_s))

    def blocks(self, stream: str, first: int = 0) -> Sequence[SampleBlock]:
        """The stream's blocks as they were recorded, the first ones left out; empty where there are none."""
        return tuple(self._blocks.get(stream, ())[first:])

    def latest(self, name: str, samples: int) -> tuple[Floats, str]:
        """The last samples of a stream, shape (n, channels) with n up to `samples`, and their unit."""
        found: list[Floats] = []
        for block in reversed(self._blocks.get(name, ())):
            if samples <= 0:
                break
            if len(block):
                found.insert(0, block.physical[-samples:])
                samples -= len(found[0])
        unit = self._blocks[name][-1].unit if found else ""
        return (np.concatenate(found) if found else np.empty((0, 1))), unit

    def stream(self, name: str) -> Series:
        """One stream as arrays, not to be written to; without a sample where nothing of it was recorded."""
        blocks, skipped = self._blocks.get(name, ()), self._skipped.get(name, ())
        known = (name, len(blocks), len(skipped))
        if self._joined is None or self._joined[0] != known:
            self._joined = known, joined(blocks, tuple(skipped), name)
        return self._joined[1]


def joined(blocks: Sequence[SampleBlock], skipped: tuple[Span, ...] = (), name: str = "") -> Series:
    """Blocks of one stream as arrays, with a gap where the sequence jumps and no skipped span explains it."""
    blocks = [block for block in blocks if len(block)]
    if not blocks:
        return Series(np.empty(0), np.empty((0, 1)), skipped=skipped, name=name)
    times = [block.times for block in blocks]
    gaps = []
    for (before, last), (after, first) in pairwise(zip(blocks, times, strict=True)):
        missing, t0_s, t1_s = after.seq - before.seq - len(before), float(last[-1]), float(first[0])
        if missing > 0 and not any(span.t0_s < t1_s and span.t1_s > t0_s for span in skipped):
            gaps.append(Gap(t0_s, t1_s, missing))
    values = np.concatenate([block.physical for block in blocks])
    return Series(np.concatenate(times), values, blocks[0].unit, tuple(gaps), skipped, name)


def extremes(values: Floats, points: int) -> NDArray[np.intp]:
    """Places of the least and the largest of each of `points` / 2 stretches, in order; all where they fit."""
    if len(values) <= points:
        return np.arange(len(values))
    starts = np.linspace(0, len(values), points // 2 + 1).astype(int)[:-1]
    return np.union1d([0, len(values) - 1], extremes_of_each(values, starts))


def bins_of(times_s: Floats, bin_s: float, *, ended: bool) -> tuple[NDArray[np.intp], int]:
    """Where each bin of time begins, and how many samples the bins have.

    The bins are of bench time: the cut of blocks and turns changes nothing. The last one may go on and is left out
    unless all has `ended`.
    """
    bins = np.floor(times_s / bin_s)
    whole = len(bins) if ended else int(np.searchsorted(bins, bins[-1]))
    return np.flatnonzero(np.diff(bins[:whole], prepend=-np.inf)), whole


def extremes_of_each(values: Floats, starts: NDArray[np.intp]) -> NDArray[np.intp]:
    """Places of the least and the largest of each stretch, of each channel (n, channels) or of one (n,), in order, the
    first of equal ones."""
    stretch = np.repeat(np.arange(len(starts)), np.diff(starts, append=len(values)))
    found = []
    for channel in np.atleast_2d(values.T):
        for most, no_value in ((np.minimum, np.inf), (np.maximum, -np.inf)):
            known = np.where(np.isnan(channel), no_value, channel)
            places = np.flatnonzero(known == most.reduceat(known, starts)[stretch])
            found.append(places[np.unique(stretch[places], return_index=True)[1]])
    return np.unique(np.concatenate(found))
