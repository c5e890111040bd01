"""A desk at the emulated controller: writes registers and watches the answers, in virtual time."""

import math
from collections.abc import Sequence

import numpy as np
import pytest

from simulator.devices.ur_controller.controller import Runtime, UrController, UrControllerSettings
from simulator.physics.arm_motion import StiffPlane

READY, DONE = 1, 2


class Desk:
    """Writes registers and watches the answer, as the client does.

    Args:
        controller: A fresh one; its program is started.
    """

    def __init__(self, controller: UrController) -> None:
        self.controller = controller
        controller.start_program(0)
        self.run(2)

    def run(self, steps: int) -> None:
        for _ in range(steps):
            self.controller.step()

    def write(
        self, command: int, numbers: Sequence[float] = (), flag: int = 0, flags: Sequence[int] = ()
    ) -> None:
        values: dict[str, float] = {f"input_double_register_{i}": float(v) for i, v in enumerate(numbers)}
        values.update({f"input_int_register_{i}": v for i, v in enumerate([command, *(flags or [flag])])})
        self.controller.write_inputs(values)

    def call(self, command: int, numbers: Sequence[float] = (), flag: int = 0, steps: int = 5000) -> int:
        """A blocking command; how many cycles it took."""
        self.write(command, numbers, flag)
        for step in range(steps):
            self.controller.step()
            if self.controller.runtime is Runtime.STOPPED:
                pytest.fail(f"the program stopped: {self.controller.log}")
            if self.controller.outputs["output_int_register_0"] == DONE:
                self.write(0)
                self.run(2)
                assert self.controller.outputs["output_int_register_0"] == READY
                return step + 1
        pytest.fail("the command is never done")

    def vector(self) -> list[float]:
        return [float(self.controller.outputs[f"output_double_register_{i}"]) for i in range(6)]  # type: ignore[arg-type]

    @property
    def pose(self) -> np.ndarray:
        return self.controller.arm.pose

    @property
    def log(self) -> str:
        return " | ".join(self.controller.log)

    @property
    def progress(self) -> int:
        value = self.controller.outputs["output_int_register_2"]
        assert isinstance(value, int)
        return value


def desk(plane_m: float = -math.inf, **settings: object) -> Desk:
    """A quiet controller in front of a plane, with its program running."""
    quiet = {"force_noise_n": 0.0, "torque_noise_n_m": 0.0, "unlock_s": 0.1, **settings}
    return Desk(UrController(UrControllerSettings.model_validate(quiet), StiffPlane(height_m=plane_m)))


def down(desk: Desk, by_m: float) -> list[float]:
    return [*desk.pose[:2], desk.pose[2] - by_m, *desk.pose[3:]]
