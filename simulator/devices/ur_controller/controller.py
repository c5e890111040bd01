"""The controller's model: registers, program, safety and watchdog on a simulated arm. No bytes, no clock.

Facts marked [E] in the comments are what a re-implementation of the control script does; no real controller
was at hand.
"""

import math
from collections import Counter, deque
from collections.abc import Callable, Mapping, Sequence
from enum import IntEnum
from typing import Annotated, cast

import numpy as np
from pydantic import Field, Strict

from drivers.arm.settings import Pose, Vector
from drivers.core.settings import Settings
from drivers.ur_arm.tool import NO_TOOL
from simulator.devices.ur_controller.registers import registers
from simulator.devices.ur_controller.rtde import Value
from simulator.devices.ur_controller.script import STEP_S, ControlScript, ScriptError
from simulator.physics.arm_motion import Arm, LimitError, StiffPlane, Surroundings
from simulator.physics.rigid import Array, matrix

SLIDER_S = 0.4
"""How long the pace takes from standing to full when the slider is moved (assumption)."""

HISTORY_STEPS = 500
"""How far back the controller knows its joints: one second (assumption)."""

LOG_LINES = 200
"""Lines of the controller's log that are kept (assumption)."""


class UrControllerSettings(Settings):
    """What the emulated controller is."""

    host: str = Field("127.0.0.2", pattern=r"^127\.\d+\.\d+\.\d+$")
    """Loopback address that it listens on. The client skips its remote-control check at 127.0.0.1."""
    version: str = Field("5.11.1.108318", pattern=r"^5\.(6|7|8|9|1\d|2[0-2])\.\d+\.\d+$")
    """PolyScope version that it reports: from 5.6 to 5.22 the client works as measured."""
    serial: str = Field("20215300001", pattern=r"^\d+$")
    """Serial number that it reports (assumption); the client insists on digits."""
    joints_rad: Annotated[tuple[float, float, float, float, float, float], Strict(False)] = (
        0.0,
        -1.8,
        -2.2,
        -0.71238898038469,
        1.5707963267948966,
        0.0,
    )
    """Where the arm starts, radians: tool downwards, about 0.4 m in front of the base (assumption)."""
    tcp_offset: Pose = NO_TOOL.tcp_offset
    """The tool's point in the flange's frame, metres and rotation vector: entered at its pendant."""
    payload_kg: float = Field(NO_TOOL.payload_kg, ge=0.0, le=50.0)
    """Mass of the tool, likewise."""
    payload_cog_m: Vector = NO_TOOL.payload_cog_m
    """Its centre of gravity in the flange's frame, likewise."""
    halt_m_s2: float = Field(5.0, gt=0.0, le=50.0)
    """Deceleration when a program stops or the arm stops itself, m/s^2 (assumption)."""
    unlock_s: float = Field(5.0, ge=0.0, le=60.0)
    """How long after a protective stop it may be unlocked, seconds (dashboard manual: 5 s)."""
    force_limit_n: float = Field(150.0, gt=0.0, le=1000.0)
    """Force on the tool above which the arm stops itself, N (default of the e-Series safety configuration)."""
    contact_n: float = Field(5.0, gt=0.0, le=100.0)
    """Force at which `tool_contact` reports contact, N [E] (assumption)."""
    force_noise_n: float = Field(0.5, ge=0.0, le=20.0)
    """Standard deviation of each force channel, N (assumption; the data sheet's precision is 3.5 N)."""
    torque_noise_n_m: float = Field(0.02, ge=0.0, le=2.0)
    """Standard deviation of each torque channel, N m (assumption; the data sheet's precision is 0.2 N m)."""
    seed: int = Field(0, ge=0)
    """Seed of the force noise."""


