"""Centering without touching (C3): the paper's algorithm and ours, 85 searches twenty times over, six objects.

`python -m benchmarks centering`. The mock bench's own plant, arm and detectors in a closed loop, without drivers and
recorder: searches as in behaviors/centering.py, with the real detectors through their `push`.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from itertools import product
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.stats import t

from behaviors.events import Contact, PreTouch
from benchmarks.results import in_parallel, progress, save, workers
from config.profile import load_profile
from controller.detectors.envelope import as_complex
from controller.detectors.level import LevelDetector, LevelSettings
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from drivers.can_gripper.units import STROKE_M
from drivers.core.messages import SampleBlock
from drivers.ur_arm.settings import CYCLES_HZ as ENCODER_HZ
from simulator.physics.aura import BOTH, ENVELOPE_HZ, LEFT, RIGHT, AuraMotion, AuraPlant
from simulator.physics.aura_settings import NOTHING, OBJECTS, SIX, RoomSettings
from simulator.physics.gripper_part import AuraBenchSettings
from simulator.physics.tool_motion import ToolMotion

Complexes = NDArray[np.complex128]

SEED_TUNE, SEED_CALIBRATE, SEED_TEST, SEED_OBJECTS, SEED_SCATTER = 41_000, 42_000, 43_000, 44_000, 45_000
"""Every part has its own noise and places; choices were made on the first."""

DRIVE_HZ, LEVEL = 40_000.0, 0.5
"""As behaviors/centering.py drives it."""

ACCELERATION_M_S2, STOP_M_S2, MAX_SPEED_M_S = 0.5, 3.0, 0.06
"""The arm's, as in the profile mock/bench_aura."""

STILL_S = 0.02
"""Delay after which the arm reports standstill."""

TOUCH_M = 1e-9
"""Nearer than this is touching."""

TURNED = 500_000
"""Added to a search's number, keys the noise after a turn."""

CLOCK_EDGE = 1e-7
"""Tolerance of a time to a turn, as a share of it."""


class Place(NamedTuple):
    """One search to be made.

    Attributes:
        seed, number: Key of all noise.
        object, object_x_m: What stands between the fingers, and where its middle is, from the gripper's at the start.
        mismatch_db: By how much the right finger is more sensitive than the left.
        begin_s: When the rest before the search begins, on the bench's clock.
        finger_db: Standard deviation of each finger's sensitivity from search to search.
        fades: Sensitivity of the right finger after half a turn, as a share of the one before.
        decays: Distance over which the sound of the right finger spreads, as a share of the left one's.
    """

    seed: int
    number: int
    object: str
    object_x_m: float
    speed_m_s: float
    mismatch_db: float = 0.0
    begin_s: float = 8.92
    finger_db: float = 0.0
    room: RoomSettings = RoomSettings()
    fades: float = 1.0
    decays: float = 1.0


