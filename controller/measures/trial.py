"""What a measure is given: the trial's events and streams, live or read again."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Event
from controller.detectors.protocol import Detector
from controller.recording.series import TrialRecording


@dataclass(slots=True)
class TrialEvidence:
    """Everything that a trial left behind.

    Attributes:
        factors: What the trial varied.
        recording: The streams.
        events: In the order in which they were handled.
        entered_s: Bench time at which each state was last entered, by name.
        visits: Every state in the order of its being entered, with the bench time.
        truth: Instants at which contact really began and ended, where the bench is simulated here; else None.
        slips: Instants at which slip really did, where the bench knows slip; else None.
        detectors: Who could be asked to listen, by name.
    """

    factors: Mapping[str, Any]
    recording: TrialRecording
    events: list[Event] = field(default_factory=list)
    entered_s: dict[str, float] = field(default_factory=dict)
    visits: list[tuple[str, float]] = field(default_factory=list)
    truth: Sequence[tuple[float, bool]] | None = None
    slips: Sequence[tuple[float, bool]] | None = None
    detectors: Mapping[str, Detector] = field(default_factory=dict)

    def series(
        self, stream: str, since_s: float = -np.inf, until_s: float = np.inf
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Times (n,) in seconds and values (n,) of a stream's first channel, in its unit, within a span."""
        series = self.recording.stream(stream)
        wanted = (series.times_s >= since_s) & (series.times_s <= until_s)
        return series.times_s[wanted], series.values[wanted, 0]

    def last(self, kind: type[Event], **wanted: object) -> Any:
        """Last event of a kind whose attributes are as wanted, or None."""
        for event in reversed(self.events):
            if isinstance(event, kind) and all(
                getattr(event, name) == value for name, value in wanted.items()
            ):
                return event
        return None
