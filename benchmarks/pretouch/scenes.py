"""Passages of a finger to an object and back, without an object, and by the other finger.

Straight from the aura's plant, with the arm's motion and encoder written down here: no driver, no loop. What the plant
assumes: docs/explanation/aura.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from drivers.messages import SampleBlock
from drivers.mock.physics.aura import BOTH, LEFT, RIGHT, AuraMotion, AuraPlant
from drivers.mock.physics.aura_drive import FRAME_HZ
from drivers.mock.physics.aura_objects import NOTHING, OBJECTS, SIDES, SIX, Side
from drivers.mock.physics.gripper_part import AuraBenchSettings

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

Kind = Literal["touch", "near", "nothing", "other_side", "drift"]

KINDS: dict[Kind, str] = {
    "touch": "to the object, against it by 0.5 mm, and back",
    "near": "to 0.4 cm from the object, and back",
    "nothing": "the same motion before nothing",
    "other_side": "the other finger, which does not look at the object",
    "drift": "standing still before nothing, while bridge and air warm up by 0.02 K/s",
}

POSITIVE: tuple[Kind, ...] = ("touch", "near")
"""Of pre-touch; of contact only the first is."""

RATE_HZ = 1000.0
"""Of the envelope."""

ENCODER_HZ = 500.0
"""Of the arm's encoder (wire/rtde: 500 Hz)."""

ENCODER_NOISE_M = 1e-5
"""Standard deviation of its readings. Assumption: a third of the arm's repeatability of 0.03 mm."""

START_M, END_M = 0.055, 0.004
"""Rupavatharam et al., IV.A.1: from 5.5 cm to 0.4 cm."""

PRESS_M = 0.0005
"""Travel of the finger after the touch. Assumption: half of its foam."""

ACCELERATION_M_S2 = 0.5
"""Of the arm. Assumption: as the mock arm's."""

HOLD_S = 1.5
"""At the end of the way. Assumption; Fig. 7 shows about 2 s."""

SPEEDS_M_S = (0.01, 0.03)
"""Fig. 4d."""

LEVEL = 0.5
"""Of the drive."""

DRIVE_HZ = 40_000.0

SOUND_ERROR = 0.02
"""By how much the real speed of sound differs from the detectors' setting, either way."""

WARMING_K_S = 0.02
"""While it drifts. Assumption: a bridge in its first minutes."""

NOMINAL_K = 293.15


@dataclass(frozen=True)
class Event:
    """One passage to be simulated; equal events give identical passages.

    Attributes:
        seed: Of the study's part: calibration and test share no noise.
        number: Of the passage: keys its noise.
        kind: What happens.
        object: What stands there.
        side: Which side of the finger goes ahead.
        speed_m_s: Of the arm.
        weaker_db: Reduction of the echo against the plant's default.
        start_m: Distance at the beginning.
    """

    seed: int
    number: int
    kind: Kind
    object: str
    side: Side
    speed_m_s: float
    weaker_db: float = 0.0
    start_m: float = START_M


@dataclass(frozen=True)
class PassageRecord:
    """Signals and truth of a passage.

    Attributes:
        event: The simulated event.
        z: Envelope, shape (n,).
        position_m: The encoder's readings interpolated to the envelope's instants, shape (n,).
        encoder: The readings themselves, `arm.position`.
        gap_m: Distance to the object, infinite without an object, shape (n,).
        begun: Sample at which the approach began.
        arrived: Sample at which it ended.
        touched: Sample of the first touch, None without one.
        released: First sample after the last touch.
        times_s: Of the samples, shape (n,).
    """

    event: Event
    z: Complexes
    position_m: Floats
    encoder: SampleBlock
    gap_m: Floats
    begun: int
    arrived: int
    touched: int | None
    released: int | None

    times_s: Floats

    @property
    def block(self) -> SampleBlock:
        """The envelope as the detectors receive it, `signals.right`."""
        values = np.ascontiguousarray(self.z).view(np.float64).reshape(-1, 2)
        return SampleBlock("signals.right", 0, float(self.times_s[0]), values, rate_hz=RATE_HZ, unit="FS")


@dataclass(frozen=True)
class PassageCourse:
    """Positions of arm and object at some instants, and the start of each phase."""

    way_m: Floats
    motion: AuraMotion
    begun_s: float
    arrived_s: float


def settings_of(event: Event) -> AuraBenchSettings:
    """The plant's: air 2 % faster or slower than the detectors assume, in turn."""
    ratio = 1.0 + (SOUND_ERROR if event.number % 2 else -SOUND_ERROR)
    warming = WARMING_K_S if event.kind == "drift" else 0.0
    found = AuraBenchSettings(
        scene="ahead", temperature_k=NOMINAL_K * ratio * ratio, warming_k_s=warming, side=event.side
    )
    weaker_fs = found.reflection_fs * 10.0 ** (-event.weaker_db / 20.0)
    return found.model_copy(update={"reflection_fs": weaker_fs})


