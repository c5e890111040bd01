"""The slip detector's arithmetic once more: in long double, sample by sample.

From the equations of docs/explanation/slip.md. Slow and plain on purpose. It shares no code with the compiled one.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from controller.detectors.slip import SlipSettings

Long = np.longdouble


class Reference:
    """Evidence of one channel.

    Args:
        settings: Of the detector.
        rate_hz: Sample rate.
    """

    def __init__(self, settings: SlipSettings, rate_hz: float) -> None:
        s = settings
        self.p = s.order
        self.learn = max(2 * s.order, round(s.learn_s * rate_hz))
        # constants are what they are in double: their rounding is not at issue
        self.keep = Long(math.exp(-1.0 / (s.memory_s * rate_hz)))
        self.keep_energy = Long(math.exp(-1.0 / (s.energy_s * rate_hz)))
        self.scale = Long(s.scale_s * rate_hz)
        self.error = Long(s.model_error)
        self.knock = Long(min(0.3, s.knocks_hz / rate_hz))
        self.jump = Long(min(0.2 * float(self.knock), s.jumps_hz / rate_hz))
        self.cap = Long(math.log(float(self.knock) / float(self.jump)))
        self.refill = Long(float(self.cap) / (s.jump_s * rate_hz))
        self.ratio = Long(s.knock_ratio)
        self.gram = np.zeros((self.p, self.p), dtype=Long)
        self.cross = np.zeros(self.p, dtype=Long)
        self.weights = np.zeros(self.p, dtype=Long)
        self.heard: list[np.longdouble] = []
        self.seconds: list[np.longdouble] = []
        self.first: list[np.longdouble] = []
        self.count = 0
        self.noise = self.energy = Long(0)
        self.gain = Long(6)
        self.sum = Long(0)
        self.credit = self.cap
        self.patience = round(s.max_gap_s * rate_hz) + s.order + 2
        self.missing = 0

    def push(self, x: NDArray[np.float64]) -> NDArray[np.longdouble]:
        """Evidence after each sample; NaN is a gap."""
        return np.array([self._sample(Long(value)) for value in x])

    def _sample(self, x: np.longdouble) -> np.longdouble:
        judged = None
        if np.isnan(x):
            self.heard, self.seconds = [], []
        else:
            self.heard = [*self.heard[-2:], x]
            if len(self.heard) == 3:
                judged = self._second((self.heard[2] - self.heard[1]) - (self.heard[1] - self.heard[0]))
        if judged is not None:
            self.missing = 0
            self._judge(judged)
        else:
            self.missing += 1
            if self.missing > self.patience:
                self.sum = Long(0)
        return self.sum

    def _second(self, d: np.longdouble) -> np.longdouble | None:
        """The squared innovation over its variance, where there is one."""
        if self.count < self.learn:
            self._first(abs(d))
            return None
        bound = 1000 * np.sqrt(6 * self.noise)
        d = min(max(d, -bound), bound)
        past = np.array(self.seconds[::-1], dtype=Long)
        judged = None
        if len(past) == self.p and self.count >= self.learn + self.p:
            e2 = (d - self.weights @ past) ** 2
            floor = self.gain * self.noise
            judged = e2 / (floor + self.error**2 * self.energy)
            if e2 > 0:
                pace = self.scale if self.sum < self.cap else 8 * self.scale
                self.noise *= 1 + (min(e2 / floor, Long(4)) - Long(0.9205369)) / pace
                weight = min(Long(1), 1 / judged)
                self.gram = self.keep * self.gram + weight * np.outer(past, past)
                self.cross = self.keep * self.cross + weight * d * past
        self.count += 1
        if self.count % 8 == 0:
            self._solve()
        self.seconds = [*self.seconds[-(self.p - 1) :], d]
        self.energy = self.keep_energy * self.energy + (1 - self.keep_energy) * d * d
        return judged if self.count >= 2 * self.learn else None

    def _first(self, magnitude: np.longdouble) -> None:
        self.first.append(magnitude)
        self.count += 1
        if self.count == self.learn:
            kept = sorted(self.first)[: int(0.75 * self.learn)]
            self.noise = sum((value * value for value in kept), Long(0)) / (len(kept) * Long(0.3685241) * 6)
            self.energy = 6 * self.noise

    def _judge(self, squared: np.longdouble) -> None:
        lift = np.exp(min(squared, Long(100)) * (1 - 1 / self.ratio) / 2) / np.sqrt(self.ratio)
        odds = np.log((1 - self.knock + self.knock * lift) / (1 - self.jump + self.jump * lift))
        if odds > 0:
            odds = min(odds, self.credit)
            self.credit -= odds
        self.credit = min(self.cap, self.credit + self.refill)
        self.sum = max(Long(0), self.sum + odds)

    def _solve(self) -> None:
        """Gaussian elimination, for the compiled one uses Cholesky's factors."""
        trace = np.trace(self.gram)
        if trace <= 0:
            return
        ridge, drift = Long(1e-6) * trace, Long(1e-4) * trace / self.p
        a = np.column_stack([self.gram + drift + ridge * np.eye(self.p, dtype=Long), self.cross + drift])
        for i in range(self.p):
            a[i] /= a[i, i]
            for j in range(self.p):
                if j != i:
                    a[j] -= a[j, i] * a[i]
        self.weights = a[:, -1]
        taps = np.convolve(np.concatenate(([Long(1)], -self.weights)), np.array([1, -2, 1], dtype=Long))
        self.gain = taps @ taps
