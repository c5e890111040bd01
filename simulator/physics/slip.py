"""A fingertip on a table: touch, roll, slip, stop, as a force sensor feels it.

The equations, their sources and what is assumed: docs/explanation/slip.md. The five sensors of Fernandez et al. are
settings of this one plant, in slip_sensors.toml.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from drivers.core.messages import Floats
from drivers.core.settings import Settings
from simulator.physics import slip_kernel as kernel
from simulator.physics.stage_axis import SANE


class SlipNuisances(Settings):
    """Disturbances of one sensor and its table.

    Those of the read-out act where the plant's own bridges have their noise and converter: on both fingertips, and on
    the BarrettHand's noise.
    """

    change_s: float = Field(default=2.0, ge=0.0, le=1e6)
    """When noise and hum change, from the beginning of a trial, s."""

    noise_factor: float = Field(default=1.0, ge=0.0, le=100.0)
    """Multiplies the noise from then on. Seen in recordings: 1.2 to 3."""

    hum: float = Field(default=0.0, ge=0.0, le=1e3)
    """Root mean square of a hum that is switched on then, in standard deviations of the noise."""

    hum_hz: Annotated[tuple[float, ...], Strict(False)] = (160.0, 320.0, 480.0)
    """Its sines, equally strong, Hz. Those of the recorded tribometer's servo."""

    converter: float = Field(default=0.0, ge=0.0, le=1e3)
    """Step of the converter in standard deviations of the noise; 0 keeps the bridge's own."""

    tails: float = Field(default=1.0, ge=1.0, le=3.0)
    """Heaviness of the noise's tails: sinh(tails x asinh(x)) instead of a normal x, over its value at 1. 1.4 puts
    2 % beyond three standard deviations as estimated from its median, as the recorded quiet has."""

    tremor_n: float = Field(default=0.0, ge=0.0, le=10.0)
    """Root mean square of the tangential force of a tremor while the tip is loaded, N; fingers press with some
    5 N."""

    tremor_hz: Annotated[tuple[float, ...], Strict(False)] = (6.0, 9.0, 13.0, 21.0)
    """Its sines, equally strong, Hz. Assumption: those of a hand, and of an arm's controller."""

    smoothness: float = Field(default=1.0, ge=1.0, le=100.0)
    """Divides the patches' length and the static excess: at 10 and 10 mm/s friction changes 3,300 times a second, more
    often than it can be counted."""

    bounces: int = Field(default=0, ge=0, le=20)
    """How often a bump bounces."""

    bounce_s: float = Field(default=0.04, gt=0.0, le=1.0)
    """Time to the first bounce, s; to the next it is `bounce_ratio` as long, and the blow as strong. Assumption: a
    light tip on metal."""

    bounce_ratio: float = Field(default=0.6, ge=0.0, lt=1.0)
    """See `bounce_s`."""

    table_m_s: float = Field(default=0.0, ge=-1.0, le=1.0)
    """Speed of the table under the tip, m/s: slip that is in progress from the first contact on."""


class BridgeSettings(Settings):
    """One channel of a sensor: which share of which force it feels, and what its amplifier makes of it.

    The force is `tangential` x Ft + `normal_sine` x Fn sin(theta) + `normal_cosine` x Fn cos(theta).
    """

    name: str
    """Of the channel."""

    tangential: float = Field(default=0.0, ge=-10.0, le=10.0)
    """Share of the tangential force, N/N."""

    normal_sine: float = Field(default=0.0, ge=-10.0, le=10.0)
    """Share of Fn sin(theta), N/N."""

    normal_cosine: float = Field(default=0.0, ge=-10.0, le=10.0)
    """Share of Fn cos(theta), N/N."""

    gain: float = Field(gt=0.0, le=1e6)
    """Output per newton: V/N for bridges, mV/N for taxels, N/N for a sensor that reports newtons."""

    full_scale_n: float = Field(gt=0.0, le=1e6)
    """Range that it was tested over, N."""

    hysteresis: float = Field(default=0.0, ge=0.0, le=0.5)
    """Largest difference between loading and unloading, as a share of full scale."""

    noise: float = Field(ge=0.0, le=1e6)
    """Standard deviation of one sample, output units."""

    step: float = Field(default=0.0, ge=0.0, le=1e6)
    """Of the converter, output units."""


