"""What a controller sends at its primary interface: its state, of which the configuration alone is here."""

import struct

from simulator.devices.ur_controller.controller import UrController
from simulator.devices.ur_controller.session import ScriptSession
from simulator.physics import arm

EVERY_STEPS = 50
"""Ten times a second (client interface manual)."""

ROBOT_STATE, CONFIGURATION = 16, 6
"""Type of a package, and of a part of it (client interface manual)."""

ACCELERATION_RAD_S2 = 40.0
"""Greatest acceleration of a joint that it reports (assumption)."""

USUAL = (1.05, 1.4, 0.25, 1.2, 0.0)
"""Usual speed and acceleration of joints and of the tool, and a radius (script manual; the radius an assumption)."""


def _package(kind: int, content: bytes) -> bytes:
    return struct.pack(">IB", 5 + len(content), kind) + content


def state() -> bytes:
    """What the arm's joints can do: limits in rad, speeds in rad/s, accelerations in rad/s^2, dimensions in m."""
    limits = (-arm.JOINT_LIMIT_RAD, arm.JOINT_LIMIT_RAD) * arm.JOINTS
    speeds = (arm.JOINT_SPEED_RAD_S, ACCELERATION_RAD_S2) * arm.JOINTS
    a, d, alpha = zip(*arm.DH, strict=True)
    numbers = (*limits, *speeds, *USUAL, *a, *d, *alpha, *[0.0] * arm.JOINTS)
    return _package(ROBOT_STATE, _package(CONFIGURATION, struct.pack(">53d4i", *numbers, 0, 2, 1, 5)))


class PrimarySession(ScriptSession):
    """One client's connection to the primary interface: programs in, states out."""

    def __init__(self, controller: UrController) -> None:
        super().__init__(controller)
        self._steps = 0

    def step(self) -> bytes:
        """The state where it is due in this cycle, or nothing."""
        self._steps += 1
        return state() if self._steps % EVERY_STEPS == 0 else b""