def ramp(times_s: Floats, length_m: float, speed_m_s: float) -> tuple[Floats, float]:
    """Way along a motion that begins at 0, and how long it takes."""
    rise_s = speed_m_s / ACCELERATION_M_S2
    total_s = length_m / speed_m_s + rise_s
    t = np.clip(times_s, 0.0, total_s)
    way_m = (
        0.5 * ACCELERATION_M_S2 * np.minimum(t, rise_s) ** 2
        + speed_m_s * np.clip(t - rise_s, 0.0, total_s - 2.0 * rise_s)
        + speed_m_s * np.maximum(t - (total_s - rise_s), 0.0)
        - 0.5 * ACCELERATION_M_S2 * np.maximum(t - (total_s - rise_s), 0.0) ** 2
    )
    return way_m, total_s


def duration_s(event: Event) -> float:
    """Of a passage."""
    return _rest_s(event) + 2.0 * (_length_m(event) / event.speed_m_s + 0.06) + HOLD_S + 0.5


def _length_m(event: Event) -> float:
    return event.start_m + PRESS_M if event.kind == "touch" else event.start_m - END_M


def _rest_s(event: Event) -> float:
    """Rest before the approach: not the same each time, so that no window of time is favoured."""
    draw = np.random.default_rng((event.seed, event.number, 1)).random()
    return 1.5 + float(draw)


def course(event: Event, times_s: Floats) -> PassageCourse:
    """The course at instants since the passage began."""
    rest_s, length_m = _rest_s(event), _length_m(event)
    forth_m, takes_s = ramp(times_s - rest_s, length_m, event.speed_m_s)
    back_m, _ = ramp(times_s - rest_s - takes_s - HOLD_S, length_m, event.speed_m_s)
    way_m = forth_m - back_m
    if event.kind == "drift":
        way_m = np.zeros_like(way_m)
    n = len(times_s)
    gap_m = np.full((n, 2), np.inf)
    if event.object != NOTHING:
        gap_m[:, RIGHT] = event.start_m - way_m
    force_n = np.zeros((n, 2))
    force_n[:, RIGHT] = AuraBenchSettings().press_n_m * np.maximum(-gap_m[:, RIGHT], 0.0)
    speed_m_s = np.abs(np.gradient(way_m, times_s)) if n > 1 else np.zeros(n)
    motion = AuraMotion(gap_m, np.zeros(n), np.zeros(n), np.full(n, 0.063), force_n, speed_m_s, way_m)
    return PassageCourse(way_m, motion, rest_s, rest_s + takes_s)


def plant_of(event: Event) -> AuraPlant:
    """The plant, at the beginning of the passage."""
    settings = settings_of(event)
    plant = AuraPlant(settings)
    thing = OBJECTS.get(event.object)
    plant.begin((event.seed, event.number), thing, settings.object_top_m, event.side)
    return plant


def finger_of(event: Event) -> int:
    """The receiving finger."""
    return LEFT if event.kind == "other_side" else RIGHT


def encoder_of(event: Event, until_s: float) -> SampleBlock:
    """The arm's readings."""
    times_s = np.arange(math.ceil(until_s * ENCODER_HZ) + 2) / ENCODER_HZ
    noise_m = ENCODER_NOISE_M * np.random.default_rng((event.seed, event.number, 2)).standard_normal(
        len(times_s)
    )
    values = (course(event, times_s).way_m + noise_m)[:, None]
    return SampleBlock("arm.position", 0, 0.0, values, rate_hz=ENCODER_HZ, unit="m")


def passage(event: Event) -> PassageRecord:
    """Simulate one, at envelope level."""
    n = round(duration_s(event) * RATE_HZ)
    numbers = np.arange(n, dtype=np.int64)
    times_s = numbers / RATE_HZ
    found = course(event, times_s)
    finger = finger_of(event)
    z = plant_of(event).envelope(
        found.motion, numbers, times_s, np.full(n, DRIVE_HZ), np.full(n, LEVEL), (finger,)
    )[:, finger]
    return record_of(event, times_s, z, found)


CHUNK = 96_000
"""Frames that are simulated at a time, so that a passage needs little memory."""


