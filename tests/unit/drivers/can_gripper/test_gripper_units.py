"""Widths, speeds and forces against the data sheet's figures."""

import math
from dataclasses import replace

import pytest
from pydantic import ValidationError

from drivers.can_gripper import units
from drivers.can_gripper.driver import CanGripperSettings
from drivers.can_gripper.units import FORCE_MAX_N, FORCE_MIN_N, GripperUnits
from drivers.core.errors import CommandError
from drivers.core.messages import Command, Excite, Grip, MoveTo, Release

UNITS = GripperUnits(closed_width_m=0.020)
GRIP = Grip("gripper", 0.030, 0.05, 20.0)


def checked(command: Command) -> Command:
    return UNITS.checked("gripper", command, 0.1, FORCE_MAX_N)


def test_the_travel_is_48_mm_from_the_closed_width_on_in_counts_of_less_than_a_fifth_of_one() -> None:
    assert UNITS.width_m(255) == pytest.approx(0.020)
    assert UNITS.width_m(0) == pytest.approx(0.068)
    assert UNITS.position(0.044) in (127, 128)
    assert UNITS.width_m(100) - UNITS.width_m(101) == pytest.approx(0.19e-3, rel=0.02)


def test_the_fastest_jaw_moves_at_the_data_sheets_speed() -> None:
    """v = omega r with 80,000 ticks/s of 16,384 and r = 6 mm, for one jaw of two."""
    assert units.speed_m_s(255) / 2 == pytest.approx(80_000 / 16_384 * 2 * math.pi * 0.006)
    assert units.speed_ticks_s(0) == 40.0


@pytest.mark.parametrize("speed_m_s", [0.0005, 0.01, 0.0503, 0.1, 0.36])
def test_no_speed_is_greater_than_what_was_asked_for(speed_m_s: float) -> None:
    count = units.speed_count(speed_m_s)
    assert units.speed_m_s(count) <= speed_m_s * (1 + 1e-12)
    assert units.speed_m_s(count + 1) > speed_m_s


def test_force_is_linear_in_a_current_of_150_to_1300_ma_and_rounded_down() -> None:
    assert UNITS.current_ma(20.0) == 432  # 20 / 0.0462 = 432.9
    assert UNITS.force_n(-432) == pytest.approx(432 * 0.0462)
    assert (UNITS.current_ma(FORCE_MIN_N), UNITS.current_ma(FORCE_MAX_N)) == (150, 1300)


@pytest.mark.parametrize(
    ("command", "cause", "remedy"),
    [
        (replace(GRIP, width_m=0.019), "its brackets let it open 20 to 68 mm", "choose a width"),
        (replace(GRIP, width_m=0.069), "its brackets let it open 20 to 68 mm", "choose a width"),
        (replace(GRIP, width_m=math.nan), "its brackets let it open 20 to 68 mm", "choose a width"),
        (replace(GRIP, force_n=5.0), "5 N is out of range", "from 6.93 to 60.1 N"),
        (replace(GRIP, force_n=80.0), "80 N is out of range", "from 6.93 to 60.1 N"),
        (replace(GRIP, force_n=math.nan), "nan N is out of range", "from 6.93 to 60.1 N"),
        (replace(GRIP, speed_m_s=0.0), "0 m/s is no speed", "above zero"),
        (Release("gripper", math.inf), "inf m/s is no speed", "above zero"),
        (Release("gripper", -1.0), "-1 m/s is no speed", "above zero"),
        (MoveTo("gripper", 0.03, 0.01), "it has no such command", "can Home, Grip"),
        (Excite("gripper", on=True), "it has no such command", "can Home, Grip"),
    ],
)
def test_a_refusal_names_device_cause_and_remedy(command: Command, cause: str, remedy: str) -> None:
    with pytest.raises(CommandError) as error:
        checked(command)
    assert (error.value.device, error.value.reason) == ("gripper", cause)
    assert remedy in error.value.advice


def test_a_grip_as_sent_is_in_the_grippers_own_counts() -> None:
    order, sent = UNITS.grip(GRIP), checked(GRIP)
    assert isinstance(sent, Grip)
    assert sent.width_m == UNITS.width_m(order.position) != GRIP.width_m
    assert sent.speed_m_s == units.speed_m_s(order.speed) != GRIP.speed_m_s
    assert sent.force_n == UNITS.force_n(order.current_ma) != GRIP.force_n


@pytest.mark.parametrize(
    "end", [{"width_m": 0.020}, {"width_m": 0.068}, {"force_n": FORCE_MIN_N}, {"force_n": FORCE_MAX_N}]
)
def test_both_ends_of_a_range_may_be_asked_for(end: dict[str, float]) -> None:
    sent = checked(replace(GRIP, **end))
    for name, value in end.items():
        assert getattr(sent, name) == pytest.approx(value, rel=1e-9)


def test_the_jaws_move_no_faster_than_they_may() -> None:
    assert checked(replace(GRIP, speed_m_s=9.0)) == checked(replace(GRIP, speed_m_s=0.1))
    assert checked(Release("gripper", 9.0)) == checked(Release("gripper", 0.1))
    assert checked(Release("gripper", 0.05)) == Release("gripper", units.speed_m_s(units.speed_count(0.05)))


def test_brackets_that_reach_too_far_are_refused() -> None:
    with pytest.raises(ValidationError):
        CanGripperSettings(port="can0", closed_width_m=0.0375)


def test_a_watchdog_that_one_lost_answer_would_trip_is_refused() -> None:
    with pytest.raises(ValidationError, match="one lost answer would open the grip"):
        CanGripperSettings(port="can0", watchdog_s=0.25)


def test_forces_that_may_be_asked_for_are_the_drives_least_and_the_settings_most():
    assert CanGripperSettings(port="can0", max_force_n=20.0).forces_n == (pytest.approx(150 * 0.0462), 20.0)
