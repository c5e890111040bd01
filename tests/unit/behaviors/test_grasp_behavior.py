"""A grasp: the fragments joined, and what the lift adds to them."""

import pytest

from behaviors.events import LoadChanged, Resumed, SlipEnded, SlipStarted, Tick
from behaviors.grasp import Grasp, GraspSettings
from behaviors.grip import GripSettings
from behaviors.search import SearchFactors
from drivers.can_gripper.driver import CanGripperSettings
from drivers.core.messages import Grip, Gripped, MovePose, Release, Stop, Twist
from drivers.robotiq.settings import RobotiqSettings
from simulator.mocks.can_gripper import MockCanGripperSettings
from tests.unit.behaviors.driving import arm, jaws, lost, seen, still, tell, touch

NAMES = frozenset({"left_ours", "right_ours", "left_contact", "right_contact", "slip", "load"})
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
UP_S = 15.0
"""When it is up; what swings has calmed half a second later."""


def grasping(**settings):
    """A grasp that both fingers feel, and what was commanded last."""
    usual = {"slip": ("slip",), "load": ("load",), "tightest_n": 40.0, "margin": 1.2, "boost": 1.5}
    usual |= {"moving_margin": 1.0, "hold_s": 5.0, "plateau_s": 0.0}
    behavior = Grasp(GraspSettings(**usual | settings), SearchFactors(), NAMES)
    behavior.begin(0.0)
    commands = tell(behavior, *FOUND)
    assert behavior.state == "LOADING"
    return behavior, commands


def harder(force_n):
    return Grip("gripper", 0.0, 0.1, pytest.approx(force_n))


def slip(t_s):
    return SlipStarted(t_s, "slip", 20.0, 10.0)


def slips(behavior, t_s):
    """What follows from a slip in the turn that tells it."""
    return [*behavior.handle(slip(t_s)), *behavior.handle(Tick(t_s))]


def over(t_s):
    return SlipEnded(t_s, "slip", 5.0, 10.0)


def load(t_s, load_n):
    return LoadChanged(t_s, "load", load_n, 0.1)


def slipping(**settings):
    """A grasp whose object has slipped at 4 of 10 N, and now loads a finger with 5 N."""
    behavior, _ = grasping(**settings)
    tell(behavior, load(12.9, 4.0), slip(13.0), Tick(13.0), over(13.05), load(13.2, 5.0))
    return behavior


def in_the_air(**settings):
    """The same, up."""
    behavior = slipping(**settings)
    tell(behavior, arm(14.0), arm(UP_S))
    assert behavior.state == "HOLDING"
    assert behavior.notes["friction"] == [pytest.approx(0.4)]
    return behavior


def test_the_weight_is_taken_up_slowly_and_then_lifted_from_the_middle():
    behavior, commands = grasping()
    assert commands == [MovePose("arm", (0.002, 0.0, 0.004, 0.0, 0.0, 0.0), 0.002)]
    assert behavior.handle(arm(14.2)) == [MovePose("arm", (0.002, 0.0, 0.02, 0.0, 0.0, 0.0), 0.01)]
    assert not behavior.handle(arm(UP_S))
    assert behavior.state == "HOLDING"


def test_a_slip_tells_the_friction_and_the_grip_follows_the_load_by_it():
    behavior, _ = grasping()
    assert not behavior.handle(load(12.9, 4.0)), "nothing is known yet"
    assert slips(behavior, 13.0) == [harder(12.0)], "4 N of 10 N: 0.4"
    behavior.handle(over(13.05))
    assert behavior.handle(load(13.2, 5.0)) == [harder(1.2 * 5.0 / 0.4)]
    assert not behavior.handle(load(13.25, 4.9)), "less load, no harder grip"


def test_a_load_that_no_longer_grows_while_the_arm_rises_tells_the_friction_too():
    behavior, _ = grasping(plateau_s=0.12)
    tell(behavior, load(12.9, 3.9), load(12.95, 4.0))
    assert not slips(behavior, 12.97), "one patch may slip before all does"
    assert not behavior.handle(Tick(13.06))
    assert behavior.handle(Tick(13.07)) == [harder(12.0)], "4 N of 10 N, at a margin of 1.2"
    tell(behavior, over(13.08), load(13.1, 4.3))
    assert not behavior.handle(Tick(13.3)), "it hangs: less than friction bears"
    tell(behavior, load(13.4, 4.6))
    assert not slips(behavior, 13.5), "soon after it grew: a part of a pad"
    tell(behavior, over(13.51))
    assert slips(behavior, 13.53)[-1].force_n > 1.2 * 4.6 / 0.4, "it hangs, and slides"


