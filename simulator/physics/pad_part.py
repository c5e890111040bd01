"""A force sensor in the right finger's pad, as a part of a bench: it feels what the gripper holds slip."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import Field

from drivers.core.messages import Floats
from simulator.physics.aura_part import AuraPart
from simulator.physics.aura_scene import FORCE, LOAD, SHARE, SLID, Weight
from simulator.physics.aura_settings import AuraObject
from simulator.physics.bench import Bench, BenchPart, StreamSpec
from simulator.physics.fingertip_settings import CONVERTER_V
from simulator.physics.gripper_part import AuraBenchSettings, GripperPart, ticks_of
from simulator.physics.held_kernel import GRAVITY_M_S2, Held
from simulator.physics.jaws_drive import STIFFEST_N_M
from simulator.physics.slip import SENSORS, SlipPlant, SlipPlantSettings
from simulator.physics.slip_track import SlipTruth, Track

PAD = "pad"
"""Name of its stream."""

STREAMS = (StreamSpec(PAD, ("Fx", "Fy", "Ft"), "V", CONVERTER_V, 1000.0),)

APART_M = -1e-3
"""How far the pad is pressed while it touches nothing: any number below zero."""


class GraspBenchSettings(AuraBenchSettings):
    """The plant section of a profile: as for the aura, with a weight and what holds it."""

    object_kg: float = Field(default=0.2, ge=0.02, le=10.0)
    """Mass of the object; steps of 0.1 ms follow no lighter one. Assumption: a small pipe of steel; it stands on a
    table until it is lifted."""

    object_width_m: float | None = Field(default=None, gt=0.0, le=0.2)
    """Its width where the jaws close on it; None is that of the object of this name."""

    object_n_m: float | None = Field(default=None, gt=0.0, le=STIFFEST_N_M)
    """Force for each metre by which the jaws squeeze it; None likewise."""

    crush_n: float = Field(default=1e9, ge=0.0, le=1e9)
    """Force of a finger that crushes it; as it stands here, none does."""

    lever_m: float = Field(default=0.0, ge=-0.005, le=0.005)
    """How far its centre of mass is beside the axis through both fingers: it is gripped off centre."""

    gyration_m: float = Field(default=0.03, ge=0.01, le=0.5)
    """Radius of gyration about the centre of mass. Assumption: something of 10 cm."""

    pad_friction: float = Field(default=0.2, ge=1e-3, le=10.0)
    """Mean coefficient of kinetic friction between object and pads (as `SlipPlantSettings.friction`)."""

    pad_roughness: float = Field(default=0.05, ge=0.0, le=1.0)
    """Standard deviation of it from patch to patch of the object's surface, relative (as
    `SlipPlantSettings.roughness`)."""

    pad_noise_scale: float = Field(default=1.0, ge=0.0, le=1000.0)
    """Multiplies the noise of the pad's bridges."""

    table_friction: float = Field(default=0.3, ge=1e-3, le=10.0)
    """Coefficient of friction between object and table: what one finger alone pushes slides on it (assumption)."""

    up_m: float = Field(default=0.15, gt=0.0, le=0.5)
    """From this height of the tool over its start pose on, the times below count, while it grips."""

    added: float = Field(default=0.0, ge=0.0, le=10.0)
    """Load that is hung on the object at once, as a share of its mass."""

    added_s: float = Field(default=4.0, ge=0.0, le=1e6)
    """When."""

    added_for_s: float = Field(default=1.0, ge=0.0, le=1e6)
    """For how long."""

    tap_n: float = Field(default=0.0, ge=0.0, le=1000.0)
    """Peak of a tap on the object from below, half a sine."""

    tap_s: float = Field(default=6.0, ge=0.0, le=1e6)
    """When."""

    tap_for_s: float = Field(default=0.004, ge=1e-4, le=1.0)
    """Its length. Assumption: a light knock with something hard."""

    @property
    def thing(self) -> AuraObject | None:
        """See `AuraBenchSettings.thing`: as wide and stiff as this plant says."""
        thing = super().thing
        own = {"width_m": self.object_width_m, "stiffness_n_m": self.object_n_m}
        own = {name: value for name, value in own.items() if value is not None}
        return None if thing is None else thing.model_copy(update=own)

    @property
    def pad(self) -> SlipPlantSettings:
        """The fingertip of Fernandez et al. on the right finger; nothing rolls there."""
        changed = {
            "friction": self.pad_friction,
            "roughness": self.pad_roughness,
            "noise_scale": self.pad_noise_scale,
            "rolling_n": 0.0,
        }
        return SENSORS["fingertip"].model_copy(update=changed)

    @property
    def slide_n(self) -> float:
        """See `AuraBenchSettings.slide_n`: friction on the table."""
        return self.table_friction * self.object_kg * GRAVITY_M_S2

    @property
    def weight(self) -> Weight:
        """Of the object; both fingers give as the right one does."""
        pad = self.pad
        spring_n_m = pad.mass_kg * (2.0 * np.pi * pad.mode_hz) ** 2
        each_n_m = spring_n_m * pad.contact_ratio / (1.0 + pad.contact_ratio)
        about = (self.up_m, self.added, self.added_s, self.added_for_s)
        tap = (self.tap_n, self.tap_s, self.tap_for_s)
        body = (self.object_kg, self.pad_friction, 2.0 * each_n_m, self.lever_m, self.gyration_m)
        return Weight(Held(*body, *about, *tap), self.crush_n)


