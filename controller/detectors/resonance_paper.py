"""Contact from a rise of the finger's resonant frequency (Backus and Dollar, III.B)."""

import math
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from typing import Literal

import numpy as np
from pydantic import Field

from behaviors.events import BaselineReady, BaselineRefused, Contact, ContactLost, Detected
from controller.detectors.protocol import NOTHING, Quantity
from drivers.core.messages import Floats, SampleBlock
from drivers.core.settings import BaselineS, Settings, StreamName


class ResonancePaperSettings(Settings):
    """The paper's criterion, with what it does not print as settings."""

    input: StreamName = "board.period"
    """Stream of period counts (s), of frequencies (Hz), or a waveform of any other unit."""

    sample_hz: float | None = Field(default=15.0, gt=0.0, le=1000.0)
    """How often the frequency is sampled (Hz): the first whole period after each point of the grid, so at most
    every period. According to the paper about 30 Hz of oscillation limits it to 15; None takes every period."""

    average_samples: int = Field(default=10, ge=1, le=1000)
    """Length of the moving average (III.B: 10)."""

    baseline_s: BaselineS = Field(default=1.0, gt=0.0, le=600.0)
    """Time over which mean and standard deviation of the frequency are taken (III.B: 1 s)."""

    threshold_sigma: float = Field(default=3.0, gt=0.0, le=100.0)
    """Contact above the mean by so many standard deviations (III.B: 3)."""

    sigma_of: Literal["averages", "samples"] = "averages"
    """Of what mean and standard deviation are taken: of the moving average, as III.B reads at first, or of the single
    samples. At ten a second the paper's "one second sample" is one average of ten, which alone has no deviation."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """A silence of the input longer than this empties the moving average. Assumption: 14 periods of 28 Hz."""

    tendon: StreamName | None = None
    """Stream of the tendon's position (m). With it the threshold follows the tendon (V.C): the frequency for each
    position is learned from the baseline, in which the tendon must move over its range."""

    hysteresis: float = Field(default=0.0, ge=0.0)
    """Of the software comparator, in the waveform's unit; unused where the input is periods or frequencies."""