def passage_by_carrier(event: Event) -> PassageRecord:
    """The same at carrier level: 96 kHz, 24 bits, through the real chain (`controller.signals.iq`)."""
    from controller.signals.iq import Iq, IqSettings

    plant, finger = plant_of(event), finger_of(event)
    chain = Iq("right", IqSettings(channel=finger))
    total = round(duration_s(event) * FRAME_HZ)
    pieces: list[SampleBlock] = []
    for first in range(0, total, CHUNK):
        frames = np.arange(first, min(first + CHUNK, total), dtype=np.int64)
        n = len(frames)
        motion = course(event, frames / FRAME_HZ).motion
        # exact: 5/12 of a turn a frame
        phase_rad = np.asarray(2.0 * math.pi / 12.0 * (frames * 5 % 12), np.float64)
        counts = plant.carrier(
            motion, frames, 0.0, np.full(n, DRIVE_HZ), np.full(n, LEVEL), phase_rad, (finger,)
        )
        block = SampleBlock(
            "audio.fingers", first, first / FRAME_HZ, counts, rate_hz=FRAME_HZ, unit="FS", scale=2.0**-23
        )
        pieces += [made for made in chain.push(block) if isinstance(made, SampleBlock)]
    times_s = np.concatenate([piece.times for piece in pieces])
    values = np.concatenate([piece.physical for piece in pieces])
    return record_of(event, times_s, values[:, 0] + 1j * values[:, 1], course(event, times_s))


def template(event: Event) -> tuple[Complexes, Complexes, Floats]:
    """The plant's truth of a passage, for the clairvoyant.

    Returns:
        What the object adds to the envelope (before nothing: what an object of the six would have added), the envelope
        without object and noise, and the standard deviation of the noise on I and on Q, each shape (n,).
    """
    n = round(duration_s(event) * RATE_HZ)
    times_s = np.arange(n) / RATE_HZ
    frequency_hz, level = np.full(n, DRIVE_HZ), np.full(n, LEVEL)
    finger = finger_of(event)
    own = course(event, times_s).motion
    without = replace(event, object=NOTHING)
    bare_motion = own._replace(gap_m=np.full((n, 2), np.inf), force_n=np.zeros((n, 2)))
    bare = plant_of(without).field(bare_motion, times_s, frequency_hz, level, BOTH)
    supposed = event if event.object != NOTHING else replace(event, object=SIX[event.number % len(SIX)])
    way_m = course(replace(supposed, kind="near"), times_s).motion.gap_m[:, RIGHT]
    near_motion = bare_motion._replace(gap_m=np.column_stack((way_m, np.full(n, np.inf))))
    seen = plant_of(supposed).field(near_motion, times_s, frequency_hz, level, (RIGHT,))
    settings = settings_of(event)
    quiet_fs = settings.noise_fs_rthz * math.sqrt(RATE_HZ / (1.0 + 2.0 * settings.noise_colour))
    sigma_fs = np.hypot(quiet_fs, settings.motion_fs * np.sqrt(own.speed_m_s / 0.01) * LEVEL)
    return seen[:, RIGHT] - bare[:, RIGHT], bare[:, finger], sigma_fs


def record_of(event: Event, times_s: Floats, z: Complexes, found: PassageCourse) -> PassageRecord:
    """A passage from its envelope at given instants, 1 kHz apart."""
    encoder = encoder_of(event, float(times_s[-1]))
    position_m = np.interp(times_s, encoder.times, encoder.values[:, 0])
    gap_m = found.motion.gap_m[:, RIGHT]
    touching = np.flatnonzero(gap_m <= 0.0)
    return PassageRecord(
        event,
        z,
        position_m,
        encoder,
        gap_m,
        int(np.searchsorted(times_s, found.begun_s)),
        int(np.searchsorted(times_s, found.arrived_s)),
        int(touching[0]) if len(touching) else None,
        int(touching[-1]) + 1 if len(touching) else None,
        times_s,
    )


def events(
    seed: int,
    touches: int,
    nears: int,
    others: int,
    objects: tuple[str, ...] = SIX,
    weaker_db: float = 0.0,
) -> Iterator[Event]:
    """The passages of one part of the study.

    Args:
        seed: Of the part.
        touches: For each object, side and speed.
        nears: Likewise.
        others: Of each other kind, for each side and speed.
        objects: Which.
        weaker_db: Reduction of the echo against the plant's default.
    """
    number = 0
    for speed_m_s in SPEEDS_M_S:
        for side in SIDES:
            wanted: list[tuple[Kind, str, int]] = []
            for name in objects:
                wanted += [("touch", name, touches), ("near", name, nears)]
            wanted += [("nothing", NOTHING, others), ("drift", NOTHING, others)]
            wanted += [("other_side", objects[i % len(objects)], 1) for i in range(others)]
            for kind, name, count in wanted:
                for _ in range(count):
                    yield Event(seed, number, kind, name, side, speed_m_s, weaker_db)
                    number += 1
