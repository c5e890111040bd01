"""One client's RTDE connection: bytes in, bytes out."""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise

from drivers.mock.devices.ur_controller import rtde
from drivers.mock.devices.ur_controller.controller import UrController
from drivers.mock.devices.ur_controller.rtde import Kind, Recipe, Value
from drivers.mock.devices.ur_controller.script import STEP_S

POWERED_ON, PROGRAM_RUNNING = 1 << 0, 1 << 1
"""`robot_status_bits` (RTDE guide)."""

ROBOT_RUNNING = 7
JOINT_RUNNING = 253
"""`robot_mode` and `joint_mode` of an arm that is ready (RTDE guide)."""

_INPUT_TYPES = {
    "speed_slider_mask": "UINT32",
    "speed_slider_fraction": "DOUBLE",
    "standard_digital_output_mask": "UINT8",
    "standard_digital_output": "UINT8",
    "configurable_digital_output_mask": "UINT8",
    "configurable_digital_output": "UINT8",
    "tool_digital_output_mask": "UINT8",
    "tool_digital_output": "UINT8",
    "standard_analog_output_mask": "UINT8",
    "standard_analog_output_type": "UINT8",
    "standard_analog_output_0": "DOUBLE",
    "standard_analog_output_1": "DOUBLE",
    "external_force_torque": "VECTOR6D",
}
"""Inputs that are no registers (RTDE guide). They are taken and change nothing."""

Getter = Callable[[UrController], Value]


def _always(value: Value) -> Getter:
    return lambda _: value


_OUTPUTS: dict[str, tuple[str, Getter]] = {
    "timestamp": ("DOUBLE", lambda c: c.t_s),
    "target_q": ("VECTOR6D", lambda c: c.arm.joints_rad),
    "target_qd": ("VECTOR6D", lambda c: c.arm.joint_speeds_rad_s),
    "target_qdd": ("VECTOR6D", _always((0.0,) * 6)),
    "target_current": ("VECTOR6D", _always((0.0,) * 6)),
    "target_moment": ("VECTOR6D", _always((0.0,) * 6)),
    "actual_q": ("VECTOR6D", lambda c: c.arm.joints_rad),
    "actual_qd": ("VECTOR6D", lambda c: c.arm.joint_speeds_rad_s),
    "actual_current": ("VECTOR6D", _always((0.0,) * 6)),
    "joint_control_output": ("VECTOR6D", _always((0.0,) * 6)),
    "actual_TCP_pose": ("VECTOR6D", lambda c: c.arm.pose),
    "actual_TCP_speed": ("VECTOR6D", lambda c: c.arm.twist),
    "actual_TCP_force": ("VECTOR6D", lambda c: c.force),
    "target_TCP_pose": ("VECTOR6D", lambda c: c.arm.pose),
    "target_TCP_speed": ("VECTOR6D", lambda c: c.arm.twist),
    "actual_digital_input_bits": ("UINT64", _always(0)),
    "joint_temperatures": ("VECTOR6D", _always((25.0,) * 6)),
    "actual_execution_time": ("DOUBLE", _always(0.0)),
    "robot_mode": ("INT32", _always(ROBOT_RUNNING)),
    "joint_mode": ("VECTOR6INT32", _always((JOINT_RUNNING,) * 6)),
    "safety_mode": ("INT32", lambda c: int(c.safety)),
    "actual_tool_accelerometer": ("VECTOR3D", _always((0.0, 0.0, -9.81))),
    "speed_scaling": ("DOUBLE", _always(1.0)),
    "target_speed_fraction": ("DOUBLE", _always(1.0)),
    "actual_momentum": ("DOUBLE", _always(0.0)),
    "actual_main_voltage": ("DOUBLE", _always(48.0)),
    "actual_robot_voltage": ("DOUBLE", _always(48.0)),
    "actual_robot_current": ("DOUBLE", _always(1.0)),
    "actual_joint_voltage": ("VECTOR6D", _always((48.0,) * 6)),
    "actual_digital_output_bits": ("UINT64", _always(0)),
    "runtime_state": ("UINT32", lambda c: int(c.runtime)),
    "standard_analog_input0": ("DOUBLE", _always(0.0)),
    "standard_analog_input1": ("DOUBLE", _always(0.0)),
    "standard_analog_output0": ("DOUBLE", _always(0.0)),
    "standard_analog_output1": ("DOUBLE", _always(0.0)),
    "robot_status_bits": (
        "UINT32",
        lambda c: POWERED_ON | (PROGRAM_RUNNING if c.runtime is c.runtime.PLAYING else 0),
    ),
    "safety_status_bits": ("UINT32", lambda c: c.safety.bits),
    "ft_raw_wrench": ("VECTOR6D", lambda c: c.raw_force),
    "payload": ("DOUBLE", lambda c: c.payload[0]),
    "payload_cog": ("VECTOR3D", lambda c: c.payload[1:]),
    "payload_inertia": ("VECTOR6D", _always((0.0,) * 6)),
}
"""Outputs that are no registers: type and value. Electrical ones are constants (assumption)."""


