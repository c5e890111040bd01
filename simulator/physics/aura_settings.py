"""Settings of the aura: what the paper prints, and what had to be assumed."""

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, Strict

from drivers.core.settings import Settings

Side = Literal["normal", "back", "front", "top", "bottom"]
"""Sides of a finger (Fig. 3)."""

SIDES: tuple[Side, ...] = ("normal", "back", "front", "top", "bottom")

NOTHING = "none"
"""Name of the object that is not there."""


class AuraObject(Settings):
    """Something that stands upright in front of a finger, or between two."""

    width_m: float = Field(gt=0.0, le=0.2)
    """Along x, on which the jaws close."""

    depth_m: float = Field(gt=0.0, le=0.5)
    """Along y, across the finger."""

    height_m: float = Field(gt=0.0, le=0.5)
    """Along z, lengthwise of the finger."""

    radius_m: float = Field(gt=0.0, le=10.0)
    """Radius of curvature of what faces the finger; a flat face has a large one."""

    absorption: float = Field(ge=0.0, le=1.0)
    """Share of the sound's power at 40 kHz that stays in it."""

    coupling: float = Field(ge=0.0, le=1.0)
    """How much it loads a finger that it touches, as a share of what a rigid body does."""

    stiffness_n_m: float = Field(default=2e4, gt=0.0, le=1e6)
    """Force for each metre by which the jaws squeeze it, finger pads included (assumption: 1 mm at 20 N)."""

    @property
    def reflectivity(self) -> float:
        """Sound pressure that comes back from a flat piece of it, as a share of what arrived."""
        return float((1.0 - self.absorption) ** 0.5)


OBJECTS: Mapping[str, AuraObject] = {
    name: AuraObject.model_validate(row)
    for name, row in tomllib.loads(Path(__file__).with_name("aura_objects.toml").read_text("utf-8")).items()
}
"""By the names that trials use."""

SIX = ("mug", "hand_sanitizer", "transparent_plastic", "notebook", "water_cup", "paper_cylinder")
"""The objects of the paper's deployment (IV.B)."""

SOFT = ("sponge", "cloth")
"""Ours: "soft objects absorb sound making them relatively harder to detect" (IV.B.1)."""


Pair = Annotated[tuple[float, float], Strict(False)]
HalfWaves = Annotated[int, Field(ge=0, le=4)]
"""At least two pieces of a pad to each, of the nine across it for which a plate's echo is summed."""
"""One number for the right finger and one for the left."""

PAD_WIDTH_M = 0.027
PAD_LENGTH_M = 0.055
"""A finger's pad: 55 mm long, 27 mm wide (Rupavatharam et al., III.A)."""


class SideSettings(Settings):
    """One side of a finger. All assumptions: the paper shows that all five see and that the top feels least."""

    sensitivity: float = Field(ge=0.0, le=10.0)
    """Sound that this side sends out and takes in, as a share of the normal side's."""

    coupling_fs: float = Field(ge=0.0, le=1.0)
    """How much the bridge's output moves when a rigid body presses on this side, at full drive."""

    coupling_rad: float = 0.0
    """In which direction."""

    phase_rad: float = 0.0
    """Phase of what is reflected to this side."""


SIDE_SETTINGS: dict[Side, SideSettings] = {
    "normal": SideSettings(sensitivity=1.0, coupling_fs=0.04, coupling_rad=0.7, phase_rad=0.4),
    "back": SideSettings(sensitivity=0.7, coupling_fs=0.03, coupling_rad=-0.9, phase_rad=1.9),
    "front": SideSettings(sensitivity=0.5, coupling_fs=0.02, coupling_rad=2.5, phase_rad=-2.2),
    "bottom": SideSettings(sensitivity=0.45, coupling_fs=0.016, coupling_rad=-2.2, phase_rad=-0.8),
    "top": SideSettings(sensitivity=0.3, coupling_fs=0.002, coupling_rad=1.3, phase_rad=2.9),
}
"""Fig. 6: undulations on all five, smallest on the sides without foam; Fig. 7: a level change on each, and IV.A.3:
contact is felt always "except for the top"."""


class EchoSettings(Settings):
    """Something in the room that sends sound back and is not the object: a wall, the table, another machine."""

    size_fs: float = Field(ge=0.0, le=1.0)
    """What comes back to a finger at the start pose, at full drive."""

    away_m: float = Field(default=0.3, gt=0.0, le=10.0)
    """How far away it is there; its echo grows towards it as the object's does."""

    cosine: float = Field(default=1.0, ge=-1.0, le=1.0)
    """Of the angle between x and the line to it: 1 is straight ahead, 0 beside, -1 behind."""

    stroke_m: float = Field(default=0.0, ge=0.0, le=1.0)
    """It moves to and fro by so much to either side; 0 stands still."""

    stroke_hz: float = Field(default=0.5, ge=0.0, le=100.0)
    """So often."""


class RoomSettings(Settings):
    """What a real room adds. All of it is off unless a profile or a study sets it; sizes are assumptions."""

    echoes: Annotated[tuple[EchoSettings, ...], Strict(False)] = ()
    """What else sends sound back."""

    second_path: float = Field(default=0.0, ge=0.0, le=1.0)
    """Of the object's echo, the share that comes back once more by way of a surface beside the fingers."""

    second_path_m: float = Field(default=0.015, gt=0.0, le=1.0)
    """Distance of that surface."""

    ripple_fs: float = Field(default=0.0, ge=0.0, le=1.0)
    """Amplitude of what a gear's teeth do to the bridge's balance, at full drive."""

    ripple_m: float = Field(default=0.005, ge=1e-5, le=1.0)
    """Way from tooth to tooth; no gear's is below 10 um."""

    vibration_fs: float = Field(default=0.0, ge=0.0, le=1.0)
    """Amplitude of a narrow vibration of the mechanism while it moves, at full drive."""

    vibration_hz: float = Field(default=5.0, gt=0.0, le=400.0)
    """Its frequency."""


