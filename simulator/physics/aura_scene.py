"""Where two fingers and an object are, millisecond by millisecond, and which finger touches it."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from drivers.core.messages import Floats, Ints
from simulator.physics import gripper_kernel as kernel
from simulator.physics.aura import ENVELOPE_HZ, AuraMotion
from simulator.physics.held_kernel import GRAVITY_M_S2, NUMBERS, TOOL_BEFORE, TURN_M, Held
from simulator.physics.jaws_drive import JawsDrive
from simulator.physics.jaws_kernel import SEEN

if TYPE_CHECKING:
    from simulator.physics.gripper_part import AuraBenchSettings


KEEP = 4096
"""Milliseconds that are remembered: longer than an emulated bench falls behind, and twice as long as a look ahead (2 s
both)."""

TOOL, OBJECT, FORCE = (
    slice(kernel.TOOL, kernel.TOOL + 3),
    slice(kernel.OBJECT, kernel.OBJECT + 3),
    slice(9, 11),
)
WIDTH, RATE, SPEED, LOAD = kernel.WIDTH, kernel.RATE, kernel.SPEED, kernel.LOAD
SHARE, SLID, YAW = kernel.SHARE, kernel.SLID, kernel.YAW
"""Columns of a row: see the kernel."""


NOTE_TICKS = KEEP // 4
"""The truth about a lift is noted so many milliseconds at a time: with a look ahead they are still remembered."""

LIFT_TICKS = 5
"""How often the truth about a lift is noted, in milliseconds."""

SLIDES_M = 1e-6
"""An object that has slid further than this in a millisecond slides (assumption: what rounding leaves is less)."""

PAUSE_TICKS = 50
"""What rests for longer has stopped sliding (as `slip_track.PAUSE_S`)."""


class Lift(NamedTuple):
    """The truth about an object with a weight between two fingers, for scoring alone.

    Attributes:
        t_s: When, on the devices' clock.
        rise_m: How far it is off the table.
        carried: What of its weight the fingers carry, as a share.
        grip_n: How hard each presses.
        least_n: The least with which each would hold it.
        weight_n: The weight, and what accelerates it, that both would carry then, N.
        slid_m: How far it has slid in them so far.
        turned_rad: How far it has turned about the grip's axis.
        push_n: The greatest force so far with which one finger alone pushed it.
        crushed: Whether they have crushed it.
    """

    t_s: float
    rise_m: float
    carried: float
    grip_n: float
    least_n: float
    weight_n: float
    slid_m: float
    turned_rad: float
    push_n: float
    crushed: bool


class Weight(NamedTuple):
    """Of an object that stands on a table until friction lifts it.

    Attributes:
        held: As the kernel has it.
        crush_n: Force of a finger that crushes it.
    """

    held: Held
    crush_n: float


NO_WEIGHT = Held(0.0, 1.0, 1.0, 0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0)


class AuraScene:
    """Follows tool and jaws in order of time; the object slides where one finger pushes it, and moves along when held.

    Args:
        settings: What stands where.
        fits: Whether the jaws on their brackets close on the object at all.
        tick: Number of the millisecond in which it begins, on the devices' clock.
        tool_m: Displacement of the tool then, shape (3,).
        width_m: Opening of the jaws then.

    Attributes:
        tick: Number of the last millisecond that is known.
        contacts: When a finger began (True) and ceased (False) to touch, both fingers together.
        finger_contacts: The same of the right finger and of the left.
    """

    lasting = ("_rows", "_noted")

    def __init__(
        self, settings: AuraBenchSettings, fits: bool, tick: int, tool_m: Floats, width_m: float
    ) -> None:
        thing, self._weight, ahead = settings.thing, settings.weight, settings.scene == "ahead"
        x_m = settings.surface_m if ahead else settings.object_x_m
        place_m = (x_m, settings.object_y_m, settings.object_top_m)
        size_m = (0.0, 0.0, 0.0) if thing is None else (thing.width_m, thing.depth_m, thing.height_m)
        about = (place_m[2], settings.lean_rad, settings.slide_n, settings.press_n_m)
        held = NO_WEIGHT if self._weight is None else self._weight.held
        self._thing = kernel.GripThing(thing is not None, ahead, fits, *size_m, *about, held)
        self.tick = tick
        self.contacts: list[tuple[float, bool]] = []
        self.finger_contacts: tuple[list[tuple[float, bool]], ...] = ([], [])
        self._noted, self._notes = np.empty((1024, len(Lift._fields))), 0
        self._first = self._noted_tick = tick
        self._flags = np.zeros(4, dtype=np.int64)
        self._lift = np.zeros(NUMBERS)
        self._lift[TOOL_BEFORE] = tool_m[2]
        self._slides: list[tuple[int, int]] = []
        self._slid_m, self._push_n, self._crushed = 0.0, 0.0, False
        self._rows = np.zeros((KEEP, kernel.COLUMNS))
        row = self._rows[tick % KEEP]
        row[TOOL], row[OBJECT], row[WIDTH] = tool_m, place_m, width_m

    def follow(self, tools_m: Floats, jaws: JawsDrive, polls: Ints) -> Floats:
        """Follow tool and jaws.

        Args:
            tools_m: Displacement of the tool in the next milliseconds, and its turn, rad, shape (n, 6).
            jaws: Their drive runs along.
            polls: Numbers of the milliseconds after which it is polled, shape (m,).

        Returns:
            Its states, shape (m, 6): see `jaws_kernel.look`.
        """
        if self.tick + len(tools_m) > self._noted_tick + NOTE_TICKS:
            self._note_lifts()
        made = np.empty((2 * len(tools_m), 3), dtype=np.int64)
        state = (jaws.x, jaws.flags, self._flags, self._lift, self._rows)
        seen = np.empty((len(polls), SEEN))
        places_m = np.ascontiguousarray(tools_m[:, :3])
        n = kernel.follow(self._thing, *state, self.tick, places_m, made, polls, seen)
        kept = tools_m[-KEEP:, 5]
        self._rows[(self.tick + 1 + len(tools_m) - len(kept) + np.arange(len(kept))) % KEEP, YAW] = kept
        swapped = np.cos(tools_m[made[:n, 0] - self.tick - 1, 5]) < 0.0
        made[:n, 1] ^= swapped
        self.tick += len(tools_m)
        for tick, finger, touching in made[:n].tolist():
            event = (tick / ENVELOPE_HZ, bool(touching))
            self.contacts.append(event)
            self.finger_contacts[finger].append(event)
        return seen

    def _note_lifts(self) -> None:
        """Note what the fingers have held since it was noted last."""
        ticks = np.arange(max(self._noted_tick, self.tick - KEEP) + 1, self.tick + 1)
        self._noted_tick, weight = self.tick, self._weight
        if weight is None or not len(ticks):
            return
        rows = self.at(ticks)
        forces_n = rows[:, FORCE]
        both = (forces_n > 0.0).all(axis=1)
        if not forces_n.any():
            return
        alone_n = np.where(both, 0.0, forces_n.max(axis=1))
        slid_m = np.diff(rows[:, kernel.SLID], prepend=self._slid_m)
        self._slid_m = float(rows[-1, kernel.SLID])
        for tick in ticks[slid_m > SLIDES_M].tolist():
            if self._slides and tick - self._slides[-1][1] <= PAUSE_TICKS:
                self._slides[-1] = (self._slides[-1][0], tick)
            else:
                self._slides.append((tick, tick))
        pushed_n = np.maximum.accumulate(np.maximum(alone_n, self._push_n))
        crushed = np.logical_or.accumulate((forces_n[:, 0] > weight.crush_n) | self._crushed)
        self._push_n, self._crushed = float(pushed_n[-1]), bool(crushed[-1])
        per_n = 1.0 / (weight.held.mass_kg * GRAVITY_M_S2)
        per_grip = 2.0 * weight.held.friction / math.hypot(1.0, weight.held.lever_m / TURN_M)
        noted = both & (ticks % LIFT_TICKS == 0)
        rows, ticks = rows[noted], ticks[noted]
        end = self._notes + len(ticks)
        if end > len(self._noted):
            self._noted = np.concatenate(
                [self._noted, np.empty((max(end, len(self._noted)), len(Lift._fields)))]
            )
        self._noted[self._notes : end] = np.column_stack(
            [
                ticks / ENVELOPE_HZ,
                rows[:, kernel.OBJECT + 2] - self._thing.top_m,
                rows[:, LOAD] * per_n,
                rows[:, kernel.FORCE],
                rows[:, kernel.LEAST],
                rows[:, kernel.LEAST] * per_grip,
                rows[:, kernel.SLID],
                rows[:, kernel.TURNED],
                pushed_n[noted],
                crushed[noted],
            ]
        )
        self._notes = end

    @property
    def lifts(self) -> list[Lift]:
        """What was noted of the object while both fingers touched it."""
        self._note_lifts()
        return [Lift._make([*row[:-1], bool(row[-1])]) for row in self._noted[: self._notes].tolist()]

    @property
    def slides(self) -> list[tuple[float, bool]]:
        """When all of the object began (True) and ceased (False) to slide in the fingers."""
        self._note_lifts()
        return [(tick / ENVELOPE_HZ, i == 0) for span in self._slides for i, tick in enumerate(span)]

    def at(self, ticks: Ints) -> Floats:
        """Rows of some recent milliseconds, shape (n, columns)."""
        oldest = max(self._first, self.tick - KEEP + 1)
        found: Floats = self._rows[np.minimum(np.maximum(ticks, oldest), self.tick) % KEEP]
        return found

    def motion(self, tool_m: Floats, rows: Floats, width_m: Floats) -> AuraMotion:
        """Where fingers and object are towards each other, n instants.

        Args:
            tool_m: Displacement of the tool, shape (n, 3 or more).
            rows: Of the millisecond of each instant, shape (n, columns).
            width_m: Opening of the jaws, shape (n,).
        """
        there = self._thing.present
        away_m = self._away(rows[:, OBJECT], tool_m[:, :3]) if there else np.zeros((len(tool_m), 3))
        forces_n, yaw_rad = rows[:, FORCE], rows[:, YAW]
        if yaw_rad.any():  # the object's place as the wrist has it; its cross-section is taken for round
            cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
            x_m, y_m = away_m[:, 0].copy(), away_m[:, 1].copy()
            away_m[:, 0], away_m[:, 1] = cos * x_m + sin * y_m, cos * y_m - sin * x_m
            forces_n = np.where(cos[:, None] < 0.0, forces_n[:, ::-1], forces_n)
        return AuraMotion(
            self._gaps(away_m[:, 0], width_m),
            -away_m[:, 1],
            self._thing.top_m - away_m[:, 2],
            np.ascontiguousarray(width_m),
            forces_n,
            rows[:, SPEED],
            np.ascontiguousarray(tool_m[:, 0]),
        )

    def _away(self, place_m: Floats, tool_m: Floats) -> Floats:
        """Place of the object from the tool, at the tool's height, shape (..., 3) of two such."""
        away_m: Floats = place_m - tool_m
        away_m[..., 0] -= self._thing.lean_rad * (away_m[..., 2] - self._thing.top_m)
        return away_m

    def _gaps(self, x_m: Floats, width_m: Floats) -> Floats:
        """Distance of both fingers from the object on x, by its place from the tool, shape (n, 2)."""
        gaps_m = np.full((len(x_m), 2), np.inf)
        if not self._thing.present:
            return gaps_m
        if self._thing.ahead:
            gaps_m[:, 0] = x_m
            return gaps_m
        half_m = 0.5 * (width_m - self._thing.width_m)
        gaps_m[:, 0] = half_m - x_m
        gaps_m[:, 1] = half_m + x_m
        return gaps_m
