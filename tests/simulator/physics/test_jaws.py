"""Jaws and their drive: forces, ends, what does not fit, and that steps of time change nothing."""

import math

import pytest

from drivers.gripper.state import GripFinding
from simulator.physics.jaws_drive import FRICTION_N, JawsDrive
from tests.contracts.gripper_suite import put

CLOSED_M, OBJECT_M = 0.010, 0.040


@pytest.fixture
def drive() -> JawsDrive:
    return ready()


def ready() -> JawsDrive:
    """Calibrated, open, at time 0."""
    made = JawsDrive(CLOSED_M)
    made.advance(0.0)
    made.calibrate()
    made.advance(3.0)
    made.go(0.0, 20_000.0, 300.0)
    made.advance(5.0)
    made.sleep()
    made.restart()
    made.advance(0.0)
    return made


def grip(
    drive: JawsDrive, current_ma: float, stiffness_n_m: float = 2e4, damping_n_s_m: float = 20.0
) -> None:
    put(drive, OBJECT_M, stiffness_n_m, damping_n_s_m)
    drive.go(1.0, 10_000.0, current_ma)
    drive.advance(2.0)


@pytest.mark.parametrize(("stiffness_n_m", "damping_n_s_m"), [(2e4, 20.0), (5e3, 20.0), (1e6, 50.0)])
@pytest.mark.parametrize("current_ma", [150.0, 432.0, 1300.0])
def test_the_force_is_the_currents_within_the_friction(
    drive: JawsDrive, stiffness_n_m: float, damping_n_s_m: float, current_ma: float
) -> None:
    grip(drive, current_ma, stiffness_n_m, damping_n_s_m)
    assert drive.contact_n == pytest.approx(0.0462 * current_ma, abs=FRICTION_N + 0.01)
    squeezed_m = OBJECT_M - drive.width_m
    assert squeezed_m == pytest.approx(drive.contact_n / stiffness_n_m)
    assert drive.finding is GripFinding.OBJECT_CLOSING


def test_no_current_is_greater_than_1300_ma(drive: JawsDrive) -> None:
    grip(drive, 30_000.0)
    assert drive.current_ma == -1300.0


def test_jaws_that_meet_nothing_are_at_their_position(drive: JawsDrive) -> None:
    drive.go(0.5, 10_000.0, 300.0)
    drive.advance(2.0)
    assert drive.finding is GripFinding.AT_POSITION
    assert drive.width_m == pytest.approx(0.010 + 0.024, abs=5e-5)
    assert drive.closed_share == pytest.approx(0.5, abs=1e-3)


def test_a_motion_has_the_speed_that_was_asked_for(drive: JawsDrive) -> None:
    drive.go(1.0, 16_384.0, 300.0)
    drive.advance(0.2)
    one_turn_s_m_s = 2.0 * 2.0 * math.pi * 0.006  # two jaws on a pinion of 6 mm
    assert drive.rate_m_s == pytest.approx(-one_turn_s_m_s, rel=0.01)


def test_a_held_object_is_released_when_the_drive_sleeps(drive: JawsDrive) -> None:
    grip(drive, 432.0)
    drive.sleep()
    drive.advance(3.0)
    assert drive.contact_n <= FRICTION_N


def test_an_object_that_is_taken_away_is_felt(drive: JawsDrive) -> None:
    grip(drive, 432.0)
    put(drive, None)
    drive.disturb()
    drive.advance(3.0)
    assert drive.finding is GripFinding.AT_POSITION
    assert drive.width_m == pytest.approx(0.010, abs=5e-5)


def test_below_150_ma_a_grip_is_unstable(drive: JawsDrive) -> None:
    grip(drive, 120.0)
    forces_n, findings = set(), set()
    for step in range(100):
        drive.advance(2.0 + step * 1e-3)
        forces_n.add(drive.contact_n)
        findings.add(drive.finding)
    assert max(forces_n) - min(forces_n) > 1.0
    assert findings == {GripFinding.MOVING, GripFinding.OBJECT_CLOSING}


def test_a_jam_while_opening_is_an_object_while_opening(drive: JawsDrive) -> None:
    drive.go(1.0, 10_000.0, 300.0)
    drive.advance(0.5)
    drive.go(0.0, 10_000.0, 300.0)
    drive.jam()
    drive.advance(1.0)
    assert drive.finding is GripFinding.OBJECT_OPENING


def test_calibration_opens_closes_and_holds_at_each_stop() -> None:
    drive = JawsDrive(CLOSED_M)
    drive.width_m = 0.030
    drive.advance(0.0)
    drive.calibrate()
    widths_m = []
    while not drive.calibrated:
        drive.advance(len(widths_m) * 0.01)
        widths_m.append(drive.width_m)
    at_open = sum(width_m == pytest.approx(0.058) for width_m in widths_m) * 0.01
    at_closed = sum(width_m == pytest.approx(0.010) for width_m in widths_m) * 0.01
    assert at_open == pytest.approx(0.64, abs=0.1)
    assert at_closed == pytest.approx(0.64, abs=0.1)
    assert drive.closed_share == 1.0
    assert drive.current_ma == 0.0


def test_without_a_calibration_nothing_moves() -> None:
    drive = JawsDrive(CLOSED_M)
    drive.advance(0.0)
    drive.go(1.0, 10_000.0, 300.0)
    drive.advance(1.0)
    assert drive.width_m == pytest.approx(0.058)


def test_steps_of_time_change_nothing(drive: JawsDrive) -> None:
    """One advance of two seconds, or two thousand uneven ones: the same to the last bit."""
    other = ready()
    grip(drive, 432.0)
    put(other, OBJECT_M)
    other.go(1.0, 10_000.0, 432.0)
    for step in range(2000):
        other.advance((step + 0.37) * 1e-3)
    other.advance(2.0)
    assert (other.width_m, other.current_ma) == (drive.width_m, drive.current_ma)


def test_jaws_at_rest_cost_nothing(drive: JawsDrive) -> None:
    grip(drive, 432.0)
    drive.advance(1e10)  # 5e13 ticks: some days, if they were computed


def test_what_is_too_wide_or_too_thin_for_the_brackets_does_not_fit() -> None:
    jaws = JawsDrive(CLOSED_M)
    assert [jaws.fits(width_m) for width_m in (0.0005, 0.0109, 0.0111, 0.0569, 0.0571)] == [
        *(False, False),
        *(True, True),
        False,
    ]
