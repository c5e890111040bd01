"""A WAV or FLAC recording in the fingers' place."""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np
from numpy.typing import NDArray

from drivers.audio.codec import Sound
from drivers.audio.settings import FULL_SCALE, AudioSettings
from drivers.audio.source import Drive, SoundSource, SourceEvent, SourceFound, Swept
from drivers.core.clock import Clock
from drivers.core.errors import PortError, ProtocolError, lacking
from drivers.core.messages import Chirp

if TYPE_CHECKING:
    import soundfile

PACKET_FRAMES: Final = 480
"""Frames in a packet: 5 ms at 96 kHz, as a sound card's buffer (assumption)."""

PACKETS_MAX: Final = 50
"""Packets of one call: a host that was away catches up over several turns of the loop (assumption)."""

BITS: Final[Mapping[str, int]] = {"PCM_S8": 8, "PCM_U8": 8, "PCM_16": 16, "PCM_24": 24, "PCM_32": 32}
"""Of the formats with integers; 32-bit floats carry 24 bits."""

MENDING: Final = "record it again, or save what is left of it with an editor"


class Recording(SoundSource):
    """Plays a file as if it were live: it runs from the first subscription on, subscribed or not.

    It holds the drive as recorded: a new drive is accepted, and changes nothing. A packet is handed out when its last
    frame is due, or as soon as it is asked for where `paced` is false.

    Args:
        address: Path of the file.
    """

    def __init__(self, device: str, settings: AudioSettings, clock: Clock, address: str) -> None:
        super().__init__(device, settings, clock, address)
        self._path = Path(address).expanduser()
        self._file: soundfile.SoundFile | None = None
        self._frames = 0
        self._rate_hz = 1.0
        self._listening = False
        self._begun_s: float | None = None
        self._next = 0
        self._sweep: int | None = None

    def open(self) -> SourceFound:
        """See `SoundSource.open`."""
        doing = f"opening {self._path}"
        try:
            import soundfile
        except ImportError as error:
            raise PortError(self._device, doing, *lacking("soundfile", "sound")) from error
        if not self._path.is_file():
            raise PortError(self._device, doing, "there is no such file", 'name one: port = "file:take.wav"')
        try:
            self._file = opened = soundfile.SoundFile(self._path)
        except (soundfile.SoundFileError, OSError) as error:
            reason = f"it is cut off or no sound ({str(error).rpartition(': ')[2].rstrip('.')})"
            raise ProtocolError(self._device, doing, reason, "a WAV or FLAC recording is wanted") from error
        self._frames, self._rate_hz = opened.frames, float(opened.samplerate)
        self._check_whole(opened, doing)
        return SourceFound(
            what=f"the recording {self._path.name}",
            model=f"{opened.format} recording {self._path.name}",
            rate_hz=self._rate_hz,
            channels=opened.channels,
            bits=BITS.get(opened.subtype, 24),
            clock="the recording's frames",
            details={"duration_s": round(self._frames / self._rate_hz, 6), "drive": "as recorded"},
        )

    def _check_whole(self, opened: soundfile.SoundFile, doing: str) -> None:
        """Refuse a file that ends before its header says; libsndfile itself takes what is there."""
        import soundfile

        promised, there = _riff_bytes(self._path), self._path.stat().st_size
        if promised is not None and there < promised:
            reason = f"it is cut off: {there} of {promised} bytes are there"
            raise ProtocolError(self._device, doing, reason, MENDING)
        try:
            opened.seek(max(0, self._frames - 1))
            whole = len(opened.read(1)) == 1
            opened.seek(0)
        except soundfile.SoundFileError:
            whole = False
        if not whole:
            reason = (
                f"it is cut off: {self._frames / self._rate_hz:.2f} s are promised, and its end is not there"
            )
            raise ProtocolError(self._device, doing, reason, MENDING)

    def peek(self, seconds: float) -> NDArray[np.int32] | None:
        """See `SoundSource.peek`."""
        assert self._file is not None, "it is not open"
        counts = self._read(round(seconds * self._rate_hz))
        self._file.seek(0)
        return counts

    def listen(self, on: bool) -> None:
        """See `SoundSource.listen`."""
        self._listening = on
        if on and self._begun_s is None:
            self._begun_s = self._clock.monotonic_s()

    def drive(self, command: Drive) -> None:
        """See `SoundSource.drive`: the recording holds the drive."""
        self._sweep = None
        if isinstance(command, Chirp):
            now = self._next if not self._settings.paced else self._due()
            self._sweep = now + round(command.duration_s * self._rate_hz)

    def receive(self) -> Sequence[SourceEvent]:
        """See `SoundSource.receive`."""
        if self._file is None or self._begun_s is None or self.fault is not None:
            return ()
        events: list[SourceEvent] = []
        due = self._due()
        if not self._listening:
            self._skip(due)
        for _ in range(PACKETS_MAX if self._listening else 0):
            # The last packet may be a shorter one.
            end = min(self._next + PACKET_FRAMES, self._frames)
            if end > due or end == self._next:
                break
            counts = self._read(end - self._next)
            if len(counts) < end - self._next:
                self.fault = f"the recording cannot be read beyond {self._next / self._rate_hz:.2f} s"
                return events
            events.append(Sound(self._next, counts, self._begun_s + end / self._rate_hz))
            self._next = end
        if self._sweep is not None and self._sweep <= min(due, self._next):
            events.append(Swept(self._sweep, self._begun_s + self._sweep / self._rate_hz))
            self._sweep = None
        if self._next >= self._frames:
            self.fault = f"the recording has ended, after {self._frames / self._rate_hz:.2f} s"
        return events

    def _due(self) -> int:
        """How many frames are due."""
        if not self._settings.paced:
            # Without a subscriber, an unpaced recording stands still.
            return self._next + PACKETS_MAX * PACKET_FRAMES if self._listening else self._next
        if self._begun_s is None:
            return 0
        return math.floor((self._clock.monotonic_s() - self._begun_s) * self._rate_hz)

    def _skip(self, due: int) -> None:
        assert self._file is not None, "it is not open"
        skipped = min(due, self._frames)
        if skipped > self._next:
            self._file.seek(skipped)
            self._next = skipped

    def _read(self, frames: int) -> NDArray[np.int32]:
        """The next frames as 24-bit counts, fewer where it is spoilt; 24-bit integers pass through floats unchanged."""
        import soundfile

        assert self._file is not None, "it is not open"
        try:
            values = self._file.read(frames, dtype="float64", always_2d=True)
        except soundfile.SoundFileError:
            values = np.empty((0, self._file.channels))
        counts = np.rint(values * FULL_SCALE).clip(-FULL_SCALE, FULL_SCALE - 1)
        return np.asarray(counts.astype(np.int32))

    def account(self) -> Mapping[str, object]:
        """See `SoundSource.account`."""
        return {"frames_of_recording": self._frames}

    def close(self) -> None:
        """See `SoundSource.close`."""
        opened, self._file = self._file, None
        if opened is not None:
            opened.close()


def _riff_bytes(path: Path) -> int | None:
    """Length of a WAV file by its header; None where it is none, or too long for the header."""
    with path.open("rb") as opened:
        magic, size, form = struct.unpack("<4sI4s", opened.read(12).ljust(12, b"\0"))
        if form != b"WAVE":
            return None
        if magic == b"RF64":
            size = struct.unpack("<8xQ", opened.read(16).ljust(16, b"\0"))[0]
        # A last chunk of odd length may lack its byte of padding.
        return int(size) + 8 - 1
