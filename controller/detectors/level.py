"""Contact by the level of a finger's envelope: the paper's z-score, and jumps off the circle that stay."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, Strict, field_validator

from behaviors.events import Contact, ContactHeld, ContactLost, Detected
from controller.detectors.envelope import (
    Direction,
    EnvelopeSamples,
    OnEnvelope,
    as_complex,
    recorded,
    with_position,
)
from controller.detectors.protocol import Quantity, decisions
from controller.signals.iq import IqSettings
from controller.signals.level import StepSearch, Window, find_steps, step_search, window, z_scores
from drivers.core.messages import Floats, Ints
from drivers.core.settings import DriveHz, Mismatch, Settings, StreamName


class LevelPaperSettings(Settings):
    """The paper's criterion, with what it does not print as settings."""

    input: StreamName = "signals.right"
    """Envelope of one finger, full scales, at a fixed rate; its first channel, the in-phase one, is used."""

    window_s: float = Field(default=2.0, gt=0.0, le=600.0)
    """Samples that mean and standard deviation are taken of, s. Not printed."""

    threshold: float = Field(default=6.0, gt=0.0, le=1e6)
    """gamma, standard deviations. Not printed ("heuristically set"); with 3, noise alone is contact 3 times in a
    second at 1 kHz."""

    hold_s: float = Field(default=0.1, gt=0.0, le=600.0)
    """Contact persists after this time above it, s. Not printed; in a window of 2 s contact is forgotten after
    0.2 s at gamma 3, and sooner at more."""


class LevelPaperDetector(OnEnvelope[LevelPaperSettings]):
    """Contact while a sample is farther from its own window's mean than some of the window's standard deviations.

    |z| of the newest of n samples is at most (n - 1) / sqrt(n), and that of a level which fills the share p of the
    window sqrt((1 - p) / p): with gamma 3 no window of 10 samples or fewer detects anything, and a contact that lasts
    a tenth of the window is forgotten; its end is then reported as a contact as well. That is the paper's criterion,
    unchanged.

    Emits `Contact` above gamma, `ContactHeld` once after `hold_s`, `ContactLost` below; nothing until the window is
    full. A gap restarts the window; values that are not finite are ignored.

    Reference: S. Rupavatharam, C. Escobedo et al., "SonicFinger: Pre-touch and Contact Detection Tactile Sensor for
    Reactive Pregrasping", section III.E.

    Example:
        >>> detector = LevelPaperDetector("touch", LevelPaperSettings(window_s=0.1, threshold=4.0))
        >>> level = np.where(np.arange(300) < 200, 0.01, 0.02)[:, None] + 1e-5 * np.sin(np.arange(300))[:, None]
        >>> events = detector.push(SampleBlock("signals.right", 0, 0.0, level, rate_hz=1000.0))
        >>> [(type(event).__name__, event.t_s) for event in events]
        [('Contact', 0.2), ('ContactLost', 0.205)]
    """

    doing = "waiting for contact"
    quantity = Quantity("distance from the mean of its window", "σ")

    def reset(self) -> None:
        """Clear window and contact."""
        super().reset()
        self._window: Window | None = None
        self._touching = False
        self._lasted = 0

    def _decide(self, samples: EnvelopeSamples) -> Sequence[Detected]:
        scores, threshold = self._scores(samples), self.settings.threshold
        self.readings = decisions(samples.times_s, scores, threshold)
        if not self._touching and not (scores > threshold).any():  # NaN is not
            return ()
        hold = max(1, round(self.settings.hold_s * samples.rate_hz))
        events: list[Detected] = []
        for t_s, score, _ in self.readings.tolist():
            above = score > threshold
            kind: type[Detected] | None = None
            if above != self._touching:
                self._touching, self._lasted = above, 0
                kind = Contact if above else ContactLost
            elif above:
                self._lasted += 1
                kind = ContactHeld if self._lasted == hold else None
            if kind is not None:
                events.append(kind(t_s, self.name, score, threshold))
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """|z| after each sample, NaN until the window is full, shape (n,); the first column is used."""
        return self._fresh()._scores(recorded(values[:, 0].astype(np.complex128), rate_hz))

    def _scores(self, samples: EnvelopeSamples) -> Floats:
        if self._window is None:
            self._window = window(max(2, round(self.settings.window_s * samples.rate_hz)))
        scores = np.empty(len(samples.z))
        z_scores(self._window, np.ascontiguousarray(samples.z.real), samples.missing, scores)
        return np.abs(scores)


