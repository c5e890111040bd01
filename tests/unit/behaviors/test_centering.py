import pytest

from behaviors.centering import Centering, CenteringSettings
from behaviors.events import Resumed, Tick
from behaviors.search import HALF_TURN_RAD, SearchFactors
from drivers.core.messages import (
    Excite,
    Grip,
    Gripped,
    Home,
    MoveAt,
    MovePose,
    MoveTo,
    Release,
    Stop,
    Tone,
    Twist,
)
from tests.unit.behaviors.driving import arm, held, jaws, lead, lost, seen, still, tell, touch

DETECTORS = frozenset({"left_ours", "right_ours", "left_contact", "right_contact"})
AWAY = MovePose("arm", (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), 0.05)
GRIPPED = Gripped(12.0, "gripper", True, 0.019, 10.0)

PATH = {
    "CLEARING": [],
    "CALIBRATING": [arm(1.0)],
    "OPENING": [jaws(2.0)],
    "ENTERING": [jaws(3.0)],
    "BASELINE": [arm(4.0)],
    "SEEKING_FORWARD": [Tick(6.0)],
    "TURNING": [seen(6.5, "left_ours", 0.005)],
    "SEEKING_BACKWARD": [still(6.6, 0.0055)],
    "STOPPING": [seen(8.0, "right_ours", -0.001)],
    "CENTERING": [still(8.1, -0.0015)],
    "RESTING": [arm(9.0, 0.002)],
    "CLOSING": [Tick(11.0)],
    "CONFIRMING": [GRIPPED],
    "HOLDING": [touch(12.1, "left_contact"), touch(12.2, "right_contact")],
    "RELEASING": [Tick(13.5)],
    "LEAVING": [jaws(14.0)],
}


def to(state, **settings):
    return lead(Centering(CenteringSettings(**settings), SearchFactors(), DETECTORS), PATH, state)


@pytest.mark.parametrize(("width_m", "state"), [(0.0509, "CONFIRMING"), (0.0511, "FAILED")])
def test_jaws_that_hold_wider_than_the_fingers_came_together_in_the_search_hold_no_object(width_m, state):
    """They were 56 mm apart, and one came 5 mm to the right and the other 1 mm to the left without a touch."""
    behavior, _ = to("CLOSING")
    commands = behavior.handle(Gripped(12.0, "gripper", True, width_m, 10.0))
    assert behavior.state == state
    if state == "FAILED":
        assert commands == [Stop("arm"), Stop("gripper"), Excite("audio", False)]
        assert behavior.outcome == "fault"
        assert "51.1 mm" in behavior.reason
        assert "at most 50.0 mm" in behavior.reason


def test_it_searches_one_way_then_the_other_and_goes_to_the_middle():
    assert to("CLEARING")[1] == [AWAY]
    assert to("CALIBRATING")[1] == [Home("gripper")]
    assert to("OPENING")[1] == [Release("gripper", 0.02)]
    assert to("ENTERING")[1] == [Tone("audio", 40_000.0, 0.5), MovePose("arm", (0.0,) * 6, 0.05)]
    assert to("SEEKING_FORWARD")[1] == [MoveAt("arm", 0.01, 0.017)]
    assert to("TURNING")[1] == [Stop("arm")]
    assert to("SEEKING_BACKWARD")[1] == [MoveAt("arm", -0.01, -0.017)]
    assert to("STOPPING")[1] == [Stop("arm")]
    assert to("CENTERING")[1] == [MoveTo("arm", 0.002, 0.01)]
    assert to("CLOSING")[1] == [Grip("gripper", 0.0, 0.02, 10.0)]
    assert to("RELEASING")[1] == [Release("gripper", 0.02)]
    behavior, _ = to("LEAVING")
    assert behavior.handle(arm(15.0)) == [Excite("audio", False)]
    assert (behavior.done, behavior.outcome) == (True, "centered")


