"""What the gripper's driver writes, frame by frame, and when it asks: on an emulated gripper, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.can_gripper.codec import decode_order
from drivers.can_gripper.messages import AskState, DriveOrder, GripperCode, Order, Plain, Poll, Watchdog
from drivers.core.messages import Applied, Failed, Grip, Home, Listen, Lost, Refused, Release, Sent, Stop
from tests.unit.drivers.can_gripper.gripper_bench import DELAY_S, FRAME_S, Bench

GRIP = Grip("gripper", 0.020, 0.1, 20.0)
OPEN_SLOWLY = Release("gripper", 0.02)
WIDTH, FORCE = "gripper.width", "gripper.force"
IDLE = DriveOrder(0, 0, 0, activate=False, go=False)
CLEAR, CALIBRATE, SLEEP = (
    Plain(code) for code in (GripperCode.CLEAR_ERROR, GripperCode.CALIBRATE, GripperCode.IDLE)
)
STEADY_MA = 324
"""15 N at 0.0462 N/mA, rounded down."""

Make = Callable[..., Bench]


def orders(bench: Bench, deed: Callable[[], object]) -> list[Order]:
    """What is written meanwhile."""
    before = len(bench.host.sent)
    deed()
    return [decode_order(frame)[1] for frame in bench.host.sent[before:]]


def applied(bench: Bench, *commands: object) -> list[Order]:
    return orders(bench, lambda: [bench.apply(command) for command in commands])


def grip_the_mug(bench: Bench) -> None:
    bench.apply(Release("gripper", 0.1))
    bench.turn(0.6)
    bench.place("mug")
    bench.apply(GRIP)
    bench.turn(0.5)
    bench.statuses.clear()


def position(bench: Bench) -> int:
    assert bench.driver._state is not None
    return bench.driver._state.position


def test_open_sets_the_watchdog_and_stops_nothing_that_stands(make_bench: Make) -> None:
    bench = make_bench(watchdog_s=2.5)
    *asked, last = orders(bench, bench.open)
    assert asked == [AskState(code) for code in (25, 26, 23, 24)] + [Poll()]
    assert last == Watchdog(2500)


def test_open_stops_what_moves_where_it_is_with_little_force(make_bench: Make) -> None:
    bench = make_bench()
    bench.open()
    bench.apply(OPEN_SLOWLY)
    bench.turn(0.3)
    bench.driver._failure = "the program was killed"
    assert orders(bench, bench.driver.close) == []
    watchdog, hold = orders(bench, bench.open)[-2:]
    assert watchdog == Watchdog(1000)
    assert hold == DriveOrder(position(bench), 0, STEADY_MA)


def test_what_the_last_session_left_is_forgotten_at_open(bench: Bench) -> None:
    bench.apply(Listen("gripper", frozenset({WIDTH})))
    grip_the_mug(bench)
    bench.driver.close()
    bench.open()
    assert applied(bench, Stop("gripper")) == [Poll()]
    bench.turn(0.3)
    bench.blocks.clear()
    assert len(orders(bench, lambda: bench.turn(1.0))) <= 11, "asked ten times a second: nothing is under way"
    assert bench.blocks == []


def test_closing_a_grip_only_switches_the_watchdog_off(bench: Bench) -> None:
    grip_the_mug(bench)
    assert orders(bench, bench.driver.close) == [Watchdog(0)]


def test_closing_in_motion_holds_the_jaws_where_they_were_last_seen(bench: Bench) -> None:
    speed = applied(bench, OPEN_SLOWLY)[0].speed  # type: ignore[union-attr]
    bench.turn(0.3)
    hold = DriveOrder(position(bench), speed, STEADY_MA)
    assert orders(bench, bench.driver.close) == [hold, Watchdog(0)]


def test_closing_a_calibration_puts_the_drive_to_sleep(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    bench.apply(Home("gripper"))
    bench.turn(0.3)
    assert orders(bench, bench.driver.close) == [SLEEP, Watchdog(0)]


def test_closing_a_gripper_that_has_failed_writes_nothing(bench: Bench) -> None:
    """Its watchdog lets go by itself."""
    bench.apply(OPEN_SLOWLY)
    bench.host.spoil = lambda frame: None
    bench.turn(1.0)
    assert len(bench.take(Failed)) == 1
    assert orders(bench, bench.driver.close) == []
    assert bench.host.closed


def test_a_stop_in_motion_holds_and_keeps_the_jaws_asked_often(bench: Bench) -> None:
    applied(bench, OPEN_SLOWLY)
    bench.turn(0.3)
    seen = position(bench)
    (hold,) = applied(bench, Stop("gripper"))
    assert isinstance(hold, DriveOrder)
    assert (hold.position, hold.current_ma, hold.go) == (seen, STEADY_MA, True)
    bench.turn(0.3)
    assert 45 <= len(orders(bench, lambda: bench.turn(0.5))) <= 52, "they hold: a hundred times a second"


def test_a_stop_of_a_calibration_puts_the_drive_to_sleep(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    bench.apply(Home("gripper"))
    bench.turn(0.3)
    assert applied(bench, Stop("gripper")) == [SLEEP]


def test_home_writes_what_is_missing_and_no_more(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    home = Home("gripper")
    assert applied(bench, home) == [IDLE, CLEAR, CALIBRATE]
    bench.turn(3.0)
    assert applied(bench, home) == [Poll()]
    bench.host.gripper.inject("overheat", bench.host.now_s)
    assert AskState(GripperCode.ERRORS) in orders(bench, lambda: bench.turn(0.2))
    assert applied(bench, home) == [IDLE, CLEAR]
    bench.turn(0.2)
    assert applied(bench, home) == [Poll()]


def test_a_fault_is_asked_about_once(bench: Bench) -> None:
    bench.host.gripper.inject("overheat", bench.host.now_s)
    asked = orders(bench, lambda: bench.turn(1.0))
    assert asked.count(AskState(GripperCode.ERRORS)) == 1


@pytest.mark.parametrize("command", [GRIP, OPEN_SLOWLY])
def test_what_cannot_be_done_is_refused_unwritten_with_what_to_do(make_bench: Make, command: Grip) -> None:
    bench = make_bench(calibrated=False)
    bench.open()

    def refused() -> object:
        now_s = bench.clock.now()
        assert applied(bench, command) == []
        (status,) = bench.driver.poll()
        assert isinstance(status, Refused)
        assert (status.t_s, status.device) == (now_s, "gripper")
        return status.reason

    assert refused() == "it does not know its ends; send Home first, with empty jaws"
    bench.apply(Home("gripper"))
    bench.turn(3.0)
    bench.host.gripper.inject("overheat", bench.host.now_s)
    bench.turn(0.2)
    bench.driver.poll()
    assert refused() == "it has a fault; send Home, which clears it"


def test_apply_says_what_was_sent_and_when(bench: Bench) -> None:
    quick = bench.driver.apply(Release("gripper", 9.0))
    assert isinstance(quick.command, Release)
    assert quick.command.speed_m_s == pytest.approx(0.1, rel=0.02)
    assert quick.t_s == bench.clock.now()
    (sent,) = bench.driver.poll()
    assert sent == Sent(quick.t_s, "gripper", quick.command)
    listen = Listen("gripper", frozenset({WIDTH, "board.force"}))
    assert bench.driver.apply(listen) == Applied(listen, bench.clock.now())


def test_what_a_bus_that_has_just_gone_does_not_take_was_not_sent(bench: Bench) -> None:
    bench.host.fault = "the bus was taken away"
    bench.apply(Stop("gripper"))
    statuses = bench.driver.poll()
    assert statuses == [Failed(bench.clock.now(), "gripper", "the bus was taken away")]


def test_ten_questions_in_a_row_without_an_answer_are_a_failure_and_nine_are_not(bench: Bench) -> None:
    bench.apply(Listen("gripper", frozenset({WIDTH, FORCE})))
    bench.turn(0.2)
    bench.statuses.clear()
    begin_s = bench.clock.now()
    bench.host.spoil = lambda frame: None
    while not any(isinstance(status, Failed) for status in bench.statuses):
        bench.turn(0.005)
        assert bench.clock.now() < begin_s + 2.0
    failed: Any
    (failed,) = bench.take(Failed)
    assert failed.reason == "no answer to 10 polls in a row; is it powered, and the bus whole?"
    lost: Any = bench.take(Lost)
    assert [(status.stream, status.samples) for status in lost] == [(FORCE, 1), (WIDTH, 1)] * 10
    assert lost[0].t_s == pytest.approx(begin_s, abs=0.011)
    assert lost[-1].t_s - lost[0].t_s == pytest.approx(0.5, abs=0.06), (
        "one every 50 ms, when the last was given up"
    )
    assert failed.t_s - begin_s == pytest.approx(0.55, abs=0.06)
    assert bench.driver.account()["lost"] == 10


def test_nine_lost_answers_and_one_that_comes_are_no_failure(bench: Bench) -> None:
    begin_s = bench.clock.now()
    while bench.clock.now() < begin_s + 3.0:
        bench.host.spoil = lambda frame: None
        bench.turn(0.4)
        bench.host.spoil = lambda frame: frame
        bench.turn(0.15)
    assert bench.take(Failed) == []


def test_no_question_is_asked_while_one_waits_for_its_answer(bench: Bench) -> None:
    bench.apply(Listen("gripper", frozenset({WIDTH})))
    bench.turn(0.2)
    bench.host.spoil = lambda frame: None
    assert 1 <= len(orders(bench, lambda: bench.turn(0.05))) <= 2


def test_a_sample_is_dated_between_its_question_and_its_answer(bench: Bench) -> None:
    bench.apply(Listen("gripper", frozenset({WIDTH})))
    bench.turn(0.1)
    block = bench.blocks[-1]
    assert block.arrival_s is not None
    assert block.arrival_s - block.times[-1] == pytest.approx(0.5 * DELAY_S, abs=1e-9)
    assert FRAME_S < DELAY_S
