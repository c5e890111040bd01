"""What a profile says of a board that prints lines."""

import math
from collections.abc import Sequence
from typing import Literal, Self

from pydantic import Field, model_validator

from drivers.core.line_sensor import LineSensorSettings
from drivers.core.scaled import ScaledStream
from drivers.serial_lines import bota
from drivers.serial_lines.codec import Check, LineFormat


class LineStream(ScaledStream):
    """Some of the columns: a channel each."""

    columns: tuple[int, ...] = Field(min_length=1)
    """Which columns, counted from 0."""

    @property
    def sources(self) -> Sequence[int | str]:
        """See `ScaledStream.sources`."""
        return self.columns


class SerialLinesSettings(LineSensorSettings):
    """A board that prints a line of numbers for each sample, all the time."""

    reply_timeout_s: float = Field(default=5.0, gt=0.0, le=60.0)
    """How long after opening until it prints sound lines. Assumption: a boot loader waits for 2 s at the most."""
    frames: Literal["lines", "bota"] = "lines"
    """What it sends: lines of text, or frames of Bota Systems' serial force sensors, with `time_column` 6."""
    separator: str = Field(default=",", min_length=1, max_length=4)
    """What stands between two numbers; " " is any run of blanks."""
    checksum: Check = "none"
    """What follows the numbers as `*` and two hexadecimal digits: "xor", as NMEA 0183 has it, or "sum", modulo 256."""
    time_column: int | None = Field(default=0, ge=0)
    """Column of the board's own time; "none": a sample is dated by its arrival, or where it is counted by that."""
    time_unit_s: float = Field(default=1e-6, gt=0.0, le=1.0)
    """A step of that time in seconds: 1e-6 of `micros()`, 1e-3 of `millis()`."""
    time_modulus: int | None = Field(default=1 << 32, ge=2)
    """At which it is zero again: 32 bits of an Arduino; "none": never."""
    counter_column: int | None = Field(default=None, ge=0)
    """Column of a number that counts samples: what is lost is known by it."""
    counter_modulus: int | None = Field(default=None, ge=2)
    """At which that number is zero again: 256 of 8 bits."""
    rate_hz: float | None = Field(default=None, gt=0.0, le=100_000.0)
    """Lines a second, where they come regularly by the board's time or its count. Without it each sample has a time of
    its own, and what needs a regular waveform refuses the stream."""
    streams: dict[str, LineStream] = Field(min_length=1)
    """`[devices.NAME.streams.force]` is the stream `NAME.force`."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if (self.counter_column is None) != (self.counter_modulus is None):
            raise ValueError("counter_column and counter_modulus go together: 256 of 8 bits, 65536 of 16")
        if self.rate_hz and self.time_column is None and self.counter_column is None:
            raise ValueError(
                "rate_hz needs the board's time (time_column) or a counter (counter_column); arrivals are not regular"
            )
        own = [self.time_column, self.counter_column]
        taken = {
            column: name for column, name in zip(own, ("time", "counter"), strict=True) if column is not None
        }
        if self.frames == "bota" and self.time_column != bota.TIME_COLUMN:
            raise ValueError(
                f"a frame has its time in column {bota.TIME_COLUMN}: time_column = {bota.TIME_COLUMN}"
            )
        end = bota.NUMBERS if self.frames == "bota" else math.inf
        for name, stream in self.streams.items():
            for column in stream.columns:
                if not 0 <= column < end or column in taken:
                    known = "count from 0" if column < 0 else f"a frame has 0 to {bota.NUMBERS - 1}"
                    raise ValueError(
                        f"stream {name}: column {column} is {taken.get(column, f'none; {known}')}"
                    )
        return self

    @property
    def format(self) -> LineFormat | bota.BotaFormat:
        """How its numbers are written."""
        return bota.BotaFormat() if self.frames == "bota" else LineFormat(self.separator, self.checksum)

    @property
    def fields(self) -> int:
        """How many numbers a line has at the least."""
        named = [column for stream in self.streams.values() for column in stream.columns]
        return 1 + max([*named, self.time_column or 0, self.counter_column or 0])

    @property
    def wrap_s(self) -> float | None:
        """After how long the board's clock is zero again; None never."""
        if self.time_column is not None:
            return None if self.time_modulus is None else self.time_modulus * self.time_unit_s
        return self.counter_modulus / self.rate_hz if self.counter_modulus and self.rate_hz else None
