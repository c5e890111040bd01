"""The resonant finger: two links, tendon and drive, accelerometer, phase-locked loop, and a probe that touches it.

Equations, choice of the model and fit: docs/explanation/finger_physics.md.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from drivers.mock.plants import finger_scene as scene
from drivers.mock.plants.finger_settings import LOCATIONS, FingerSettings

if TYPE_CHECKING:
    from drivers.mock.plants.finger_lock import Lock

__all__ = ["CHANNELS", "LOCATIONS", "FingerPlant", "FingerSettings"]

Floats = NDArray[np.float64]

WAVEFORMS = {"accelerometer": 1, "load_cell": 2}
"""Channels with a value at any time, and their bit in what the kernel records."""

CHANNELS = frozenset(WAVEFORMS) | {"period", "switches"}
"""What can be observed."""

SWITCHES = ("made", "lost", "comparator_up", "comparator_down", "drive_up", "drive_down")
"""Names of the switches, in the kernel's order: contact, comparator, oscillator."""

_EVENTS = 1024
"""Places for switches: taken out as they fill."""

_RECORDS = 512
"""Places for recorded pieces at first; more are made when a span needs them."""

_MARGIN = 2.0
"""The finger is out of reach beyond this many times the swing that it reaches while it locks."""

_WORTH_S = 5.0
"""A shorter span is not worth a jump: to compute it costs less than a millisecond."""


