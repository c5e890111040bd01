"""A Robotiq gripper of the mock bench: the real driver on its emulated twin."""

from drivers.robotiq.driver import Robotiq
from simulator.devices.robotiq import EmulatedRobotiq
from simulator.mocks.base import OverMemory


class MockRobotiq(OverMemory, Robotiq):
    """Moves the bench's jaws through the real gripper's counts."""

    _far_end = EmulatedRobotiq
