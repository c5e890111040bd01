"""Slip from the vibration of a force sensor: the paper's spectral peak; unpredicted knocks, and octaves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from statistics import NormalDist

import numpy as np
from pydantic import Field

from behaviors.events import BaselineReady, BaselineRefused, Detected, Impact, SlipEnded, SlipStarted
from controller.detectors.protocol import Hysteresis, Quantity, decisions
from controller.detectors.stream import OnStream
from controller.signals.cusum import (
    CREDIT,
    DEAF,
    IMPACT,
    LASTING,
    MOST_VIBRATION_NAT,
    QUIET,
    STRIKE,
    SUM,
    USED,
    Cusum,
    accumulate,
)
from controller.signals.octaves import octaves
from controller.signals.spectrum import BlockCutter, block_peaks
from controller.signals.whitening import BRIDGED, COUNT, predictor
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import Settings, StreamName


class SlipStreamSettings(Settings):
    """Input settings of every slip detector."""

    input: StreamName = "board.tangential"
    """Stream of the force sensor."""

    channel: int | None = Field(default=None, ge=0, le=4095)
    """Which of its channels; None uses all of them."""


class SlipPaperSettings(SlipStreamSettings):
    """The paper's criterion."""

    block_s: float = Field(default=0.064, gt=0.0, le=60.0)
    """Length of a block (section 3: N = 64 at 1 kHz; section 5.4: N = 16 at 100 Hz, 0.16 s)."""

    threshold: float = Field(default=10.0, gt=0.0, le=1e300)
    """Peak x frequency that means slip, the input's unit squared x Hz (4.3: 10, 5.1: 0.25)."""


