"""Two fingers' aura: what their bridges put out, at envelope and at carrier level."""

import cmath
import math
from collections.abc import Sequence
from functools import cached_property, lru_cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.messages import Floats, Ints
from simulator.physics.aura_drive import FRAME_HZ
from simulator.physics.aura_kernel import (
    Air,
    AuraThing,
    crossings,
    echoed,
    modulated,
    reflections,
    slow_waves,
)
from simulator.physics.aura_settings import (
    PAD_LENGTH_M,
    PAD_WIDTH_M,
    AuraObject,
    AuraPlantSettings,
    RoomSettings,
    Side,
)
from simulator.physics.noise import gaussian_at

Complexes = NDArray[np.complex128]

FINGERS = 2
RIGHT, LEFT = range(FINGERS)
BOTH = (RIGHT, LEFT)

ENVELOPE_HZ = 1000
"""Rate of the envelope (the project's; the paper's processed rate is not printed)."""

STREAM_PREAMPLIFIER = 64
STREAM_MOTION = 68
STREAM_CONVERTER = 72
STREAM_TRIAL = 74
"""Numbers of the noises among the bench's counter-based streams: two each for I and Q of each finger, one for each
finger's converter, one for what is drawn once a trial. Arms and boards have those below."""

PERIODS_S = np.geomspace(20.0, 600.0, 6)
"""Of the imbalance's slow wandering."""

NODE_S = 0.01
"""Interval at which it is computed; linear in between, which is off the curve by a millionth of itself."""

SCATTERED, DRAWN_LATER, DRAWN_ROOM = 2, 16, 64
"""Numbers of a trial's draws from which on the fingers' scatter, the wandering's phases and the room's are taken."""

SMOOTH = np.array([1.0, 2.0, 1.0]) / math.sqrt(6.0)
"""Motion's noise is white up to some 200 Hz: this on white noise, power 1."""

QUIET_ROOM = RoomSettings()

NO_THING = AuraThing(0.0, 0.0, -1.0, 0.0, 1.0)

COUNTS = 2**23
"""Counts of full scale: 24 bits (Rupavatharam et al., IV)."""


class AuraMotion(NamedTuple):
    """Where fingers and object are, instant by instant.

    Attributes:
        gap_m: From each finger's side to the object, in the direction in which it looks; below 0 where they are
            pressed into each other; infinite for a finger that does not look there. Shape (n, 2), right and left.
        y_m: Place of the fingers' middles across, from the object's, shape (n,).
        z_m: Height of the fingers' middles over their own at the start pose, shape (n,).
        width_m: Opening of the jaws, shape (n,).
        force_n: How hard each finger is pressed, shape (n, 2).
        speed_m_s: Of arm and jaws, shape (n,).
        x_m: Way of the tool along x since the start pose, shape (n,).
    """

    gap_m: Floats
    y_m: Floats
    z_m: Floats
    width_m: Floats
    force_n: Floats
    speed_m_s: Floats
    x_m: Floats


