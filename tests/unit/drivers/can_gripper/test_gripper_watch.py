"""What a watch makes of one state after the other."""

from __future__ import annotations

from dataclasses import replace

import pytest

from drivers.can_gripper.brackets import Brackets
from drivers.can_gripper.messages import GripFinding, GripperState
from drivers.can_gripper.watch import Watch
from drivers.core.messages import (
    Command,
    Grip,
    Gripped,
    Home,
    Reached,
    Release,
    Stalled,
    Standstill,
    Status,
    Stop,
)

GRIP = Grip("gripper", 0.02, 0.1, 20.0)
MOVING = GripperState(100, -400, GripFinding.MOVING, True, True, False, False, False, True)
CLOSING = replace(MOVING, finding=GripFinding.OBJECT_CLOSING)
OPENING = replace(MOVING, finding=GripFinding.OBJECT_OPENING)
THERE = replace(MOVING, finding=GripFinding.AT_POSITION)


@pytest.fixture
def watch() -> Watch:
    made = Watch("gripper", Brackets(0.010), hold_s=0.03)
    made.begin(GRIP, 1.0, drives=True)
    return made


def pushed(watch: Watch, *states: GripperState, begin_s: float = 1.01, fault: bool = False) -> list[Status]:
    """States 10 ms apart."""
    return [
        status
        for number, state in enumerate(states)
        for status in watch.push(begin_s + 0.01 * number, state, fault)
    ]


def test_what_holds_the_jaws_for_a_moment_is_no_object(watch: Watch) -> None:
    """A start at full current looks like one until the jaws are fast enough."""
    assert pushed(watch, CLOSING, CLOSING, MOVING, CLOSING, CLOSING, CLOSING, MOVING) == []
    assert watch.busy


@pytest.mark.parametrize("held", [CLOSING, OPENING])
def test_either_object_bit_is_an_object_once_it_is_held(watch: Watch, held: GripperState) -> None:
    (gripped,) = pushed(watch, *[held] * 10)
    assert isinstance(gripped, Gripped)
    assert gripped.object
    assert gripped.t_s == pytest.approx(1.04)
    assert gripped.force_n == pytest.approx(400 * 0.0462)


def test_a_state_from_before_the_command_says_nothing_of_it(watch: Watch) -> None:
    assert pushed(watch, THERE, begin_s=1.0) == []
    assert len(pushed(watch, THERE, begin_s=1.001)) == 1


def test_an_object_that_moves_within_the_grip_is_reported_when_it_is_gone_alone(watch: Watch) -> None:
    pushed(watch, *[CLOSING] * 5)
    assert watch.resting
    assert pushed(watch, MOVING, MOVING, begin_s=1.1) == []
    assert not watch.resting
    assert pushed(watch, *[CLOSING] * 5, begin_s=1.2) == []
    (lost,) = pushed(watch, MOVING, THERE, THERE, begin_s=1.3)
    assert isinstance(lost, Gripped)
    assert not lost.object


def test_a_grip_rests_through_stops_and_homes_that_drive_nothing(watch: Watch) -> None:
    pushed(watch, *[CLOSING] * 5)
    for command in (Stop("gripper"), Stop("gripper"), Home("gripper"), Stop("gripper")):
        watch.begin(command, 1.1, drives=False)
        assert watch.busy
        assert watch.resting


def test_a_motion_is_something_to_stop_whatever_was_asked_since(watch: Watch) -> None:
    pushed(watch, MOVING)
    watch.begin(Home("gripper"), 1.1, drives=False)
    assert pushed(watch, MOVING, begin_s=1.11) == [Reached(1.11, "gripper", pytest.approx(0.0392, abs=1e-4))]
    assert not watch.resting
    pushed(watch, THERE, begin_s=1.2)
    assert watch.resting


def test_nothing_is_left_to_stop_after_a_fault(watch: Watch) -> None:
    watch.begin(Stop("gripper"), 1.0, drives=True)
    pushed(watch, replace(MOVING, estop=True), fault=True)
    assert watch.resting


def test_a_fault_is_reported_once_and_ends_the_command(watch: Watch) -> None:
    late = replace(MOVING, watchdog=True)
    (stalled,) = pushed(watch, late, late, late, fault=True)
    assert isinstance(stalled, Stalled)
    assert "watchdog" in stalled.reason
    assert "send Home" in stalled.reason
    assert pushed(watch, THERE, THERE, begin_s=2.0) == []


def test_a_fault_while_stopping_is_reported_beside_the_standstill(watch: Watch) -> None:
    watch.begin(Stop("gripper"), 1.0, drives=True)
    statuses = pushed(watch, *[replace(MOVING, estop=True)] * 10, fault=True)
    assert [type(status) for status in statuses] == [Stalled, Standstill]