class Runtime(IntEnum):
    """`runtime_state` (RTDE guide)."""

    STOPPED = 1
    PLAYING = 2


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

    Attributes:
        t_s: The controller's time: steps of 2 ms since it was made.
        epoch_s: The surroundings' time at which `t_s` was zero.
        inputs: Input registers, and what else a client has written, by RTDE name.
        safety: Why it would not move, or NORMAL.
        remote: Whether remote control is on at the pendant.
        accepts_scripts: False makes it ignore uploads, as in local control.
        log: What went wrong with programs, newest last.
        obeyed: How often its programs obeyed each command id.
        payload: Mass in kg and centre of gravity in m, as the pendant or a program set them.
    """

    def __init__(self, settings: UrControllerSettings, surroundings: Surroundings | None = None) -> None:
        self.settings = settings
        self.arm = Arm(settings.joints_rad)
        self.arm.mount(matrix(settings.tcp_offset))
        self.inputs: dict[str, Value] = _zeros("input")
        self.outputs: dict[str, Value] = _zeros("output")
        self.panel = Panel()
        self.safety = Safety.NORMAL
        self.remote = True
        self.accepts_scripts = True
        self.log: deque[str] = deque(maxlen=LOG_LINES)
        self.obeyed: Counter[int] = Counter()
        self.payload: tuple[float, ...] = (settings.payload_kg, *settings.payload_cog_m)
        self.surroundings = surroundings or StiffPlane()
        self.epoch_s = 0.0
        self._noise = np.random.Generator(np.random.Philox(settings.seed))
        self._sigma = np.array([settings.force_noise_n] * 3 + [settings.torque_noise_n_m] * 3)
        self._steps = 0
        self._script: ControlScript | None = None
        self._watched: tuple[str, float] | None = None
        self._written_s: dict[str, float] = {}
        self._stopped_s = -np.inf
        self._zero = np.zeros(6)
        self._touch = np.zeros(6)
        self._measured = np.zeros(6)
        self._history: deque[tuple[Array, Array]] = deque(maxlen=HISTORY_STEPS)  # joints, force
        self._feel()

    @property
    def t_s(self) -> float:
        """The controller's time in seconds."""
        return self._steps * STEP_S

    @property
    def runtime(self) -> Runtime:
        """Whether a program runs."""
        return Runtime.STOPPED if self._script is None else Runtime.PLAYING

    @property
    def force(self) -> Array:
        """`actual_TCP_force`: what acts on the tool beyond the tare, base frame, (6,): N and N m."""
        return self._measured - self._zero

    @property
    def felt(self) -> Array:
        """The same without the sensor's noise: what a program's control of force works on."""
        return self._touch - self._zero

    @property
    def raw_force(self) -> Array:
        """`ft_raw_wrench`: the same before the tare."""
        return self._measured

    def step(self) -> None:
        """Two milliseconds: program, arm, force."""
        self._steps += 1
        self._mind_the_watchdog()
        self._pace()
        if self._script is not None:
            try:
                if not self._script.step():
                    self.stop_program("the program ended")
            except (ScriptError, ValueError, ArithmeticError, LookupError, TypeError) as error:
                self.stop_program(f"runtime exception: {error}")
        try:
            self.arm.step(STEP_S)
        except LimitError as error:
            self.protective_stop(str(error))
        self._feel()
        force_n = math.hypot(*self._touch[:3].tolist())
        if force_n > self.settings.force_limit_n and self.safety is Safety.NORMAL:
            self.protective_stop(f"{force_n:.0f} N on the tool, above {self.settings.force_limit_n:g} N")

    def write_inputs(self, values: Mapping[str, Value]) -> None:
        """Take a client's data package."""
        for name, value in values.items():
            self.inputs[name] = value
            self._written_s[name] = self.t_s
        self.panel.write(values)

    def start_program(self, offset: int) -> None:
        """Run the client's control script, whose registers begin at `offset`.

        A script that comes while another runs ends it [E]. A protective stop or local control runs nothing.
        """
        if self.safety is not Safety.NORMAL or not self.accepts_scripts:
            self.log.append("script refused")
            return
        if self._script is not None:
            self.stop_program("replaced by another program")
        self._watched = None
        self._script = ControlScript(self, offset)

    def stop_program(self, reason: str) -> None:
        """End the program; the arm comes to rest."""
        if self._script is None:
            return
        self._script = None
        self.log.append(f"{self.t_s:.3f} s: program stopped: {reason}")
        self._halt()

    def protective_stop(self, reason: str) -> None:
        """Stop arm and program until someone unlocks them."""
        self._stop_for_safety(Safety.PROTECTIVE_STOP, reason)

    def emergency_stop(self) -> None:
        """Stop as with the red button."""
        self._stop_for_safety(Safety.EMERGENCY_STOP, "emergency stop")

    def unlock(self) -> bool:
        """Unlock a protective stop; False where it is too early."""
        if self.safety is not Safety.PROTECTIVE_STOP or self.t_s - self._stopped_s < self.settings.unlock_s:
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

    def contact_steps(self, direction: Sequence[float] | Array) -> int:
        """How many steps ago the contact began that is there now; 0 where there is none [E].

        Args:
            direction: Of the tool's motion, base frame; zeros take a contact from any side.

        Raises:
            ValueError: that is no direction.
        """
        toward = np.asarray(direction[:3], dtype=np.float64)
        length = math.hypot(*toward.tolist())
        if not length < math.inf:
            raise ValueError(f"a contact from {toward}")
        against: Callable[[Array], float] = (
            (lambda force: -float(force @ toward) / length)
            if length
            else (lambda force: math.hypot(*force.tolist()))
        )
        if not self._history or against(self._history[-1][1]) < self.settings.contact_n:
            return 0
        steps = 0
        for _, force_n in reversed(self._history):
            if against(force_n) <= 0.0:
                break
            steps += 1
        return steps

    def joints_before(self, steps: int) -> Array:
        """The joints (6,) as they were so many steps ago, or as far back as they are known.

        Raises:
            ValueError: so many are none.
        """
        if steps < 0:
            raise ValueError(f"joints {steps} steps ago")
        return self._history[-1 - min(steps, len(self._history) - 1)][0]

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
        self._halt()

    def _halt(self) -> None:
        self.arm.brake(self.settings.halt_m_s2)

    def _pace(self) -> None:
        """Bring the pace of what the program moves towards the slider; a stop of the controller's own has its own."""
        wanted = 1.0 if self._script is None else self.panel.slider
        if self.arm.scaling == wanted:
            return
        if self.arm.resting:
            self.arm.scaling = wanted
            return
        most = STEP_S / SLIDER_S
        self.arm.scaling += min(max(wanted - self.arm.scaling, -most), most)

    def _feel(self) -> None:
        now_s = self.epoch_s + self.t_s
        wrench = self.surroundings.wrench(self.arm.pose, self.arm.twist, now_s)
        self._touch = np.asarray(wrench, dtype=np.float64)
        self._measured = self._touch + self._sigma * self._noise.standard_normal(6)
        self._history.append((self.arm.joints_rad, (self._touch - self._zero)[:3]))


