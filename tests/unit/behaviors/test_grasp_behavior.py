"""A grasp: the fragments joined, and what the lift adds to them."""

import pytest

from behaviors.events import Resumed, SlipEnded, SlipStarted, Tick
from behaviors.grasp import Grasp, GraspSettings
from behaviors.search import SearchFactors
from drivers.core.messages import Grip, Gripped, MovePose, Release
from tests.unit.behaviors.driving import arm, jaws, lost, seen, still, tell, touch

NAMES = frozenset({"left_ours", "right_ours", "left_contact", "right_contact", "slip"})
FOUND = [
    arm(1.0, 0.0),
    jaws(2.0),
    jaws(3.0),
    arm(4.0, 0.0),
    Tick(6.0),
    seen(6.5, "left_ours", 0.005),
    still(6.6, 0.0055),
    seen(8.0, "right_ours", -0.001),
    still(8.1, -0.0015),
    arm(9.0, 0.002),
    Tick(11.0),
    Gripped(12.0, "gripper", True, 0.019, 10.0),
    touch(12.1, "left_contact"),
    touch(12.2, "right_contact"),
]


@pytest.fixture
def lifting():
    """A grasp that both fingers feel, and what was commanded last."""
    behavior = Grasp(GraspSettings(slip=("slip",), tightest_n=13.0), SearchFactors(), NAMES)
    behavior.begin(0.0)
    commands = tell(behavior, *FOUND)
    assert behavior.state == "LIFTING"
    return behavior, commands


UP_S = 12.2 + 0.3
"""When the lift, begun at the last contact, has gone 3 mm at 10 mm/s."""


def harder(force_n):
    return Grip("gripper", 0.0, 0.02, force_n)


def slip(t_s):
    return SlipStarted(t_s, "slip", 20.0, 10.0)


def test_what_both_fingers_feel_is_lifted_from_the_middle_held_and_set_down_there(lifting):
    behavior, commands = lifting
    assert commands == [MovePose("arm", (0.002, 0.0, 0.02, 0.0, 0.0, 0.0), 0.01)]
    assert not behavior.handle(arm(14.0, 0.002))
    assert behavior.state == "HOLDING"
    lower = behavior.handle(Tick(15.0))
    assert lower == [MovePose("arm", (0.002, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01)]
    assert behavior.outcome == "held"
    assert behavior.handle(arm(17.0, 0.002)) == [Release("gripper", 0.02)]


def test_a_knock_while_the_pads_take_up_the_weight_is_no_slip(lifting):
    behavior, _ = lifting
    deadline_s = behavior.wake_s
    assert not behavior.handle(slip(12.25))
    assert behavior.wake_s == pytest.approx(UP_S), "a slip would last until the weight is taken up"
    assert not behavior.handle(SlipEnded(12.42, "slip", 5.0, 10.0))
    assert behavior.wake_s == deadline_s
    assert not behavior.handle(Tick(12.6))


def test_a_slip_that_outlasts_the_take_up_makes_the_jaws_press_harder(lifting):
    behavior, _ = lifting
    assert not behavior.handle(slip(12.25))
    assert not behavior.handle(Tick(12.49))
    assert behavior.handle(Tick(12.5)) == [harder(12.0)]


def test_later_a_slip_makes_the_jaws_press_harder_at_once(lifting):
    behavior, _ = lifting
    assert behavior.handle(slip(13.0)) == [harder(12.0)]
    tell(behavior, Gripped(13.1, "gripper", True, 0.019, 12.0), SlipEnded(13.2, "slip", 5.0, 10.0))
    assert not behavior.handle(Tick(13.4)), "it is over"
    assert behavior.handle(slip(13.5)) == [harder(13.0)], "the tightest"
    assert not behavior.handle(Gripped(13.6, "gripper", True, 0.019, 13.0))
    assert not behavior.handle(Tick(13.9)), "it slips on, and no more can be done"
    assert behavior.state == "LIFTING"


def test_a_slip_gets_its_time_to_end_before_the_jaws_press_harder_still(lifting):
    behavior, _ = lifting
    behavior.handle(slip(13.0))
    assert not behavior.handle(Gripped(13.1, "gripper", True, 0.019, 12.0))
    assert not behavior.handle(Tick(13.3))
    assert behavior.handle(Tick(13.35)) == [harder(13.0)]


def test_what_falls_out_of_the_jaws_is_no_grasp(lifting):
    behavior, _ = lifting
    behavior.handle(Gripped(13.0, "gripper", False, 0.0, 0.0))
    assert behavior.state == "LOWERING"
    assert (behavior.outcome, behavior.reason) == ("dropped", "the object was lost in LIFTING")


def test_what_a_finger_no_longer_feels_at_the_end_is_no_grasp(lifting):
    behavior, _ = lifting
    tell(behavior, arm(14.0, 0.002), lost(14.5, "left_contact"), Tick(15.0))
    assert (behavior.outcome, behavior.reason) == ("dropped", "the object was lost in HOLDING")


def test_a_pause_sets_it_down(lifting):
    behavior, _ = lifting
    assert behavior.handle(Resumed(13.0)) == [MovePose("arm", (0.002, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01)]
    assert behavior.reason == "a pause broke the grip off"


def test_a_slip_before_the_lift_is_no_slip_of_the_object():
    behavior = Grasp(GraspSettings(slip=("slip",)), SearchFactors(), NAMES)
    behavior.begin(0.0)
    tell(behavior, *FOUND[:-3])
    assert behavior.state == "CLOSING"
    assert "slip" in behavior.plan.detectors, "it has learned in the rest what noise is"
    assert not behavior.handle(slip(11.5))
