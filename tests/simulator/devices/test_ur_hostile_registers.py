"""Whatever a client leaves in the registers, the controller goes on and its arm has a place."""

import math
import random

import numpy as np
import pytest

from simulator.devices.ur_controller.controller import Runtime, Safety
from tests.simulator.devices.ur_desk import Desk, desk

HOSTILE = (0.0, 1e-310, 1e308, -1e308, math.nan, math.inf, -math.inf, -1.0, 100.0)
INTEGERS = (0, 1, 2, 7, -1, 2**31 - 1, -(2**31))
COMMANDS = (*range(75), 254, 255, -1)


def command(one: Desk, dice: random.Random) -> None:
    """A pose or joints, of whose numbers a few are hostile."""
    likely = [*one.controller.arm.pose.tolist(), *one.controller.arm.joints_rad.tolist(), 0.1, 0.5]
    numbers = likely[:6] if dice.random() < 0.5 else likely[6:12]
    numbers += [dice.choice(likely) for _ in range(12)]
    for place in range(len(numbers)):
        if dice.random() < 0.2:
            numbers[place] = dice.choice(HOSTILE)
    flags = [dice.choice(INTEGERS) for _ in range(7)]
    one.write(dice.choice(COMMANDS), numbers, flags=flags)


@pytest.mark.parametrize("seed", range(4))
def test_no_command_ends_the_controller_or_takes_its_arm_to_nowhere(seed: int) -> None:
    dice = random.Random(seed)
    one = desk(plane_m=0.17, unlock_s=0.0)
    controller = one.controller
    with np.errstate(all="ignore"):
        for _ in range(60):
            command(one, dice)
            one.run(dice.choice((1, 3, 20)))
            one.write(0)
            one.run(2)
            assert np.isfinite(controller.arm.joints_rad).all(), one.log
            assert np.isfinite(controller.arm.twist).all(), one.log
            if controller.safety is not Safety.NORMAL:
                controller.unlock()
            if controller.runtime is Runtime.STOPPED:
                controller.start_program(0)
