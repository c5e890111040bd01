"""The resonant finger: two links, tendon and drive, accelerometer, phase-locked loop, and a probe that touches it.

Equations, choice of the model and fit: docs/explanation/finger_physics.md.
"""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from drivers.core.messages import Floats
from simulator.physics import finger_scene as scene
from simulator.physics.finger_course import FingerCourse
from simulator.physics.finger_kernel import STREAM_LOAD_CELL
from simulator.physics.finger_lock import leap, may_touch
from simulator.physics.finger_settings import LOCATIONS, FingerSettings
from simulator.physics.noise import gaussian_at
from simulator.physics.stage_axis import SANE

__all__ = ["CHANNELS", "LOCATIONS", "FingerPlant", "FingerSettings"]


WAVEFORMS = {"accelerometer": (1, 0), "load_cell": (2, 1), "distal": (8, 2)}
"""Channels with a value at any time: their bit in what is recorded, and their place there."""

CHANNELS = frozenset(WAVEFORMS) | {"period", "switches"}
"""What can be observed."""

_WORTH_S = 5.0
"""A shorter span is not worth a leap: to compute it costs less than a millisecond."""


class FingerPlant(FingerCourse):
    """Finger, probe and electronics, advanced piece by piece in closed form.

    What is not observed is computed when it is first needed, or not at all: see `account`.
    """

    def __init__(self, settings: FingerSettings) -> None:
        self.settings = settings
        self._seconds = {"exact": 0.0, "cycles": 0.0, "stationary": 0.0}
        self._error_rad = 0.0
        self.begin(key=(0, 0), gap_m=1e-3)

    def begin(self, *, key: tuple[int, int], location: str = "f", gap_m: float, t_s: float = 0.0) -> None:
        """Start a trial: everything at rest, excitation off, probe at rest.

        Args:
            key: Seed of the run and number of the trial: they key the noise.
            location: Where the probe will touch, a key of `LOCATIONS`.
            gap_m: Distance of the probe from the finger at rest.

        Raises:
            ValueError: unknown location, a key out of range, a gap or a time that is not finite.
        """
        if location not in LOCATIONS:
            raise ValueError(f"finger: no location {location!r}; there are {', '.join(LOCATIONS)}")
        if not (0 <= key[0] < 2**63 and 0 <= key[1] < 2**32):
            raise ValueError(
                f"finger: noise is keyed by a seed below 2^63 and a trial below 2^32, not by {key}"
            )
        self._key = key
        self._location = location
        self._gap_m = _finite("gap_m", gap_m)
        self._until_s = _finite("t_s", t_s)
        self._computed_s = t_s
        self._span_s = (t_s, t_s)
        self._channels = (0, 0)
        self.set_out(scene.scene(self.settings, location, gap_m, 0.0, key), t_s)

    # what comes from outside

    def excite(self, on: bool) -> None:
        """Switch the excitation at the present time."""
        self._settle()
        self.moment.flags[scene.EXCITED] = int(on)

    def set_tendon(self, position_m: float) -> None:
        """Set the tendon at the present time; 0 is extended, flexion is positive.

        Raises:
            ValueError: not finite, or so far extended that the joint would lose its stiffness.
        """
        if 1.0 + self.settings.flexion_1_m * _finite("position_m", position_m) <= 0.0:
            raise ValueError(f"finger: a tendon at {position_m} m leaves the joint no stiffness")
        self._settle()
        self.finger = scene.scene(self.settings, self._location, self._gap_m, position_m, self._key)

    def move_probe(self, pieces: Sequence[tuple[float, float, float, float]]) -> None:
        """Give the probe a plan, from the present time on.

        Args:
            pieces: (t_start_s, position_m, velocity_m_s, acceleration_m_s2) in order of time, position from where the
                probe stood when the trial began. Each holds until the next begins, the last for ever.

        Raises:
            ValueError: empty, not finite or beyond `SANE`, or not in order.
        """
        table = np.array(pieces, dtype=np.float64).reshape(-1, 4)
        if not len(table):
            raise ValueError("finger: a plan for the probe needs a piece")
        if not (np.abs(table) <= SANE).all():
            raise ValueError(
                f"finger: the probe's plan is not finite, or beyond {SANE:g}, which no bench has"
            )
        if np.any(np.diff(table[:, 0]) < 0.0):
            raise ValueError("finger: the pieces of the probe's plan are not in order of time")
        self._settle()
        self.follow(table)

    # time

    @property
    def t_s(self) -> float:
        """Present time in the trial."""
        return self._until_s

    def advance(self, until_s: float, observe: frozenset[str] = frozenset()) -> None:
        """Let time pass.

        Args:
            observe: Channels that will be read for this span.

        Raises:
            ValueError: not finite, backwards, or a channel that is not there.
        """
        if _finite("until_s", until_s) < self._until_s:
            raise ValueError(f"finger: time runs forward, from {self._until_s} s not to {until_s} s")
        if not observe <= CHANNELS:
            raise ValueError(f"finger: no channel {', '.join(sorted(observe - CHANNELS))}")
        if observe:
            self._catch_up()
        channels = sum(bit for channel, (bit, _) in WAVEFORMS.items() if channel in observe)
        self._channels = (channels, self._channels[0])
        self._span_s = (self._until_s, self._span_s[0])
        self.begin_span()
        if observe:
            self.run(until_s, channels=channels, periods=True, switches="switches" in observe)
            self._seconds["exact"] += until_s - self._until_s
            self._computed_s = until_s
        self._until_s = until_s

    def _settle(self) -> None:
        """Bring the state to the present time, for something is about to change."""
        self._catch_up()
        self.run(self._until_s, settle=True, periods=True)

    def _catch_up(self) -> None:
        """Leap over, or compute, what was not observed, from one corner of the probe's plan to the next."""
        if self._computed_s >= self._until_s:
            return
        starts = (self.motion.whole + self.motion.fraction).tolist()
        for corner_s in [*(t for t in starts if self._computed_s < t < self._until_s), self._until_s]:
            if corner_s - self._computed_s > _WORTH_S:
                self._leap(corner_s)
            self.run(corner_s)
            self._seconds["exact"] += corner_s - self._computed_s
            self._computed_s = corner_s

    def _leap(self, until_s: float) -> None:
        done = leap(self, self._computed_s, until_s, self.settings.error_budget_rad)
        if done is not None:
            tier, computed_s, left_out_s = done
            self._seconds["exact"] += computed_s
            self._seconds[tier] += left_out_s
            self._computed_s += computed_s + left_out_s
            self._error_rad = self.settings.error_budget_rad

    # what can be read

    def sample(self, channel: str, times_s: Floats) -> Floats:
        """What a channel shows at given times, noise included.

        Args:
            channel: `accelerometer` or `distal` (m/s^2) or `load_cell` (N).
            times_s: Ascending, within the last two spans and observed there; shape (n,).

        Returns:
            Shape (n,).

        Raises:
            ValueError: not a waveform, or not observed at these times.
        """
        bit, place = WAVEFORMS.get(channel, (0, 0))
        times_s = np.ascontiguousarray(times_s, dtype=np.float64)
        out = np.empty(times_s.size)
        split = int(np.searchsorted(times_s, self._span_s[0]))
        for part, age in ((slice(0, split), 1), (slice(split, times_s.size), 0)):
            if part.start == part.stop:
                continue
            if (
                not bit & self._channels[age]
                or times_s[part.start] < self._span_s[age]
                or times_s[-1] > self._until_s
            ):
                raise ValueError(f"finger: {channel!r} was not observed from {times_s[0]} to {times_s[-1]} s")
            self.read(place, times_s[part], out[part], before=age == 1)
        s = self.settings
        if channel != "load_cell":
            return np.clip(out, -s.accelerometer_range_m_s2, s.accelerometer_range_m_s2)
        if s.noise_scale * s.load_cell_n > 0.0:
            out += s.noise_scale * s.load_cell_n * self._sampling_noise(times_s)
        return np.clip(out, -s.load_cell_range_n, s.load_cell_range_n)

    def _sampling_noise(self, times_s: Floats) -> Floats:
        """Standard normal deviates of samples, numbered by their nanosecond: the same at each call."""
        return gaussian_at(self._key, STREAM_LOAD_CELL, np.round(times_s * 1e9).astype(np.int64))

    def contacts(self) -> list[tuple[float, bool]]:
        """See `FingerCourse.contacts`."""
        if self._computed_s < self._until_s and may_touch(self, self._computed_s, self._until_s):
            self._catch_up()
        return super().contacts()

    def account(self) -> dict[str, Any]:
        """What was computed and how, over the plant's life, for the manifest.

        Returns:
            `seconds`: virtual time by tier. `exact`: computed; `cycles`: whole cycles of the locked loop, left out;
            `stationary`: left out, and entered again from the locked loop's stationary state. `error_budget_rad`
            and `error_bound_rad`: the error in theta that leaps may make, and that they were allowed.
        """
        return {
            "seconds": dict(self._seconds),
            "error_budget_rad": self.settings.error_budget_rad,
            "error_bound_rad": self._error_rad,
        }

    # the truth now; to read it is to observe it, and ends a span that may be left out

    def state(self) -> Floats:
        """theta, its rate, b, its rate, a, g1, g2, v, phi now; shape (9,)."""
        self._catch_up()
        return self.present(self._until_s).x[: scene.LOOP_STATES]

    @property
    def theta_rad(self) -> float:
        """Angle of the distal link now."""
        return float(self.state()[scene.THETA])

    @property
    def force_n(self) -> float:
        """Force between probe and finger now, compression positive, without noise."""
        self._catch_up()
        return self.force_at(self._until_s)


def _finite(name: str, number: float) -> float:
    if not math.isfinite(number):
        raise ValueError(f"finger: {name} is not finite ({number})")
    return number