class PadPart(BenchPart):
    """A fingertip's plant whose table is the object: it slides where the object slides in the fingers.

    It is followed whatever is subscribed: what really slips does not depend on who listens.
    """

    offers = ("streams", "sample", "events", "excite", "set_tendon", "slips")

    def __init__(self, bench: Bench, gripper: GripperPart, settings: GraspBenchSettings) -> None:
        super().__init__(bench)
        self._gripper = gripper
        self._plant = SlipPlant(settings.pad)
        self._hold_n_m = settings.weight.held.hold_n_m
        self._computed = 0
        self.begin(settings, {})

    def warm_up(self) -> None:
        """See `BenchPart`."""
        ramp = np.linspace(0.0, 1.0, 50)
        SlipPlant(self._plant.settings).advance(1e-3 * ramp, 1e-4 * ramp, 0.0 * ramp)

    def begin(self, settings: GraspBenchSettings, factors: Mapping[str, Any]) -> None:
        """Nothing has slid yet."""
        if settings.pad != self._plant.settings:
            self._plant = SlipPlant(settings.pad)
        self._track = Track(settings.pad.rate_hz, len(settings.pad.bridges))
        self._truth = SlipTruth(settings.pad.rate_hz, self.bench.origin_s)
        arm_m, press_m = self._tracks(np.zeros(1, dtype=np.int64))
        self._plant.begin(key=self.bench.key, arm_m=arm_m[0], press_m=press_m[0])

    def advance(self, t_s: float) -> None:
        """See `BenchPart`."""
        for numbers in self._track.due(t_s - self.bench.origin_s):
            arm_m, press_m = self._tracks(numbers)
            self._track.push(self._plant.advance(arm_m, press_m, np.zeros(len(numbers))))
            self._truth.follow(numbers, self._plant.slid_m, self._plant.normal_n)
            self._computed += len(numbers)

    def _tracks(self, numbers: Any) -> tuple[Floats, Floats]:
        """How far the finger is dragged over the object, and how far its pad is pressed, at each sample.

        It is dragged by as much as the pads give under half of what both carry, and by what all of the object slides.
        """
        times_s = self.bench.origin_s + numbers / self._plant.settings.rate_hz
        rows = self._gripper.track.at(ticks_of(times_s))
        # by the limit surface a torque takes up its part of the friction: the pull has the rest
        force_n = rows[:, FORCE][:, 0] * np.where(rows[:, SHARE] > 0.0, rows[:, SHARE], 1.0)
        press_m = np.where(force_n > 0.0, force_n / self._plant.settings.normal_n_m, APART_M)
        return rows[:, LOAD] / self._hold_n_m + rows[:, SLID], press_m

    def streams(self) -> Sequence[StreamSpec]:
        """What the board has, in the order of its stream ids."""
        return STREAMS

    def sample(self, stream: str, times_s: Floats) -> Floats:
        """What the pad's bridges show at recent instants, V, shape (n, 3)."""
        return self._track.at(times_s - self.bench.origin_s)

    @property
    def slips(self) -> Sequence[tuple[float, bool]]:
        """The truth: when the object began (True) and ceased (False) to slip."""
        return self._truth.slips

    def account(self) -> Mapping[str, Any]:
        """How many samples were computed."""
        return {"pad_samples": self._computed}


def grasp_bench(settings: GraspBenchSettings) -> Bench:
    """A gripper with two sonic fingers, one of which has a force sensor in its pad, and an object on a table."""
    bench = Bench(settings, "gripper", one_axis="this mover moves along one axis alone")
    gripper = GripperPart(bench, settings)
    AuraPart(bench, gripper, settings)
    PadPart(bench, gripper, settings)
    return bench
