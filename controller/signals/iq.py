"""The envelope of one finger: I and Q against the drive, out of the sound of both."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from controller.signals.demodulation import SPAN, Fused, Variant, peak
from drivers.core.messages import Floats, SampleBlock, Saturated, StreamInfo
from drivers.core.settings import DriveHz, Mismatch, Settings, StreamName

CARRIER_FROM_HZ: Final = 4000.0
"""A stream with fewer samples a second is an envelope already (bench at envelope level)."""

FULL_SCALE: Final = 1 << 23
"""Counts of a 24-bit converter; sound in floats is rounded to them."""

CLEAR_S: Final = 0.1
"""Time without a clipped frame that ends an excursion to full scale (assumption, as of the audio driver)."""

CONVERTER_HZ: Final = 96_000.0
"""Sample rate of sound in a run; a single recording may have another one."""

GUARD: Final = {"fused": 3.0, "in_phase": 3.0, "cic": 10.0}
"""How far from the drive its image and the converter's own offset must stay, in output rates: beyond, the low-pass
takes 95 dB off them, or 90 dB (`cic`)."""

OUTPUT_MIN_HZ: Final = 100.0
"""Least rate of I and Q: what is slower has no room for undulations (assumption)."""

DRIFT_MAX_PPM: Final = 0.01
"""Clocks that are farther apart are two. At 0.01 ppm a bridge's imbalance of 0.2 of full scale turns by 5e-4 of full
scale a second at 40 kHz, and the level detector still detects a step of 0.001 after 15 s; at 0.02 it misses half of
them, at 0.3 the paper's pre-touch takes the turning itself for an object. On one clock at most 0.004 was measured
(centering, 96 trials of 11 s on the mock bench)."""


class IqSettings(Settings):
    """How a finger's sound becomes I and Q."""

    input: StreamName = "audio.fingers"
    """Stream of the sound of both fingers."""

    channel: int = Field(default=0, ge=0, le=63)
    """The finger's: 0 is the right one, 1 the left."""

    drive_hz: DriveHz = Field(default=40_000.0, gt=0.0, le=500_000.0)
    """Of the tone, to a millihertz. 40 kHz: Rupavatharam et al., III.A.2."""

    output_hz: float = Field(default=1000.0, ge=OUTPUT_MIN_HZ, le=4000.0)
    """I and Q a second; the frame rate is a multiple of it. The drive must be 3 times it or more (`cic`: 10), and as
    far below half the frame rate as 1.5 times it (`cic`: 5)."""

    variant: Variant = "fused"
    """`fused`: a FIR of 6 ms (at 1 kHz out), flat to 0.001 dB from 0 to 100 Hz, 3 ms of delay. `cic`: one of 3 ms, as
    three integrators and combs respond, 1.5 ms of delay, -0.43 dB at 100 Hz. `in_phase`: the paper's, without Q: one
    channel, and blind spots."""

    clocks: Literal["locked", "watched", "tracked"] = "locked"
    """`locked`: drive and converter share a clock. `watched`: the same is assumed, and their difference is measured
    (`drift_ppm`). `tracked`: separate clocks, and their beat is removed; I and Q begin after a second."""

    @model_validator(mode="after")
    def _in_phase_cannot_turn(self) -> IqSettings:
        if self.variant == "in_phase" and self.clocks != "locked":
            raise ValueError(
                f'in-phase alone cannot show a beat: clocks = "{self.clocks}" needs another variant'
            )
        return self

    @property
    def silent_s(self) -> float:
        """Time over which the beat is measured before the first I and Q, s; 0 where it is not tracked."""
        return SEGMENT_S + SPAN / self.output_hz if self.clocks == "tracked" else 0.0

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """What sound at the rate of a run cannot give."""
        unsuitable = self.unsuitable()
        if unsuitable is not None:
            yield Mismatch(path, *unsuitable)

    def unsuitable(self, rate_hz: float = CONVERTER_HZ) -> tuple[str, str] | None:
        """Which setting does not suit sound at this frame rate, and the reason as text; None where all do."""
        output_hz, drive_hz, guard = self.output_hz, self.drive_hz, GUARD[self.variant]
        if rate_hz / output_hz != round(rate_hz / output_hz):
            return "output_hz", f" = {output_hz:g}: {rate_hz:g} frames a second are no multiple of it"
        least_hz, most_hz = guard * output_hz, 0.5 * (rate_hz - guard * output_hz)
        if least_hz <= drive_hz <= most_hz:
            return None
        able = f"{least_hz:g} to {most_hz:g} Hz" if least_hz <= most_hz else "no drive at all"
        reason = (
            f' = {drive_hz:g}: {rate_hz:g} frames a second with variant = "{self.variant}" and output_hz ='
            f" {output_hz:g} can do {able}; {self._remedy(rate_hz)}"
        )
        return "drive_hz", reason

    def _remedy(self, rate_hz: float) -> str:
        """What to do about a drive that sound of this rate cannot hold."""
        slower_hz = min(self.drive_hz, rate_hz - 2.0 * self.drive_hz) / GUARD[self.variant]
        if slower_hz >= OUTPUT_MIN_HZ:
            return f"lower output_hz to {rate_hz / math.ceil(rate_hz / slower_hz):g}"
        if rate_hz < CONVERTER_HZ:
            return f"record at {CONVERTER_HZ:.0f} Hz"
        return "choose another drive"


