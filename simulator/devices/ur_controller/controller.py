"""The controller's model: registers, program, safety and watchdog on a simulated arm. No bytes, no clock.

Facts marked [E] in the comments are what a re-implementation of the control script does; no real controller
was at hand.
"""

import math
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum

import numpy as np

from drivers.ur_arm.tool import NO_TOOL, Tool
from simulator.devices.ur_controller.registers import registers
from simulator.devices.ur_controller.rtde import Value
from simulator.devices.ur_controller.script import STEP_S, ControlScript
from simulator.physics.arm_motion import Arm, LimitError
from simulator.physics.rigid import Array, matrix

VERSION = "5.11.1.108318"
"""PolyScope version that it reports: from 5.6 to 5.22 the client works as measured."""

SERIAL = "20215300001"
"""Serial number that it reports (assumption); the client insists on digits."""

START_RAD = (0.0, -1.8, -2.2, -0.71238898038469, 1.5707963267948966, 0.0)
"""Joints of an arm with its tool downwards, about 0.4 m in front of the base (assumption)."""

UNLOCK_S = 5.0
"""How long after a protective stop it may be unlocked (dashboard manual)."""

FORCE_NOISE_N, TORQUE_NOISE_N_M = 0.5, 0.02
"""Standard deviation of each channel (assumption; the data sheet's precision is 3.5 N and 0.2 N m)."""

HALT_M_S2 = 5.0
"""Deceleration when a program stops or the arm stops itself (assumption)."""

FORCE_LIMIT_N = 150.0
"""Force on the tool above which the arm stops itself (default of the e-Series safety configuration)."""

LOG_LINES = 200
"""Lines of the controller's log that are kept (assumption)."""

Wrench = Callable[[Array, Array, float], Sequence[float] | Array]
"""What acts on the tool at its point, base frame, shape (6,), N and N m: of its pose (m and rotation vector), its twist
(m/s and rad/s), shape (6,) each, and the surroundings' time at the end of this cycle, which never goes back."""


def free(pose: Array, twist: Array, t_s: float) -> Array:
    """A `Wrench`: of an arm that touches nothing."""
    return np.zeros(6)


class Safety(IntEnum):
    """`safety_mode` (RTDE guide)."""

    NORMAL = 1
    PROTECTIVE_STOP = 3
    EMERGENCY_STOP = 7

    @property
    def bits(self) -> int:
        """`safety_status_bits`: normal is bit 0; stops set their own and bit 10 (RTDE guide)."""
        return {Safety.NORMAL: 1 << 0, Safety.PROTECTIVE_STOP: 1 << 2 | 1 << 10}.get(
            self, 1 << 6 | 1 << 7 | 1 << 10
        )


