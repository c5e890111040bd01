"""Slip from the vibration of a force sensor: the paper's spectral peak; unpredicted knocks, and octaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from behaviors.events import BaselineReady, BaselineRefused, Detected, SlipEnded, SlipStarted
from controller.detectors.protocol import NOTHING, Quantity, decisions
from controller.signals.spectrum_blocks import SpectrumBlocks
from drivers.core.messages import SampleBlock
from drivers.core.settings import Settings, StreamName

if TYPE_CHECKING:
    from controller.signals.evidence import Odds
    from controller.signals.whitening import Predictor, Settling

Floats = NDArray[np.float64]


class SlipStreamSettings(Settings):
    """Input settings of every slip detector."""

    input: StreamName = "board.tangential"
    """Stream of the force sensor."""

    channel: int | None = Field(default=None, ge=0, le=4095)
    """Which of its channels; None uses all of them."""

    def chosen(self, values: Floats) -> Floats:
        """The channels in use, shape (n, 1) or (n, channels).

        Raises:
            ValueError: the stream has fewer channels.
        """
        if self.channel is None:
            return values
        if self.channel >= values.shape[1]:
            raise ValueError(
                f"{self.input}: no channel {self.channel} while detecting slip: it has {values.shape[1]}; count from 0"
            )
        return values[:, self.channel : self.channel + 1]


class SlipPaperSettings(SlipStreamSettings):
    """The paper's criterion."""

    block_s: float = Field(default=0.064, gt=0.0, le=60.0)
    """Length of a block (section 3: N = 64 at 1 kHz; section 5.4: N = 16 at 100 Hz, 0.16 s)."""

    threshold: float = Field(default=10.0, gt=0.0, le=1e300)
    """Peak x frequency that means slip, the input's unit squared x Hz (4.3: 10, 5.1: 0.25)."""


class SlipPaperDetector:
    """Slip while the peak of a block's power spectrum times the peak's frequency exceeds a threshold.

    Every N samples: DFT without its DC term, power |Phi(k)|^2 / N, the largest k. Of several channels the one with
    the highest frequency decides. `SlipStarted` comes with the last sample of the first block above the threshold,
    `SlipEnded` with that of the first block below. A gap begins a new block; a block with a value that is not
    finite is skipped.

    Reference: R. Fernandez, I. Payo, A. S. Vazquez, J. Becedas, "Micro-Vibration-Based Slip Detection in Tactile
    Force Sensors", Sensors 2014, 14, section 3.

    Example:
        >>> detector = SlipPaperDetector("slip", SlipPaperSettings())
        >>> tone = 0.2 * np.sin(2 * np.pi * 180.0 * np.arange(64) / 1000.0)
        >>> detector.push(SampleBlock("board.tangential", 0, 0.0, tone[:, None], rate_hz=1000.0))[0].t_s
        0.063
    """

    quantity = Quantity("spectral product", "")

    def __init__(self, name: str, settings: SlipPaperSettings) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input,)
        self.reset()

    def reset(self) -> None:
        """Clear the block begun and the slip."""
        self.readings = NOTHING
        self._blocks: SpectrumBlocks | None = None
        self._next_seq: int | None = None
        self._slipping = False

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next samples."""
        rate_hz = _rate_hz(block)
        if self._blocks is None:
            self._blocks = SpectrumBlocks(self._size(rate_hz))
        if self._next_seq is not None and block.seq != self._next_seq:
            self._blocks.reset()
        self._next_seq = block.seq + len(block)
        ends, products = self._products(self._blocks, self.settings.chosen(block.physical), rate_hz)
        self.readings = decisions(block.times[ends], products, self.settings.threshold)
        events: list[Detected] = []
        for t_s, product in zip(block.times[ends].tolist(), products.tolist(), strict=True):
            if not math.isnan(product) and (product > self.settings.threshold) != self._slipping:
                self._slipping = not self._slipping
                kind = SlipStarted if self._slipping else SlipEnded
                events.append(kind(t_s, self.name, product, self.settings.threshold))
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Peak x frequency at the last sample of each block, NaN elsewhere, shape (n,)."""
        found = np.full(len(values), np.nan)
        ends, products = self._products(
            SpectrumBlocks(self._size(rate_hz)), self.settings.chosen(values), rate_hz
        )
        found[ends] = products
        return found

    def _size(self, rate_hz: float) -> int:
        return round(self.settings.block_s * rate_hz)

    @staticmethod
    def _products(blocks: SpectrumBlocks, values: Floats, rate_hz: float) -> tuple[NDArray[np.int64], Floats]:
        ends, power, frequency_hz = blocks.push(values, rate_hz)
        if not len(ends):
            return ends, np.empty(0)
        # NaN never wins, and of equal frequencies the first channel does
        deciding = np.argmax(np.where(np.isnan(frequency_hz), -1.0, frequency_hz), axis=1)
        rows = np.arange(len(ends))
        return ends, power[rows, deciding] * frequency_hz[rows, deciding]


