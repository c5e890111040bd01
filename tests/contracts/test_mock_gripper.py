"""The mock gripper, and the Robotiq driver on its emulated twin, keep the grippers' promises, in virtual time."""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from drivers.core.clock import VirtualClock
from drivers.robotiq.settings import RobotiqSettings
from simulator.mocks.can_gripper import MockCanGripper, MockCanGripperSettings
from simulator.mocks.robotiq import MockRobotiq
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import (
    CLOSED_M,
    FreshGripperContract,
    GripperBench,
    GripperContract,
    calibrated_jaws,
)


def can_gripper(clock: VirtualClock, drive: JawsDrive) -> MockCanGripper:
    return MockCanGripper("gripper", MockCanGripperSettings(), clock, SimpleNamespace(jaws=drive))


def robotiq(clock: VirtualClock, drive: JawsDrive) -> MockRobotiq:
    settings = RobotiqSettings(port="mock", closed_width_m=CLOSED_M, open_width_m=0.068)
    return MockRobotiq("gripper", settings, clock, SimpleNamespace(jaws=drive))


def opened(request: pytest.FixtureRequest, drive: JawsDrive) -> Iterator[GripperBench]:
    clock = VirtualClock()
    made = GripperBench(request.cls.make(clock, drive), clock, lambda scene: scene(drive))
    yield made
    made.device.close()


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Iterator[GripperBench]:
    yield from opened(request, calibrated_jaws())


@pytest.fixture
def fresh(request: pytest.FixtureRequest) -> Iterator[GripperBench]:
    yield from opened(request, JawsDrive(CLOSED_M))


class TestMockGripper(GripperContract):
    make = staticmethod(can_gripper)


class TestFreshMockGripper(FreshGripperContract):
    make = staticmethod(can_gripper)


class TestMockRobotiq(GripperContract):
    make = staticmethod(robotiq)
    feels = False
    count_n = 0.85


class TestFreshMockRobotiq(FreshGripperContract):
    make = staticmethod(robotiq)
