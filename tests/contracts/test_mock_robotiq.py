"""The Robotiq driver on its emulated twin keeps the grippers' promises, in virtual time."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from drivers.core.clock import VirtualClock
from simulator.mocks.robotiq import MockRobotiq, MockRobotiqSettings
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import (
    SCENE,
    FreshGripperContract,
    GripperBench,
    GripperContract,
    calibrated_jaws,
)


def opened(drive: JawsDrive) -> GripperBench:
    settings = MockRobotiqSettings(closed_width_m=SCENE.closed_width_m, open_width_m=0.068)
    clock = VirtualClock()
    gripper = MockRobotiq("gripper", settings, clock, SimpleNamespace(jaws=drive))
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


class TestMockRobotiq(GripperContract):
    feels = False
    count_n = 0.85


class TestFreshMockRobotiq(FreshGripperContract):
    pass
