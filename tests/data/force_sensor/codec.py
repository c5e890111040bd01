"""A small force sensor's lines: text, a space, `*` and the XOR of the text's bytes in hexadecimal, a line feed."""

from __future__ import annotations

from dataclasses import dataclass
from functools import reduce
from operator import xor

from touchbench import CodecError

COUNTER_MODULUS = 1 << 16
"""It counts its samples in a u16."""

TIME_MODULUS = 1 << 32
"""Its milliseconds are a u32."""


@dataclass(frozen=True, slots=True)
class Identity:
    """Its answer to `id`; one count is `newton_per_count`."""

    serial: str
    rate_hz: float
    newton_per_count: float


@dataclass(frozen=True, slots=True)
class Done:
    """It has carried out `go` or `halt`."""

    command: str


@dataclass(frozen=True, slots=True)
class Sample:
    """One sample: its number modulo `COUNTER_MODULUS`, the sensor's time in ms, the force in counts."""

    counter: int
    time_ms: int
    counts: int


Message = Identity | Done | Sample


def encode(text: str) -> bytes:
    """A line."""
    return b"%b *%02X\n" % (text.encode(), reduce(xor, text.encode(), 0))


def encode_message(message: Message) -> bytes:
    """A line from the sensor."""
    match message:
        case Identity(serial, rate_hz, newton_per_count):
            return encode(f"id FS1 {serial} {rate_hz:g} {newton_per_count:g}")
        case Done(command):
            return encode(f"ok {command}")
        case Sample(counter, time_ms, counts):
            return encode(f"s {counter} {time_ms} {counts}")


def text_of(line: bytes) -> str:
    """The text of a line; raises `CodecError` where its check fails."""
    text, star, _ = line.decode("ascii", "replace").partition(" *")
    if not star or encode(text) != line + b"\n":
        raise CodecError(f"{line[:24]!r} has no sound check")
    return text


def decode(line: bytes) -> Message:
    """The message in a line from the sensor; raises `CodecError`."""
    match text_of(line).split():
        case ["id", "FS1", serial, rate_hz, newton_per_count]:
            return Identity(serial, float(rate_hz), float(newton_per_count))
        case ["ok", command]:
            return Done(command)
        case ["s", *numbers] if len(numbers) == 3 and all(n.lstrip("-").isdecimal() for n in numbers):
            return Sample(*map(int, numbers))
    raise CodecError(f"{line[:24]!r} is no message of the sensor")


class Lines:
    """Splits received bytes into lines."""

    def __init__(self) -> None:
        self._rest = b""

    def feed(self, data: bytes) -> list[bytes]:
        """The lines that are complete."""
        *lines, self._rest = (self._rest + data).split(b"\n")
        self._rest = self._rest[-256:]
        return lines
