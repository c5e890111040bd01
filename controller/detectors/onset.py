"""The time at which something knocked or touched, with its uncertainty, from any vibration channel."""

import math
from collections.abc import Sequence

import numpy as np
from pydantic import Field

from behaviors.events import BaselineReady, BaselineRefused, Detected, Onset
from controller.detectors.protocol import Quantity, decisions
from controller.detectors.stream import OnStream, step_of
from controller.signals.whitening import ROUNDED
from drivers.core.compiled import compiled
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import Settings, StreamName

ORDER = 16
"""Differences of the signal from which the next is predicted."""

MOST = 16.0
"""An innovation counts no more than this many variances of the quiet: four standard deviations. Four outliers in a row,
whatever their size, stay below the default threshold."""

RATIO = 4.0
"""What is looked for: innovations of four times the variance."""

BEYOND = 1e100
"""A larger magnitude counts as a missing sample: its square would overflow."""

CELLS, BESIDE = 128, 32
"""The time of the onset is looked for in so many cells at most; and so many samples more than twice what the sum took
to grow."""

GROWTHS = ((1, 1), *((rise, order) for rise in (4, 16, 64) for order in (1, 2, 4)))
"""In so many cells vibration may grow to its full amplitude, and by which power of time: a blow at once, a soft touch
slowly. Chosen on two of three runs of blows to a force sensor; with linear growth alone the time comes late where it is
noisy."""

POWERS = 4.0 ** np.arange(1, 13)
"""Variances of the quiet that it may have then."""

SUM, LEVEL, LEAST, SINCE, FRESH, LAST, ON = STATE = range(7)
"""Places in the state: the sum; variance of the innovations in quiet, and its least; samples since the sum left zero,
and since the last gap; the last sample; 1 from an onset until the sum is back at zero."""


