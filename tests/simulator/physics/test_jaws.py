"""Jaws and their drive: forces, ends, what does not fit, and that steps of time change nothing."""

import math

import pytest
from pydantic import ValidationError

from drivers.gripper.state import GripFinding
from simulator.physics.jaws_drive import GripObject, Jaws, JawsDrive, JawsSettings

OBJECTS = {
    "mug": GripObject(width_m=0.040),
    "sponge": GripObject(width_m=0.040, stiffness_n_m=5e3),
    "steel": GripObject(width_m=0.040, stiffness_n_m=1e6, damping_n_s_m=50.0),
    "card": GripObject(width_m=0.0005),
    "door": GripObject(width_m=0.080),
}
SCENE = JawsSettings(closed_width_m=0.010, objects=OBJECTS)


@pytest.fixture
def drive() -> JawsDrive:
    return ready()


def ready() -> JawsDrive:
    """Calibrated, open, at time 0."""
    made = JawsDrive(SCENE)
    made.advance(0.0)
    made.calibrate()
    made.advance(3.0)
    made.go(0.0, 20_000.0, 300.0)
    made.advance(5.0)
    made.sleep()
    made.restart()
    made.advance(0.0)
    return made


def grip(drive: JawsDrive, name: str | None, current_ma: float) -> None:
    drive.jaws.place(name)
    drive.go(1.0, 10_000.0, current_ma)
    drive.advance(2.0)


@pytest.mark.parametrize("name", ["mug", "sponge", "steel"])
@pytest.mark.parametrize("current_ma", [150.0, 432.0, 1300.0])
def test_the_force_is_the_currents_within_the_friction(
    drive: JawsDrive, name: str, current_ma: float
) -> None:
    grip(drive, name, current_ma)
    assert drive.jaws.contact_n == pytest.approx(0.0462 * current_ma, abs=SCENE.friction_n + 0.01)
    squeezed_m = OBJECTS[name].width_m - drive.jaws.width_m
    assert squeezed_m == pytest.approx(drive.jaws.contact_n / OBJECTS[name].stiffness_n_m)
    assert drive.finding is GripFinding.OBJECT_CLOSING


def test_no_current_is_greater_than_1300_ma(drive: JawsDrive) -> None:
    grip(drive, "mug", 30_000.0)
    assert drive.current_ma == -1300.0


def test_jaws_that_meet_nothing_are_at_their_position(drive: JawsDrive) -> None:
    drive.go(0.5, 10_000.0, 300.0)
    drive.advance(2.0)
    assert drive.finding is GripFinding.AT_POSITION
    assert drive.jaws.width_m == pytest.approx(0.010 + 0.024, abs=5e-5)
    assert drive.closed_share == pytest.approx(0.5, abs=1e-3)


def test_a_motion_has_the_speed_that_was_asked_for(drive: JawsDrive) -> None:
    drive.go(1.0, 16_384.0, 300.0)
    drive.advance(0.2)
    one_turn_s_m_s = 2.0 * 2.0 * math.pi * 0.006  # two jaws on a pinion of 6 mm
    assert drive.jaws.rate_m_s == pytest.approx(-one_turn_s_m_s, rel=0.01)


def test_a_held_object_is_released_when_the_drive_sleeps(drive: JawsDrive) -> None:
    grip(drive, "mug", 432.0)
    drive.sleep()
    drive.advance(3.0)
    assert drive.jaws.contact_n <= SCENE.friction_n


def test_an_object_that_is_taken_away_is_felt(drive: JawsDrive) -> None:
    grip(drive, "mug", 432.0)
    drive.jaws.place(None)
    drive.disturb()
    drive.advance(3.0)
    assert drive.finding is GripFinding.AT_POSITION
    assert drive.jaws.width_m == pytest.approx(0.010, abs=5e-5)


def test_below_150_ma_a_grip_is_unstable(drive: JawsDrive) -> None:
    grip(drive, "mug", 120.0)
    forces_n, findings = set(), set()
    for step in range(100):
        drive.advance(2.0 + step * 1e-3)
        forces_n.add(drive.jaws.contact_n)
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
    drive = JawsDrive(SCENE.model_copy(update={"start_width_m": 0.030}))
    drive.advance(0.0)
    drive.calibrate()
    widths_m = []
    while not drive.calibrated:
        drive.advance(len(widths_m) * 0.01)
        widths_m.append(drive.jaws.width_m)
    at_open = sum(width_m == pytest.approx(0.058) for width_m in widths_m) * 0.01
    at_closed = sum(width_m == pytest.approx(0.010) for width_m in widths_m) * 0.01
    assert at_open == pytest.approx(0.64, abs=0.1)
    assert at_closed == pytest.approx(0.64, abs=0.1)
    assert drive.closed_share == 1.0
    assert drive.current_ma == 0.0


def test_without_a_calibration_nothing_moves() -> None:
    drive = JawsDrive(SCENE)
    drive.advance(0.0)
    drive.go(1.0, 10_000.0, 300.0)
    drive.advance(1.0)
    assert drive.jaws.width_m == pytest.approx(0.058)


def test_steps_of_time_change_nothing(drive: JawsDrive) -> None:
    """One advance of two seconds, or two thousand uneven ones: the same to the last bit."""
    other = ready()
    grip(drive, "mug", 432.0)
    other.jaws.place("mug")
    other.go(1.0, 10_000.0, 432.0)
    for step in range(2000):
        other.advance((step + 0.37) * 1e-3)
    other.advance(2.0)
    assert (other.jaws.width_m, other.current_ma) == (drive.jaws.width_m, drive.current_ma)


def test_jaws_at_rest_cost_nothing(drive: JawsDrive) -> None:
    grip(drive, "mug", 432.0)
    drive.advance(1e10)  # 5e13 ticks: some days, if they were computed


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("door", "door is 80 mm wide and does not fit: on these brackets the jaws hold 11 to 57 mm"),
        ("card", "card is 0.5 mm wide and does not fit"),
        ("mugg", "there is no object 'mugg'; there is: card, door, mug, sponge, steel"),
    ],
)
def test_an_object_that_does_not_fit_is_refused_by_name(name: str, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Jaws(SCENE).place(name)
    with pytest.raises(ValidationError, match=message):
        JawsSettings(closed_width_m=0.010, objects=OBJECTS, object=name)


def test_nothing_is_put_into_closed_jaws() -> None:
    jaws = Jaws(SCENE.model_copy(update={"start_width_m": 0.020}))
    with pytest.raises(ValueError, match="open them first"):
        jaws.place("mug")


@pytest.mark.parametrize("closed_width_m", [0.0079, 0.0371])
def test_brackets_reach_from_8_to_85_mm(closed_width_m: float) -> None:
    with pytest.raises(ValidationError):
        JawsSettings(closed_width_m=closed_width_m)
