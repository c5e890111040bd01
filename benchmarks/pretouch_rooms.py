"""Pre-touch in difficult rooms: walls, gears, vibration, oblique paths, warm air, other movers.

`python -m benchmarks pretouch_rooms`. One threshold is set on random rooms; and for each room one of its own, and with
it our background, on other passages of the same kind. Rates are from other rooms, one nuisance at a time and all at
once; some kinds are in no room that sets the one threshold (`NEVER`). Sizes in full scales are as received by a finger,
at the study's drive. A room is drawn anew for each passage.
"""

import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmarks.pretouch import DRIVE_HZ, END_M, LEVEL, RATE_HZ, START_M, Complexes, ramp, rate
from benchmarks.results import in_parallel, save, workers
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from drivers.core.messages import Floats
from simulator.physics.aura import RIGHT, AuraMotion, AuraPlant
from simulator.physics.aura_settings import OBJECTS, SIDES, SIX, EchoSettings, RoomSettings, Side
from simulator.physics.gripper_part import AuraBenchSettings

Rng = np.random.Generator

UNDULATION_M = 0.00429
"""Half a wavelength at 40 kHz."""

REST_S, HOLD_S = 0.6, 0.3
"""Rest before the motion and at its end."""

JITTER_HZ = 0.7
"""Of a mover's speed. Assumption: a badly tuned axis, slow enough to shift by a part of an undulation."""

SAME_M = 0.025
"""Distance at which echoes of other growth are equally loud."""

TRAINING = "training"


class Room(NamedTuple):
    """The room of one passage.

    Attributes:
        settings: Of the plant.
        slant_deg: Angle between the path and the finger's face.
        jitter: Amplitude of the speed's swing, as a share of it.
        object_share: Speed at which the object comes nearer by itself, as a share of the mover's.
        sound: Ratio of the real speed of sound to the one assumed by the detectors.
        growth: Of the echo's power of distance, as a share of the plant's own; from 2.5 cm it is as loud.
        late_s: By how much the encoder is late.
    """

    settings: RoomSettings = RoomSettings()
    slant_deg: float = 0.0
    jitter: float = 0.0
    object_share: float = 0.0
    sound: float = 1.0
    growth: float = 1.0
    late_s: float = 0.0


def walls(rng: Rng, echo_fs: float) -> tuple[EchoSettings, ...]:
    """One to three still echoes from a quarter of a metre on, in any direction, of size `echo_fs` together."""
    count = int(rng.integers(1, 4))
    shares = np.sqrt(rng.dirichlet(np.ones(count)))
    return tuple(
        EchoSettings(size_fs=float(share) * echo_fs / LEVEL, away_m=rng.uniform(0.25, 1.0), cosine=cosine)
        for share, cosine in zip(shares, rng.uniform(-1.0, 1.0, count), strict=True)
    )


def facing(rng: Rng, echo_fs: float) -> tuple[EchoSettings, ...]:
    """One wall straight ahead or behind: its echo turns as the object's does."""
    cosine = float(rng.choice((-1.0, 1.0)))
    return (EchoSettings(size_fs=echo_fs / LEVEL, away_m=rng.uniform(0.25, 1.0), cosine=cosine),)


def before(rng: Rng, echo_fs: float) -> tuple[EchoSettings, ...]:
    """A wall 10 to 15 cm ahead: its echo grows on the way."""
    return (EchoSettings(size_fs=echo_fs / LEVEL, away_m=rng.uniform(0.10, 0.15), cosine=1.0),)


def mains(mains_fs: float) -> RoomSettings:
    """A hum at 50 Hz while the mechanism moves."""
    return RoomSettings(vibration_fs=mains_fs / LEVEL, vibration_hz=50.0)


def mover(rng: Rng, echo_fs: float) -> tuple[EchoSettings, ...]:
    """Something half a metre away that moves to and fro by 5 cm."""
    about = {"away_m": 0.5, "cosine": 0.0, "stroke_m": 0.05, "stroke_hz": rng.uniform(0.1, 0.5)}
    return (EchoSettings(size_fs=echo_fs / LEVEL, **about),)


