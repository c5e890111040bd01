"""Two sonic fingers on a gripper in an arm's tool, and an object: what mock drivers and emulated devices share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from drivers.clock import last_tick
from drivers.errors import RefusedError
from drivers.mock.physics.aura import ENVELOPE_HZ, FINGERS, LEFT, RIGHT, AuraPlant
from drivers.mock.physics.aura_drive import FRAME_HZ, Drive
from drivers.mock.physics.aura_jaws import AuraJaws, fits, jaws_settings
from drivers.mock.physics.aura_objects import NOTHING, OBJECTS, AuraObject, Side
from drivers.mock.physics.aura_scene import FORCE, RATE, TOOL, WIDTH, AuraScene, Layout
from drivers.mock.physics.aura_settings import AuraSettings
from drivers.mock.physics.bench import StreamSpec, ToolCarrier, mountable

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

PLACES = {"right": RIGHT, "left": LEFT}
"""Column of each finger."""

CHUNK = 9600
"""Frames that are computed at once: so many stay in a processor's cache."""

FACTORS = ("object", "object_x_m", "side", "temperature_k", "mismatch_db")
"""Factors of a trial that are settings of this bench."""


class AuraBenchSettings(AuraSettings):
    """The plant section of a profile: the aura's own parameters, and where things stand.

    The frame is the arm's base frame, from the start pose: x is the line on which the jaws close, y goes across the
    fingers, z along them, upwards. The right finger is at plus half the opening on x, the left one at minus.
    """

    scene: Literal["between", "ahead"] = "between"
    """`between`: the object stands between the fingers, their normal sides look at it, and it slides where one finger
    pushes it. `ahead`: it is clamped before one side of the right finger; moving forward on x closes the gap; the left
    finger does not see it."""

    object: str = "pipe"
    """What stands there, by its name among the objects; "none" is nothing."""

    wired: Annotated[
        tuple[Literal["right", "left"], ...], Strict(False), Field(min_length=1, max_length=FINGERS)
    ] = ("right", "left")
    """Fingers whose bridges are connected to the converter; of the other one nothing is computed, and its channel
    reads 0."""

    side: Side = "normal"
    """Which side of the right finger looks forward (`ahead`); a person turned the gripper so."""

    object_x_m: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Middle of the object on x, with the tool at its start pose (`between`)."""

    surface_m: float = Field(default=0.055, ge=0.0, le=0.5)
    """Where the object's surface is on x, from the finger's at the start pose (`ahead`; IV.A.1: from 5.5 cm)."""

    object_y_m: float = Field(default=0.0, ge=-0.5, le=0.5)
    """Middle of the object on y."""

    object_top_m: float = Field(default=0.03, ge=-0.5, le=0.5)
    """Upper end of the object on z, over the fingers' middle. Assumption: it stands on a table, held near its top."""

    lean_rad: float = Field(default=0.02, ge=-0.2, le=0.2)
    """By how much it leans towards x, seen from the height of the start pose. Assumption: nobody puts it straighter
    than a degree."""

    closed_width_m: float = Field(default=0.015, ge=0.008, le=0.037)
    """Opening of the closed jaws, set by the brackets; they open 48 mm wider."""

    push_n: float = Field(default=0.5, gt=0.0, le=100.0)
    """Force that slides an object which one finger pushes. Assumption: 0.1 kg on a table, friction 0.5."""

    press_n_m: float = Field(default=2000.0, gt=0.0, le=1e6)
    """Stiffness of a finger that is pressed on what is clamped. Assumption: its foam, 1 mm thick, gives 0.5 mm at
    1 N."""


