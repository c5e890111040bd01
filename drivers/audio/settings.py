"""Where the fingers' sound comes from, and what is asked of it."""

from typing import Annotated, Final, Self

from pydantic import Field, Strict, model_validator

from drivers.core.settings import Settings

RATE_HZ: Final = 96_000
"""Frames a second: a converter's rate above twice 40 kHz (Rupavatharam et al., III.B)."""

FINGERS: Final = ("right", "left")
"""Channels of the stream, in its order."""

STREAM: Final = "fingers"
"""Name of the stream, behind the device's."""

UNIT: Final = "FS"
"""Shares of the converter's full scale."""

FULL_SCALE: Final = 1 << 23
"""Counts of a 24-bit converter's full scale."""


class AudioSettings(Settings):
    """The fingers' sound.

    `port` is `sounddevice:NAME` (a sound card; NAME is part of its name, or empty for the system's own choice),
    `file:PATH` (a WAV or FLAC recording) or `tcp:HOST:PORT` (a recorder on the network; an emulated one is that too).
    """

    port: str = Field(min_length=1)
    """Where the sound comes from."""
    channels: Annotated[tuple[int, int], Strict(False)] = (0, 1)
    """Which channels of the source, from 0, the right and the left finger are on."""
    drive_channels: Annotated[tuple[int, ...], Strict(False)] = (0, 1)
    """Which outputs of a sound card, from 0, the drive goes out on; all others are silent."""
    paced: bool = True
    """Of a file: play it as it was recorded; false hands it out as fast as it is asked for, times running ahead."""
    look_s: float = Field(default=0.25, ge=0.0, le=5.0)
    """How much sound is checked at `open`, where clipped, silent and 16-bit sound is refused; 0 checks none.
    Assumption: ten thousand periods of the drive."""
    silence_timeout_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """Silence, of the link or of a finger, after which the device has failed (assumption)."""
    reply_timeout_s: float = Field(default=1.0, gt=0.0, le=30.0)
    """How long a recorder on the network may take to answer (assumption)."""
    latency_s: float = Field(default=0.02, gt=0.0, le=1.0)
    """Of a sound card: the buffering that it is asked for; more of it overruns less (assumption). A sound server, such
    as PulseAudio, needs 0.1 (measured there: at 0.02 it does not keep up)."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between the converter's clock and the host's. Assumption: two crystals of 100 ppm."""

    @model_validator(mode="after")
    def _each_channel_once(self) -> Self:
        for key, channels in (("channels", self.channels), ("drive_channels", self.drive_channels)):
            if len(set(channels)) < len(channels) or min(channels, default=0) < 0:
                raise ValueError(f"{key} = {list(channels)}: each channel once, counted from 0")
        return self