class Iq:
    """Sound → I and Q of one finger, full scale 1.0: a tone a cos(phase of the drive + p) is (a cos p, a sin p).

    Frames are numbered: the drive's phase is zero at frame 0, so that a gap does not shift it. Outputs with an
    incomplete window are omitted, which leaves a jump in `seq`; values that are not finite count as lost. An
    output's time is the middle of its window. A stream below 4 kHz counts as an envelope, (I0, Q0, I1, Q1, …), and the
    finger's pair is passed on.

    A finger at full scale is reported as `Saturated`, once each time.

    Args:
        name: In the profile; the stream is `signals.<name>`.
    """

    def __init__(self, name: str, settings: IqSettings) -> None:
        self.name = name
        self.inputs = (settings.input,)
        channels = ("I",) if settings.variant == "in_phase" else ("I", "Q")
        self.info = StreamInfo(f"signals.{name}", channels, "FS")
        self._settings = settings
        self._demodulator: Fused | None = None
        self._rate_hz = math.nan
        self.reset()

    @property
    def drift_ppm(self) -> float:
        """How much faster the drive's clock is than the converter's; NaN while unknown, or if `locked`.

        Measurable only on a finger whose bridge's imbalance exceeds its signal.
        """
        return math.nan if self._beat is None else 1e6 * self._beat.hz / self._settings.drive_hz

    def account(self) -> Mapping[str, object]:
        """The clocks, for the manifest: `drift_ppm`, and a `warning` where separate clocks are used as one.

        Empty while unknown, or where the clocks are `locked`.
        """
        drift_ppm = self.drift_ppm
        if math.isnan(drift_ppm):
            return {}
        clocks = self._settings.clocks
        found: dict[str, object] = {"clocks": clocks, "drift_ppm": drift_ppm}
        if clocks == "watched" and abs(drift_ppm) > DRIFT_MAX_PPM:
            found["warning"] = (
                f"{self.info.name}: drive and converter are {abs(drift_ppm):.3g} ppm apart, more than "
                f'{DRIFT_MAX_PPM:g}: set clocks = "tracked", or use one card for both'
            )
        return found

    def reset(self) -> None:
        """Return to the initial state."""
        if self._demodulator is not None:
            self._demodulator.reset()
        self._beat: Beat | None = None
        self._clipped = -math.inf  # frame

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""
        settings = self._settings
        counts = np.zeros((round(16 * CONVERTER_HZ / settings.output_hz), settings.channel + 1), np.int32)
        silence = SampleBlock(settings.input, 0, 0.0, counts, rate_hz=CONVERTER_HZ, scale=1.0 / FULL_SCALE)
        Iq(self.name, settings).push(silence)

    def push(self, block: SampleBlock) -> Sequence[SampleBlock | Saturated]:
        """Process the next frames of both fingers.

        Raises:
            ValueError: the stream is at irregular times, has no such channel, or its rate does not suit drive and
                output.
        """
        rate_hz = block.rate_hz
        if rate_hz is None:
            raise ValueError(f"{block.stream}: samples at irregular times have no I and Q; it needs sound")
        if not len(block):
            return ()
        return (self._envelope if rate_hz < CARRIER_FROM_HZ else self._carrier)(block, rate_hz)

    # sound

    def _carrier(self, block: SampleBlock, rate_hz: float) -> list[SampleBlock | Saturated]:
        settings = self._settings
        if settings.channel >= block.values.shape[1]:
            raise self._missing(block, settings.channel + 1)
        if self._demodulator is None or rate_hz != self._rate_hz:
            self._demodulator, self._rate_hz = self._made(block.stream, rate_hz), rate_hz
        demodulator = self._demodulator
        decimation = round(rate_hz / settings.output_hz)
        unit = block.scale if block.values.dtype.kind == "i" else 1.0 / FULL_SCALE
        made: list[SampleBlock | Saturated] = []
        for frame, counts in _runs(block, settings.channel):
            first, values = demodulator.push(counts, frame)
            if len(values):
                middle = (first + 1) * decimation - 1 - demodulator.delay_frames
                later_s = (middle - block.seq) / rate_hz
                made += self._blocks(block, first, values * unit, settings.output_hz, later_s)
            made += self._excursions(block, rate_hz, frame, counts)
        return made

    def _made(self, stream: str, rate_hz: float) -> Fused:
        settings = self._settings
        unsuitable = settings.unsuitable(rate_hz)
        if unsuitable is not None:
            raise ValueError(f"{stream}: {self.info.name} {unsuitable[0]}{unsuitable[1]}")
        decimation = round(rate_hz / settings.output_hz)
        return Fused(settings.channel, settings.drive_hz, rate_hz, decimation, settings.variant)

    def _excursions(
        self, block: SampleBlock, rate_hz: float, frame: int, counts: NDArray[np.int32]
    ) -> Iterator[Saturated]:
        whole = block.values.dtype.kind == "i"
        full = round(1.0 / block.scale) if whole else FULL_SCALE
        rail = full - (1 if whole else FULL_SCALE // 2**15)  # a file's shares may be those of 16 bits
        if peak(counts, self._settings.channel) < rail:
            return
        counts = counts[:, self._settings.channel]
        clear = CLEAR_S * rate_hz
        places = np.flatnonzero((counts >= rail) | (counts <= -rail - 1))
        before = np.concatenate(([self._clipped], frame + places[:-1]))
        self._clipped = frame + float(places[-1])
        for place in places[frame + places - before > clear].tolist():
            t_s = block.t0_s + (frame + place - block.seq) / rate_hz
            yield Saturated(t_s, "signals", self.info.name, float(counts[place]) / full)

    # an envelope

    def _envelope(self, block: SampleBlock, rate_hz: float) -> list[SampleBlock | Saturated]:
        if block.unit != self.info.unit:
            raise ValueError(
                f"{block.stream}: {rate_hz:g} samples a second in {block.unit or 'no unit'} are neither sound"
                f" nor an envelope ({self.info.unit}); set the input of {self.info.name} to the fingers' stream"
            )
        pair = slice(2 * self._settings.channel, 2 * self._settings.channel + 2)
        if block.values.shape[1] < pair.stop:
            raise self._missing(block, pair.stop)
        values = np.asarray(block.values[:, pair] * block.scale, np.float64)
        good = np.asarray(np.isfinite(values).all(axis=1))
        made: list[SampleBlock | Saturated] = []
        for first, last in _stretches(good):
            later_s = first / rate_hz
            made += self._blocks(block, block.seq + first, values[first:last], rate_hz, later_s)
        return made

    # both

    def _blocks(
        self,
        block: SampleBlock,
        seq: int,
        values: Floats,
        rate_hz: float,
        later_s: float,
    ) -> list[SampleBlock | Saturated]:
        """What comes out: `values` from number `seq` on, `later_s` after the block's first sample."""
        settings = self._settings
        if settings.clocks != "locked":
            if self._beat is None:
                self._beat = Beat(rate_hz)
            z = np.ascontiguousarray(values).view(np.complex128)[:, 0]
            still = self._beat.push(z, seq)
            if settings.clocks == "tracked":
                values = still.view(np.float64).reshape(-1, 2)
                seq, later_s = seq + len(z) - len(still), later_s + (len(z) - len(still)) / rate_hz
        if not len(values):
            return []
        return [
            SampleBlock(
                self.info.name,
                seq,
                block.t0_s + later_s,
                values[:, : len(self.info.channels)],
                rate_hz=rate_hz,
                unit=self.info.unit,
                device_t0_s=None if block.device_t0_s is None else block.device_t0_s + later_s,
                arrival_s=block.arrival_s,
            )
        ]

    def _missing(self, block: SampleBlock, needed: int) -> ValueError:
        has = block.values.shape[1]
        return ValueError(
            f"{block.stream}: {has} channel{'s' if has > 1 else ''} where {self.info.name} needs {needed}; "
            "record both fingers, and set its `channel`"
        )


def _stretches(good: NDArray[np.bool_]) -> Iterator[tuple[int, int]]:
    """Where runs of good samples begin, and end before."""
    if good.all():  # as nearly always, and much faster
        yield 0, len(good)
        return
    edges = np.flatnonzero(np.diff(good.astype(np.int8), prepend=0, append=0))
    yield from zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)


