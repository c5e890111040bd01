"""What a client sets beside the program: the speed slider, digital and analog outputs."""

from __future__ import annotations

from collections.abc import Mapping
from typing import cast

from simulator.devices.ur_controller.rtde import Value

_DIGITAL = {"standard": (0, 0xFF), "configurable": (8, 0xFF), "tool": (16, 0b11)}
"""First bit of each group in `actual_digital_output_bits`, and which of its bits there are (RTDE guide)."""

_ANALOG_TYPES_BIT = 2
"""First bit of the outputs in `analog_io_types`: the inputs come before (RTDE guide)."""

_CURRENT_A, _VOLTAGE_V = (0.004, 0.020), (0.0, 10.0)
"""What an analog output gives at fractions of 0 and 1 (user manual)."""


class Panel:
    """The controller's outputs and its slider.

    Attributes:
        slider: Fraction of the programmed speed, 0 to 1.
        digital_bits: Standard outputs in bits 0-7, configurable ones in 8-15, the tool's in 16-17.
    """

    def __init__(self) -> None:
        self.slider = 1.0
        self.digital_bits = 0
        self._voltages = 0
        self._fractions = [0.0, 0.0]

    @property
    def analog_types(self) -> int:
        """`analog_io_types`: a bit for each input and output, 1 where it is a voltage."""
        return self._voltages << _ANALOG_TYPES_BIT

    def analog(self, number: int) -> float:
        """What an analog output gives, A or V as its type is."""
        lowest, highest = _VOLTAGE_V if self._voltages >> number & 1 else _CURRENT_A
        return lowest + (highest - lowest) * self._fractions[number]

    def write(self, values: Mapping[str, Value]) -> None:
        """Take a client's data package. What its masks leave out stays; a fraction beyond 0 to 1 changes nothing."""
        if _integer(values, "speed_slider_mask") & 1:
            self.slider = _fraction(values, "speed_slider_fraction", self.slider)
        for group, (first, there) in _DIGITAL.items():
            mask = (_integer(values, f"{group}_digital_output_mask") & there) << first
            bits = _integer(values, f"{group}_digital_output") << first
            self.digital_bits = self.digital_bits & ~mask | bits & mask
        mask = _integer(values, "standard_analog_output_mask") & 0b11
        self._voltages = self._voltages & ~mask | _integer(values, "standard_analog_output_type") & mask
        for number, present in enumerate(self._fractions):
            if mask >> number & 1:
                self._fractions[number] = _fraction(values, f"standard_analog_output_{number}", present)


def _integer(values: Mapping[str, Value], name: str) -> int:
    return cast(int, values.get(name, 0))


def _fraction(values: Mapping[str, Value], name: str, otherwise: float) -> float:
    value = cast(float, values.get(name, otherwise))
    return value if 0.0 <= value <= 1.0 else otherwise
