"""One client's connection, bytes in, bytes out: RTDE with its variables, script, dashboard."""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

from simulator.devices.ur_controller import rtde
from simulator.devices.ur_controller.controller import Runtime, Safety, UrController
from simulator.devices.ur_controller.registers import registers
from simulator.devices.ur_controller.rtde import PackageError, PackageKind, Recipe, Value
from simulator.devices.ur_controller.script import STEP_S
from simulator.physics import arm, rigid

SLOWEST_HZ, FASTEST_HZ = 1.0, 500.0
"""Rates of the stream on an e-Series; requests beyond are clipped to them (RTDE guide)."""

OUTPUT_RECIPE = 1
"""Id of the one recipe of outputs that a client has (RTDE guide); 0 means none."""

PROGRAM_BYTES = 1 << 20
"""Longest program (assumption: twenty times the client's)."""

Piece = bytes | Callable[[UrController], bytes]


class RtdeSession:
    """What one connection has agreed on with the controller.

    Args:
        taken: Names of the inputs that have a writer, shared by all sessions: each has at most one.

    Attributes:
        writes: Whether this client has set up any input: the control interface has, the receive one has not.
    """

    def __init__(self, controller: UrController, taken: set[str]) -> None:
        self.streaming = False
        self._controller = controller
        self._taken = taken
        self._own: set[str] = set()
        self._buffer = bytearray()
        self._inputs: list[Recipe] = []
        self._outputs: list[Piece] = []
        self._every_steps = 1
        self._steps = 0

    @property
    def writes(self) -> bool:
        """Whether this client has set up any input."""
        return bool(self._inputs)

    def feed(self, data: bytes) -> bytes:
        """Take bytes, answer with bytes.

        Raises:
            PackageError: these are no RTDE packages, or none that can be answered.
        """
        self._buffer += data
        return b"".join(self._handle(kind, body) for kind, body in rtde.take(self._buffer))

    def step(self) -> bytes:
        """The data package of this cycle, or nothing."""
        self._steps += 1
        if not self.streaming or self._steps % self._every_steps:
            return b""
        body = [piece if isinstance(piece, bytes) else piece(self._controller) for piece in self._outputs]
        return rtde.encode(PackageKind.DATA, b"".join(body))

    def close(self) -> None:
        """Give the inputs back."""
        self._taken -= self._own

    def _handle(self, kind: int, body: bytes) -> bytes:
        match kind:
            case PackageKind.PROTOCOL:
                version = int.from_bytes(body, "big")
                return rtde.accepted(PackageKind.PROTOCOL, version == rtde.PROTOCOL_VERSION)
            case PackageKind.CONTROLLER:
                version_numbers = [int(part) for part in self._controller.settings.version.split(".")]
                return rtde.version_reply(version_numbers)
            case PackageKind.OUTPUTS:
                return self._set_up_outputs(body)
            case PackageKind.INPUTS:
                return self._set_up_inputs(rtde.names(body))
            case PackageKind.START | PackageKind.PAUSE:
                self.streaming = kind == PackageKind.START and bool(self._outputs)
                return rtde.accepted(PackageKind(kind), kind == PackageKind.PAUSE or self.streaming)
            case PackageKind.DATA:
                self._take(body)
        return b""

    def _set_up_outputs(self, body: bytes) -> bytes:
        rate_hz, names = rtde.outputs_request(body)
        types = [OUTPUTS[name][0] if name in OUTPUTS else rtde.NOT_FOUND for name in names]
        if rtde.NOT_FOUND in types or 1 + rtde.size(types) > rtde.LARGEST_BODY:
            return rtde.setup_reply(PackageKind.OUTPUTS, 0, types)
        self._outputs = [bytes([OUTPUT_RECIPE]), *(_piece(OUTPUTS[name]) for name in names)]
        self._every_steps = round(1.0 / (min(max(rate_hz, SLOWEST_HZ), FASTEST_HZ) * STEP_S))
        return rtde.setup_reply(PackageKind.OUTPUTS, OUTPUT_RECIPE, types)

    def _set_up_inputs(self, names: list[str]) -> bytes:
        types = [self._input_type(name) for name in names]
        if rtde.NOT_FOUND in types or rtde.IN_USE in types or len(self._inputs) == rtde.RECIPES:
            return rtde.setup_reply(PackageKind.INPUTS, 0, types)
        self._own.update(names)
        self._taken.update(names)
        self._inputs.append(Recipe(len(self._inputs) + 1, names, types))
        return rtde.setup_reply(PackageKind.INPUTS, len(self._inputs), types)

    def _input_type(self, name: str) -> str:
        return rtde.IN_USE if name in self._taken - self._own else INPUTS.get(name, rtde.NOT_FOUND)

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


