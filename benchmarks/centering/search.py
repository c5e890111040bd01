"""One search, as in behaviors/centering.py, with the real detectors through their `push`."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Contact, PreTouch
from benchmarks.centering.scenes import (
    STILL_S,
    STOP_M_S2,
    CenteringScene,
    Place,
    after,
    turn_at,
)
from controller.detectors.level import LevelDetector, LevelSettings
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from drivers.messages import SampleBlock
from drivers.mock.physics.aura import ENVELOPE_HZ, LEFT, RIGHT
from drivers.ur_arm.stream import RATE_HZ as ENCODER_HZ

Method = Literal["paper", "ours"]
Finder = PreTouchDetector | PreTouchPaperDetector

NAMES = {RIGHT: "right", LEFT: "left"}

TURN_S = 2.5
"""Half a turn at 1.5 rad/s, half of what the arm's wrist may do, with its ramps (assumption)."""

REST_S = 0.5
"""After it: contact detectors learn 0.3 s."""

CHUNK = 500
"""Milliseconds that are predicted at a time."""


@dataclass(frozen=True)
class Tuning:
    """Settings of the detectors.

    Attributes:
        method: Kind of the finders.
        finder: Settings of the finders.
        gains: Of the right and the left finger (ours).
        contact: Settings of the contact detectors; None for none.
    """

    method: Method
    finder: dict[str, Any] = field(default_factory=dict)
    gains: tuple[float, float] = (1.0, 1.0)
    contact: dict[str, Any] | None = field(default_factory=dict)


@dataclass(frozen=True)
class SearchCourse:
    """Procedure of the search: see `behaviors.search.SearchSettings`."""

    sweep_m: float = 0.033
    baseline_s: float = 1.0
    run_up: bool = False
    blind_m: float = 0.0045
    loop_hz: float = 100.0
    idle_hz: float = 50.0
    turned: bool = False
    """Whether both fingers search a second time, each where the other did: half a turn of the wrist between."""


@dataclass(frozen=True)
class Found:
    """Result of a search.

    Attributes:
        place: The search.
        outcome: `found`, `unseen` or `contact` (a contact detector triggered while a finder was armed).
        error_m: The gripper's middle from the object's, positive where it went too far forward; NaN unless found.
        seen_m: Distance of the right and of the left finger from the object when it was seen.
        touches: How often a finger really began to touch the object.
        moved_m: How far it was pushed.
        search_s: From the first motion to the last standstill.
    """

    place: Place
    outcome: Literal["found", "unseen", "contact"]
    error_m: float = math.nan
    seen_m: tuple[float, float] = (math.nan, math.nan)
    touches: int = 0
    moved_m: float = 0.0
    search_s: float = math.nan


def finder(tuning: Tuning, which: int) -> Finder:
    """The finder of one finger."""
    name = NAMES[which]
    if tuning.method == "paper":
        return PreTouchPaperDetector(
            name, PreTouchPaperSettings(**{"input": f"signals.{name}"} | tuning.finder)
        )
    settings: dict[str, Any] = {"input": f"signals.{name}", "gain": tuning.gains[which]}
    return PreTouchDetector(name, PreTouchSettings(**settings | tuning.finder))


def block_of(which: int, first: int, z: NDArray[np.complex128]) -> SampleBlock:
    """A finger's envelope as its signal gives it."""
    values = np.ascontiguousarray(z[:, which]).view(np.float64).reshape(-1, 2)
    return SampleBlock(
        f"signals.{NAMES[which]}", first, first / ENVELOPE_HZ, values, rate_hz=float(ENVELOPE_HZ), unit="FS"
    )