class LevelSettings(Settings):
    """The detector that looks for a jump after which the level stays. Times in seconds hold at any sample rate."""

    input: StreamName = "signals.right"
    """Envelope of one finger: I and Q, full scales, at a fixed rate."""

    position_input: StreamName | None = None
    """The mover's encoder: a position (m), or a pose. With it a wave is expected to turn by the way gone, and what
    rings after a stop is no touch; None: by time, and a braking mover hides small touches."""

    direction: Direction = (1.0, 0.0, 0.0)
    """Along which a pose is measured; a position has its direction already."""

    ring_s: float = Field(default=0.3, ge=0.0, le=10.0)
    """How long a mover rings after a stop, s: in that time, and while it comes to stand, no jump is a touch."""

    threshold: float = Field(default=7.0, gt=0.0, le=1e9)
    """Jump that means contact, in root mean squares of the other jumps. White Gaussian noise would reach 3.8 once an
    hour, but a starting arm is not white: chosen on simulated approaches, of which some 1 % reach it
    without contact (benchmarks/pretouch). On a noisy mover with its encoder a few approaches in a hundred jump far
    higher, and a threshold from those feels hardly any touch (benchmarks/results/level_stops.md): look at it beside
    this one."""

    spans_s: Annotated[tuple[float, ...], Strict(False)] = (0.004, 0.008, 0.016)
    """Lengths over which a jump is looked for, s, growing. Assumption: a finger's foam takes its first load within
    milliseconds; an undulation at 0.03 m/s bends by a tenth of its amplitude in 16 ms."""

    settle_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """How long after a jump the level may take to settle, s. Assumption: a gripper reaches its force sooner."""

    stay_s: float = Field(default=0.06, gt=0.0, le=10.0)
    """How long it must then stay before contact is reported, s. Assumption: an undulation at 0.01 m/s turns by 50
    degrees."""

    rise_s: float = Field(default=0.06, ge=0.0, le=10.0)
    """Delay after which a jump enters the scales, s, so that a slow one is not compared with itself. Assumption: a
    finger at 0.01 m/s has pressed its foam by 0.6 mm."""

    flat: float = Field(default=0.1, gt=0.0, le=1.0)
    """Largest change in that time, as a share of the step. A steady change since the jump always exceeds it."""

    scale_s: float = Field(default=0.5, ge=1e-3, le=600.0)
    """Memory of the other jumps, s. Assumption: an undulation at 0.01 m/s."""

    fast_scale_s: float = Field(default=0.04, ge=1e-3, le=600.0)
    """A second, faster one: a starting arm's noise comes at once. The larger scale counts."""

    learn_s: float = Field(default=0.3, gt=0.0, le=600.0)
    """Time after a reset over which the level at rest is averaged, s; the finger must stand still or be far from
    everything."""

    drift_fs_s: float = Field(default=5e-5, ge=0.0, le=1.0)
    """How fast the level at rest may drift, full scales a second. Assumption: a thousandth of what a touch does."""

    drive_hz: DriveHz = Field(default=40_000.0, gt=0.0, le=1e6)
    """Frequency of the aura (III.A: 40 kHz)."""

    sound_m_s: float = Field(default=343.2, gt=100.0, le=1000.0)
    """Speed of sound: air at 20 degrees."""

    acceleration_m_s2: float = Field(default=0.5, ge=0.0, le=100.0)
    """How hard the mover accelerates and brakes: its effect on an undulation is not a touch."""

    end_s: float = Field(default=0.015, gt=0.0, le=10.0)
    """How long half the step must be gone before contact is over, s."""

    hold_s: float = Field(default=0.5, gt=0.0, le=600.0)
    """Contact persists after this time, s."""

    follow_s: float = Field(default=2.0, gt=0.0, le=3600.0)
    """How fast the level in contact is followed, by a third of the step at most, s: drift."""

    max_gap_s: float = Field(default=0.004, ge=0.0, le=1.0)
    """Bad samples that are bridged, s; after more, and after lost ones, levels are not compared across the gap."""

    @field_validator("spans_s")
    @classmethod
    def _growing(cls, spans_s: tuple[float, ...]) -> tuple[float, ...]:
        if not spans_s or min(spans_s) <= 0.0 or list(spans_s) != sorted(set(spans_s)):
            raise ValueError("positive lengths, each longer than the one before it, at least one")
        return spans_s

    def mismatches(
        self, path: tuple[str, ...], profile: Mapping[tuple[str, ...], Settings]
    ) -> Iterator[Mismatch]:
        """The rest at a trial's begin must be long enough to learn in, also of a signal that begins late."""
        from behaviors.sonic import SonicSettings

        behavior, chain = profile.get(("behavior",)), profile.get(tuple(self.input.split(".")))
        if not (isinstance(behavior, SonicSettings) and isinstance(chain, IqSettings)):
            return
        needed_s = chain.silent_s + self.learn_s
        if behavior.baseline_s < needed_s:
            late = f"[{self.input}] tracks for {chain.silent_s:.2f} s before it gives anything, and "
            mistake = (
                f" = {behavior.baseline_s}: {late if chain.silent_s else ''}[{'.'.join(path)}] learns for"
                f" {self.learn_s:g} s; make it {math.ceil(100.0 * needed_s) / 100.0:g} or longer"
            )
            yield Mismatch(("behavior",), "baseline_s", mistake)


