"""An emulated sensor board: frames on whatever its sensors are wired to; no port, no clock of the host's."""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import CodecError
from drivers.sensor_board.codec import (
    COUNTER_MODULUS,
    TIME_MODULUS,
    BoardCode,
    BoardHello,
    BoardReply,
    BoardSamples,
    CommandFrame,
    HelloStream,
    ReplyStatus,
    decode,
    encode,
)
from drivers.sensor_board.framing import BoardFrameDecoder
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import Bench, StreamSpec, part

INT32 = np.iinfo(np.int32)


@dataclass(frozen=True, slots=True)
class BoardClock:
    """The board's own clock.

    Attributes:
        power_s: Host time at which it began.
        start_us: What it showed then, in us.
        rate: Its seconds for each second of the host.
    """

    power_s: float
    start_us: int
    rate: float

    def tick(self, t_s: float, rate_hz: float) -> int:
        """Number of the last tick of `rate_hz`, by this clock, at or before host time `t_s`."""
        return math.floor((t_s - self.power_s) * self.rate * rate_hz)

    def host_s(self, ticks: NDArray[np.int64], rate_hz: float) -> NDArray[np.float64]:
        """Host times of ticks."""
        return np.asarray(self.power_s + ticks / (rate_hz * self.rate))

    def tick_us(self, tick: int, rate_hz: float) -> int:
        """What the clock shows at a tick."""
        return (self.start_us + round(tick * 1e6 / rate_hz)) % TIME_MODULUS

    def shown_us(self, times_s: NDArray[np.float64]) -> NDArray[np.uint32]:
        """What the clock shows at host times."""
        since_us = np.floor((times_s - self.power_s) * self.rate * 1e6).astype(np.int64)
        return ((self.start_us + since_us) % TIME_MODULUS).astype(np.uint32)


class Channel:
    """One stream of the board: its converter, its zero, its counter, and what waits to fill a block.

    Args:
        bits: Width of the converter, sign included.
    """

    def __init__(self, number: int, spec: StreamSpec, bits: int) -> None:
        self.number = number
        self.spec = spec
        self.on = False
        self.tick = 0
        self._limit = 2 ** (bits - 1)
        self.restart()

    def restart(self) -> None:
        """Counter, zero and block are as after power-on."""
        self.seq = 0
        self._zero = np.zeros(len(self.spec.channels), np.int64)
        self._recent = np.empty((0, len(self.spec.channels)), np.int64)
        self.waiting = np.empty((0, len(self.spec.channels)), np.int32)

    def start(self, tick: int) -> None:
        """Sample from this tick on."""
        self.on = True
        self.tick = tick
        self._recent = self._recent[:0]

    def convert(self, values: NDArray[np.float64]) -> NDArray[np.int32]:
        """What the converter makes of values in the unit: counts, saturated, from its zero; (n, channels)."""
        ideal = np.rint(values.reshape(-1, len(self.spec.channels)) / self.spec.scale)
        # What is no number leaves the converter at its lower rail.
        held = np.clip(np.nan_to_num(ideal, nan=-self._limit), -self._limit, self._limit - 1)
        counts = held.astype(np.int64)
        self._recent = np.concatenate([self._recent, counts])[-TARE_SAMPLES:]
        return np.asarray(np.clip(counts - self._zero, INT32.min, INT32.max), dtype=np.int32)

    def tare(self) -> bool:
        """Take the latest samples as zero; False where there are none."""
        if not (self.on and len(self._recent)):
            return False
        self._zero = np.rint(self._recent.mean(axis=0)).astype(np.int64)
        return True

    def number_block(self, samples: int) -> int:
        """Counter of the first of the next samples."""
        seq, self.seq = self.seq, (self.seq + samples) % COUNTER_MODULUS
        return seq


LONGEST_BLOCK_S = 0.05
"""No frame of a regular stream waits longer for its samples: after 0.1 s of silence a stream is stale. Assumption."""


DRIFT_PPM = 37.0
"""How much faster than the host's its clock runs. Assumption: an ordinary crystal, within 100 ppm."""

START_US = TIME_MODULUS - 5_000_000
"""What its clock shows at the first call, in us: 5 s before it wraps, so that it does in a run."""

BLOCK_SAMPLES = 10
"""Samples of a regular stream in a frame, or fewer where they take too long. Assumption: 10 ms at 1 kHz."""

ADC_BITS = {"accelerometer": 16, "load_cell": 24}
"""Width of a stream's converter, sign included; 32 where none is named (assumption)."""

TARE_SAMPLES = 100
"""Samples that a new zero is the mean of. Assumption: 0.1 s at 1 kHz."""

