"""Pre-touch by the paper: spectral power between 0 and 100 Hz, window by window."""

import math
from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from pydantic import Field

from behaviors.events import Detected, PreTouch, PreTouchLost
from controller.detectors.envelope import Direction, EnvelopeSamples, OnEnvelope
from controller.detectors.protocol import Hysteresis, Quantity, decisions
from controller.signals.spectrum import BlockCutter
from drivers.core.messages import Floats
from drivers.core.settings import Settings, StreamName


class PreTouchPaperSettings(Settings):
    """The paper's criterion, with what it does not print as settings."""

    input: StreamName = "signals.right"
    """Envelope of one finger, full scales, at a fixed rate; its first channel, the in-phase one, is used."""

    position_input: StreamName | None = None
    """The mover's encoder, reported with each event and not used otherwise; None: no encoder, position NaN."""

    direction: Direction = (1.0, 0.0, 0.0)
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


class PreTouchPaperDetector(OnEnvelope[PreTouchPaperSettings]):
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

    doing = "detecting pre-touch"
    quantity = Quantity("power of the window", "FS²")
    decides_in_motion = True

    def reset(self) -> None:
        """Clear the window begun and the object."""
        super().reset()
        self._windows: BlockCutter | None = None
        self._near = Hysteresis()

    def _decide(self, samples: EnvelopeSamples) -> Sequence[Detected]:
        if self._windows is None:
            self._windows = self._cutter(samples.rate_hz)
        powers, complete = np.full(len(samples.z), np.nan), False
        starts = [0, *np.flatnonzero(samples.missing).tolist()]
        for start, end in pairwise([*starts, len(samples.z)]):
            if samples.missing[start]:
                self._windows.reset()
            ends, windows = self._windows.push(samples.z.real[start:end, None])
            if len(ends):
                complete = True
                powers[start + ends] = self._powers(windows, samples.rate_hz)
        if not complete:
            return ()
        threshold = self.settings.threshold
        self.readings = decisions(samples.times_s, powers, threshold)
        events: list[Detected] = []
        for i, near in self._near.changes(powers, threshold, release=threshold):
            t_s, position_m = float(samples.times_s[i]), float(samples.position_m[i])
            # one and the same NaN, so that equal events are equal
            known_m = position_m if math.isfinite(position_m) else math.nan
            kind = PreTouch if near else PreTouchLost
            events.append(kind(t_s, self.name, float(powers[i]), threshold, known_m))
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """Power at the last sample of each window, NaN elsewhere, shape (n,); the first column is used."""
        found = np.full(len(values), np.nan)
        ends, windows = self._cutter(rate_hz).push(values[:, :1])
        found[ends] = self._powers(windows, rate_hz)
        return found

    def _cutter(self, rate_hz: float) -> BlockCutter:
        return BlockCutter(round(self.settings.window_s * rate_hz))

    def _powers(self, windows: Floats, rate_hz: float) -> Floats:
        """Summed power of each window, shape (m,); NaN for one with a value that is not finite."""
        size = windows.shape[1]
        powers = np.full(len(windows), np.nan)
        last = math.floor(self.settings.band_hz * size / rate_hz + 1e-9)
        # each window by itself: a transform of many at once may differ in the last bit
        for row in np.flatnonzero(np.isfinite(windows).all(axis=(1, 2))):
            window = windows[row, :, 0]
            if self.settings.remove_dc:
                window = window - window.mean()
            spectrum = np.abs(np.fft.rfft(window) / size) ** 2
            spectrum[1 : (size + 1) // 2] *= 2.0  # the negative frequencies'
            powers[row] = float(spectrum[: last + 1].sum())
        return powers
