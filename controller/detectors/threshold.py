"""Contact from a force that rises above its level at rest, as when a hand reaches the table."""

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, Strict

from behaviors.events import BaselineReady, BaselineRefused, Contact, ContactLost, Detected
from controller.detectors.protocol import Hysteresis, Quantity, decisions
from controller.detectors.stream import OnStream, RunningMean, running, step_of
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import BaselineS, Settings, StreamName

NOISE_SIGMA = 8.0
"""Default threshold, in standard deviations of the running mean at rest. Assumption: half a second gives the noise to
a seventh, and six sigma never happen in a day."""

DRIFT_ROOM = 1.5
"""A baseline may stray so many times farther than means side by side say: rest drifts, too. Assumption."""

LEAST_STEPS = 2.0
"""A threshold that is not set is no less than so many steps of the converter, and a baseline may stray by as many: at
rest between two codes noise flips by one, whatever the baseline has shown of it."""


class ForceThresholdSettings(Settings):
    """When a force is called contact."""

    input: StreamName = "board.fingertip"
    """Stream of the force sensor; it needs a rate."""

    channels: Annotated[tuple[int, ...], Strict(False), Field(min_length=1)] | None = None
    """Which of its channels; None uses all of them."""

    baseline_s: BaselineS = Field(default=0.5, gt=0.0, le=60.0)
    """Time over which the level at rest is taken, from the first sample on, s."""

    average_s: float = Field(default=0.02, gt=0.0, le=10.0)
    """Length of the running mean that is compared with the threshold, s. Assumption: shorter than a human reaction,
    long enough to quiet an arm's own force sensor."""

    threshold: float | None = Field(default=None, gt=0.0, le=1e6)
    """Distance from the level at rest that means contact, in the input's unit; that of the vector where several
    channels are used. None derives it from the noise of the baseline."""

    tared: bool = False
    """Whether the sensor reads zero at rest: a baseline farther from zero than the threshold is then a contact, and
    refused."""

    release_ratio: float = Field(default=0.5, gt=0.0, le=1.0)
    """Share of the threshold below which the contact has ended,"""

    hold_s: float = Field(default=0.05, ge=0.0, le=60.0)
    """where the mean has stayed there for so long, s: a tip that bounces is one contact. Assumption: bounces of an arm
    on a plate are closer together."""


