"""An emulated bench's time, with wall time set by the test: no test sleeps."""

import threading
from collections.abc import Callable

import pytest

from simulator.wiring import bench_clock
from simulator.wiring.bench_clock import (
    ABSENCE_S,
    AHEAD_S,
    LOOK_S,
    PATIENCE_S,
    PLACES,
    SLACK_S,
    UNREAD_S,
    BenchClock,
    ClockPage,
    Pace,
)

STEP_S = 0.002


class Wall:
    """The wall's time, and an emulator that turns in it."""

    def __init__(self) -> None:
        self.now_s = 5000.0
        self.turns: Callable[[], object] = lambda: None

    def monotonic_s(self) -> float:
        return self.now_s

    def rest(self, seconds: float) -> None:
        """The emulator turns as often as it is due, whichever thread rests."""
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-9:
            self.now_s = min(self.now_s + STEP_S, until_s)
            self.turns()


@pytest.fixture
def wall(monkeypatch: pytest.MonkeyPatch) -> Wall:
    made = Wall()
    monkeypatch.setattr(bench_clock, "monotonic_s", made.monotonic_s)
    monkeypatch.setattr(bench_clock, "rest", made.rest)
    return made


@pytest.fixture
def emulator(wall: Wall) -> Pace:
    made = Pace()
    wall.turns = made.turn
    made.turn()
    return made


def joined(emulator: Pace) -> BenchClock:
    """The clock of another process on the same page."""
    return BenchClock(ClockPage(emulator.page.path))


def in_a_thread(action: Callable[[], object]) -> None:
    thread = threading.Thread(target=action)
    thread.start()
    thread.join()


