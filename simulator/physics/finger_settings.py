"""Every number of the finger: mechanics, electronics, noise; each with its unit and where it is from."""

import math
from collections.abc import Mapping
from typing import Self

from pydantic import Field, model_validator

from drivers.core.settings import Settings

PIECE_S = 0.86e-6
"""What a piece costs, s (measured: 5.6 s for a second of contact with a damping of 1e6 N s/m, at location f)."""

FREE_S, CONTACT_S = 0.3, 10.0
"""What a second of the bench may cost at most, s: free, a third of what an emulated bench has, which runs in wall time;
in contact, which a trial has for a few seconds, what can be waited for."""

WANDER_MAX = 0.1
"""Largest standard deviation of the joint's stiffness, relative: at one half it is negative every 40 values."""

LOCATIONS: Mapping[str, tuple[str, float]] = {
    "a": ("back", 0.01905),
    "b": ("back", 0.0127),
    "c": ("back", 0.0),
    "d": ("pad", 0.0),
    "e": ("pad", 0.00635),
    "f": ("pad", 0.0127),
    "g": ("pad", 0.01905),
    "h": ("pad", 0.0254),
    "p": ("base", 0.0),
}
"""Side and distance from the distal end in metres, Table I; that 0 is the distal end is inferred. p is not the paper's:
the middle of the proximal link (`proximal_arm_m`)."""