def test_the_finger_behind_the_motion_is_ignored_and_a_touch_during_the_search_stops_at_once():
    behavior, _ = to("SEEKING_FORWARD")
    assert behavior.handle(seen(6.2, "right_ours", 0.001)) == []
    assert behavior.state == "SEEKING_FORWARD"
    assert behavior.handle(touch(6.46, "left_contact")) == [Stop("arm")]
    behavior.handle(still(6.5, 0.01))
    assert behavior.state == "LEAVING"
    assert behavior.reason == "touched during the search"


def test_a_sweep_that_sees_nothing_leaves_and_names_the_finger():
    behavior, _ = to("SEEKING_BACKWARD")
    assert behavior.handle(arm(9.0, -0.017)) == [AWAY]
    behavior.handle(arm(10.0))
    assert behavior.outcome == "not_found"
    assert "right finger saw nothing" in behavior.reason


def test_fingers_that_feel_it_before_the_gripper_reports_it_confirm_at_once_and_one_alone_does_not():
    behavior, _ = to("CLOSING")
    tell(behavior, touch(11.5, "left_contact"), touch(11.6, "right_contact"), GRIPPED)
    assert behavior.state == "HOLDING"
    behavior, _ = to("CONFIRMING")
    tell(behavior, touch(12.1, "left_contact"), lost(12.2, "left_contact"))
    assert behavior.handle(touch(12.3, "right_contact")) == []
    assert behavior.state == "CONFIRMING"
    assert behavior.handle(Tick(13.1)) == [Release("gripper", 0.02)]
    assert "no contact felt" in behavior.reason


def test_jaws_that_close_on_nothing_open_again_and_a_grip_that_a_pause_broke_off_reports_it():
    behavior, _ = to("CLOSING")
    assert behavior.handle(Gripped(12.0, "gripper", False, 0.008, 0.0)) == [Release("gripper", 0.02)]
    assert behavior.reason == "the jaws closed on nothing"
    behavior, _ = to("CLOSING")
    assert behavior.handle(Resumed(12.0)) == [Release("gripper", 0.02)]
    tell(behavior, jaws(13.0), arm(14.0))
    assert (behavior.outcome, behavior.reason) == ("not_gripped", "a pause broke the grip off")


def test_without_a_grasp_it_leaves_from_the_middle_where_the_arm_came_to_stand_without_a_place():
    behavior, _ = to("CENTERING", grasp=False)
    behavior.handle(arm(9.0, 0.002))
    assert behavior.state == "LEAVING"
    behavior, _ = to("SEEKING_FORWARD")
    tell(behavior, seen(6.5, "left_ours"), still(6.6, 0.006), seen(8.0, "right_ours"))
    assert behavior.handle(still(8.1, -0.002)) == [MoveTo("arm", pytest.approx(0.002), 0.01)]


def test_the_finders_are_armed_while_it_searches_and_not_while_it_turns():
    finders = {"left_ours", "right_ours"}
    for state in PATH:
        armed = to(state)[0].plan.detectors & finders
        assert bool(armed) == (state in ("BASELINE", "SEEKING_FORWARD", "SEEKING_BACKWARD")), state


def test_with_a_run_up_the_right_finger_goes_first_and_finds_nothing_and_the_papers_way_has_none():
    behavior, _ = to("BASELINE", run_up=True)
    assert behavior.handle(Tick(6.0)) == [MoveAt("arm", -0.01, -0.017)]
    assert behavior.state == "RUNNING_UP"
    assert behavior.handle(seen(6.4, "left_ours", -0.003)) == [], "it is behind the motion"
    assert behavior.handle(seen(6.5, "right_ours", -0.005)) == [Stop("arm")]
    assert not behavior.plan.detectors & {"left_ours", "right_ours"}
    assert behavior.handle(still(6.6, -0.0055)) == [MoveAt("arm", 0.01, 0.017)]
    tell(behavior, seen(7.5, "left_ours", 0.005), still(7.6, 0.0055), seen(8.5, "right_ours", -0.002))
    assert behavior.handle(still(8.6, -0.0025)) == [MoveTo("arm", pytest.approx(0.0015), 0.01)]
    names = frozenset({"left_paper", "right_paper"})
    behavior = Centering(CenteringSettings(run_up=True), SearchFactors(method="paper"), names)
    behavior.begin(0.0)
    tell(behavior, arm(1.0), jaws(2.0), jaws(3.0), arm(4.0))
    assert behavior.handle(Tick(6.0)) == [MoveAt("arm", 0.01, 0.017)]