def test_a_load_beyond_what_friction_bears_or_that_jumps_makes_the_jaws_press_harder_at_once():
    behavior = in_the_air()
    assert behavior.handle(load(17.0, 5.9)) == [harder(1.5 * 5.0 / 0.4)], "98 % of 6 N: it is about to slip"
    assert behavior.handle(load(17.01, 9.6)) == [harder(1.02 * 9.6 / 0.4)], "what the load asks for"
    behavior = in_the_air()
    assert behavior.handle(load(17.0, 5.3)) == [harder(1.2 * 5.3 / 0.4)], "it creeps"
    assert behavior.handle(load(17.01, 5.65)) == [harder(1.5 * 5.0 / 0.4)]
    behavior = in_the_air(tightest_n=16.0)
    assert behavior.handle(load(17.0, 7.0)) == [harder(16.0)]
    assert not behavior.handle(load(17.1, 9.0))


def test_a_grip_that_is_no_longer_needed_is_loosened_step_by_step():
    behavior = in_the_air()
    tell(behavior, load(17.0, 5.9), load(17.1, 5.0))
    forces_n = []
    for k in range(200):
        forces_n += [command.force_n for command in behavior.handle(Tick(17.11 + 0.01 * k))]
    assert forces_n[0] == pytest.approx(0.94 * 18.75)
    assert forces_n == sorted(forces_n, reverse=True)
    assert forces_n[-1] == pytest.approx(15.0)


def test_a_slip_of_a_finger_that_carries_little_or_while_the_arm_shakes_is_a_knock():
    behavior = in_the_air()
    tell(behavior, load(15.1, 3.9))
    assert not slips(behavior, 15.2), "65 % of what friction bears"
    tell(behavior, over(15.3), load(15.35, 5.0))
    assert slips(behavior, 15.8)[-1].force_n > 1.2 * 15.0
    behavior = slipping(shake_m_s=0.05)
    tell(behavior, arm(14.0), arm(UP_S))
    assert behavior.state == "SHAKING"
    believed = any(isinstance(command, Grip) for command in slips(behavior, 15.25))
    assert not believed, "83 % of what friction bears"


def test_a_slip_that_outlasts_what_the_jaws_themselves_do_is_believed():
    behavior = in_the_air()
    tell(behavior, load(17.0, 5.4), load(17.1, 5.0))
    assert [len(behavior.handle(Tick(17.3 + 0.03 * k))) for k in range(3)] == [1, 1, 0], "less hard"
    behavior.handle(slip(17.4))
    assert not behavior.handle(Tick(17.4)), "by which the pad may have slipped a little"
    commands = [command for k in range(20) for command in behavior.handle(Tick(17.4 + 0.01 * k))]
    assert commands[-1].force_n > 15.0, "but it is not over"


def test_while_the_arm_moves_it_it_is_gripped_for_what_the_motion_adds():
    behavior = slipping(moving_margin=1.5)
    assert harder(1.5 * 5.0 / 0.4) in behavior.handle(arm(14.0))
    tell(behavior, arm(UP_S))
    forces_n = [command.force_n for k in range(80) for command in behavior.handle(Tick(UP_S + 0.01 * k))]
    assert forces_n[-1] == pytest.approx(1.2 * 5.0 / 0.4), "and no longer than that"


def test_what_the_drives_friction_takes_or_adds_is_commanded_besides():
    behavior, _ = grasping(jaws_n=0.5)
    tell(behavior, load(12.9, 3.8))
    assert slips(behavior, 13.0) == [harder(1.2 * 9.5 + 0.5)]
    tell(behavior, over(13.05), load(13.1, 3.5))
    assert [*behavior.handle(Tick(13.45)), *behavior.handle(Tick(13.5))][0] == harder(0.94 * 11.4 - 0.5)


def test_the_shake_goes_up_and_down_and_ends_standing():
    behavior, _ = grasping(shake_m_s=0.05, shake_hz=2.5)
    tell(behavior, arm(14.0))
    commands = list(behavior.handle(arm(UP_S)))
    for k in range(1, 400):
        commands += behavior.handle(Tick(UP_S + 0.005 * k))
    speeds_m_s = [command.twist[2] for command in commands if isinstance(command, Twist)]
    assert speeds_m_s == [0.05, -0.05] * 5 + [0.05]
    assert behavior.handle(Tick(UP_S + 2.0)) == [Stop("arm")]
    assert behavior.state == "HOLDING"


