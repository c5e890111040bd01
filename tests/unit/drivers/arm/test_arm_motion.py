"""What the arm does with commands, on the emulated controller in virtual time."""

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.arm.guidance import CYCLE_S
from drivers.core.messages import (
    Home,
    Lead,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Refused,
    Stalled,
    Standstill,
    Stop,
    Twist,
)
from simulator.physics.rigid import difference

DOWN = (0.0, 0.0, -0.02, 0.0, 0.0, 0.0)
ASIDE = (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("speed_m_s", "limit_m"), [(0.02, 0.03), (-0.05, -0.02)])
def test_an_approach_comes_to_rest_just_before_its_limit(rig, speed_m_s: float, limit_m: float) -> None:
    arm = rig()
    arm.order(MoveAt("arm", speed_m_s, limit_m))
    reached = arm.run_until(Reached)
    assert arm.kinds() == ["Sent", "Reached"]
    assert abs(limit_m) - 2e-4 <= abs(reached.position_m) <= abs(limit_m)
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


def test_an_arm_is_led_by_hand_until_a_stop(rig) -> None:
    arm = rig()
    arm.order(Lead("arm"))
    arm.run(0.5)
    assert arm.client.calls.count("lead") == 1
    assert arm.controller.runtime is arm.controller.runtime.PLAYING, "its watchdog is fed"
    arm.order(Stop("arm"))
    arm.run_until(Standstill)
    assert arm.kinds() == ["Sent", "Sent", "Standstill"]
    assert arm.client.calls.count("end_lead") == 1


def test_a_motion_ends_the_leading_first(rig) -> None:
    arm = rig()
    arm.order(Lead("arm"))
    arm.run(0.1)
    arm.order(MoveTo("arm", -0.01, 0.05))
    assert arm.run_until(Reached).position_m == pytest.approx(-0.01, abs=1e-5)
    assert arm.client.calls.index("end_lead") < arm.client.calls.index("move")


def test_an_arm_that_cannot_be_led_refuses(rig) -> None:
    arm = rig()
    arm.client.lead = lambda on: False
    arm.order(Lead("arm"))
    assert arm.kinds() == ["Refused"]
    assert arm.controller.arm.resting


@pytest.mark.parametrize(
    "command", [MoveAt("arm", 0.02, 0.04), MoveTo("arm", 0.04, 0.02), Twist("arm", DOWN, 5.0), Lead("arm")]
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
