"""The drive of the transducers: tones and sweeps on the converter's own clock, exact in phase for ever."""

import bisect
import math
from typing import NamedTuple

import numpy as np

from drivers.core.messages import Floats, Ints
from simulator.physics.stage_axis import sane

FRAME_HZ = 96_000
"""Frames a second (Rupavatharam et al., IV: 96 kHz)."""

STEPS_PER_HZ = 1000
"""Frequencies are kept in whole millihertz, so that phases are whole numbers."""


class Segment(NamedTuple):
    """What is driven from `start_s` on: a tone where there is no end, else a sweep."""

    start_s: float
    level: float
    from_hz: float
    to_hz: float
    end_s: float


SILENCE = Segment(-math.inf, 0.0, 0.0, 0.0, math.inf)


class AuraDrive:
    """One drive for both fingers.

    A tone's phase is zero at frame 0 of the converter, whenever it was switched on; a sweep's where it begins.
    """

    def __init__(self) -> None:
        self.restart()

    def restart(self) -> None:
        """Time begins anew, in silence."""
        self._segments = [SILENCE]

    def tone(self, t_s: float, frequency_hz: float, level: float) -> None:
        """One frequency from `t_s` on, in whole millihertz."""
        sane("level", level)
        frequency_hz = round(sane("frequency_hz", frequency_hz) * STEPS_PER_HZ) / STEPS_PER_HZ
        self._put(Segment(t_s, level, frequency_hz, frequency_hz, math.inf))

    def sweep(self, t_s: float, from_hz: float, to_hz: float, duration_s: float, level: float) -> None:
        """A linear sweep from `t_s` on, then silence."""
        wanted = {"from_hz": from_hz, "to_hz": to_hz, "duration_s": duration_s, "level": level}
        for name, value in wanted.items():
            sane(name, value)
        self._put(Segment(t_s, level, from_hz, to_hz, t_s + duration_s))

    def silence(self, t_s: float) -> None:
        """Nothing from `t_s` on."""
        self._put(SILENCE._replace(start_s=t_s))

    def at(self, times_s: Floats) -> tuple[Floats, Floats]:
        """Frequency in Hz and level at each instant, shape (n,) each; both are 0 in silence."""
        frequency_hz = np.zeros(len(times_s))
        level = np.zeros(len(times_s))
        for segment, part in self._parts(times_s):
            within_s = times_s[part] - segment.start_s
            if segment.end_s < math.inf:
                slope = (segment.to_hz - segment.from_hz) / (segment.end_s - segment.start_s)
                on = times_s[part] < segment.end_s
                frequency_hz[part] = np.where(on, segment.from_hz + slope * within_s, 0.0)
                level[part] = np.where(on, segment.level, 0.0)
            else:
                frequency_hz[part], level[part] = segment.from_hz, segment.level
        return frequency_hz, level

    def phase_rad(self, frames: Ints, times_s: Floats | None = None) -> Floats:
        """Phase of the drive at each frame, shape (n,).

        Args:
            frames: Of the converter, shape (n,).
            times_s: When they are; None where the converter's clock is the devices' own.
        """
        times_s = frames / FRAME_HZ if times_s is None else times_s
        phase = np.zeros(len(frames))
        for segment, part in self._parts(times_s):
            if segment.end_s < math.inf:
                within_s = times_s[part] - segment.start_s
                slope = (segment.to_hz - segment.from_hz) / (segment.end_s - segment.start_s)
                turns = within_s * (segment.from_hz + 0.5 * slope * within_s)
                phase[part] = 2.0 * math.pi * (turns - np.floor(turns))
            else:
                whole = FRAME_HZ * STEPS_PER_HZ
                step = round(segment.from_hz * STEPS_PER_HZ)
                # whole numbers: no frame is too late for the last bit of the phase
                phase[part] = (step * (frames[part] % whole) % whole) * (2.0 * math.pi / whole)
        return phase

    def _put(self, segment: Segment) -> None:
        while self._segments[-1].start_s >= segment.start_s and len(self._segments) > 1:
            self._segments.pop()
        self._segments.append(segment)

    def _parts(self, times_s: Floats) -> list[tuple[Segment, slice]]:
        """The segments that instants in growing order fall into, and which."""
        if not len(times_s):
            return []
        starts = [segment.start_s for segment in self._segments]
        first = bisect.bisect_right(starts, times_s[0]) - 1
        last = bisect.bisect_right(starts, times_s[-1]) - 1
        cuts = np.searchsorted(times_s, starts[first + 1 : last + 1])
        bounds = [0, *cuts.tolist(), len(times_s)]
        return [(self._segments[first + i], slice(bounds[i], bounds[i + 1])) for i in range(last - first + 1)]