class UrController:
    """A controller with its arm.

    Args:
        joints_rad: Where the arm starts, shape (6,).
        tool: As it was entered at the pendant.
        wrench: What acts on it.

    Attributes:
        t_s: The controller's time: steps of 2 ms since it was made.
        epoch_s: The surroundings' time at which `t_s` was zero.
        inputs: Input registers, and what else a client has written, by RTDE name.
        safety: Why it would not move, or NORMAL.
        remote: Whether remote control is on at the pendant.
        accepts_scripts: False makes it ignore uploads, as in local control.
        log: What went wrong with programs, newest last.
        payload: Mass in kg and centre of gravity in m, as the pendant or a program set them.
    """

    def __init__(
        self,
        joints_rad: Sequence[float] | Array = START_RAD,
        tool: Tool = NO_TOOL,
        wrench: Wrench = free,
        *,
        unlock_s: float = UNLOCK_S,
        force_noise_n: float = FORCE_NOISE_N,
        torque_noise_n_m: float = TORQUE_NOISE_N_M,
    ) -> None:
        self.arm = Arm(joints_rad)
        self.arm.mount(matrix(tool.tcp_offset))
        self.inputs: dict[str, Value] = _zeros("input")
        self.outputs: dict[str, Value] = _zeros("output")
        self.safety = Safety.NORMAL
        self.remote = True
        self.accepts_scripts = True
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self.payload: tuple[float, ...] = (tool.payload_kg, *tool.payload_cog_m)
        self.wrench = wrench
        self.epoch_s = 0.0
        self._unlock_s = unlock_s
        self._noise = np.random.Generator(np.random.Philox(0))
        self._sigma = np.array([force_noise_n] * 3 + [torque_noise_n_m] * 3)
        self._steps = 0
        self._script: ControlScript | None = None
        self._watched: tuple[str, float] | None = None
        self._written_s: dict[str, float] = {}
        self._stopped_s = -np.inf
        self._zero = np.zeros(6)
        self._touch = np.zeros(6)
        self._measured = np.zeros(6)
        self._feel()

    @property
    def t_s(self) -> float:
        """The controller's time in seconds."""
        return self._steps * STEP_S

    @property
    def playing(self) -> bool:
        """Whether a program runs."""
        return self._script is not None

    @property
    def force(self) -> Array:
        """`actual_TCP_force`: what acts on the tool beyond the tare, base frame, (6,): N and N m."""
        return self._measured - self._zero

    @property
    def felt(self) -> Array:
        """The same without the sensor's noise: what an arm that is led by hand gives way to."""
        return self._touch - self._zero

    @property
    def raw_force(self) -> Array:
        """`ft_raw_wrench`: the same before the tare."""
        return self._measured

    def step(self) -> None:
        """Two milliseconds: program, arm, force."""
        self._steps += 1
        self._mind_the_watchdog()
        if self._script is not None:
            try:
                if not self._script.step():
                    self.stop_program("the program ended")
            except (RuntimeError, ValueError, ArithmeticError, LookupError, TypeError) as error:
                self.stop_program(f"runtime exception: {error}")
        try:
            self.arm.step(STEP_S)
        except LimitError as error:
            self.protective_stop(str(error))
        self._feel()
        force_n = math.hypot(*self._touch[:3].tolist())
        if force_n > FORCE_LIMIT_N and self.safety is Safety.NORMAL:
            self.protective_stop(f"{force_n:.0f} N on the tool, above {FORCE_LIMIT_N:g} N")

    def write_inputs(self, values: Mapping[str, Value]) -> None:
        """Take a client's data package."""
        for name, value in values.items():
            self.inputs[name] = value
            self._written_s[name] = self.t_s

    def start_program(self) -> None:
        """Run the client's control script.

        A script that comes while another runs ends it [E]. A protective stop or local control runs nothing.
        """
        if self.safety is not Safety.NORMAL or not self.accepts_scripts:
            self.log.append("script refused")
            return
        if self._script is not None:
            self.stop_program("replaced by another program")
        self._watched = None
        self._script = ControlScript(self)

    def stop_program(self, reason: str) -> None:
        """End the program; the arm comes to rest."""
        if self._script is None:
            return
        self._script = None
        self.log.append(f"{self.t_s:.3f} s: program stopped: {reason}")
        self.arm.brake(HALT_M_S2)

    def protective_stop(self, reason: str) -> None:
        """Stop arm and program until someone unlocks them."""
        self._stop_for_safety(Safety.PROTECTIVE_STOP, reason)

    def emergency_stop(self) -> None:
        """Stop as with the red button."""
        self._stop_for_safety(Safety.EMERGENCY_STOP, "emergency stop")

    def unlock(self) -> bool:
        """Unlock a protective stop; False where it is too early."""
        if self.safety is not Safety.PROTECTIVE_STOP or self.t_s - self._stopped_s < self._unlock_s:
            return False
        self.safety = Safety.NORMAL
        return True

    def set_watchdog(self, register: str, frequency_hz: float) -> None:
        """Stop the program when a client's writes to an input register become rarer than this [E]."""
        self._watched = (register, 1.0 / frequency_hz) if frequency_hz > 0.0 else None
        self._written_s[register] = self.t_s

    def zero_force(self) -> None:
        """Take the present force for zero, noise averaged out."""
        self._zero = self._touch

    def _mind_the_watchdog(self) -> None:
        if self._script is None or self._watched is None:
            return
        register, period_s = self._watched
        if self.t_s - self._written_s.get(register, 0.0) > period_s:
            self.stop_program(f"watchdog: {register} not written for {period_s:.3f} s")

    def _stop_for_safety(self, safety: Safety, reason: str) -> None:
        self.safety = safety
        self._stopped_s = self.t_s
        self.stop_program(f"{safety.name.lower().replace('_', ' ')}: {reason}")
        self.arm.brake(HALT_M_S2)

    def _feel(self) -> None:
        now_s = self.epoch_s + self.t_s
        wrench = self.wrench(self.arm.pose, self.arm.twist, now_s)
        self._touch = np.asarray(wrench, dtype=np.float64)
        self._measured = self._touch + self._sigma * self._noise.standard_normal(6)


def _zeros(way: str) -> dict[str, Value]:
    return {name: 0.0 if kind == "DOUBLE" else 0 for name, kind in registers(way).items()}
