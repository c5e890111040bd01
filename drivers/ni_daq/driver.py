"""Analog inputs of a National Instruments device, through NI-DAQmx."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock_model import DeviceClock
from drivers.core.errors import CommandError, check_streams, wrong
from drivers.core.messages import Command, DeviceInfo, Listen, StreamInfo, Tare
from drivers.core.numbering import ENDLESS, StreamTrack
from drivers.core.wire import WireDriver
from drivers.ni_daq.link import DaqBlock, DaqLink, open_daq
from drivers.ni_daq.settings import DaqLimits, DaqStream, NiDaqSettings

TARE_SAMPLES = 50
"""A new zero is the mean of as many samples (assumption)."""


class DaqInputs:
    """What the voltages of a device's streams mean; for driver and mock alike.

    Args:
        name: Of the device, in the profile.

    Attributes:
        infos: Streams by name.
        streams: The profile's, by the same names.
        places: Columns of each stream among all inputs.
    """

    def __init__(self, name: str, settings: DaqLimits) -> None:
        self.streams = {f"{name}.{own}": stream for own, stream in settings.streams.items()}
        self.infos = {full: _info(full, stream, settings.rate_hz) for full, stream in self.streams.items()}
        self.places: dict[str, slice] = {}
        first = 0
        for full, stream in self.streams.items():
            self.places[full] = slice(first, first := first + len(stream.inputs))
        self._device = name
        self.forget()

    def forget(self) -> None:
        """Zeros are the profile's again."""
        self._zeros = {full: np.full(len(one.inputs), one.offset) for full, one in self.streams.items()}
        self._recent = {full: np.empty((0, len(one.inputs))) for full, one in self.streams.items()}

    def counts(self, stream: str, volts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Volts less the zero, shape (n, channels), positive where the value is."""
        self._recent[stream] = np.concatenate([self._recent[stream], volts])[-TARE_SAMPLES:]
        return np.asarray((volts - self._zeros[stream]) * math.copysign(1.0, self.streams[stream].scale))

    def tare(self, stream: str) -> bool:
        """Take the latest samples for zero; False where there are none."""
        recent = self._recent[stream]
        if not len(recent) or not np.isfinite(recent).all():
            return False
        self._zeros[stream] = recent.mean(axis=0)
        return True

    def zeros(self) -> Mapping[str, object]:
        """Volts at zero, by stream."""
        return {stream: zero.tolist() for stream, zero in self._zeros.items()}

    def valid(self, command: Command) -> Listen | Tare:
        """The command; raises `CommandError` where it is not for such a device."""
        if isinstance(command, Listen):
            check_streams(self._device, command, command.streams, self.infos)
            return command
        if isinstance(command, Tare):
            check_streams(self._device, command, (command.stream,), self.infos)
            return command
        error: CommandError = wrong(self._device, command, "it has no such command", "it can Listen and Tare")
        raise error


class NiDaq(WireDriver[DaqLink]):
    """Analog inputs; implements `drivers.core.protocols.Device`. It moves nothing.

    The device samples all inputs by its own clock, from `open` on; a thread fetches them. Samples are numbered by the
    device and dated by its clock (`clock_model`), never by their arrival. The device loses none: where they are not
    fetched in time, its task ends, and the device has failed.

    Streams are the profile's, in volts less the zero, with the profile's scale.
    """

    _settings: NiDaqSettings
    _opens = staticmethod(open_daq)

    def _prepare(self) -> None:
        self._inputs = DaqInputs(self.name, self._settings)
        self._samples = 0
        self._forget()

    def _forget(self) -> None:
        s = self._settings
        self._inputs.forget()
        self._listening: frozenset[str] = frozenset()
        self._received_s = self._clock.monotonic_s()
        clock = DeviceClock(s.max_drift_ppm)
        self._tracks = {stream: StreamTrack(clock, s.rate_hz, ENDLESS) for stream in self._inputs.infos}

    def _identify(self, link: DaqLink) -> DeviceInfo:
        s = self._settings
        model, serial = link.found
        self._received_s = self._clock.monotonic_s()
        return DeviceInfo(
            self.name,
            model,
            serial,
            streams=self._inputs.infos,
            clock=f"{self.name}'s own",
            details={"port": s.port, "server": s.server, "range_v": s.range_v, "terminal": s.terminal},
        )

    def _valid(self, command: Command) -> Command:
        return self._inputs.valid(command)

    def _carry_out(self, command: Command) -> None:
        if isinstance(command, Listen):
            for stream in command.streams - self._listening:
                self._tracks[stream].begin()
            self._listening = command.streams
            self._received_s = self._clock.monotonic_s()
            self._sent(command)
        elif isinstance(command, Tare) and self._inputs.tare(command.stream):
            self._sent(command)
        else:
            self._refuse(command, "no samples of it yet; listen to it first")

    def account(self) -> Mapping[str, object]:
        """Samples of each input, and the volts at zero."""
        return {"samples": self._samples, "zero_v": self._inputs.zeros()}

    def _update(self, link: DaqLink) -> str | None:
        for block in link.receive():
            self._received_s = block.arrival_s
            self._samples += len(block.volts)
            for stream in sorted(self._listening):
                self._take(stream, block)
        limit_s, silent_s = self._settings.silence_timeout_s, self._clock.monotonic_s() - self._received_s
        return f"no sample in {limit_s:g} s" if silent_s > limit_s else None

    def _take(self, stream: str, block: DaqBlock) -> None:
        info, n = self._inputs.infos[stream], len(block.volts)
        shown_s = block.first / self._settings.rate_hz
        placed = self._tracks[stream].place(shown_s, block.arrival_s, n, counter=block.first)
        bench_s = self._clock.from_monotonic(0.0)
        values = self._inputs.counts(stream, block.volts[:, self._inputs.places[stream]])
        self._blocks.append(
            info.block(
                placed.seq,
                placed.t0_s + bench_s,
                values,
                device_t0_s=placed.device_s,
                arrival_s=block.arrival_s + bench_s,
            )
        )
        if placed.lost is not None:
            self._lost(placed.t0_s + bench_s, stream, placed.lost)


def _info(name: str, stream: DaqStream, rate_hz: float) -> StreamInfo:
    """What a stream is, by the profile."""
    channels = stream.channels or ((name.partition(".")[2],) if len(stream.inputs) == 1 else stream.inputs)
    return StreamInfo(name, channels, stream.unit, abs(stream.scale), rate_hz, noisy=stream.noisy)
