"""A tool's motion in closed form: as small steps have it, within its limits, exactly on its target."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from simulator.physics.rigid import rotation
from simulator.physics.stage_axis import StageAxis
from simulator.physics.tool_motion import ToolMotion

DOWN = (0.0, 0.0, -1.0)
SLOPING = (0.6, 0.0, -0.8)
ACCELERATION, SPEED_M_S = 0.5, 0.05
STEP_S = 1e-4


def motion(direction: tuple[float, float, float] = DOWN) -> ToolMotion:
    return ToolMotion(direction, acceleration_m_s2=ACCELERATION, max_speed_m_s=SPEED_M_S)


def speedl(orders: list[tuple[float, np.ndarray]], duration_s: float) -> np.ndarray:
    """Naive tool speeds: at each step the twist goes towards what was last ordered, translation and turn together.

    Returns displacements (n, 6), one for each step.
    """
    twist, place, places = np.zeros(6), np.zeros(6), []
    for number in range(round(duration_s / STEP_S)):
        t_s = number * STEP_S
        target = next(order for begin_s, order in reversed(orders) if begin_s <= t_s + 1e-9)
        change = target - twist
        largest = max(np.linalg.norm(change[:3]), np.linalg.norm(change[3:]))
        before = twist
        if largest > 0.0:
            twist = twist + change * min(1.0, ACCELERATION * STEP_S / largest)
        place = place + 0.5 * (before + twist) * STEP_S
        places.append(place)
    return np.array(places)


def test_twists_that_take_over_from_each_other_are_where_small_steps_lead():
    first, second = np.array([0.02, -0.01, 0.03, 0.1, 0.0, 0.0]), np.array([-0.03, 0.0, 0.01, 0.0, 0.3, 0.0])
    tool = motion(SLOPING)
    tool.twist(0.0, first.tolist(), 5.0)
    tool.twist(0.31, second.tolist(), 0.95)
    steps = speedl([(0.0, first), (0.31, second), (1.26, np.zeros(6))], 3.0)
    times_s = STEP_S * np.arange(1, len(steps) + 1)
    # The steps round each ramp's end up to a whole one: half a step of 0.3 rad/s at the most, a few times.
    assert np.abs(tool.offsets(times_s) - steps).max() < 1e-6


def test_a_twist_from_rest_goes_as_far_as_twist_times_duration():
    tool = motion(SLOPING)
    twist = np.array([0.02, 0.01, 0.0, 0.0, 0.2, 0.0])
    tool.twist(0.5, twist.tolist(), 2.0)
    assert tool.arrival_s == pytest.approx(0.5 + 2.0 + 0.2 / ACCELERATION)
    assert tool.offsets(np.array([10.0]))[0] == pytest.approx(2.0 * twist, abs=1e-15)


def test_translation_and_turn_of_a_twist_keep_their_ratio_while_it_begins_and_ends():
    tool = motion()
    tool.twist(0.0, (0.003, 0.0, 0.0, 0.0, 0.25, 0.0), 1.0)
    offsets = tool.offsets(np.linspace(0.01, 2.0, 200))
    assert offsets[:, 0] == pytest.approx(0.012 * offsets[:, 4], rel=1e-12)


def test_a_twist_shorter_than_its_ramp_turns_round_on_it():
    tool = motion()
    tool.twist(0.0, (0.05, 0.0, 0.0, 0.0, 0.0, 0.0), 0.04)
    # 0.04 s at 0.5 m/s2, up and down again.
    assert tool.arrival_s == pytest.approx(0.08)
    assert tool.offsets(np.array([1.0]))[0, 0] == pytest.approx(0.02 * 0.04, abs=1e-15)


@pytest.mark.parametrize("direction", [DOWN, SLOPING])
def test_a_straight_move_takes_the_time_of_its_trapezoid_and_stands_exactly_there(direction):
    tool = motion(direction)
    offset = (0.03, 0.04, 0.0, 0.0, 0.01, 0.0)
    tool.move_pose(1.0, offset, 0.02)
    # 50 mm at 20 mm/s, and one ramp of 40 ms more.
    assert tool.arrival_s == pytest.approx(1.0 + 0.05 / 0.02 + 0.04)
    assert tool.offsets(np.array([tool.arrival_s, 9.0])) == pytest.approx(np.array([offset] * 2), abs=1e-17)
    line = tool.offsets(np.linspace(1.0, tool.arrival_s, 50))
    assert np.abs(line[:, 0] - 0.75 * line[:, 1]).max() < 1e-16


def test_a_move_that_turns_goes_the_shortest_way_round_and_home_again():
    tool = motion()
    first, second = (0.0, 0.0, 0.0, 0.4, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.7, 0.2)
    tool.move_pose(0.0, first, 0.3)
    tool.move_pose(5.0, second, 0.3)
    assert tool.turns(np.array([4.0, 20.0])) == pytest.approx(np.array([first[3:], second[3:]]), abs=1e-12)
    between = [rotation(turn) for turn in tool.turns(np.linspace(5.0, tool.arrival_s, 20))]
    axes = [(b @ between[0].T - between[0] @ b.T)[[2, 0, 1], [1, 2, 0]] for b in between[1:]]
    assert all(np.allclose(np.cross(axes[0], axis), 0.0, atol=1e-12) for axis in axes)
    tool.move_to(20.0, 0.0, 0.3)
    assert not tool.turns(np.array([40.0])).any()


def test_a_turn_under_a_twist_of_a_fixed_axis_is_its_angle():
    tool = motion()
    tool.move_pose(0.0, (0.0, 0.0, 0.0, 0.0, 0.0, math.pi / 2.0), 0.5)
    tool.twist(10.0, (0.0, 0.0, 0.0, 0.3, 0.0, 0.0), 1.0)
    (turn,) = tool.turns(np.array([20.0]))
    wanted = rotation((0.3, 0.0, 0.0)) @ rotation((0.0, 0.0, math.pi / 2.0))
    assert rotation(turn) == pytest.approx(wanted, abs=1e-12)


def test_a_stop_on_a_free_motion_brakes_along_its_way_at_the_rate_that_is_given():
    tool = motion()
    tool.twist(0.0, (0.03, 0.04, 0.0, 0.0, 0.0, 0.0), 5.0)
    tool.stop(1.0, 3.0)
    before, after = tool.offsets(np.array([1.0, 2.0]))
    assert tool.arrival_s == pytest.approx(1.0 + 0.05 / 3.0)
    assert after - before == pytest.approx(np.array([0.6, 0.8, 0, 0, 0, 0]) * 0.05**2 / 6.0, abs=1e-15)


def test_an_approach_keeps_what_the_tool_is_beside_the_axis_and_takes_its_speed_along():
    tool = motion()
    tool.move_pose(0.0, (0.01, 0.0, 0.0, 0.0, 0.2, 0.0), 0.05)
    tool.twist(30.0, (0.02, 0.0, -0.01, 0.0, 0.0, 0.0), 5.0)
    tool.move_at(31.0, 0.02, 0.04)
    turning = tool.offsets(np.array([31.0, 31.02, 50.0]))
    assert turning[1, 2] < turning[0, 2] - 0.01 * 0.02, "it did not stand in between"
    assert turning[2, 2] == -0.04
    assert 0.01 + 0.0196 < turning[2, 0] < 0.01 + 0.0204
    assert turning[2, 4] == pytest.approx(0.2)


def test_an_approach_from_beside_without_room_for_its_speed_does_not_pass_its_limit():
    tool = motion()
    tool.twist(0.0, (0.01, 0.0, -0.05, 0.0, 0.0, 0.0), 5.0)
    here_m = tool.position(0.2)
    tool.move_at(0.2, 0.05, here_m + 0.004)
    depths = -tool.offsets(np.linspace(0.2, 3.0, 3000))[:, 2]
    assert depths.max() <= here_m + 0.004 + 1e-12
    assert depths[-1] == pytest.approx(here_m + 0.004, abs=1e-15)


ORDERS = st.lists(
    st.tuples(
        st.sampled_from(["twist", "pose", "at", "to", "stop"]),
        st.floats(0.01, 0.6),
        st.tuples(*[st.floats(-0.04, 0.04)] * 6),
    ),
    min_size=1,
    max_size=6,
)


def given_orders(tool: ToolMotion, orders: list[tuple[str, float, tuple[float, ...]]]) -> float:
    """Give them one after the other, each after its pause; when the last one was given."""
    t_s = 0.0
    does: dict[str, Callable[[tuple[float, ...]], None]] = {
        "twist": lambda six: tool.twist(t_s, six, 0.4),
        "pose": lambda six: tool.move_pose(t_s, six, 0.03),
        "at": lambda six: tool.move_at(t_s, math.copysign(0.03, six[0]), six[1]),
        "to": lambda six: tool.move_to(t_s, six[0], 0.03),
        "stop": lambda six: tool.stop(t_s),
    }
    for name, pause_s, six in orders:
        t_s += pause_s
        does[name](six)
    return t_s


@settings(max_examples=60, deadline=None)
@given(orders=ORDERS)
def test_no_order_makes_the_tool_jump_or_exceed_its_acceleration(orders):
    tool = motion(SLOPING)
    given_orders(tool, orders)
    step_s = 1e-3
    offsets = tool.offsets(np.arange(0.0, tool.arrival_s + 0.1, step_s))
    speeds = np.diff(offsets, axis=0) / step_s
    for part in (slice(0, 3), slice(3, 6)):
        rates = np.linalg.norm(np.diff(speeds[:, part], axis=0), axis=1) / step_s
        assert rates.max(initial=0.0) <= ACCELERATION * (1.0 + 1e-6)
        assert np.linalg.norm(speeds[:, part], axis=1).max() <= np.hypot(np.hypot(0.04, 0.04), 0.04) + 1e-9


@settings(max_examples=30, deadline=None)
@given(orders=ORDERS, cuts=st.lists(st.integers(1, 400), max_size=5))
def test_blocks_of_any_size_have_the_same_bytes(orders, cuts):
    tool = motion(SLOPING)
    given_orders(tool, orders)
    times_s = np.arange(400) * 0.002
    for ask in (tool.offsets, tool.turns):
        parts = [ask(part) for part in np.split(times_s, sorted(set(cuts))) if len(part)]
        assert np.concatenate(parts).tobytes() == ask(times_s).tobytes()


@settings(max_examples=40, deadline=None)
@given(
    orders=st.lists(
        st.tuples(
            st.sampled_from(["at", "to", "stop"]),
            st.floats(0.01, 0.6),
            st.tuples(*[st.floats(-0.04, 0.04)] * 2),
        ),
        min_size=1,
        max_size=6,
    )
)
def test_on_the_axis_alone_it_is_a_stage_to_the_last_bit(orders):
    tool = motion(SLOPING)
    stage = StageAxis(acceleration_m_s2=ACCELERATION, max_speed_m_s=SPEED_M_S)
    t_s = 0.0
    for name, pause_s, (first, second) in orders:
        t_s += pause_s
        for mover in (tool, stage):
            if name == "at":
                mover.move_at(t_s, math.copysign(0.03, first), second)
            elif name == "to":
                mover.move_to(t_s, first, 0.03)
            else:
                mover.stop(t_s)
        assert tool.pieces(t_s) == stage.pieces(t_s)
        assert tool.arrival_s == stage.arrival_s


def test_what_is_longer_ago_than_it_remembers_is_an_error():
    tool = motion()
    for number in range(100):
        tool.twist(0.1 * number, (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0)
    with pytest.raises(ValueError, match="before the motion that is remembered"):
        tool.offsets(np.array([0.0, 9.9]))
