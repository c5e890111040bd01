"""A Robotiq gripper of the mock bench: the real driver on its emulated twin."""

from drivers.robotiq.driver import Robotiq
from drivers.robotiq.settings import RobotiqSettings
from simulator.devices.robotiq import EmulatedRobotiq
from simulator.mocks.base import OverMemory


class MockRobotiqSettings(RobotiqSettings):
    """The simulated gripper; its widths are the plant's."""

    port: str = "mock"


class MockRobotiq(OverMemory, Robotiq):
    """Moves the bench's jaws through the real gripper's counts."""

    _far_end = EmulatedRobotiq
