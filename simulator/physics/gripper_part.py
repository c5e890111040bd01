"""A gripper in the tool and the object that it closes on, or presses on, as a part of a bench."""

from collections.abc import Mapping, Sequence
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from drivers.core.clock import last_tick
from drivers.core.errors import RefusedError
from drivers.core.messages import Floats
from simulator.physics.aura import ENVELOPE_HZ, FINGERS
from simulator.physics.aura_scene import FORCE, LOAD, TOOL, WIDTH, AuraScene, Lift, Weight
from simulator.physics.aura_settings import NOTHING, OBJECTS, AuraObject, AuraPlantSettings, Side
from simulator.physics.bench import Bench, BenchPart
from simulator.physics.jaws_drive import JawsDrive


class AuraBenchSettings(AuraPlantSettings):
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
    """Fingers whose bridges are connected to the converter; the other one is not computed, and its channel
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
    """By how much it leans towards x, seen from the height of the start pose. Assumption: it is not placed straighter
    than a degree."""

    closed_width_m: float = Field(default=0.015, ge=0.008, le=0.037)
    """Opening of the closed jaws, set by the brackets; they open 48 mm wider."""

    push_n: float = Field(default=0.5, gt=0.0, le=100.0)
    """Force that slides an object which one finger pushes. Assumption: 0.1 kg on a table, friction 0.5."""

    press_n_m: float = Field(default=2000.0, gt=0.0, le=1e6)
    """Stiffness of a finger that is pressed on what is clamped. Assumption: its foam, 1 mm thick, gives 0.5 mm at
    1 N."""

    @property
    def thing(self) -> AuraObject | None:
        """The object; None is nothing.

        Raises:
            RefusedError: there is none of this name.
        """
        return _thing(self.object)

    @property
    def slide_n(self) -> float:
        """Force that slides it where one finger pushes it."""
        return self.push_n

    @property
    def weight(self) -> Weight | None:
        """Of the object; None is one that goes wherever jaws that hold it go."""
        return None


class GripperPart(BenchPart):
    """Jaws on a gripper, two fingers on the jaws, and an object: where they are, once a millisecond.

    Attributes:
        jaws: Their drive; its time is the bench's.
        thing: The object, or None.
        track: Where all was lately.
    """

    offers = ("jaws", "contacts", "finger_contacts", "distances", "lifts", "slides")

    def __init__(self, bench: Bench, settings: AuraBenchSettings) -> None:
        super().__init__(bench)
        self.jaws = JawsDrive(settings.closed_width_m, bench.advance)
        self._begin(settings)

    def restart(self) -> None:
        """The jaws are open and without power."""
        self.jaws.renew()

    def check(self, settings: AuraBenchSettings, factors: Mapping[str, Any]) -> None:
        """Its object is one that is known, and the brackets stay."""
        if settings.closed_width_m != self._settings.closed_width_m:
            raise RefusedError(
                "gripper",
                "being set up",
                f"its brackets are for {self._settings.closed_width_m * 1e3:g} mm",
                "the same closed_width_m holds for all trials of a run",
            )
        _thing(settings.object)

    def begin(self, settings: AuraBenchSettings, factors: Mapping[str, Any]) -> None:
        """The object is in its place, tool and jaws are where they are."""
        self.advance(self.bench.t_s)
        self._begin(settings)

    def _begin(self, settings: AuraBenchSettings) -> None:
        self._settings = settings
        self.thing = settings.thing
        jaws = self.jaws
        jaws.clear()
        fitting = self.thing is not None and jaws.fits(self.thing.width_m)
        if self.thing is not None and fitting:
            jaws.show(self.thing.width_m, self.thing.stiffness_n_m)
        tick = last_tick(self.bench.t_s, ENVELOPE_HZ)
        tool_m = self.bench.places(np.array([self.bench.t_s]))[0, :3]
        self.track = AuraScene(settings, fitting, tick, tool_m, jaws.width_m)

    def advance(self, t_s: float) -> None:
        """See `BenchPart`."""
        ticks = np.arange(self.track.tick + 1, last_tick(t_s, ENVELOPE_HZ) + 1)
        polls_s = self.jaws.polls_until(t_s)
        if len(ticks) or len(polls_s):
            tools_m = self.bench.places(ticks / ENVELOPE_HZ)
            states = self.track.follow(tools_m, self.jaws, ticks_of(polls_s))
            self.jaws.states += [states] if len(states) else []

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """See `Bench.wrench`: along the line on which the jaws close, and the weight that they hold."""
        rows = self.track.at(ticks_of(times_s))
        forces_n = rows[:, FORCE]
        found = np.zeros((len(times_s), 6))
        inward = 1.0 if self._settings.scene == "between" else -1.0
        found[:, 0] = inward * (forces_n[:, 0] - forces_n[:, 1])
        found[:, 2] = -rows[:, LOAD]
        return found

    @property
    def contacts(self) -> Sequence[tuple[float, bool]]:
        """The truth: when a finger began (True) and ceased (False) to touch in this trial."""
        return self.track.contacts

    @property
    def finger_contacts(self) -> tuple[Sequence[tuple[float, bool]], ...]:
        """The same of the right finger and of the left."""
        return self.track.finger_contacts

    @property
    def lifts(self) -> Sequence[Lift]:
        """The truth: how far the fingers have lifted an object with a weight, while they hold it in this trial."""
        return self.track.lifts

    @property
    def slides(self) -> Sequence[tuple[float, bool]]:
        """The truth: when all of it began (True) and ceased (False) to slide in them."""
        return self.track.slides

    def distances(self, times_s: Floats) -> Floats:
        """How far each finger is from the object's surface on x at recent instants, m, shape (n, 2).

        Infinite for a finger that does not look there."""
        rows = self.track.at(ticks_of(times_s))
        return self.track.motion(rows[:, TOOL], rows, rows[:, WIDTH]).gap_m

    def scene(self, t_s: float) -> Mapping[str, float]:
        """Where tool and jaws are, and how far from the object."""
        tool_m = self.bench.places(np.array([t_s]))[0]
        right_m, left_m = self.distances(np.array([self.bench.t_s]))[0].tolist()
        found = {"tool_x_m": tool_m[0], "tool_y_m": tool_m[1], "tool_z_m": tool_m[2]}
        found |= {"width_m": self.jaws.width_m, "gap_right_m": right_m, "gap_left_m": left_m}
        return {name: float(value) for name, value in found.items() if np.isfinite(value)}

    def account(self) -> Mapping[str, Any]:
        """What stands there."""
        return {"object": self._settings.object}


def ticks_of(times_s: Floats) -> NDArray[np.int64]:
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
