"""What is kept of a bench while time is tried, and how far is looked ahead."""

import math
from collections import deque
from dataclasses import dataclass, field
from threading import Lock
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from config.assemble import build_rig, plan_campaign
from config.profile import load_profile
from controller.rig import TrialScene
from drivers.core.clock import VirtualClock
from simulator.devices.faults import Fault, FaultSchedule
from simulator.look_ahead import LONGEST_S, LookAhead, Snapshot, turns_before
from simulator.physics.finger_scene import books_of


class Thing:
    """State of all kinds, some of it shared."""

    def __init__(self):
        self.count = 1
        self.array = np.arange(3.0)
        self.thing: Any = None
        self.parts: dict[str, Any] = {"a": [self.array], "b": deque([1, 2], maxlen=2), "c": {1}}
        self.act = self.acted

    def acted(self):
        return self.count


def test_what_is_put_back_is_as_it_was_and_shares_what_it_shared():
    thing, other = Thing(), Thing()
    other.array, other.thing = thing.array, thing
    kept = Snapshot([thing, other])
    thing.array += 1.0
    thing.parts["b"].append(3)
    thing.parts["c"].add(2)
    thing.count = 2
    kept.restore()
    assert thing.array.tolist() == [0.0, 1.0, 2.0]
    assert thing.parts["b"] == deque([1, 2]) and thing.parts["c"] == {1}
    assert thing.parts["a"][0] is thing.array is other.array, "what was one array is one array"
    assert other.thing is thing and thing.act() == 1


def test_views_of_what_is_put_back_are_views_of_it_still():
    n = 4
    ring = np.arange(2.0 * n)
    windows = np.lib.stride_tricks.sliding_window_view(ring, n)  # read-only, and it changes
    thing = SimpleNamespace(low=ring[:n], high=ring[n:], ring=ring, windows=windows)
    kept = Snapshot([thing])
    thing.low[:] = thing.high[:] = -1.0
    kept.restore()
    assert thing.ring.tolist() == list(range(2 * n))
    thing.low[0] = thing.high[0] = 9.0
    assert thing.ring.tolist() == [9.0, 1.0, 2.0, 3.0, 9.0, 5.0, 6.0, 7.0]
    assert thing.windows[0].tolist() == [9.0, 1.0, 2.0, 3.0]


@dataclass(frozen=True)
class Held:
    """A value of the user's own, with what can be written to."""

    ring: np.ndarray


@dataclass(frozen=True, slots=True)
class HeldInSlots:
    """Likewise."""

    ring: np.ndarray
    names: list[str] = field(default_factory=list)


@pytest.mark.parametrize("kind", [Held, HeldInSlots])
def test_what_a_frozen_dataclass_of_the_users_own_holds_is_put_back(kind):
    thing = SimpleNamespace(held=kind(np.zeros(2)))
    kept = Snapshot([thing])
    thing.held.ring[0] = 1.0
    getattr(thing.held, "names", []).append("later")
    kept.restore()
    assert thing.held.ring.tolist() == [0.0, 0.0]
    assert getattr(thing.held, "names", []) == []


def test_an_array_that_was_given_away_in_what_is_put_back_can_be_written_to_again():
    thing = SimpleNamespace(filled=np.zeros(2))
    kept = Snapshot([thing])
    thing.filled[:] = 1.0
    thing.filled.flags.writeable = False
    kept.restore()
    thing.filled[1] = 2.0
    assert thing.filled.tolist() == [0.0, 2.0]


def _closure():
    kept = []
    return lambda: kept.append(1)


@pytest.mark.parametrize(
    "held", [(n for n in ()), Lock(), _closure(), [].append, iter([1])], ids=lambda held: type(held).__name__
)
def test_what_cannot_be_copied_is_refused(held):
    with pytest.raises(TypeError):
        Snapshot([SimpleNamespace(held=held)])


@pytest.mark.parametrize(
    "name",
    ["transient", "weights", "chirp", "centering", "grasp", "slip", "border", "flexion", "transient_arm"],
)
def test_every_shipped_bench_and_what_listens_to_it_can_be_put_back(name):
    profile = load_profile(f"mock/{name}", {})
    rig = build_rig(profile)
    rig.begin_trial(TrialScene(1, 1, {}, {}))
    ahead: Any = rig.ahead
    (plan,) = plan_campaign(profile, profile.trials(1)[:1], 1).trials
    before = Snapshot([*ahead.__self__.roots, plan.behavior, *plan.detectors.values(), *plan.signals])
    rig.clock.wait_until(0.1)
    before.restore()
    assert rig.clock.now() == 0.0


def test_a_tuple_of_values_is_kept_as_it_is_and_one_that_holds_what_changes_is_copied():
    fixed, mutable = np.arange(3.0), np.arange(3.0)
    fixed.setflags(write=False)
    thing = SimpleNamespace(leg=(1.0, fixed), table=(1.0, mutable))
    for _ in range(2):
        leg, kept = thing.leg, Snapshot([thing])
        mutable += 1.0
        kept.restore()
        assert thing.leg is leg and thing.table[1].tolist() == [0.0, 1.0, 2.0]
        mutable = thing.table[1]


