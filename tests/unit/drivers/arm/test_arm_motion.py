"""What the arm does with commands, on the emulated controller in virtual time."""

from collections.abc import Sequence
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.arm.axis import Axis
from drivers.arm.guidance import CYCLE_S
from drivers.arm.link import ArmRow, Seen
from drivers.arm.motion import MotionControl
from drivers.core.messages import (
    Command,
    Home,
    Lead,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Stalled,
    Status,
    Twist,
)
from drivers.ur_arm.client import fault_of
from drivers.ur_arm.settings import UrArmSettings
from simulator.devices.ur_controller.controller import Runtime, Safety, UrController, UrControllerSettings
from simulator.physics.rigid import difference

EPOCH_S = 1000.0
"""The host's monotonic time at the controller's zero."""

LIMITS = {"travel_min_m": -0.04, "travel_max_m": 0.04, "max_speed_m_s": 0.1, "leash_m": 0.06}


class DirectClient:
    """Does with registers what the real client does over the wire, blocking calls included."""

    def __init__(self, rig: "Rig") -> None:
        self.calls: list[str] = []
        self.deaf = False
        self._rig = rig

    def speed(self, twist: Sequence[float], acceleration_m_s2: float) -> bool:
        taken = self._stream("speed", 10, [*twist, acceleration_m_s2, 0.002])
        if taken:
            self._rig.twists.append(tuple(twist))
        return taken

    def end_speed(self) -> bool:
        return self._call("end_speed", 15, [3.0])

    def move(self, pose: Sequence[float], speed_m_s: float, acceleration_m_s2: float) -> bool:
        return self._call("move", 3, [*pose, speed_m_s, acceleration_m_s2], flag=1)

    def end_move(self, deceleration_m_s2: float) -> bool:
        return self._call("end_move", 33, [deceleration_m_s2], flag=1)

    def busy(self) -> bool:
        value = self._rig.controller.outputs["output_int_register_2"]
        assert isinstance(value, int)
        return bool(value & 0x8000)

    def feed_watchdog(self) -> bool:
        return self._stream("feed_watchdog", 0, [])

    def tare(self) -> bool:
        return self._call("tare", 8, [])

    def lead(self, on: bool) -> bool:
        return self._call("lead" if on else "end_lead", 18 if on else 19, [])

    def halt(self) -> None:
        self.calls.append("halt")
        self._rig.controller.stop_program("halt")

    def recover(self) -> str:
        controller = self._rig.controller
        self.calls.append("recover")
        if controller.safety is Safety.EMERGENCY_STOP:
            return "the emergency stop is pressed"
        self._rig.advance(100)
        controller.unlock()
        controller.write_inputs({"input_int_register_0": 0})
        controller.start_program(0)
        self._rig.advance(2)
        return ""

    def _stream(self, name: str, command: int, numbers: Sequence[float]) -> bool:
        self.calls.append(name)
        if self.deaf or self._rig.controller.runtime is Runtime.STOPPED:
            return False
        self._write(command, numbers, 0)
        return True

    def _call(self, name: str, command: int, numbers: Sequence[float], flag: int = 0) -> bool:
        if not self._stream(name, command, numbers):
            return False
        self._write(command, numbers, flag)
        controller = self._rig.controller
        for _ in range(2000):
            self._rig.advance(1)
            if controller.runtime is Runtime.STOPPED:
                return False
            if controller.outputs["output_int_register_0"] == 2:
                self._write(0, [], 0)
                self._rig.advance(1)
                return True
        raise AssertionError(f"{name} is never done")

    def _write(self, command: int, numbers: Sequence[float], flag: int) -> None:
        registers = {f"input_double_register_{i}": float(number) for i, number in enumerate(numbers)}
        self._rig.controller.write_inputs(
            {"input_int_register_0": command, "input_int_register_1": flag, **registers}
        )


