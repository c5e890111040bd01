"""What two sources say of one quantity: the commanded and the measured position, two sensors. Pure."""

import math

import numpy as np

from controller.limits import Agreement
from drivers.core.messages import MOTION, Command, MoveAt, MoveTo, SampleBlock, Stop

FOLLOW_S = 0.2
"""What a mover may be behind or ahead of its command, as time at the commanded speed. Assumption: an arm takes 0.1 s to
reach 0.05 m/s, a stage's position is read every 50 ms, and a slow approach to the target takes the rest."""

SETTLED_S = 0.1
"""After a trial's first sample, and after a tare, both begin so much later. Assumption: by then a tare has acted."""

LATEST_S = 2.0
"""How much later one of both may be than the other. Assumption: longer than any stream may be silent where something
moves; at rest the samples of a sensor whose partner is silent would pile up."""


class Followed:
    """Holds a mover's measured position against what it was commanded.

    The commanded position counts from the first sample after the command. After a motion that no position follows from
    (`Home`, a free one) nothing is compared.

    Args:
        follow_m: How far both may be apart, beside what is commanded in `FOLLOW_S`; None does not compare.

    Attributes:
        place_m: Where the mover was seen last in this trial; NaN before.
    """

    def __init__(self, follow_m: float | None, where: str) -> None:
        self._follow_m, self._where = follow_m, where
        self.begin()

    def begin(self) -> None:
        """Begin a trial: the mover was not seen yet."""
        self.place_m = math.nan
        self.forget()

    def forget(self) -> None:
        """Compare nothing until the next command."""
        self._command: Command | None = None
        self._from: tuple[float, float] | None = None
        self._speed_m_s = self._before_m_s = 0.0

    def sent(self, command: Command) -> None:
        """A command went to the mover."""
        if isinstance(command, MoveAt | MoveTo) or (isinstance(command, Stop) and self._command is not None):
            # As fast as it went before, it still goes for a while.
            self._before_m_s, self._speed_m_s = self._speed_m_s, _speed_m_s(command)
            self._command, self._from = command, None
        elif isinstance(command, MOTION):
            self.forget()

    def rest(self) -> None:
        """The mover says that it stands still."""
        self._speed_m_s = 0.0

    def see(self, block: SampleBlock) -> str | None:
        """Why the mover does not do what it was commanded; None where it does."""
        places_m = block.physical[:, 0]
        self.place_m = float(places_m[-1])
        command = self._command
        if command is None or self._follow_m is None:
            return None
        times_s = block.times
        if self._from is None:
            self._from = float(times_s[0]), float(places_m[0])
        begun_s, from_m = self._from
        target_m = getattr(command, "position_m", getattr(command, "limit_m", from_m))
        speed_m_s = _speed_m_s(command)
        way_m = math.copysign(speed_m_s, target_m - from_m) * (times_s - begun_s)
        least_m, most_m = min(from_m, target_m), max(from_m, target_m)
        expected_m = np.clip(from_m + way_m, least_m, most_m)
        off_m = np.abs(places_m - expected_m)
        beyond = off_m > self._follow_m + FOLLOW_S * max(self._before_m_s, speed_m_s)
        if not beyond.any():
            return None
        first = int(beyond.argmax())
        return (
            f"{block.stream} is at {places_m[first]:.6f} m, {off_m[first]:.6f} m from where it was commanded to be"
            f" ({self._where}.follow_m = {self._follow_m:g})"
        )


def _speed_m_s(command: Command) -> float:
    """At which it has a mover go; 0 of a stop."""
    return abs(float(getattr(command, "velocity_m_s", getattr(command, "speed_m_s", 0.0))))


class Agreeing:
    """Holds two sensors of one quantity against each other, by what each has changed since its first sample.

    Args:
        where: Where it stands in a profile.

    Attributes:
        streams: Both.
    """

    def __init__(self, settings: Agreement, where: str) -> None:
        self.streams = settings.streams
        self._settings, self._where = settings, where
        self.forget()

    def forget(self) -> None:
        """Begin anew: a trial begins, or one of both is tared."""
        self._waiting = [(np.empty(0), np.empty(0))] * 2
        self._zero = [math.nan, math.nan]
        self._begin_s = self._since_s = math.nan

    def see(self, block: SampleBlock) -> str | None:
        """Why both disagree, from new samples of one; None where they do not."""
        if math.isnan(self._begin_s):
            self._begin_s = float(block.times[0]) + SETTLED_S
        used = block.times >= self._begin_s
        for side in (0, 1):
            if block.stream == self.streams[side] and used.any():
                values = block.physical[used, self._settings.channels[side]]
                if math.isnan(self._zero[side]):
                    self._zero[side] = float(values[0])
                changed = (values - self._zero[side]) * (self._settings.factor if side else 1.0)
                times_s, before = self._waiting[side]
                times_s, changed = np.append(times_s, block.times[used]), np.append(before, changed)
                recent = times_s >= times_s[-1] - LATEST_S
                self._waiting[side] = times_s[recent], changed[recent]
        (times_s, first), (others_s, second) = self._waiting
        if not len(times_s) or not len(others_s):
            return None
        known = (times_s >= others_s[0]) & (times_s <= others_s[-1])
        other = second[np.searchsorted(others_s, times_s[known], side="right") - 1]
        reason = self._apart(times_s[known], first[known], other)
        last_s = min(times_s[-1], others_s[-1])
        self._waiting[0] = times_s[times_s > last_s], first[times_s > last_s]
        kept = max(0, int(np.searchsorted(others_s, last_s, side="right")) - 1)
        self._waiting[1] = others_s[kept:], second[kept:]
        return reason

    def _apart(self, times_s: np.ndarray, first: np.ndarray, second: np.ndarray) -> str | None:
        settings = self._settings
        for t_s, one, other in zip(times_s.tolist(), first.tolist(), second.tolist(), strict=True):
            if abs(one - other) <= settings.most:
                self._since_s = math.nan
                continue
            self._since_s = t_s if math.isnan(self._since_s) else self._since_s
            if t_s - self._since_s >= settings.for_s:
                names = " and ".join(self.streams)
                return (
                    f"{names} disagree: they have changed by {one:.4g} and {other:.4g} since both began"
                    f" ({self._where}.most = {settings.most:g})"
                )
        return None