class AuraPlantSettings(Settings):
    """Two fingers, the air, the bridge. Amplitudes are shares of the converter's full scale at full drive.

    The wavelength follows from frequency and temperature; the rest is assumed unless stated.
    """

    level: Literal["envelope", "carrier"] = "envelope"
    """What is computed: I and Q at 1 kHz as an ideal chain would give them, or counts at 96 kHz."""

    temperature_k: float = Field(default=293.15, ge=250.0, le=330.0)
    """Of the air at the trial's beginning."""

    warming_k_s: float = Field(default=0.0, ge=-0.1, le=0.1)
    """How fast air and bridge warm up."""

    reflection_fs: float = Field(default=0.04, ge=0.0, le=1.0)
    """What comes back from a wide flat rigid wall at no distance. Assumption: a fifth of the imbalance, so that the
    undulations are seen in the raw envelope close to the object (Fig. 4a) and not from afar."""

    plate: Annotated[tuple[HalfWaves, HalfWaves], Strict(False)] | None = None
    """Half waves in which the pad vibrates, across and along it, as a free plate does; (0, 0) moves as a whole. None:
    it sends and receives at a point."""

    decay_m: float = Field(default=0.01, gt=0.0, le=1.0)
    """Distance at which sound has spread by its first half: (1 + distance / decay_m)^-decay_power (assumption)."""

    decay_power: float = Field(default=2.0, ge=0.0, le=4.0)
    """2: out and back, each with the inverse of the distance (assumption)."""

    air_db_m: float = Field(default=1.3, ge=0.0, le=10.0)
    """What air takes at 40 kHz (ISO 9613-1: 20 degrees, 50 % humidity: about 1.3 dB/m)."""

    bounce: float = Field(default=0.2, ge=0.0, lt=1.0)
    """Sound that the finger sends back to the object once more: makes undulations that are not quite sines."""

    edge: float = Field(default=0.2, ge=0.0, le=1.0)
    """Amplitude of the wave from an object's upper or lower end, as a share of its face's."""

    cross_fs: float = Field(default=0.003, ge=0.0, le=1.0)
    """What one finger receives of the other, at no distance (IV.B: "minimal interference")."""

    imbalance_fs: Pair = (0.2, 0.17)
    """What is left of the drive in the bridge's output."""

    imbalance_rad: Pair = (0.5, -1.1)
    """Its phase."""

    imbalance_per_k: float = Field(default=0.002, ge=-1.0, le=1.0)
    """Its change with temperature, in quadrature, as a share of itself."""

    drift_fs: float = Field(default=5e-4, ge=0.0, le=0.1)
    """Standard deviation of its slow wandering, periods of 20 s to 10 minutes."""

    mismatch_db: float = Field(default=0.0, ge=-20.0, le=20.0)
    """By how much the right finger is more sensitive than the left ("not identical in their construction", IV.A.2)."""

    finger_scatter_db: float = Field(default=0.0, ge=0.0, le=20.0)
    """Standard deviation, from trial to trial, of each finger's own sensitivity."""

    gain_scatter_db: float = Field(default=1.0, ge=0.0, le=20.0)
    """Standard deviation, from trial to trial, of what is reflected: no placement is repeated exactly."""

    phase_scatter_rad: float = Field(default=0.5, ge=0.0, le=10.0)
    """The same of its phase."""

    resonance_hz: Pair = (40_000.0, 40_000.0)
    """Where a finger transfers best (III.A.2: 40 kHz)."""

    quality: float = Field(default=25.0, gt=0.5, le=1000.0)
    """Sharpness of that."""

    second_hz: Pair | None = None
    """A second resonance, as sharp; None is one alone. What is sent and what is received pass through both, as in
    `controller.signals.transducer`: a pair sold for 40 kHz peaks at 40.4 to 40.5 kHz with a sharpness of 45."""

    force_n: float = Field(default=0.5, ge=1e-6, le=100.0)
    """Force at which the coupling has done 63 % of its change; the weight of a tenth of a milligram at the least."""

    noise_fs_rthz: float = Field(default=5e-7, ge=0.0, le=1e-2)
    """Preamplifier and converter: density at the converter's input, full scales for each root of a hertz."""

    noise_colour: float = Field(default=0.13, ge=0.0, le=0.49)
    """Correlation from one millisecond to the next that a chain's filter leaves (measured on the program's own,
    benchmarks/results/aura.md; a narrower prototype left 0.24)."""

    motion_fs: float = Field(default=2e-4, ge=0.0, le=0.1)
    """Standard deviation of what a mechanism that moves at 0.01 m/s does to I or Q at full drive: it shakes the
    bridge's balance, more so with the root of the speed ("spread out over various frequencies", III.C)."""

    drive_ppm: float = Field(default=0.0, ge=-1000.0, le=1000.0)
    """By how much the drive's clock is faster than the converter's; 0 is one clock for both."""

    room: RoomSettings = RoomSettings()
    """Around it."""

    sides: dict[Side, SideSettings] = SIDE_SETTINGS
    """By name."""

    @property
    def quiet(self) -> bool:
        """Whether there is no noise: a finger that repeats its value is not stuck then."""
        return self.noise_fs_rthz == 0.0

    def sound_m_s(self, temperature_k: float) -> float:
        """Speed of sound in air, an ideal gas: 331.3 m/s at 273.15 K, and with the root of the temperature."""
        return 331.3 * math.sqrt(temperature_k / 273.15)
