"""A sound card, through PortAudio: input, and output in the same stream where the card has one."""

import threading
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from drivers.audio.codec import Sound
from drivers.audio.oscillator import chirp, tone
from drivers.audio.settings import FULL_SCALE, RATE_HZ, AudioSettings
from drivers.audio.source import Drive, SoundSource, SourceEvent, SourceFound, Swept
from drivers.core.clock import Clock
from drivers.core.errors import PortError, first_line, lacking
from drivers.core.links import drained
from drivers.core.messages import Chirp, Refused, Tone

WAITING_PACKETS: Final = 4096
"""Buffers that were not taken (20 s of 5 ms): beyond, the oldest are dropped, and their frames count as lost
(assumption)."""

SPARE_BITS: Final = 8
"""PortAudio hands 24-bit samples over at the top of 32."""

ROUND_TRIP_MAX_S: Final = 1.0
"""A card that reports a longer way from output to input has no clock to measure it (assumption)."""


SERVERS: Final = ("pulse", "pipewire", "default")
"""Names under which PortAudio lists sound servers; ALSA's `default` leads to one, or mixes and resamples itself."""

SERVER_LATENCY_S: Final = 0.1
"""Least buffering of a sound server (PulseAudio: measured, no gap)."""


class SoundCard(SoundSource):
    """A sound card's input channels, and the drive on the output channels that the profile names.

    Input and output are one stream on one clock: the drive is generated for the frames that its buffer is handed over
    with, so that the phase at the input is that of `seq`, but for the card's constant latency. Whatever the card loses,
    of input or of output, may change that latency by an unknown number of frames: the sound that may hold the step is
    left out, which is a gap in `seq`. Phases before and after it must not be compared. The drive itself goes on
    without a step.

    Args:
        address: Part of the card's name; empty for the system's own choice.
    """

    def __init__(self, device: str, settings: AudioSettings, clock: Clock, address: str) -> None:
        super().__init__(device, settings, clock, address)
        self._stream: Any = None
        self._has_output = False
        self._callback: _Callback | None = None
        self._listening = False
        self._declined: list[Refused] = []

    def open(self) -> SourceFound:
        """See `SoundSource.open`."""
        sounddevice = self._library()
        chosen = self._choose(sounddevice)
        channels = int(chosen["max_input_channels"])
        outputs = int(chosen["max_output_channels"])
        self._has_output = outputs > 0
        self._check(str(chosen["name"]), outputs)
        driven = self._settings.drive_channels
        self._callback = callback = _Callback(self._clock, 2.0 * self._settings.latency_s, driven)
        made, wanted = sounddevice.InputStream, {"device": chosen["index"], "channels": channels}
        if self._has_output:
            made = sounddevice.Stream
            wanted["channels"] = (channels, outputs)
        try:
            self._stream = made(
                samplerate=RATE_HZ,
                dtype="int32",
                latency=self._settings.latency_s,
                dither_off=True,
                callback=callback.both if self._has_output else callback.input,
                finished_callback=callback.finished,
                **wanted,
            )
            self._stream.start()
        except sounddevice.PortAudioError as error:
            reason = f"{chosen['name']} does not open at {RATE_HZ} Hz ({first_line(error)})"
            advice = "is it held by another program, and can it do 96 kHz?"
            raise PortError(self._device, "opening the sound card", reason, advice) from error
        return SourceFound(
            what=f"the sound card {chosen['name']}",
            model=str(chosen["name"]),
            rate_hz=float(self._stream.samplerate),
            channels=channels,
            bits=None,
            clock=f"{self._device} frames",
            version=sounddevice.get_portaudio_version()[1],
            details={"drive_channels": driven if self._has_output else "none: it has no output"},
        )

    def _check(self, name: str, outputs: int) -> None:
        settings, doing = self._settings, "opening the sound card"
        beyond = [channel for channel in settings.drive_channels if not 0 <= channel < outputs]
        if outputs and beyond:
            reason = f"{name} has {outputs} outputs, and drive_channels names {beyond[0]}"
            raise PortError(self._device, doing, reason, "channels count from 0")
        if name.lower() in SERVERS and settings.latency_s < SERVER_LATENCY_S:
            reason = (
                f"{name} is a sound server, which does not keep up with latency_s = {settings.latency_s:g}"
            )
            raise PortError(
                self._device, doing, reason, f"set latency_s = {SERVER_LATENCY_S:g}, or name the card"
            )

    def _library(self) -> Any:
        doing = "loading sounddevice"
        try:
            import sounddevice
        except ImportError as error:
            raise PortError(self._device, doing, *lacking("sounddevice", "sound")) from error
        except OSError as error:
            advice = "install it, on Debian and Ubuntu: sudo apt install libportaudio2"
            raise PortError(self._device, doing, "PortAudio is missing", advice) from error
        return sounddevice

    def _choose(self, sounddevice: Any) -> Mapping[str, Any]:
        """The input that the address names.

        Raises:
            PortError: there is none, or there are several.
        """
        cards = [card for card in sounddevice.query_devices() if card["max_input_channels"] > 0]
        names = ", ".join(dict.fromkeys(str(card["name"]) for card in cards)) or "none"
        doing = "choosing the sound card"
        if not self._address:
            number = sounddevice.default.device[0]
            matching = [card for card in cards if card["index"] == number]
        else:
            matching = [card for card in cards if self._address.lower() in str(card["name"]).lower()]
            exact = [card for card in matching if str(card["name"]) == self._address]
            matching = exact[:1] or matching
        if not matching:
            what = (
                f"no input is called {self._address}" if self._address else "the system has chosen no input"
            )
            raise PortError(self._device, doing, what, f"there are: {names}")
        if len(matching) > 1:
            several = ", ".join(str(card["name"]) for card in matching)
            reason = f"{len(matching)} inputs are called so: {several}"
            raise PortError(self._device, doing, reason, "write more of the name")
        chosen: Mapping[str, Any] = matching[0]
        return chosen

    def listen(self, on: bool) -> None:
        """See `SoundSource.listen`: the card runs on without a subscriber."""
        if self._callback is not None:
            self._callback.take()
        self._listening = on

    def drive(self, command: Drive) -> None:
        """See `SoundSource.drive`; it begins with the next buffer."""
        if self._callback is None:
            return
        if not self._has_output and isinstance(command, Tone | Chirp):
            reason = "the sound card has no output"
            self._declined.append(Refused(self._clock.now(), self._device, command, reason))
        else:
            self._callback.play(command)

    def receive(self) -> Sequence[SourceEvent]:
        """See `SoundSource.receive`."""
        callback = self._callback
        if callback is None:
            return ()
        taken = callback.take()
        events: list[SourceEvent] = [*taken] if self._listening else []
        events += self._declined
        self._declined = []
        while callback.sweeps:
            events.append(callback.sweeps.popleft())
        self.fault = self.fault or callback.fault
        return events

    def account(self) -> Mapping[str, object]:
        """See `SoundSource.account`."""
        callback = self._callback
        return {} if callback is None else {"overruns": callback.overruns, "underruns": callback.underruns}

    def close(self) -> None:
        """See `SoundSource.close`."""
        stream, self._stream = self._stream, None
        if stream is not None:
            if self._callback is not None:
                self._callback.closing = True
            stream.abort(ignore_errors=True)
            stream.close(ignore_errors=True)


