"""Slip from the vibration of a force sensor: the paper's spectral peak, and knocks that no past foretells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from behaviors.events import Detected, SlipEnded, SlipStarted
from controller.signals.spectrum_blocks import SpectrumBlocks
from drivers.messages import SampleBlock
from drivers.settings import Settings, StreamName

if TYPE_CHECKING:
    from controller.signals.evidence import Odds
    from controller.signals.whitening import Predictor, Settling

Floats = NDArray[np.float64]


class SlipStreamSettings(Settings):
    """What every slip detector must know of its input."""

    input: StreamName = "board.tangential"
    """Stream of the force sensor."""

    channel: int | None = Field(default=None, ge=0, le=4095)
    """Which of its channels; None hears all of them."""

    def chosen(self, values: Floats) -> Floats:
        """The channels to hear, shape (n, 1) or (n, channels).

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
    finite says nothing.

    Reference: R. Fernandez, I. Payo, A. S. Vazquez, J. Becedas, "Micro-Vibration-Based Slip Detection in Tactile
    Force Sensors", Sensors 2014, 14, section 3.

    Example:
        >>> detector = SlipPaperDetector("slip", SlipPaperSettings())
        >>> tone = 0.2 * np.sin(2 * np.pi * 180.0 * np.arange(64) / 1000.0)
        >>> detector.push(SampleBlock("board.tangential", 0, 0.0, tone[:, None], rate_hz=1000.0))[0].t_s
        0.063
    """

    def __init__(self, name: str, settings: SlipPaperSettings) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input,)
        self.reset()

    def reset(self) -> None:
        """Forget the block begun and the slip."""
        self._blocks: SpectrumBlocks | None = None
        self._next_seq: int | None = None
        self._slipping = False

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Hear the next samples."""
        rate_hz = _rate_hz(block)
        if self._blocks is None:
            self._blocks = SpectrumBlocks(self._size(rate_hz))
        if self._next_seq is not None and block.seq != self._next_seq:
            self._blocks.reset()
        self._next_seq = block.seq + len(block)
        ends, products = self._products(self._blocks, self.settings.chosen(block.physical), rate_hz)
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


