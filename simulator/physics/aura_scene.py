"""Where two fingers and an object are, millisecond by millisecond, and which finger touches it."""

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from simulator.physics import gripper_kernel as kernel
from simulator.physics.aura import ENVELOPE_HZ, AuraMotion
from simulator.physics.aura_settings import AuraObject
from simulator.physics.jaws_drive import Jaws
from simulator.physics.jaws_kernel import SEEN

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KEEP = 4096
"""Milliseconds that are remembered: longer than an emulated bench falls behind, and twice as long as a look ahead (2 s
both)."""

TOOL, OBJECT, FORCE = (
    slice(kernel.TOOL, kernel.TOOL + 3),
    slice(kernel.OBJECT, kernel.OBJECT + 3),
    slice(9, 11),
)
WIDTH, RATE, SPEED, LOAD = kernel.WIDTH, kernel.RATE, kernel.SPEED, kernel.LOAD
"""Columns of a row: see the kernel."""


LIFT_TICKS = 50
"""How often the truth about a lift is noted, in milliseconds."""


class Lift(NamedTuple):
    """The truth about an object with a weight between two fingers, for scoring alone.

    Attributes:
        t_s: When, on the devices' clock.
        rise_m: How far it is off the table.
        carried: What of its weight the fingers carry, as a share.
    """

    t_s: float
    rise_m: float
    carried: float


class Weight(NamedTuple):
    """Of an object that stands on a table until friction lifts it.

    Attributes:
        friction: Coefficient of kinetic friction of either finger.
        hold_n_m: Tangential stiffness of both fingers together.
    """

    mass_kg: float
    friction: float
    hold_n_m: float


class Layout(NamedTuple):
    """What stands where: see `AuraBenchSettings`.

    Attributes:
        scene: `between` the fingers or `ahead` of the right one.
        thing: The object, or None.
        place_m: Its middle on x and y (on x its surface, where it is ahead) and its upper end on z.
        lean_rad: By how much it leans towards x.
        push_n: Force that slides it.
        press_n_m: Stiffness of a finger that is pressed on what is clamped.
        weight: Of the object; None is one that goes wherever jaws that hold it go.
    """

    scene: Literal["between", "ahead"]
    thing: AuraObject | None
    place_m: tuple[float, float, float]
    lean_rad: float
    push_n: float
    press_n_m: float
    weight: Weight | None = None

    def thing_for_kernel(self, fits: bool) -> kernel.GripThing:
        """The same as the kernel has it; `fits` is whether the jaws close on it at all."""
        thing = self.thing
        size_m = (0.0, 0.0, 0.0) if thing is None else (thing.width_m, thing.depth_m, thing.height_m)
        about = (self.place_m[2], self.lean_rad, self.push_n, self.press_n_m)
        weight = self.weight or Weight(0.0, 0.0, 1.0)
        return kernel.GripThing(thing is not None, self.scene == "ahead", fits, *size_m, *about, *weight)