class _Callback:
    """PortAudio's callbacks: they copy the input into a queue and compute the output, nothing else.

    Two counts: of input frames, those that were lost included, and of output frames, which nothing interrupts. They are
    equal until something is lost.

    Args:
        round_trip_s: Least time assumed from output to input, whatever the card reports.
        driven: Output channels that the drive goes out on.

    Attributes:
        overruns: How often the card reported input as lost or made up.
        underruns: The same of output.
        sweeps: Chirps whose end has arrived at the input, by the latency that the card reports.
    """

    def __init__(self, clock: Clock, round_trip_s: float, driven: Sequence[int]) -> None:
        self._clock = clock
        self._driven = list(driven)
        self.overruns = 0
        self.underruns = 0
        self.sweeps: deque[Swept] = deque()
        self.fault: str | None = None
        self.closing = False
        self._packets: deque[Sound] = deque(maxlen=WAITING_PACKETS)
        self._frame = 0
        self._played = 0
        self._round_trip_s = round_trip_s
        self._doubtful = 0
        self._expected_s: float | None = None
        self._lock = threading.Lock()
        self._wave: Callable[[int, int], NDArray[np.float64]] | None = None
        self._wave_end: int | None = None
        self._asked: Drive | None = None
        self._sweep_returns: int | None = None

    def play(self, command: Drive) -> None:
        """Drive so from the next buffer on."""
        with self._lock:
            self._asked = command

    def take(self) -> list[Sound]:
        """Packets since the last call."""
        return drained(self._packets)

    def input(self, indata: NDArray[np.int32], frames: int, time: Any, status: Any) -> None:
        """Of a card without output."""
        arrival_s = self._clock.monotonic_s()
        if status.input_overflow:
            self._frame += self._missing(time)
        if status.input_underflow:  # PortAudio has filled the buffer with samples that were never taken
            self._doubtful = max(self._doubtful, frames)
        self.overruns += bool(status.input_overflow or status.input_underflow)
        if self._doubtful < frames:
            first = self._doubtful
            self._packets.append(Sound(self._frame + first, indata[first:] >> SPARE_BITS, arrival_s))
        self._doubtful = max(0, self._doubtful - frames)
        self._frame += frames
        adc_s = float(time.inputBufferAdcTime)
        self._expected_s = adc_s + frames / RATE_HZ if adc_s > 0.0 else None

    def both(
        self, indata: NDArray[np.int32], outdata: NDArray[np.int32], frames: int, time: Any, status: Any
    ) -> None:
        """Of a card with output: as many frames out as in."""
        output_lost = bool(status.output_underflow or status.output_overflow)
        self.underruns += output_lost
        round_trip_s = _reported_round_trip(time)
        if output_lost or status.input_overflow or status.input_underflow:
            # Reported afterwards, of output that may not have been played yet: until what is computed now comes
            # back, the step may lie anywhere.
            self._doubtful = max(frames, round(max(round_trip_s, self._round_trip_s) * RATE_HZ))
        self.input(indata, frames, time, status)
        first, self._played = self._played, self._played + frames
        self._choose(first)
        wave = np.zeros(frames) if self._wave is None else self._wave(first, frames) * (FULL_SCALE - 1)
        outdata[:] = 0
        outdata[:, self._driven] = (np.rint(wave).astype(np.int32) << SPARE_BITS)[:, None]
        if self._wave_end is not None and self._wave_end <= self._played:
            later = self._frame - self._played + round(round_trip_s * RATE_HZ)
            self._sweep_returns = self._wave_end + later
            self._wave = self._wave_end = None
        if self._sweep_returns is not None and self._sweep_returns <= self._frame:
            self.sweeps.append(Swept(self._sweep_returns, self._clock.monotonic_s()))
            self._sweep_returns = None

    def finished(self) -> None:
        """The stream has ended, as when a card is unplugged."""
        if not self.closing:
            self.fault = self.fault or "the sound card is gone"

    def _choose(self, first: int) -> None:
        with self._lock:
            asked, self._asked = self._asked, None
        if asked is None:
            return
        self._wave = self._wave_end = self._sweep_returns = None
        if isinstance(asked, Tone):
            self._wave = partial(tone, frequency_hz=asked.frequency_hz, level=asked.level)
        elif isinstance(asked, Chirp):
            frames = round(asked.duration_s * RATE_HZ)
            self._wave_end = first + frames
            self._wave = partial(
                chirp, begin=first, from_hz=asked.from_hz, to_hz=asked.to_hz, frames=frames, level=asked.level
            )

    def _missing(self, time: Any) -> int:
        """Frames that an overrun has cost, by the card's time of the first sample; at least one."""
        adc_s = float(time.inputBufferAdcTime)
        if self._expected_s is None or adc_s <= 0.0:
            return 1
        return max(1, round((adc_s - self._expected_s) * RATE_HZ))


def _reported_round_trip(time: Any) -> float:
    """Time from this buffer's output to the input as the card reports it, s; 0 where it does not."""
    adc_s, dac_s = float(time.inputBufferAdcTime), float(time.outputBufferDacTime)
    reported_s = dac_s - adc_s if adc_s > 0.0 else 0.0
    return reported_s if 0.0 < reported_s < ROUND_TRIP_MAX_S else 0.0
