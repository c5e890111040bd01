"""What can be read from and written to the controller over RTDE: names, types, and where the values are.

Source of names, types and codes: Universal Robots, "Real-Time Data Exchange (RTDE) guide". A name that is not here is
answered with NOT_FOUND.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from simulator.devices.ur_controller.registers import registers
from simulator.devices.ur_controller.rtde import Value
from simulator.physics import arm, rigid

if TYPE_CHECKING:
    from simulator.devices.ur_controller.controller import UrController

POWERED_ON, PROGRAM_RUNNING = 1 << 0, 1 << 1
"""`robot_status_bits`."""


class Output(NamedTuple):
    """A variable that the controller sends.

    Attributes:
        kind: Its type on the wire.
        value: Its value, or what finds it.
    """

    kind: str
    value: Value | Callable[[UrController], Value]


_TABLE: dict[str, Any] = tomllib.loads(Path(__file__).with_name("variables.toml").read_text("utf-8"))

INPUTS: dict[str, str] = {**registers("input"), **_TABLE["inputs"]}
"""Type of each input. `external_force_torque` is taken and changes nothing: no program here can select it."""


def _register(way: str, name: str) -> Callable[[UrController], Value]:
    return (lambda c: c.inputs[name]) if way == "input" else (lambda c: c.outputs[name])


_CONSTANTS = {
    name: Output(row["kind"], tuple(row["value"]) if isinstance(row["value"], list) else row["value"])
    for name, row in _TABLE["constants"].items()
}

OUTPUTS = {
    **_CONSTANTS,
    "timestamp": Output("DOUBLE", lambda c: c.t_s),
    "target_q": Output("VECTOR6D", lambda c: c.arm.joints_rad),
    "target_qd": Output("VECTOR6D", lambda c: c.arm.joint_speeds_rad_s),
    "target_qdd": Output("VECTOR6D", lambda c: c.arm.joint_accelerations_rad_s2),
    "actual_q": Output("VECTOR6D", lambda c: c.arm.joints_rad),
    "actual_qd": Output("VECTOR6D", lambda c: c.arm.joint_speeds_rad_s),
    "actual_TCP_pose": Output("VECTOR6D", lambda c: c.arm.pose),
    "actual_TCP_speed": Output("VECTOR6D", lambda c: c.arm.twist),
    "actual_TCP_force": Output("VECTOR6D", lambda c: c.force),
    "target_TCP_pose": Output("VECTOR6D", lambda c: c.arm.pose),
    "target_TCP_speed": Output("VECTOR6D", lambda c: c.arm.twist),
    "tcp_force_scalar": Output("DOUBLE", lambda c: math.hypot(*c.force[:3])),
    "tcp_offset": Output("VECTOR6D", lambda c: rigid.pose(c.arm.tool)),
    "elbow_position": Output("VECTOR3D", lambda c: arm.elbow(c.arm.joints_rad, c.arm.joint_speeds_rad_s)[0]),
    "elbow_velocity": Output("VECTOR3D", lambda c: arm.elbow(c.arm.joints_rad, c.arm.joint_speeds_rad_s)[1]),
    "ft_raw_wrench": Output("VECTOR6D", lambda c: c.raw_force),
    "payload": Output("DOUBLE", lambda c: c.payload[0]),
    "payload_cog": Output("VECTOR3D", lambda c: c.payload[1:]),
    "safety_mode": Output("INT32", lambda c: int(c.safety)),
    "safety_status": Output("INT32", lambda c: int(c.safety)),
    "safety_status_bits": Output("UINT32", lambda c: c.safety.bits),
    "robot_status_bits": Output(
        "UINT32", lambda c: POWERED_ON | (PROGRAM_RUNNING if c.runtime is c.runtime.PLAYING else 0)
    ),
    "runtime_state": Output("UINT32", lambda c: int(c.runtime)),
    "speed_scaling": Output("DOUBLE", lambda c: c.arm.scaling),
    "target_speed_fraction": Output("DOUBLE", lambda c: c.panel.slider),
    "actual_digital_output_bits": Output("UINT64", lambda c: c.panel.digital_bits),
    "actual_configurable_digital_output_bits": Output("UINT64", lambda c: c.panel.digital_bits >> 8 & 0xFF),
    "analog_io_types": Output("UINT32", lambda c: c.panel.analog_types),
    "standard_analog_output0": Output("DOUBLE", lambda c: c.panel.analog(0)),
    "standard_analog_output1": Output("DOUBLE", lambda c: c.panel.analog(1)),
    **{
        name: Output(kind, _register(way, name))
        for way in ("input", "output")
        for name, kind in registers(way).items()
    },
}
"""What can be read. The arm follows exactly, so that what is actual is the target."""