def _runs(block: SampleBlock, channel: int) -> Iterator[tuple[int, NDArray[np.int32]]]:
    """A block's frames without a gap, those that are finite in this channel: number of the first, and int32 counts."""
    values = block.values
    if values.dtype.kind == "i":
        if block.scale * FULL_SCALE < 1.0:
            raise ValueError(f"{block.stream}: counts of more than 24 bits; choose a 24-bit format")
        yield block.seq, values  # type: ignore[misc]
        return
    shares = values * block.scale
    limit = np.where(np.isfinite(shares), np.clip(shares, -1.0, 1.0 - 1.0 / FULL_SCALE), 0.0)
    counts = np.rint(limit * FULL_SCALE).astype(np.int32)
    for first, last in _stretches(np.isfinite(shares[:, channel])):
        yield block.seq + first, counts[first:last]


Complexes = NDArray[np.complex128]

SEGMENT_S: Final = 1.0
"""Interval between phase estimates. Assumption: 40 us of two crystals 20 ppm apart are 0.8 of a turn."""

MEMORY_S: Final = 60.0
"""The weight of an estimate falls to 1/e in this time. Assumption: crystals warm up in minutes."""

CHANGES, SIGMAS = 2.0, 3.0
"""A change of the beat is followed where it explains as many times what it leaves of the estimates' variance, and by
as many standard deviations. Assumption: of two crystals of one temperature, or of a finger that moves, it does not."""