class OnsetSettings(Settings):
    """What is a knock. Times in seconds: they hold at any sample rate."""

    input: StreamName = "board.accelerometer"
    """Stream of the sensor; it needs a rate."""

    channel: int = Field(default=0, ge=0, le=4095)
    """Which of its channels."""

    threshold: float = Field(default=40.0, gt=0.0, le=1e12)
    """Evidence that means an onset, nats. With each sample worth 5.3 at most, eight samples decide."""

    learn_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """Time from which the quiet is learned, s."""

    follow_s: float = Field(default=2.0, gt=0.0, le=600.0)
    """Memory of the quiet's level, s: vibration that lasts as long becomes quiet."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """After a longer gap the quiet is learned again."""


@compiled()
def advance(
    taps: Floats, past: Floats, state: Floats, x: Floats, keep: float, top: float, sums: Floats, left: Floats
) -> int:
    """Samples until the sum exceeds `top` while no onset lasts, that one included, or all.

    Args:
        taps: Of the prediction error filter on the signal's differences, the newest first, shape (ORDER + 1,).
        past: Last differences, the newest first, shape (ORDER + 1,).
        keep: Share of the level that a sample leaves.
        sums: Receives Page's sum after each sample, NaN where there is none, shape (n,).
        left: Receives the innovations in standard deviations of the quiet, shape (n,).
    """
    for i in range(x.size):
        sums[i], left[i] = np.nan, 0.0
        if not abs(x[i]) < BEYOND:
            state[FRESH] = state[SUM] = state[SINCE] = 0.0
            continue
        for k in range(ORDER, 0, -1):
            past[k] = past[k - 1]
        past[0], state[LAST] = x[i] - state[LAST], x[i]
        state[FRESH] += 1.0
        if state[FRESH] <= ORDER + 2.0:
            continue
        error = 0.0
        for k in range(ORDER + 1):
            error += taps[k] * past[k]
        squared = min(error * error, BEYOND)
        bounded = min(squared, MOST * state[LEVEL])
        gain = 0.5 * (1.0 - 1.0 / RATIO) * bounded / state[LEVEL] - 0.5 * math.log(RATIO)
        left[i] = math.sqrt(squared / state[LEVEL])
        # what is beyond stays out of later predictions: an outlier is one sample, a step as many as it is high
        beyond = math.copysign(math.sqrt(squared) - math.sqrt(bounded), error)
        past[0] -= beyond
        state[LAST] -= beyond
        state[LEVEL] = max(state[LEAST], keep * state[LEVEL] + (1.0 - keep) * bounded)
        state[SUM] = max(0.0, state[SUM] + gain)
        state[SINCE] = state[SINCE] + 1.0 if state[SUM] > 0.0 else 0.0
        sums[i] = state[SUM]
        if state[ON] > 0.0:  # no further than the threshold: when it is over shows soon
            state[SUM] = min(state[SUM], top)
            sums[i] = state[SUM]
            if state[SUM] == 0.0:
                state[ON] = 0.0
        elif state[SUM] > top:
            state[ON] = 1.0
            return i + 1
    return int(x.size)


class OnsetDetector(OnStream[OnsetSettings]):
    """The onset of vibration above the quiet: Page's CUSUM of innovations for four times their variance, and when it
    began.

    The signal's differences are predicted from their last 16 by what the first `learn_s` taught: offset, drift, hum and
    a structure's ring in quiet are predicted. Each innovation is bounded, so that no outlier decides. `Onset` comes
    with the sample at which the sum exceeds the threshold; `began_s` and `sigma_s` are mean and standard deviation of
    the time at which it began, given the samples until then, for vibration that grows at once or slowly to any
    amplitude. One that lasts is one onset: the next comes after the sum was back at zero. `BaselineReady` (`value`: the
    innovations' standard deviation, in the input's unit) once the quiet is learned, `BaselineRefused` where something
    knocked in it, or nothing changed; it then learns again.

    References: E. S. Page, "Continuous inspection schemes", Biometrika 41 (1954); N. Maeda, "A method for reading and
    checking phase times in auto-processing system of seismic wave data", Zisin 38 (1985), whose two variances are one
    of the cases here.

    Example:
        >>> rng = np.random.default_rng(1)
        >>> x = 1e-3 * rng.standard_normal(10_000)
        >>> x[8_000:8_050] += 0.1 * rng.standard_normal(50)
        >>> detector = OnsetDetector("knock", OnsetSettings())
        >>> ready, onset = detector.push(SampleBlock("board.accelerometer", 0, 0.0, x[:, None], rate_hz=10_000.0))
        >>> round(onset.began_s, 4), round(onset.t_s, 4)
        (0.7999, 0.8007)
    """

    doing = "detecting an onset"
    quantity = Quantity("evidence of an onset", "nat")

    def reset(self) -> None:
        """Clear quiet and evidence."""
        super().reset()
        self._first = np.empty(0)
        self._taps: Floats | None = None
        self._past, self._left, self._state = np.zeros(ORDER + 1), np.empty(0), np.zeros(len(STATE))
        self._said = False

    def warm_up(self) -> None:
        """Load the compiled code, compiling it on first use; leaves the state unchanged."""
        advance(
            np.zeros(ORDER + 1),
            np.zeros(ORDER + 1),
            np.ones(len(STATE)),
            np.zeros(1),
            0.5,
            1.0,
            np.zeros(1),
            np.zeros(1),
        )

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        if not 0 <= lost <= self.settings.max_gap_s * rate_hz:
            self.reset()
        self._first = np.empty(0)
        if self._taps is not None:
            self._state[[SUM, SINCE, FRESH]] = 0.0
            self._left = np.empty(0)
        return ()

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        x, settings, place = np.ascontiguousarray(values[:, 0]), self.settings, 0
        events: list[Detected] = []
        while self._taps is None and place < len(x):
            taken = min(len(x), place + _learning(settings, rate_hz) - len(self._first))
            self._first, place = np.concatenate([self._first, x[place:taken]]), taken
            if len(self._first) == _learning(settings, rate_hz):
                events += self._learned(float(times_s[place - 1]), rate_hz)
        if self._taps is not None and place < len(x):
            events += self._follow(self._taps, x[place:], times_s[place:], rate_hz)
        return events

    def _learned(self, t_s: float, rate_hz: float) -> Sequence[Detected]:
        """Learn the quiet from the first samples, or refuse it, once, and learn again."""
        first, threshold = self._first, self.settings.threshold
        self._first = np.empty(0)
        taps, level, least, reason = _quiet(first)
        if not reason:
            highest = float(np.nanmax(_sums(taps, level, least, first, self._keep(rate_hz))))
            if highest > threshold:
                reason = (
                    f"something knocked while the quiet was learned: {highest:.3g} nats, the threshold is"
                    f" {threshold:.3g}; leave the sensor alone for {self.settings.learn_s:g} s"
                )
        if reason:
            told, self._said = self._said, True
            return [] if told else [BaselineRefused(t_s, self.name, math.sqrt(level), threshold, reason)]
        self._taps, self._past, self._left = taps, np.zeros(ORDER + 1), np.empty(0)
        self._state = _quiet_state(level, least)
        return [BaselineReady(t_s, self.name, math.sqrt(level), threshold)]

    def _follow(self, taps: Floats, x: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        threshold, begin, events = self.settings.threshold, 0, list[Detected]()
        sums, left = np.empty(len(x)), np.empty(len(x))
        longest = round(rate_hz)  # the past in which an onset is looked for
        while begin < len(x):
            done = advance(
                taps,
                self._past,
                self._state,
                x[begin:],
                self._keep(rate_hz),
                threshold,
                sums[begin:],
                left[begin:],
            )
            self._left = np.concatenate([self._left, left[begin : begin + done]])[-longest:]
            begin += done
            if sums[begin - 1] > threshold:  # while an onset lasts it is not
                size = min(len(self._left), 2 * int(self._state[SINCE]) + BESIDE)
                ago, sigma = began(self._left[len(self._left) - size :])
                t_s = float(times_s[begin - 1])
                place = (self.name, float(sums[begin - 1]), threshold, t_s - ago / rate_hz, sigma / rate_hz)
                events.append(Onset(t_s, *place))
        self.readings = decisions(times_s, sums, threshold)
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The sum after each sample of a whole recording, shape (n,); NaN for the `learn_s` in which it learns."""
        x = np.ascontiguousarray(self._chosen(values)[:, 0])
        size, found = _learning(self.settings, rate_hz), np.full(len(x), np.nan)
        taps, level, least, reason = _quiet(x[:size])
        if not reason and len(x) > size:
            found[size:] = _sums(taps, level, least, x[size:], self._keep(rate_hz))
        return found

    def _keep(self, rate_hz: float) -> float:
        return math.exp(-1.0 / (self.settings.follow_s * rate_hz))