STORED_RATIO = 3.0
"""A first second that vibrates this many times as strongly as the stored quiet is refused. Assumption: noise of one
sensor differs by less from day to day, a slip by more."""

FOLLOW_SAMPLES = 50.0
"""Samples that suffice to follow a running median: at 10 kHz noise that grows is followed in 5 ms. Chosen on the
choosing half of the recordings and on simulated seeds from 40,000 on, as is DENSE. With 25 samples steps of noise to
twice are called slip at 11 nats in 0 to 5 % instead of 20 to 50, but the recordings' slips are detected after 19 ms and
75 (nine in ten) instead of 15 and 70, and half of BarrettHand's among bumps after 33 ms instead of 27."""

FOLLOWED_DENSE_NAT, FOLLOWED_RARE_NAT, DENSE = math.log(2.25), math.log(9.0), 0.2
"""So far the median is followed where a fifth of the samples are knocks, as at 1 kHz, and where hardly any are: there
noise three times as strong is followed. Where they are dense, slip lifts the median itself, and a slip that lasts
would be followed as noise; in between by proportion."""

PATIENCE = 2.0
"""A detector that has learned nothing after this many times its learning time reports so."""


class SlipSettings(SlipStreamSettings):
    """Settings of the detector that waits for several knocks. Times in seconds: they hold at any sample rate."""

    threshold: float = Field(default=25.0, gt=0.0, le=1e12)
    """Evidence that means slip, nats; calibrate it on a recording without slip. Beyond 15, as by default, only several
    knocks reach it, so bumps do not: the simulated sensors ask for 17.0 to 23.5 for one false alarm an hour among
    bumps (six hours each, benchmarks/results/slip_thresholds.md), and none of 64 recorded blows reaches it. Below 15
    vibration alone reaches it, too: slip is detected sooner, but so is a single blow."""

    quiet_rms: float | None = Field(default=None, gt=0.0, le=1e300)
    """Vibration above 15 Hz in quiet, in the input's unit: `value` of an earlier `BaselineReady`. Where it is given, a
    first second that is three times as loud is refused, by name, and learning begins anew."""

    knocks_hz: float = Field(default=200.0, ge=1e-6, le=1e5)
    """How often stick-slip releases while it slips, Hz. Assumption: about once a period of the structure; half or
    twice as much changes the delay by a third."""

    jumps_hz: float = Field(default=1.0, ge=1e-6, le=1e3)
    """How often something knocks while it does not slip, Hz. The study's bumps."""

    jump_s: float = Field(default=0.009, gt=0.0, le=1.0)
    """A knock counts once in this time, s: longer than a blow lasts. Chosen on simulated bumps and load steps of 3
    ms."""

    knock_ratio: float = Field(default=30.0, gt=1.0, le=1e6)
    """Variance of a knock over that of noise. The bounded likelihood hardly depends on it."""

    order: int = Field(default=16, ge=2, le=64)
    """Past values that the prediction uses. Sixteen predict a ring at a tenth of the sample rate in noise; ten do
    not."""

    model_error: float = Field(default=0.1, ge=0.0, le=1.0)
    """Part of a ring's amplitude that the prediction may miss."""

    memory_s: float = Field(default=4.0, gt=0.0, le=3600.0)
    """Memory of the ringing's shape, s."""

    energy_s: float = Field(default=0.01, gt=0.0, le=10.0)
    """Memory of the ringing's strength, s."""

    scale_s: float = Field(default=2.0, ge=1e-3, le=3600.0)
    """How fast the noise level is followed, s."""

    follow_s: float = Field(default=0.05, gt=0.0, le=60.0)
    """Time in which the running median of the innovations, the reference for knocks and octaves, follows by a factor e,
    s; 50 samples where those are less. It follows to 1.5 times the amplitude of noise at 1 kHz, to 2.8 times
    at 10 kHz."""

    vibration_s: float = Field(default=0.032, gt=0.0, le=1.0)
    """Longest window in which innovations are compared with noise, s."""

    learn_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Time of the first noise estimate, s; armed after twice this time."""

    hold_s: float = Field(default=0.05, ge=0.0, le=10.0)
    """The evidence must have stayed one knock's worth below the threshold for so long before a slip is over, s."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """A longer gap restarts learning. Assumption: a slip is over or lost by then, and the quiet level may have
    changed."""


class SlipDetector:
    """Slip when knocks come faster than bumps do, or when the whole spectrum rises at once.

    Three opinions on one scale, nats; the evidence is the larger of knocks and vibration.

    *Knocks*: the signal's second difference is predicted from its own past, so that offset, load ramps, rolling and
    the ringing of the structure are predicted. The innovation, over noise whose running median is followed, is judged
    by the log-likelihood ratio of "knocks at `knocks_hz`" against "knocks at `jumps_hz`". No single sample can
    drive it beyond ln(knocks_hz / jumps_hz), and a blow of less than `jump_s` cannot add twice. The sum is kept from
    falling below zero (Page's CUSUM).

    *Vibration*: the smaller of what three neighbouring octaves from 15 Hz together exceed their own quiet by, and of
    the likelihood ratio of a larger innovation. Hum shakes one octave; a starting arm makes no innovation. It
    is worth 15 nats at most: one blow rings as a slip does.

    It needs `2 * learn_s` to arm after a reset or a gap beyond `max_gap_s`, and emits `BaselineReady` (`value`: the
    vibration in quiet, root mean square) or `BaselineRefused`. Of several channels the one with the
    most evidence decides. `SlipEnded` comes when the evidence has been one knock's worth
    below the threshold for `hold_s`.

    References: E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954); P. J. Huber, "A robust version of
    the probability ratio test", Ann. Math. Statist. 36 (1965). docs/explanation/slip.md derives it.

    Example:
        >>> detector = SlipDetector("slip", SlipSettings(threshold=20.0))
        >>> detector.inputs
        ('board.tangential',)
    """

    quantity = Quantity("evidence of slip", "nat")

    def __init__(self, name: str, settings: SlipSettings) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input,)
        self.reset()

    def reset(self) -> None:
        """Clear noise, ringing and evidence."""
        self.readings = NOTHING
        self._channels: list[_Channel] = []
        self._next_seq: int | None = None
        self._slipping = False
        self._below = 0
        self._received = 0
        self._ready_reported = False
        self._refusal_reported = False

    def arming_s(self, rate_hz: float) -> float:
        """Learning time after a reset, s: no events before its end."""
        return 2 * _settling(self.settings, rate_hz).learn / rate_hz

    def least_delay_s(self, rate_hz: float) -> float:
        """Shortest detection delay from a slip's first sample, with no evidence before, s.

        Vibration is worth `MOST_VIBRATION_NAT` at most; beyond that no sample is worth more than one knock, and after
        the first none more than the credit regained in its time.
        """
        from controller.signals.evidence import MOST_VIBRATION_NAT

        odds, threshold = _odds(self.settings, rate_hz), self.settings.threshold
        if threshold < max(odds.cap, MOST_VIBRATION_NAT):
            return 1.0 / rate_hz
        return math.ceil((threshold - odds.cap) / min(odds.cap, odds.refill)) / rate_hz

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""
        self.statistic(np.zeros((64, (self.settings.channel or 0) + 1)), 1000.0)

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next samples."""
        begun_anew = self._begin(block)
        trace = self.evidence(block)
        events = [] if self._ready_reported else self._baseline(block)
        threshold = self.settings.threshold
        self.readings = decisions(block.times, trace, threshold)
        if begun_anew and self._slipping:
            self._slipping = False
            events.append(SlipEnded(float(block.times[0]), self.name, 0.0, threshold))
        if self._slipping or (len(trace) and trace.max() > threshold):
            times_s = block.times
            for i in self._changes(trace, round(self.settings.hold_s * _rate_hz(block))):
                kind = SlipStarted if trace[i] > threshold else SlipEnded
                events.append(kind(float(times_s[i]), self.name, float(trace[i]), threshold))
        return sorted(events, key=lambda event: event.t_s)

    def _changes(self, trace: Floats, hold: int) -> list[int]:
        """Samples at which slip begins: above the threshold; and ends: one knock's worth below, for so many samples."""
        threshold = self.settings.threshold
        over = trace > max(0.5 * threshold, threshold - self._channels[0].odds.cap)
        changes: list[int] = []
        begin = 0
        while begin < len(trace):
            if not self._slipping:
                above = np.flatnonzero(trace[begin:] > threshold)
                if not above.size:
                    break
                place = begin + int(above[0])
                self._below = 0
            else:
                marks = np.concatenate(
                    [[-1 - self._below], np.flatnonzero(over[begin:]), [len(trace) - begin]]
                )
                long = np.flatnonzero(np.diff(marks) > hold)
                if not long.size:
                    self._below = int(len(trace) - begin - 1 - marks[-2])
                    break
                place = begin + int(marks[long[0]]) + max(1, hold)
            self._slipping = not self._slipping
            changes.append(place)
            begin = place + 1
        return changes

    def _begin(self, block: SampleBlock) -> bool:
        """Reset after a long gap or a restart of the stream; returns whether."""
        if self._next_seq is None:
            return False
        lost = block.seq - self._next_seq
        if 0 <= lost <= self.settings.max_gap_s * _rate_hz(block):
            return False
        slipping = self._slipping
        self.reset()
        self._slipping = slipping
        return True

    def _baseline(self, block: SampleBlock) -> list[Detected]:
        """Report that the quiet level is learned, or cannot be; once each."""
        before = self._received
        self._received += len(block)
        events: list[Detected] = []
        armed = [channel for channel in self._channels if channel.armed is not None]
        first = min(armed, key=lambda channel: channel.armed or 0, default=None)
        ready = (first.armed or 0) if first else len(block)
        late = round(PATIENCE * self.arming_s(_rate_hz(block)) * _rate_hz(block)) - before - 1
        refused = sorted(found for channel in self._channels for found in channel.refused)
        if (
            refused
            and refused[0][0] < min(ready, late if late >= 0 else ready)
            and not self._refusal_reported
        ):
            place, level = refused[0]
            stored = self.settings.quiet_rms or math.nan
            reason = (
                f"the first {self.arming_s(_rate_hz(block)):g} s vibrate with {level:.3g}, the stored quiet is"
                f" {stored:.3g}: does it slip already, or is quiet_rms that of another sensor?"
            )
            self._refusal_reported = True
            events.append(
                BaselineRefused(float(block.times[place]), self.name, level, STORED_RATIO * stored, reason)
            )
        if 0 <= late < ready and not self._refusal_reported:
            reason = (
                "no quiet could be learned: the samples are constant, or not finite; is the sensor alive?"
            )
            self._refusal_reported = True
            events.append(
                BaselineRefused(float(block.times[late]), self.name, 0.0, self.settings.threshold, reason)
            )
        if first:
            self._ready_reported = True
            events.append(
                BaselineReady(float(block.times[ready]), self.name, first.quiet, self.settings.threshold)
            )
        return events

    def evidence(self, block: SampleBlock) -> Floats:
        """Process the next samples.

        Returns:
            Evidence after each, nats, capped at one knock's worth above the threshold; 0 while it learns, shape (n,).
        """
        values, rate_hz = self.settings.chosen(block.physical), _rate_hz(block)
        if not self._channels:
            self._channels = [_Channel(self.settings, rate_hz) for _ in range(values.shape[1])]
        if self._next_seq is not None and block.seq != self._next_seq:
            for channel in self._channels:
                channel.skip(block.seq - self._next_seq)
        self._next_seq = block.seq + len(block)
        trace = self._largest_evidence(
            self._channels, values, self.settings.threshold + self._channels[0].odds.cap
        )
        trace[np.isnan(trace)] = 0.0
        return trace

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Evidence after each sample of a whole recording, nats, shape (n,); NaN for the `2 * learn_s` in which it
        learns."""
        chosen = self.settings.chosen(values)
        channels = [
            _Channel(self.settings.model_copy(update={"quiet_rms": None}), rate_hz)
            for _ in range(chosen.shape[1])
        ]
        return self._largest_evidence(channels, chosen, math.inf)

    @staticmethod
    def _largest_evidence(channels: Sequence[_Channel], values: Floats, ceiling: float) -> Floats:
        traces = [
            channel.evidence(np.ascontiguousarray(values[:, i]), ceiling)
            for i, channel in enumerate(channels)
        ]
        most: Floats = traces[0] if len(traces) == 1 else np.fmax.reduce(traces, axis=0)
        return most


class _Channel:
    """Predictor, octaves and evidence of one channel.

    Attributes:
        armed: The sample of the last block at which the quiet level was learned; None in other blocks.
        quiet: The vibration in quiet.
        refused: Samples of the last block at which the learned level exceeded the stored quiet, and that level.
    """

    def __init__(self, settings: SlipSettings, rate_hz: float) -> None:
        from controller.signals import evidence, octaves, whitening

        self._accumulate = evidence.accumulate
        self._stored = settings.quiet_rms
        self._places = evidence
        self._whitening = whitening
        self.odds = _odds(settings, rate_hz)
        self._settling = _settling(settings, rate_hz)
        self._predictor: Predictor = whitening.predictor(settings.order, self._settling.learn)
        self._octaves = octaves.octaves(rate_hz)
        self._state = np.zeros(9)
        self._state[evidence.CREDIT] = self.odds.cap
        self._totals = np.zeros(max(2, round(settings.vibration_s * rate_hz) + 1))
        self.quiet = 0.0
        self.armed: int | None = None
        self.refused: list[tuple[int, float]] = []

    def evidence(self, x: Floats, ceiling: float) -> Floats:
        """Evidence after each sample, shape (n,); NaN while it learns."""
        out = np.empty(x.size)
        self.armed, self.refused = None, []
        begin = 0
        while begin < x.size:
            knew = self._state[self._places.USED] > 0.0
            begin += self._accumulate(
                self.odds,
                self._settling,
                self._predictor,
                self._octaves,
                self._state,
                self._totals,
                x[begin:],
                ceiling,
                out[begin:],
            )
            if not knew and self._state[self._places.USED] > 0.0:
                self._judge(begin - 1, out)
        return out

    def _judge(self, place: int, out: Floats) -> None:
        """Accept the learned quiet level, or learn again."""
        self.quiet = float(self._state[self._places.QUIET])
        if self._stored is None or self.quiet <= STORED_RATIO * self._stored:
            self.armed = place
            return
        self.refused.append((place, self.quiet))
        self._predictor.counts[self._whitening.COUNT] = 0
        self._state[self._places.USED] = 0.0
        self._state[self._places.SUM] = 0.0
        out[place] = math.nan

    def skip(self, samples: int) -> None:
        """Skip lost samples."""
        self._predictor.counts[self._whitening.FRESH] = 0
        self._state[self._places.MISSING] += samples


def _odds(s: SlipSettings, rate_hz: float) -> Odds:
    from controller.signals.evidence import Odds

    # at low rates knocks come with every sample: probabilities stay below 1, and a jump the rarer
    knock = min(0.3, s.knocks_hz / rate_hz)
    jump = min(0.2 * knock, s.jumps_hz / rate_hz)
    cap = math.log(knock / jump)
    return Odds(
        knock,
        jump,
        s.knock_ratio,
        cap,
        cap / (s.jump_s * rate_hz),
        round(s.max_gap_s * rate_hz) + s.order + 2,
        1.0 / min(s.follow_s * rate_hz, FOLLOW_SAMPLES),
        FOLLOWED_DENSE_NAT + (FOLLOWED_RARE_NAT - FOLLOWED_DENSE_NAT) * max(0.0, 1.0 - knock / DENSE),
    )


def _settling(s: SlipSettings, rate_hz: float) -> Settling:
    from controller.signals.whitening import Settling

    return Settling(
        learn=max(2 * s.order, round(s.learn_s * rate_hz)),
        keep=math.exp(-1.0 / (s.memory_s * rate_hz)),
        keep_energy=math.exp(-1.0 / (s.energy_s * rate_hz)),
        scale=s.scale_s * rate_hz,
        model_error=s.model_error,
    )


def _rate_hz(block: SampleBlock) -> float:
    if block.rate_hz is None:
        raise ValueError(
            f"{block.stream}: samples at irregular times while detecting slip; give it a stream with a rate"
        )
    return block.rate_hz
