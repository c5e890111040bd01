"""What a controller sends at its primary and secondary interface: its version once, then its state."""

import struct

from simulator.devices.ur_controller.controller import Runtime, Safety, UrController
from simulator.devices.ur_controller.session import ScriptSession
from simulator.physics import arm, rigid

EVERY_STEPS = 50
"""Ten times a second (client interface manual)."""

ROBOT_STATE, MESSAGE, VERSION = 16, 20, 3
"""Types of packages, and of the message (client interface manual)."""

ACCELERATION_RAD_S2 = 40.0
"""Greatest acceleration of a joint that it reports (assumption)."""

USUAL = (1.05, 1.4, 0.25, 1.2, 0.0)
"""Usual speed and acceleration of joints and of the tool, and a radius (script manual; the radius an assumption)."""


def _package(kind: int, content: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(content), kind) + content


def greeting(controller: UrController) -> bytes:
    """The message with its version."""
    name = b"URControl"
    major, minor, fix, *build = (int(part) for part in controller.settings.version.split("."))
    head = struct.pack(">QbbB", int(controller.t_s * 1e6), -2, VERSION, len(name))
    return _package(MESSAGE, head + name + struct.pack(">BBii", major, minor, fix, *(build or [0])))


def state(controller: UrController) -> bytes:
    """Mode, joints, tool and configuration."""
    return _package(
        ROBOT_STATE,
        b"".join(
            _package(kind, content(controller))
            for kind, content in ((0, _mode), (1, _joints), (4, _tool), (6, _configuration))
        ),
    )


def _mode(controller: UrController) -> bytes:
    safety = controller.safety
    flags = (True, True, True, safety is Safety.EMERGENCY_STOP, safety is Safety.PROTECTIVE_STOP)
    playing = controller.runtime is Runtime.PLAYING
    speeds = (controller.panel.slider, controller.arm.scaling, 1.0)
    return struct.pack(">Q7?BB3dB", int(controller.t_s * 1e6), *flags, playing, False, 7, 0, *speeds, 0)


def _joints(controller: UrController) -> bytes:
    moving = zip(controller.arm.joints_rad, controller.arm.joint_speeds_rad_s, strict=True)
    return b"".join(struct.pack(">3d4fB", q, q, qd, 0.0, 48.0, 30.0, 30.0, 253) for q, qd in moving)


def _tool(controller: UrController) -> bytes:
    return struct.pack(">12d", *controller.arm.pose, *rigid.pose(controller.arm.tool))


def _configuration(controller: UrController) -> bytes:
    limits = (-arm.JOINT_LIMIT_RAD, arm.JOINT_LIMIT_RAD) * arm.JOINTS
    speeds = (arm.JOINT_SPEED_RAD_S, ACCELERATION_RAD_S2) * arm.JOINTS
    a, d, alpha = zip(*arm.DH, strict=True)
    return struct.pack(">53d4i", *limits, *speeds, *USUAL, *a, *d, *alpha, *[0.0] * arm.JOINTS, 0, 2, 1, 5)


class PrimarySession(ScriptSession):
    """One client's connection to the primary or secondary interface: programs in, states out."""

    def __init__(self, controller: UrController) -> None:
        super().__init__(controller)
        self._steps = 0

    def step(self) -> bytes:
        """The state where it is due in this cycle, or nothing."""
        self._steps += 1
        return state(self._controller) if self._steps % EVERY_STEPS == 0 else b""
