"""A small force sensor on a serial port.

Its lines are text, a space, `*` and the XOR of the text's bytes in hexadecimal, a line feed.
"""

from functools import reduce
from operator import xor

from touchbench import CodecError, LineIdentity, LineSample, LineSensor, LineSensorSettings, StreamInfo

COUNTER_MODULUS = 1 << 16
"""It counts its samples in a u16."""

TIME_MODULUS = 1 << 32
"""Its milliseconds are a u32."""


def encode(text: str) -> bytes:
    """A line."""
    return b"%b *%02X\n" % (text.encode(), reduce(xor, text.encode(), 0))


def text_of(line: bytes) -> str:
    """The text of a line without its end; raises `CodecError` where its check fails."""
    text, star, _ = line.decode("ascii", "replace").partition(" *")
    if not star or encode(text) != line + b"\n":
        raise CodecError(f"{line[:24]!r} has no sound check")
    return text


class ForceSensorSettings(LineSensorSettings):
    """The force sensor."""


class ForceSensor(LineSensor):
    """A force sensor; a `touchbench.Device`. Its stream is `<name>.force`, in N."""

    channel = "force"
    query, start, stop = encode("id"), encode("go"), encode("halt")

    def parse(self, line: bytes) -> LineIdentity | LineSample | None:
        """See `LineSensor.parse`."""
        match text_of(line).split():
            case ["id", "FS1", serial, rate_hz, newton_per_count]:
                scale, rate = float(newton_per_count), float(rate_hz)
                stream = StreamInfo(f"{self.name}.force", ("force",), "N", scale, rate, noisy=True)
                return LineIdentity("FS1", serial, stream, TIME_MODULUS * 1e-3, COUNTER_MODULUS)
            case ["ok", _]:
                return None
            case ["s", *numbers] if len(numbers) == 3 and all(n.lstrip("-").isdecimal() for n in numbers):
                counter, time_ms, counts = map(int, numbers)
                return LineSample((counts,), time_ms * 1e-3, counter)
        raise CodecError(f"{line[:24]!r} is no message of the sensor")