class AuraPlant:
    """Fingers, bridge and air; it remembers nothing from one instant to the next."""

    def __init__(self, settings: AuraPlantSettings) -> None:
        self.settings = settings
        self._air = Air(
            settings.decay_m,
            settings.decay_power,
            settings.air_db_m * math.log(10.0) / 20.0,
            settings.bounce,
            settings.edge,
        )
        self.begin((0, 0), None, 0.0, "normal")

    def begin(self, key: tuple[int, int], thing: AuraObject | None, top_m: float, side: Side) -> None:
        """Begin a trial.

        Args:
            key: Seed of the run and number of the trial, which key every noise.
            top_m: Height of its upper end over the middle of a finger at the start pose.
            side: Which side of the fingers it is before.
        """
        settings = self.settings
        self.key = key
        self._thing = thing
        self._shape = NO_THING
        if thing is not None:
            self._shape = AuraThing(
                thing.reflectivity, 0.5 * thing.depth_m, top_m - thing.height_m, top_m, thing.radius_m
            )
        about = settings.sides[side]
        self._side_rad = about.phase_rad
        for drawn in ("_reflected", "_phases_rad", "_gains", "_room_rad"):
            self.__dict__.pop(drawn, None)
        self._strength = about.sensitivity * self._shape.strength
        touched = 0.0 if thing is None else thing.coupling
        self._coupled = touched * about.coupling_fs * cmath.exp(1j * about.coupling_rad)

    # drawn when they are needed: what draws is compiled, and a plant that only describes itself needs none of it

    @cached_property
    def _reflected(self) -> complex:
        settings = self.settings
        drawn = gaussian_at(self.key, STREAM_TRIAL, np.arange(2, dtype=np.int64))
        scatter = 10.0 ** (settings.gain_scatter_db * float(drawn[0]) / 20.0)
        turn = cmath.exp(1j * (self._side_rad + settings.phase_scatter_rad * float(drawn[1])))
        reflected: complex = settings.reflection_fs * scatter * turn
        return reflected

    @cached_property
    def _phases_rad(self) -> Floats:
        numbers = DRAWN_LATER + np.arange(len(PERIODS_S) * 2 * FINGERS, dtype=np.int64)
        phases: Floats = gaussian_at(self.key, STREAM_TRIAL, numbers).reshape(len(PERIODS_S), -1)
        return 20.0 * phases  # so wide that it is uniform over the circle

    @cached_property
    def _gains(self) -> tuple[float, float]:
        settings = self.settings
        half_db = 0.5 * settings.mismatch_db
        gains_db = np.array([half_db, -half_db])
        if settings.finger_scatter_db:
            numbers = SCATTERED + np.arange(FINGERS, dtype=np.int64)
            gains_db += settings.finger_scatter_db * gaussian_at(self.key, STREAM_TRIAL, numbers)
        right_db, left_db = gains_db.tolist()
        return 10.0 ** (right_db / 20.0), 10.0 ** (left_db / 20.0)

    @cached_property
    def _room_rad(self) -> Floats:
        numbers = DRAWN_ROOM + np.arange(FINGERS * ROOM_PHASES, dtype=np.int64)
        return 20.0 * gaussian_at(self.key, STREAM_TRIAL, numbers).reshape(FINGERS, -1)

    def response(self, finger: int, frequency_hz: Floats) -> Complexes:
        """What of a drive gets through a finger and back, 1 where that is best (of two: where one is), shape (n,)."""
        found = np.ones(len(frequency_hz), dtype=np.complex128)
        for resonance_hz in self._resonances_hz(finger):
            ratio = np.maximum(frequency_hz, 1.0) / resonance_hz
            found *= 1.0 / (1.0 + 1j * self.settings.quality * (ratio - 1.0 / ratio))
        return found

    def field(
        self,
        motion: AuraMotion,
        times_s: Floats,
        frequency_hz: Floats,
        level: Floats,
        fingers: Sequence[int] = BOTH,
    ) -> Complexes:
        """What the bridges put out, against the drive's phase, without noise.

        Args:
            times_s: Since the trial began, shape (n,).
            frequency_hz: Of the drive, shape (n,).
            level: Of the drive, shape (n,).

        Returns:
            Shares of full scale, shape (n, 2); 0 for a finger that is not computed.
        """
        settings = self.settings
        warmed_k = settings.warming_k_s * times_s
        sound_m_s = settings.sound_m_s(settings.temperature_k) * np.sqrt(
            1.0 + warmed_k / settings.temperature_k
        )
        wave_rad_m = 2.0 * math.pi * frequency_hz / sound_m_s
        crossed = np.empty(len(times_s), dtype=np.complex128)
        between, gaps_m = NO_THING, motion.width_m  # of no object, whatever the gaps
        if self._thing is not None and np.isfinite(motion.gap_m).all():
            between, gaps_m = self._shape, np.maximum(motion.gap_m, 0.0).sum(axis=1)
        crossings(motion.width_m, gaps_m, motion.y_m, motion.z_m, wave_rad_m, between, self._air, crossed)
        drift_clock = 2.0 * math.pi * 1e-6 * settings.drive_ppm * frequency_hz * times_s
        turned = level * np.exp(1j * drift_clock) if settings.drive_ppm else level
        out = np.zeros((len(times_s), FINGERS), dtype=np.complex128)
        passed: dict[tuple[float, ...], Complexes] = {}
        for finger in fingers:
            received = self._bridge(finger, times_s, warmed_k) + settings.cross_fs * crossed
            if self._strength > 0.0 and np.isfinite(motion.gap_m[:, finger]).any():
                reflection = self._reflected * self._reflection(motion, finger, wave_rad_m)
                if settings.plate is not None:
                    gap_m = motion.gap_m[:, finger]
                    reflection *= plate_echo(settings.plate, gap_m, wave_rad_m, settings.decay_m)
                if settings.room.second_path:
                    late_rad = self._room_rad[finger, 0]
                    reflection *= second_path(settings.room, motion.gap_m[:, finger], wave_rad_m, late_rad)
                received += reflection
            if settings.room != QUIET_ROOM:
                room = (motion.x_m, motion.speed_m_s, times_s, wave_rad_m)
                received += room_field(settings.room, self._air, *room, self._room_rad[finger])
            pressed_n = motion.force_n[:, finger]
            if self._coupled and pressed_n.any():
                received -= self._coupled * np.expm1(-pressed_n / settings.force_n)
            resonances_hz = self._resonances_hz(finger)
            if resonances_hz not in passed:  # as a rule one for both
                passed[resonances_hz] = self.response(finger, frequency_hz)
            out[:, finger] = turned * self._gains[finger] * passed[resonances_hz] * received
        return out

    def _resonances_hz(self, finger: int) -> tuple[float, ...]:
        settings = self.settings
        return tuple(pair[finger] for pair in (settings.resonance_hz, settings.second_hz) if pair is not None)

    def envelope(
        self,
        motion: AuraMotion,
        numbers: Ints,
        times_s: Floats,
        frequency_hz: Floats,
        level: Floats,
        fingers: Sequence[int] = BOTH,
    ) -> Complexes:
        """`field` at instants of the envelope, with all noise; `numbers` are theirs on its grid, shape (n,)."""
        settings = self.settings
        out = self.field(motion, times_s, frequency_hz, level, fingers)
        sigma = settings.noise_fs_rthz * math.sqrt(ENVELOPE_HZ / (1.0 + 2.0 * settings.noise_colour))
        # white noise and its echo of a millisecond ago: the least that gives this correlation
        echo = _echo(settings.noise_colour)
        weights = sigma / math.hypot(1.0, echo) * np.array([1.0, echo])
        shaken = self._shaken(motion.speed_m_s) * level
        for finger in fingers:
            out[:, finger] += self._echoed(STREAM_PREAMPLIFIER, finger, numbers, weights)
            if shaken.any():
                out[:, finger] += shaken * self._echoed(STREAM_MOTION, finger, numbers, SMOOTH)
        return out

    def carrier(
        self,
        motion: AuraMotion,
        frames: Ints,
        origin_s: float,
        frequency_hz: Floats,
        level: Floats,
        phase_rad: Floats,
        fingers: Sequence[int] = BOTH,
    ) -> NDArray[np.int32]:
        """What the converter hands over, 24-bit counts, shape (n, 2).

        Args:
            motion: Where things are at each frame.
            frames: Consecutive numbers since the converter's time began, shape (n,).
            origin_s: When the trial began on the converter's clock.
            frequency_hz: Of the drive, shape (n,).
            level: Of the drive, shape (n,).
            phase_rad: Of the drive, shape (n,).
            fingers: Which are computed; the others read 0.
        """
        out = np.zeros((len(frames), FINGERS), dtype=np.int32)
        times_s = frames / FRAME_HZ - origin_s
        received = self.field(motion, times_s, frequency_hz, level, fingers)
        sigma = self.settings.noise_fs_rthz * math.sqrt(FRAME_HZ / 2.0)
        if motion.speed_m_s.any():
            self._shake(received, frames, self._shaken(motion.speed_m_s) * level, fingers)
        noise = np.zeros((FINGERS, len(frames)))
        for finger in fingers:
            noise[finger] = sigma * gaussian_at(self.key, STREAM_CONVERTER + finger, frames)
        modulated(received, phase_rad, noise, COUNTS, out)
        return out

    def _shake(self, received: Complexes, frames: Ints, shaken: Floats, fingers: Sequence[int]) -> None:
        """Add motion's noise at each frame, linear between milliseconds; `received` has shape (n, 2)."""
        share = frames % (FRAME_HZ // ENVELOPE_HZ) / (FRAME_HZ // ENVELOPE_HZ)
        ticks = frames // (FRAME_HZ // ENVELOPE_HZ)
        grid = np.arange(ticks[0], ticks[-1] + 2, dtype=np.int64)
        place = ticks - ticks[0]
        for finger in fingers:
            moved = self._echoed(STREAM_MOTION, finger, grid, SMOOTH)
            received[:, finger] += shaken * ((1.0 - share) * moved[place] + share * moved[place + 1])

    def _bridge(self, finger: int, times_s: Floats, warmed_k: Floats) -> Complexes:
        """What is left of the drive, shape (n,)."""
        settings = self.settings
        first, last = math.floor(times_s[0] / NODE_S), math.floor(times_s[-1] / NODE_S) + 1
        nodes_s = NODE_S * np.arange(first, last + 1)
        wander = np.empty(len(nodes_s), dtype=np.complex128)
        phases_rad = np.ascontiguousarray(self._phases_rad[:, 2 * finger : 2 * finger + 2])
        slow_waves(nodes_s, 2.0 * math.pi / PERIODS_S, phases_rad, wander)
        wander *= settings.drift_fs / math.sqrt(0.5 * len(PERIODS_S))
        rest = cmath.rect(settings.imbalance_fs[finger], settings.imbalance_rad[finger])
        warmed = 1.0 + 1j * settings.imbalance_per_k * warmed_k
        found: Complexes = rest * warmed + np.interp(times_s, nodes_s, wander)
        return found

    def _reflection(self, motion: AuraMotion, finger: int, wave_rad_m: Floats) -> Complexes:
        found = np.empty(len(wave_rad_m), dtype=np.complex128)
        reflections(
            np.ascontiguousarray(motion.gap_m[:, finger]),
            motion.y_m,
            motion.z_m,
            wave_rad_m,
            self._strength,
            self._shape,
            self._air,
            found,
        )
        return found

    def _shaken(self, speed_m_s: Floats) -> Floats:
        found: Floats = self.settings.motion_fs * np.sqrt(speed_m_s / 0.01)
        return found

    def _echoed(self, stream: int, finger: int, numbers: Ints, weights: Floats) -> Complexes:
        """A finger's noise in I and in Q, shape (n,)."""
        parts = np.empty((2, len(numbers)))
        for part in range(2):
            echoed(*self.key, stream + 2 * finger + part, numbers, weights, parts[part])
        found: Complexes = parts[0] + 1j * parts[1]
        return found


def _echo(colour: float) -> float:
    """Share of the sample before that correlates neighbours by `colour`: echo / (1 + echo^2)."""
    return 0.0 if colour == 0.0 else (1.0 - math.sqrt(1.0 - 4.0 * colour**2)) / (2.0 * colour)


PLATE_CELLS = (9, 18)
"""Pieces of a pad across and along, 3 mm each: less than half a wave."""

PLATE_STEP_M, PLATE_TO_M, PLATE_EVEN_M = 0.00025, 0.25, 0.025
"""Distances for which a plate's echo is computed; and the one at which it is as loud as a point's."""


@lru_cache(maxsize=32)
def _plate_echoes(plate: tuple[int, int], wave_rad_m: float, decay_m: float) -> Complexes:
    """An echo of a plate from a wide flat wall, over that of a point, at every `PLATE_STEP_M`.

    Each piece hears the mirror image of each: what they have between them depends on how far apart they are alone, so
    the pad's shape of vibration enters by its correlation with itself. Pieces radiate as points do (Rayleigh).
    """
    shapes, sides_m = [], (PAD_WIDTH_M, PAD_LENGTH_M)
    for cells, half_waves in zip(PLATE_CELLS, plate, strict=True):
        shapes.append(np.cos(math.pi * half_waves * (np.arange(cells) + 0.5) / cells))
    across, along = (np.correlate(shape, shape, "full") for shape in shapes)
    offsets_m = [
        side_m / cells * np.arange(1 - cells, cells)
        for side_m, cells in zip(sides_m, PLATE_CELLS, strict=True)
    ]
    beside_m2 = (offsets_m[0][:, None] ** 2 + offsets_m[1] ** 2).ravel()
    weights = np.outer(across, along).ravel()
    way_m = 2.0 * np.arange(0.0, PLATE_TO_M, PLATE_STEP_M)[:, None]
    between_m = np.sqrt(way_m**2 + beside_m2)
    spread = (way_m + decay_m) / (between_m + decay_m)
    found: Complexes = (weights * spread * np.exp(-1j * wave_rad_m * (between_m - way_m))).sum(axis=1)
    found /= abs(found[round(PLATE_EVEN_M / PLATE_STEP_M)])
    return found


def plate_echo(plate: tuple[int, int], gap_m: Floats, wave_rad_m: Floats, decay_m: float) -> Complexes:
    """Factor by which an echo changes where a pad sends and receives as a plate, shape (n,)."""
    table = _plate_echoes(plate, round(float(wave_rad_m[0]), 1), decay_m)
    places_m = PLATE_STEP_M * np.arange(len(table))
    found: Complexes = np.interp(np.maximum(gap_m, 0.0), places_m, table)
    return found


ROOM_PHASES = 16
"""Phases that a finger draws for a trial: of the second path, two each of ripple and vibration, then of the echoes."""

MOVING_M_S = 0.002
"""Speed from which on a vibration is there in full. Assumption."""


def second_path(room: RoomSettings, gap_m: Floats, wave_rad_m: Floats, turned_rad: float) -> Complexes:
    """Factor by which sound that comes back by way of a surface beside the fingers changes an echo, shape (n,)."""
    near_m = np.where(np.isfinite(gap_m), np.maximum(gap_m, 0.0), 1.0)
    longer_m = np.hypot(near_m, 2.0 * room.second_path_m) - near_m
    found: Complexes = 1.0 + room.second_path * np.exp(1j * (turned_rad - wave_rad_m * longer_m))
    return found


def room_field(
    room: RoomSettings,
    air: Air,
    x_m: Floats,
    speed_m_s: Floats,
    times_s: Floats,
    wave_rad_m: Floats,
    phases_rad: Floats,
) -> Complexes:
    """What the room adds to a finger's bridge, shares of full scale at full drive, shape (n,).

    Args:
        x_m: Way of the tool since the start pose, shape (n,).
        speed_m_s: Of the mechanism, shape (n,).
        times_s: Shape (n,).
        wave_rad_m: Wave number, shape (n,).
        phases_rad: Drawn for this finger and trial, shape (ROOM_PHASES,).
    """
    found = np.zeros(len(x_m), dtype=np.complex128)
    for echo, turned_rad in zip(room.echoes, phases_rad[5:], strict=False):
        to_and_fro_m = echo.stroke_m * np.sin(2.0 * np.pi * echo.stroke_hz * times_s + turned_rad)
        way_m = np.maximum(echo.away_m - echo.cosine * x_m + to_and_fro_m, 0.0)
        nearer = ((air.decay_m + echo.away_m) / (air.decay_m + way_m)) ** air.decay_power
        found += echo.size_fs * nearer * np.exp(1j * (turned_rad - 2.0 * wave_rad_m * way_m))
    teeth = np.cos(2.0 * np.pi * x_m / room.ripple_m + phases_rad[1])
    found += room.ripple_fs * np.exp(1j * phases_rad[2]) * teeth
    shaken = np.minimum(speed_m_s / MOVING_M_S, 1.0) * np.cos(
        2.0 * np.pi * room.vibration_hz * times_s + phases_rad[3]
    )
    found += room.vibration_fs * np.exp(1j * phases_rad[4]) * shaken
    return found
