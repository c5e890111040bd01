"""A gripper's driver on an emulated gripper, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from drivers.can_gripper.brackets import CanGripperSettings
from simulator.devices.can_gripper import EmulatedCanGripper, EmulatedCanGripperSettings
from simulator.physics.jaws import GripObject, JawsSettings
from simulator.physics.jaws_drive import JawsDrive
from tests.unit.drivers.can_gripper.gripper_bench import Bench, Host

BEGIN_S = 5000.0
"""Monotonic time at which the bench begins: the host has been up for a while."""

SCENE = JawsSettings(closed_width_m=0.010, objects={"mug": GripObject(width_m=0.040)})


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(calibrated=…, …driver's settings)`; not yet open."""

    def made(*, calibrated: bool = True, **driver: Any) -> Bench:
        drive = JawsDrive(SCENE)
        if calibrated:
            drive.advance(0.0)
            drive.calibrate()
            drive.advance(3.0)
            drive.restart()
        host = Host(EmulatedCanGripper(EmulatedCanGripperSettings(), drive), BEGIN_S)
        settings = {"port": "can0", "closed_width_m": SCENE.closed_width_m, **driver}
        return Bench(host, drive, CanGripperSettings(**settings))

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """An open gripper that knows its ends."""
    made = make_bench()
    made.open()
    return made