class SlipPlantSettings(Settings):
    """Every number of a fingertip, its table and its sensor."""

    bridges: tuple[BridgeSettings, ...]
    """The sensor's channels."""

    unit: str = "V"
    """Of the channels."""

    rate_hz: float = Field(default=1000.0, gt=0.0, le=1e5)
    """Samples a second. Paper 4.1: 1 kHz."""

    mode_hz: float = Field(gt=0.0, le=1e5)
    """Frequency of the structural mode while the tip is free or slides, Hz. Paper, by sensor."""

    damping_ratio: float = Field(default=0.03, gt=0.0, lt=1.0)
    """Of that mode. Assumption: a lightly damped metal or methacrylate structure."""

    mass_kg: float = Field(default=0.01, gt=0.0, le=100.0)
    """Modal mass, kg. Assumption: a small metal cover."""

    contact_ratio: float = Field(default=0.2, gt=0.0, le=1e6)
    """Tangential stiffness of the contact over that of the mode. Assumption, and the hard case for a detector: a
    bump on a tip that holds rings within 10 % of the frequency of slip."""

    normal_n_m: float = Field(default=5e3, gt=0.0, le=1e9)
    """Normal stiffness of tip and arm, N/m. Assumption: 1 mm of press for 5 N."""

    friction: float = Field(default=0.2, gt=0.0, le=10.0)
    """Mean coefficient of kinetic friction. Assumption: metal on steel; with 5 N it gives Ft of about 1 N."""

    static_excess: float = Field(default=0.05, ge=0.0, le=10.0)
    """How much larger static friction is, relative. Assumption."""

    roughness: float = Field(default=0.05, ge=0.0, le=1.0)
    """Standard deviation of friction from patch to patch, relative. Fit, by sensor: the spectrum's peak in slip."""

    patch_m: float = Field(default=3e-5, gt=0.0, le=1.0)
    """Length of table over which friction is the same, m. Assumption: ground steel."""

    rolling_n: float = Field(default=0.0, ge=0.0, le=1e3)
    """Standard deviation of the tangential force while the arm moves in contact, N. Fit, by sensor."""

    rolling_hz: float = Field(default=8.0, gt=0.0, le=1e4)
    """Corner of its two low-pass poles, Hz. Assumption: waviness of millimetres at centimetres a second."""

    bumps_hz: float = Field(default=0.0, ge=0.0, le=100.0)
    """Bumps a second, at random instants."""

    bump_events: float = Field(default=1.5, ge=0.0, le=100.0)
    """Mean of the exponential amplitude of bumps, in slip events (`slip_event_n`). Nuisance of the study."""

    loads_hz: float = Field(default=0.0, ge=0.0, le=100.0)
    """Load steps a second (contact made or lost elsewhere on the finger), at random instants."""

    load_low: float = Field(default=0.3, ge=0.0, le=1e6)
    """Smallest load step, output units of the last bridge. Nuisance of the study: 0.3 V."""

    load_high: float = Field(default=1.0, ge=0.0, le=1e6)
    """Largest load step, output units of the last bridge. Nuisance of the study: 1 V."""

    load_rise_s: float = Field(default=0.003, gt=0.0, le=10.0)
    """How long a load step takes, s. Assumption: a light impact."""

    noise_scale: float = Field(default=1.0, ge=0.0, le=1e3)
    """Multiplies the noise of every bridge."""

    event_load_n: float = Field(default=5.0, gt=0.0, le=1e4)
    """Normal force at which `slip_event_n` is stated, N."""

    nuisances: SlipNuisances = SlipNuisances()
    """What recordings have besides; nothing of it by default."""

    @property
    def slip_event_n(self) -> float:
        """Amplitude of the ring that one event of slip leaves in the tangential force, N.

        A drop of friction by some force leaves a ring of the same force in a spring-held mass. The drops are the
        static excess at breaking away and the difference of two patches: their root mean square.
        """
        return (
            self.friction
            * self.event_load_n
            * math.hypot(self.static_excess, math.sqrt(2.0) * self.roughness)
        )