class ForceThresholdDetector(OnStream[ForceThresholdSettings]):
    """Contact while the running mean is farther from the baseline than a threshold.

    Emits `BaselineReady` once the level at rest is known (`value`: largest distance of a running mean from it), or
    `BaselineRefused` where that exceeds the threshold, a value is not finite or there is no noise to derive a threshold
    from; then `Contact` and `ContactLost` in turn, the latter where the mean has stayed below the release for `hold_s`.
    A gap begins a new running mean; samples that are not finite are ignored.

    Example:
        >>> detector = ForceThresholdDetector("touch", ForceThresholdSettings(baseline_s=0.1, threshold=0.3))
        >>> force_n = np.concatenate([np.zeros(200), np.ones(50)])[:, None]
        >>> [round(e.t_s, 3) for e in detector.push(SampleBlock("board.fingertip", 0, 0.0, force_n, rate_hz=1000.0))]
        [0.099, 0.206]
    """

    doing = "waiting for contact"
    quantity = Quantity("distance of the running mean from the level at rest", None)

    def reset(self) -> None:
        """Clear level and contact."""
        super().reset()
        self._first: list[Floats] = []
        self._mean = RunningMean()
        self._level: Floats | None = None
        self._threshold = math.nan if self.settings.threshold is None else self.settings.threshold
        self._refused = False
        self._contact = Hysteresis()

    def _channels(self) -> Sequence[int] | None:
        return self.settings.channels

    def _missed(self, lost: int, block: SampleBlock, rate_hz: float) -> Sequence[Detected]:
        self._mean.restart()
        return ()

    def _decide(self, values: Floats, times_s: Floats, rate_hz: float) -> Sequence[Detected]:
        events: list[Detected] = []
        if self._level is None and not self._refused:
            wanted = max(1, round(self.settings.baseline_s * rate_hz))
            taken = min(len(values), wanted - sum(map(len, self._first)))
            self._first.append(values[:taken])
            if sum(map(len, self._first)) == wanted:
                events.append(self._learn(float(times_s[taken - 1]), np.concatenate(self._first), rate_hz))
                self._first = []
            values, times_s = values[taken:], times_s[taken:]
        if self._level is not None and len(values):
            events += self._follow(self._level, values, times_s, rate_hz)
        return events

    def _learn(self, t_s: float, samples: Floats, rate_hz: float) -> Detected:
        level, worst = samples[0], math.nan
        if np.isfinite(samples).all():
            level = samples.mean(axis=0)
            means = running(samples, min(self._size(rate_hz), len(samples)))
            distances = np.linalg.norm(means - level, axis=1)
            worst = float(distances.max())
            if self.settings.threshold is None:
                least = LEAST_STEPS * step_of(samples)
                noise = NOISE_SIGMA * math.sqrt(float(np.mean(distances**2)))
                self._threshold = max(noise, least) if math.isfinite(least) else 0.0
                # a contact is noise to itself: how far rest may stray, means side by side say
                rest = DRIFT_ROOM * NOISE_SIGMA * _noise_beside(means, self._size(rate_hz))
                if worst > max(rest, least):
                    self._threshold = rest
        reason = self._unfit(worst, float(np.linalg.norm(level)))
        if reason:
            self._refused = True
            return BaselineRefused(t_s, self.name, worst, self._threshold, reason)
        self._level = level
        return BaselineReady(t_s, self.name, worst, self._threshold)

    def _unfit(self, worst: float, away: float) -> str:
        """Why the baseline gives no level at rest, or one in contact; "" where it gives one."""
        if not math.isfinite(worst):
            return "a value of the baseline is not finite"
        if self._threshold == 0.0:
            return "the baseline has no noise that a threshold could be taken from; set threshold"
        if worst > self._threshold:
            return (
                f"the baseline is not at rest: a mean of {self.settings.average_s:g} s is {worst:.4g} from its level,"
                f" the threshold is {self._threshold:.4g}; is something touching, or the threshold below the noise?"
            )
        if self.settings.tared and away > self._threshold:
            return (
                f"the baseline is in contact: a tared sensor reads {away:.4g}, the threshold is {self._threshold:.4g};"
                " lift it, or tare it"
            )
        return ""

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Distance of the running mean from the level of the first `baseline_s`, shape (n,); NaN until it is known."""
        chosen = self._chosen(values)
        begin, size = max(1, round(self.settings.baseline_s * rate_hz)), self._size(rate_hz)
        found = np.full(len(values), math.nan)
        if len(values) > begin + size:
            after = chosen[begin:]
            away = running(after, size) - np.nanmean(chosen[:begin], axis=0)  # samples may be missing
            found[begin + size - 1 :] = np.linalg.norm(away, axis=1)
        return found

    def _follow(self, level: Floats, values: Floats, times_s: Floats, rate_hz: float) -> list[Detected]:
        settings = self.settings
        means, times_s = self._mean.push(values, times_s, self._size(rate_hz))
        distances = _lengths(means - level)
        self.readings = decisions(times_s, distances, self._threshold)
        events: list[Detected] = []
        release, hold = settings.release_ratio * self._threshold, round(settings.hold_s * rate_hz)
        for i, touching in self._contact.changes(distances, self._threshold, release, hold):
            kind = Contact if touching else ContactLost
            events.append(kind(float(times_s[i]), self.name, float(distances[i]), self._threshold))
        return events

    def _size(self, rate_hz: float) -> int:
        return max(1, round(self.settings.average_s * rate_hz))


def _noise_beside(means: Floats, size: int) -> float:
    """Standard deviation of running means, shape (n, channels), by those `size` samples apart, which share no sample; a
    step among them does nothing. Infinite where there are too few."""
    if len(means) < 4 * size:
        return math.inf
    apart = ((means[size:] - means[:-size]) ** 2).sum(axis=1)
    # the median of a chi-square variable over its mean (E. B. Wilson, M. M. Hilferty, PNAS 17, 1931)
    middle = (1.0 - 2.0 / (9.0 * means.shape[1])) ** 3
    return math.sqrt(0.5 * float(np.median(apart)) / middle)


def _lengths(vectors: Floats) -> Floats:
    """Of each row, shape (n,)."""
    lengths: Floats = np.sqrt((vectors * vectors).sum(axis=1))
    return lengths
