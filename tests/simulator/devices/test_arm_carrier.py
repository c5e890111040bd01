"""The probe in the tool of an arm that moves in cycles: where the finger meets it, and with what force."""

import numpy as np
import pytest

from drivers.arm.axis import Axis
from drivers.ur_arm.settings import UrArmSettings
from simulator.devices.arm_carrier import JOGGED_M, ArmCarrier, emulated
from simulator.physics.finger_part import FingerBenchSettings, finger_bench
from simulator.physics.rigid import displaced, matrix, pose
from simulator.physics.stage_axis import AxisMotion, MotionPiece

START = (0.4, -0.1, 0.25, 0.0, 3.1416, 0.0)
CYCLE_S = 0.002
SPEED_M_S = 0.01
AXIS = Axis(UrArmSettings.model_validate({"host": "nobody", "start_pose": START}))


class Scene:
    """An arm in front of an unexcited finger, and a clock for both."""

    def __init__(self) -> None:
        self.bench = finger_bench(FingerBenchSettings())
        self.carrier = ArmCarrier(AXIS, self.bench)
        self.bench.mount(self.carrier)
        self.cycle(0, 0.0, 0.0)

    def cycle(self, number: int, position_m: float, velocity_m_s: float) -> tuple[float, ...]:
        return self.carrier.wrench(
            np.array(AXIS.pose(position_m)), np.array(AXIS.twist(velocity_m_s)), number * CYCLE_S
        )

    def approach(self, cycles: int, late_s: float = 0.0) -> tuple[float, ...]:
        """Steady motion; before each cycle the bench has lived to `late_s` after it."""
        force: tuple[float, ...] = (0.0,) * 6
        for number in range(1, cycles + 1):
            self.bench.advance(number * CYCLE_S + late_s)
            force = self.cycle(number, SPEED_M_S * number * CYCLE_S, SPEED_M_S)
        return force


@pytest.mark.parametrize("late_s", [-0.0015, 0.0, 0.0007, 0.0019, 0.0045])
def test_the_probe_follows_the_tool_one_cycle_behind_however_late_the_cycle_comes(late_s):
    scene = Scene()
    scene.approach(100, late_s)
    for t_s in (0.15, 0.1701, 0.2):
        assert scene.carrier.position(t_s) == pytest.approx(SPEED_M_S * (t_s - CYCLE_S), abs=1e-12)
        assert scene.carrier.velocity(t_s) == pytest.approx(SPEED_M_S, rel=1e-6)


def test_a_tool_that_stops_leaves_the_probe_where_the_tool_is():
    scene = Scene()
    scene.approach(50)
    for number in range(51, 60):
        scene.cycle(number, 0.001, 0.0)
    assert scene.carrier.position(1.0) == pytest.approx(0.001, abs=1e-12)
    assert scene.carrier.velocity(1.0) == 0.0


def test_a_bench_that_no_other_device_advances_is_advanced_by_the_arm():
    scene = Scene()
    for number in range(1, 200):
        scene.cycle(number, SPEED_M_S * number * CYCLE_S, SPEED_M_S)
    assert 0.3 < scene.bench.t_s < 0.4


def test_the_finger_s_force_on_the_tool_is_that_of_a_probe_on_an_axis():
    scene = Scene()
    force = scene.approach(400)
    # The same motion in one piece, on another bench: 8 mm, of which 5 are in the finger.
    bench = finger_bench(FingerBenchSettings())
    axis = AxisMotion()
    bench.mount(axis)
    axis.replace(CYCLE_S, [MotionPiece(CYCLE_S, 0.0, SPEED_M_S, 0.0)])
    bench.on_plan(CYCLE_S)
    bench.advance(400 * CYCLE_S)
    assert bench.force_n > 0.05
    assert force == pytest.approx((0.0, 0.0, bench.force_n, 0.0, 0.0, 0.0), rel=1e-6, abs=1e-12)


def test_what_the_tool_does_beside_the_axis_moves_no_probe():
    scene = Scene()
    aside = np.array(AXIS.pose(0.0)) + np.array([0.05, 0.02, 0.0, 0.0, 0.0, 0.0])
    scene.carrier.wrench(aside, np.array([0.1, 0.0, 0.0, 0.0, 0.0, 0.0]), CYCLE_S)
    assert scene.carrier.position(1.0) == 0.0


def pose_at(offset: np.ndarray) -> np.ndarray:
    """The tool's pose at an offset (6,) from the start pose, as the controller writes it."""
    return pose(displaced(matrix(START), offset))


@pytest.mark.parametrize("late_s", [-0.0015, 0.0, 0.0019])
def test_in_all_directions_the_bench_s_tool_is_one_cycle_behind_in_straight_lines(late_s):
    scene = Scene()
    twist = np.array([0.02, -0.01, -0.03, 0.0, 0.3, 0.0])
    for number in range(1, 200):
        scene.bench.advance(number * CYCLE_S + late_s)
        scene.carrier.wrench(pose_at(twist * number * CYCLE_S), twist, number * CYCLE_S)
    times_s = np.array([0.15, 0.2003, 0.3, 0.398])
    assert scene.carrier.offsets(times_s) == pytest.approx(twist * (times_s - CYCLE_S)[:, None], abs=1e-9)
    beyond_s = np.array([0.42])
    assert scene.carrier.offsets(beyond_s) == pytest.approx(twist * (beyond_s - CYCLE_S)[:, None], abs=1e-9)
    assert scene.carrier.position(0.3) == pytest.approx(0.03 * (0.3 - CYCLE_S), abs=1e-9)


def test_half_a_second_of_motion_can_still_be_asked_for():
    scene = Scene()
    for number in range(1, 1000):
        scene.cycle(number, SPEED_M_S * number * CYCLE_S, SPEED_M_S)
    now_s = 999 * CYCLE_S
    before = scene.carrier.offsets(np.array([now_s - 0.5]))[0]
    assert before == pytest.approx([0.0, 0.0, -SPEED_M_S * (now_s - 0.5 - CYCLE_S), 0.0, 0.0, 0.0], abs=1e-9)


def test_a_turn_alone_is_followed_too():
    scene = Scene()
    turned = np.array([0.0, 0.0, 0.0, 0.2, 0.0, 0.0])
    for number in range(1, 5):
        scene.carrier.wrench(pose_at(turned), np.zeros(6), number * CYCLE_S)
    assert scene.carrier.offsets(np.array([1.0]))[0] == pytest.approx(turned, abs=1e-9)
    assert scene.carrier.position(1.0) == pytest.approx(0.0, abs=1e-12)


def test_an_emulated_arm_has_the_tool_of_the_profile_with_its_point_at_the_start() -> None:
    tool = {"tcp_offset": (0.0, 0.02, 0.1, 0.0, 0.0, 0.5), "payload_kg": 1.25}
    settings = UrArmSettings(host="emulated", start_pose=START, **tool)
    controller = emulated(settings, finger_bench(FingerBenchSettings())).controller
    jogged = AXIS.pose(JOGGED_M)
    assert controller.arm.pose[:3] == pytest.approx(jogged[:3], abs=1e-9)
    assert controller.arm.tool == pytest.approx(matrix(tool["tcp_offset"]))
    assert controller.payload == (1.25, 0.0, 0.0, 0.0)