def shaken(rng: Rng, speed_m_s: float, ripple_fs: float, vibration_fs: float) -> RoomSettings:
    """Gear ripple of about the undulation's length and a vibration at its rate, each up to a fifth off."""
    off = rng.uniform(0.8, 1.2, 2)
    return RoomSettings(
        ripple_fs=ripple_fs / LEVEL,
        ripple_m=off[0] * UNDULATION_M,
        vibration_fs=vibration_fs / LEVEL,
        vibration_hz=off[1] * speed_m_s / UNDULATION_M,
    )


def _training(rng: Rng, speed_m_s: float) -> Room:
    """Rooms for setting thresholds: all effects at random, sizes from zero to twice the largest that is judged."""
    sizes_fs = 10.0 ** rng.uniform(-6.0, math.log10(2e-4), 4)
    echoes = (walls, facing)[int(rng.integers(2))](rng, sizes_fs[0]) + mover(rng, sizes_fs[3])
    moved = shaken(rng, speed_m_s, sizes_fs[1], sizes_fs[2])
    kept = rng.random(4) < 0.5
    settings = RoomSettings(
        echoes=tuple(echo for echo in echoes if kept[3 if echo.stroke_m else 0]),
        ripple_fs=moved.ripple_fs * kept[1],
        ripple_m=moved.ripple_m,
        vibration_fs=moved.vibration_fs * kept[2],
        vibration_hz=moved.vibration_hz,
    )
    return Room(settings, jitter=rng.uniform(0.0, 0.2), sound=rng.uniform(0.95, 1.05))


def _echoes(kind: Callable[[Rng, float], tuple[EchoSettings, ...]], echo_fs: float) -> Callable[..., Room]:
    return lambda rng, speed_m_s: Room(RoomSettings(echoes=kind(rng, echo_fs)))


def _off(sound: float) -> Callable[..., Room]:
    return lambda rng, speed_m_s: Room(sound=1.0 + sound * float(rng.choice((-1.0, 1.0))))


ROOMS: Mapping[str, Callable[[Rng, float], Room]] = {
    TRAINING: _training,
    "empty": lambda rng, speed_m_s: Room(),
    "walls 1e-5": _echoes(walls, 1e-5),
    "walls 3e-5": _echoes(walls, 3e-5),
    "walls 1e-4": _echoes(walls, 1e-4),
    "a wall that faces, 3e-5": _echoes(facing, 3e-5),
    "a wall that faces, 1e-4": _echoes(facing, 1e-4),
    "ripple 3e-5": lambda rng, speed_m_s: Room(shaken(rng, speed_m_s, 3e-5, 0.0)),
    "ripple 1e-4": lambda rng, speed_m_s: Room(shaken(rng, speed_m_s, 1e-4, 0.0)),
    "vibration 3e-5": lambda rng, speed_m_s: Room(shaken(rng, speed_m_s, 0.0, 3e-5)),
    "vibration 1e-4": lambda rng, speed_m_s: Room(shaken(rng, speed_m_s, 0.0, 1e-4)),
    "second mover 1e-4": _echoes(mover, 1e-4),
    "second path 5 %": lambda rng, speed_m_s: Room(RoomSettings(second_path=0.05)),
    "second path 10 %": lambda rng, speed_m_s: Room(RoomSettings(second_path=0.1)),
    "second path 30 %": lambda rng, speed_m_s: Room(RoomSettings(second_path=0.3)),
    "grows by 5 % less": lambda rng, speed_m_s: Room(growth=0.95),
    "grows by 10 % less": lambda rng, speed_m_s: Room(growth=0.9),
    "grows by 30 % less": lambda rng, speed_m_s: Room(growth=0.7),
    "20 degrees oblique": lambda rng, speed_m_s: Room(slant_deg=20.0),
    "40 degrees oblique": lambda rng, speed_m_s: Room(slant_deg=40.0),
    "speed swings by 20 %": lambda rng, speed_m_s: Room(jitter=0.2),
    "sound off by 5 %": _off(0.05),
    "sound off by 8 %": _off(0.08),
    "sound off by 10 %": _off(0.10),
    "sound off by 30 %": _off(0.30),
    "object moves by 30 %": lambda rng, speed_m_s: Room(object_share=0.3 * float(rng.choice((-1.0, 1.0)))),
    "all at once": lambda rng, speed_m_s: Room(
        shaken(rng, speed_m_s, 2e-5, 2e-5).model_copy(
            update={"echoes": walls(rng, 5e-5) + mover(rng, 2e-5), "second_path": 0.1}
        ),
        slant_deg=20.0,
        jitter=0.1,
        sound=1.0 + 0.05 * float(rng.choice((-1.0, 1.0))),
    ),
    "a wall 10 to 15 cm ahead, 3e-5": _echoes(before, 3e-5),
    "a wall 10 to 15 cm ahead, 1e-4": _echoes(before, 1e-4),
    "mains 1e-4": lambda rng, speed_m_s: Room(mains(1e-4)),
    "mains 1e-3": lambda rng, speed_m_s: Room(mains(1e-3)),
    "encoder 20 ms late": lambda rng, speed_m_s: Room(late_s=0.02),
}
"""By name. Each is drawn with a passage's own generator."""

