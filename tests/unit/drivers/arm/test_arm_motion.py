"""What the arm does with commands, on the emulated controller in virtual time."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.arm.guidance import CYCLE_S
from drivers.arm.motion import MotionState
from drivers.core.messages import (
    Home,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Refused,
    Sent,
    Stalled,
    Standstill,
    Stop,
    Tare,
    Twist,
)
from simulator.physics.rigid import difference

DOWN = (0.0, 0.0, -0.02, 0.0, 0.0, 0.0)
ASIDE = (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)


def test_an_approach_comes_to_rest_just_before_its_limit(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.03))
    reached = arm.run_until(Reached)
    assert arm.kinds() == ["Sent", "Reached"]
    assert 0.03 - 2e-4 <= reached.position_m <= 0.03
    assert arm.controller.arm.resting


@settings(max_examples=25, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(
    speed=st.floats(0.001, 0.1),
    limit=st.floats(0.002, 0.04),
    cycle_steps=st.integers(1, 12),
    old_steps=st.integers(0, 4),
)
def test_no_speed_and_no_late_cycle_carries_an_approach_beyond_its_limit(
    rig, speed: float, limit: float, cycle_steps: int, old_steps: int
) -> None:
    arm = rig()
    arm.order(MoveAt("arm", speed, limit))
    arm.run(1.5, cycle_steps, old_steps)
    assert max(arm.positions_m) <= limit


def test_an_approach_backwards_keeps_to_its_limit_too(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", -0.05, -0.02))
    reached = arm.run_until(Reached)
    assert -0.02 <= reached.position_m <= -0.02 + 2e-4


def test_an_approach_whose_limit_lies_behind_is_over_at_once(rig) -> None:
    arm = rig()
    arm.order(MoveTo("arm", 0.01, 0.05))
    arm.run_until(Reached)
    arm.order(MoveAt("arm", 0.05, 0.005))
    reached = arm.run_until(Reached)
    assert reached.position_m == pytest.approx(0.01, abs=1e-5)


def test_an_approach_takes_its_speed(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.04))
    arm.run(0.3)
    before_m = arm.position_m
    arm.run(0.4)
    assert (arm.position_m - before_m) / 0.4 == pytest.approx(0.02, rel=0.02)


def test_a_move_goes_exactly_to_its_position_with_the_start_s_orientation(rig) -> None:
    arm = rig()
    arm.order(MoveTo("arm", -0.015, 0.05))
    reached = arm.run_until(Reached)
    assert reached.position_m == pytest.approx(-0.015, abs=1e-6)
    assert tuple(arm.controller.arm.pose) == pytest.approx(arm.axis.pose(-0.015), abs=1e-6)


def test_a_stop_during_an_approach_stops_within_its_braking_distance(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.05, 0.04))
    arm.run(0.4)
    before_m = arm.position_m
    arm.order(Stop("arm"))
    standstill = arm.run_until(Standstill)
    # v2/2a at 3 m/s2, and two cycles of the controller until it begins.
    assert standstill.position_m - before_m <= 0.05**2 / 6.0 + 0.05 * 0.004 + 1e-5
    assert arm.kinds()[-2:] == ["Sent", "Standstill"]


def test_a_stop_during_a_move_stops_it_on_its_way(rig) -> None:
    arm = rig()
    arm.order(MoveTo("arm", 0.04, 0.02))
    arm.run(0.5)
    arm.order(Stop("arm"))
    standstill = arm.run_until(Standstill)
    assert 0.005 < standstill.position_m < 0.02
    arm.run(1.0)
    assert arm.position_m == pytest.approx(standstill.position_m, abs=1e-5)
    assert "Reached" not in arm.kinds()


def test_a_stop_of_an_arm_that_stands_is_answered_too(rig) -> None:
    arm = rig()
    arm.order(Stop("arm"))
    arm.run_until(Standstill, timeout_s=0.1)
    assert arm.kinds() == ["Sent", "Standstill"]


def test_each_of_two_stops_is_sent_and_the_arm_stands_still_once(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.05, 0.04))
    arm.run(0.3)
    arm.order(Stop("arm"))
    arm.order(Stop("arm"))
    arm.run(0.5)
    assert arm.kinds() == ["Sent", "Sent", "Sent", "Standstill"]


def test_a_move_during_an_approach_waits_until_the_speeds_have_ended(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.04))
    arm.run(0.3)
    arm.order(MoveTo("arm", -0.01, 0.05))
    reached = arm.run_until(Reached)
    assert reached.position_m == pytest.approx(-0.01, abs=1e-5)
    # The controller ends a program in which two threads move the arm; this one runs.
    assert arm.controller.runtime is arm.controller.runtime.PLAYING
    assert arm.client.calls.index("end_speed") < arm.client.calls.index("move")


def test_an_approach_during_a_move_waits_until_the_move_has_stopped(rig) -> None:
    arm = rig()
    arm.order(MoveTo("arm", 0.04, 0.02))
    arm.run(0.3)
    arm.order(MoveAt("arm", -0.02, -0.03))
    reached = arm.run_until(Reached)
    assert reached.position_m == pytest.approx(-0.03, abs=2e-4)
    assert arm.controller.runtime is arm.controller.runtime.PLAYING


def test_the_last_of_several_waiting_motions_is_made(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.04))
    arm.run(0.1)
    for position_m in (0.02, 0.01, -0.02):
        arm.order(MoveTo("arm", position_m, 0.05))
    assert arm.run_until(Reached).position_m == pytest.approx(-0.02, abs=1e-5)
    assert arm.client.calls.count("move") == 1


def test_another_approach_takes_over_without_a_stop(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.04))
    arm.run(0.3)
    arm.order(MoveAt("arm", 0.05, 0.03))
    reached = arm.run_until(Reached)
    assert reached.position_m <= 0.03
    assert arm.client.calls.count("end_speed") == 1


def test_a_twist_moves_for_its_time_and_stops(rig) -> None:
    arm = rig()
    start = arm.controller.arm.pose.copy()
    arm.order(Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.2), 0.5))
    arm.run_until(Reached)
    way = arm.controller.arm.pose[0] - start[0]
    assert way == pytest.approx(0.01 * 0.5, abs=0.01 * 0.02)
    assert arm.controller.arm.resting


def test_a_newer_twist_takes_over_and_the_older_s_end_does_not_stop_it(rig) -> None:
    arm = rig()
    arm.order(Twist("arm", ASIDE, 0.2))
    arm.run(0.1)
    arm.order(Twist("arm", ASIDE, 0.5))
    arm.run(0.4)
    assert arm.motion.state is MotionState.SPEEDING
    arm.run_until(Reached)
    assert arm.kinds() == ["Sent", "Sent", "Reached"]


def test_a_twist_goes_as_far_as_its_duration_says_and_rolls_without_sliding(rig) -> None:
    arm = rig()
    start = arm.controller.arm.transform
    arm.order(Twist("arm", (0.003, 0.0, 0.0, 0.0, 0.25, 0.0), 1.0))
    slides_m = []
    while not any(isinstance(status, Reached) for status in arm.statuses):
        arm.run(0.008)
        done = difference(start, arm.controller.arm.transform)
        slides_m.append(done[0] - 0.012 * done[4])
    # Cycles of 8 ms: half of one, at full speed.
    assert difference(start, arm.controller.arm.transform)[[0, 4]] == pytest.approx([0.003, 0.25], rel=0.01)
    # Of a cycle's change the controller makes the smaller part first: half a cycle ahead at the most, at 3 mm/s.
    assert max(map(abs, slides_m)) < 0.5 * CYCLE_S * 0.003


def test_a_move_to_a_pose_goes_exactly_there_and_says_so(rig) -> None:
    arm = rig()
    offset = (0.02, -0.01, 0.01, 0.1, 0.0, 0.0)
    arm.order(MovePose("arm", offset, 0.05))
    reached = arm.run_until(Reached)
    assert tuple(arm.controller.arm.pose) == pytest.approx(arm.axis.displaced(offset), abs=1e-6)
    assert reached.position_m == pytest.approx(-0.01, abs=1e-6)
    assert arm.kinds() == ["Sent", "Reached"]


def test_a_move_that_only_turns_takes_its_speed_for_rad_s(rig) -> None:
    arm = rig()
    before_s = arm.now()
    arm.order(MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.4, 0.0), 0.4))
    arm.run_until(Reached)
    # 1 s, one ramp of 0.8 s (0.5 rad/s2: it never gets to 0.4 rad/s in less), and the time to be sure.
    assert 1.75 < arm.now() - before_s < 1.95


def test_a_stop_ends_a_move_to_a_pose_on_its_way(rig) -> None:
    arm = rig()
    arm.order(MovePose("arm", (0.05, 0.0, 0.0, 0.0, 0.0, 0.0), 0.02))
    arm.run(0.5)
    arm.order(Stop("arm"))
    arm.run_until(Standstill)
    assert 0.005 < arm.axis.away_m(tuple(arm.controller.arm.pose)) < 0.02
    assert "Reached" not in arm.kinds()


def test_a_twist_along_the_axis_ends_at_the_travel(rig) -> None:
    arm = rig()
    arm.order(Twist("arm", DOWN, 10.0))
    stalled = arm.run_until(Stalled)
    assert "travel" in stalled.reason
    assert 0.038 < max(arm.positions_m) <= 0.04


def test_a_twist_aside_ends_at_the_leash(rig) -> None:
    arm = rig()
    arm.order(Twist("arm", ASIDE, 10.0))
    stalled = arm.run_until(Stalled)
    assert "leash" in stalled.reason
    assert 0.058 < arm.axis.away_m(tuple(arm.controller.arm.pose)) <= 0.06


def test_a_twist_may_come_back_from_the_end_of_its_leash(rig) -> None:
    arm = rig()
    arm.order(Twist("arm", ASIDE, 10.0))
    arm.run_until(Stalled)
    arm.order(Twist("arm", tuple(-part for part in ASIDE), 0.5))
    arm.run_until(Reached)
    assert arm.axis.away_m(tuple(arm.controller.arm.pose)) < 0.052


def test_home_goes_to_the_start_pose_from_beside_the_axis(rig) -> None:
    arm = rig()
    arm.order(Twist("arm", (0.02, 0.02, 0.0, 0.0, 0.0, 0.3), 0.5))
    arm.run_until(Reached)
    arm.order(Home("arm"))
    arm.run_until(Reached)
    assert tuple(arm.controller.arm.pose) == pytest.approx(arm.settings.start_pose, abs=1e-6)


def test_home_is_refused_from_beyond_the_leash(rig) -> None:
    arm = rig(leash_m=0.01)
    arm.order(MoveTo("arm", 0.03, 0.05))
    arm.run_until(Reached)
    arm.order(Home("arm"))
    assert "leash" in arm.statuses[-1].reason
    assert arm.position_m == pytest.approx(0.03, abs=1e-5)


def test_taring_takes_the_force_away_and_is_refused_while_the_arm_moves(rig) -> None:
    arm = rig()
    arm.order(Tare("arm", "arm.force"))
    assert arm.kinds() == ["Sent"]
    arm.order(MoveAt("arm", 0.02, 0.04))
    arm.run(0.2)
    arm.order(Tare("arm", "arm.force"))
    assert isinstance(arm.statuses[-1], Refused)
    assert arm.motion.state is MotionState.SPEEDING


def test_an_idle_arm_keeps_its_watchdog_fed(rig) -> None:
    arm = rig()
    arm.controller.set_watchdog("input_int_register_0", 10.0)
    arm.run(1.0)
    assert arm.controller.runtime is arm.controller.runtime.PLAYING


@pytest.mark.parametrize(
    "command", [MoveAt("arm", 0.02, 0.04), MoveTo("arm", 0.04, 0.02), Twist("arm", DOWN, 5.0)]
)
def test_the_watchdog_is_fed_through_every_motion_and_stop(rig, command) -> None:
    arm = rig()
    arm.controller.set_watchdog("input_int_register_0", 10.0)
    arm.order(command)
    arm.run(0.5)
    arm.order(Stop("arm"))
    arm.run_until(Standstill)
    arm.run(0.5)
    assert arm.controller.runtime is arm.controller.runtime.PLAYING


@pytest.mark.parametrize(
    "command", [MoveAt("arm", 0.02, 0.04), MoveTo("arm", 0.04, 0.02), Twist("arm", DOWN, 5.0)]
)
def test_a_protective_stop_stalls_the_arm_and_only_home_gets_it_going(rig, command) -> None:
    arm = rig()
    arm.order(command)
    arm.run(0.3)
    arm.controller.protective_stop("a test")
    stalled = arm.run_until(Stalled)
    assert "protective stop" in stalled.reason
    arm.order(MoveTo("arm", 0.0, 0.02))
    assert isinstance(arm.statuses[-1], Refused)
    arm.order(Home("arm"))
    assert arm.run_until(Reached).position_m == pytest.approx(0.0, abs=1e-5)


def test_an_arm_at_rest_says_that_it_is_stopped_as_well(rig) -> None:
    arm = rig()
    arm.run(0.1)
    arm.controller.stop_program("a test")
    assert "program has stopped" in arm.run_until(Stalled).reason
    arm.run(0.5)
    assert arm.kinds() == ["Stalled"]


def test_an_emergency_stop_is_not_recovered_from_afar(rig) -> None:
    arm = rig()
    arm.controller.emergency_stop()
    assert "emergency stop" in arm.run_until(Stalled).reason
    arm.order(Home("arm"))
    assert arm.statuses[-1].reason == "the emergency stop is pressed"
    assert arm.motion.state is MotionState.HALTED


def test_a_stop_is_answered_though_the_program_has_stopped(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.05, 0.04))
    arm.run(0.2)
    arm.order(Stop("arm"))
    arm.controller.stop_program("a test")
    arm.run_until(Standstill)
    assert arm.kinds() == ["Sent", "Sent", "Stalled", "Standstill"]


def test_a_motion_that_waited_when_the_arm_halted_is_refused(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.05, 0.04))
    arm.run(0.2)
    arm.order(MoveTo("arm", 0.0, 0.05))
    arm.controller.protective_stop("a test")
    arm.run_until(Stalled)
    assert arm.kinds() == ["Sent", "Refused", "Stalled"]


def test_a_controller_that_takes_no_commands_for_no_visible_reason_halts_the_arm(rig) -> None:
    arm = rig()
    arm.client.deaf = True
    assert "takes no commands" in arm.run_until(Stalled, timeout_s=0.5).reason


def test_an_arm_that_takes_no_commands_is_stopped_from_outside(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.05, 0.04))
    arm.run(0.2)
    arm.client.deaf = True
    arm.run_until(Stalled)
    arm.run(0.1)
    assert arm.client.calls.count("halt") == 1
    assert arm.controller.arm.resting


def test_an_arm_that_goes_on_all_the_same_is_stopped_from_outside_again(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.04))
    arm.run(0.2)
    arm.client.deaf, arm.client.unhalted = True, 1
    arm.run_until(Stalled)
    arm.order(Stop("arm"))
    arm.run(0.4)
    assert not arm.controller.arm.resting
    arm.run_until(Standstill, timeout_s=0.3)
    assert arm.client.calls.count("halt") == 2
    arm.run(2.0)
    assert arm.client.calls.count("halt") == 2
    assert arm.kinds() == ["Sent", "Stalled", "Standstill"]


def test_a_twist_after_a_recovery_begins_from_rest(rig) -> None:
    arm = rig()
    arm.order(Twist("arm", (0.04, 0.0, 0.0, 0.0, 0.0, 0.0), 5.0))
    arm.run(0.2)
    arm.client.deaf = True
    arm.run_until(Stalled)
    arm.client.deaf = False
    arm.order(Home("arm"))
    arm.run_until(Reached)
    arm.twists.clear()
    arm.order(Twist("arm", (-0.001, 0.0, 0.0, 0.0, 0.0, 0.0), 0.3))
    arm.run_until(Reached)
    assert min(twist[0] for twist in arm.twists) == pytest.approx(-0.001)
    assert max(twist[0] for twist in arm.twists) <= 0.0


@pytest.mark.parametrize(
    "command", [MoveAt("arm", 0.02, 0.04), MoveTo("arm", 0.04, 0.02), Twist("arm", DOWN, 5.0)]
)
def test_an_arm_that_the_program_no_longer_looks_at_stops_and_says_why(rig, command) -> None:
    arm = rig(loop_timeout_s=0.3)
    arm.order(command)
    arm.run(0.5)
    before_m, before_s = arm.position_m, arm.now()
    arm.looking = False
    stalled = arm.run_until(Stalled)
    # The bound, one cycle of ours, braking of 10 ms, and 20 ms in which nothing may have moved.
    assert 0.3 < arm.now() - before_s < 0.3 + 0.06
    assert arm.position_m - before_m < 0.02 * (0.3 + 0.02)
    assert "has not looked at it for 0.3" in stalled.reason
    arm.run(1.0)
    assert arm.kinds() == ["Sent", "Stalled"]


def test_a_motion_that_waits_for_another_s_end_is_not_begun_without_supervision(rig) -> None:
    # Braking from 0.1 m/s takes 0.2 s: the program is missed before the arm stands.
    arm = rig(loop_timeout_s=0.05, stop_m_s2=0.5)
    arm.order(MoveAt("arm", 0.1, 0.04))
    arm.run(0.25)
    arm.order(MoveTo("arm", -0.04, 0.1))
    arm.looking = False
    arm.run(0.5)
    assert arm.kinds() == ["Sent", "Refused"]
    assert "has not looked at it" in arm.statuses[-1].reason
    assert arm.client.calls.count("move") == 0
    assert arm.controller.arm.resting


def test_a_program_that_comes_back_moves_the_arm_again(rig) -> None:
    arm = rig()
    arm.looking = False
    arm.run(2.0)
    assert arm.kinds() == []
    arm.order(MoveTo("arm", 0.01, 0.02))
    arm.looking = True
    assert arm.run_until(Reached).position_m == pytest.approx(0.01, abs=1e-5)


def test_a_motion_that_the_controller_does_not_take_is_refused(rig) -> None:
    arm = rig()
    arm.client.deaf = True
    for command in (MoveAt("arm", 0.05, 0.04), MoveTo("arm", 0.01, 0.05), Tare("arm", "arm.force")):
        arm.order(command)
        assert isinstance(arm.statuses[-1], Refused)
        arm.client.deaf = False
        arm.run(0.1)
        arm.client.deaf = True
    assert "Sent" not in arm.kinds()


def test_a_stop_that_does_not_stop_the_arm_ends_the_program_from_outside(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.002, 0.04))
    arm.run(0.3)
    arm.client.stubborn = True
    arm.order(Stop("arm"))
    arm.run_until(Stalled)
    assert "halt" in arm.client.calls
    arm.run_until(Standstill)


def test_a_move_that_ends_elsewhere_is_a_stall(rig) -> None:
    arm = rig()
    arm.order(MoveTo("arm", 0.04, 0.02))
    arm.run(0.5)
    # Someone else's stop: the controller ends the move, and does not report it.
    arm.client.end_move(3.0)
    stalled = arm.run_until(Stalled)
    assert "from where it was sent" in stalled.reason
    arm.order(MoveTo("arm", 0.0, 0.05))
    arm.run_until(Reached)


def test_every_status_carries_the_time_of_its_report(rig) -> None:
    arm = rig()
    arm.order(MoveAt("arm", 0.02, 0.01))
    began_s = arm.now()
    arm.run_until(Reached)
    sent, reached = arm.statuses
    assert isinstance(sent, Sent)
    assert sent.t_s <= began_s
    assert began_s + 0.5 <= reached.t_s <= arm.now()