def _zeros(way: str) -> dict[str, Value]:
    return {name: 0.0 if kind == "DOUBLE" else 0 for name, kind in registers(way).items()}


_DIGITAL = {"standard": (0, 0xFF), "configurable": (8, 0xFF), "tool": (16, 0b11)}
"""First bit of each group in `actual_digital_output_bits`, and which of its bits there are (RTDE guide)."""

_ANALOG_TYPES_BIT = 2
"""First bit of the outputs in `analog_io_types`: the inputs come before (RTDE guide)."""

_CURRENT_A, _VOLTAGE_V = (0.004, 0.020), (0.0, 10.0)
"""What an analog output gives at fractions of 0 and 1 (user manual)."""


class Panel:
    """The controller's outputs and its slider.

    Attributes:
        slider: Fraction of the programmed speed, 0 to 1.
        digital_bits: Standard outputs in bits 0-7, configurable ones in 8-15, the tool's in 16-17.
    """

    def __init__(self) -> None:
        self.slider = 1.0
        self.digital_bits = 0
        self._voltages = 0
        self._fractions = [0.0, 0.0]

    @property
    def analog_types(self) -> int:
        """`analog_io_types`: a bit for each input and output, 1 where it is a voltage."""
        return self._voltages << _ANALOG_TYPES_BIT

    def analog(self, number: int) -> float:
        """What an analog output gives, A or V as its type is."""
        lowest, highest = _VOLTAGE_V if self._voltages >> number & 1 else _CURRENT_A
        return lowest + (highest - lowest) * self._fractions[number]

    def write(self, values: Mapping[str, Value]) -> None:
        """Take a client's data package. What its masks leave out stays; a fraction beyond 0 to 1 changes nothing."""
        if _integer(values, "speed_slider_mask") & 1:
            self.slider = _fraction(values, "speed_slider_fraction", self.slider)
        for group, (first, there) in _DIGITAL.items():
            mask = (_integer(values, f"{group}_digital_output_mask") & there) << first
            bits = _integer(values, f"{group}_digital_output") << first
            self.digital_bits = self.digital_bits & ~mask | bits & mask
        mask = _integer(values, "standard_analog_output_mask") & 0b11
        self._voltages = self._voltages & ~mask | _integer(values, "standard_analog_output_type") & mask
        for number, present in enumerate(self._fractions):
            if mask >> number & 1:
                self._fractions[number] = _fraction(values, f"standard_analog_output_{number}", present)


def _integer(values: Mapping[str, Value], name: str) -> int:
    return cast(int, values.get(name, 0))


def _fraction(values: Mapping[str, Value], name: str, otherwise: float) -> float:
    value = cast(float, values.get(name, otherwise))
    return value if 0.0 <= value <= 1.0 else otherwise