TENDON_M = (-0.005, 0.03)
"""Least and greatest tendon position that is not refused (assumption)."""


class EmulatedSensorBoard(EmulatedDevice):
    """Answers as the board does: bytes in, bytes out, and time from outside.

    Regular streams are sampled on the grid of the board's own clock, all at the same instants; only those in
    the mask are computed. A stream's counter goes on where it was when it is started again. The last,
    shorter block of a stream is sent when it is stopped. A tare takes the mean of the stream's latest samples
    and is refused while the stream is off. When no command has come for as long as the watchdog was set
    to, the excitation is switched off and the streams are stopped.

    Args:
        source: What its sensors and its drive are wired to.
        boot_s: How long it hears nothing once it has power, or was restarted by the opening of its port.
        drift_ppm: Of its clock.
        start_us: What its clock shows at the first call.
        block_samples: Most samples in a frame.
        adc_bits: Of each stream's converter.
    """

    called = "a sensor board"

    def __init__(
        self,
        source: Bench,
        *,
        boot_s: float = 0.0,
        drift_ppm: float = DRIFT_PPM,
        start_us: int = START_US,
        block_samples: int = BLOCK_SAMPLES,
        adc_bits: Mapping[str, int] = ADC_BITS,
    ) -> None:
        super().__init__()
        self._source = source
        self._boot_s, self._block_samples = boot_s, block_samples
        self._rate, self._start_us = 1.0 + drift_ppm * 1e-6, start_us
        self._channels = [
            Channel(number, spec, adc_bits.get(spec.name, 32)) for number, spec in enumerate(source.streams())
        ]
        self._line = BoardFrameDecoder()
        self._clock: BoardClock | None = None
        self._watchdog_s = math.inf
        self._fed_s = 0.0
        self._answers: list[ReplyStatus] = []
        self._orders: Mapping[int, Callable[[int, BoardClock], bool]] = {
            BoardCode.HELLO: self._hello,
            BoardCode.START: self._start,
            BoardCode.STOP: self._stop,
            BoardCode.EXCITE: self._excite,
            BoardCode.TENDON: self._tendon,
            BoardCode.TARE: self._tare,
            BoardCode.WATCHDOG: self._watch,
        }

    def receive(self, data: bytes, t_s: float) -> bytes:
        """See `EmulatedDevice.receive`."""
        clock = self._run(t_s)
        booting = t_s < clock.power_s + self._boot_s
        for body in self._line.feed(b"" if booting else data):
            try:
                command = decode(body)
            except CodecError:
                continue
            if isinstance(command, CommandFrame):
                self._fed_s = t_s
                status = self._answers.pop(0) if self._answers else self._obey(command, clock)
                self._outbox += encode(BoardReply(command.code, command.tag, status))
        return self._take(t_s)

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """Faults: "refuse" and "busy" answer the next command; "reboot" is a power failure, after which nothing is on;
        "restart" sets clock, counters and zeros back while the streams go on."""
        return {
            "refuse": lambda: self._answers.append(ReplyStatus.REFUSED),
            "busy": lambda: self._answers.append(ReplyStatus.BUSY),
            "reboot": lambda: self._restart(t_s, keep=False),
            "restart": lambda: self._restart(t_s, keep=True),
        }

    # time

    def _run(self, t_s: float) -> BoardClock:
        """Let time pass until `t_s`, and the watchdog trip where it is due."""
        if self._clock is None:
            self._clock = BoardClock(t_s, self._start_us, self._rate)
        starved_s = self._fed_s + self._watchdog_s
        if starved_s <= t_s:
            self._advance(self._clock, starved_s)
            self._switch(0, self._clock, starved_s)
            self._source.excite(False)
            self._fed_s = math.inf  # until the next command
        self._advance(self._clock, t_s)
        return self._clock

    def _advance(self, clock: BoardClock, t_s: float) -> None:
        subscribed = [channel for channel in self._channels if channel.on]
        self._source.advance(t_s, frozenset(channel.spec.name for channel in subscribed))
        for channel in subscribed:
            if channel.spec.rate_hz is None:
                self._send_events(channel, clock)
            else:
                self._sample(channel, clock, t_s, channel.spec.rate_hz)

    def _sample(self, channel: Channel, clock: BoardClock, t_s: float, rate_hz: float) -> None:
        ticks = np.arange(channel.tick, clock.tick(t_s, rate_hz) + 1)
        if not len(ticks):
            return
        times_s = np.minimum(clock.host_s(ticks, rate_hz), t_s)
        counts = channel.convert(self._source.sample(channel.spec.name, times_s))
        channel.waiting = np.concatenate([channel.waiting, counts])
        channel.tick = int(ticks[-1]) + 1
        samples = max(1, min(self._block_samples, int(LONGEST_BLOCK_S * rate_hz)))
        while len(channel.waiting) >= samples:
            self._send_block(channel, clock, rate_hz, samples)

    def _send_block(self, channel: Channel, clock: BoardClock, rate_hz: float, samples: int) -> None:
        first_tick = channel.tick - len(channel.waiting)
        values, channel.waiting = channel.waiting[:samples], channel.waiting[samples:]
        seq = channel.number_block(samples)
        shown_us = clock.tick_us(first_tick, rate_hz)
        self._outbox += encode(BoardSamples(channel.number, seq, shown_us, values.reshape(-1)))

    def _send_events(self, channel: Channel, clock: BoardClock) -> None:
        times_s, values = self._source.events(channel.spec.name)
        shown_us = clock.shown_us(times_s)
        counts = channel.convert(values).reshape(-1)
        for start in range(0, len(counts), self._block_samples):
            part = slice(start, start + self._block_samples)
            seq = channel.number_block(len(counts[part]))
            message = BoardSamples(channel.number, seq, int(shown_us[start]), counts[part], shown_us[part])
            self._outbox += encode(message)

    # commands

    def _obey(self, command: CommandFrame, clock: BoardClock) -> ReplyStatus:
        order = self._orders.get(command.code)
        if order is None:
            return ReplyStatus.UNKNOWN
        return ReplyStatus.OK if order(command.argument or 0, clock) else ReplyStatus.REFUSED

    def _hello(self, _: int, clock: BoardClock) -> bool:
        streams = tuple(
            HelloStream(
                id=channel.number,
                name=channel.spec.name,
                channels=channel.spec.channels,
                rate_hz=channel.spec.rate_hz,
                unit=channel.spec.unit,
                scale=channel.spec.scale,
                kind="times" if channel.spec.rate_hz is None else "samples",
            )
            for channel in self._channels
        )
        # A delimiter ahead: a new client takes nothing before one.
        self._outbox += b"\0" + encode(
            BoardHello(board="emulated sensor board", serial="E1", version="1.0", streams=streams)
        )
        return True

    def _start(self, mask: int, clock: BoardClock) -> bool:
        if mask >> len(self._channels):
            return False
        self._switch(mask, clock, self._fed_s)
        return True

    def _stop(self, _: int, clock: BoardClock) -> bool:
        self._switch(0, clock, self._fed_s)
        return True

    def _switch(self, mask: int, clock: BoardClock, t_s: float) -> None:
        """Send the streams in the mask and no others from `t_s` on; those that stay are not disturbed."""
        for channel in self._channels:
            wanted = bool(mask >> channel.number & 1)
            rate_hz = channel.spec.rate_hz
            if channel.on and not wanted:
                if rate_hz is not None and len(channel.waiting):
                    self._send_block(channel, clock, rate_hz, len(channel.waiting))
                channel.on = False
            elif wanted and not channel.on:
                if rate_hz is None:
                    self._source.events(channel.spec.name)  # what happened while unsubscribed
                channel.start(0 if rate_hz is None else clock.tick(t_s, rate_hz) + 1)

    def _excite(self, on: int, _: BoardClock) -> bool:
        if on not in (0, 1):
            return False
        self._source.excite(bool(on))
        return True

    def _tendon(self, position_um: int, _: BoardClock) -> bool:
        position_m = position_um * 1e-6
        if not TENDON_M[0] <= position_m <= TENDON_M[1]:
            return False
        self._source.set_tendon(position_m)
        return True

    def _tare(self, number: int, _: BoardClock) -> bool:
        return number < len(self._channels) and self._channels[number].tare()

    def _watch(self, period_ms: int, _: BoardClock) -> bool:
        self._watchdog_s = period_ms * 1e-3 if period_ms else math.inf
        return True

    def _restart(self, t_s: float, keep: bool) -> None:
        self._clock = BoardClock(t_s, 0, self._rate)
        for channel in self._channels:
            channel.restart()
            channel.on = channel.on and keep
            channel.tick = 1  # tick 0 is now, and has been sampled
        if not keep:
            self._source.excite(False)
            self._watchdog_s = math.inf


def emulated(settings: object, bench: Bench) -> EmulatedSensorBoard:
    """The board that is wired to the bench's sensors and drive.

    Raises:
        RefusedError: the bench has none.
    """
    part(bench, "streams", "board")
    return EmulatedSensorBoard(bench)
