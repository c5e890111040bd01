"""Lines of numbers, as sketches print them: fields, a separator, perhaps a check. No I/O."""

import math
from collections.abc import Iterable
from functools import reduce
from operator import xor
from typing import Literal, NamedTuple

from drivers.core.errors import CodecError
from drivers.core.line_sensor import LONGEST_LINE
from drivers.core.links import LineBuffer

Check = Literal["none", "xor", "sum"]

NO_VALUE = frozenset(("nan", "inf", "-inf", "ovf", "-ovf"))
"""What Arduino's `Print::print` writes of a float that is no number, or that it cannot write."""

SHOWN = 40
"""Bytes of a line that a message shows."""


class LineFormat(NamedTuple):
    """How a board writes a line.

    Attributes:
        separator: Between two numbers; blanks around a number are ignored, and a blank stands for any run of them.
        check: After the numbers, as `*` and two hexadecimal digits: the XOR of the characters before it, as NMEA 0183
            has it (a `$` in front does not count), or their sum modulo 256; or nothing.
    """

    separator: str = ","
    check: Check = "none"

    @property
    def model(self) -> str:
        """What sends it."""
        return "lines over serial"

    @property
    def ending(self) -> str:
        """What completes a line, for a message."""
        return "end of a line"

    def buffer(self) -> LineBuffer:
        """What cuts bytes into lines."""
        return LineBuffer(LONGEST_LINE)

    def shown(self, line: bytes) -> str:
        """A line, for a person."""
        return line.decode("ascii", "replace")

    def decode(self, line: bytes) -> list[float]:
        """The numbers of a line without its end; NaN where the board had no value.

        Raises:
            CodecError: it is no such line.
        """
        try:
            text = line.decode("ascii").strip()
        except UnicodeDecodeError:
            raise CodecError(f"{line[:SHOWN]!r} is no text") from None
        if self.check != "none":
            text, star, given = text.removeprefix("$").rpartition("*")
            if not star or given.upper() != self.sum_of(text):
                raise CodecError(f"{line[:SHOWN]!r} has no sound check")
        try:
            return [
                _number(field) for field in text.split(self.separator if self.separator.strip() else None)
            ]
        except ValueError:
            raise CodecError(f"{line[:SHOWN]!r} is not made of numbers") from None

    def encode(self, fields: Iterable[str]) -> bytes:
        """A line with its end."""
        text = self.separator.join(fields)
        return (text if self.check == "none" else f"{text}*{self.sum_of(text)}").encode() + b"\r\n"

    def sum_of(self, text: str) -> str:
        """The check of a text, two hexadecimal digits."""
        data = text.encode()
        return f"{sum(data) % 256 if self.check == 'sum' else reduce(xor, data, 0):02X}"


def _number(field: str) -> float:
    field = field.strip()
    if field.lower() in NO_VALUE:
        return math.nan
    if "_" in field or not math.isfinite(value := float(field)):  # both are numbers to Python alone
        raise ValueError(field)
    return value