class FingerSettings(Settings):
    """Every number of the finger, its electronics and its noise."""

    inertia_kg_m2: float = Field(default=1.2e-4, ge=1e-9, le=1.0)
    """I, the distal link about its joint, kg m^2. Paper II."""

    joint_n_m_rad: float = Field(default=2.5, ge=1e-6, le=1e6)
    """K, the distal joint, N m/rad; with less than 1e-6 nothing holds it. Paper II (k1)."""

    joint_n_m_s_rad: float = Field(default=1.2e-3, ge=0.0, le=1e6)
    """c1, damping of the distal joint, N m s/rad. Assumption."""

    base_inertia_kg_m2: float = Field(default=2.99e-4, ge=1e-9, le=1.0)
    """J, of what the distal joint is mounted on: proximal link, tendon and motor, kg m^2. Fit: 28 Hz in free air."""

    base_n_m_rad: float = Field(default=0.0775, ge=1e-6, le=1e6)
    """k_b, its stiffness, N m/rad; likewise. Fit: the one compliance, identified on location f."""

    base_n_m_s_rad: float = Field(default=1.1e-3, ge=0.0, le=1e6)
    """c_b, its damping, N m s/rad. Assumption: a tenth of critical; with more, light contact is not erratic."""

    flexion_1_m: float = Field(default=30.0, ge=0.0, le=1e4)
    """How much the joint stiffens with the tendon's position, 1/m. Assumption; that flexing stiffens: paper V.C."""

    drive_n_m: float = Field(default=2.324e-3, gt=0.0, le=1e3)
    """U, amplitude of the square-wave drive's torque, N m. Fit: 0.9 degrees peak to peak in free air."""

    arm_f_m: float = Field(default=0.05, gt=0.0, le=1.0)
    """l, from the distal joint to location f, m. Paper II (l1) with the assumption that it means f."""

    pad_n_m: float = Field(default=4220.0, gt=0.0, le=1e10)
    """k2 on the pad, N/m. Fit: 50 Hz in full contact."""

    back_n_m: float = Field(default=7300.0, gt=0.0, le=1e10)
    """k2 on the back, N/m. Assumption."""

    contact_n_s_m: float = Field(default=1.0, ge=0.0)
    """c2, damping of the contact, N s/m. Assumption."""

    accelerometer_arm_m: float = Field(default=0.03, gt=0.0, le=1.0)
    """r, from the base's axis to the accelerometer, m. Assumption."""

    accelerometer_hz: float = Field(default=50.0, gt=0.0, le=1e5)
    """Bandwidth of the accelerometer's output, Hz. ADXL335 data sheet: 0.1 uF at the output."""

    accelerometer_m_s2_rt_hz: float = Field(default=300e-6 * 9.80665, ge=0.0, le=10.0)
    """Noise density of the accelerometer, m/s^2 per square root of Hz. ADXL335 data sheet: 300 ug on the z axis."""

    high_pass_hz: float = Field(default=4.8, gt=0.0, le=1e4)
    """Corner of the second-order high-pass, Hz. Paper III.A."""

    high_pass_quality: float = Field(default=math.sqrt(0.5), gt=0.0, le=100.0)
    """Its quality. Assumption: Butterworth."""

    hysteresis_m_s2: float = Field(default=0.05, gt=0.0, le=1e3)
    """Half the width of the comparator's hysteresis, m/s^2 at the accelerometer. Assumption: above its noise."""

    loop_hz: float = Field(default=5.0, gt=0.0, le=1e4)
    """Corner of the loop's RC filter, Hz. Assumption."""

    oscillator_lowest_hz: float = Field(default=10.0, ge=0.0, le=1e4)
    """Frequency of the oscillator at 0 control, Hz. Fit."""

    oscillator_range_hz: float = Field(default=70.0, gt=0.0, le=1e4)
    """From there to its frequency at full control, Hz. Fit."""

    wander: float = Field(default=0.01, ge=0.0, le=0.1)
    """Standard deviation of the joint's stiffness, relative. Assumption; that the resonance wanders: paper IV.B."""

    wander_s: float = Field(default=1.0, gt=0.0, le=1e3)
    """Correlation time of the wander, s. Assumption."""

    proximal_arm_m: float = Field(default=0.03, gt=0.0, le=1.0)
    """From the base's axis to a contact on the proximal link, m. Assumption: where the accelerometer is."""

    distal_accelerometer_arm_m: float = Field(default=0.0, ge=0.0, le=1.0)
    """From the distal joint to a second accelerometer on the distal link (paper V.C), m; 0: there is none."""

    tendon_friction_n_m: float = Field(default=0.0, ge=0.0, le=1.0)
    """Torque at which the tendon slides in its sheath, at the base, N m; 0: without friction."""

    tendon_sleeve_n_m_rad: float = Field(default=0.05, gt=0.0, le=1e3)
    """Stiffness of the tendon until it slides, N m/rad. Assumption: two thirds of the base's own."""

    drive_ripple: float = Field(default=0.0, ge=0.0, le=1.0)
    """Amplitude of the supply's ripple on the drive, relative."""

    drive_ripple_hz: float = Field(default=100.0, gt=0.0, le=1e3)
    """Its frequency, Hz: twice the mains'."""

    drift_1_s: float = Field(default=0.0, ge=-1e-3, le=5e-3)
    """Drift of the joint's stiffness with temperature from the trial's start on, relative, 1/s; the resonance drifts by
    half of it."""

    vibration_m_s2: float = Field(default=0.0, ge=0.0, le=100.0)
    """Amplitude of the vibration of what the finger is mounted on, while the probe and it move, m/s^2."""

    vibration_hz: float = Field(default=20.0, gt=0.0, le=1e3)
    """Its frequency, Hz; an arm that moves vibrates at some 5 to 40."""

    slide_m: float = Field(default=0.0, ge=-0.05, le=0.05)
    """A probe that slides along the finger while it moves: friction coefficient times the surface's height over the
    joint, by which the force's arm differs from the contact's, m."""

    load_cell_n: float = Field(default=4e-4, ge=0.0, le=1.0)
    """Noise of one sample of the load cell, N. Assumption: a tenth of the paper's onset threshold of 0.005 N."""

    accelerometer_range_m_s2: float = Field(default=3.0 * 9.80665, gt=0.0, le=1e5)
    """Where the accelerometer's output stops, m/s^2 either way. ADXL335 data sheet: 3 g at least."""

    load_cell_range_n: float = Field(default=22.24, gt=0.0, le=1e6)
    """Where the load cell's output stops, N either way. Paper III.C: 5 lbf."""

    noise_scale: float = Field(default=1.0, ge=0.0, le=1e3)
    """Multiplies every noise."""

    error_budget_rad: float = Field(default=1e-6, ge=0.0, le=1e-2)
    """Error in theta that a jump over unobserved time may make, rad; 0 computes everything."""

    @model_validator(mode="after")
    def _stays_stiff(self) -> Self:
        if self.noise_scale * self.wander > WANDER_MAX:
            raise ValueError(
                f"noise_scale x wander = {self.noise_scale * self.wander:g}: the joint would lose its stiffness;"
                f" must be <= {WANDER_MAX:g}"
            )
        return self

    @model_validator(mode="after")
    def _affordable(self) -> Self:
        for where, cost_s, most_s in zip(
            ("that is free", "of contact"), self._cost_s(), (FREE_S, CONTACT_S), strict=True
        ):
            if not cost_s <= most_s:
                name = self._dearest()
                raise ValueError(
                    f"{name} = {getattr(self, name):g}: a second {where} would cost {cost_s:.3g} s of computing;"
                    f" must be <= {most_s:g} s"
                )
        return self

    def _cost_s(self) -> tuple[float, float]:
        """What a second costs, free and in contact, s."""
        from simulator.physics.finger_scene import pieces_hz

        free_hz, contact_hz = pieces_hz(self)
        return PIECE_S * free_hz, PIECE_S * contact_hz

    def _dearest(self) -> str:
        """The setting that costs most: with its default in its place, a second costs least."""

        def without(name: str) -> float:
            default = type(self).model_fields[name].default
            return sum(self.model_copy(update={name: default})._cost_s())

        changed = [name for name in type(self).model_fields if isinstance(getattr(self, name), float)]
        return min(changed, key=without)

    @property
    def restless(self) -> bool:
        """Whether the free finger's motion is not that of a locked loop in noise, so that nothing may be left out."""
        return self.tendon_friction_n_m > 0.0 or self.drive_ripple > 0.0 or self.drift_1_s != 0.0

    @property
    def stiffest_n_m(self) -> float:
        """Stiffness of the hardest contact, from which a peak force is forecast, N/m."""
        return max(self.pad_n_m, self.back_n_m)

    @property
    def quiet(self) -> bool:
        """Whether a converter sees no noise: a load cell that repeats its value is not stuck then."""
        return self.noise_scale * self.load_cell_n < 1e-5  # N, its last bit
