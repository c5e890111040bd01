"""The fingers' sound on the mock bench: carrier or envelope, in the process and in virtual time."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.audio.commands import checked, fingers_info
from drivers.audio.quality import Excursions, clipped
from drivers.audio.settings import FULL_SCALE, UNIT
from drivers.core.messages import (
    Chirp,
    Command,
    DeviceInfo,
    Excite,
    Listen,
    Reached,
    SampleBlock,
    Saturated,
    Status,
    StreamInfo,
    Tone,
)
from drivers.core.settings import Settings
from simulator.mocks.base import MockSensor
from simulator.physics.bench import part

ENVELOPE_HZ: Final = 1000
"""Rate of the envelope: that of the chain's output."""

ENVELOPE: Final = ("I0", "Q0", "I1", "Q1")
"""Channels of the envelope: right finger, then left."""


class MockAudioSettings(Settings):
    """The mock audio."""

    block_samples: int = Field(default=9600, ge=1, le=96_000)
    """Longest block that `read` hands out."""


class MockAudio(MockSensor):
    """What a bench's fingers send, only while subscribed; the bench's `level` sets which of the two.

    At carrier level the stream is the real driver's. At envelope level it is baseband: 1 kHz, floats, full scale 1,
    channels `I0 Q0 I1 Q1`. Sample k is at k / rate in bench time, and k is its `seq`.
    """

    model = "simulated fingers"
    _settings: MockAudioSettings

    def _wire(self) -> None:
        part(self._bench, "carrier", self.name)
        self._longest = self._settings.block_samples
        self._envelope = self._bench.level == "envelope"
        info = fingers_info(self.name)
        if self._envelope:
            info = StreamInfo(info.name, ENVELOPE, UNIT, 1.0, float(ENVELOPE_HZ), noisy=True)
        self._infos = {info.name: info}
        assert info.rate_hz is not None
        self._rate_hz = info.rate_hz

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._sweep_s: float | None = None
        self._sweep = 0  # id of its command
        self._excursions = Excursions(self._rate_hz)
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return replace(super().open(), details={"level": self._bench.level})

    def close(self) -> None:
        """Nothing to release; the drive falls silent."""
        self._bench.silence()

    def apply(self, command: Command) -> Command:
        """Drive the transducers, or listen to the fingers.

        Raises:
            CommandError: not for audio, not finite or out of range.
        """
        command, now_s = checked(self.name, command), self._clock.now()
        self._bench.advance(now_s)
        self._sent(command)
        if isinstance(command, Listen):
            if command.streams != self._next.keys():
                self._subscribe(command.streams, now_s)
                self._excursions.begin()
        elif isinstance(command, Tone | Chirp) and self._faults.active(now_s, "refuse"):
            self._refuse(command, "its amplifier is off")
        else:
            self._report_sweep(now_s)
            self._drive(command, now_s)
        return command

    def _drive(self, command: Command, now_s: float) -> None:
        self._sweep_s = None
        if isinstance(command, Tone):
            self._bench.drive(command.frequency_hz, command.level)
        elif isinstance(command, Chirp):
            self._bench.chirp(command.from_hz, command.to_hz, command.duration_s, command.level)
            self._sweep_s, self._sweep = now_s + command.duration_s, command.id
        elif isinstance(command, Excite):
            self._bench.silence()

    def read(self) -> Sequence[SampleBlock]:
        """What was sampled since the last call."""
        blocks = super().read()
        for block in blocks:
            self._watch(block)
        return blocks

    def _counts(self, stream: str, times_s: NDArray[np.float64]) -> Any:
        n, full_scale = len(times_s), self._faults.active(float(times_s[-1]), "full_scale")
        if self._envelope:
            found = self._bench.baseband(times_s).view(np.float64).reshape(n, 4)
            return np.full((n, 4), -1.0) if full_scale else found
        counts = self._bench.carrier(round(times_s[0] * self._rate_hz), n)
        return np.full((n, 2), -FULL_SCALE, np.int32) if full_scale else counts

    def _block(
        self, stream: str, t0_s: float, values: Any, now_s: float, times_s: NDArray[np.float64] | None = None
    ) -> SampleBlock:
        self._seq[stream] = round(t0_s * self._rate_hz)
        return super()._block(stream, t0_s, values, now_s)

    def _watch(self, block: SampleBlock) -> None:
        """Report each excursion to full scale once."""
        values: Any = block.values
        step = 2 if self._envelope else 1
        full = np.hypot(values[:, 0::2], values[:, 1::2]) >= 1.0 if self._envelope else clipped(values)
        for place, finger in self._excursions.push(full):
            value = float(values[place, step * finger]) * block.scale
            t_s = (block.seq + place) / self._rate_hz
            self._report(Saturated(t_s, self.name, block.stream, value))

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        self._report_sweep(self._clock.now())
        return super().poll()

    @property
    def alone_s(self) -> float:
        """How long it may go unread: then it reports that a sweep has ended."""
        return math.inf if self._sweep_s is None else self._sweep_s - self._clock.now()

    def _report_sweep(self, now_s: float) -> None:
        if self._sweep_s is not None and self._sweep_s <= now_s:
            self._report(Reached(self._sweep_s, self.name, 0.0, command_id=self._sweep))
            self._sweep_s = None
