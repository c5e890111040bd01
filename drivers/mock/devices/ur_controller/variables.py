"""What the controller can be asked for and told over RTDE: names, types, and where the values are.

Source of names, types and codes: Universal Robots, "Real-Time Data Exchange (RTDE) guide". A name that is not here is
answered with NOT_FOUND.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from drivers.mock.devices.ur_controller.registers import registers
from drivers.mock.devices.ur_controller.rtde import Value
from drivers.mock.physics import arm, rigid

if TYPE_CHECKING:
    from drivers.mock.devices.ur_controller.controller import UrController

POWERED_ON, PROGRAM_RUNNING = 1 << 0, 1 << 1
"""`robot_status_bits`."""

ROBOT_RUNNING = 7
JOINT_RUNNING = 253
"""`robot_mode`; `joint_mode` and `tool_mode` of an arm that is ready."""


class Output(NamedTuple):
    """A variable that the controller sends.

    Attributes:
        kind: Its type on the wire.
        value: Its value, or what finds it.
    """

    kind: str
    value: Value | Callable[[UrController], Value]


INPUTS = {
    **registers("input"),
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
"""Type of each input. `external_force_torque` is taken and changes nothing: no program here can ask for it."""


def _register(way: str, name: str) -> Callable[[UrController], Value]:
    return (lambda c: c.inputs[name]) if way == "input" else (lambda c: c.outputs[name])


_ZEROS = (0.0,) * 6

_ELECTRICAL = {
    "target_current": Output("VECTOR6D", _ZEROS),
    "target_moment": Output("VECTOR6D", _ZEROS),
    "actual_current": Output("VECTOR6D", _ZEROS),
    "actual_current_window": Output("VECTOR6D", _ZEROS),
    "joint_control_output": Output("VECTOR6D", _ZEROS),
    "joint_temperatures": Output("VECTOR6D", (25.0,) * 6),
    "actual_joint_voltage": Output("VECTOR6D", (48.0,) * 6),
    "actual_main_voltage": Output("DOUBLE", 48.0),
    "actual_robot_voltage": Output("DOUBLE", 48.0),
    "actual_robot_current": Output("DOUBLE", 1.0),
    "actual_momentum": Output("DOUBLE", 0.0),
    "actual_execution_time": Output("DOUBLE", 0.0),
    "joint_position_deviation_ratio": Output("DOUBLE", 0.0),
    "io_current": Output("DOUBLE", 0.0),
    "actual_digital_input_bits": Output("UINT64", 0),
    "actual_configurable_digital_input_bits": Output("UINT64", 0),
    "standard_analog_input0": Output("DOUBLE", 0.0),
    "standard_analog_input1": Output("DOUBLE", 0.0),
    "tool_analog_input_types": Output("UINT32", 0),
    "tool_analog_input0": Output("DOUBLE", 0.0),
    "tool_analog_input1": Output("DOUBLE", 0.0),
    "tool_output_voltage": Output("INT32", 0),
    "tool_output_current": Output("DOUBLE", 0.0),
    "tool_temperature": Output("DOUBLE", 25.0),
    "tool_output_mode": Output("UINT8", 0),
    "tool_digital_output0_mode": Output("UINT8", 1),
    "tool_digital_output1_mode": Output("UINT8", 1),
    "euromap67_input_bits": Output("UINT32", 0),
    "euromap67_output_bits": Output("UINT32", 0),
    "euromap67_24V_voltage": Output("DOUBLE", 0.0),
    "euromap67_24V_current": Output("DOUBLE", 0.0),
    "encoder0_raw": Output("INT32", 0),
    "encoder1_raw": Output("INT32", 0),
}
"""What is wired to nothing, and motors that follow without effort: constants (assumption)."""

OUTPUTS = {
    **_ELECTRICAL,
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
    "actual_tool_accelerometer": Output("VECTOR3D", (0.0, 0.0, -9.81)),
    "payload": Output("DOUBLE", lambda c: c.payload[0]),
    "payload_cog": Output("VECTOR3D", lambda c: c.payload[1:]),
    "payload_inertia": Output("VECTOR6D", _ZEROS),
    "robot_mode": Output("INT32", ROBOT_RUNNING),
    "joint_mode": Output("VECTOR6INT32", (JOINT_RUNNING,) * 6),
    "tool_mode": Output("UINT32", JOINT_RUNNING),
    "safety_mode": Output("INT32", lambda c: int(c.safety)),
    "safety_status": Output("INT32", lambda c: int(c.safety)),
    "safety_status_bits": Output("UINT32", lambda c: c.safety.bits),
    "robot_status_bits": Output(
        "UINT32", lambda c: POWERED_ON | (PROGRAM_RUNNING if c.runtime is c.runtime.PLAYING else 0)
    ),
    "runtime_state": Output("UINT32", lambda c: int(c.runtime)),
    "script_control_line": Output("UINT32", 0),
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
"""What can be asked for. The arm follows exactly, so that what is actual is the target."""