class SlipSettings(SlipStreamSettings):
    """The detector that waits for several knocks. Times in seconds: they hold at any sample rate."""

    threshold: float = Field(default=25.0, gt=0.0, le=1e12)
    """Evidence that means slip, nats. Default: one false alarm in an hour of bumps on the simulated sensors of
    benchmarks/slip; calibrate it on a recording without slip."""

    knocks_hz: float = Field(default=200.0, gt=0.0, le=1e5)
    """How often friction lets go while it slips, Hz. Assumption: about once a period of the structure; half or
    twice as much changes the delay by a third."""

    jumps_hz: float = Field(default=1.0, gt=0.0, le=1e3)
    """How often something knocks while it does not slip, Hz. The study's bumps."""

    jump_s: float = Field(default=0.009, gt=0.0, le=1.0)
    """A knock counts once in this time, s: longer than a blow lasts. Chosen on simulated bumps and load steps of 3
    ms."""

    knock_ratio: float = Field(default=30.0, gt=1.0, le=1e6)
    """Variance of a knock over that of noise. The bounded likelihood hardly depends on it."""

    order: int = Field(default=16, ge=2, le=64)
    """Past values that the prediction uses. Sixteen foretell a ring at a tenth of the sample rate in noise; ten do
    not."""

    model_error: float = Field(default=0.1, ge=0.0, le=1.0)
    """Part of a ring's amplitude that may go unforetold."""

    memory_s: float = Field(default=4.0, gt=0.0, le=3600.0)
    """Memory of what ringing looks like, s."""

    energy_s: float = Field(default=0.01, gt=0.0, le=10.0)
    """Memory of how strongly it rings, s."""

    scale_s: float = Field(default=2.0, gt=0.0, le=3600.0)
    """How fast the noise level is followed, s; eight times slower while there is evidence."""

    learn_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Time that sets the first guess of the noise, s; after as long again it is armed."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """After a gap longer than this the evidence begins anew. Assumption: a slip is over or lost by then."""


class SlipDetector:
    """Slip when knocks come faster than bumps do: whitened, bounded, summed.

    The signal's second difference is predicted from its own past, so that offset, load ramps, rolling and the
    ringing of the structure, whatever its frequency, are foretold. What is not foretold is judged by the
    log-likelihood ratio of "knocks at `knocks_hz`" against "knocks at `jumps_hz`", which no single sample can drive
    beyond ln(knocks_hz / jumps_hz), and which a blow of less than `jump_s` cannot add twice. The sum, kept from
    falling below zero, is held against the threshold (Page's CUSUM). Of several channels the one with the most
    evidence decides.

    It needs `2 * learn_s` to arm after a reset. A gap keeps what was learned. `SlipEnded` comes when the evidence
    has fallen one knock's worth below the threshold, 40 ms after the last knock at 1 kHz.

    References: E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954); P. J. Huber, "A robust version of
    the probability ratio test", Ann. Math. Statist. 36 (1965). docs/explanation/slip.md derives it.

    Example:
        >>> detector = SlipDetector("slip", SlipSettings(threshold=20.0))
        >>> detector.inputs
        ('board.tangential',)
    """

    def __init__(self, name: str, settings: SlipSettings) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input,)
        self.reset()

    def reset(self) -> None:
        """Forget noise, ringing and evidence."""
        self._channels: list[_Channel] = []
        self._next_seq: int | None = None
        self._slipping = False

    def arming_s(self, rate_hz: float) -> float:
        """How long it learns after a reset, s: before that it tells nothing."""
        return 2 * _settling(self.settings, rate_hz).learn / rate_hz

    def least_delay_s(self, rate_hz: float) -> float:
        """From a slip's first sample to the soonest that can tell it where there was no evidence before, s: no sample
        is worth more than one knock, and none after the first more than the credit gets back in its time."""
        odds = _odds(self.settings, rate_hz)
        beyond = max(0.0, self.settings.threshold - odds.cap)
        return math.ceil(beyond / min(odds.cap, odds.refill)) / rate_hz

    def warm_up(self) -> None:
        """Let compiled code load, or compile on first use, before anything moves; changes nothing here."""
        self.statistic(np.zeros((64, (self.settings.channel or 0) + 1)), 1000.0)

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Hear the next samples."""
        trace = self.hear(block)
        threshold, worth = self.settings.threshold, self._channels[0].odds.cap
        times_s = block.times
        events: list[Detected] = []
        for i in _crossings(trace, threshold, max(0.0, threshold - worth), self._slipping):
            self._slipping = not self._slipping
            kind = SlipStarted if self._slipping else SlipEnded
            events.append(kind(float(times_s[i]), self.name, float(trace[i]), threshold))
        return events

    def hear(self, block: SampleBlock) -> Floats:
        """Hear the next samples.

        Returns:
            Evidence after each, nats, held at one knock's worth above the threshold, shape (n,).
        """
        values, rate_hz = self.settings.chosen(block.physical), _rate_hz(block)
        if not self._channels:
            self._channels = [_Channel(self.settings, rate_hz) for _ in range(values.shape[1])]
        if self._next_seq is not None and block.seq != self._next_seq:
            for channel in self._channels:
                channel.skip(block.seq - self._next_seq)
        self._next_seq = block.seq + len(block)
        return self._evidence(self._channels, values, self.settings.threshold + self._channels[0].odds.cap)

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Evidence after each sample of a whole recording, nats, shape (n,); NaN for the `2 * learn_s` in which it
        learns."""
        heard = self.settings.chosen(values)
        channels = [_Channel(self.settings, rate_hz) for _ in range(heard.shape[1])]
        found = self._evidence(channels, heard, math.inf)
        found[: 2 * _settling(self.settings, rate_hz).learn] = math.nan
        return found

    @staticmethod
    def _evidence(channels: Sequence[_Channel], values: Floats, ceiling: float) -> Floats:
        traces = [
            channel.hear(np.ascontiguousarray(values[:, i]), ceiling) for i, channel in enumerate(channels)
        ]
        most: Floats = traces[0] if len(traces) == 1 else np.max(traces, axis=0)
        return most


class _Channel:
    """Predictor and evidence of one channel."""

    def __init__(self, settings: SlipSettings, rate_hz: float) -> None:
        from controller.signals import evidence, whitening

        self._accumulate = evidence.accumulate
        self._missing = evidence.MISSING
        self._fresh = whitening.FRESH
        self.odds = _odds(settings, rate_hz)
        self._settling = _settling(settings, rate_hz)
        self._predictor: Predictor = whitening.predictor(settings.order, self._settling.learn)
        self._state = np.array([0.0, self.odds.cap, 0.0])

    def hear(self, x: Floats, ceiling: float) -> Floats:
        """Evidence after each sample, shape (n,)."""
        out = np.empty(x.size)
        self._accumulate(self.odds, self._settling, self._predictor, self._state, x, ceiling, out)
        return out

    def skip(self, samples: int) -> None:
        """Samples were lost; a negative number is a stream that began anew, a gap of unknown length."""
        self._predictor.counts[self._fresh] = 0
        self._state[self._missing] += samples if samples > 0 else self.odds.patience


def _odds(s: SlipSettings, rate_hz: float) -> Odds:
    from controller.signals.evidence import Odds

    # at low rates knocks come with every sample: odds stay odds, and a jump stays the rarer
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


def _crossings(trace: Floats, rise: float, fall: float, above: bool) -> list[int]:
    """Samples at which a trace rises above `rise` or falls to `fall` or below, in turn; `above` says which comes
    first."""
    # most blocks change nothing
    over = trace > rise
    if not above and not over.any():
        return []
    # nor do samples between the two levels
    deciding = np.flatnonzero(over | (trace <= fall))
    changes: list[int] = deciding[np.diff(over[deciding], prepend=above)].tolist()
    return changes


def _rate_hz(block: SampleBlock) -> float:
    if block.rate_hz is None:
        raise ValueError(
            f"{block.stream}: samples at irregular times while detecting slip; give it a stream with a rate"
        )
    return block.rate_hz