def test_a_touch_that_is_felt_as_the_arm_sets_out_is_ignored_as_is_one_that_ended_before_the_search():
    behavior, _ = to("SEEKING_BACKWARD")
    assert behavior.handle(touch(7.04, "left_contact")) == [], "4.4 mm from where it turned"
    assert behavior.state == "SEEKING_BACKWARD"
    assert behavior.handle(touch(7.06, "right_contact")) == [Stop("arm")]
    assert behavior.reason == "touched during the search"
    behavior, _ = to("BASELINE")
    tell(behavior, touch(4.5, "left_contact"), held(5.0, "left_contact"), lost(5.5, "left_contact"))
    assert behavior.handle(Tick(6.0)) == [MoveAt("arm", 0.01, 0.017)]


FELT = touch(4.5, "left_contact")
OTHERS = [[], [held(5.0, "left_contact")], [touch(4.6, "right_contact"), lost(4.7, "right_contact")]]


@pytest.mark.parametrize("others", OTHERS)
@pytest.mark.parametrize("event", [Tick(6.0), Resumed(5.9)])
@pytest.mark.parametrize("run_up", [False, True])
def test_a_touch_that_stands_before_the_search_lets_none_begin(others, event, run_up):
    behavior, _ = to("BASELINE", run_up=run_up)
    tell(behavior, FELT, *others)
    assert behavior.handle(event) == [AWAY]
    behavior.handle(arm(8.0))
    assert (behavior.done, behavior.outcome) == (True, "touched")
    assert behavior.reason.startswith("left_contact reported a touch at rest and not its end")


@pytest.mark.parametrize("finger", ["left_contact", "right_contact"])
def test_a_touch_that_is_held_while_the_arm_turns_ends_the_search_where_it_stands(finger):
    behavior, _ = to("SEEKING_FORWARD")
    assert behavior.handle(touch(6.1, finger)) == [], "as it sets out"
    behavior.handle(seen(6.5, "left_ours", 0.005))
    assert behavior.handle(held(6.6, finger)) == [], "it is stopping already"
    assert behavior.handle(still(6.7, 0.0055)) == [AWAY]
    assert (behavior.outcome, behavior.reason) == ("touched", "touched during the search")


def test_a_touch_that_begins_while_the_arm_turns_or_the_run_up_is_reversed_counts_when_it_is_held():
    behavior, _ = to("TURNING")
    behavior.handle(touch(6.55, "right_contact"))
    assert behavior.handle(still(6.6, 0.0055)) == [MoveAt("arm", -0.01, -0.017)]
    assert behavior.handle(held(7.05, "right_contact")) == [Stop("arm")]
    assert behavior.reason == "touched during the search"
    behavior, _ = to("BASELINE", run_up=True)
    tell(behavior, Tick(6.0), touch(6.1, "right_contact"), seen(6.4, "right_ours", -0.005))
    assert behavior.state == "REVERSING"
    behavior.handle(held(6.6, "right_contact"))
    assert behavior.handle(still(6.7, -0.0055)) == [AWAY]


def test_a_touch_of_the_search_or_of_a_detector_that_was_disarmed_confirms_no_grip():
    behavior, _ = to("SEEKING_BACKWARD")
    behavior.handle(touch(6.65, "left_contact"))
    tell(behavior, seen(7.0, "right_ours", -0.001), still(7.1, -0.0015), arm(9.0, 0.002), Tick(11.0))
    assert behavior.state == "CLOSING"
    tell(behavior, touch(11.5, "right_contact"), GRIPPED)
    assert behavior.state == "CONFIRMING", "the left finger has felt nothing"
    assert behavior.handle(Tick(13.1)) == [Release("gripper", 0.02)]
    behavior, _ = to("STOPPING")
    behavior.handle(touch(8.0, "left_contact"))
    tell(behavior, still(8.1, -0.0015), arm(9.0, 0.002), Tick(11.0), touch(11.5, "right_contact"), GRIPPED)
    assert behavior.state == "CONFIRMING"


