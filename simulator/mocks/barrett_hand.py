"""The BarrettHand of the mock bench: what its fingers feel, sampled in the process."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, Strict

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import FingerStrain, FingerStrainSettings
from drivers.core.clock import last_tick
from drivers.core.errors import check_streams, wrong
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Listen,
    SampleBlock,
    Tare,
)
from simulator.devices.barrett_hand import counts
from simulator.mocks.base import MockSensor
from simulator.physics.bench import part


class MockBarrettHandSettings(FingerStrainSettings):
    """The mock hand."""

    fingers: Annotated[tuple[int, ...], Strict(False)] = codec.FINGERS
    """Nodes of the fingers that have a strain gauge."""

    poll_hz: float = Field(default=1000.0, ge=1.0, le=1000.0)
    """How often the gauges are polled, as in the real driver."""

    block_samples: int = Field(default=4096, ge=1, le=65536)
    """Longest block that `read` hands out."""


class MockBarrettHand(MockSensor):
    """Samples the fingers on its own grid (sample k at k / poll_hz), computing only what is subscribed."""

    _settings: MockBarrettHandSettings

    def _wire(self) -> None:
        part(self._bench, "forces_n", self.name)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        s = self._settings
        strains = [FingerStrain(self.name, finger, s.poll_hz, s) for finger in s.fingers]
        self._strains = {strain.info.name: strain for strain in strains}
        self._fingers = dict(zip(self._strains, s.fingers, strict=True))
        self._next: dict[str, int] = {}
        self._seq = dict.fromkeys(self._strains, 0)
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(
            self.name,
            model="simulated BarrettHand",
            streams={name: strain.info for name, strain in self._strains.items()},
            clock="bench",
            details={"safe_counts": codec.SAFE_COUNTS},
        )

    def apply(self, command: Command) -> Command:
        """Listen to fingers, or tare one.

        Raises:
            CommandError: not for this hand.
        """
        now_s = self._clock.now()
        match command:
            case Listen(streams=streams):
                check_streams(self.name, command, streams, self._strains)
                begins = last_tick(now_s, self._settings.poll_hz) + 1
                self._next = {stream: self._next.get(stream, begins) for stream in sorted(streams)}
            case Tare(stream=stream):
                check_streams(self.name, command, (stream,), self._strains)
                if self._strains[stream].tare():
                    self._sent(command)
                else:
                    self._refuse(command, "nothing has been read of it; listen to it first")
            case _:
                raise wrong(self.name, command, "it has no such command", "a hand can Listen and Tare")
        return command

    def read(self) -> Sequence[SampleBlock]:
        """What was sampled since the last call."""
        now_s = self._clock.now()
        self._bench.advance(now_s)
        blocks = [block for stream in self._next for block in self._sample(stream, now_s)]
        arrived = self._arrived(blocks, now_s)
        for block in arrived:
            self._statuses += self._strains[block.stream].saturation(block)
        return arrived

    def account(self) -> Mapping[str, object]:
        """No link; where the zeros are."""
        return {"zero_counts": {name: strain.zero for name, strain in self._strains.items()}}

    def _sample(self, stream: str, now_s: float) -> list[SampleBlock]:
        rate_hz, first = self._settings.poll_hz, self._next[stream]
        last = last_tick(now_s, rate_hz)
        if last < first:
            return []
        self._next[stream] = last + 1
        times_s = np.arange(first, last + 1) / rate_hz
        raw = counts(self._bench.forces_n(self._fingers[stream], times_s), self._settings)
        if self._faults.active(now_s, "full_scale"):
            raw = np.zeros_like(raw)
        raw = self._faults.held(now_s, stream, raw[:, None])[:, 0]
        blocks = []
        for start in range(0, len(raw), self._settings.block_samples):
            part = raw[start : start + self._settings.block_samples]
            blocks.append(self._strains[stream].block(self._seq[stream], float(times_s[start]), part, now_s))
            self._seq[stream] += len(part)
        return blocks
