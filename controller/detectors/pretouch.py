"""Pre-touch by a matched filter along the path: the envelope's I and Q against the mover's encoder."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict, field_validator

from behaviors.events import Detected, PreTouch, PreTouchLost
from controller.detectors.envelope import Direction, EnvelopeSamples, OnEnvelope, recorded, with_position
from controller.detectors.protocol import Quantity, decisions
from controller.signals.undulation import WaveFit, fit_wave, wave_fit
from drivers.core.messages import Floats
from drivers.core.settings import DriveHz, Settings, StreamName

CELLS_PER_TURN = 16
"""Cells in each half wavelength: a mean over one takes 0.6 % of the wave away."""

LONGEST_CELL_S = 0.5
"""Longest time over which a cell averages, s: limits the effect of drift on a creeping mover. Assumption."""

CERTAIN = 20.0
"""F ratio of a wave that noise does not make. Chosen on simulated rooms."""


class PreTouchSettings(Settings):
    """What the matched filter looks for. Lengths in metres: they hold at any speed and sample rate."""

    input: StreamName = "signals.right"
    """Envelope of one finger: I and Q, full scales, at a fixed rate."""

    position_input: StreamName = "arm.position"
    """The mover's encoder: a position (m), or a pose whose first three values are a place (m)."""

    direction: Direction = (1.0, 0.0, 0.0)
    """Along which a pose is measured, in its own frame; a position has its direction already."""

    drive_hz: DriveHz = Field(default=40_000.0, gt=0.0, le=1e6)
    """Frequency of the aura (Rupavatharam et al., III.A: 40 kHz)."""

    sound_m_s: float = Field(default=343.2, gt=100.0, le=1000.0)
    """Speed of sound: air at 20 degrees. A few per cent make no difference."""

    obliquity: Annotated[tuple[float, ...], Strict(False)] = (1.42, 1.26, 1.12, 1.0, 0.89, 0.79, 0.7)
    """How fast an object comes nearer, as shares of the way, toward it and away from it: what is looked for. 1 is
    straight ahead or behind, less a cosine (0.77: a face that slants by 40 degrees), more an object that comes by
    itself; a wave that is shorter or longer than believed is as either. Chosen on simulated rooms: in steps of an
    eighth, which the memory bridges, between objects that go and come at 0.3 to 0.4 of the mover's speed."""

    memory_m: float = Field(default=0.008, gt=0.0, le=1.0)
    """Distance after which a sample counts for 1/e. Assumption: two undulations at 40 kHz; an echo that
    doubles in that distance is detected as well."""

    least_m: float = Field(default=0.005, gt=0.0, le=1.0)
    """Distance before the first decision. Assumption: a little more than one undulation at 40 kHz."""

    threshold: float = Field(default=18.0, gt=0.0, le=1e12)
    """F ratio that means pre-touch: explained over residual variance plus that of a static background, each per degree
    of freedom. Calibrate it on motion without an object."""

    background_fs: float = Field(default=1.5e-4, ge=0.0, le=1.0)
    """Amplitude that walls, a table or gears may have in the envelope. A wave that was there `learn_m` ago counts as
    background up to four times this; before, this is granted. 0 for a room without echoes: longest range.
    `run.py calibrate` proposes it."""

    learn_m: float = Field(default=0.015, gt=0.0, le=1.0)
    """Distance after which an echo counts as background. An echo that doubles in it, as an object's within some 4 cm
    does, stands out. Chosen on simulated rooms."""

    stretch_m: float = Field(default=0.006, ge=0.0, le=1.0)
    """Stretch of the way over which a background is learned at the least: waves of two walls cancel here and add there.
    Chosen on simulated rooms."""

    release_ratio: float = Field(default=0.5, gt=0.0, le=1.0)
    """Share of the threshold below which the object is lost."""

    level_fs: float = Field(default=0.0, ge=0.0, le=1.0)
    """Amplitude of the wave (times `gain`) that pre-touch needs beside it, full scales; 0 asks for none. An amplitude
    belongs to a distance: with it both fingers detect at the same one, which centering needs."""

    gain: float = Field(default=1.0, gt=0.0, le=1e3)
    """Factor on this finger's amplitude before it is compared with `level_fs`: calibrates fingers against each
    other."""

    pause_s: float = Field(default=5.0, gt=0.0, le=3600.0)
    """A standstill of this length restarts the fit. Assumption: the bridge's offset drifts little in it."""

    max_gap_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """The same for lost or unusable samples."""

    @field_validator("obliquity")
    @classmethod
    def _some_angle(cls, obliquity: tuple[float, ...]) -> tuple[float, ...]:
        if not obliquity or not all(0.0 < share <= 2.0 for share in obliquity):
            raise ValueError("shares of the way between 0 (not itself) and 2, at least one")
        return obliquity

    @property
    def undulation_m(self) -> float:
        """Way that turns the wave once around: half a wavelength."""
        return 0.5 * self.sound_m_s / self.drive_hz