class AuraBench:
    """The aura's plant, with fingers that an arm and a gripper carry.

    Once a millisecond it notes where everything is, whoever hears it; sound is computed when it is asked for.

    Args:
        settings: Of the bench.

    Attributes:
        t_s: How far time has passed here, on the devices' clock.
        key: Seed of the run and number of the trial, which key every noise.
        fingers: How many there are: right, left.
        jaws: Their drive; its time is the bench's.
    """

    fingers = FINGERS

    def __init__(self, settings: AuraBenchSettings) -> None:
        self._carrier: ToolCarrier | None = None
        self._settings = settings
        self._origin_s = 0.0
        self._drive = Drive()
        self._plant = AuraPlant(settings)
        self._wired = tuple(PLACES[name] for name in dict.fromkeys(settings.wired))
        self._computed = dict.fromkeys(("envelope", "carrier"), 0)
        self.jaws = AuraJaws(jaws_settings(settings.closed_width_m), self.advance)
        self._begin((0, 0))

    @property
    def level(self) -> Literal["envelope", "carrier"]:
        """What the audio device is to ask for."""
        return self._settings.level

    def warm_up(self) -> None:
        """Let compiled code load, or compile on first use, before anybody waits for an answer."""
        bench = AuraBench(self._settings)
        bench.drive(40_000.0, 0.5)
        bench.advance(0.01)
        bench.baseband(np.arange(1, 5) / ENVELOPE_HZ)
        bench.carrier(0, 10)

    def mount(self, carrier: ToolCarrier) -> None:
        """Fix the gripper to what carries it.

        Raises:
            RefusedError: something carries it already, or cannot tell where it is beside its axis.
        """
        mountable(self._carrier, carrier, "gripper", "this mover moves along one axis alone")
        self._carrier = carrier

    def restart(self) -> None:
        """Time begins anew: the tool at its start pose, the jaws open and without power, silence."""
        self._origin_s = 0.0
        self._drive.restart()
        self.jaws.renew()
        if self._carrier is not None:
            self._carrier.place(0.0, 0.0)

    def begin(
        self, t_s: float, seed: int, trial: int, factors: Mapping[str, Any], plant: Mapping[str, Any]
    ) -> None:
        """Put the bench into a trial's scene at time `t_s`: the object in its place, tool and jaws where they are.

        Args:
            t_s: Present time of the devices.
            seed: Of the run; keys the noise together with `trial`.
            trial: Number of the trial.
            factors: Its factors; those in `FACTORS` matter here, before the plant section.
            plant: The profile's plant section for this trial.

        Raises:
            RefusedError: there is no such object, or the brackets are to change.
        """
        chosen = {name: factors[name] for name in FACTORS if factors.get(name) is not None}
        settings = AuraBenchSettings.model_validate({**plant, **chosen})
        if settings.closed_width_m != self._settings.closed_width_m:
            raise RefusedError(
                "gripper",
                "being set up",
                f"its brackets are for {self._settings.closed_width_m * 1e3:g} mm",
                "the same closed_width_m holds for all trials of a run",
            )
        self.advance(t_s)
        if settings != self._settings:
            self._settings = settings
            self._plant = AuraPlant(settings)
        self._origin_s = t_s
        self._begin((seed, trial))

    def _begin(self, key: tuple[int, int]) -> None:
        settings = self._settings
        thing = _thing(settings.object)
        x_m = settings.object_x_m if settings.scene == "between" else settings.surface_m
        place_m = (x_m, settings.object_y_m, settings.object_top_m)
        layout = Layout(
            settings.scene, thing, place_m, settings.lean_rad, settings.push_n, settings.press_n_m
        )
        side: Side = settings.side if settings.scene == "ahead" else "normal"
        self._plant.begin(key, thing, settings.object_top_m, side)
        self.key, self.t_s = key, self._origin_s
        tool_m = self._tool(np.array([self.t_s]))[0]
        self._loaded = False
        self.jaws.jaws.place(None)
        tick = last_tick(self.t_s, ENVELOPE_HZ)
        self.jaws.run(tick / ENVELOPE_HZ)
        self._scene = AuraScene(layout, tick, tool_m, self.jaws.jaws.width_m)
        self._grip_fits = thing is not None and fits(self.jaws.jaws.settings, settings.object)

    # what the mover tells and feels

    def on_plan(self, t_s: float) -> None:
        """The tool's motion changes at `t_s`, or changed there already where time has passed it."""
        self.advance(t_s)

    def feel(self, on: bool) -> None:
        """Whether the arm's own sensor is listened to: it costs nothing here."""

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """What the object does to the tool, base axes, N and N m, shape (n, 6), at recent instants.

        Args:
            times_s: Shape (n,).
            direction: The approach direction: this bench knows where its fingers are pressed.
        """
        forces_n = self._scene.at(_ticks(times_s))[:, FORCE]
        found = np.zeros((len(times_s), 6))
        inward = 1.0 if self._settings.scene == "between" else -1.0
        found[:, 0] = inward * (forces_n[:, 0] - forces_n[:, 1])
        return found

    # what the audio device is wired to

    def drive(self, frequency_hz: float, level: float) -> None:
        """Drive both transducers with one frequency, from the bench's present time on; level is 0 to 1."""
        self._drive.tone(self.t_s, frequency_hz, level)

    def chirp(self, from_hz: float, to_hz: float, duration_s: float, level: float) -> None:
        """Sweep linearly once from the bench's present time on, then be silent."""
        self._drive.sweep(self.t_s, from_hz, to_hz, duration_s, level)

    def silence(self) -> None:
        """No drive, from the bench's present time on."""
        self._drive.silence(self.t_s)

    def excite(self, on: bool) -> None:
        """Silence, where it is off; to drive takes a frequency."""
        if not on:
            self.silence()

    def baseband(self, times_s: Floats) -> Complexes:
        """I and Q of the bridges as an ideal chain would give them, at recent milliseconds.

        Args:
            times_s: Whole milliseconds in growing order, none later than the last advance, shape (n,).

        Returns:
            Full scale 1.0, the drive's phase is the real axis (tone or sweep), shape (n, 2): right, left.
        """
        ticks = _ticks(times_s)
        rows = self._scene.at(ticks)
        motion = self._scene.motion(rows[:, TOOL], rows, rows[:, WIDTH])
        frequency_hz, level = self._drive.at(times_s)
        self._computed["envelope"] += len(ticks) * len(self._wired)
        return self._plant.envelope(motion, ticks, times_s - self._origin_s, frequency_hz, level, self._wired)

    def carrier(self, first_frame: int, n: int, *, drift_ppm: float = 0.0) -> NDArray[np.int32]:
        """Counts of the converter, 24 bits sign-extended, shape (n, 2): right, left.

        Frame k is at k / 96,000 s on the converter's clock; a tone's phase is zero at frame 0.

        Args:
            first_frame: The first; none may be later than the last advance, nor long before it.
            n: How many.
            drift_ppm: How much faster than the devices' clock the converter's runs.
        """
        end = first_frame + n
        cuts = range(first_frame, end, CHUNK)
        parts = [self._carrier_part(np.arange(cut, min(cut + CHUNK, end)), drift_ppm) for cut in cuts]
        self._computed["carrier"] += n * len(self._wired)
        return np.concatenate(parts) if parts else np.empty((0, FINGERS), dtype=np.int32)

    def _carrier_part(self, frames: NDArray[np.int64], drift_ppm: float) -> NDArray[np.int32]:
        times_s = frames / (FRAME_HZ * (1.0 + 1e-6 * drift_ppm))
        ticks = frames // (FRAME_HZ // ENVELOPE_HZ) if drift_ppm == 0.0 else _ticks(times_s)
        rows = self._scene.at(ticks)
        width_m = rows[:, WIDTH] + rows[:, RATE] * (times_s - ticks / ENVELOPE_HZ)
        motion = self._scene.motion(self._tool(times_s), rows, width_m)
        frequency_hz, level = self._drive.at(times_s)
        phase_rad = self._drive.phase_rad(frames, times_s)
        return self._plant.carrier(
            motion, frames, self._origin_s, frequency_hz, level, phase_rad, self._wired
        )

    # what other devices are wired to

    def streams(self) -> Sequence[StreamSpec]:
        """No sensor board is on this bench."""
        return ()

    def sample(self, stream: str, times_s: Floats) -> Floats:
        """No sensor board is on this bench."""
        raise KeyError(stream)

    def events(self, stream: str) -> tuple[Floats, Floats]:
        """No stream of this bench is irregular."""
        return np.empty(0), np.empty(0)

    def set_tendon(self, position_m: float) -> None:
        """There is no tendon on this bench."""

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        """Let time pass until `t_s`; nobody's hearing matters to where things are."""
        if t_s <= self.t_s:
            return
        last = last_tick(t_s, ENVELOPE_HZ)
        if last > self._scene.tick:
            self._follow(np.arange(self._scene.tick + 1, last + 1))
        self.t_s = t_s

    def _follow(self, ticks: NDArray[np.int64]) -> None:
        """Let the scene follow tool and jaws, in one go where nothing touches and the jaws stand still."""
        scene, jaws = self._scene, self.jaws
        times_s = ticks / ENVELOPE_HZ
        tools_m = self._tool(times_s)
        place = 0
        while place < len(ticks):
            if jaws.resting and scene.untouched and (followed := scene.rest(tools_m[place:])):
                place += followed
                jaws.run(float(times_s[place - 1]))
                continue
            self._set_between(scene.between(tools_m[place]))
            jaws.run(float(times_s[place]))
            scene.step(tools_m[place], jaws)
            place += 1

    def _set_between(self, between: bool) -> None:
        """Let the jaws know whether they have something to close on, or would still come to it."""
        if between == self._loaded or not self._grip_fits:
            return
        jaws, name = self.jaws.jaws, self._settings.object
        if between and jaws.width_m < jaws.settings.objects[name].width_m:
            return
        self._loaded = between
        jaws.place(name if between else None)
        self.jaws.disturb()

    def _tool(self, times_s: Floats) -> Floats:
        """Displacement of the tool from its start pose, m, shape (n, 3)."""
        if self._carrier is None:
            return np.zeros((len(times_s), 3))
        return self._carrier.offsets(times_s)[:, :3]

    # the truth, for scoring alone

    @property
    def contacts(self) -> Sequence[tuple[float, bool]]:
        """When a finger began (True) and ceased (False) to touch in this trial."""
        return self._scene.contacts

    @property
    def finger_contacts(self) -> tuple[Sequence[tuple[float, bool]], ...]:
        """The same of the right finger and of the left."""
        return self._scene.finger_contacts

    def distances(self, times_s: Floats) -> Floats:
        """How far each finger is from the object's surface on x at recent instants, m, shape (n, 2).

        Infinite for a finger that does not look there."""
        rows = self._scene.at(_ticks(times_s))
        return self._scene.motion(rows[:, TOOL], rows, rows[:, WIDTH]).gap_m

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where things stand: what a person at the bench would see."""
        tool_m = self._tool(np.array([t_s]))[0]
        right_m, left_m = self.distances(np.array([self.t_s]))[0].tolist()
        found = {"tool_x_m": tool_m[0], "tool_y_m": tool_m[1], "tool_z_m": tool_m[2]}
        found |= {"width_m": self.jaws.jaws.width_m, "gap_right_m": right_m, "gap_left_m": left_m}
        return {name: float(value) for name, value in found.items() if np.isfinite(value)}

    def account(self) -> Mapping[str, Any]:
        """What was computed: samples of a finger, at each level."""
        return {
            "level": self._settings.level,
            "object": self._settings.object,
            "computed": dict(self._computed),
        }


def _ticks(times_s: Floats) -> NDArray[np.int64]:
    """The millisecond at or before each instant."""
    found: NDArray[np.int64] = np.floor(times_s * ENVELOPE_HZ + 1e-6).astype(np.int64)
    return found


def _thing(name: str) -> AuraObject | None:
    if name == NOTHING:
        return None
    if name not in OBJECTS:
        there = ", ".join((*OBJECTS, NOTHING))
        raise RefusedError("bench", f"taking {name}", "there is no such object", f"choose one of {there}")
    return OBJECTS[name]
