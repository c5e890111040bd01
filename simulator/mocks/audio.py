"""The fingers' sound on the mock bench: carrier or envelope, in the process and in virtual time."""

import math
from collections.abc import Sequence
from typing import Final

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.audio.commands import checked, fingers_info
from drivers.audio.quality import Excursions, clipped
from drivers.audio.settings import FULL_SCALE, STREAM, UNIT
from drivers.core.clock import last_tick
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
from simulator.mocks.base import MockDriver
from simulator.physics.bench import part

ENVELOPE_HZ: Final = 1000
"""Rate of the envelope: that of the chain's output."""

ENVELOPE: Final = ("I0", "Q0", "I1", "Q1")
"""Channels of the envelope: right finger, then left."""

SPAN_S: Final = 1.0
"""Sound is computed in spans of this length at the most: a bench remembers the last few seconds (assumption)."""


class MockAudioSettings(Settings):
    """The mock audio."""

    block_samples: int = Field(default=9600, ge=1, le=96_000)
    """Longest block that `read` hands out."""


class MockAudio(MockDriver):
    """What a bench's fingers send, only while subscribed; the bench's `level` sets which of the two.

    At carrier level the stream is the real driver's. At envelope level it is baseband: 1 kHz, floats, full scale 1,
    channels `I0 Q0 I1 Q1`. Sample k is at k / rate in bench time, and k is its `seq`.
    """

    _settings: MockAudioSettings

    def _wire(self) -> None:
        part(self._bench, "carrier", self.name)
        self._envelope = self._bench.level == "envelope"
        self._info = fingers_info(self.name)
        if self._envelope:
            self._info = StreamInfo(
                f"{self.name}.{STREAM}", ENVELOPE, UNIT, 1.0, float(ENVELOPE_HZ), noisy=True
            )
        assert self._info.rate_hz is not None
        self._rate_hz = self._info.rate_hz

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._next: int | None = None
        self._sweep_s: float | None = None
        self._sweep = 0  # id of its command
        self._excursions = Excursions(self._rate_hz)
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(
            self.name,
            model="simulated fingers",
            streams={self._info.name: self._info},
            clock="bench",
            details={"level": self._bench.level},
        )

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
            self._listen(bool(command.streams), now_s)
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

    def _listen(self, on: bool, now_s: float) -> None:
        if on == (self._next is not None):
            return
        self._next = last_tick(now_s, self._rate_hz) + 1 if on else None
        self._excursions.begin()

    def read(self) -> Sequence[SampleBlock]:
        """What was sampled since the last call."""
        now_s = self._clock.now()
        if self._next is None:
            return ()
        if self._gone(now_s):
            following = last_tick(now_s, self._rate_hz) + 1
            self._unheard_of(self._info.name, following - self._next)
            self._next = following
            return ()
        self._heard(now_s)
        if self._garbled(now_s):
            return self._lose(now_s)
        blocks: list[SampleBlock] = []
        while (last := last_tick(now_s, self._rate_hz)) >= self._next:
            span = round(SPAN_S * self._rate_hz)
            n = min(last + 1 - self._next, self._settings.block_samples, span)
            until_s = now_s if self._next + n > last else (self._next + n) / self._rate_hz
            self._bench.advance(until_s)
            blocks.append(self._block(self._next, n, now_s))
            self._next += n
        return blocks

    def _lose(self, now_s: float) -> Sequence[SampleBlock]:
        assert self._next is not None
        last = last_tick(now_s, self._rate_hz)
        if last >= self._next:
            self._lost(now_s, self._info.name, last + 1 - self._next)
            self._next = last + 1
        return ()

    def _block(self, first: int, n: int, now_s: float) -> SampleBlock:
        t0_s = first / self._rate_hz
        until_s = (first + n - 1) / self._rate_hz
        full_scale = self._faults.active(until_s, "full_scale")
        values: NDArray[np.float64] | NDArray[np.int32]
        if self._envelope:
            found = self._bench.baseband(np.arange(first, first + n) / self._rate_hz)
            values = np.full((n, 4), -1.0) if full_scale else found.view(np.float64).reshape(n, 4)
            full = np.hypot(values[:, 0::2], values[:, 1::2]) >= 1.0
        else:
            counts: NDArray[np.int32] = self._bench.carrier(first, n)
            values = counts = np.full((n, 2), -FULL_SCALE, np.int32) if full_scale else counts
            full = clipped(counts)
        for place, finger in self._excursions.push(full):
            column = 2 * finger if self._envelope else finger
            value = float(values[place, column]) * self._info.scale
            t_s = (first + place) / self._rate_hz
            self._report(Saturated(t_s, self.name, self._info.name, value))
        return self._info.block(first, t0_s, values, device_t0_s=t0_s, arrival_s=now_s)

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
