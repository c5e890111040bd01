"""A force sensor in the right finger's pad, as a part of a bench: it feels what the gripper holds slip."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from pydantic import Field

from simulator.physics.aura_part import AuraPart
from simulator.physics.aura_scene import FORCE, OBJECT, TOOL, Weight
from simulator.physics.bench import Bench, BenchPart, Floats, StreamSpec
from simulator.physics.fingertip_settings import CONVERTER_V
from simulator.physics.gripper_part import AuraBenchSettings, GripperPart, ticks_of
from simulator.physics.slip import SENSORS, SlipPlant, SlipPlantSettings
from simulator.physics.slip_track import SlipTruth, Track

PAD = "pad"
"""Name of its stream."""

STREAMS = (StreamSpec(PAD, ("Fx", "Fy", "Ft"), "V", CONVERTER_V, 1000.0),)

APART_M = -1e-3
"""How far the pad is pressed while it touches nothing: any number below zero."""


class GraspBenchSettings(AuraBenchSettings):
    """The plant section of a profile: as for the aura, with a weight and what holds it."""

    object_kg: float = Field(default=0.2, gt=0.0, le=10.0)
    """Mass of the object. Assumption: a small pipe of steel; it stands on a table until it is lifted."""

    pad_friction: float = Field(default=0.2, ge=1e-3, le=10.0)
    """Mean coefficient of kinetic friction between object and pads (as `SlipPlantSettings.friction`)."""

    pad_noise_scale: float = Field(default=1.0, ge=0.0, le=1000.0)
    """Multiplies the noise of the pad's bridges."""

    @property
    def pad(self) -> SlipPlantSettings:
        """The fingertip of Fernandez et al. on the right finger; nothing rolls there."""
        changed = {"friction": self.pad_friction, "noise_scale": self.pad_noise_scale, "rolling_n": 0.0}
        return SENSORS["fingertip"].model_copy(update=changed)

    @property
    def weight(self) -> Weight:
        """Of the object; both fingers give as the right one does."""
        pad = self.pad
        spring_n_m = pad.mass_kg * (2.0 * np.pi * pad.mode_hz) ** 2
        each_n_m = spring_n_m * pad.contact_ratio / (1.0 + pad.contact_ratio)
        return Weight(self.object_kg, self.pad_friction, 2.0 * each_n_m)


class PadPart(BenchPart):
    """A fingertip's plant whose table is the object: it slides where the object slides in the fingers.

    It is followed whatever is subscribed: what really slips does not depend on who listens.
    """

    offers = ("streams", "sample", "events", "excite", "set_tendon", "slips")

    def __init__(self, bench: Bench, gripper: GripperPart, settings: GraspBenchSettings) -> None:
        super().__init__(bench)
        self._gripper = gripper
        self._plant = SlipPlant(settings.pad)
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
        """Height of the finger over the object, and how far its pad is pressed, at each sample."""
        times_s = self.bench.origin_s + numbers / self._plant.settings.rate_hz
        rows = self._gripper.track.at(ticks_of(times_s))
        force_n = rows[:, FORCE][:, 0]
        press_m = np.where(force_n > 0.0, force_n / self._plant.settings.normal_n_m, APART_M)
        return rows[:, TOOL][:, 2] - rows[:, OBJECT][:, 2], press_m

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
