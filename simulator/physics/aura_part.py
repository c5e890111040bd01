"""Sound of two fingers on a gripper, as a part of a bench: their drive, and what their bridges show."""

from collections.abc import Mapping
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.core.messages import Floats
from simulator.physics.aura import ENVELOPE_HZ, FINGERS, LEFT, RIGHT, AuraPlant
from simulator.physics.aura_drive import FRAME_HZ, AuraDrive
from simulator.physics.aura_scene import RATE, TOOL, WIDTH
from simulator.physics.aura_settings import Side
from simulator.physics.bench import Bench, BenchPart
from simulator.physics.gripper_part import AuraBenchSettings, GripperPart, ticks_of

Complexes = NDArray[np.complex128]

PLACES = {"right": RIGHT, "left": LEFT}
"""Column of each finger."""

CHUNK = 9600
"""Frames that are computed at once: so many stay in a processor's cache."""


class AuraPart(BenchPart):
    """Sound is computed on request, from where the gripper was then."""

    offers = ("level", "drive", "chirp", "silence", "baseband", "carrier")

    def __init__(self, bench: Bench, gripper: GripperPart, settings: AuraBenchSettings) -> None:
        super().__init__(bench)
        self._gripper = gripper
        self._settings = settings
        self._drive = AuraDrive()
        self._plant = AuraPlant(settings)
        self._wired = tuple(PLACES[name] for name in dict.fromkeys(settings.wired))
        self._computed = dict.fromkeys(("envelope", "carrier"), 0)
        self._begin()

    def warm_up(self) -> None:
        """See `BenchPart`."""
        bench = Bench(self._settings, "gripper")
        AuraPart(bench, GripperPart(bench, self._settings), self._settings).drive(40_000.0, 0.5)
        bench.advance(0.01)
        bench.baseband(np.arange(1, 5) / ENVELOPE_HZ)
        bench.carrier(0, 10)

    def restart(self) -> None:
        """Silence."""
        self._drive.restart()

    def begin(self, settings: AuraBenchSettings, factors: Mapping[str, Any]) -> None:
        """See `BenchPart`; the drive is as it was."""
        if settings != self._settings:
            self._settings = settings
            self._plant = AuraPlant(settings)
        self._begin()

    def _begin(self) -> None:
        side: Side = self._settings.side if self._settings.scene == "ahead" else "normal"
        self._plant.begin(self.bench.key, self._gripper.thing, self._settings.object_top_m, side)

    @property
    def level(self) -> Literal["envelope", "carrier"]:
        """Level that the audio device requests."""
        return self._settings.level

    def drive(self, frequency_hz: float, level: float) -> None:
        """Drive both transducers with one frequency, from the present time on; level is 0 to 1."""
        self._drive.tone(self.bench.t_s, frequency_hz, level)

    def chirp(self, from_hz: float, to_hz: float, duration_s: float, level: float) -> None:
        """Sweep linearly once from the present time on, then be silent."""
        self._drive.sweep(self.bench.t_s, from_hz, to_hz, duration_s, level)

    def silence(self) -> None:
        """No drive, from the present time on."""
        self._drive.silence(self.bench.t_s)

    def baseband(self, times_s: Floats) -> Complexes:
        """I and Q of the bridges as an ideal chain would give them, at recent milliseconds.

        Args:
            times_s: Whole milliseconds in growing order, none later than the last advance, shape (n,).

        Returns:
            Full scale 1.0, the drive's phase is the real axis (tone or sweep), shape (n, 2): right, left.
        """
        ticks = ticks_of(times_s)
        rows = self._gripper.track.at(ticks)
        motion = self._gripper.track.motion(rows[:, TOOL], rows, rows[:, WIDTH])
        frequency_hz, level = self._drive.at(times_s)
        self._computed["envelope"] += len(ticks) * len(self._wired)
        return self._plant.envelope(
            motion, ticks, times_s - self.bench.origin_s, frequency_hz, level, self._wired
        )

    def carrier(self, first_frame: int, n: int, *, drift_ppm: float = 0.0) -> NDArray[np.int32]:
        """Counts of the converter, 24 bits sign-extended, shape (n, 2): right, left.

        Frame k is at k / 96,000 s on the converter's clock; a tone's phase is zero at frame 0.

        Args:
            first_frame: The first; none may be later than the last advance, nor long before it.
            drift_ppm: How much faster than the devices' clock the converter's runs.
        """
        end = first_frame + n
        cuts = range(first_frame, end, CHUNK)
        parts = [self._carrier_part(np.arange(cut, min(cut + CHUNK, end)), drift_ppm) for cut in cuts]
        self._computed["carrier"] += n * len(self._wired)
        return np.concatenate(parts) if parts else np.empty((0, FINGERS), dtype=np.int32)

    def _carrier_part(self, frames: NDArray[np.int64], drift_ppm: float) -> NDArray[np.int32]:
        times_s = frames / (FRAME_HZ * (1.0 + 1e-6 * drift_ppm))
        ticks = frames // (FRAME_HZ // ENVELOPE_HZ) if drift_ppm == 0.0 else ticks_of(times_s)
        rows = self._gripper.track.at(np.arange(ticks[0], ticks[-1] + 1))
        still = (rows == rows[0]).all()
        rows = np.broadcast_to(rows[0], (len(ticks), rows.shape[1])) if still else rows[ticks - ticks[0]]
        width_m = rows[:, WIDTH] + rows[:, RATE] * (times_s - ticks / ENVELOPE_HZ)
        motion = self._gripper.track.motion(self.bench.places(times_s)[:, :3], rows, width_m)
        frequency_hz, level = self._drive.at(times_s)
        phase_rad = self._drive.phase_rad(frames, times_s)
        return self._plant.carrier(
            motion, frames, self.bench.origin_s, frequency_hz, level, phase_rad, self._wired
        )

    def account(self) -> Mapping[str, Any]:
        """What was computed: samples of a finger, at each level."""
        return {"level": self._settings.level, "computed": dict(self._computed)}


def aura_bench(settings: AuraBenchSettings) -> Bench:
    """A gripper with two sonic fingers, an object between them or before one of them."""
    bench = Bench(settings, "gripper", one_axis="this mover moves along one axis alone")
    AuraPart(bench, GripperPart(bench, settings), settings)
    return bench
