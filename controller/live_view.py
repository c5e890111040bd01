"""What a person sees of a trial that runs, on the terminal and on the live page: signals, thresholds, margins, ages."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from itertools import islice
from typing import Any

import numpy as np

from behaviors.events import Approached, BorderNear, Contact, Event, Forecast, PreTouch, SlipStarted
from behaviors.machine import Behavior
from controller.detectors.protocol import Detector, quantity_of
from controller.limits import GuardSettings, shown_limits
from controller.recording.series import DETECTOR, TrialRecording
from controller.scales import as_text, displayed, shown_in, spaced
from drivers.core.messages import Floats

BARS = "▁▂▃▄▅▆▇█"

SPARKS = 40
"""Samples side by side: with their name and numbers, they fit into 80 columns."""

FELT = (Contact, PreTouch, SlipStarted, BorderNear)
"""What a detector reports that a trial waits for."""

PANELS = 6
"""Most signals on the page (assumption: what a screen holds)."""


class LiveView:
    """A trial from what was recorded of it so far.

    It is read a few times a second, by the loop's thread between two turns and by the page's thread, which changes
    nothing and reads growing lists of blocks and events. An exception of a user's own detector is shown, and ends no
    trial.

    Args:
        detectors: By name; what decides, by the behavior, is shown first: its first input, statistic and threshold.
        events: What happened in it, as it grows.
    """

    def __init__(
        self,
        recording: TrialRecording,
        detectors: Mapping[str, Detector],
        limits: GuardSettings,
        behavior: Behavior,
        events: Sequence[Event],
        lost: Mapping[str, int],
        now: Callable[[], float],
    ) -> None:
        self.recording = recording
        self.now = now
        self._detectors = detectors
        self._limits = limits
        self._behavior = behavior
        self._events = events
        self._lost = lost

    # on the terminal

    def lines(self, width: int = 80) -> list[str]:
        """The signal's line, no wider than that, and the margins'; nothing for what has not arrived."""
        margins = (f"{name} {value:.2f} of {limit:.1f} {unit}" for name, value, limit, unit in self.margins())
        lines = (self._signal_or_why_not(width), "  ".join(margins), self.foreseen())
        return [line for line in lines if line]

    def foreseen(self) -> str:
        """What the approach under way will do at a touch, or what the last one did."""
        newest = (event for event in reversed(self._events) if isinstance(event, Forecast | Approached))
        return next(map(as_text, newest), "")

    def _signal_or_why_not(self, width: int) -> str:
        name = next(iter(self.deciding()), "")
        detector = self._detectors.get(name)
        try:
            return self._signal(name, detector, width)
        except Exception as error:
            return f"{type(detector).__name__} cannot be shown: {type(error).__name__}: {error}"

    def _signal(self, name: str, detector: Detector | None, width: int) -> str:
        if detector is None or not detector.inputs:
            return ""
        stream = detector.inputs[0]
        values, unit = self.recording.latest(stream, SPARKS)
        if not len(values):
            return ""
        shown, unit = displayed(stream, values[:, self.channel(stream)], unit)
        readings, its_unit = self.recording.latest(f"{DETECTOR}{name}", 1)
        known = len(readings) and math.isfinite(readings[-1, 1])
        held, its_unit = displayed(DETECTOR, readings[-1] if known else readings, its_unit)
        beside = f"  {name} {held[0]:.4g} of {held[1]:.4g} {its_unit}".rstrip() if known else ""
        newest = f"  {shown[-1]:.4g} {unit}".rstrip() + beside
        room = max(1, width - len(f"{stream}  {newest}"))
        return f"{stream}  {sparkline(shown[-room:])}{newest}"

    # on both

    def margins(self) -> Iterator[tuple[str, float, float, str]]:
        """Name, value, limit and unit of what the guard watches: `force 0.04 of 2.0 N`."""
        for name, stream, channels, limit, unit in shown_limits(self._limits):
            values, _ = self.recording.latest(stream, 1)
            if len(values):
                shown, scale = shown_in(unit)
                size = float(np.linalg.norm(values[-1, list(channels)]))
                yield name, size * scale, limit * scale, shown

    def thresholds(self) -> Iterator[tuple[str, float, float, str, bool]]:
        """Name, statistic, threshold and unit of each detector that has both: `contact 26.4 of 28.2 nats`; and whether
        the present state acts on it, or it only watches."""
        acts = self._behavior.acts_on & self._behavior.plan.detectors
        for name in self.deciding():
            readings, unit = self.recording.latest(f"{DETECTOR}{name}", 1)
            if len(readings) and np.isfinite(readings[-1]).all():
                (value, threshold), unit = displayed(DETECTOR, readings[-1], unit)
                yield name, float(value), float(threshold), unit, name in acts

    def deciding(self) -> list[str]:
        """The detectors, what decides in the present state first."""
        first = self._behavior.deciding
        return sorted(self._detectors, key=lambda name: first.index(name) if name in first else len(first))

    def channel(self, stream: str) -> int:
        """Of a stream's channels the one that is drawn: what the foremost detector hears, else the first."""
        heard = (self._detectors[name] for name in self.deciding() if stream in self._detectors[name].inputs)
        chosen = getattr(getattr(next(heard, None), "settings", None), "channel", 0)
        return chosen if isinstance(chosen, int) else 0

    def title(self, stream: str) -> str:
        """What a detector's statistic is; "" for any other stream."""
        name = stream.removeprefix(DETECTOR)
        return "" if name == stream else f"{name}: {quantity_of(self._detectors.get(name)).name}"

    # on the page

    def diagram(self) -> dict[str, Any]:
        """States in their order, those that end, and transitions (from, to, event); those from everywhere left out."""
        behavior = self._behavior
        rows = [row for row in behavior.table if row.dest is not None and len(row.sources) <= 2]
        ways = [(source, row.dest, row.trigger.replace("_", " ")) for row in rows for source in row.sources]
        return {"states": list(behavior.states), "final": list(behavior.final), "ways": ways}

    def after_resume(self) -> str:
        """The state that follows a resume now: by the first row of the table without a condition; "" for none."""
        here = self._behavior.state
        rows = (row for row in self._behavior.table if row.trigger == "resumed" and here in row.sources)
        return next((row.dest or here for row in rows if not row.conditions), here)

    def detected(self) -> str:
        """What was last detected in this trial, by a detector that the behavior acts on: `contact at 12.31 s`; "" for
        nothing yet."""
        told = [
            each
            for each in self._events
            if isinstance(each, FELT) and each.detector in self._behavior.acts_on
        ]
        return f"{spaced(type(told[-1]).__name__)} at {told[-1].t_s:.2f} s" if told else ""

    def panels(self) -> list[str]:
        """Streams that are drawn: of what decides in the present state statistic and inputs; what the guard watches;
        the same of the other detectors, those that listen first."""
        first, armed = self._behavior.deciding, self._behavior.plan.detectors
        names = sorted(self.deciding(), key=lambda name: (name not in first, name not in armed))
        pairs = {name: (f"{DETECTOR}{name}", *self._detectors[name].inputs) for name in names}
        wanted = [stream for name in names if name in first for stream in pairs[name]]
        wanted += [stream for stream in (self._limits.force_stream, self._limits.position_stream) if stream]
        wanted += [stream for name in names for stream in pairs[name]]
        present = set(self.recording.streams)
        return list(islice((stream for stream in dict.fromkeys(wanted) if stream in present), PANELS))

    def ages(self) -> list[tuple[str, float, int]]:
        """Each stream that has arrived, s since its last sample, and how many samples were lost."""
        now_s, found = self.now(), []
        for stream in self.recording.streams:
            newest = () if stream.startswith(DETECTOR) else self.recording.blocks(stream, -1)
            found += [
                (stream, now_s - each.last_s, self._lost.get(stream, 0)) for each in newest if len(each)
            ]
        return found

    def events(self, first: int) -> list[tuple[float, str]]:
        """What happened, the first ones left out: when, and what as text."""
        return [(event.t_s, as_text(event)) for event in self._events[first:]]


def label(stream: str, unit: str) -> str:
    """A signal's name and unit."""
    name = stream.removeprefix(DETECTOR)
    return f"{name}, {unit}" if unit else name


def sparkline(values: Floats | Sequence[float]) -> str:
    """A bar for each value between the least and the largest; a blank for what is not finite."""
    known = [value for value in values if math.isfinite(value)]
    low, high = min(known, default=0.0), max(known, default=0.0)
    steps = (len(BARS) - 1) / ((high - low) or 1.0)
    return "".join(BARS[round((value - low) * steps)] if math.isfinite(value) else " " for value in values)