SENSORS: Mapping[str, SlipPlantSettings] = {
    name: SlipPlantSettings.model_validate(row, strict=False)
    for name, row in tomllib.loads(Path(__file__).with_name("slip_sensors.toml").read_text("utf-8")).items()
}
"""The five sensors of Fernandez et al. as settings of the plant, by name; each number's source is in the table."""


class SlipPlant:
    """Tip, table and sensor, advanced sample by sample; exact between samples whatever happens there.

    Attributes:
        load_n: Weights that hang on the sensor itself, a force on each bridge, N, shape (bridges,); may be set.
        slid_m: After `advance`, the truth: the place of the contact on the table, m, shape (n,).
        tangential_n: Likewise: force in the tangential spring, N, shape (n,).
        normal_n: Likewise: normal force, N, shape (n,).
    """

    def __init__(self, settings: SlipPlantSettings) -> None:
        self.settings = settings
        self.begin(key=(0, 0))

    def begin(
        self,
        *,
        key: tuple[int, int],
        arm_m: float = 0.0,
        press_m: float = 0.0,
        roll_rad: float = 0.0,
        first: int = 0,
    ) -> None:
        """Start a trial at t = 0, everything at rest.

        Args:
            key: Seed of the run and number of the trial: they key noise and table.
            arm_m: Where the arm stands along the table.
            press_m: How far it presses; 0 at first touch, negative above the table.
            roll_rad: Angle of the contact on the tip, theta.
            first: Number of the sample at which it rests: it keys the noise of those after it.
        """
        self._key = key
        self._count = first
        self._x = np.zeros(kernel.STATES)
        self._flags = np.zeros(kernel.FLAGS, dtype=np.int64)
        self._last = (arm_m, press_m, roll_rad)
        self._play = np.zeros((len(self.settings.bridges), 1))
        self.__dict__.pop("_tip", None)
        self.load_n: Floats = np.zeros(len(self.settings.bridges))
        self.slid_m: Floats = np.zeros(0)
        self.tangential_n: Floats = np.zeros(0)
        self.normal_n: Floats = np.zeros(0)

    @property
    def t_s(self) -> float:
        """Time of the last sample taken."""
        return self._count / self.settings.rate_hz

    def advance(self, arm_m: Floats, press_m: Floats, roll_rad: Floats) -> Floats:
        """Let n samples pass.

        Args:
            arm_m: Place of the arm along the table at each sample, shape (n,); in between its speed is constant.
            press_m: How far it presses at each sample, shape (n,).
            roll_rad: Angle of the contact on the tip at each sample, shape (n,).

        Returns:
            What the bridges show, shape (n, bridges), in `settings.unit`. The truth is left in `slid_m`,
            `tangential_n` and `normal_n`; where the contact slid is for scoring alone.

        Raises:
            ValueError: lengths that differ, or a place that is not finite or beyond `SANE`.
        """
        first = self._count
        values = self.feel(arm_m, press_m, roll_rad)
        return self.shown(values, np.arange(first, self._count))

    def feel(self, arm_m: Floats, press_m: Floats, roll_rad: Floats) -> Floats:
        """As `advance`; returns what the bridges would show if their amplifiers added nothing, shape (n, bridges)."""
        given = [np.asarray(track, dtype=np.float64) for track in (arm_m, press_m, roll_rad)]
        n = given[0].size
        tracks = np.empty((3, n + 1))
        tracks[:, 0] = self._last
        if all(track.shape == (n,) for track in given):
            tracks[:, 1:] = given
        else:
            tracks[:, 1:] = math.nan
        if not (np.abs(tracks) <= SANE).all():
            raise ValueError(
                f"slip: arm, press and roll need one finite value for each sample, at most {SANE:g}"
            )
        arm_last_m = tracks[0, -1]
        if self.settings.nuisances.table_m_s != 0.0:
            tracks[0] -= self._table_m(self._count + np.arange(n + 1))
        tangential_n, normal_n, self.slid_m = np.empty(n), np.empty(n), np.empty(n)
        status = kernel.advance(
            self._tip, self._x, self._flags, self._count, tracks, tangential_n, normal_n, self.slid_m
        )
        if status == kernel.ENDLESS:
            raise RuntimeError(f"slip: events without end near {self.t_s} s")
        if status == kernel.NOT_FINITE:
            raise FloatingPointError(f"slip: not finite near {self.t_s} s")
        self.tangential_n, self.normal_n = tangential_n, normal_n
        values = self._outputs(tangential_n, normal_n, tracks[2, 1:])
        self._count += n
        self._last = (arm_last_m, tracks[1, -1], tracks[2, -1])
        return values

    def _table_m(self, number: NDArray[np.int64]) -> Floats:
        """How far the table has gone under the arm at these samples."""
        return np.asarray(self.settings.nuisances.table_m_s / self.settings.rate_hz * number, np.float64)

    def _outputs(self, tangential_n: Floats, normal_n: Floats, roll_rad: Floats) -> Floats:
        values = np.empty((len(self.settings.bridges), tangential_n.size))
        for channel, bridge in enumerate(self.settings.bridges):
            force_n = self.load_n[channel] + bridge.tangential * tangential_n
            if bridge.normal_sine != 0.0 or bridge.normal_cosine != 0.0:
                force_n += normal_n * (
                    bridge.normal_sine * np.sin(roll_rad) + bridge.normal_cosine * np.cos(roll_rad)
                )
            # the loop's width, and the gain that a line through zero finds in it, are those that were set
            share = bridge.hysteresis / (2.0 * _PLAY + bridge.hysteresis / 8.0)
            gain, play_n = bridge.gain / (1.0 - share / 8.0), _PLAY * bridge.full_scale_n
            kernel.strain_bridge(force_n, gain, play_n, share, self._play[channel], values[channel])
        return values.T

    def shown(self, values: Floats, numbers: NDArray[np.int64]) -> Floats:
        """What the amplifiers show of what the bridges put out.

        Args:
            values: As `feel` returns them, shape (n, bridges).
            numbers: Of the samples, shape (n,): they key the noise; the first after `begin` has the number `first`.
        """
        shown = np.empty(values.shape[::-1])
        for channel, electronics in enumerate(self._electronics):
            stream = kernel.STREAM_BRIDGE + channel
            given = np.ascontiguousarray(values[:, channel])
            kernel.amplify(given, numbers, electronics, self._key, stream, shown[channel])
        return shown.T

    @cached_property
    def _electronics(self) -> Sequence[kernel.Electronics]:
        s, wrong = self.settings, self.settings.nuisances
        found = []
        for bridge in s.bridges:
            noise = s.noise_scale * bridge.noise
            found.append(
                kernel.Electronics(
                    noise,
                    wrong.converter * noise if wrong.converter > 0.0 else bridge.step,
                    wrong.tails,
                    round(wrong.change_s * s.rate_hz),
                    wrong.noise_factor,
                    *self._sines(wrong.hum * noise, wrong.hum_hz),
                )
            )
        return tuple(found)

    def _sines(self, rms: float, frequencies_hz: tuple[float, ...]) -> tuple[float, Floats]:
        """Amplitude and phase from sample to sample of equally strong sines."""
        rad = 2.0 * np.pi / self.settings.rate_hz * np.array(frequencies_hz, dtype=np.float64)
        return rms * math.sqrt(2.0 / max(1, len(frequencies_hz))), rad

    @cached_property
    def _tip(self) -> kernel.Tip:
        s, wrong = self.settings, self.settings.nuisances
        tremor_n, tremor_rad = self._sines(wrong.tremor_n * (1.0 + s.contact_ratio), wrong.tremor_hz)
        omega = 2.0 * math.pi * s.mode_hz
        spring, damper = s.mass_kg * omega**2, 2.0 * s.damping_ratio * omega * s.mass_kg
        contact = s.contact_ratio * spring
        sample_s = 1.0 / s.rate_hz
        stuck_rad_s = math.sqrt((spring + contact) / s.mass_kg)
        keep = math.exp(-2.0 * math.pi * s.rolling_hz * sample_s)
        # standard deviation that two equal one-pole low-passes leave of white noise
        left = math.sqrt((1.0 - keep) * (1.0 + keep**2) / (1.0 + keep) ** 3)
        loading = s.bridges[-1]
        # of the force that acts on a tip that holds, the sensor's spring carries this share
        carried = loading.gain * max(abs(loading.tangential), 1e-6) / (1.0 + s.contact_ratio)
        return kernel.Tip(
            sample_s=sample_s,
            mass=s.mass_kg,
            spring=spring,
            damper=damper,
            contact=contact,
            radius_rad_s=stuck_rad_s * (1.0 + s.damping_ratio),
            stuck_rad_s=stuck_rad_s,
            normal_n_m=s.normal_n_m,
            friction=s.friction,
            static_excess=s.static_excess / wrong.smoothness,
            roughness=s.roughness,
            patch=s.patch_m / wrong.smoothness,
            rolling_n=s.rolling_n * (1.0 + s.contact_ratio) / left,
            rolling_keep=keep,
            bump_chance=0.5 * s.bumps_hz * sample_s,
            # a force held for one sample leaves a ring of force x omega x sample
            bump_n=s.bump_events * s.slip_event_n / (omega * sample_s),
            load_chance=s.loads_hz * sample_s,
            load_low_n=s.load_low / carried,
            load_high_n=s.load_high / carried,
            load_samples=max(1, round(s.load_rise_s * s.rate_hz)),
            bounces=wrong.bounces,
            bounce_samples=wrong.bounce_s * s.rate_hz,
            bounce_ratio=wrong.bounce_ratio,
            tremor_n=tremor_n,
            tremor_rad=tremor_rad,
            **self._recursions(spring, damper, contact, sample_s),
            seed=self._key[0],
            trial=self._key[1],
        )

    def _recursions(self, spring: float, damper: float, contact: float, sample_s: float) -> dict[str, Floats]:
        """One sample of holding and of freedom as matrices: state to state, and (arm's speed, push) to state."""
        from scipy.linalg import expm

        mass = self.settings.mass_kg
        found = {}
        for name, hold in (("stuck", 1.0), ("free", 0.0)):
            a = np.zeros((5, 5))
            a[0, 1], a[0, 3] = 1.0, -1.0
            a[1, :3] = -spring / mass, -damper / mass, -hold * contact / mass
            a[1, 4] = 1.0
            a[2, 1] = hold
            whole = expm(a * sample_s)
            found[f"{name}_step"] = np.ascontiguousarray(whole[:3, :3])
            # the arm's speed enters with a minus, as in the kernel
            found[f"{name}_drive"] = np.ascontiguousarray(whole[:3, 3:] * [-1.0, 1.0])
        return found


_PLAY = 0.25
"""Half the width of the play that makes the hysteresis, as a share of full scale. Assumption: the loop of Fig. 6 closes
within half of the range. A line through zero, fitted to a full loop by least squares, then has a gain of
1 - share / 8."""
