"""What is kept of a bench while time is tried, and how far the loop looks ahead."""

from collections import deque
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller.look_ahead import MOST_TURNS, Reach, Snapshot, UnkeptError, turns_before


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


def _closure():
    kept = []
    return lambda: kept.append(1)


@pytest.mark.parametrize(
    "held", [iter([1]), (n for n in ()), [].append, _closure()], ids=lambda held: type(held).__name__
)
def test_what_cannot_be_copied_is_refused(held):
    with pytest.raises(UnkeptError):
        Snapshot([SimpleNamespace(held=held)])


def test_turns_before_an_event_are_those_in_which_it_is_not_seen():
    assert turns_before(0.05, first=1, stride=1, rate_hz=200.0) == 9, "turn 10 is at 0.05 s and sees it"
    assert turns_before(0.051, first=1, stride=1, rate_hz=200.0) == 10
    assert turns_before(0.05, first=4, stride=4, rate_hz=200.0) == 2
    assert turns_before(0.0, first=4, stride=4, rate_hz=200.0) == 0


def test_the_reach_grows_in_quiet_and_ends_before_what_happened():
    reach = Reach()
    reach.quiet(armed=True)
    reach.quiet(armed=True)
    assert reach.turns == 64
    reach.happened(16, before=5)
    assert reach.turns == 5
    reach.quiet(armed=True)
    assert reach.turns == 1, "the next turn sees it"
    reach.quiet(armed=False)
    assert reach.turns > MOST_TURNS, "no detector is armed"
    reach.turns = 16
    reach.happened(16, before=15)
    assert reach.turns == 8, "at the end: when is not known"


class Ring:
    """The latest samples, of which more are kept than are tried."""

    lasting = ("rows",)

    def __init__(self):
        self.rows, self.count = np.zeros(8), 0


def test_a_ring_is_not_put_back_and_a_read_only_array_is_not_copied():
    ring, fixed = Ring(), np.arange(3.0)
    fixed.setflags(write=False)
    thing = SimpleNamespace(ring=ring, fixed=fixed, pair=(1, "a"))
    pair = thing.pair
    kept = Snapshot([thing])
    ring.rows[1], ring.count = 1.0, 1
    kept.restore()
    assert thing.ring.count == 0 and thing.ring.rows is ring.rows
    assert thing.fixed is fixed and thing.pair is pair
