"""What a person sees of a trial that runs: the deciding signal, its threshold, and the guard's margins."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from controller.detectors.protocol import Detector
from controller.limits import GuardSettings
from controller.recording.series import TrialRecording

BARS = "▁▂▃▄▅▆▇█"

SPARKS = 40
"""Samples side by side: with their name and numbers, they fit into 80 columns."""


class Glimpse:
    """The deciding signal and the margins of a trial, from what was recorded of it so far.

    It is asked a few times a second, between two turns of the loop, and reads the last samples alone. What a
    detector of the user's own raises is shown, and ends no trial.

    Args:
        recording: Of the trial, as it grows.
        detectors: By name; the first one's first input is the deciding signal.
        limits: Of the guard.
    """

    def __init__(
        self, recording: TrialRecording, detectors: Mapping[str, Detector], limits: GuardSettings
    ) -> None:
        self._recording = recording
        self._detector = next(iter(detectors.values()), None)
        self._limits = limits

    def lines(self) -> list[str]:
        """The signal's line and the margins'; nothing for what has not been heard."""
        return [line for line in (self._signal_or_why_not(), "  ".join(self._margins())) if line]

    def _signal_or_why_not(self) -> str:
        try:
            return self._signal()
        except Exception as error:
            return f"{type(self._detector).__name__} cannot be shown: {type(error).__name__}: {error}"

    def _signal(self) -> str:
        if self._detector is None or not self._detector.inputs:
            return ""
        stream = self._detector.inputs[0]
        values, unit = self._recording.latest(stream, SPARKS)
        if not len(values):
            return ""
        shown = values[:, 0]
        if stream.endswith(".period"):  # heard as a frequency
            shown, unit = 1.0 / shown, "Hz"
        threshold = float(getattr(self._detector, "threshold_hz", math.nan))
        beside = f" of {threshold:.4g}" if math.isfinite(threshold) else ""
        return f"{stream}  {sparkline(shown)}  {shown[-1]:.4g}{beside} {unit}".rstrip()

    def _margins(self) -> Iterator[str]:
        """`force 0.04 of 2.0 N`: what the guard watches beside its limit."""
        limits = self._limits
        for name, stream, limit, scale, unit in (
            ("force", limits.force_stream, limits.force_n, 1.0, "N"),
            ("travel", limits.position_stream, limits.travel_m, 1e3, "mm"),
        ):
            if stream is None or limit is None:
                continue
            values, _ = self._recording.latest(stream, 1)
            if len(values):
                columns = limits.force_channels if name == "force" else (0,)
                size = float(np.linalg.norm(values[-1, list(columns)]))
                yield f"{name} {size * scale:.2f} of {limit * scale:.1f} {unit}"


def sparkline(values: NDArray[np.float64] | Sequence[float]) -> str:
    """A bar for each value between the least and the largest; a blank for what is not finite."""
    known = [value for value in values if math.isfinite(value)]
    low, high = min(known, default=0.0), max(known, default=0.0)
    steps = (len(BARS) - 1) / ((high - low) or 1.0)
    return "".join(BARS[round((value - low) * steps)] if math.isfinite(value) else " " for value in values)