def test_of_a_fingers_books_what_was_written_is_put_back():
    books = books_of(4, 4, 2)
    books.filled[:] = 2, 3
    books.switch[:2], books.record_terms[:3] = (7, 8), 1.5
    held = SimpleNamespace(books=books)
    before = Snapshot([held])
    books.filled[:], books.switch[:], books.record_terms[:] = 4, 0, 0.0
    before.restore()
    assert held.books.filled.tolist() == [2, 3]
    assert held.books.switch[:2].tolist() == [7, 8]
    assert (held.books.record_terms[:3] == 1.5).all()


def test_turns_before_an_event_are_those_in_which_it_is_not_seen():
    assert turns_before(0.05, first=1, stride=1, rate_hz=200.0) == 9, "turn 10 is at 0.05 s and sees it"
    assert turns_before(0.051, first=1, stride=1, rate_hz=200.0) == 10
    assert turns_before(0.05, first=4, stride=4, rate_hz=200.0) == 2
    assert turns_before(0.0, first=4, stride=4, rate_hz=200.0) == 0


class Quiet:
    """The loop's side: asks before each turn at 200 Hz, and counts what passes as one."""

    def __init__(self, faults=(), **bench):
        self.clock = VirtualClock()
        self.device = SimpleNamespace(**bench)
        self.ahead = LookAhead(self.clock, SimpleNamespace(), [self.device], faults)
        self.turn = self.decisions = 0
        self.happens_s = math.inf

    def passed(self, asked, *, armed=True, until_s=math.inf):
        """How many turns pass as one, each time; a turn by itself follows where none do."""
        found = []
        for _ in range(asked):
            found.append(
                self.ahead.skip(self.turn + 1, 1, 200.0, until_s, (), self.look, armed, self.decisions)
            )
            self.turn += found[-1] or 1
            self.clock.wait_until(self.turn / 200.0)
            if not found[-1] and self.clock.now() >= self.happens_s:
                self.decisions, self.happens_s = self.decisions + 1, math.inf
        return found

    def look(self):
        return self.happens_s if self.happens_s <= self.clock.now() else None


def test_looks_grow_while_nothing_happens_and_end_before_what_does():
    loop = Quiet()
    assert loop.passed(4) == [0, 32, 399, 399], (
        "from turn 1 on: the longest are those before two seconds are over"
    )
    loop.happens_s = 836.5 / 200.0
    assert loop.passed(4) == [5, 0, 32, 399], "turn 837 sees it"


def test_where_it_is_not_known_when_something_happens_looks_are_halved():
    loop = Quiet()
    loop.passed(2)
    loop.happens_s = 431.5 / 200.0
    assert loop.passed(1) == [199], "turn 432, the last of 399"


def test_a_look_ends_before_what_is_known_to_come():
    assert Quiet().passed(3, until_s=10 / 200.0) == [0, 8, 0]
    assert Quiet(alone_s=6.5 / 200.0).passed(2) == [0, 6]
    assert Quiet().passed(2, armed=False) == [0, 200.0 * LONGEST_S - 1]


def test_a_trial_begins_with_single_turns():
    loop = Quiet()
    loop.passed(3)
    loop.ahead.restart()
    assert loop.passed(2) == [0, 32]


def test_a_fault_and_a_mover_that_must_be_polled_are_gone_through_turn_by_turn():
    fault = Fault(device="stage", kind="stall")
    assert Quiet([FaultSchedule([fault])]).passed(3) == [0, 0, 0]
    ends = Fault(device="stage", kind="silent", at_s=11 / 200.0, for_s=1.0)
    assert Quiet([FaultSchedule([ends])]).passed(3) == [0, 9, 0], "a look ends before a fault begins"
    assert Quiet(blind_s=0.005, watched_until_s=0.0).passed(3) == [0, 0, 0]
    loop = Quiet(blind_s=0.006, watched_until_s=0.0)
    assert loop.passed(2) == [0, 32]
    assert loop.device.watched_until_s == 33 / 200.0


class Ring:
    """The latest samples, of which more are kept than are tried."""

    lasting = ("rows",)

    def __init__(self):
        self.rows, self.count = np.zeros(8), 0


def test_a_ring_is_not_put_back_and_a_read_only_array_is_not_copied():
    ring, fixed = Ring(), np.arange(3.0)
    fixed.setflags(write=False)
    thing = SimpleNamespace(ring=ring, fixed=fixed)
    kept = Snapshot([thing])
    ring.rows[1], ring.count = 1.0, 1
    kept.restore()
    assert thing.ring.count == 0 and thing.ring.rows is ring.rows
    assert thing.fixed is fixed