class RtdeSession:
    """What one connection has agreed on with the controller.

    Args:
        controller: Whose variables it reads and writes.
        taken: Names of the inputs that have a writer, shared by all sessions: each has at most one.

    Attributes:
        streaming: Whether data packages go out.
        writes: Whether this client has set up any input: the control interface has, the receive one has not.
    """

    def __init__(self, controller: UrController, taken: set[str]) -> None:
        self.streaming = False
        self._controller = controller
        self._taken = taken
        self._own: set[str] = set()
        self._buffer = bytearray()
        self._inputs: list[Recipe] = []
        self._outputs: Recipe | None = None
        self._getters: list[Getter] = []
        self._every_steps = 1
        self._steps = 0

    @property
    def writes(self) -> bool:
        """Whether this client has set up any input."""
        return bool(self._inputs)

    def feed(self, data: bytes) -> bytes:
        """Take bytes, answer with bytes.

        Raises:
            PackageError: these are no RTDE packages.
        """
        self._buffer += data
        return b"".join(self._handle(kind, body) for kind, body in rtde.take(self._buffer))

    def step(self) -> bytes:
        """The data package of this cycle, or nothing."""
        self._steps += 1
        if not self.streaming or self._outputs is None or self._steps % self._every_steps:
            return b""
        return self._outputs.encode([getter(self._controller) for getter in self._getters])

    def close(self) -> None:
        """Give the inputs back."""
        self._taken -= self._own

    def _handle(self, kind: int, body: bytes) -> bytes:
        match kind:
            case Kind.PROTOCOL:
                version = int.from_bytes(body, "big")
                return rtde.accepted(Kind.PROTOCOL, version == rtde.PROTOCOL_VERSION)
            case Kind.CONTROLLER:
                version_numbers = [int(part) for part in self._controller.settings.version.split(".")]
                return rtde.version_reply(version_numbers)
            case Kind.OUTPUTS:
                return self._set_up_outputs(body)
            case Kind.INPUTS:
                return self._set_up_inputs(rtde.names(body))
            case Kind.START | Kind.PAUSE:
                self.streaming = kind == Kind.START and self._outputs is not None
                return rtde.accepted(Kind(kind), kind == Kind.PAUSE or self.streaming)
            case Kind.DATA:
                self._take(body)
        return b""

    def _set_up_outputs(self, body: bytes) -> bytes:
        rate_hz, names = rtde.outputs_request(body)
        found = [_output(name) for name in names]
        types = [kind for kind, _ in found]
        if rtde.NOT_FOUND not in types and rate_hz > 0.0:
            self._outputs = Recipe(1, names, types)
            self._getters = [getter for _, getter in found]
            self._every_steps = max(1, round(1.0 / (rate_hz * STEP_S)))
        return rtde.setup_reply(Kind.OUTPUTS, 1, types)

    def _set_up_inputs(self, names: list[str]) -> bytes:
        types = [self._input_type(name) for name in names]
        if rtde.NOT_FOUND in types or rtde.IN_USE in types:
            return rtde.setup_reply(Kind.INPUTS, 0, types)
        self._own.update(names)
        self._taken.update(names)
        self._inputs.append(Recipe(len(self._inputs) + 1, names, types))
        return rtde.setup_reply(Kind.INPUTS, len(self._inputs), types)

    def _input_type(self, name: str) -> str:
        if name in self._taken - self._own:
            return rtde.IN_USE
        if name in self._controller.inputs:
            return "INT32" if "_int_" in name else "DOUBLE"
        return _INPUT_TYPES.get(name, rtde.NOT_FOUND)

    def _take(self, body: bytes) -> None:
        """A package that does not fit its recipe is dropped: the client that sent it waits in vain."""
        number = body[0] if body else 0
        if not 1 <= number <= len(self._inputs):
            self._controller.log.append(f"data for recipe {number}, which does not exist")
            return
        try:
            self._controller.write_inputs(self._inputs[number - 1].decode(body))
        except rtde.PackageError as error:
            self._controller.log.append(str(error))


def _output(name: str) -> tuple[str, Getter]:
    kind, _, number = name.rpartition("_register_")
    if number.isdigit() and kind in ("output_int", "output_double"):
        return ("INT32" if kind == "output_int" else "DOUBLE"), lambda c: c.outputs[name]
    return _OUTPUTS.get(name, (rtde.NOT_FOUND, _always(0)))


class ScriptSession:
    """One client's connection to the script port: programs in, nothing out.

    Args:
        controller: Who runs them.
    """

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._text = bytearray()

    def feed(self, data: bytes) -> bytes:
        """Take a piece of a program, and start the program when its last line is there."""
        self._text += data
        while (size := _program_size(self._text)) is not None:
            lines = self._text[:size].decode("utf-8", "replace").splitlines()
            del self._text[:size]
            self._start(lines)
        return b""

    def close(self) -> None:
        """Nothing to give back."""

    def _start(self, lines: list[str]) -> None:
        # The client writes the offset at the head of the line that follows the one which asks for it.
        heads = [after for line, after in pairwise(lines) if line.endswith("# int register offset")]
        digits = heads[0].split()[0] if heads and heads[0].split() else ""
        if lines[0] != "def rtde_control():" or digits not in ("0", "24"):
            self._controller.log.append(f"program not emulated: {lines[0][:60]!r}")
            return
        self._controller.start_program(int(digits))


def _program_size(text: bytearray) -> int | None:
    """Bytes up to and with the line that ends the first program: `end` at the margin."""
    end = text.find(b"\nend\n")
    return None if end < 0 else end + len(b"\nend\n")