class SlipPaperDetector(OnStream[SlipPaperSettings]):
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

    doing = "detecting slip"
    quantity = Quantity("spectral product", "")

    def reset(self) -> None:
        """Clear the block begun and the slip."""
        super().reset()
        self._blocks: BlockCutter | None = None
        self._slip = Hysteresis()

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        self._blocks = None
        return ()

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        if self._blocks is None:
            self._blocks = BlockCutter(self._size(rate_hz))
        ends, complete = self._blocks.push(values)
        if not len(ends):
            return []
        times_s, threshold = times_s[ends], self.settings.threshold
        products = self._products(complete, rate_hz)
        self.readings = decisions(times_s, products, threshold)
        events: list[Detected] = []
        for i, slipping in self._slip.changes(products, threshold, release=threshold):
            kind = SlipStarted if slipping else SlipEnded
            events.append(kind(float(times_s[i]), self.name, float(products[i]), threshold))
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Peak x frequency at the last sample of each block, NaN elsewhere, shape (n,)."""
        found = np.full(len(values), np.nan)
        ends, complete = BlockCutter(self._size(rate_hz)).push(self._chosen(values))
        found[ends] = self._products(complete, rate_hz)
        return found

    def _size(self, rate_hz: float) -> int:
        return round(self.settings.block_s * rate_hz)

    @staticmethod
    def _products(blocks: Floats, rate_hz: float) -> Floats:
        power, frequency_hz = block_peaks(blocks, rate_hz)
        return power * frequency_hz


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

TAIL_HZ, MOST_TAIL_SHARE = 20.0, 0.02
"""The tail of the quiet with which knocks are compared is what so many innovations a second are beyond, a fiftieth at
most: knocks count by the second, and so do outliers."""

IMPACT_S = 0.1
"""An impact is over within this time, s."""

PATIENCE = 2.0
"""A detector that has learned nothing after this many times its learning time reports so."""

LOSSY = 0.1
"""Where a larger share of the samples was lost, that is why. Assumption."""

DEAF_S = 1.0
"""Losses that leave it without a decision for so much longer than with one are reported. Assumption: a slip is over by
then."""


class SlipSettings(SlipStreamSettings):
    """Settings of the detector that waits for several knocks. Times in seconds: they hold at any sample rate."""

    threshold: float = Field(default=25.0, gt=0.0, le=1e12)
    """Evidence that means slip, nats; calibrate it on a recording without slip. Beyond 15, as by default, only several
    knocks reach it, or vibration that lasts, so bumps do not: the simulated sensors ask for 17.0 to 23.5 for one false
    alarm an hour among bumps (six hours each, benchmarks/results/slip_thresholds.md), and none of 64 recorded blows
    reaches it. Below 15 any vibration reaches it: slip is detected sooner."""

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

    hold_s: float = Field(default=0.2, ge=0.0, le=10.0)
    """The evidence must have stayed one knock's worth below the threshold for so long before a slip is over, s. With
    0.05, slips of a soft sensor at 10 to 80 Hz come and go twice in the mean, at 12 nats."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """A longer gap restarts learning. Assumption: a slip is over or lost by then, and the quiet level may have
    changed."""


class SlipDetector(OnStream[SlipSettings]):
    """Slip when knocks come faster than bumps do, or when the whole spectrum rises at once; an impact is none.

    Three opinions on one scale, nats; the evidence is the largest of knocks, vibration and vibration that lasts.

    *Knocks*: the signal's second difference is predicted from its own past, so that offset, load ramps, rolling and
    the ringing of the structure are predicted. The innovation, over noise whose running median is followed, is judged
    by the log-likelihood ratio of "knocks at `knocks_hz`" against "knocks at `jumps_hz`". No single sample can
    drive it beyond ln(knocks_hz / jumps_hz), and a blow of less than `jump_s` cannot add twice. The sum is kept from
    falling below zero (Page's CUSUM).

    *Vibration*: the smaller of what three neighbouring octaves from 15 Hz together exceed their own quiet by, and of
    the likelihood ratio of a larger innovation. Hum shakes one octave; a starting arm makes no innovation. It
    is worth 15 nats at most: one blow rings as a slip does. *Lasting* vibration adds up, and is worth more after 0.1 s.

    An innovation of 40 deviations begins an *impact*: for 0.1 s vibration counts as its own, and what is left then is
    quiet until it has died away. `Impact` tells of it at its end, if no other as strong has followed.

    It needs `2 * learn_s` to arm after a reset or a gap beyond `max_gap_s`, and emits `BaselineReady` (`value`: the
    vibration in quiet, root mean square) or `BaselineRefused`. One or two lost samples are bridged by what was
    predicted; `BaselineRefused` tells where more are lost so often that it is deaf. Noise below the step of a converter
    counts as what a converter makes of it at the edge of a code. Of several channels the one with the
    most evidence decides. `SlipEnded` comes when the evidence has been one knock's worth
    below the threshold for `hold_s`.

    References: E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954); P. J. Huber, "A robust version of
    the probability ratio test", Ann. Math. Statist. 36 (1965). docs/explanation/slip.md derives it.

    Example:
        >>> detector = SlipDetector("slip", SlipSettings(threshold=20.0))
        >>> detector.inputs
        ('board.tangential',)
    """

    doing = "detecting slip"
    quantity = Quantity("evidence of slip", "nat")

    def reset(self) -> None:
        """Clear noise, ringing and evidence."""
        super().reset()
        self._each: list[_Channel] = []
        self._slip = Hysteresis()
        self._received = self._lost = self._before = 0
        self._ready_reported = False
        self._refusal_reported = False
        self._deaf_reported = False

    def arming_s(self, rate_hz: float) -> float:
        """Learning time after a reset, s: no events before its end."""
        return 2 * _learning(self.settings, rate_hz) / rate_hz

    def least_delay_s(self, rate_hz: float) -> float:
        """Shortest detection delay from a slip's first sample, with nothing before, s.

        Vibration is worth `MOST_VIBRATION_NAT` at most; beyond that no sample is worth more than one knock, and after
        the first none more than the credit regained in its time.
        """
        cusum, threshold = _cusum(self.settings, rate_hz), self.settings.threshold
        if threshold < max(cusum.cap, MOST_VIBRATION_NAT):
            return 1.0 / rate_hz
        return math.ceil((threshold - cusum.cap) / min(cusum.cap, cusum.refill)) / rate_hz

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""
        self.statistic(np.zeros((64, (self.settings.channel or 0) + 1)), 1000.0)

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        if 0 <= lost <= self.settings.max_gap_s * rate_hz:
            self._before = lost
            self._lost += lost
            return ()
        slipping = self._slip.on
        self.reset()
        return [SlipEnded(float(block.times[0]), self.name, 0.0, self.settings.threshold)] if slipping else ()

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        threshold, before, self._before = self.settings.threshold, self._before, 0
        if before:  # lost samples have the time of the next
            values = np.concatenate([np.full((before, values.shape[1]), math.nan), values])
            times_s = np.concatenate([np.repeat(times_s[:1], before), times_s])
        scores = self._scores(values, rate_hz)
        events = self._deaf(times_s) if self._ready_reported else self._baseline(times_s, rate_hz)
        self.readings = decisions(times_s[before:], scores[before:], threshold)
        ending = max(0.5 * threshold, threshold - self._each[0].cusum.cap)
        hold = round(self.settings.hold_s * rate_hz)
        impacts = {place: size for channel in self._each for place, size in channel.impacts}
        for i, size in impacts.items():
            t_s = float(times_s[i])
            events.append(Impact(t_s, self.name, size, math.sqrt(STRIKE), t_s - IMPACT_S))
        for i, slipping in self._slip.changes(scores, threshold, ending, hold):
            kind = SlipStarted if slipping else SlipEnded
            events.append(kind(float(times_s[i]), self.name, float(scores[i]), threshold))
        return sorted(events, key=lambda event: event.t_s)

    def _deaf(self, times_s: Floats) -> list[Detected]:
        """Report that losses leave too little to decide by; once."""
        places = [channel.deaf for channel in self._each if channel.deaf is not None]
        if self._deaf_reported or not places:
            return []
        self._deaf_reported = True
        reason = (
            f"so many samples are lost, or not finite, that it was deaf for {DEAF_S:g} s longer than not: it decides"
            f" {self.settings.order + 2} samples after more than {BRIDGED} in a row; is the line, or the computer, too"
            " slow?"
        )
        return [BaselineRefused(float(times_s[min(places)]), self.name, math.nan, math.nan, reason)]

    def _baseline(self, times_s: Floats, rate_hz: float) -> list[Detected]:
        """Report that the quiet level is learned, or cannot be; once each."""
        arming_s = self.arming_s(rate_hz)
        patience = round(PATIENCE * arming_s * rate_hz)
        late = patience - self._received - 1
        self._received += len(times_s)
        armed = [channel for channel in self._each if channel.armed is not None]
        first = min(armed, key=lambda channel: channel.armed or 0, default=None)
        ready = (first.armed or 0) if first else len(times_s)
        stored = self.settings.quiet_rms or math.nan
        failures = [
            (
                place,
                level,
                STORED_RATIO * stored,
                f"the first {arming_s:g} s vibrate with {level:.3g}, the stored quiet is {stored:.3g}: does it slip"
                " already, or is quiet_rms that of another sensor?",
            )
            for channel in self._each
            for place, level in channel.refused
        ]
        if late >= 0:
            reason = (
                f"no quiet could be learned: {self._lost} of {patience} samples are lost; is the line, or the"
                " computer, too slow?"
                if self._lost > LOSSY * patience
                else "no quiet could be learned: the samples are constant, or not finite; is the sensor alive?"
            )
            failures.append((late, 0.0, self.settings.threshold, reason))
        events: list[Detected] = []
        place, level, limit, reason = min(failures, default=(ready, 0.0, 0.0, ""))
        if place < ready and not self._refusal_reported:
            self._refusal_reported = True
            events.append(BaselineRefused(float(times_s[place]), self.name, level, limit, reason))
        if first:
            self._ready_reported = True
            events.append(
                BaselineReady(float(times_s[ready]), self.name, first.quiet, self.settings.threshold)
            )
        return events

    def _scores(self, values: Floats, rate_hz: float) -> Floats:
        """Evidence after each sample, nats, capped at one knock's worth above the threshold; 0 while it learns."""
        if not self._each:
            self._each = [_Channel(self.settings, rate_hz) for _ in range(values.shape[1])]
        ceiling = self.settings.threshold + self._each[0].cusum.cap
        scores = self._largest(self._each, values, ceiling)
        scores[np.isnan(scores)] = 0.0
        return scores

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Evidence after each sample of a whole recording, nats, shape (n,); NaN for the `2 * learn_s` in which it
        learns."""
        chosen = self._chosen(values)
        settings = self.settings.model_copy(update={"quiet_rms": None})
        return self._largest([_Channel(settings, rate_hz) for _ in range(chosen.shape[1])], chosen, math.inf)

    @staticmethod
    def _largest(channels: Sequence[_Channel], values: Floats, ceiling: float) -> Floats:
        scores = [
            channel.scores(np.ascontiguousarray(values[:, i]), ceiling) for i, channel in enumerate(channels)
        ]
        most: Floats = scores[0] if len(scores) == 1 else np.fmax.reduce(scores, axis=0)
        return most


class _Channel:
    """Predictor, octaves and CUSUM of one channel.

    Attributes:
        armed: The sample of the last block at which the quiet level was learned; None in other blocks.
        quiet: The vibration in quiet.
        refused: Samples of the last block at which the learned level exceeded the stored quiet, and that level.
        impacts: Samples of the last block with which an impact was over, and its size in deviations of noise.
        deaf: The sample of the last block with which it had been deaf for too long; None in other blocks.
    """

    def __init__(self, settings: SlipSettings, rate_hz: float) -> None:
        self._stored = settings.quiet_rms
        self.cusum = _cusum(settings, rate_hz)
        self._octaves = octaves(rate_hz)
        self._predictor = predictor(
            settings.order,
            _learning(settings, rate_hz),
            keep=math.exp(-1.0 / (settings.memory_s * rate_hz)),
            keep_energy=math.exp(-1.0 / (settings.energy_s * rate_hz)),
            scale=settings.scale_s * rate_hz,
            model_error=settings.model_error,
        )
        self.quiet = 0.0
        self.armed: int | None = None
        self.refused: list[tuple[int, float]] = []
        self.impacts: list[tuple[int, float]] = []
        self.deaf: int | None = None

    def scores(self, x: Floats, ceiling: float) -> Floats:
        """Evidence after each sample, shape (n,); NaN while it learns."""
        out, state = np.empty(x.size), self.cusum.state
        self.armed, self.refused, self.impacts, self.deaf = None, [], [], None
        begin = 0
        while begin < x.size:
            knew = state[USED] > 0.0
            begin += accumulate(self.cusum, self._predictor, self._octaves, x[begin:], ceiling, out[begin:])
            if not knew and state[USED] > 0.0:
                self._judge(begin - 1, out)
            if state[IMPACT] > 0.0:
                self.impacts.append((begin - 1, math.sqrt(state[IMPACT])))
                state[IMPACT] = 0.0
            if self.deaf is None and state[DEAF] == self.cusum.deaf:
                self.deaf = begin - 1
        return out

    def _judge(self, place: int, out: Floats) -> None:
        """Accept the learned quiet level, or learn again."""
        state = self.cusum.state
        self.quiet = float(state[QUIET])
        if self._stored is None or self.quiet <= STORED_RATIO * self._stored:
            self.armed = place
            return
        self.refused.append((place, self.quiet))
        self._predictor.counts[COUNT] = 0
        state[USED] = state[SUM] = state[LASTING] = 0.0
        out[place] = math.nan


def _learning(s: SlipSettings, rate_hz: float) -> int:
    """Samples of the first noise estimate."""
    return max(2 * s.order, round(s.learn_s * rate_hz))


def _cusum(s: SlipSettings, rate_hz: float) -> Cusum:
    # at low rates knocks come with every sample: probabilities stay below 1, and a jump the rarer
    knock = min(0.3, s.knocks_hz / rate_hz)
    jump = min(0.2 * knock, s.jumps_hz / rate_hz)
    cap = math.log(knock / jump)
    state = np.zeros(17)
    state[CREDIT] = cap
    rare = max(0.0, 1.0 - knock / DENSE)
    share = min(MOST_TAIL_SHARE, TAIL_HZ / rate_hz)
    return Cusum(
        knock,
        jump,
        s.knock_ratio,
        cap,
        refill=cap / (s.jump_s * rate_hz),
        patience=round(s.max_gap_s * rate_hz) + s.order + 2,
        follow=1.0 / min(s.follow_s * rate_hz, FOLLOW_SAMPLES),
        most_followed=FOLLOWED_DENSE_NAT + (FOLLOWED_RARE_NAT - FOLLOWED_DENSE_NAT) * rare,
        tail_share=share,
        tail_normal=2.0 * math.log(NormalDist().inv_cdf(1.0 - 0.5 * share)),
        strike=max(2, round(IMPACT_S * rate_hz)),
        sample_s=1.0 / rate_hz,
        deaf=round(DEAF_S * rate_hz),
        state=state,
        totals=np.zeros(max(2, round(s.vibration_s * rate_hz) + 1)),
    )