class CenteringScene:
    """The fingers' signals while the arm moves to and fro; the object slides where a finger pushes it, and `touches`
    counts how often one began to touch it."""

    def __init__(self, place: Place) -> None:
        about = {"mismatch_db": place.mismatch_db, "finger_scatter_db": place.finger_db, "room": place.room}
        settings = AuraBenchSettings.model_validate({"object": place.object, **about})
        thing = OBJECTS[place.object]
        limits = {"acceleration_m_s2": ACCELERATION_M_S2, "max_speed_m_s": MAX_SPEED_M_S}
        self.arm = ToolMotion((1.0, 0.0, 0.0), **limits)
        self.arm.place(0.0, 0.0)
        self.object_x_m = place.object_x_m
        self.touches = 0
        self._plant = AuraPlant(settings)
        # the right finger has a plant of its own where its sound spreads differently
        other = settings.model_copy(update={"decay_m": place.decays * settings.decay_m})
        self._right = self._plant if place.decays == 1.0 else AuraPlant(other)
        self._place, self._thing, self._top_m = place, thing, settings.object_top_m
        for plant in {self._plant, self._right}:
            plant.begin((place.seed, place.number), thing, self._top_m, "normal")
        self._push_n = settings.push_n
        self._width_m = settings.closed_width_m + STROKE_M
        self._half_m = 0.5 * (self._width_m - thing.width_m)
        self._touching = np.zeros(2, bool)
        self.turned = False

    def turn(self) -> None:
        """Turn the gripper half around its own axis: each finger is where the other was, as sensitive as it was.

        The room's echoes are redrawn for each: their phases belong to places."""
        self.turned = not self.turned
        key = (self._place.seed, TURNED + self._place.number)
        for plant in {self._plant, self._right}:
            (right, left), reflected = plant._gains, plant._reflected
            plant.begin(key, self._thing, self._top_m, "normal")
            plant.__dict__.update(_gains=(right * self._place.fades, left), _reflected=reflected)

    def receive(self, first: int, end: int) -> tuple[Complexes, SampleBlock]:
        """Envelope of both fingers in milliseconds `first` to `end` - 1, shape (n, 2), and the arm's encoder.

        The arm's motion until then must be known; each span is received once.
        """
        ticks = np.arange(first, end, dtype=np.int64)
        motion = self._pushed(ticks)
        n = len(ticks)
        inputs = motion, ticks, ticks / ENVELOPE_HZ, np.full(n, DRIVE_HZ), np.full(n, LEVEL), BOTH
        z = self._plant.envelope(*inputs)
        if self._right is not self._plant:
            z[:, RIGHT] = self._right.envelope(*inputs)[:, RIGHT]
        step = round(ENVELOPE_HZ / ENCODER_HZ)
        readings = np.arange(-(-first // step), -(-end // step), dtype=np.int64)
        position = self.arm.coordinates(readings / ENCODER_HZ)[:, :1]
        at = int(readings[0]) if len(readings) else 0
        return z, SampleBlock("arm.position", at, at / ENCODER_HZ, position, rate_hz=ENCODER_HZ, unit="m")

    def foresee(self, first: int, end: int) -> tuple[Complexes, SampleBlock, bool]:
        """The same for a predicted span that may still change, and whether it is free of touches."""
        kept = self.object_x_m, self.touches, self._touching.copy()
        z, encoder = self.receive(first, end)
        clear = self.touches == kept[1] and not kept[2].any() and self.object_x_m == kept[0]
        self.object_x_m, self.touches, self._touching = kept
        return z, encoder, clear

    def _pushed(self, ticks: NDArray[np.int64]) -> AuraMotion:
        times_s = ticks / ENVELOPE_HZ
        before_s = float(times_s[0]) - 1.0 / ENVELOPE_HZ
        tools_m = self.arm.coordinates(np.concatenate(([before_s], times_s)))[:, 0]
        tool_m = tools_m[1:]
        # the left finger pushes forward, the right one backward; never both between two places of a search
        forward = np.maximum(np.maximum.accumulate(tool_m) - self._half_m, self.object_x_m)
        object_m = np.minimum(np.minimum.accumulate(tool_m) + self._half_m, forward)
        gap_m = np.empty((len(ticks), 2))
        gap_m[:, RIGHT] = self._half_m - (object_m - tool_m)
        gap_m[:, LEFT] = self._half_m + (object_m - tool_m)
        touching = gap_m <= TOUCH_M
        begun = touching & ~np.vstack((self._touching, touching[:-1]))
        self.touches += int(begun.sum())
        self._touching = touching[-1]
        self.object_x_m = float(object_m[-1])
        n = len(ticks)
        if self.turned:
            gap_m, touching = gap_m[:, ::-1], touching[:, ::-1]
        push_n, speed_m_s = (
            np.asarray(self._push_n * touching, np.float64),
            ENVELOPE_HZ * np.abs(np.diff(tools_m)),
        )
        width_m = np.full(n, self._width_m)
        return AuraMotion(gap_m, np.zeros(n), np.zeros(n), width_m, push_n, speed_m_s, tool_m)

    def gap_m(self, finger: int, tool_m: float) -> float:
        """From a finger to the object where it stands now, with the tool at a place."""
        sign = 1.0 if (finger == LEFT) != self.turned else -1.0
        return self._half_m + sign * (self.object_x_m - tool_m)


def turn_at(t_s: float, loop_hz: float) -> float:
    """The loop's first turn at `t_s` or after: when a command can be given."""
    return math.ceil(t_s * loop_hz - CLOCK_EDGE) / loop_hz


def after(t_s: float) -> int:
    """Number of the first millisecond after `t_s`."""
    return math.floor(t_s * ENVELOPE_HZ + 1e-6) + 1


# --- one search --------------------------------------------------------------------------------


Finder = PreTouchDetector | PreTouchPaperDetector

ENDED = {"unseen": "unseen", "stopped": "contact"}
"""Outcomes of searches that found nothing, as they are counted."""

NAMES = {RIGHT: "right", LEFT: "left"}

TURN_S = 2.5
"""Half a turn at 1.5 rad/s, half of what the arm's wrist may do, with its ramps (assumption)."""

REST_S = 0.5
"""After it: contact detectors learn 0.3 s."""

CHUNK = 500
"""Milliseconds that are predicted at a time."""


@dataclass(frozen=True)
class Method:
    """A way to search, as the profile has it: its detectors, and its procedure (`behaviors.search.SearchSettings`).

    Attributes:
        kind: Of the finders.
        finder: Settings of the finders.
        gains: Of the right and the left finger (ours).
        contact: Settings of the contact detectors.
        turned: Whether both fingers search a second time, each where the other did: half a turn of the wrist between.
    """

    kind: Literal["paper", "ours"]
    finder: Mapping[str, Any]
    gains: tuple[float, float]
    contact: Mapping[str, Any]
    sweep_m: float
    baseline_s: float
    run_up: bool
    blind_m: float
    loop_hz: float
    idle_hz: float = 50.0
    turned: bool = False

    def set_to(self, **finder: float) -> Method:
        """The same with other settings of the finders."""
        return replace(self, finder={**self.finder, **finder})


@dataclass(frozen=True)
class Searched:
    """Result of a search.

    Attributes:
        outcome: `found`, `unseen` or `contact` (a contact detector triggered while a finder was armed).
        error_m: The gripper's middle from the object's, positive where it went too far forward; NaN unless found.
        seen_m: Distance of the right and of the left finger from the object when it was seen.
        touches: How often a finger really began to touch the object.
        search_s: From the first motion to the last standstill.
    """

    outcome: Literal["found", "unseen", "contact"]
    error_m: float = math.nan
    seen_m: tuple[float, float] = (math.nan, math.nan)
    touches: int = 0
    search_s: float = math.nan


def finder(method: Method, which: int) -> Finder:
    """The finder of one finger."""
    name = NAMES[which]
    settings = {"input": f"signals.{name}", **method.finder}
    if method.kind == "paper":
        return PreTouchPaperDetector(name, PreTouchPaperSettings(**settings))
    return PreTouchDetector(name, PreTouchSettings(gain=method.gains[which], **settings))


def block_of(which: int, first: int, z: Complexes) -> SampleBlock:
    """A finger's envelope as its signal gives it."""
    values = np.ascontiguousarray(z[:, which]).view(np.float64).reshape(-1, 2)
    stream, rate_hz = f"signals.{NAMES[which]}", float(ENVELOPE_HZ)
    return SampleBlock(stream, first, first / ENVELOPE_HZ, values, rate_hz=rate_hz, unit="FS")


class SimulatedSearch:
    """A search under way."""

    def __init__(self, place: Place, method: Method) -> None:
        self.place, self.method = place, method
        self.bench = CenteringScene(place)
        self.now_s = place.begin_s
        self._next = after(place.begin_s)
        self._contacts = self._contact_detectors()
        self._touched_s = self._heeded_s = math.inf
        self._saw_m: dict[int, float] = {}
        self._gap_m = {RIGHT: math.nan, LEFT: math.nan}

    def _contact_detectors(self) -> list[LevelDetector]:
        def one(name: str) -> LevelDetector:
            return LevelDetector(name, LevelSettings(**{"input": f"signals.{name}", **self.method.contact}))

        return [one(name) for name in NAMES.values()]

    def run(self) -> Searched:
        """Search to the end."""
        order = (RIGHT, LEFT, RIGHT) if self.method.run_up else (LEFT, RIGHT)
        first = finder(self.method, order[0])
        self._rest(first)
        begun_s = self.now_s
        middles_m: list[float] = []
        for turned in (False, True)[: 1 + self.method.turned]:
            if turned:
                self._turn(middles_m[0])
            # after half a turn each finger goes the other's way
            for place, which in enumerate(order):
                detector = first if place == 0 and not turned else finder(self.method, which)
                ending = self._seek(which, detector)
                if ending is not None:
                    return self._found(ending, math.nan, begun_s)
            middles_m.append(0.5 * (self._saw_m[LEFT] + self._saw_m[RIGHT]))
        return self._found("found", sum(middles_m) / len(middles_m), begun_s)

    def _turn(self, middle_m: float) -> None:
        """To the middle, half a turn of the wrist about it, and a rest in which the contact detectors learn again."""
        arm = self.bench.arm
        arm.move_to(self.now_s, middle_m, min(self.place.speed_m_s, 0.01))
        self.now_s = self._turn_at(arm.arrival_s + STILL_S)
        self._pass(self.now_s)
        self.now_s = self._turn_at(self.now_s + TURN_S)
        self._next = after(self.now_s)  # no detector is subscribed while it turns
        self.bench.turn()
        self._contacts = self._contact_detectors()
        self.now_s = self._turn_at(self.now_s + REST_S)
        self._pass(self.now_s)

    def _turn_at(self, t_s: float) -> float:
        return turn_at(t_s, self.method.loop_hz)

    def _found(self, outcome: Any, middle_m: float, begun_s: float) -> Searched:
        bench, seen_m = self.bench, (self._gap_m[RIGHT], self._gap_m[LEFT])
        return Searched(outcome, middle_m - bench.object_x_m, seen_m, bench.touches, self.now_s - begun_s)

    def _rest(self, detector: Finder) -> None:
        # nothing moves: the loop turns at its idle rate
        self.now_s = turn_at(self.now_s + self.method.baseline_s, self.method.idle_hz)
        self._pass(self.now_s, detector)

    def _pass(self, until_s: float, detector: Finder | None = None, known: Complexes | None = None) -> None:
        """Let time pass; contact detectors process it, and a finder if given (its events are dropped).

        A prediction without a touch is reused as far as it goes."""
        end = after(until_s)
        if end <= self._next:
            return
        first, self._next = self._next, end
        if known is not None and end - first <= len(known):
            self._touch(first, known[: end - first])
            return
        z, encoder = self.bench.receive(first, end)
        self._touch(first, z)
        if detector is not None:
            _events_of(detector, first, z, encoder)

    def _touch(self, first: int, z: Complexes) -> None:
        for contact, which in zip(self._contacts, NAMES, strict=False):
            for event in contact.push(block_of(which, first, z)):
                if isinstance(event, Contact) and event.t_s >= self._heeded_s:
                    self._touched_s = min(self._touched_s, event.t_s)

    def _seek(self, which: int, detector: Finder) -> Literal["unseen", "contact"] | None:
        """One way, until the finger ahead of the motion sees the object and the arm stands still again."""
        bench, arm = self.bench, self.bench.arm
        forward = 1.0 if (which == LEFT) != bench.turned else -1.0
        began_s = self.now_s
        self._heeded_s = began_s + self.method.blind_m / self.place.speed_m_s
        arm.move_at(began_s, forward * self.place.speed_m_s, forward * self.method.sweep_m)
        end = after(self._turn_at(arm.arrival_s + STILL_S))
        while self._next < end:
            first = self._next
            z, encoder, clear = bench.foresee(first, min(first + CHUNK, end))
            known = z if clear else None
            reported = _events_of(detector, first, z, encoder)
            seen = next((event for event in reported if isinstance(event, PreTouch)), None)
            if seen is None:
                self._pass((min(first + CHUNK, end) - 1) / ENVELOPE_HZ, known=known)
            else:
                stop_s = self._reaction_s(seen.t_s, first)
                self._pass(stop_s, known=known)
            if self._touched_s < math.inf:
                self.now_s = self._turn_at(self._touched_s)
                return "contact"
            if seen is not None:
                self._stop(which, seen, stop_s)
                return None
        self.now_s = self._turn_at(arm.arrival_s + STILL_S)
        return "unseen"

    def _reaction_s(self, t_s: float, first: int) -> float:
        """The turn in which the loop handles a sample."""
        known_s = t_s
        if self.method.kind == "ours":  # it waits for the encoder
            known_s = math.ceil(t_s * ENCODER_HZ - 1e-7) / ENCODER_HZ
        return max(self._turn_at(known_s), self._turn_at(first / ENVELOPE_HZ))

    def _stop(self, which: int, seen: PreTouch, stop_s: float) -> None:
        arm = self.bench.arm
        arm.stop(stop_s, STOP_M_S2)
        self._heeded_s = math.inf  # contacts in the turn are ignored
        self.now_s = self._turn_at(arm.arrival_s + STILL_S)
        self._pass(self.now_s)
        position_m = seen.position_m if math.isfinite(seen.position_m) else arm.target_m
        self._saw_m[which] = position_m
        self._gap_m[which] = self.bench.gap_m(which, position_m)
        # the next command is sent in the following turn
        self.now_s = max(self.now_s, stop_s + 1.0 / self.method.loop_hz)


def _events_of(detector: Finder, first: int, z: Complexes, encoder: SampleBlock) -> list[Any]:
    which = RIGHT if detector.name == "right" else LEFT
    blocks = [block_of(which, first, z)]
    if len(encoder) and encoder.stream in detector.inputs:
        blocks.insert(0, encoder)
    return [event for block in blocks for event in detector.push(block)]


def search(place: Place, method: Method) -> Searched:
    """Make one search."""
    return SimulatedSearch(place, method).run()


# --- scores ------------------------------------------------------------------------------------


def clean(found: Sequence[Searched]) -> list[Searched]:
    """Searches that found the middle without a touch: if a finger pushes the object, the middle of two touches is the
    object's anyway."""
    return [one for one in found if one.outcome == "found" and not one.touches]


CenteringScore = dict[str, Any]


def score(repeats: Sequence[Sequence[Searched]]) -> CenteringScore:
    """Of repeats of the same set: mean of the largest error in each with its 95 % interval (Student's t), the largest,
    mean, deviation and skewness of the errors, the median of their sizes; how many searches there were, saw
    nothing, were ended by the contact detectors, really touched the object, found the middle without; median distance
    at which the object was seen, and time. None where nothing is known."""
    every = [one for repeat in repeats for one in repeat]
    good = clean(every)
    errors_m = np.array([one.error_m for one in good])
    worst = [max(abs(one.error_m) for one in clean(repeat)) for repeat in repeats if clean(repeat)]
    mean, lo, hi = interval(worst)
    found: CenteringScore = {"worst_m": mean, "worst_lo_m": lo, "worst_hi_m": hi, "searches": len(every)}
    found |= {way: sum(one.outcome == end and not one.touches for one in every) for way, end in ENDED.items()}
    found |= {"touched": sum(one.touches > 0 for one in every), "centred": len(good)}
    values: dict[str, Any] = {
        "largest_m": lambda: max(worst),
        "mean_m": errors_m.mean,
        "sd_m": errors_m.std,
        "median_m": lambda: np.median(np.abs(errors_m)),
        "skewness": lambda: np.mean((errors_m - errors_m.mean()) ** 3) / (errors_m.std() or math.nan) ** 3,
        "seen_m": lambda: np.median([one.seen_m for one in good]),
        "search_s": lambda: np.median([one.search_s for one in good]),
    }
    numbers = {name: float(value()) if good else math.nan for name, value in values.items()}
    return found | {name: None if math.isnan(number) else number for name, number in numbers.items()}


def interval(values: Sequence[float]) -> tuple[float | None, float | None, float | None]:
    """Mean and its 95 % interval by Student's t; None of too few."""
    n = len(values)
    mean = float(np.mean(values)) if n else None
    if mean is None or n < 2:
        return mean, None, None
    half = float(t.ppf(0.975, n - 1) * np.std(values, ddof=1) / math.sqrt(n))
    return mean, mean - half, mean + half


# --- what is searched --------------------------------------------------------------------------


SPEEDS_M_S = (0.01, 0.03)
MISMATCH_DB = 1.5
STARTS_M = ((0.006, 0.011), (-0.002, 0.002), (-0.011, -0.006))
"""Near the right finger, near the middle, near the left one."""
SHARES = (29, 27, 29)
"""Of the 85."""

LEAST_GAP_M = 0.007
"""No object of the six starts nearer than this to a finger: the detector needs 5 mm of travel."""

CALIBRATIONS = 10
"""Passes of each finger from which its gain is measured."""
CALIBRATION_GAP_M = 0.008
"""At this distance of the pipe."""

LEVELS_FS = (0.0, 0.0005, 0.001, 0.0015, 0.002, 0.0025, 0.003, 0.004)
"""Tried values of our amplitude."""

SCATTERS_DB = (0.5, 1.0, 2.0)

FULL, QUICK = (20, 3, 85, 2), (2, 1, 17, 5)
"""Repeats of the 85, and of the side studies; searches for each object; and one in so many where settings are tried."""


def methods(name: str) -> dict[str, Method]:
    """The paper's and ours, as a profile has them."""
    profile: Any = load_profile(name, {})
    behavior = profile.behavior
    given = {
        each: {key: getattr(entry.settings, key) for key in entry.settings.model_fields_set - {"input"}}
        for each, entry in profile.detectors.items()
    }
    course = (behavior.sweep_m, behavior.baseline_s)
    rest = (behavior.blind_m, profile.loop.rate_hz)
    found = {}
    for kind in ("paper", "ours"):
        sides = [given[f"{side}_{kind}"] for side in ("right", "left")]
        right, left = (float(side.pop("gain", 1.0)) for side in sides)
        if sides[0] != sides[1]:
            raise ValueError(f"{name}: the fingers' detectors differ by more than their gain")
        run_up = behavior.run_up and kind == "ours"
        found[kind] = Method(kind, sides[0], (right, left), given["left_contact"], *course, run_up, *rest)
    return found


def eighty_five(seed: int, repeat: int, speed_m_s: float, mismatch_db: float = 0.0) -> list[Place]:
    """One repeat: 85 places, drawn anew, the same for every method."""
    rng = np.random.default_rng((seed, repeat, round(1e3 * speed_m_s)))
    spots = [rng.uniform(low_m, high_m, n) for (low_m, high_m), n in zip(STARTS_M, SHARES, strict=True)]
    numbers = 1000 * repeat + np.arange(sum(SHARES))
    return [
        Place(seed + round(1e3 * speed_m_s), int(number), "pipe", float(x_m), speed_m_s, mismatch_db)
        for number, x_m in zip(numbers, np.concatenate(spots), strict=True)
    ]


def with_object(name: str, n: int, speed_m_s: float) -> list[Place]:
    """Searches for one of the six, from anywhere at least `LEAST_GAP_M` from both fingers."""
    reach_m = object_reach_m(name)
    seed = SEED_OBJECTS + 100 * SIX.index(name) + round(1e3 * speed_m_s)
    spots = np.random.default_rng(seed).uniform(-reach_m, reach_m, n)
    return [Place(seed, number, name, float(x_m), speed_m_s) for number, x_m in enumerate(spots)]


def object_reach_m(name: str) -> float:
    """How far from the middle an object starts at the most."""
    room_m = CenteringScene(Place(0, 0, name, 0.0, 0.01)).gap_m(LEFT, 0.0)
    return min(STARTS_M[0][1], room_m - LEAST_GAP_M)


Key = tuple[Any, ...]


def scores(
    jobs: Mapping[Key, Sequence[Sequence[tuple[Place, Method]]]], pool: Any
) -> dict[Key, CenteringScore]:
    """The score of each, of which each has one or more repeats of the same set."""
    work = [one for repeats in jobs.values() for repeat in repeats for one in repeat]
    found = iter(in_parallel(_one, work, pool))
    return {key: score([[next(found) for _ in each] for each in repeats]) for key, repeats in jobs.items()}


def _one(job: tuple[Place, Method]) -> Searched:
    return search(*job)


def wave_fs(distance_m: float) -> float:
    """Mean amplitude of what the pipe sends back from a distance, full scales at the drive's level."""
    settings = AuraBenchSettings(gain_scatter_db=0.0, phase_scatter_rad=0.0)
    fields = []
    for thing in (OBJECTS["pipe"], OBJECTS.get(NOTHING)):
        plant = AuraPlant(settings)
        plant.begin((0, 0), thing, settings.object_top_m, "normal")
        one, gap_m = np.zeros(1), np.array([[distance_m, 1.0]])
        motion = AuraMotion(gap_m, one, one, np.full(1, 0.063), np.zeros((1, 2)), one, one)
        fields.append(plant.field(motion, one, np.full(1, DRIVE_HZ), np.full(1, LEVEL), (RIGHT,))[0, RIGHT])
    return float(abs(fields[0] - fields[1]))


def gamma(distance_m: float) -> float:
    """The paper's threshold for a distance: power of that wave in phase, if it kept its size over a window."""
    return 0.5 * wave_fs(distance_m) ** 2


def paper_at(paper: Method, window_s: float, distance_m: float) -> Method:
    """The paper's method with an alpha and the gamma of a distance."""
    return paper.set_to(window_s=window_s, threshold=gamma(distance_m))


def gains_of(mismatch_db: float, method: Method) -> tuple[float, float]:
    """Gains of the right and the left finger, measured: with the pipe in the middle each finger goes to it ten times,
    and the mean amplitude that its detector fits at 8 mm is made the same for both."""
    logs: dict[int, list[float]] = {RIGHT: [], LEFT: []}
    for number in range(CALIBRATIONS):
        for which in BOTH:
            place = Place(SEED_CALIBRATE, number, "pipe", 0.0, 0.01, mismatch_db)
            logs[which].append(math.log(_amplitude_fs(place, which, method)))
    half = 0.5 * (float(np.mean(logs[RIGHT])) - float(np.mean(logs[LEFT])))
    return math.exp(-half), math.exp(half)


def _amplitude_fs(place: Place, which: int, method: Method) -> float:
    """The detector's fitted amplitude at the distance of calibration."""
    bench = CenteringScene(place)
    forward = 1.0 if which == LEFT else -1.0
    bench.arm.move_at(place.begin_s, forward * place.speed_m_s, forward * 0.018)
    first, end = after(place.begin_s), after(bench.arm.arrival_s)
    z, _ = bench.receive(first, end)
    position_m = bench.arm.coordinates(np.arange(first, end) / ENVELOPE_HZ)[:, 0]
    detector = finder(replace(method, gains=(1.0, 1.0)), which)
    envelope = as_complex(block_of(which, first, z).physical)
    _, amplitudes_fs = detector.traced(envelope, position_m, float(ENVELOPE_HZ))  # type: ignore[union-attr]
    gaps_m: NDArray[np.float64] = np.array([bench.gap_m(which, x_m) for x_m in position_m.tolist()])
    known = np.isfinite(amplitudes_fs)
    order = np.argsort(gaps_m[known])
    return float(np.interp(CALIBRATION_GAP_M, gaps_m[known][order], amplitudes_fs[known][order]))


def main(quick: bool = False) -> None:
    """Run the study, print the worst of the 85; writes results/centering.json."""
    started_s, (repeats, aside, objects, one_in) = time.perf_counter(), QUICK if quick else FULL
    pipe, six = methods("mock/centering"), methods("mock/centering_objects")
    paper, ours = pipe["paper"], pipe["ours"]
    gains, alike = gains_of(MISMATCH_DB, ours), gains_of(0.0, ours)
    ways = [
        ("paper", paper, 0.0),
        ("ours", ours, 0.0),
        ("paper", paper, MISMATCH_DB),
        ("ours", ours, MISMATCH_DB),
    ]
    ways.append(("ours, gains calibrated", replace(ours, gains=gains), MISMATCH_DB))

    def sets(
        count: int, method: Method, speed: float, seed: int, db: float = 0.0, finger_db: float = 0.0
    ) -> Any:
        each = [eighty_five(seed, repeat, speed, db) for repeat in range(count)]
        return [[(place._replace(finger_db=finger_db), method) for place in places] for places in each]

    def each_speed(what: Iterable[Any]) -> Iterator[tuple[Any, float]]:
        return product(what, SPEEDS_M_S)

    tables: dict[str, tuple[tuple[str, ...], dict[Key, Any]]] = {
        "eighty_five": (
            ("method", "mismatch_db", "speed_m_s"),
            {(way[0], way[2], v): sets(repeats, way[1], v, SEED_TEST, way[2]) for way, v in each_speed(ways)},
        ),
        "fingers_scatter": (
            ("each_db", "speed_m_s"),
            {(db, v): sets(aside, ours, v, SEED_SCATTER, finger_db=db) for db, v in each_speed(SCATTERS_DB)},
        ),
        "objects": (
            ("object", "method", "speed_m_s"),
            {
                (name, kind, v): [[(place, six[kind]) for place in with_object(name, objects, v)]]
                for (name, kind), v in each_speed(product(SIX, ("paper", "ours")))
            },
        ),
        "our_choices": (
            ("level_fs", "run_up", "speed_m_s"),
            {
                (level_fs, up, v): [[(place, at) for place in eighty_five(SEED_TUNE, 0, v)[::one_in]]]
                for (up, level_fs), v in each_speed(product((False, True), LEVELS_FS))
                for at in (replace(ours.set_to(level_fs=level_fs), run_up=up),)
            },
        ),
    }
    study: dict[str, Any] = {
        "simulated": True,
        "gains_right_left": {"0 dB": alike, f"{MISMATCH_DB:g} dB": gains},
    }
    study["detectors"] = {name: asdict(method) for name, method in pipe.items()}
    study["detectors_objects"] = {name: asdict(method) for name, method in six.items()}
    with workers() as pool:
        for table, (names, jobs) in tables.items():
            found = scores(jobs, pool)
            study[table] = [dict(zip(names, key, strict=True)) | one for key, one in found.items()]
            progress(table)
    save("centering", study | {"wall_s": time.perf_counter() - started_s}, quick=quick)