def _learning(settings: OnsetSettings, rate_hz: float) -> int:
    """Samples of the quiet that is learned from: several for each coefficient."""
    return max(8 * ORDER, round(settings.learn_s * rate_hz))


def _quiet(first: Floats) -> tuple[Floats, float, float, str]:
    """Of quiet samples, shape (n,): the prediction error filter (Yule-Walker), the innovations' bounded variance, the
    least that it may have, and why there is none ("" where there is)."""
    nothing = np.zeros(ORDER + 1)
    if not (np.abs(first) < BEYOND).all():
        return nothing, 0.0, 0.0, "a value of the quiet is not finite"
    d = np.diff(first)
    lags = np.array([d[: len(d) - k] @ d[k:] for k in range(ORDER + 1)]) / max(1, len(d))
    if not lags[0] > 0.0:
        return nothing, 0.0, 0.0, "the quiet is constant; is the sensor alive, and its converter fine enough?"
    lags[0] *= 1.0 + 1e-9
    places = np.abs(np.arange(ORDER)[:, None] - np.arange(ORDER))
    taps = np.concatenate([[1.0], -np.linalg.solve(lags[places], lags[1:])])
    squared = np.convolve(d, taps, "valid") ** 2
    level = float(squared.mean())
    for _ in range(20):  # the level whose bounded innovations have it for their mean
        level = float(np.minimum(squared, MOST * level).mean())
    if not level > 0.0:
        return nothing, 0.0, 0.0, "the quiet can be predicted to the last bit; is the sensor alive?"
    least = ROUNDED * step_of(first[:, None]) ** 2
    return taps, max(level, least), least, ""


def _quiet_state(level: float, least: float) -> Floats:
    """The state in which a quiet of this variance begins."""
    state = np.zeros(len(STATE))
    state[LEVEL], state[LEAST] = level, least
    return state


def _sums(taps: Floats, level: float, least: float, x: Floats, keep: float) -> Floats:
    """Page's sum of a stretch that follows the quiet, without a threshold."""
    state = _quiet_state(level, least)
    sums, left = np.empty(len(x)), np.empty(len(x))
    advance(taps, np.zeros(ORDER + 1), state, x, keep, math.inf, sums, left)
    return sums


def began(left: Floats) -> tuple[float, float]:
    """How many samples before the last one vibration began: mean and standard deviation.

    All times, growths and powers are equally likely before; samples are independent and normal, whatever follows.

    Args:
        left: Innovations in standard deviations of the quiet, at least one, shape (n,).
    """
    size = -(-len(left) // CELLS)
    count = len(left) // size
    energy = (left[len(left) - count * size :] ** 2).reshape(count, size).sum(axis=1)
    since = np.arange(1, count + 1)
    scores = []
    for rise, order in GROWTHS:
        for power in POWERS:
            variance = 1.0 + power * np.minimum(1.0, since / rise) ** (2 * order)
            # of an onset at cell k: what each later cell gains by its variance, less what that variance costs
            gains = np.correlate(energy, 0.5 - 0.5 / variance, "full")[count - 1 :]
            scores.append(gains - 0.5 * size * np.cumsum(np.log(variance))[::-1])
    likely = np.exp(np.array(scores) - np.max(scores)).sum(axis=0)
    likely /= likely.sum()
    ago = (
        count - np.arange(count)
    ) * size - 0.5 * size  # the middle between a cell's first and last sample before it
    mean = float(likely @ ago)
    return mean, math.sqrt(float(likely @ (ago - mean) ** 2) + size**2 / 12.0)