class ResonancePaperDetector:
    """Contact when the averaged frequency exceeds the baseline's mean by some standard deviations.

    After a reset the moving average fills, then `baseline_s` seconds of it give mean and standard deviation
    (`BaselineReady`; or `baseline_s` of single samples, from the first: `sigma_of`), then every sample is compared
    with the threshold: `Contact` when it rises above, `ContactLost` when it falls back. A period that is not finite
    or not positive is skipped; a baseline without two values or without variance is refused, once, and the detector
    stays silent.

    With a tendon the mean is a curve: the averaged frequency as a parabola of the tendon's averaged position, and in
    proportion to its speed, because the loop lags. `BaselineReady` reports it at the tendon's current position.

    Reference: S. B. Backus, A. M. Dollar, "Robust, Inexpensive Resonant Frequency Based Contact Detection for
    Robotic Manipulators", section III.B.

    Example:
        >>> detector = ResonancePaperDetector("contact", ResonancePaperSettings(sample_hz=None))
        >>> detector.inputs
        ('board.period',)
    """

    quantity = Quantity("averaged frequency", "Hz")

    def __init__(self, name: str, settings: ResonancePaperSettings) -> None:
        self.name = name
        self.settings = settings
        self.inputs = (settings.input, *([settings.tendon] if settings.tendon else []))
        self.reset()

    def reset(self) -> None:
        """Clear baseline, average and contact."""
        self.readings = NOTHING
        self._read: list[tuple[float, float, float]] = []
        self._cycles = CycleCounter(self.settings.hysteresis)
        self._next_seq: int | None = None
        self._window: deque[tuple[float, float, float]] = deque(maxlen=self.settings.average_samples)
        self._waiting: deque[tuple[float, float]] = deque()
        self._tendon_s = np.empty(0)
        self._tendon_m = np.empty(0)
        self._last_s = math.nan
        self._cell: int | None = None
        self._baseline: list[tuple[float, Floats]] = []
        self._baseline_start_s = math.nan
        self._curve: Floats | None = None
        self._sigma_hz = self._threshold_hz = self._above_sigma = math.nan
        self._refused = False
        self._contact = False

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next periods, frequencies or waveform samples."""
        self._read.clear()
        if block.stream == self.settings.tendon:
            self._tendon_s = np.concatenate([self._tendon_s, block.times])
            self._tendon_m = np.concatenate([self._tendon_m, block.physical[:, 0]])
        else:
            if self._next_seq not in (None, block.seq):
                self._cycles.reset()  # samples are missing: a cycle across them would be none
            self._next_seq = block.seq + len(block)
            self._waiting.extend(self._frequencies(block))
        found = [self._update(t_s, frequency_hz) for t_s, frequency_hz in self._ready()]
        self.readings = np.array(self._read).reshape(-1, 3)
        return [event for event in found if event]

    def deviations(self, times_s: Floats, values: Floats) -> tuple[Floats, Mapping[str, Floats]]:
        """Times of the averages after the baseline of a recording, and how many sigmas each lies above the mean.

        Args:
            times_s: When each period ended, shape (n,).
            values: The periods in s, shape (n,).
        """
        twin = ResonancePaperDetector(self.name, self.settings)
        found = []
        for t_s, period_s in zip(times_s.tolist(), values.tolist(), strict=True):
            twin._update(t_s, 1.0 / period_s if period_s > 0.0 else math.nan)
            found.append((t_s, twin._above_sigma))
        known = np.array([each for each in found if math.isfinite(each[1])]).reshape(-1, 2)
        return known[:, 0], {"average": known[:, 1]}

    def _ready(self) -> Iterator[tuple[float, float]]:
        """Waiting frequencies; with a tendon, only as far as its position is known."""
        known_s = math.inf
        if self.settings.tendon:
            known_s = float(self._tendon_s[-1]) if len(self._tendon_s) else -math.inf
        while self._waiting and self._waiting[0][0] <= known_s:
            yield self._waiting.popleft()

    def _update(self, t_s: float, frequency_hz: float) -> Detected | None:
        return self._averaged(t_s, frequency_hz) if self._due(t_s, frequency_hz) else None

    def _frequencies(self, block: SampleBlock) -> Iterator[tuple[float, float]]:
        times_s, x = block.times, block.physical[:, 0]
        if block.unit == "Hz":
            yield from zip(times_s.tolist(), x.tolist(), strict=True)
            return
        if block.unit == "s":
            ends_s, periods_s = times_s.tolist(), x.tolist()
        else:
            ends_s, periods_s = self._cycles.push(times_s, x)
        for t_s, period_s in zip(ends_s, periods_s, strict=True):
            yield t_s, 1.0 / period_s if period_s > 0.0 else math.nan

    def _due(self, t_s: float, frequency_hz: float) -> bool:
        """Whether the period that ends at `t_s` is one that the frequency is sampled at.

        The sampling grid is absolute (k / sample_hz), so that the block size changes nothing; the first period to
        end after a grid point is taken, whole, so that the detector stays causal.
        """
        if not (math.isfinite(frequency_hz) and frequency_hz > 0.0 and math.isfinite(t_s)):
            return False
        if t_s - self._last_s > self.settings.max_gap_s:
            self._window.clear()
            self._baseline.clear()  # a baseline must not span a silence
        self._last_s = t_s
        if self.settings.sample_hz is None:
            return True
        cell = math.floor(t_s * self.settings.sample_hz)
        due, self._cell = cell != self._cell, cell
        return due

    def _averaged(self, t_s: float, frequency_hz: float) -> Detected | None:
        settings = self.settings
        self._window.append((frequency_hz, t_s, self._position(t_s)))
        learning = self._curve is None
        single = learning and settings.sigma_of == "samples"
        if self._refused or (len(self._window) < settings.average_samples and not single):
            return None
        average_hz = math.fsum(each[0] for each in self._window) / len(self._window)
        terms = self._terms()
        if self._curve is not None:
            mean_hz = float(terms @ self._curve)
            self._threshold_hz = mean_hz + settings.threshold_sigma * self._sigma_hz
            self._above_sigma = (average_hz - mean_hz) / self._sigma_hz
        self._read.append((t_s, average_hz, self._threshold_hz))
        if learning:
            return self._learn(t_s, frequency_hz if single else average_hz, terms)
        if (average_hz > self._threshold_hz) == self._contact:
            return None
        self._contact = not self._contact
        kind = Contact if self._contact else ContactLost
        return kind(t_s, self.name, average_hz, self._threshold_hz)

    def _position(self, t_s: float) -> float:
        return float(np.interp(t_s, self._tendon_s, self._tendon_m)) if self.settings.tendon else 0.0

    def _terms(self) -> Floats:
        """What the mean depends on: nothing, or the tendon's position over the window, its square and its speed."""
        terms = np.ones(1)
        if self.settings.tendon:
            (_, first_s, first_m), (_, last_s, last_m) = self._window[0], self._window[-1]
            at_m = math.fsum(each[2] for each in self._window) / len(self._window)
            speed_m_s = (last_m - first_m) / (last_s - first_s) if last_s > first_s else 0.0
            terms = np.array([1.0, at_m, at_m**2, speed_m_s])
        terms.setflags(write=False)  # a look-ahead copies no array that cannot change
        return terms

    def _learn(self, t_s: float, value_hz: float, terms: Floats) -> Detected | None:
        if not self._baseline:
            self._baseline_start_s = t_s
        self._baseline.append((value_hz, terms))
        # Half a nanosecond: the grid's times carry rounding, and the last sample belongs to the baseline.
        if t_s - self._baseline_start_s < self.settings.baseline_s - 5e-10:
            return None
        n = len(self._baseline)
        values_hz = np.array([each[0] for each in self._baseline])
        given = np.array([each[1] for each in self._baseline])
        plain_hz = np.array([math.fsum(values_hz) / n])
        curve = np.linalg.lstsq(given, values_hz, rcond=None)[0] if self.settings.tendon else plain_hz
        free = n - given.shape[1]
        variance = math.fsum((values_hz - given @ curve) ** 2) / free if free > 0 else 0.0
        mean_hz = float(terms @ curve)
        if variance <= 0.0:
            self._refused = True
            reason = (
                f"{n} samples" if n < 2 else "no variance: is the oscillation locked, is the counter alive?"
            )
            return BaselineRefused(t_s, self.name, mean_hz, math.nan, reason)
        self._curve, self._sigma_hz = curve, math.sqrt(variance)
        self._threshold_hz = mean_hz + self.settings.threshold_sigma * self._sigma_hz
        self._baseline.clear()
        return BaselineReady(t_s, self.name, mean_hz, self._threshold_hz)


