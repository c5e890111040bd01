"""Thresholds from a bench at rest: what its detectors make of a minute in which nothing happens."""

from collections.abc import Collection, Iterator, Mapping, Sequence
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from behaviors.events import BaselineRefused, Event, Tick
from controller.by_hand import HandResult, HandSession, Script, scripted, unwatched
from controller.detectors.calibration import Calibration, Statistic, calibrate_pieces, poisson_interval
from controller.detectors.protocol import Detector
from controller.guard import RELIEF, GuardSettings
from controller.recording.series import joined
from controller.replay import replay
from drivers.core.errors import PROGRAM
from drivers.core.messages import Command, Excite, SampleBlock, Saturated

MOVED_M = 1e-4
"""What stands still stays within this, m: above an arm's noise (assumption)."""

STEP = 8.0
"""A level that changes from a second to the next by more than so many deviations of a sample did not rest: touched,
knocked or moved. Assumption: a second's mean of 100 samples varies by a tenth of one."""

WINDOW_S = 1.0
"""Length of which levels are compared."""


def listened(
    session: HandSession, streams: Collection[str], drive: Command | None, settle_s: float, seconds: float
) -> tuple[HandResult, Sequence[SampleBlock]]:
    """Listen, after a while in which the bench settles; nothing is moved. How it went, and what came.

    Args:
        session: Keeps all that comes.
        drive: What makes the sensors hear anything: an excitation, no motion. It is ended at the end.
        settle_s: How long before.
        seconds: How long.
    """

    def script() -> Script:
        event = yield [drive] if drive is not None else ()
        while not isinstance(event, Tick) or event.t_s < settle_s + seconds:
            event = yield ()
        if drive is not None:
            yield [Excite(drive.device, False)]

    result = session.run(scripted(script()), streams=streams, limits=unwatched(session.limits))
    return result, [block for block in session.latest.blocks if block.t0_s >= settle_s]


class Proposal(NamedTuple):
    """What a minute of rest says of one detector's threshold.

    Attributes:
        found: The threshold; None where rest alone gives none.
    """

    detector: str
    found: Calibration | None
    reason: str = ""

    @property
    def line(self) -> str:
        """For people."""
        found = self.found
        if found is None:
            return f"{self.detector}: no threshold from rest: {self.reason}"
        text = f"{self.detector}: threshold = {found.threshold:.4g}, {self.evidence}"
        if found.extrapolated:
            text += " (beyond what was heard: extrapolated)"
        if np.isfinite(found.checked_found):
            low, high = poisson_interval(found.checked_found)
            text += (
                f"; held out, for one in {found.checked_interval_s:.3g} s: {found.checked_expected:.0f} expected,"
                f" {found.checked_found:.0f} found ({low:.2g} to {high:.2g})"
            )
        return text

    @property
    def evidence(self) -> str:
        """How far it can be trusted; the comment in a profile."""
        found = self.found
        assert found is not None
        return (
            f"{found.low:.4g} to {found.high:.4g} (95 %), n = {found.recording_s:.3g} s, asked: a false alarm in"
            f" {found.false_alarm_interval_s:g} s"
        )


def proposals(
    detectors: Mapping[str, Detector], blocks: Sequence[SampleBlock], false_alarm_interval_s: float
) -> Iterator[Proposal]:
    """A threshold for each detector, or why there is none.

    Args:
        detectors: By name, fresh.
        blocks: Of their inputs, in order, without an event.
    """
    for name, detector in detectors.items():
        heard = [block for block in blocks if block.stream in detector.inputs]
        if getattr(detector, "decides_in_motion", False):
            reason = f"it decides while something moves: {PROGRAM} calibrate, on motion without an object"
            yield Proposal(name, None, reason)
        elif not isinstance(detector, Statistic):
            yield Proposal(name, None, "it takes its own from each trial's baseline, or shows no statistic")
        else:
            try:
                yield Proposal(name, calibrate_pieces([(detector, heard)], false_alarm_interval_s))
            except ValueError as error:
                refusals = (each for each in replay(heard, detector) if isinstance(each, BaselineRefused))
                yield Proposal(name, None, next((each.reason for each in refusals), str(error)))


def unrest(blocks: Sequence[SampleBlock], events: Sequence[Event], limits: GuardSettings) -> Iterator[str]:
    """Why a bench was not at rest, a line each.

    Args:
        blocks: What it sent, each stream in order.
        limits: Which streams are positions, poses and the force.
    """
    for event in events:
        if isinstance(event, Saturated):
            yield f"{event.stream} is beyond its range, at {event.value:.4g}: is something touching?"
    parts = [limits, *limits.movers.values()]
    places = {stream for each in parts for stream in (each.position_stream, each.pose_stream)}
    for stream in dict.fromkeys(block.stream for block in blocks):
        series = joined([block for block in blocks if block.stream == stream])
        values, times_s = series.values, series.times_s
        if stream in places:
            way_m = float(np.ptp(values[:, :3], axis=0).max())
            if way_m > MOVED_M:
                yield f"{stream} went {1e3 * way_m:.2f} mm: nothing may move"
            continue
        if stream == limits.force_stream and limits.force_n is not None:
            force_n = float(np.linalg.norm(np.median(values[:, list(limits.force_channels)], axis=0)))
            if force_n > RELIEF * limits.force_n:
                yield (
                    f"{stream} reads {force_n:.3g} N at rest, more than a tenth of limits.force_n: lift off what"
                    f" touches, else {PROGRAM} tare PROFILE"
                )
        yield from _stepped(stream, values, times_s)


def _stepped(stream: str, values: np.ndarray, times_s: np.ndarray) -> Iterator[str]:
    """Where a stream's level changed from a second to the next."""
    seconds = np.floor((times_s - times_s[0]) / WINDOW_S).astype(int)
    parts = [values[seconds == second] for second in range(int(seconds[-1]))]
    if not all(len(part) > 1 for part in parts):
        return
    spreads = np.array([part.std(axis=0) for part in parts])
    spread = np.median(spreads, axis=0) if parts else np.zeros(values.shape[1])
    for second, (before, after) in enumerate(pairwise(np.median(part, axis=0) for part in parts), start=1):
        if ((spread > 0.0) & (np.abs(after - before) > STEP * spread)).any():
            yield f"{stream} changed its level {second * WINDOW_S:.0f} s after the beginning: was something touched?"
            return
