"""Trapezoidal motion, held against its own equations."""

import itertools
import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simulator.physics.stage_axis import MotionPiece, StageAxis

A_M_S2 = 0.5
V_M_S = 0.026
positions = st.floats(min_value=-0.05, max_value=0.05)
speeds = st.floats(min_value=1e-5, max_value=0.1)
times = st.floats(min_value=0.0, max_value=3.0)


def axis() -> StageAxis:
    return StageAxis(acceleration_m_s2=A_M_S2, max_speed_m_s=V_M_S)


def instants(stage: StageAxis, t0_s: float) -> list[float]:
    """Times that see every piece of the plan, its ends, and what comes after."""
    starts_s = [piece.t_start_s for piece in stage.pieces(t0_s)]
    ends_s = [*starts_s[1:], starts_s[-1] + 1.0]
    return [
        a + share * (b - a) for a, b in zip(starts_s, ends_s, strict=True) for share in (0.0, 0.3, 0.7, 1.0)
    ]


@given(target_m=positions, speed_m_s=speeds)
def test_a_move_from_rest_takes_as_long_as_its_trapezoid(target_m: float, speed_m_s: float) -> None:
    stage = axis()
    stage.move_to(1.0, target_m, speed_m_s)
    v_m_s, distance_m = min(speed_m_s, V_M_S), abs(target_m)
    if distance_m >= v_m_s**2 / A_M_S2:
        expected_s = distance_m / v_m_s + v_m_s / A_M_S2
    else:
        expected_s = 2.0 * math.sqrt(distance_m / A_M_S2)
    assert stage.arrival_s - 1.0 == pytest.approx(expected_s, abs=1e-9)


@given(first_m=positions, again_s=times, target_m=positions, speed_m_s=speeds)
def test_any_motion_is_continuous_within_its_limits_and_ends_exactly_on_its_target(
    first_m: float, again_s: float, target_m: float, speed_m_s: float
) -> None:
    stage = axis()
    stage.move_to(0.0, first_m, V_M_S)
    before = stage.position(again_s), stage.velocity(again_s)
    stage.move_to(again_s, target_m, speed_m_s)
    pieces = stage.pieces(again_s)
    assert (pieces[0].position_m, pieces[0].velocity_m_s) == pytest.approx(before, abs=1e-12)
    for piece, following in itertools.pairwise(pieces):
        assert piece.position(following.t_start_s) == pytest.approx(following.position_m, abs=1e-12)
        assert piece.velocity(following.t_start_s) == pytest.approx(following.velocity_m_s, abs=1e-12)
        assert abs(piece.acceleration_m_s2) in (0.0, A_M_S2)
    assert all(abs(stage.velocity(t_s)) <= V_M_S * (1.0 + 1e-9) for t_s in instants(stage, again_s))
    assert pieces[-1] == MotionPiece(stage.arrival_s, target_m, 0.0, 0.0)
    assert stage.position(stage.arrival_s + 100.0) == target_m


@given(velocity_m_s=speeds, limit_m=st.floats(min_value=0.0, max_value=0.05))
def test_an_approach_never_passes_its_limit(velocity_m_s: float, limit_m: float) -> None:
    stage = axis()
    stage.move_at(0.0, velocity_m_s, limit_m)
    assert all(stage.position(t_s) <= limit_m + 1e-15 for t_s in instants(stage, 0.0))
    assert stage.target_m == limit_m


def test_an_approach_whose_limit_lies_behind_does_not_move() -> None:
    stage = StageAxis(acceleration_m_s2=A_M_S2, max_speed_m_s=V_M_S, position_m=0.01)
    stage.move_at(0.0, 0.01, 0.005)
    assert stage.position(10.0) == 0.01


@given(stop_s=times)
def test_a_stop_takes_half_the_speed_squared_over_the_acceleration(stop_s: float) -> None:
    stage = axis()
    stage.move_to(0.0, 0.05, 0.02)
    here_m, v_m_s = stage.position(stop_s), stage.velocity(stop_s)
    stage.stop(stop_s)
    assert stage.target_m - here_m == pytest.approx(v_m_s**2 / (2.0 * A_M_S2), abs=1e-12)
    assert stage.arrival_s - stop_s == pytest.approx(v_m_s / A_M_S2, abs=1e-9)


def test_a_target_behind_is_reached_after_braking_first() -> None:
    stage = axis()
    stage.move_to(0.0, 0.05, 0.02)
    stage.move_to(1.0, 0.0, 0.02)
    furthest_m = max(stage.position(t_s) for t_s in instants(stage, 1.0))
    assert furthest_m == pytest.approx(stage.position(1.0) + 0.02**2 / (2.0 * A_M_S2), abs=1e-12)
    assert stage.target_m == 0.0


def test_a_stall_stands_still_at_once_where_it_is() -> None:
    stage = axis()
    stage.move_to(0.0, 0.05, 0.02)
    here_m = stage.position(1.0)
    stage.stall(1.0)
    assert stage.velocity(1.0) == 0.0
    assert stage.position(50.0) == here_m
    assert not stage.moving(1.0)


def test_the_motion_before_a_command_is_remembered() -> None:
    stage = axis()
    stage.move_to(0.0, 0.05, 0.02)
    expected_m = stage.position(0.7)
    stage.stop(1.0)
    assert stage.position(0.7) == expected_m


def test_memory_does_not_grow_with_commands() -> None:
    stage = axis()
    for k in range(1000):
        stage.move_to(0.1 * k, 0.01 * (k % 3), 0.02)
    assert len(stage._pieces) <= 64


@pytest.mark.parametrize("wrong", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_refused_by_name(wrong: float) -> None:
    with pytest.raises(ValueError, match="target_m"):
        axis().move_to(0.0, wrong, 0.01)
    with pytest.raises(ValueError, match="speed_m_s"):
        axis().move_to(0.0, 0.01, wrong)
    with pytest.raises(ValueError, match="acceleration_m_s2"):
        StageAxis(acceleration_m_s2=wrong, max_speed_m_s=1.0)


def test_a_stage_that_is_placed_stands_there_and_knows_nothing_of_before() -> None:
    stage = axis()
    stage.move_to(0.0, 0.05, 0.02)
    stage.place(1.0, 0.003)
    assert stage.pieces(2.0) == [MotionPiece(2.0, 0.003, 0.0, 0.0)]
    with pytest.raises(ValueError, match="is before the motion that is remembered"):
        stage.position(0.5)
