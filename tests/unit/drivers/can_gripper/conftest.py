"""A gripper's driver on an emulated gripper, in virtual time."""

from collections.abc import Callable
from typing import Any

import pytest

from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import CLOSED_M
from tests.unit.drivers.can_gripper.gripper_bench import Bench


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(calibrated=…, …driver's settings)`: its jaws are closed; not yet open."""

    def made(*, calibrated: bool = True, **driver: Any) -> Bench:
        drive = JawsDrive(CLOSED_M)
        if calibrated:
            drive.advance(0.0)
            drive.calibrate()
            drive.advance(3.0)
            drive.restart()
        return Bench(drive, **driver)

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """An open gripper that knows its ends."""
    made = make_bench()
    made.device.open()
    return made