class FingerPlant:
    """Finger, probe and electronics, advanced piece by piece in closed form.

    What nobody observes is computed when it is first needed, or not at all: see `account`.

    Args:
        settings: Of the plant.
    """

    def __init__(self, settings: FingerSettings) -> None:
        # compiled code is loaded when there is a plant, not when a profile is checked
        from drivers.mock.plants import finger_kernel
        from drivers.mock.plants.piecewise import DEGREE

        self._kernel = finger_kernel
        self.settings = settings
        # records of the present span and of the one before
        self._books = scene.books_of(_EVENTS, _RECORDS, DEGREE)
        self._books_before = scene.books_of(_EVENTS, _RECORDS, DEGREE)
        self._seconds = {"exact": 0.0, "cycles": 0.0, "stationary": 0.0}
        self._error_rad = 0.0
        self.begin(key=(0, 0), gap_m=1e-3)

    def begin(self, *, key: tuple[int, int], location: str = "f", gap_m: float, t_s: float = 0.0) -> None:
        """Start a trial: everything at rest, excitation off, probe at rest.

        Args:
            key: Seed of the run and number of the trial: they key the noise.
            location: Where the probe will touch, a key of `LOCATIONS`.
            gap_m: Distance of the probe from the finger at rest.
            t_s: The time at its start.

        Raises:
            ValueError: unknown location, a key out of range, a gap or a time that is not finite.
        """
        if location not in LOCATIONS:
            raise ValueError(f"finger: no location {location!r}; there are {', '.join(LOCATIONS)}")
        if not (0 <= key[0] < 2**63 and 0 <= key[1] < 2**32):
            raise ValueError(f"finger: noise is keyed by a seed below 2^63 and a trial below 2^32, not by {key}")
        _finite("t_s", t_s)
        self._key = key
        self._location = location
        self._gap_m = _finite("gap_m", gap_m)
        self._tendon_m = 0.0
        self._moment = scene.at_rest()
        self._motion = scene.motion_of(np.array([[t_s, 0.0, 0.0, 0.0]]))
        self._finger = scene.scene(self.settings, location, gap_m, 0.0, key)
        self._moment.put(t_s)
        self._until_s = t_s
        self._computed_s = t_s
        self._span_s = (t_s, t_s)
        self._channels = (0, 0)
        self._lock: Lock | None = None
        self._lock_known = False
        self._last_edge: tuple[int, float] | None = None
        self._periods: list[tuple[Floats, Floats]] = []
        self._contacts: list[tuple[float, bool]] = []
        self._switches: list[tuple[float, str]] = []

    # what comes from outside

    def excite(self, on: bool) -> None:
        """Switch the excitation at the present time."""
        self._settle()
        self._moment.flags[scene.EXCITED] = int(on)

    def set_tendon(self, position_m: float) -> None:
        """Set the tendon at the present time; 0 is extended, flexion is positive.

        Raises:
            ValueError: not finite, or so far extended that the joint would lose its stiffness.
        """
        if 1.0 + self.settings.flexion_1_m * _finite("position_m", position_m) <= 0.0:
            raise ValueError(f"finger: a tendon at {position_m} m leaves the joint no stiffness")
        self._settle()
        self._tendon_m = position_m
        self._finger = scene.scene(self.settings, self._location, self._gap_m, position_m, self._key)
        self._lock_known = False

    def move_probe(self, pieces: Sequence[tuple[float, float, float, float]]) -> None:
        """Give the probe a plan, from the present time on.

        Args:
            pieces: (t_start_s, position_m, velocity_m_s, acceleration_m_s2) in order of time, position from where the
                probe stood when the trial began. Each holds until the next begins, the last for ever.

        Raises:
            ValueError: empty, not finite, or not in order.
        """
        table = np.array(pieces, dtype=np.float64).reshape(-1, 4)
        if not len(table):
            raise ValueError("finger: a plan for the probe needs a piece")
        if not np.isfinite(table).all():
            raise ValueError("finger: the probe's plan is not finite")
        if np.any(np.diff(table[:, 0]) < 0.0):
            raise ValueError("finger: the pieces of the probe's plan are not in order of time")
        self._settle()
        self._motion = scene.motion_of(table)
        self._moment.flags[scene.PIECE] = 0

    # time

    @property
    def t_s(self) -> float:
        """Present time in the trial."""
        return self._until_s

    def advance(self, until_s: float, observe: frozenset[str] = frozenset()) -> None:
        """Let time pass.

        Args:
            until_s: The new present.
            observe: Channels that will be sampled for this span.

        Raises:
            ValueError: not finite, backwards, or a channel that is not there.
        """
        if _finite("until_s", until_s) < self._until_s:
            raise ValueError(f"finger: time runs forward, from {self._until_s} s not to {until_s} s")
        if not observe <= CHANNELS:
            raise ValueError(f"finger: no channel {', '.join(sorted(observe - CHANNELS))}")
        if observe:
            self._catch_up()
        channels = sum(bit for channel, bit in WAVEFORMS.items() if channel in observe)
        self._books, self._books_before = self._books_before, self._books
        self._books.filled[:] = 0
        self._channels = (channels, self._channels[0])
        self._span_s = (self._until_s, self._span_s[0])
        if observe:
            self._seconds["exact"] += until_s - self._until_s
            self._run(until_s, channels=channels, heard=True, told="switches" in observe)
            self._computed_s = until_s
        self._until_s = until_s

    def _settle(self) -> None:
        """Bring the state to the present time, for something is about to change."""
        self._catch_up()
        self._run(self._until_s, settle=True, heard=True)

    def _catch_up(self) -> None:
        """Jump over, or compute, what nobody observed."""
        if self._computed_s >= self._until_s:
            return
        starts = (self._motion.whole + self._motion.fraction).tolist()
        corners = [corner for corner in starts if self._computed_s < corner < self._until_s]
        for corner in [*corners, self._until_s]:
            self._jump(corner)
            self._seconds["exact"] += corner - self._computed_s
            self._run(corner)
            self._computed_s = corner

    def _jump(self, until_s: float) -> None:
        """Leave out what the locked loop does before `until_s`, where the error budget allows it.

        Between two corners of the probe's plan the scene is constant. Without noise the cycle repeats, and whole cycles are left out.
        With noise the loop forgets: it is put on its cycle so long before the end that what is left of the difference is inside the
        budget. The noise itself is the one of that time. The phase at the end is then one of many equally likely.
        """
        budget_rad = self.settings.error_budget_rad
        if budget_rad == 0.0 or until_s - self._computed_s < _WORTH_S or not self._moment.flags[scene.EXCITED]:
            return
        lock = self._locked()
        if lock is None or self._may_touch(until_s):
            return
        if self._finger.noise > 0.0 or self._finger.wander > 0.0:
            tier, skipped_s = "stationary", until_s - lock.forgotten_s(budget_rad) - self._computed_s
            if skipped_s < lock.locked_s:
                return
            self._moment.x[:] = lock.x
            self._moment.flags[:] = (scene.FREE, lock.comparator, 1, 1, self._moment.flags[scene.PIECE])
            self._moment.put(self._computed_s + skipped_s)
        else:
            begin_s = self._computed_s + lock.locked_s + lock.repeating_s(budget_rad)
            # the last cycle is computed: its edge begins the first period that is heard
            tier, skipped_s = "cycles", (math.floor((until_s - begin_s) / lock.period_s) - 1) * lock.period_s
            if skipped_s <= 0.0:
                return
            self._seconds["exact"] += begin_s - self._computed_s
            self._run(begin_s)
            self._computed_s = begin_s
            self._moment.put(self._moment.t_s + skipped_s)
        self._last_edge = None
        self._computed_s += skipped_s
        self._seconds[tier] += skipped_s
        self._error_rad = max(self._error_rad, budget_rad)

    def _locked(self) -> Lock | None:
        """The locked loop of the present scene, or None where it does not lock."""
        if not self._lock_known:
            from drivers.mock.plants.finger_lock import lock_of

            self._lock, self._lock_known = lock_of(self._finger), True
        return self._lock

    def _may_touch(self, until_s: float) -> bool:
        """Whether, from the last computed instant on, the probe moves or rests where the finger could touch it."""
        lock = self._locked()
        if lock is None:
            return True
        motion = self._motion
        starts = motion.whole + motion.fraction
        first = max(0, int(np.searchsorted(starts, self._computed_s, side="right")) - 1)
        present = slice(first, max(first + 1, int(np.searchsorted(starts, until_s))))
        if motion.velocity[present].any() or motion.acceleration[present].any():
            return True
        margin_m = _MARGIN * self._finger.arm * lock.swing_rad
        return float(motion.position[present].max()) + margin_m > self._finger.gap

    def _run(
        self,
        until_s: float,
        *,
        settle: bool = False,
        channels: int = 0,
        heard: bool = False,
        told: bool = False,
    ) -> None:
        kernel, books = self._kernel, self._books
        whole = math.floor(until_s)
        while True:
            status = kernel.run(
                self._finger, self._motion, self._moment, whole, until_s - whole, settle, channels, books
            )
            self._note(heard, told)
            if status == kernel.DONE:
                return
            if status == kernel.RECORDS_FULL:
                books = self._books = books.enlarged()
            elif status == kernel.STUCK:
                raise RuntimeError(f"finger: events without end at {self._moment.t_s} s; {self._motion}, {self._finger}")
            elif status == kernel.NOT_FINITE:
                raise FloatingPointError(f"finger: the motion is not finite at {self._moment.t_s} s")

    def _note(self, heard: bool, told: bool) -> None:
        """Take the switches from the books: periods where they are heard, all of them where they are told."""
        books = self._books
        count = int(books.filled[0])
        if not count:
            return
        books.filled[0] = 0
        whole, fraction, switch = books.switch_whole[:count], books.switch_fraction[:count], books.switch[:count]
        edges = np.flatnonzero(switch == scene.DRIVE_UP)
        if edges.size:
            edge_whole, edge_fraction = whole[edges], fraction[edges]
            if heard:
                times = edge_whole + edge_fraction
                lengths = np.diff(edge_whole) + np.diff(edge_fraction)
                if self._last_edge is None:
                    times = times[1:]
                else:
                    first = (edge_whole[0] - self._last_edge[0]) + (edge_fraction[0] - self._last_edge[1])
                    lengths = np.concatenate(([first], lengths))
                self._periods.append((times, lengths))
            self._last_edge = int(edge_whole[-1]), float(edge_fraction[-1])
        for place in np.flatnonzero(switch <= scene.LOST):
            self._contacts.append((float(whole[place] + fraction[place]), bool(switch[place] == scene.MADE)))
        if told:
            times = whole + fraction
            self._switches += [(float(t), SWITCHES[kind]) for t, kind in zip(times, switch, strict=True)]

    # what can be read

    def sample(self, channel: str, times_s: Floats) -> Floats:
        """What a channel shows at given times, noise included.

        Args:
            channel: `accelerometer` (m/s^2) or `load_cell` (N).
            times_s: Ascending, within the last two spans and observed there; shape (n,).

        Returns:
            Shape (n,).

        Raises:
            ValueError: not a waveform, or not observed at these times.
        """
        bit = WAVEFORMS.get(channel, 0)
        times_s = np.ascontiguousarray(times_s, dtype=np.float64)
        out = np.empty(times_s.size)
        split = int(np.searchsorted(times_s, self._span_s[0]))
        spans = ((self._books_before, slice(0, split), 1), (self._books, slice(split, times_s.size), 0))
        for books, part, age in spans:
            if part.start == part.stop:
                continue
            if not bit & self._channels[age] or times_s[part.start] < self._span_s[age] or times_s[-1] > self._until_s:
                raise ValueError(f"finger: {channel!r} was not observed from {times_s[0]} to {times_s[-1]} s")
            self._kernel.read(books, bit - 1, times_s[part], out[part])
        s = self.settings
        if channel == "load_cell":
            if s.noise_scale * s.load_cell_n > 0.0:
                out += s.noise_scale * s.load_cell_n * self._sampling_noise(times_s)
            return np.clip(out, -s.load_cell_range_n, s.load_cell_range_n)
        return np.clip(out, -s.accelerometer_range_m_s2, s.accelerometer_range_m_s2)

    def _sampling_noise(self, times_s: Floats) -> Floats:
        """Standard normal deviates of samples, numbered by their nanosecond: asked for again, they are the same."""
        from drivers.mock.noise import gaussian_at

        return gaussian_at(self._key, self._kernel.STREAM_LOAD_CELL, np.round(times_s * 1e9).astype(np.int64))

    def periods(self) -> tuple[Floats, Floats]:
        """Rising edges of the drive in observed spans since the last call, s, and the period that each ends, s; (n,)."""
        taken, self._periods = self._periods, []
        if not taken:
            return np.empty(0), np.empty(0)
        return np.concatenate([times for times, _ in taken]), np.concatenate([lengths for _, lengths in taken])

    def switches(self) -> list[tuple[float, str]]:
        """Every switch in spans that observed `switches`, since the last call: (time in s, one of `SWITCHES`)."""
        taken, self._switches = self._switches, []
        return taken

    def contacts(self) -> list[tuple[float, bool]]:
        """The truth: (time, whether force began or ended) since the last call. For scoring alone."""
        if self._computed_s < self._until_s and self._may_touch(self._until_s):
            self._catch_up()
        taken, self._contacts = self._contacts, []
        return taken

    def account(self) -> dict[str, Any]:
        """What was computed and how, over the plant's life, for the manifest.

        Returns:
            `seconds` of virtual time by tier: `exact` (every piece), `cycles` (whole cycles of the locked loop left out),
            `stationary` (left out, and entered again from the locked loop's stationary state); the budget, and the error in theta
            that the jumps are allowed, in rad.
        """
        return {
            "seconds": dict(self._seconds),
            "error_budget_rad": self.settings.error_budget_rad,
            "error_bound_rad": self._error_rad,
        }

    def _present(self) -> scene.Moment:
        """State, switches and time now. The plant itself stays at the start of its piece."""
        self._catch_up()
        resting = self._moment
        self._moment = resting.copy()
        self._run(self._until_s, settle=True, heard=True)
        present, self._moment = self._moment, resting
        return present

    @property
    def theta_rad(self) -> float:
        """Angle of the distal link now. Reading it is an observation: it ends a span that may be jumped."""
        return float(self._present().x[scene.THETA])

    @property
    def energy_j(self) -> float:
        """Mechanical energy of the finger now, the contact's spring left out."""
        x, s = self._present().x, self.settings
        kinetic = s.inertia_kg_m2 * x[scene.OMEGA] ** 2 + s.base_inertia_kg_m2 * x[scene.BASE_RATE] ** 2
        bent = self._finger.joint * (x[scene.THETA] - x[scene.BASE]) ** 2 + s.base_n_m_rad * x[scene.BASE] ** 2
        return float(0.5 * (kinetic + bent))

    @property
    def force_n(self) -> float:
        """Force between probe and finger now, compression positive, without noise."""
        present, finger = self._present(), self._finger
        if present.flags[scene.MODE] != scene.TOUCHING:
            return 0.0
        position, velocity, _ = self._kernel.probe_at(
            self._motion, present.flags[scene.PIECE], present.whole[0], present.fraction[0], present.fraction[1]
        )
        depth = position - finger.gap - finger.arm * present.x[scene.THETA]
        speed = velocity - finger.arm * present.x[scene.OMEGA]
        return float(finger.contact * depth + finger.contact_damping * speed)


def _finite(name: str, number: float) -> float:
    if not math.isfinite(number):
        raise ValueError(f"finger: {name} is not finite ({number})")
    return number