class PreTouchDetector(OnEnvelope[PreTouchSettings]):
    """Pre-touch while a wave of the reflected sound's wavelength is in the envelope along the way.

    Amplitude, phase, decay, offset and slow drift are fitted; from the residual it learns the
    noise, and from the path so far the static background of the room: that hardly grows, an object's echo does. The
    statistic is the better of two: the best wave against the best so far, the one straight ahead against its own. Emits
    `PreTouch` at the sample that completes the first cell (a sixteenth of an undulation) whose F ratio is above the
    threshold, and `PreTouchLost` at the first one below `release_ratio` of it; `value` is the ratio.
    At standstill there are no events. A bad sample, or a gap, costs a cell; a jump of the level, as at contact,
    restarts the fit, and the last event stands until the path is long enough again.

    It subscribes to two streams, and decides about a time once both have reached it.

    Example:
        >>> detector = PreTouchDetector("near", PreTouchSettings())
        >>> detector.inputs
        ('signals.right', 'arm.position')
    """

    doing = "detecting pre-touch"
    quantity = Quantity("explained over residual variance", "")
    decides_in_motion = True

    def reset(self) -> None:
        """Clear the object and the path."""
        super().reset()
        self._fit: WaveFit | None = None
        self._near = False

    def _decide(self, samples: EnvelopeSamples) -> Sequence[Detected]:
        ratios, amplitudes_fs = self._fitted(samples)
        self.readings = decisions(samples.times_s, ratios, self.settings.threshold)
        events: list[Detected] = []
        settings = self.settings
        for i in np.flatnonzero(np.isfinite(ratios)).tolist():
            ratio, size_fs = float(ratios[i]), settings.gain * float(amplitudes_fs[i])
            share = settings.release_ratio if self._near else 1.0
            near = ratio > share * settings.threshold and size_fs >= share * settings.level_fs
            if near != self._near:
                self._near = near
                kind = PreTouch if near else PreTouchLost
                t_s, position_m = float(samples.times_s[i]), float(samples.position_m[i])
                events.append(kind(t_s, self.name, ratio, settings.threshold, position_m))
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """F ratio at the samples that complete a cell, NaN elsewhere, shape (n,).

        Args:
            values: I, Q and the mover's position in metres, shape (n, 3).
            rate_hz: Of all three.

        Raises:
            ValueError: there are not three columns.
        """
        return self.traced(*with_position(values, "pretouch"), rate_hz)[0]

    def proposed(self, values: Floats, rate_hz: float) -> Mapping[str, float]:
        """`background_fs` for a room of which this is a recording without an object: the largest wave in it that noise
        does not make, 0 where there is none; `values` as for `statistic`."""
        bare = self.set_to(background_fs=0.0)
        ratios, sizes_fs = bare.traced(*with_position(values, "pretouch"), rate_hz)
        return {"background_fs": float(np.max(sizes_fs, where=ratios > CERTAIN, initial=0.0))}

    def set_to(self, **settings: float) -> PreTouchDetector:
        """The same detector in its initial state, set otherwise."""
        return PreTouchDetector(self.name, self.settings.model_copy(update=settings))

    def traced(self, z: NDArray[np.complex128], position_m: Floats, rate_hz: float) -> tuple[Floats, Floats]:
        """F ratio and amplitude (full scales) of a whole recording from its first sample, shape (n,) each; the
        detector's own state is unchanged."""
        return self._fresh()._fitted(recorded(z, rate_hz, position_m))

    def _fitted(self, samples: EnvelopeSamples) -> tuple[Floats, Floats]:
        if self._fit is None:
            self._fit = self._begun(samples.rate_hz)
        ratios, amplitudes_fs = np.empty(len(samples.z)), np.empty(len(samples.z))
        fit_wave(self._fit, samples.z, samples.position_m, samples.missing, ratios, amplitudes_fs)
        return ratios, amplitudes_fs

    def _begun(self, rate_hz: float) -> WaveFit:
        settings = self.settings
        shares = np.array(settings.obliquity, dtype=np.float64)
        ahead = int(np.argmin(np.abs(shares - 1.0)))
        cell_m = settings.undulation_m / CELLS_PER_TURN
        return wave_fit(
            kappa_rad_m=2.0 * math.pi / settings.undulation_m * np.concatenate((shares, -shares)),
            straight=np.array([ahead, ahead + len(shares)]),
            cell_m=cell_m,
            memory_m=settings.memory_m,
            least_m=settings.least_m,
            longest=max(1, round(LONGEST_CELL_S * rate_hz)),
            background_fs=settings.background_fs,
            lag=max(1, round(settings.learn_m / cell_m)),
            stretch=round(settings.stretch_m / cell_m),
            pause=max(1, round(settings.pause_s * rate_hz)),
            patience=max(1, round(settings.max_gap_s * rate_hz)),
        )
