"""A National Instruments device through NI-DAQmx: analog inputs, counters, an analog output."""

from collections.abc import Mapping
from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock_model import DeviceClock
from drivers.core.errors import wrong
from drivers.core.messages import Command, DeviceInfo, Excite, Listen, SampleBlock, Saturated, Tare, Tone
from drivers.core.numbering import ENDLESS, StreamTrack
from drivers.core.scaled import ScaledStreams
from drivers.core.wire import WireDriver, check_sensor
from drivers.ni_daq.link import DaqBlock, DaqLink, open_daq
from drivers.ni_daq.output import LONGEST, periods
from drivers.ni_daq.settings import NiDaqSettings

FULL: Final = 0.99
"""From this share of its range on an input counts as clipped (assumption: converters end within 1 % of it)."""


class NiDaq(WireDriver[DaqLink]):
    """Inputs and an output. It moves nothing.

    The device samples all inputs by its own clock, from `open` on; a thread fetches them. Samples are numbered by the
    device and dated by its clock (`clock_model`), never by their arrival. The device loses none: where they are not
    fetched in time, its task ends, and the device has failed.

    Streams are the profile's, in volts or counts less the zero, with the profile's scale. An input at the end of the
    range that the device took is reported as `Saturated`. The output is at 0 V from
    `open` on, at any failure and at `close`; nothing else takes it there when this program dies.
    """

    _settings: NiDaqSettings
    _opens = staticmethod(open_daq)

    def _prepare(self) -> None:
        s = self._settings
        self._scaled = ScaledStreams(self.name, s.streams, s.rate_hz)
        columns = [*s.analog, *s.counters]
        self._places = {
            full: [columns.index(name) for name in one.inputs] for full, one in self._scaled.streams.items()
        }
        self._infos = {full: one.info(full, s.rate_hz) for full, one in self._scaled.streams.items()}
        self._samples = 0
        self._forget()

    def _forget(self) -> None:
        self._scaled.forget()
        self._listening: frozenset[str] = frozenset()
        self._clipped: dict[str, bool] = {}  # streams, and whether their last sample was
        self._received_s = self._clock.monotonic_s()
        clock = self._own_clock = DeviceClock(self._settings.max_drift_ppm)
        self._tracks = {full: StreamTrack(clock, self._settings.rate_hz, ENDLESS) for full in self._infos}

    def _identify(self, link: DaqLink) -> DeviceInfo:
        s = self._settings
        model, serial = link.found
        details: dict[str, object] = {
            "port": s.port,
            "server": s.server,
            "range_v": link.range_v,
            "terminal": s.terminal,
        }
        if s.drive is not None:
            details["drive"] = s.drive.model_dump()
        clock = f"{self.name}'s own"
        return DeviceInfo(self.name, model, serial, streams=self._infos, clock=clock, details=details)

    def _valid(self, command: Command) -> Command:
        drive = self._settings.drive
        match command:
            case Excite(on=on) if drive is not None:
                if on and drive.on_v is None:
                    raise wrong(
                        self.name, command, "its drive has no on_v", "set it, in volts, or send a Tone"
                    )
            case Tone(frequency_hz=frequency_hz, level=level) if drive is not None:
                if drive.rate_hz is None or not 0.0 < frequency_hz < drive.rate_hz / 2.0:
                    reason = f"{frequency_hz:g} Hz needs more than {2.0 * frequency_hz:g} samples a second"
                    raise wrong(self.name, command, reason, "rate_hz of its drive says how many there are")
                if periods(frequency_hz, drive.rate_hz) is None:
                    reason = f"a period of {frequency_hz:g} Hz is more than the {LONGEST} samples that are repeated"
                    least_hz = drive.rate_hz / LONGEST
                    raise wrong(
                        self.name, command, reason, f"choose {least_hz:g} Hz or more, or a lower rate_hz"
                    )
                if not 0.0 <= level <= 1.0:
                    raise wrong(
                        self.name, command, f"level is {level:g}", "it is between 0 and 1, of limit_v"
                    )
            case _:
                takes = (Listen, Tare) if drive is None else (Excite, Tone, Listen, Tare)
                check_sensor(self.name, command, self._scaled.streams, takes=takes)
        return command

    def _carry_out(self, command: Command) -> None:
        assert self._link is not None
        output = self._link.output
        match command:
            case Listen(streams=streams):
                for stream in streams - self._listening:
                    self._tracks[stream].begin()
                    self._scaled.begin(stream)
                    self._clipped[stream] = False
                self._listening = streams
                self._received_s = self._clock.monotonic_s()
                self._sent(command)
            case Tare(stream=stream):
                if self._scaled.tare(stream):
                    self._sent(command)
                else:
                    self._refuse(command, "no samples of it yet; listen to it first")
            case Tone() if output is not None and output.least_v >= 0.0:
                self._refuse(command, "its output has no negative voltage, and a sine needs it")
            case Excite() | Tone() if output is not None:
                output.order(command)

    def zero_setting(self, stream: str) -> str:
        """See `OwnZero.zero_setting`."""
        return self._scaled.setting(stream)

    def account(self) -> Mapping[str, object]:
        """Samples of each input, what is read at zero, and the drift of the device's clock."""
        found = {"samples": self._samples, "zeros": dict(self._scaled.zeros)}
        return {**found, **self._own_clock.account(self.name)}

    def _update(self, link: DaqLink) -> str | None:
        for command, at_s in link.output.done() if link.output is not None else ():
            self._sent(command, at_s)
        for block in link.receive():
            self._received_s = block.arrival_s
            self._samples += len(block.values)
            for stream in sorted(self._listening):
                self._take(stream, block)
        limit_s, silent_s = self._settings.silence_timeout_s, self._clock.monotonic_s() - self._received_s
        if not self._listening or silent_s <= limit_s:
            return None
        link.off()
        return f"no sample in {limit_s:g} s"

    def _take(self, stream: str, block: DaqBlock) -> None:
        shown_s = block.first / self._settings.rate_hz
        n, arrival_s = len(block.values), block.arrival_s
        placed = self._tracks[stream].place(shown_s, arrival_s, n, counter=block.first)
        bench_s = self._clock.from_monotonic(0.0)
        read = block.values[:, self._places[stream]]
        samples = self._infos[stream].block(
            placed.seq,
            placed.t0_s + bench_s,
            self._scaled.counts(stream, read),
            device_t0_s=placed.device_s,
            arrival_s=arrival_s + bench_s,
        )
        self._blocks.append(samples)
        if not self._scaled.streams[stream].counts:
            self._saturate(samples, read)
        if placed.lost is not None:
            self._lost(placed.t0_s + bench_s, stream, placed.lost)

    def _saturate(self, samples: SampleBlock, volts: NDArray[np.float64]) -> None:
        """Report where an input of this stream came to the end of its range, once for each excursion."""
        assert self._link is not None
        lowest_v, highest_v = self._link.range_v
        clipped = (volts <= FULL * lowest_v) | (volts >= FULL * highest_v)
        any_clipped = np.logical_or.reduce(clipped, axis=1)
        before = np.append(self._clipped[samples.stream], any_clipped[:-1])
        for place in np.flatnonzero(any_clipped & ~before):
            value = float(samples.physical[place, clipped[place].argmax()])
            self._report(Saturated(float(samples.times[place]), self.name, samples.stream, value))
        self._clipped[samples.stream] = bool(any_clipped[-1])
