import pytest
from pydantic import ValidationError

from behaviors.events import BaselineReady, Contact, Resumed, Tick
from behaviors.pointer import Pointer, PointerSettings
from drivers.core.messages import Home, MoveAt, Standstill, Stop, Twist
from drivers.core.settings import Settings
from tests.unit.behaviors.driving import arm


def pointer(**settings):
    given = {"angles_rad": (-0.5, 0.5), **settings}
    return Pointer(PointerSettings(**given), Settings(), frozenset({"touch"}))


def ready(t_s, detector="touch"):
    return BaselineReady(t_s, detector, 0.0, 1.0)


def contact(t_s, detector="touch"):
    return Contact(t_s, detector, 1.1, 1.0)


TOUCH = [
    ("WAITING", ready),
    ("DESCENDING", contact),
    ("STOPPING", lambda t_s: Standstill(t_s, "arm", 0.003)),
    ("RESTING", Tick),
    ("RECORDING", Tick),
    ("LIFTING", arm),
]
"""The event that leads out of each state of a touch."""

BEFORE = [("HOMING", arm), ("ZEROING", Tick), ("TURNING", arm)]


def to(state):
    """A trial, driven into a state by the events that lead there."""
    behavior = pointer()
    behavior.begin(0.0)
    t_s = 0.0
    for at, event in [*BEFORE, *TOUCH]:
        if state is at:
            break
        assert behavior.state is at
        t_s += 1.0
        behavior.handle(event(t_s))
    return behavior, t_s


def run(behavior):
    """Goes through a whole trial; returns every command, in order."""
    leave = dict([*BEFORE, *TOUCH])
    leave["UNTURNING"] = leave["RETURNING"] = arm
    commands = list(behavior.begin(0.0))
    t_s = 0.0
    while not behavior.done:
        t_s += 1.0
        event = leave[behavior.state](t_s)
        if behavior.state == "TURNING" and commands[-1] == Stop("arm"):
            event = Standstill(t_s, "arm", 0.0)
        commands += behavior.handle(event)
    return commands


def test_every_angle_is_touched_up_and_then_down_again():
    behavior = pointer(angles_rad=(-0.5, 0.0, 0.5), turn_rad_s=0.5)
    commands = run(behavior)
    turns = [command for command in commands if isinstance(command, Twist)]
    turned, angles = 0.0, []
    for turn in turns:
        assert turn.twist[:4] + turn.twist[5:] == (0.0,) * 5
        turned += turn.twist[4] * turn.duration_s
        angles.append(turned)
    assert angles == pytest.approx([-0.5, 0.0, 0.5, 0.0, -0.5, 0.0]), "the last up is the first down"
    descents = [command for command in commands if isinstance(command, MoveAt) and command.velocity_m_s > 0.0]
    assert len(descents) == 6
    assert commands[0] == commands[-1] == Home("arm")
    assert behavior.outcome == "contact"


def test_a_touch_stops_the_arm_rests_records_and_lifts_turned_as_it_is():
    behavior, t_s = to("DESCENDING")
    assert behavior.handle(contact(t_s)) == [Stop("arm")]
    assert behavior.handle(Standstill(t_s, "arm", 0.003)) == []
    assert behavior.handle(Tick(t_s + 0.3)) == []
    assert behavior.state == "RECORDING"
    assert behavior.handle(Tick(t_s + 0.8)) == [MoveAt("arm", -0.01, 0.0)]


def test_an_angle_without_a_table_ends_the_trial_without_contact():
    behavior, t_s = to("DESCENDING")
    assert behavior.handle(arm(t_s)) == [MoveAt("arm", -0.01, 0.0)]
    (turn,) = behavior.handle(arm(t_s + 1.0))
    assert turn.twist[4] * turn.duration_s == pytest.approx(0.5), "turned back"
    assert behavior.handle(arm(t_s + 2.0)) == [Home("arm")]
    behavior.handle(arm(t_s + 3.0))
    assert behavior.done
    assert (behavior.outcome, behavior.reason) == ("no_contact", "no contact up to 0.006 m at -0.5 rad")


def paused_in(state):
    behavior, t_s = to(state if state not in ("UNTURNING", "RETURNING") else "DESCENDING")
    while behavior.state is not state:
        t_s += 1.0
        behavior.handle(arm(t_s))
    return behavior, t_s


@pytest.mark.parametrize("state", [state for state in Pointer.states if state not in Pointer.final])
def test_a_pause_is_followed_by_a_lift_wherever_the_tip_may_touch_and_by_the_way_home_elsewhere(state):
    behavior, t_s = paused_in(state)
    off_the_table = ("HOMING", "ZEROING", "UNTURNING", "RETURNING")
    lift = MoveAt("arm", -0.01, 0.0)
    assert behavior.handle(Resumed(t_s)) == [Home("arm") if state in off_the_table else lift]


@pytest.mark.parametrize("state", ["TURNING", *(state for state, _ in TOUCH[:-1])])
def test_after_a_pause_it_lifts_goes_home_and_turns_to_the_same_angle(state):
    behavior, t_s = to(state)
    assert behavior.handle(Resumed(t_s)) == [MoveAt("arm", -0.01, 0.0)]
    assert behavior.handle(arm(t_s + 1.0)) == [Home("arm")]
    behavior.handle(arm(t_s + 2.0))
    (turn,) = behavior.handle(Tick(t_s + 3.0))
    assert turn.twist[4] * turn.duration_s == pytest.approx(-0.5)


def test_only_the_touch_detector_is_armed_and_another_starts_and_ends_no_descent():
    plans = pointer().plans
    assert plans["WAITING"].detectors == plans["DESCENDING"].detectors == {"touch"}
    assert plans["ZEROING"].measures == {"arm.pose"}
    assert plans["RECORDING"].measures == {"signals.tip", "arm.pose"}
    assert plans["LIFTING"].measures == frozenset()
    behavior, t_s = to("WAITING")
    assert behavior.handle(ready(t_s, "other")) == []
    behavior, t_s = to("DESCENDING")
    assert behavior.handle(contact(t_s, "other")) == []
    assert behavior.state == "DESCENDING"


def test_angles_that_do_not_ascend_or_leave_the_half_cylinder_are_refused():
    for angles in ((0.5, -0.5), (0.0,), (0.0, 1.6)):
        with pytest.raises(ValidationError):
            PointerSettings(angles_rad=angles)