def test_steps_of_force_are_the_other_rule():
    behavior, _ = grasping(rule="step", load=(), tighten_n=2.0)
    assert slips(behavior, 13.0) == [harder(12.0)]
    assert not behavior.handle(Tick(13.04))
    assert behavior.handle(Tick(13.05)) == [harder(14.0)], "it slips on"
    behavior.handle(over(13.06))
    assert not behavior.handle(Tick(13.2))


def test_what_is_carried_to_the_end_is_held_and_set_down():
    behavior = in_the_air()
    assert behavior.handle(Tick(UP_S + 5.0)) == [MovePose("arm", (0.002, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01)]
    assert behavior.outcome == "held"
    assert behavior.handle(arm(22.0)) == [Release("gripper", 0.02)]


def test_what_a_finger_no_longer_carries_at_the_end_or_feels_where_nothing_tells_the_load_is_lost():
    carried = in_the_air()
    tell(carried, load(17.0, 0.2), Tick(UP_S + 5.0))
    felt, _ = grasping(load=())
    tell(felt, arm(14.0), arm(UP_S), lost(16.0, "left_contact"), Tick(UP_S + 5.0))
    for behavior in (carried, felt):
        assert (behavior.outcome, behavior.reason) == ("dropped", "the object was lost in HOLDING")


def test_what_falls_out_of_the_jaws_is_no_grasp_and_a_pause_sets_it_down():
    behavior, _ = grasping()
    behavior.handle(Gripped(13.0, "gripper", False, 0.0, 0.0))
    assert behavior.state == "LOWERING"
    assert (behavior.outcome, behavior.reason) == ("dropped", "the object was lost in LOADING")
    behavior, _ = grasping()
    assert behavior.handle(Resumed(13.0)) == [MovePose("arm", (0.002, 0.0, 0.0, 0.0, 0.0, 0.0), 0.01)]
    assert behavior.reason == "a pause broke the grip off"


def test_a_slip_before_the_lift_is_no_slip_of_the_object_and_without_centering_the_jaws_close_at_once():
    behavior = Grasp(GraspSettings(slip=("slip",)), SearchFactors(), NAMES)
    behavior.begin(0.0)
    tell(behavior, *FOUND[:-3])
    assert behavior.state == "CLOSING"
    assert "slip" in behavior.plan.detectors, "it has learned in the rest what noise is"
    assert not behavior.handle(slip(11.5))
    behavior = Grasp(GraspSettings(center=False), SearchFactors(), NAMES)
    behavior.begin(0.0)
    tell(behavior, *FOUND[:4], Tick(6.0))
    assert behavior.state == "RESTING"
    (grip,) = behavior.handle(Tick(8.0))
    assert isinstance(grip, Grip)


@pytest.mark.parametrize(
    ("gripper", "force_n", "says"),
    [
        (CanGripperSettings(port="can0"), 6.5, "gripper presses with 6.93 to 60.1 N"),
        (CanGripperSettings(port="can0", max_force_n=20.0), 21.0, "6.93 to 20 N"),
        (MockCanGripperSettings(), 6.5, "6.93 to 60.1 N"),
        (RobotiqSettings(port="socket://10.0.0.1:63352", model="hand-e"), 19.0, "20 to 185 N"),
    ],
)
def test_a_force_that_the_gripper_refuses_is_no_match(gripper, force_n, says):
    def found(**settings):
        return [*GripSettings(**settings).mismatches(("behavior",), {("devices", "gripper"): gripper})]

    [mismatch] = found(grip_force_n=force_n)
    assert mismatch.key == "grip_force_n"
    assert says in mismatch.mistake
    assert not found(grip_force_n=20.0)
    assert not [*GripSettings(grip_force_n=force_n).mismatches(("behavior",), {})]


@pytest.mark.parametrize(("tightest_n", "goes"), [(10.0, True), (40.0, True), (9.0, False), (41.0, False)])
def test_jaws_that_could_press_no_harder_upon_a_slip_or_harder_than_the_gripper_are_no_match(
    tightest_n, goes
):
    gripper = CanGripperSettings(port="can0", max_force_n=40.0)
    settings = GraspSettings(grip_force_n=10.0, tightest_n=tightest_n)
    found = settings.mismatches(("behavior",), {("devices", "gripper"): gripper})
    assert [each.key for each in found] == ([] if goes else ["tightest_n"])


def test_a_slip_counts_where_the_jaws_press_harder_and_is_heard_where_they_cannot():
    behavior, _ = grasping(rule="step", load=(), tighten_n=2.0, tightest_n=12.0)
    assert slips(behavior, 13.0) == [harder(12.0)]
    assert not behavior.handle(Tick(13.05)), "as hard as they may"
    assert behavior.notes == {"told_s": [13.0, 13.05], "slip_s": [13.0]}
