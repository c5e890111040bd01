"""The mock gripper keeps the grippers' promises, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from drivers.core.clock import VirtualClock
from simulator.mocks.can_gripper import MockCanGripper, MockCanGripperSettings
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import (
    SCENE,
    FreshGripperContract,
    GripperBench,
    GripperContract,
    calibrated_jaws,
)


def opened(drive: JawsDrive) -> GripperBench:
    clock = VirtualClock()
    gripper = MockCanGripper("gripper", MockCanGripperSettings(), clock, SimpleNamespace(jaws=drive))
    return GripperBench(gripper, clock, lambda scene: scene(drive))


@pytest.fixture
def bench() -> Iterator[GripperBench]:
    made = opened(calibrated_jaws())
    yield made
    made.device.close()


@pytest.fixture
def fresh() -> Iterator[GripperBench]:
    made = opened(JawsDrive(SCENE))
    yield made
    made.device.close()


class TestMockGripper(GripperContract):
    pass


class TestFreshMockGripper(FreshGripperContract):
    pass
