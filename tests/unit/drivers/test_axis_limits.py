"""What a mover on an approach axis does not take, and how its speeds are clamped."""

import math

import pytest

from drivers.core.axis import AxisLimits
from drivers.core.errors import CommandError
from drivers.core.messages import MoveAt, MoveTo
from tests.refusals import refused

LIMITS = AxisLimits(travel_min_m=-0.02, travel_max_m=0.04, max_speed_m_s=0.05)
NAN, INF = math.nan, math.inf


@pytest.mark.parametrize(
    ("command", "reason", "remedy"),
    [
        *((MoveAt("x", speed, 0.01), "no speed", "above zero") for speed in (0.0, NAN, INF)),
        *((MoveTo("x", 0.01, speed), "no speed", "above zero") for speed in (0.0, -0.01, NAN, INF)),
        *((MoveAt("x", 0.01, m), "its travel is -0.02 to 0.04 m", "inside it") for m in (0.041, -0.021, NAN)),
        *((MoveTo("x", m, 0.01), "its travel is -0.02 to 0.04 m", "inside it") for m in (0.041, -INF, NAN)),
        (MoveTo("x", 0.01, 0.01, blind_travel_m=0.0), "lets it go nowhere", "above zero"),
        (MoveAt("x", 0.01, 0.01, blind_travel_m=NAN), "lets it go nowhere", "above zero"),
    ],
)
def test_a_motion_out_of_bounds_is_refused_with_its_place_and_a_remedy(
    command: MoveAt | MoveTo, reason: str, remedy: str
) -> None:
    with refused(CommandError, "x: ", "moving to", reason, remedy):
        LIMITS.checked("x", command)


@pytest.mark.parametrize(
    ("asked", "sent"),
    [
        (MoveAt("x", -1.0, -0.02), MoveAt("x", -0.05, -0.02)),
        (MoveAt("x", 0.05, 0.04), MoveAt("x", 0.05, 0.04)),
        (MoveTo("x", 0.04, 1.0), MoveTo("x", 0.04, 0.05)),
        (MoveTo("x", -0.02, 0.01), MoveTo("x", -0.02, 0.01)),
    ],
)
def test_both_ends_may_be_asked_for_and_too_great_a_speed_is_clamped_with_its_sign(
    asked: MoveAt | MoveTo, sent: MoveAt | MoveTo
) -> None:
    assert LIMITS.checked("x", asked) == sent


def test_a_travel_that_ends_before_it_begins_is_refused() -> None:
    with pytest.raises(ValueError, match="is not below"):
        AxisLimits(travel_min_m=0.01, travel_max_m=0.01, max_speed_m_s=0.05)
