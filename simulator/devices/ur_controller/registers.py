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


class Registers:
    """Input registers to read, output registers to write, from a first one on.

    Args:
        inputs: By RTDE name.
        outputs: By RTDE name.
        offset: Number of the first: 0 or 24.
    """

    def __init__(self, inputs: Mapping[str, Value], outputs: MutableMapping[str, Value], offset: int) -> None:
        self._inputs, self._outputs = inputs, outputs
        numbers = range(offset, offset + 24)
        self.command = f"input_int_register_{offset}"
        self._in_i = [f"input_int_register_{number}" for number in numbers]
        self._in_f = [f"input_double_register_{number}" for number in numbers]
        self._out_i = [f"output_int_register_{number}" for number in numbers]
        self._out_f = [f"output_double_register_{number}" for number in numbers]
        self._writes = self._operation = 0

    def i(self, number: int) -> int:
        """An integer input."""
        return cast(int, self._inputs[self._in_i[number]])

    def f(self, number: int) -> float:
        """A double input."""
        return cast(float, self._inputs[self._in_f[number]])

    def vector(self, first: int = 0) -> Array:
        """Six double inputs."""
        return np.array([self._inputs[name] for name in self._in_f[first : first + 6]])

    def output(self, number: int, value: int) -> None:
        """Set an integer output."""
        self._outputs[self._out_i[number]] = value

    def answer(self, value: int) -> None:
        """The integer result of a command."""
        self.output(1, int(value))

    def report(self, values: Sequence[float] | Array) -> None:
        """The result of a command that has several numbers."""
        for name, value in zip(self._out_f, values, strict=False):
            self._outputs[name] = float(value)

    def progress(self, value: int) -> None:
        """The asynchronous status: bits 0-14 progress, 15 running, 16-22 writes, 24-30 operation."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        running = 0 if value < 0 else 0x8000 + min(value, 0x7FFF)
        self.output(2, self._writes << 16 | self._operation << 24 | running)
