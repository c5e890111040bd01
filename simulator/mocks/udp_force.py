"""A force sensor's box on the mock bench: the real driver on its emulated twin."""

from drivers.udp_force.codec import BoxSettings
from drivers.udp_force.driver import UdpForce
from simulator.devices.udp_force import EmulatedUdpForce
from simulator.mocks.base import OverMemory


class MockUdpForce(OverMemory, UdpForce):
    """The real driver in virtual time."""

    _far_end = EmulatedUdpForce

    def _box(self) -> BoxSettings:
        twin: EmulatedUdpForce = self._twin
        return twin.box