FIRST = {state: PATH[state] for state in list(PATH)[: list(PATH).index("RESTING")]}
"""Up to CENTERING: the middle of the first search is at 2 mm."""

SECOND = [
    ("HALF_TURN", arm(9.0, 0.002)),
    ("BASELINE", arm(12.0, 0.002)),
    ("SEEKING_FORWARD", Tick(14.0)),
    ("TURNING", seen(15.0, "right_ours", 0.006)),
    ("SEEKING_BACKWARD", still(15.1, 0.0062)),
    ("STOPPING", seen(17.0, "left_ours", 0.0)),
    ("HALF_TURN", still(17.1, -0.0002)),
    ("CENTERING", arm(20.0, -0.0002)),
]
"""From there by half a turn: each finger sees the object where the other went before."""


def turning(*events):
    """Through the first search, and these events; the commands of each."""
    settings = CenteringSettings(half_turn=True, turn_rad_s=1.0)
    behavior, _ = lead(Centering(settings, SearchFactors(), DETECTORS), FIRST, "CENTERING")
    return behavior, [list(behavior.handle(event)) for event in events]


def turn(rad_s):
    return [Twist("arm", (0.0, 0.0, 0.0, 0.0, 0.0, rad_s), HALF_TURN_RAD)]


def test_after_half_a_turn_the_other_finger_leads_and_the_mean_of_both_middles_counts():
    behavior, _ = turning()
    commands = []
    for state, event in SECOND:
        commands.append(list(behavior.handle(event)))
        assert behavior.state == state
    assert commands[0] == turn(1.0)
    assert commands[6] == turn(-1.0)
    assert commands[7] == [MoveTo("arm", pytest.approx(0.0025), 0.01)]  # of 2 and 3 mm
    tell(behavior, arm(21.0, 0.0025))
    assert behavior.state == "RESTING"
    assert behavior.notes == {"turned_s": [6.0, 9.0]}  # the first search began, the wrist turned


def test_after_half_a_turn_the_finger_that_led_is_ignored_and_a_pause_begins_anew_with_the_left_one():
    behavior, _ = turning(*(event for _, event in SECOND[:3]))
    assert behavior.handle(seen(14.5, "left_ours", 0.004)) == []
    assert behavior.state == "SEEKING_FORWARD"
    behavior, commands = turning(*(event for _, event in SECOND[:3]), Resumed(14.5))
    assert (behavior.state, commands[-1][-1]) == ("ENTERING", MovePose("arm", (0.0,) * 6, 0.05))
    tell(behavior, arm(80.0), Tick(82.0), seen(82.5, "left_ours", 0.005))
    assert behavior.state == "TURNING"
    assert "turned_s" not in behavior.notes


def test_a_search_that_fails_with_the_wrist_turned_turns_back_before_it_leaves():
    behavior, commands = turning(*(event for _, event in SECOND[:3]), arm(17.0, 0.017))
    assert (behavior.state, commands[-1]) == ("LEAVING", turn(-1.0))
    assert "right finger saw nothing" in behavior.reason
    assert behavior.handle(arm(20.0, 0.017)) == [AWAY]
    assert behavior.state == "LEAVING"
    behavior.handle(arm(22.0))
    assert (behavior.done, behavior.outcome) == (True, "not_found")


def test_a_rehearsal_shows_the_turn_where_there_is_one():
    for half_turn in (False, True):
        settings = CenteringSettings(half_turn=half_turn, turn_rad_s=1.0)
        behavior = Centering(settings, SearchFactors(), DETECTORS)
        assert list(behavior.rehearse("HALF_TURN")) == (turn(1.0) if half_turn else [])
        assert behavior.notes == {}