QUIETEST_RAD: Final = 1e-5
"""Least phase noise of an estimate: 24-bit quantization of a tone at a hundredth of full scale."""


class Beat:
    """Estimates the beat of I + jQ, once a second, and removes it.

    A line is fitted to the phase of each second, and the slopes are averaged with the inverse of the residual variance:
    quiet seconds count for thousands of others, a contact's step for nothing. Where they change with time beyond doubt,
    as while a crystal warms up, a line through them is followed instead of their mean. Only a steady turn about the
    origin is removed: slow drifts, undulations and steps stay, whatever their frequency.

    Attributes:
        turn_rad: The beat expected of the next second, radians a sample; NaN until the first second is over.
    """

    def __init__(self, rate_hz: float) -> None:
        self._size = max(8, round(SEGMENT_S * rate_hz))
        self._keep = math.exp(-self._size / (rate_hz * MEMORY_S))
        self._rate_hz = rate_hz
        place = np.arange(self._size) - 0.5 * (self._size - 1)
        self._line = place / np.sum(place**2)
        self._place = place
        self.turn_rad = math.nan
        # Of the weights times 1, x, x^2, y, x y and y^2: the slope y of the second that is x before the next one.
        self._sums = np.zeros(6)
        self._squares = 0.0  # of the weights
        self._begun = np.empty(0, np.complex128)
        self._next: int | None = None
        self._angle_rad = 0.0

    @property
    def hz(self) -> float:
        """The beat; positive where the drive is faster than the converter believes."""
        return self.turn_rad / (2.0 * math.pi) * self._rate_hz

    def push(self, z: Complexes, number: int) -> Complexes:
        """Process the next samples, the first of them the stream's `number`-th.

        Returns:
            The last of them, those after the first second, turned back.
        """
        if self._next is not None and number != self._next:
            passed = len(self._begun) + number - self._next
            self._begun = self._begun[:0]
            if not math.isnan(self.turn_rad):
                self._angle_rad = (self._angle_rad + self.turn_rad * passed) % (2.0 * math.pi)
            self._pass(passed / self._size)
        self._next = number + len(z)
        still = []
        while len(z):
            taken = z[: self._size - len(self._begun)]
            z = z[len(taken) :]
            if not math.isnan(self.turn_rad):
                # from the segment's beginning, so that blocks change nothing
                places = np.arange(len(self._begun), len(self._begun) + len(taken))
                still.append(taken * np.exp(-1j * (self._angle_rad + self.turn_rad * places)))
            self._begun = np.concatenate((self._begun, taken))
            if len(self._begun) == self._size:
                self._look(self._begun)
                self._begun = self._begun[:0]
        return np.concatenate(still) if still else np.empty(0, np.complex128)

    def _look(self, z: Complexes) -> None:
        if not math.isnan(self.turn_rad):
            self._angle_rad = (self._angle_rad + self.turn_rad * len(z)) % (2.0 * math.pi)
        phases = np.unwrap(np.angle(z))
        slope = float(self._line @ phases)
        rest = phases - np.mean(phases) - slope * self._place
        weight = 1.0 / (float(np.mean(rest**2)) + QUIETEST_RAD**2)
        self._sums = self._keep * self._sums + weight * np.array([1.0, 0.0, 0.0, slope, 0.0, slope**2])
        self._squares = self._keep**2 * self._squares + weight**2
        self._pass(1.0)
        self.turn_rad = self._expected()

    def _pass(self, seconds: float) -> None:
        w, x, xx, y, xy, yy = self._sums
        later_xx = xx - 2.0 * seconds * x + seconds**2 * w
        self._sums = np.array([w, x - seconds * w, later_xx, y, xy - seconds * y, yy])

    def _expected(self) -> float:
        """Of the next second: the mean, or the line as far as it is beyond doubt."""
        w, x, xx, y, xy, yy = self._sums.tolist()
        mean, count = y / w, w**2 / self._squares
        spread, common = xx - x**2 / w, xy - x * y / w
        if count <= 3.0 or spread <= 0.0 or common == 0.0:
            return mean
        explained = common**2 / spread
        doubt = max(0.0, yy - y * mean - explained) / explained * max(CHANGES, SIGMAS**2 / (count - 2.0))
        return mean - max(0.0, 1.0 - doubt) * common / spread * x / w
