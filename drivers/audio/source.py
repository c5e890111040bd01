"""What every source of the fingers' sound offers the driver, and the table of them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from importlib import import_module
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.audio.codec import Sound
from drivers.audio.settings import AudioSettings
from drivers.core.clock import Clock
from drivers.core.errors import PortError
from drivers.core.messages import Chirp, Excite, Refused, Tone

Drive = Tone | Chirp | Excite

SOURCES: Final[Mapping[str, str]] = {
    "file": "drivers.audio.recording:Recording",
    "sounddevice": "drivers.audio.soundcard:SoundCard",
    "tcp": "drivers.audio.network:NetworkRecorder",
}
"""What a port begins with, and what it needs: imported only where a profile asks for it."""


@dataclass(frozen=True, slots=True)
class SourceFound:
    """What opening a source found.

    Attributes:
        what: What it is, to begin a sentence with: "the recording take.wav".
        rate_hz: Frames a second.
        bits: Of a sample; None where it is not reported.
        clock: Name of the clock that its frames count.
    """

    what: str
    model: str
    rate_hz: float
    channels: int
    bits: int | None
    clock: str
    serial: str = ""
    version: str = ""
    details: Mapping[str, object] = field(default_factory=dict)


class Swept(NamedTuple):
    """A chirp is over: the first input frame after it, by what is known of the latency from output to input, and the
    monotonic time in seconds at which that was known."""

    frame: int
    arrival_s: float


SourceEvent = Sound | Swept | Refused
"""What a source reports; `Refused` is of a drive that was not taken."""


class SoundSource:
    """Where sound comes from. Nothing here waits but `open` and `close`.

    Args:
        address: What the profile's port has behind the kind of the source.

    Attributes:
        fault: Why there will be no more sound; None while there may be.
    """

    def __init__(self, device: str, settings: AudioSettings, clock: Clock, address: str) -> None:
        self._device = device
        self._settings = settings
        self._clock = clock
        self._address = address
        self.fault: str | None = None

    def open(self) -> SourceFound:
        """Connect; no sound is handed out yet, and the drive is silent.

        Raises:
            PortError, SilentError, ProtocolError: one line, with what to do.
        """
        raise NotImplementedError

    def peek(self, seconds: float) -> NDArray[np.int32] | None:
        """The first sound, left where it is, shape (n, channels); None where it has to be waited for."""
        return None

    def listen(self, on: bool) -> None:
        """Start or stop handing out sound."""
        raise NotImplementedError

    def drive(self, command: Drive) -> None:
        """Drive the transducers; a newer drive replaces an older one."""
        raise NotImplementedError

    def receive(self) -> Sequence[SourceEvent]:
        """Events since the last call, in order."""
        raise NotImplementedError

    def account(self) -> Mapping[str, object]:
        """Counts so far, for the manifest."""
        return {}

    def close(self) -> None:
        """Silence the drive, close the source. Never raises; may be called twice."""
        raise NotImplementedError


def make_source(device: str, settings: AudioSettings, clock: Clock) -> SoundSource:
    """The source that a port names, closed.

    Raises:
        PortError: there is no such kind.
    """
    kind, colon, address = settings.port.partition(":")
    if not colon or kind not in SOURCES:
        raise PortError(
            device,
            "choosing its port",
            f"{settings.port} is no source of sound",
            'write port = "mock", "emulated", "sounddevice:NAME", "file:PATH" or "tcp:HOST:PORT"',
        )
    module, _, made = SOURCES[kind].partition(":")
    source: SoundSource = getattr(import_module(module), made)(device, settings, clock, address)
    return source