NEVER = (
    "a wall 10",
    "mains",
    "encoder",
    "second path",
    "grows by",
    "20 degrees",
    "40 degrees",
    "object moves",
)
"""Beginnings of rooms of which nothing is in those that set the one threshold."""


@dataclass(frozen=True)
class Passing:
    """One passage. Seed and number key its noise and its room: setting and judging share neither. Without an object it
    is a motion to and fro; the echo is weaker than the plant's default."""

    seed: int
    number: int
    room: str
    object: str | None
    weaker_db: float = 0.0

    @property
    def speed_m_s(self) -> float:
        """Of the mover: 0.01 and 0.03 m/s in turn (Fig. 4d)."""
        return (0.01, 0.03)[self.number % 2]

    @property
    def side(self) -> Side:
        """Of the finger: all five in turn."""
        return SIDES[self.number // 2 % len(SIDES)]


def simulate(passing: Passing) -> tuple[Complexes, Floats, Floats]:
    """Simulate a passage at envelope level, rest, way to the object, and without one the way back: the envelope, the
    encoder's position and the distance to the object, each of shape (n,)."""
    rng = np.random.default_rng((passing.seed, passing.number))
    room = ROOMS[passing.room](rng, passing.speed_m_s)
    slant_rad = math.radians(room.slant_deg)
    approach = (1.0 + room.object_share) * math.cos(slant_rad)
    length_m = (START_M - END_M) / approach
    takes_s = length_m / passing.speed_m_s + passing.speed_m_s / 0.5
    ways = 1 if passing.object else 2
    n = round((REST_S + ways * (takes_s + HOLD_S)) * RATE_HZ)
    numbers = np.arange(n, dtype=np.int64)
    times_s = numbers / RATE_HZ
    way_m, _ = ramp(times_s - REST_S, length_m, passing.speed_m_s)
    way_m = way_m - ramp(times_s - REST_S - takes_s - HOLD_S, length_m, passing.speed_m_s)[0]
    swing_m = room.jitter * passing.speed_m_s / (2.0 * math.pi * JITTER_HZ)
    inside = np.clip(np.minimum(way_m, length_m - way_m) / 0.002, 0.0, 1.0)
    way_m = way_m + swing_m * inside * np.sin(2.0 * math.pi * JITTER_HZ * times_s + rng.uniform(0.0, 6.28))
    gap_m = np.full((n, 2), np.inf)
    beside_m = np.zeros(n)
    if passing.object:
        gap_m[:, RIGHT] = START_M - approach * way_m
        beside_m = (length_m - way_m) * math.sin(slant_rad)
    speed_m_s = np.abs(np.gradient(way_m, times_s))
    ahead_m, width_m = way_m * math.cos(slant_rad), np.full(n, 0.063)
    motion = AuraMotion(gap_m, beside_m, np.zeros(n), width_m, np.zeros((n, 2)), speed_m_s, ahead_m)
    plant = plant_of(passing, room)
    drive = (np.full(n, DRIVE_HZ / room.sound), np.full(n, LEVEL))
    z = plant.envelope(motion, numbers, times_s, *drive, (RIGHT,))[:, RIGHT]
    noise_m = 1e-5 * rng.standard_normal(n // 2 + 1)  # the encoder at 500 Hz
    known_m = np.interp(times_s - room.late_s, times_s, way_m) if room.late_s else way_m
    position_m = known_m + np.interp(numbers, np.arange(n // 2 + 1) * 2, noise_m)
    return z, position_m, gap_m[:, RIGHT]


def plant_of(passing: Passing, room: Room) -> AuraPlant:
    """The plant at the beginning of a passage."""
    plain = AuraBenchSettings(scene="ahead", side=passing.side)
    weaker_fs = plain.reflection_fs * 10.0 ** (-passing.weaker_db / 20.0)
    power = plain.decay_power * room.growth
    weaker_fs *= (1.0 + SAME_M / plain.decay_m) ** (power - plain.decay_power)
    # a lower drive stands for faster sound: no temperature reaches these values
    about = {"reflection_fs": weaker_fs, "decay_power": power, "resonance_hz": (DRIVE_HZ / room.sound,) * 2}
    plant = AuraPlant(plain.model_copy(update={**about, "room": room.settings}))
    thing = OBJECTS.get(passing.object or "")
    plant.begin((passing.seed, passing.number), thing, plain.object_top_m, passing.side)
    return plant


def passings(seed: int, room: str, nothing: int, objects: int, weaker_db: float = 0.0) -> list[Passing]:
    """Passages through one room, without an object and to the six objects in turn."""
    first = 100_000 * list(ROOMS).index(room)
    quiet = [Passing(seed, first + i, room, None) for i in range(nothing)]
    seen = [Passing(seed, first + 50_000 + i, room, SIX[i // 10 % 6], weaker_db) for i in range(objects)]
    return quiet + seen


# --- detectors ---------------------------------------------------------------------------------


TNR = 0.99
"""Of whole passages, on the rooms that set thresholds."""

NEEDED_M = 0.025
"""Distance from which an object must be detected."""

SEED_TRAINING, SEED_JUDGED, SEED_OWN = 61_000, 62_000, 63_000
STRENGTHS_DB = (0.0, 17.0)
"""Reductions of the echo: none, and so that the paper's detector has the paper's
rate (results/pretouch.md)."""

WINDOWS_S = (0.125, 0.25, 0.5)
TURNS = (2, 3)
OURS = "pretouch"
OWN = {
    OURS: PreTouchSettings(),
    "pretouch, set for an empty room": PreTouchSettings(background_fs=0.0, obliquity=(1.0,)),
}
AS_IT_IS = "pretouch, own threshold"
OF_THE_ROOM = "pretouch, background of the room"
EVERY = 10
"""Samples between outputs of the rival with the commanded speed."""


def statistics(z: Complexes, position_m: Floats, speed_m_s: float) -> dict[str, Floats]:
    """Each detector's statistic, sample by sample; NaN where it has none."""
    values = np.column_stack((z.real, z.imag, position_m))
    found = {}
    for window_s in WINDOWS_S:
        paper = PreTouchPaperDetector("paper", PreTouchPaperSettings(window_s=window_s))
        found[f"paper, {window_s:g} s"] = paper.statistic(values[:, :1], RATE_HZ)
    for turns in TURNS:
        found[f"I and Q at the commanded speed, {turns}"] = commanded(z, speed_m_s, turns)
    waves = [commanded(z, speed_m_s, TURNS[0], share) for share in OWN[OURS].obliquity]
    found[f"I and Q at the commanded speed, {TURNS[0]}, seven waves"] = np.fmax.reduce(waves)
    for name, settings in OWN.items():
        found[name] = PreTouchDetector(name, settings).statistic(values, RATE_HZ)
    return found


def commanded(z: Complexes, speed_m_s: float, turns: int, share: float = 1.0) -> Floats:
    """Power of the wave that an object makes at the commanded speed times `share`, over so many undulations.

    A rival: it uses I and Q and the commanded speed, and needs no encoder. The window's level cancels,
    since it holds whole turns; a slope is estimated from its halves and removed. Shape (n,).
    """
    n = round(turns * UNDULATION_M / (share * speed_m_s) * RATE_HZ)
    rate_rad = 2.0 * math.pi * turns / n
    ends = np.arange(n, len(z) + 1, EVERY)
    found = np.full(len(z), np.nan)
    if not len(ends):
        return found
    level = np.concatenate(([0.0], np.cumsum(z)))
    half = n // 2
    late, early = level[ends] - level[ends - half], level[ends - half] - level[ends - n]
    slope = (late / half - early / (n - half)) / (n / 2.0)
    inside = np.arange(n)
    powers = []
    for sense in (1.0, -1.0):
        wave = np.exp(-1j * sense * rate_rad * np.arange(len(z)))
        turned = np.concatenate(([0.0], np.cumsum(z * wave)))
        ramp = np.sum(np.exp(-1j * sense * rate_rad * inside) * (inside - inside.mean())) * wave[ends - n]
        powers.append(np.abs((turned[ends] - turned[ends - n] - slope * ramp) / n) ** 2)
    found[ends - 1] = np.maximum(*powers)
    return found


Rising = Mapping[str, Floats]
"""By detector: each new largest statistic of a passage, and the distance at which it was reached, shape (2, m)."""


def judged(passing: Passing) -> Rising:
    """Apply every detector to a passage."""
    z, position_m, gap_m = simulate(passing)
    found = statistics(z, position_m, passing.speed_m_s)
    rising = {name: _rising(trace, gap_m) for name, trace in found.items()}
    return {**rising, AS_IT_IS: rising[OURS]}


def background_fs(passing: Passing) -> float:
    """Background that `calibrate` would propose after this passage."""
    z, position_m, _ = simulate(passing)
    columns = np.column_stack((z.real, z.imag, position_m))
    return PreTouchDetector(OURS, PreTouchSettings()).proposed(columns, RATE_HZ)["background_fs"]


def judged_at(given: tuple[Passing, float]) -> Rising:
    """Apply ours with a background to a passage."""
    passing, still_fs = given
    z, position_m, gap_m = simulate(passing)
    detector = PreTouchDetector(OURS, PreTouchSettings(background_fs=still_fs))
    trace = detector.statistic(np.column_stack((z.real, z.imag, position_m)), RATE_HZ)
    return {OF_THE_ROOM: _rising(trace, gap_m)}


def _rising(trace: Floats, gap_m: Floats) -> Floats:
    largest = np.maximum.accumulate(np.where(np.isnan(trace), -np.inf, trace))
    new = np.flatnonzero(largest > np.concatenate(([-np.inf], largest[:-1])))
    return np.vstack((largest[new], gap_m[new]))


def largest(rising: Rising, name: str) -> float:
    """Of a passage's statistics."""
    return float(rising[name][0, -1]) if rising[name].size else -math.inf


def seen_m(rising: Rising, name: str, threshold: float) -> float:
    """Distance at which the object was first seen, 0 where it was not."""
    values, gaps_m = rising[name]
    first = int(np.searchsorted(values, threshold, side="right"))
    return float(gaps_m[first]) if first < len(values) else 0.0


FULL, QUICK = (600, 80, 200), (60, 10, 20)
"""Passages that set the one threshold; in each room those before nothing, to objects and to objects with a weaker
echo; and those that set its own."""

OFTEN: Mapping[str, int] = {"walls 1e-4": 4}
"""Rooms that goals are about have so many times as many with a weaker echo, and that set thresholds."""


def work_of(training: int, each: int, own: int) -> list[Passing]:
    """All passages."""
    work = passings(SEED_TRAINING, TRAINING, training, 0)
    for room in ROOMS:
        if room != TRAINING:
            often = OFTEN.get(room, 1)
            work += passings(SEED_OWN, room, often * own, 0) + passings(SEED_JUDGED, room, each, 0)
            for weaker_db in STRENGTHS_DB:
                count = often * each if weaker_db else each
                work += passings(SEED_JUDGED + round(weaker_db) + 1, room, 0, count, weaker_db)
    return work


def row(inside: Sequence[tuple[Passing, Rising]], name: str, threshold: float) -> dict[str, Any]:
    """A detector in a room: passages without an object and without an event; and by strength of the echo approaches in
    which the object was seen from `NEEDED_M` or farther, and the distance from which 95 % were seen."""
    quiet = rate(largest(rising, name) <= threshold for passing, rising in inside if not passing.object)
    found: dict[str, Any] = {"tnr": quiet["share"], "tnr_95": [quiet["low"], quiet["high"]]}
    found |= {"seen": {}, "seen_95": {}, "reach_m": {}}
    for weaker_db in STRENGTHS_DB:
        own = [rising for passing, rising in inside if passing.object and passing.weaker_db == weaker_db]
        gaps_m, key = [seen_m(rising, name, threshold) for rising in own], f"{weaker_db:g} dB"
        seen = rate(gap_m >= NEEDED_M for gap_m in gaps_m)
        found["seen"][key], found["seen_95"][key] = seen["share"], [seen["low"], seen["high"]]
        found["reach_m"][key] = float(np.quantile(gaps_m, 0.05))
    return found


def main(quick: bool = False) -> None:
    """Run the study; writes results/pretouch_rooms.json. Thresholds: exceeded in 1 % of the passages that set them; a
    room's own background is the largest that is proposed after one of them."""
    started_s, work = time.perf_counter(), work_of(*(QUICK if quick else FULL))
    with workers() as pool:
        outcomes = list(zip(work, in_parallel(judged, work, pool), strict=True))
        setting = [passing for passing in work if passing.seed == SEED_OWN]
        still: dict[str, float] = {}
        for passing, size_fs in zip(setting, in_parallel(background_fs, setting, pool), strict=True):
            still[passing.room] = max(size_fs, still.get(passing.room, 0.0))
        again = [(passing, still[passing.room]) for passing in work if passing.room != TRAINING]
        with_own = dict(
            zip((passing for passing, _ in again), in_parallel(judged_at, again, pool), strict=True)
        )
    by_room = {
        room: [(one, {**rising, **with_own.get(one, {})}) for one, rising in outcomes if one.room == room]
        for room in ROOMS
    }
    training = [rising for _, rising in by_room.pop(TRAINING)]
    thresholds = {name: threshold_of(training, name) for name in training[0]}
    thresholds[AS_IT_IS] = PreTouchSettings().threshold
    rooms, own = {}, {}
    for room, inside in by_room.items():
        sets = [rising for passing, rising in inside if passing.seed == SEED_OWN]
        rest = [one for one in inside if one[0].seed != SEED_OWN]
        # the one threshold has seen neither part
        rooms[room] = {name: row(inside, name, threshold) for name, threshold in thresholds.items()}
        at = {name: threshold_of(sets, name) for name in sets[0] if name != AS_IT_IS}
        own[room] = {name: {"threshold": at[name], **row(rest, name, at[name])} for name in at}
        own[room][OF_THE_ROOM]["background_fs"] = still[room]
    false = {
        name: rate(
            largest(rising, name) > threshold
            for room, inside in by_room.items()
            if room.startswith(NEVER)
            for passing, rising in inside
            if not passing.object
        )
        for name, threshold in thresholds.items()
    }
    study = {"thresholds": thresholds, "rooms": rooms, "own": own, "never_false": false}
    save("pretouch_rooms", {**study, "wall_s": time.perf_counter() - started_s}, quick=quick)


def threshold_of(quiet: Sequence[Rising], name: str) -> float:
    """Of a detector, that all but 1 % of these passages keep."""
    return float(np.quantile([largest(rising, name) for rising in quiet], TNR, method="higher"))
