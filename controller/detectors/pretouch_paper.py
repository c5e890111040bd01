"""Pre-touch by the paper: spectral power between 0 and 100 Hz, window by window."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from behaviors.events import Detected, PreTouch, PreTouchLost
from controller.detectors.protocol import NOTHING, Quantity
from controller.signals.along import Along, EnvelopeSamples
from drivers.core.messages import SampleBlock
from drivers.core.settings import Settings, StreamName

Floats = NDArray[np.float64]


class PreTouchPaperSettings(Settings):
    """The paper's criterion, with what it does not print as settings."""

    input: StreamName = "signals.right"
    """Envelope of one finger, full scales, at a fixed rate; its first channel, the in-phase one, is used."""

    position_input: StreamName | None = None
    """The mover's encoder, reported with each event and not used otherwise; None: no encoder, position NaN."""

    direction: Annotated[tuple[float, float, float], Strict(False)] = (1.0, 0.0, 0.0)
    """Along which a pose is measured; a position has its direction already."""

    window_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """alpha, s. Not printed: the best of 0.25, 0.5 and 1 s in prototypes."""

    band_hz: float = Field(default=100.0, gt=0.0, le=1e5)
    """Power is summed from 0 to this (III.C: 0 to 100 Hz)."""

    remove_dc: bool = True
    """Take the window's mean off first. The literal method does not, and its sum is the bridge's imbalance squared:
    pre-touch always, or never."""

    threshold: float = Field(default=1e-8, gt=0.0, le=1e12)
    """gamma, full scales squared. Not printed ("heuristic"); here the power of a wave of 0.00014 full scales."""


class PreTouchPaperDetector:
    """Pre-touch while the power of a window between 0 and 100 Hz exceeds a threshold.

    Windows follow each other without overlap. Power is |DFT / N|^2 over both signs of frequency, so the sum over all
    frequencies is the window's mean square. `PreTouch` comes with the last sample of the first window above the
    threshold, `PreTouchLost` with that of the first one below. A gap begins a new window; one with a value that is not
    finite is skipped.

    Reference: S. Rupavatharam, C. Escobedo et al., "SonicFinger: Pre-touch and Contact Detection Tactile Sensor for
    Reactive Pregrasping", section III.C.

    Example:
        >>> detector = PreTouchPaperDetector("near", PreTouchPaperSettings(window_s=0.4))
        >>> wave = 0.001 * np.sin(2 * np.pi * 5.0 * np.arange(400) / 1000.0)
        >>> [event.t_s for event in detector.push(SampleBlock("signals.right", 0, 0.0, wave[:, None], rate_hz=1000.0))]
        [0.399]
    """

    quantity = Quantity("power of the window", "FS²")

    def __init__(self, name: str, settings: PreTouchPaperSettings) -> None:
        self.name = name
        self.settings = settings
        encoder = settings.position_input
        self.inputs = (settings.input,) if encoder is None else (settings.input, encoder)
        self.envelope = settings.input
        self._along = Along(settings.input, encoder, settings.direction, "detecting pre-touch")
        self.reset()

    def reset(self) -> None:
        """Clear the window begun and the object."""
        self.readings = NOTHING
        self._along.reset()
        self._begun = np.empty(0)
        self._near = False

    def push(self, block: SampleBlock) -> Sequence[Detected]:
        """Process the next samples.

        Raises:
            ValueError: an envelope at irregular times, or so slow that a window has no two samples.
        """
        samples, self.readings = self._along.push(block), NOTHING
        if not len(samples.times_s) or self._along.rate_hz is None:
            return []
        events: list[Detected] = []
        read: list[tuple[float, float, float]] = []
        for i, power in self._windows(samples, self._along.rate_hz):
            near = power > self.settings.threshold
            if math.isnan(power):
                continue
            t_s, position_m = float(samples.times_s[i]), float(samples.position_m[i])
            read.append((t_s, power, self.settings.threshold))
            if near == self._near:
                continue
            self._near = near
            kind = PreTouch if near else PreTouchLost
            # one and the same NaN, so that equal events are equal
            known_m = position_m if math.isfinite(position_m) else math.nan
            events.append(kind(t_s, self.name, power, self.settings.threshold, known_m))
        self.readings = np.array(read).reshape(-1, 3)
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Power at the last sample of each window, NaN elsewhere, shape (n,); the first column is used."""
        size = self._size(rate_hz)
        found = np.full(len(values), np.nan)
        count = len(values) // size
        windows = values[: count * size, 0].reshape(count, size)
        found[size - 1 :: size] = self._powers(windows, rate_hz)
        return found

    def _size(self, rate_hz: float) -> int:
        size = round(self.settings.window_s * rate_hz)
        if size < 2:
            raise ValueError(
                f"{self.settings.input}: {size} samples in a window of {self.settings.window_s:g} s; make it longer"
            )
        return size

    def _windows(self, samples: EnvelopeSamples, rate_hz: float) -> list[tuple[int, float]]:
        """Which samples completed a window, and its power."""
        size = self._size(rate_hz)
        found: list[tuple[int, float]] = []
        starts = [0, *np.flatnonzero(samples.missing).tolist()]
        for start, end in zip(starts, [*starts[1:], len(samples.z)], strict=True):
            if start or (end and samples.missing[0]):
                self._begun = np.empty(0)
            waiting = len(self._begun)
            joined = np.concatenate((self._begun, samples.z.real[start:end]))
            count = len(joined) // size
            self._begun = joined[count * size :]
            powers = self._powers(joined[: count * size].reshape(count, size), rate_hz).tolist()
            found += [
                (start + (number + 1) * size - 1 - waiting, power) for number, power in enumerate(powers)
            ]
        return found

    def _powers(self, windows: Floats, rate_hz: float) -> Floats:
        """Summed power of each window, shape (m,); NaN for one with a value that is not finite."""
        size = windows.shape[1]
        if not len(windows):
            return np.empty(0)
        good = np.isfinite(windows).all(axis=1)
        # each window by itself: a transform of many at once may differ in the last bit
        powers = np.full(len(windows), np.nan)
        for row in np.flatnonzero(good):
            window = windows[row]
            if self.settings.remove_dc:
                window = window - window.mean()
            spectrum = np.abs(np.fft.rfft(window) / size) ** 2
            spectrum[1 : (size + 1) // 2] *= 2.0  # the negative frequencies'
            last = math.floor(self.settings.band_hz * size / rate_hz + 1e-9)
            powers[row] = float(spectrum[: last + 1].sum())
        return powers