class AuraScene:
    """Follows tool and jaws in order of time; the object slides where one finger pushes it, and moves along when held.

    Args:
        fits: Whether the jaws on their brackets close on the object at all.
        tick: Number of the millisecond in which it begins, on the devices' clock.
        tool_m: Displacement of the tool then, shape (3,).
        width_m: Opening of the jaws then.

    Attributes:
        tick: Number of the last millisecond that is known.
        contacts: When a finger began (True) and ceased (False) to touch, both fingers together.
        finger_contacts: The same of the right finger and of the left.
        lifts: How far both fingers have lifted the object, while they hold it.
    """

    lasting = ("_rows",)

    def __init__(self, layout: Layout, fits: bool, tick: int, tool_m: Floats, width_m: float) -> None:
        self.layout = layout
        self.tick = tick
        self.contacts: list[tuple[float, bool]] = []
        self.finger_contacts: tuple[list[tuple[float, bool]], ...] = ([], [])
        self.lifts: list[Lift] = []
        self._thing = layout.thing_for_kernel(fits)
        self._first = tick
        self._flags = np.zeros(4, dtype=np.int64)
        self._lift = np.array([layout.place_m[2], tool_m[2], tool_m[2], math.nan])
        self._rows = np.zeros((KEEP, kernel.COLUMNS))
        row = self._rows[tick % KEEP]
        row[TOOL], row[OBJECT], row[WIDTH] = tool_m, layout.place_m, width_m

    def follow(self, tools_m: Floats, jaws: Jaws, polls: Ints) -> Floats:
        """Follow tool and jaws.

        Args:
            tools_m: Displacement of the tool in the next milliseconds, shape (n, 3).
            jaws: Their drive runs along.
            polls: Numbers of the milliseconds after which it is polled, shape (m,).

        Returns:
            Its states, shape (m, 6): see `jaws_kernel.look`.
        """
        made = np.empty((2 * len(tools_m), 3), dtype=np.int64)
        state = (jaws.x, jaws.flags, self._flags, self._lift, self._rows)
        seen = np.empty((len(polls), SEEN))
        n = kernel.follow(self._thing, *state, self.tick, np.ascontiguousarray(tools_m), made, polls, seen)
        self.tick += len(tools_m)
        for tick, finger, touching in made[:n].tolist():
            event = (tick / ENVELOPE_HZ, bool(touching))
            self.contacts.append(event)
            self.finger_contacts[finger].append(event)
        if self.layout.weight is not None:
            self._note_lifts(
                self.tick - len(tools_m), 1.0 / (self.layout.weight.mass_kg * kernel.GRAVITY_M_S2)
            )
        return seen

    def _note_lifts(self, since: int, per_n: float) -> None:
        """Note what the fingers hold, after the millisecond `since`."""
        first = max(since, self.tick - KEEP)
        ticks = np.arange(-(-(first + 1) // LIFT_TICKS) * LIFT_TICKS, self.tick + 1, LIFT_TICKS)
        for tick, row in zip(ticks.tolist(), self.at(ticks), strict=True):
            if row[FORCE].all():
                rise_m = float(row[kernel.OBJECT + 2]) - self.layout.place_m[2]
                self.lifts.append(Lift(tick / ENVELOPE_HZ, rise_m, float(row[LOAD]) * per_n))

    def at(self, ticks: Ints) -> Floats:
        """Rows of some recent milliseconds, shape (n, columns)."""
        oldest = max(self._first, self.tick - KEEP + 1)
        return self._rows[np.clip(ticks, oldest, self.tick) % KEEP]

    def motion(self, tool_m: Floats, rows: Floats, width_m: Floats) -> AuraMotion:
        """Where fingers and object are towards each other, n instants.

        Args:
            tool_m: Displacement of the tool, shape (n, 3).
            rows: Of the millisecond of each instant, shape (n, columns).
            width_m: Opening of the jaws, shape (n,).
        """
        if self.layout.thing is None:
            away_m = np.broadcast_to(0.0, (len(tool_m), 3))
        else:
            away_m = self._away(rows[:, OBJECT], tool_m)
        return AuraMotion(
            self._gaps(away_m[:, 0], width_m),
            -away_m[:, 1],
            self.layout.place_m[2] - away_m[:, 2],
            np.ascontiguousarray(width_m),
            rows[:, FORCE],
            rows[:, SPEED],
            np.ascontiguousarray(tool_m[:, 0]),
        )

    def _away(self, place_m: Floats, tool_m: Floats) -> Floats:
        """Place of the object from the tool, at the tool's height, shape (..., 3) of two such."""
        away_m: Floats = place_m - tool_m
        away_m[..., 0] -= self.layout.lean_rad * (away_m[..., 2] - self.layout.place_m[2])
        return away_m

    def _gaps(self, x_m: Floats, width_m: Floats) -> Floats:
        """Distance of both fingers from the object on x, by its place from the tool, shape (n, 2)."""
        gaps_m = np.full((len(x_m), 2), np.inf)
        if self.layout.thing is None:
            return gaps_m
        if self.layout.scene == "ahead":
            gaps_m[:, 0] = x_m
            return gaps_m
        half_m = 0.5 * (width_m - self.layout.thing.width_m)
        gaps_m[:, 0] = half_m - x_m
        gaps_m[:, 1] = half_m + x_m
        return gaps_m