class CycleCounter:
    """Rising zero crossings of a sampled waveform, with hysteresis, to a fraction of a sample.

    Does in software what comparator and period counter do in hardware, for recordings that hold the waveform alone.
    A crossing counts when the signal has been below `-hysteresis` since the last one; its instant is interpolated
    linearly between the two samples around zero. The mean is not removed: high-pass the waveform first where
    it has one.

    Args:
        hysteresis: Half-width of the dead band, in the waveform's unit.
    """

    def __init__(self, hysteresis: float) -> None:
        self._hysteresis = hysteresis
        self.reset()

    def reset(self) -> None:
        """Forget the last crossing."""
        self._armed = False
        self._last_x = math.nan
        self._last_t_s = math.nan
        self._crossing_s = math.nan
        self._pending_s = math.nan

    def push(self, times_s: Floats, x: Floats) -> tuple[list[float], list[float]]:
        """Process the next samples.

        Args:
            times_s: Shape (n,).
            x: Shape (n,). A sample that is not finite breaks the count: the next period begins after it.

        Returns:
            The instants at which periods ended and their lengths, both in seconds.
        """
        ends: list[float] = []
        periods: list[float] = []
        for t_s, value in zip(times_s.tolist(), x.tolist(), strict=True):
            if not math.isfinite(value):
                self.reset()
                continue
            if self._last_x < 0.0 <= value:
                step = (0.0 - self._last_x) / (value - self._last_x)
                self._pending_s = self._last_t_s + step * (t_s - self._last_t_s)
            if value < -self._hysteresis:
                self._armed = True
            elif value > self._hysteresis and self._armed:
                self._armed = False
                if math.isfinite(self._crossing_s):
                    ends.append(t_s)
                    periods.append(self._pending_s - self._crossing_s)
                self._crossing_s = self._pending_s
            self._last_x, self._last_t_s = value, t_s
        return ends, periods