def test_time_passes_with_the_wall_where_all_turn_in_time(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    for turn in range(1, 200):
        clock.wait_until(turn * 0.005)
        assert clock.now() == pytest.approx(turn * 0.005, abs=2 * LOOK_S)
    assert wall.now_s == pytest.approx(5000.0 + 199 * 0.005, abs=2 * LOOK_S)


def test_a_loop_that_is_held_up_is_late_by_its_slack_and_no_more(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    clock.wait_until(0.005)
    wall.rest(0.5)
    assert clock.now() == pytest.approx(0.005 + SLACK_S)
    clock.wait_until(0.010)
    assert clock.now() <= 0.010 + SLACK_S


def test_an_emulator_that_is_held_up_holds_time(wall: Wall, emulator: Pace) -> None:
    clock, t_s = joined(emulator), 0.0
    wall.now_s += 0.5
    assert clock.now() == pytest.approx(AHEAD_S)
    t_s = emulator.turn()
    assert t_s == pytest.approx(AHEAD_S)


def test_a_loop_that_hangs_is_waited_for_no_longer_than_its_patience(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    clock.wait_until(0.1)
    wall.rest(PATIENCE_S)
    held_s = clock.now()
    assert held_s == pytest.approx(0.1 + SLACK_S)
    wall.rest(1.0)
    assert clock.now() == pytest.approx(held_s + 1.0, abs=2 * AHEAD_S), "the watchdogs' time goes on"
    clock.wait_until(clock.now() + 0.005)
    held_s = clock.now() + SLACK_S
    wall.rest(0.5)
    assert clock.now() == pytest.approx(held_s), "and waits again for one that turns again"


def test_a_machine_that_stands_still_uses_up_no_patience(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    clock.wait_until(0.1)
    for asked in (False, True, False):
        wall.now_s += 3.0  # emulator and loop alike
        if asked:
            emulator.wait_s(clock.monotonic_s())  # held up just before it asked
        wall.rest(0.2)  # the emulator is served again before the loop
        assert clock.now() == pytest.approx(0.1 + SLACK_S)
    wall.rest(PATIENCE_S)
    assert clock.now() > 0.1 + SLACK_S, "a loop that hangs is one that is served"


def test_an_emulator_that_is_gone_blocks_no_thread_for_ever(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    wall.now_s += ABSENCE_S + 2.0
    assert clock.now() == pytest.approx(AHEAD_S + 2.0)


def test_time_waits_for_the_one_that_is_farthest_behind_and_for_none_that_has_left(
    wall: Wall, emulator: Pace
) -> None:
    clock = joined(emulator)
    clock.hold(0.2)
    in_a_thread(lambda: clock.hold(0.1))
    wall.rest(PATIENCE_S / 2)
    assert clock.monotonic_s() == pytest.approx(0.1)
    in_a_thread(lambda: clock.hold(0.3))  # another thread has another place
    wall.rest(PATIENCE_S / 2)
    clock.hold(0.4)
    wall.rest(0.2)
    assert clock.monotonic_s() == pytest.approx(0.3), "the first of the threads is waited for no longer"
    clock.leave()
    in_a_thread(clock.leave)  # a thread without a place leaves none
    wall.rest(2 * PATIENCE_S)
    assert clock.monotonic_s() > 1.0


def test_long_waits_say_that_they_go_on(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    clock.rest(10.0)
    held_s = clock.now() + SLACK_S
    wall.rest(0.5)
    assert clock.now() == pytest.approx(held_s), "a sleeper of ten seconds is waited for as well"


def test_bytes_that_lie_unread_hold_time_for_a_second_of_the_wall_at_most(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    wall.turns = lambda: emulator.turn(frozenset({"board"}))
    wall.rest(0.5)
    assert clock.now() == pytest.approx(UNREAD_S, abs=AHEAD_S)
    wall.turns = emulator.turn
    wall.rest(0.1)
    went_s = clock.now()
    assert went_s == pytest.approx(0.1, abs=2 * AHEAD_S), "they were read"
    wall.turns = lambda: emulator.turn(frozenset({"board"}))
    wall.rest(PATIENCE_S + 1.0)
    assert clock.now() == pytest.approx(went_s + 1.0, abs=3 * AHEAD_S), "that line is not read"


def test_time_never_turns_back_whatever_is_held(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    before_s = 0.0
    for round_ in range(300):
        clock.hold(clock.monotonic_s() + (round_ % 7 - 3) * 0.002)
        wall.rest(0.0007)
        assert clock.monotonic_s() >= before_s
        before_s = clock.monotonic_s()


def test_in_real_time_no_thread_is_waited_for(wall: Wall) -> None:
    free = Pace(free=True)
    wall.turns = free.turn
    free.turn()
    clock = joined(free)
    clock.hold(0.0)
    wall.rest(0.3)
    wall.now_s += 0.2
    assert clock.now() == pytest.approx(0.5)


def test_bench_time_begins_anew_and_monotonic_time_does_not(wall: Wall, emulator: Pace) -> None:
    clock = joined(emulator)
    clock.rest(1.0)
    clock.restart()
    assert clock.now() == pytest.approx(0.0)
    assert clock.monotonic_s() == pytest.approx(1.0)
    assert clock.from_monotonic(1.25) == pytest.approx(0.25)


def test_a_trial_that_is_being_prepared_holds_time_for_as_long_as_it_takes(
    wall: Wall, emulator: Pace
) -> None:
    clock = joined(emulator)
    clock.restart()
    wall.rest(5 * PATIENCE_S)
    assert clock.now() == pytest.approx(SLACK_S)
    clock.wait_until(0.005)
    wall.rest(2 * PATIENCE_S)
    assert clock.now() > 0.5, "from the first turn on the bench is no more patient than ever"


def test_places_of_those_who_left_are_taken_again_and_there_is_an_end_to_them(
    wall: Wall, emulator: Pace
) -> None:
    page = emulator.page
    places = [page.take() for _ in range(PLACES)]
    assert sorted(places) == list(range(PLACES))
    with pytest.raises(RuntimeError, match="more than"):
        page.take()
    page.allow(7, float("inf"))
    assert page.take() == 7
