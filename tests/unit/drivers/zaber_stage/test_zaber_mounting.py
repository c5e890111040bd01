"""The approach axis on the stage's rail."""

import pytest
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from drivers.core.messages import MoveAt
from drivers.zaber_stage.mounting import Mounting, ZaberStageSettings

STEP_M = 0.49609375e-6


def mounting(**settings: object) -> Mounting:
    return Mounting(ZaberStageSettings(port="-", **settings))  # type: ignore[arg-type]


@given(st.floats(min_value=0.0, max_value=0.0254))
def test_a_limit_is_never_beyond_what_was_asked_for_and_less_than_a_microstep_before_it(
    position_m: float,
) -> None:
    m = mounting()
    slack_m = 1e-6 * STEP_M
    assert position_m - STEP_M < m.position_m(m.at_most(position_m)) <= position_m + slack_m
    assert position_m - slack_m <= m.position_m(m.at_least(position_m)) < position_m + STEP_M


def test_a_whole_number_of_microsteps_is_met_exactly() -> None:
    m = mounting()
    assert m.at_most(1000 * STEP_M) == m.at_least(1000 * STEP_M) == m.nearest(1000 * STEP_M) == 1000


@pytest.mark.parametrize(("velocity_m_s", "counts"), [(0.01, 1000), (-0.01, 1001)])
def test_an_approach_ends_at_the_last_whole_microstep_before_its_limit(
    velocity_m_s: float, counts: int
) -> None:
    assert mounting().target(MoveAt("stage", velocity_m_s, 1000.5 * STEP_M)) == counts


def test_a_stage_mounted_backwards_counts_down_from_its_origin() -> None:
    m = mounting(forward=-1, origin_m=0.0254, travel_max_m=0.02)
    assert m.device(0) == 51200
    assert m.device(1000) == 50200
    assert m.counts(50200) == 1000


def test_the_travel_of_a_stage_mounted_backwards_ends_at_the_devices_lower_limit() -> None:
    m = mounting(forward=-1, origin_m=0.0254, travel_max_m=1000 * STEP_M)
    assert m.limits() == {"limit.min": 50200, "limit.max": 51200}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"travel_min_m": 0.02, "travel_max_m": 0.01}, "is not below"),
        ({"forward": -1}, "beyond the home end"),
        ({"travel_min_m": -0.001}, "beyond the home end"),
        ({"travel_max_m": 0.03}, "travel_m is 0.0254"),
        ({"travel_m": 0.02}, "0.0254 m from the home end"),
        ({"forward": 0}, "forward"),
        ({"max_speed_m_s": float("nan")}, "max_speed_m_s"),
        ({"baud": "fast"}, "baud"),
    ],
)
def test_settings_that_no_stage_can_follow_are_refused(wrong: dict[str, object], message: str) -> None:
    with pytest.raises(ValidationError, match=message):
        ZaberStageSettings(port="-", **wrong)  # type: ignore[arg-type]