def _piece(output: Output) -> Piece:
    pack, value = rtde.packer(output[0]), output[1]
    if not callable(value):
        return pack(value)
    return lambda controller: pack(value(controller))


_END = b"\nend\n"
"""The line that ends a program: `end` at the margin."""


class ScriptSession:
    """One client's connection to the script port: programs in, nothing out."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._text = bytearray()

    def feed(self, data: bytes) -> bytes:
        """Take a piece of a program, and start the program when its last line is there.

        Raises:
            PackageError: longer than a program may be.
        """
        looked = max(0, len(self._text) - len(_END))
        self._text += data
        while (end := self._text.find(_END, looked)) >= 0:
            lines = self._text[: end + len(_END)].decode("utf-8", "replace").splitlines()
            del self._text[: end + len(_END)]
            looked = 0
            self._start(lines)
        if len(self._text) > PROGRAM_BYTES:
            raise rtde.PackageError(f"a program of more than {PROGRAM_BYTES} bytes")
        return b""

    def close(self) -> None:
        """Nothing to give back."""

    def _start(self, lines: list[str]) -> None:
        # The client writes the offset at the head of the line after the one that requests it.
        heads = [after for line, after in pairwise(lines) if line.endswith("# int register offset")]
        digits = heads[0].split()[0] if heads and heads[0].split() else ""
        if lines[0] != "def rtde_control():" or digits not in ("0", "24"):
            self._controller.log.append(
                f"program refused: {lines[0][:60]!r} is not the client's control script"
            )
            return
        self._controller.start_program(int(digits))


POWERED_ON, PROGRAM_RUNNING = 1 << 0, 1 << 1
"""`robot_status_bits`."""


Output = tuple[str, Value | Callable[[UrController], Value]]
"""A variable that the controller sends: its type on the wire, and its value or what finds it."""

_TABLE: dict[str, Any] = tomllib.loads(Path(__file__).with_name("variables.toml").read_text("utf-8"))

INPUTS: dict[str, str] = {**registers("input"), **_TABLE["inputs"]}
"""Type of each input. `external_force_torque` is taken and changes nothing: no program here can select it."""


def _register(way: str, name: str) -> Callable[[UrController], Value]:
    return (lambda c: c.inputs[name]) if way == "input" else (lambda c: c.outputs[name])


_CONSTANTS: dict[str, Output] = {
    name: (row["kind"], tuple(row["value"]) if isinstance(row["value"], list) else row["value"])
    for name, row in _TABLE["constants"].items()
}

OUTPUTS: dict[str, Output] = {
    **_CONSTANTS,
    "timestamp": ("DOUBLE", lambda c: c.t_s),
    "target_q": ("VECTOR6D", lambda c: c.arm.joints_rad),
    "target_qd": ("VECTOR6D", lambda c: c.arm.joint_speeds_rad_s),
    "target_qdd": ("VECTOR6D", lambda c: c.arm.joint_accelerations_rad_s2),
    "actual_q": ("VECTOR6D", lambda c: c.arm.joints_rad),
    "actual_qd": ("VECTOR6D", lambda c: c.arm.joint_speeds_rad_s),
    "actual_TCP_pose": ("VECTOR6D", lambda c: c.arm.pose),
    "actual_TCP_speed": ("VECTOR6D", lambda c: c.arm.twist),
    "actual_TCP_force": ("VECTOR6D", lambda c: c.force),
    "target_TCP_pose": ("VECTOR6D", lambda c: c.arm.pose),
    "target_TCP_speed": ("VECTOR6D", lambda c: c.arm.twist),
    "tcp_force_scalar": ("DOUBLE", lambda c: math.hypot(*c.force[:3])),
    "tcp_offset": ("VECTOR6D", lambda c: rigid.pose(c.arm.tool)),
    "elbow_position": ("VECTOR3D", lambda c: arm.elbow(c.arm.joints_rad, c.arm.joint_speeds_rad_s)[0]),
    "elbow_velocity": ("VECTOR3D", lambda c: arm.elbow(c.arm.joints_rad, c.arm.joint_speeds_rad_s)[1]),
    "ft_raw_wrench": ("VECTOR6D", lambda c: c.raw_force),
    "payload": ("DOUBLE", lambda c: c.payload[0]),
    "payload_cog": ("VECTOR3D", lambda c: c.payload[1:]),
    "safety_mode": ("INT32", lambda c: int(c.safety)),
    "safety_status": ("INT32", lambda c: int(c.safety)),
    "safety_status_bits": ("UINT32", lambda c: c.safety.bits),
    "robot_status_bits": (
        "UINT32",
        lambda c: POWERED_ON | (PROGRAM_RUNNING if c.runtime is c.runtime.PLAYING else 0),
    ),
    "runtime_state": ("UINT32", lambda c: int(c.runtime)),
    "speed_scaling": ("DOUBLE", lambda c: c.arm.scaling),
    "target_speed_fraction": ("DOUBLE", lambda c: c.panel.slider),
    "actual_digital_output_bits": ("UINT64", lambda c: c.panel.digital_bits),
    "actual_configurable_digital_output_bits": ("UINT64", lambda c: c.panel.digital_bits >> 8 & 0xFF),
    "analog_io_types": ("UINT32", lambda c: c.panel.analog_types),
    "standard_analog_output0": ("DOUBLE", lambda c: c.panel.analog(0)),
    "standard_analog_output1": ("DOUBLE", lambda c: c.panel.analog(1)),
    **{
        name: (kind, _register(way, name))
        for way in ("input", "output")
        for name, kind in registers(way).items()
    },
}
"""What can be read. The arm follows exactly, so that what is actual is the target."""


GREETING = b"Connected: Universal Robots Dashboard Server\n"

LINE_BYTES = 1024
"""Longest line that it reads (assumption: a command and a path)."""

TOO_EARLY = "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop"


def _stop(controller: UrController) -> str:
    controller.stop_program("dashboard")
    return "Stopped"


def _unlock(controller: UrController) -> str:
    free = controller.safety is Safety.NORMAL or controller.unlock()
    return "Protective stop releasing" if free else TOO_EARLY


def _playing(controller: UrController) -> bool:
    return controller.runtime is Runtime.PLAYING


_ANSWERS: dict[str, Callable[[UrController], str]] = {
    "polyscopeversion": lambda c: f"URSoftware {c.settings.version} (Sep 30 2021)",
    "get serial number": lambda c: c.settings.serial,
    "get robot model": lambda c: "UR5",
    "is in remote control": lambda c: str(c.remote).lower(),
    "robotmode": lambda c: "Robotmode: RUNNING",
    "safetystatus": lambda c: f"Safetystatus: {c.safety.name}",
    "running": lambda c: f"Program running: {str(_playing(c)).lower()}",
    "programstate": lambda c: f"{'PLAYING' if _playing(c) else 'STOPPED'} <unnamed>",
    "stop": _stop,
    "unlock protective stop": _unlock,
    "close safety popup": lambda c: "closing safety popup",
    "popup": lambda c: "showing popup",
    "power on": lambda c: "Powering on",
    "brake release": lambda c: "Brake releasing",
    "close popup": lambda c: "closing popup",
    "play": lambda c: "Failed to execute: play",
    "pause": lambda c: "Failed to execute: pause",
    "quit": lambda c: "Disconnected",
}


class DashboardSession:
    """One client's connection to the dashboard."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._buffer = b""

    def feed(self, data: bytes) -> bytes:
        """Take bytes, answer each whole line with a line.

        Raises:
            PackageError: longer than a line may be.
        """
        *lines, rest = (self._buffer + data).split(b"\n")
        if max(map(len, [*lines, rest])) > LINE_BYTES:
            raise PackageError(f"a line of more than {LINE_BYTES} bytes")
        self._buffer = rest
        return b"".join(
            self._answer(line.decode("utf-8", "replace").strip()).encode() + b"\n" for line in lines
        )

    def close(self) -> None:
        """Nothing to give back."""

    def _answer(self, line: str) -> str:
        said = line.lower()
        answer = _ANSWERS["popup"] if said.startswith("popup ") else _ANSWERS.get(said)
        return f'could not understand: "{line}"' if answer is None else answer(self._controller)