class Rig:
    """Controller, client and motion, with time in hand."""

    def __init__(self) -> None:
        quiet = UrControllerSettings(force_noise_n=0.0, torque_noise_n_m=0.0, unlock_s=0.1)
        self.controller = UrController(quiet)
        self.settings = UrArmSettings.model_validate(
            {"host": "127.0.0.2", "start_pose": tuple(self.controller.arm.pose), **LIMITS}
        )
        self.axis = Axis(self.settings)
        self.controller.start_program(0)
        self.statuses: list[Status] = []
        self.positions_m: list[float] = []
        self._seen = Seen(self._row(), EPOCH_S)
        self.advance(2)
        self.twists: list[tuple[float, ...]] = []
        self.client = DirectClient(self)
        self.motion = MotionControl(
            "arm", self.settings, self.client, self.now, self.statuses.append, self.seen()
        )

    def now(self) -> float:
        return EPOCH_S + self.controller.t_s

    @property
    def position_m(self) -> float:
        return self.axis.position_m(tuple(self.controller.arm.pose))

    def advance(self, steps: int) -> None:
        """Cycles of the controller, without the motion."""
        for _ in range(steps):
            self.controller.step()
            self.positions_m.append(self.position_m)
            self._seen = self._seen.then(self._row())

    def seen(self) -> Seen:
        return Seen(self._row(), self._seen.still_since_s)

    def _row(self) -> ArmRow:
        controller = self.controller
        running = controller.runtime is Runtime.PLAYING
        return ArmRow(
            self.now(),
            controller.t_s,
            tuple(controller.arm.pose),
            tuple(controller.arm.twist),
            tuple(controller.force),
            fault_of(controller.safety.bits, running),
            running,
        )

    def run(self, duration_s: float, cycle_steps: int = 4, old_steps: int = 0) -> None:
        """The motion's cycles; `old_steps` is the age of what it sees."""
        end_s = self.now() + duration_s
        while self.now() < end_s:
            seen = self.seen()
            self.advance(old_steps)
            self.motion.heartbeat()
            self.motion.step(seen)
            self.advance(max(1, cycle_steps - old_steps))

    def run_until(self, kind: type[Status], timeout_s: float = 10.0) -> Any:
        """Cycles until a status of a kind comes."""
        before = len(self.statuses)
        end_s = self.now() + timeout_s
        while self.now() < end_s:
            self.run(0.008)
            for status in self.statuses[before:]:
                if isinstance(status, kind):
                    return status
        raise AssertionError(f"no {kind.__name__} in {self.statuses}")

    def order(self, command: Command) -> None:
        self.motion.order(command)

    def kinds(self) -> list[str]:
        """The names of the statuses so far."""
        return [type(status).__name__ for status in self.statuses]


DOWN = (0.0, 0.0, -0.02, 0.0, 0.0, 0.0)
ASIDE = (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize(("speed_m_s", "limit_m"), [(0.02, 0.03), (-0.05, -0.02)])
def test_an_approach_comes_to_rest_just_before_its_limit(speed_m_s: float, limit_m: float) -> None:
    arm = Rig()
    arm.order(MoveAt("arm", speed_m_s, limit_m))
    reached = arm.run_until(Reached)
    assert arm.kinds() == ["Sent", "Reached"]
    assert abs(limit_m) - 2e-4 <= abs(reached.position_m) <= abs(limit_m)
    assert arm.controller.arm.resting


@settings(max_examples=25, deadline=None)
@given(
    speed=st.floats(0.001, 0.1),
    limit=st.floats(0.002, 0.04),
    cycle_steps=st.integers(1, 12),
    old_steps=st.integers(0, 4),
)
def test_no_speed_and_no_late_cycle_carries_an_approach_beyond_its_limit(
    speed: float, limit: float, cycle_steps: int, old_steps: int
) -> None:
    arm = Rig()
    arm.order(MoveAt("arm", speed, limit))
    arm.run(1.5, cycle_steps, old_steps)
    assert max(arm.positions_m) <= limit


def test_a_twist_goes_as_far_as_its_duration_says_and_rolls_without_sliding() -> None:
    arm = Rig()
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


def test_a_move_that_only_turns_takes_its_speed_for_rad_s() -> None:
    arm = Rig()
    before_s = arm.now()
    arm.order(MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.4, 0.0), 0.4))
    arm.run_until(Reached)
    # 1 s, one ramp of 0.8 s (0.5 rad/s2: it never gets to 0.4 rad/s in less), and the time to be sure.
    assert 1.75 < arm.now() - before_s < 1.95


def test_a_twist_after_a_recovery_begins_from_rest() -> None:
    arm = Rig()
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


def test_a_motion_ends_the_leading_first() -> None:
    arm = Rig()
    arm.order(Lead("arm"))
    arm.run(0.1)
    assert arm.controller.runtime is arm.controller.runtime.PLAYING, "its watchdog is fed"
    arm.order(MoveTo("arm", -0.01, 0.05))
    assert arm.run_until(Reached).position_m == pytest.approx(-0.01, abs=1e-5)
    assert arm.client.calls.index("end_lead") < arm.client.calls.index("move")