class SimulatedSearch:
    """A search under way.

    Args:
        place: Where and how.
        tuning: Of the detectors.
        course: Its procedure.
    """

    def __init__(self, place: Place, tuning: Tuning, course: SearchCourse) -> None:
        self.place, self.tuning, self.course = place, tuning, course
        self.bench = CenteringScene(place)
        self.now_s = place.begin_s
        self._next = after(place.begin_s)
        self._contacts = self._contact_detectors()
        self._touched_s = self._heeded_s = math.inf
        self._saw_m: dict[int, float] = {}
        self._gap_m = {RIGHT: math.nan, LEFT: math.nan}

    def _contact_detectors(self) -> list[LevelDetector]:
        settings = self.tuning.contact
        if settings is None:
            return []
        names = NAMES.values()
        return [
            LevelDetector(name, LevelSettings(**{"input": f"signals.{name}"} | settings)) for name in names
        ]

    def run(self) -> Found:
        """Search to the end."""
        order = (RIGHT, LEFT, RIGHT) if self.course.run_up else (LEFT, RIGHT)
        first = finder(self.tuning, order[0])
        self._rest(first)
        begun_s = self.now_s
        middles_m: list[float] = []
        for turned in (False, True)[: 1 + self.course.turned]:
            if turned:
                self._turn(middles_m[0])
            # after half a turn each finger goes the other's way
            for place, which in enumerate(order):
                detector = first if place == 0 and not turned else finder(self.tuning, which)
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
        return turn_at(t_s, self.course.loop_hz)

    def _found(self, outcome: Any, middle_m: float, begun_s: float) -> Found:
        bench = self.bench
        return Found(
            self.place,
            outcome,
            middle_m - bench.object_x_m,
            (self._gap_m[RIGHT], self._gap_m[LEFT]),
            bench.touches,
            abs(bench.object_x_m - self.place.object_x_m),
            self.now_s - begun_s,
        )

    def _rest(self, detector: Finder) -> None:
        # nothing moves: the loop turns at its idle rate
        self.now_s = turn_at(self.now_s + self.course.baseline_s, self.course.idle_hz)
        self._pass(self.now_s, detector)

    def _pass(
        self,
        until_s: float,
        detector: Finder | None = None,
        known: NDArray[np.complex128] | None = None,
    ) -> None:
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

    def _touch(self, first: int, z: NDArray[np.complex128]) -> None:
        for contact, which in zip(self._contacts, NAMES, strict=False):
            for event in contact.push(block_of(which, first, z)):
                if isinstance(event, Contact) and event.t_s >= self._heeded_s:
                    self._touched_s = min(self._touched_s, event.t_s)

    def _seek(self, which: int, detector: Finder) -> Literal["unseen", "contact"] | None:
        """One way, until the finger ahead of the motion sees the object and the arm stands still again."""
        bench, arm = self.bench, self.bench.arm
        forward = 1.0 if (which == LEFT) != bench.turned else -1.0
        began_s = self.now_s
        self._heeded_s = began_s + self.course.blind_m / self.place.speed_m_s
        arm.move_at(began_s, forward * self.place.speed_m_s, forward * self.course.sweep_m)
        end = after(self._turn_at(arm.arrival_s + STILL_S))
        while self._next < end:
            first = self._next
            z, encoder, clear = bench.foresee(first, min(first + CHUNK, end))
            known = z if clear else None
            seen = next(
                (event for event in _events_of(detector, first, z, encoder) if isinstance(event, PreTouch)),
                None,
            )
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
        if self.tuning.method == "ours":  # it waits for the encoder
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
        self.now_s = max(self.now_s, stop_s + 1.0 / self.course.loop_hz)


def _events_of(detector: Finder, first: int, z: NDArray[np.complex128], encoder: SampleBlock) -> list[Any]:
    which = RIGHT if detector.name == "right" else LEFT
    blocks = [block_of(which, first, z)]
    if len(encoder) and encoder.stream in detector.inputs:
        blocks.insert(0, encoder)
    return [event for block in blocks for event in detector.push(block)]


def search(place: Place, tuning: Tuning, course: SearchCourse) -> Found:
    """Make one search."""
    return SimulatedSearch(place, tuning, course).run()
