"""What is made of one state after the other."""

from dataclasses import replace

import pytest

from drivers.can_gripper.units import GripperUnits
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
from drivers.gripper.outcome import GripperOutcome
from drivers.gripper.state import GripFinding, GripperState

GRIP = Grip("gripper", 0.02, 0.1, 20.0)
MOVING = GripperState(100, -400, GripFinding.MOVING, True, True, False, False, False, True)
CLOSING = replace(MOVING, finding=GripFinding.OBJECT_CLOSING)
OPENING = replace(MOVING, finding=GripFinding.OBJECT_OPENING)
THERE = replace(MOVING, finding=GripFinding.AT_POSITION)


@pytest.fixture
def outcome() -> GripperOutcome:
    made = GripperOutcome("gripper", GripperUnits(0.010), hold_s=0.03)
    made.begin(GRIP, 1.0, drives=True)
    return made


def pushed(
    outcome: GripperOutcome, *states: GripperState, begin_s: float = 1.01, fault: bool = False
) -> list[Status]:
    """States 10 ms apart."""
    return [
        status
        for number, state in enumerate(states)
        for status in outcome.push(begin_s + 0.01 * number, state, fault)
    ]


def test_what_holds_the_jaws_for_a_moment_is_no_object(outcome: GripperOutcome) -> None:
    """A start at full current looks like one until the jaws are fast enough."""
    assert pushed(outcome, CLOSING, CLOSING, MOVING, CLOSING, CLOSING, CLOSING, MOVING) == []
    assert outcome.busy


def test_a_state_from_before_the_command_says_nothing_of_it(outcome: GripperOutcome) -> None:
    assert pushed(outcome, THERE, begin_s=1.0) == []
    assert len(pushed(outcome, THERE, begin_s=1.001)) == 1


def test_an_object_that_moves_within_the_grip_is_reported_when_it_is_gone_alone(
    outcome: GripperOutcome,
) -> None:
    pushed(outcome, *[CLOSING] * 5)
    assert outcome.resting
    assert pushed(outcome, MOVING, MOVING, begin_s=1.1) == []
    assert not outcome.resting
    assert pushed(outcome, *[CLOSING] * 5, begin_s=1.2) == []
    (lost,) = pushed(outcome, MOVING, THERE, THERE, begin_s=1.3)
    assert isinstance(lost, Gripped)
    assert not lost.object
    assert pushed(outcome, CLOSING, begin_s=1.4) == []
    assert not outcome.settled(CLOSING), "it may be a new object"


def test_a_grip_rests_through_stops_and_homes_that_drive_nothing(outcome: GripperOutcome) -> None:
    pushed(outcome, *[CLOSING] * 5)
    for command in (Stop("gripper"), Stop("gripper"), Home("gripper"), Stop("gripper")):
        outcome.begin(command, 1.1, drives=False)
        assert outcome.busy
        assert outcome.resting


def test_a_motion_is_something_to_stop_whatever_was_asked_since(outcome: GripperOutcome) -> None:
    pushed(outcome, MOVING)
    outcome.begin(Home("gripper"), 1.1, drives=False)
    assert pushed(outcome, MOVING, begin_s=1.11) == [
        Reached(1.11, "gripper", pytest.approx(0.0392, abs=1e-4))
    ]
    assert not outcome.resting
    pushed(outcome, THERE, begin_s=1.2)
    assert outcome.resting


def test_nothing_is_left_to_stop_after_a_fault(outcome: GripperOutcome) -> None:
    outcome.begin(Stop("gripper"), 1.0, drives=True)
    pushed(outcome, replace(MOVING, estop=True), fault=True)
    assert outcome.resting


def test_a_fault_is_reported_once_and_ends_the_command(outcome: GripperOutcome) -> None:
    late = replace(MOVING, watchdog=True)
    (stalled,) = pushed(outcome, late, late, late, fault=True)
    assert isinstance(stalled, Stalled)
    assert "watchdog" in stalled.reason
    assert "send Home" in stalled.reason
    assert not outcome.settled(late)
    assert pushed(outcome, THERE, THERE, begin_s=2.0) == []


def test_a_fault_while_stopping_is_reported_beside_the_standstill(outcome: GripperOutcome) -> None:
    outcome.begin(Stop("gripper"), 1.0, drives=True)
    statuses = pushed(outcome, *[replace(MOVING, estop=True)] * 10, fault=True)
    assert [type(status) for status in statuses] == [Stalled, Standstill]


def test_jaws_that_still_move_do_not_stand_still(outcome: GripperOutcome) -> None:
    outcome.begin(Stop("gripper"), 1.0, drives=True)
    assert pushed(outcome, *[replace(MOVING, position=place) for place in range(100, 120)]) == []
    (still,) = pushed(outcome, *[MOVING] * 10, begin_s=1.3)
    assert isinstance(still, Standstill)


LOOKING = replace(MOVING, calibrated=False)
WIDTH_M = GripperUnits(0.010).width_m(100)


def after(number: int) -> float:
    """When the state of this number was asked for."""
    return 1.01 + 0.01 * number