def test_jaws_that_still_move_do_not_stand_still(watch: Watch) -> None:
    watch.begin(Stop("gripper"), 1.0, drives=True)
    assert pushed(watch, *[replace(MOVING, position=place) for place in range(100, 120)]) == []
    (still,) = pushed(watch, *[MOVING] * 10, begin_s=1.3)
    assert isinstance(still, Standstill)


def test_release_is_held_up_by_an_object(watch: Watch) -> None:
    watch.begin(Release("gripper", 0.1), 1.0, drives=True)
    (stalled,) = pushed(watch, *[OPENING] * 6)
    assert isinstance(stalled, Stalled)
    assert "39.2 mm" in stalled.reason, "10 mm and 155 of 255 counts of 48 mm"


LOOKING = replace(MOVING, calibrated=False)
WIDTH_M = Brackets(0.010).width_m(100)


def after(number: int) -> float:
    """When the state of this number was asked for."""
    return 1.01 + 0.01 * number


@pytest.mark.parametrize(
    ("command", "states", "answer"),
    [
        (GRIP, [CLOSING] * 4, Gripped(after(3), "gripper", True, WIDTH_M, 400 * 0.0462, command_id=7)),
        (GRIP, [MOVING, THERE], Gripped(after(1), "gripper", False, WIDTH_M, 400 * 0.0462, command_id=7)),
        (Release("gripper", 0.1), [MOVING, THERE], Reached(after(1), "gripper", WIDTH_M, command_id=7)),
        (
            Release("gripper", 0.1),
            [OPENING] * 4,
            Stalled(after(3), "gripper", "something holds its jaws at 39.2 mm", command_id=7),
        ),
        (Home("gripper"), [LOOKING, MOVING], Reached(after(1), "gripper", WIDTH_M, command_id=7)),
        (Stop("gripper"), [MOVING] * 6, Standstill(after(5), "gripper", WIDTH_M, command_id=7)),
        (Stop("gripper"), [MOVING, THERE], Standstill(after(1), "gripper", WIDTH_M, command_id=7)),
    ],
)
def test_each_command_is_answered_once_under_its_number(
    watch: Watch, command: Command, states: list[GripperState], answer: Status
) -> None:
    watch.begin(replace(command, id=7), 1.0, drives=True)
    assert pushed(watch, *states[:-1]) == []
    assert watch.busy is True
    assert watch.resting is False
    assert watch.push(after(len(states) - 1), states[-1], False) == [answer]
    assert watch.busy is False
    assert pushed(watch, *states[-1:] * 3, begin_s=after(len(states))) == []
    assert watch.resting is isinstance(command, Stop | Home) or states[-1].finding is not GripFinding.MOVING


def test_nothing_is_due_or_to_stop_before_the_first_command() -> None:
    watch = Watch("gripper", Brackets(0.010), hold_s=0.03)
    assert (watch.busy, watch.faulty, watch.resting) == (False, False, True)
    assert pushed(watch, MOVING, THERE) == []


def test_what_holds_jaws_that_look_for_their_ends_is_an_end(watch: Watch) -> None:
    watch.begin(Home("gripper"), 1.0, drives=True)
    assert pushed(watch, *[replace(CLOSING, calibrated=False)] * 6) == []
    assert not watch.resting
    assert len(pushed(watch, THERE, begin_s=2.0)) == 1
    assert watch.resting


def test_a_calibration_is_given_up_after_32_seconds(watch: Watch) -> None:
    watch.begin(replace(Home("gripper"), id=7), 1.0, drives=True)
    assert watch.push(33.0, LOOKING, False) == []
    reason = "it gave up its calibration; are its jaws free, and is it supplied with 24 V?"
    assert watch.push(33.5, LOOKING, False) == [Stalled(33.5, "gripper", reason, command_id=7)]
    assert not watch.busy
    assert watch.resting
    assert watch.push(34.0, LOOKING, False) == []


@pytest.mark.parametrize(
    ("faults", "faults_text"),
    [
        ({"over_temperature": True, "estop": True}, "it is too hot and its emergency stop is up"),
        ({}, "it reports a fault of its motor or supply"),
    ],
)
def test_a_fault_is_reported_under_the_commands_number(
    watch: Watch, faults: dict[str, bool], faults_text: str
) -> None:
    watch.begin(replace(GRIP, id=7), 1.0, drives=True)
    reason = f"{faults_text}, and whatever it held is loose; send Home"
    assert watch.push(1.1, replace(MOVING, **faults), True) == [Stalled(1.1, "gripper", reason, command_id=7)]


def test_jaws_that_are_held_where_they_stood_free_before_grip_nothing(watch: Watch) -> None:
    pushed(watch, THERE)
    watch.begin(replace(GRIP, id=7), 1.1, drives=True)
    (stalled,) = pushed(watch, *[CLOSING] * 5, begin_s=1.11)
    assert isinstance(stalled, Stalled)
    assert stalled.command_id == 7
    assert "39.2 mm" in stalled.reason
    assert "nothing" in stalled.reason