class LevelDetector(OnEnvelope[LevelSettings]):
    """Contact when I and Q leave the circle on which an undulation turns, and stay where they are.

    About the level at rest an undulation turns steadily. At each length of `spans_s` its turning is measured over the
    last spans and extrapolated; the distance of the measured from the predicted value is the jump. It is compared with
    the root mean square of earlier jumps of that length, and with the effect of a braking mover, which turns the wave
    less than predicted but leaves its size. Then the level must stay: within `settle_s` of the jump there must be
    `stay_s` in which all thirds are near their mean, measured by the change since before the jump, and which is not
    merely part of a steady change since then. The start of a motion jumps as well, but does not stay.

    `Contact` comes when the level has stayed; `ContactHeld` once, after `hold_s`; `ContactLost` when half of the step
    has been back for `end_s`. The step is kept for as long as the contact lasts. A slow drift in contact is
    followed by a third of the step at most, so that a slow release is still detected. The level at
    rest is the mean of the first `learn_s` and follows drift, no faster than `drift_fs_s`, while there is no contact.
    `value` is the jump in scales, at the end the share of the step that is left.

    Not detected: a contact that comes more slowly than an undulation does, one that changes the level by less
    than braking does, and one that begins within a gap.

    Example:
        >>> detector = LevelDetector("touch", LevelSettings())
        >>> noise = 1e-5 * np.random.default_rng(1).standard_normal((3000, 2))
        >>> level = np.where((np.arange(3000) < 1000) | (np.arange(3000) >= 2000), 0.01, 0.02)[:, None] + noise
        >>> events = detector.push(SampleBlock("signals.right", 0, 0.0, level, rate_hz=1000.0))
        >>> [type(event).__name__ for event in events]
        ['Contact', 'ContactHeld', 'ContactLost']
    """

    doing = "waiting for contact"
    quantity = Quantity("jump of the level over the rms of the other jumps", "")

    def reset(self) -> None:
        """Clear levels, scales and contact."""
        super().reset()
        self._search: StepSearch | None = None

    def _decide(self, samples: EnvelopeSamples) -> Sequence[Detected]:
        threshold = self.settings.threshold
        scores, found = self._scores(samples, threshold)
        self.readings = decisions(samples.times_s, scores, threshold)
        events: list[Detected] = []
        for i in np.flatnonzero(found).tolist():
            kind = (Contact, ContactHeld, ContactLost)[found[i] - 1]
            events.append(kind(float(samples.times_s[i]), self.name, float(scores[i]), threshold))
        return events

    def statistic(self, values: Floats, rate_hz: float) -> Floats:
        """The jump after which the level stays, in scales, 0 where there is none, NaN while it learns, shape (n,).

        Args:
            values: I and Q, or I alone, shape (n, channels); with `position_input` I, Q and the mover's position in
                metres, shape (n, 3). Without contact.
            rate_hz: Of all.

        Raises:
            ValueError: with `position_input`, there are not three columns.
        """
        z, position_m = as_complex(values), None
        if self.settings.position_input is not None:
            z, position_m = with_position(values, "level")
        found = self._fresh()._scores(recorded(z, rate_hz, position_m), math.inf)[0]
        learnt = found[round(self.settings.learn_s * rate_hz) :]
        learnt[np.isnan(learnt)] = 0.0
        if position_m is not None:  # live, a sample waits for the encoder
            found[np.flatnonzero(~np.isnan(position_m)).max(initial=-1) + 1 :] = math.nan
        return found

    def _scores(self, samples: EnvelopeSamples, threshold: float) -> tuple[Floats, Ints]:
        if self._search is None:
            self._search = self._begun(samples.rate_hz)
        scores, found = np.empty(len(samples.z)), np.empty(len(samples.z), np.int64)
        find_steps(self._search, threshold, samples.z, samples.position_m, samples.missing, scores, found)
        return scores, found

    def _begun(self, rate_hz: float) -> StepSearch:
        settings = self.settings

        def samples(length_s: float) -> int:
            return max(1, round(length_s * rate_hz))

        spans = np.array(sorted({samples(span_s) for span_s in settings.spans_s}), dtype=np.int64)
        hops = np.maximum(1, spans // 2)
        kappa_rad_m = 4.0 * math.pi * settings.drive_hz / settings.sound_m_s
        memories = np.array([settings.scale_s, settings.fast_scale_s]) * rate_hz
        return step_search(
            spans=spans,
            hops=hops,
            # in two spans a braking mover falls behind by a t^2 / 2, and the wave by 2 k times that
            bends=np.asarray(0.5 * kappa_rad_m * settings.acceleration_m_s2 * (2.0 * spans / rate_hz) ** 2),
            kappa_rad_m=kappa_rad_m,
            keeps=np.exp(-hops[:, None] / memories),
            delays=np.maximum(3 * spans, samples(settings.rise_s)) // hops,
            settle=samples(settings.settle_s),
            third=samples(settings.stay_s / 3.0),
            flat=settings.flat,
            learn=samples(settings.learn_s),
            drift_fs=settings.drift_fs_s / rate_hz,
            end=samples(settings.end_s),
            hold=samples(settings.hold_s),
            keep_level=math.exp(-1.0 / (settings.follow_s * rate_hz)),
            patience=round(settings.max_gap_s * rate_hz),
            ringing=round(settings.ring_s * rate_hz),
        )
