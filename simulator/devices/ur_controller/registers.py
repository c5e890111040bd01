"""The controller's registers, and how the client's control script uses them."""

from collections.abc import Mapping, MutableMapping, Sequence
from typing import cast

import numpy as np

from simulator.devices.ur_controller.rtde import Value
from simulator.physics.rigid import Array

NUMBERS = 48
"""Integer and double registers each way (RTDE guide)."""

LONE_BITS = range(64, 128)
"""Bit registers that have a name each; the first 64 come in two words (RTDE guide)."""


def registers(way: str) -> dict[str, str]:
    """The registers of one way ("input", "output"): name and type of each."""
    return {
        **{f"{way}_bit_registers{first}_to_{first + 31}": "UINT32" for first in (0, 32)},
        **{f"{way}_bit_register_{number}": "BOOL" for number in LONE_BITS},
        **{f"{way}_int_register_{number}": "INT32" for number in range(NUMBERS)},
        **{f"{way}_double_register_{number}": "DOUBLE" for number in range(NUMBERS)},
    }


IN_I, IN_F, OUT_I, OUT_F = (
    [f"{way}_{kind}_register_{number}" for number in range(24)]
    for way in ("input", "output")
    for kind in ("int", "double")
)
"""Those that the client's script uses: the lower half."""

COMMAND = IN_I[0]


class Registers:
    """Input registers to read, output registers to write.

    Args:
        inputs: By RTDE name.
        outputs: By RTDE name.
    """

    def __init__(self, inputs: Mapping[str, Value], outputs: MutableMapping[str, Value]) -> None:
        self._inputs, self._outputs = inputs, outputs
        self._writes = self._operation = 0

    def i(self, number: int) -> int:
        """An integer input."""
        return cast(int, self._inputs[IN_I[number]])

    def f(self, number: int) -> float:
        """A double input."""
        return cast(float, self._inputs[IN_F[number]])

    def vector(self) -> Array:
        """The first six double inputs."""
        return np.array([self._inputs[name] for name in IN_F[:6]])

    def output(self, number: int, value: int) -> None:
        """Set an integer output."""
        self._outputs[OUT_I[number]] = value

    def report(self, values: Sequence[float] | Array) -> None:
        """The result of a command that has several numbers."""
        for name, value in zip(OUT_F, values, strict=False):
            self._outputs[name] = float(value)

    def progress(self, value: int) -> None:
        """The asynchronous status: bits 0-14 progress, 15 running, 16-22 writes, 24-30 operation."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        running = 0 if value < 0 else 0x8000 + min(value, 0x7FFF)
        self.output(2, self._writes << 16 | self._operation << 24 | running)