@pytest.mark.parametrize(
    ("command", "states", "answer"),
    [
        (GRIP, [CLOSING] * 4, Gripped(after(3), "gripper", True, WIDTH_M, 400 * 0.0462, command_id=7)),
        (GRIP, [OPENING] * 4, Gripped(after(3), "gripper", True, WIDTH_M, 400 * 0.0462, command_id=7)),
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
    outcome: GripperOutcome, command: Command, states: list[GripperState], answer: Status
) -> None:
    outcome.begin(replace(command, id=7), 1.0, drives=True)
    assert pushed(outcome, *states[:-1]) == []
    assert outcome.busy is True
    assert outcome.resting is False
    assert outcome.push(after(len(states) - 1), states[-1], False) == [answer]
    assert outcome.busy is False
    assert pushed(outcome, *states[-1:] * 3, begin_s=after(len(states))) == []
    assert outcome.resting is isinstance(command, Stop | Home) or states[-1].finding is not GripFinding.MOVING


def test_nothing_is_due_or_to_stop_before_the_first_command() -> None:
    outcome = GripperOutcome("gripper", GripperUnits(0.010), hold_s=0.03)
    assert (outcome.busy, outcome.faulty, outcome.resting) == (False, False, True)
    assert pushed(outcome, MOVING, THERE) == []


@pytest.mark.parametrize("command", [GRIP, Release("gripper", 0.1), Stop("gripper"), Home("gripper")])
@pytest.mark.parametrize("state", [MOVING, CLOSING, OPENING, THERE, replace(THERE, calibrated=False)])
def test_a_state_that_settles_all_changes_nothing_however_often_it_comes(
    outcome: GripperOutcome, command: Command, state: GripperState
) -> None:
    outcome.begin(command, 1.0, drives=True)
    assert not outcome.settled(state), "its answer is due"
    settled = False
    for number in range(5000):
        before, settled = vars(outcome).copy(), outcome.settled(state)
        statuses = outcome.push(after(number), state, False)
        if settled:
            assert (statuses, vars(outcome)) == ([], before | {"_still_s": outcome._still_s})
    assert settled or outcome.busy or state.object


def test_what_holds_jaws_that_look_for_their_ends_is_an_end(outcome: GripperOutcome) -> None:
    outcome.begin(Home("gripper"), 1.0, drives=True)
    assert pushed(outcome, *[replace(CLOSING, calibrated=False)] * 6) == []
    assert not outcome.resting
    assert len(pushed(outcome, THERE, begin_s=2.0)) == 1
    assert outcome.resting


def test_a_calibration_is_given_up_after_32_seconds(outcome: GripperOutcome) -> None:
    outcome.begin(replace(Home("gripper"), id=7), 1.0, drives=True)
    assert outcome.push(33.0, LOOKING, False) == []
    reason = "it gave up its calibration; are its jaws free, and is it supplied with 24 V?"
    assert outcome.push(33.5, LOOKING, False) == [Stalled(33.5, "gripper", reason, command_id=7)]
    assert not outcome.busy
    assert outcome.resting
    assert outcome.push(34.0, LOOKING, False) == []


@pytest.mark.parametrize(
    ("faults", "faults_text"),
    [
        ({"over_temperature": True, "estop": True}, "it is too hot and its emergency stop is up"),
        ({}, "it reports a fault of its motor or supply"),
    ],
)
def test_a_fault_is_reported_under_the_commands_number(
    outcome: GripperOutcome, faults: dict[str, bool], faults_text: str
) -> None:
    outcome.begin(replace(GRIP, id=7), 1.0, drives=True)
    reason = f"{faults_text}, and whatever it held is loose; send Home"
    assert outcome.push(1.1, replace(MOVING, **faults), True) == [
        Stalled(1.1, "gripper", reason, command_id=7)
    ]


def test_jaws_that_are_held_where_they_stood_free_before_grip_nothing(outcome: GripperOutcome) -> None:
    pushed(outcome, THERE)
    outcome.begin(replace(GRIP, id=7), 1.1, drives=True)
    (stalled,) = pushed(outcome, *[CLOSING] * 5, begin_s=1.11)
    assert isinstance(stalled, Stalled)
    assert stalled.command_id == 7
    assert "39.2 mm" in stalled.reason
    assert "nothing" in stalled.reason


def test_jaws_that_no_longer_know_their_ends_are_reported_once_whatever_was_last_commanded(
    outcome: GripperOutcome,
) -> None:
    pushed(outcome, *[CLOSING] * 5)
    (stalled,) = pushed(outcome, *[LOOKING] * 3, begin_s=1.1)
    assert isinstance(stalled, Stalled)
    assert "no longer knows its ends" in stalled.reason
    assert "send Home" in stalled.reason
    assert (outcome.busy, outcome.resting, outcome.faulty) == (False, True, False)
    outcome.begin(Home("gripper"), 1.2, drives=True)
    (reached,) = pushed(outcome, LOOKING, LOOKING, MOVING, MOVING, begin_s=1.21)
    assert isinstance(reached, Reached)
    outcome.begin(Stop("gripper"), 1.3, drives=True)
    statuses = pushed(outcome, MOVING, *[LOOKING] * 10, begin_s=1.31)
    assert [type(status) for status in statuses] == [Stalled, Standstill]


def test_jaws_that_a_home_makes_look_for_their_ends_anew_have_lost_nothing(outcome: GripperOutcome) -> None:
    pushed(outcome, *[CLOSING] * 5)
    outcome.begin(Home("gripper"), 1.1, drives=True)
    assert pushed(outcome, CLOSING, begin_s=1.09) == [], "a state from before"
    assert pushed(outcome, *[LOOKING] * 5, begin_s=1.11) == []
    outcome.begin(Stop("gripper"), 1.2, drives=True)
    assert [type(status) for status in pushed(outcome, *[LOOKING] * 10, begin_s=1.21)] == [Standstill]
