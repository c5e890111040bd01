"""Where two fingers and an object are, millisecond by millisecond, and which finger touches it."""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.mock.physics.aura import ENVELOPE_HZ, Motion
from drivers.mock.physics.aura_objects import AuraObject
from drivers.mock.physics.aura_settings import PAD_LENGTH_M, PAD_WIDTH_M
from drivers.mock.physics.jaws_drive import JawsDrive

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

KEEP = 4096
"""Milliseconds that are remembered: longer than an emulated bench falls behind (its backlog is 2 s)."""

TOUCH_M = 1e-9
"""Nearer than this is touching: where a finger has pushed an object, the gap is zero but for rounding."""

TOOL, OBJECT, WIDTH, RATE, SPEED, FORCE, LOAD = slice(0, 3), slice(3, 6), 6, 7, 8, slice(9, 11), 11
COLUMNS = 12
"""What a row holds: displacement of the tool and place of the object (m), opening (m) and its rate (m/s), speed of
arm and jaws (m/s), force on the right and on the left finger (N), and what of the object's weight they hold (N)."""

GRAVITY_M_S2 = 9.80665
"""Standard gravity (CGPM 1901)."""

STATIC = 1.05
"""How much larger static friction is (as `SlipSettings.static_excess`)."""


class Weight(NamedTuple):
    """Of an object that stands on a table until friction lifts it.

    Attributes:
        mass_kg: Of the object.
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


class AuraScene:
    """Follows tool and jaws in order of time; the object slides where one finger pushes it, and goes along when held.

    Args:
        layout: What stands where.
        tick: Number of the millisecond in which it begins, on the devices' clock.
        tool_m: Displacement of the tool then, shape (3,).
        width_m: Opening of the jaws then.

    Attributes:
        tick: Number of the last millisecond that is known.
        contacts: When a finger began (True) and ceased (False) to touch, both fingers together.
        finger_contacts: The same of the right finger and of the left.
    """

    def __init__(self, layout: Layout, tick: int, tool_m: Floats, width_m: float) -> None:
        self.layout = layout
        self.tick = tick
        self.contacts: list[tuple[float, bool]] = []
        self.finger_contacts: tuple[list[tuple[float, bool]], ...] = ([], [])
        self._first = tick
        self._touching = [False, False]
        self._held = False
        self._lift = None if layout.weight is None else Lift(layout.weight, layout.place_m[2], tool_m[2])
        self._rows = np.zeros((KEEP, COLUMNS))
        row = self._rows[tick % KEEP]
        row[TOOL], row[OBJECT], row[WIDTH] = tool_m, layout.place_m, width_m

    @property
    def untouched(self) -> bool:
        """Whether no finger touches anything, and nothing falls."""
        return not any(self._touching) and (self._lift is None or self._lift.standing)

    def at(self, ticks: Ints) -> Floats:
        """Rows of some recent milliseconds, shape (n, columns)."""
        oldest = max(self._first, self.tick - KEEP + 1)
        return self._rows[np.clip(ticks, oldest, self.tick) % KEEP]

    def motion(self, tool_m: Floats, rows: Floats, width_m: Floats) -> Motion:
        """Where fingers and object are towards each other, n instants.

        Args:
            tool_m: Displacement of the tool, shape (n, 3).
            rows: Of the millisecond of each instant, shape (n, columns).
            width_m: Opening of the jaws, shape (n,).
        """
        away_m = self._away(rows[:, OBJECT], tool_m)
        return Motion(
            self._gaps(away_m[:, 0], width_m),
            -away_m[:, 1],
            self.layout.place_m[2] - away_m[:, 2],
            np.ascontiguousarray(width_m),
            rows[:, FORCE],
            rows[:, SPEED],
        )

    def rest(self, tools_m: Floats) -> int:
        """Follow the tool while the jaws stand still and nothing is touched.

        Args:
            tools_m: Displacement of the tool in the next milliseconds, shape (n, 3).

        Returns:
            How many of them were followed: those before the first touch.
        """
        last = self._rows[self.tick % KEEP]
        n = min(len(tools_m), KEEP)
        if self.layout.thing is not None:
            away_m = self._away(last[None, OBJECT], tools_m[:n])
            gaps_m = self._gaps(away_m[:, 0], np.full(n, last[WIDTH])).min(axis=1)
            near = np.flatnonzero((gaps_m <= TOUCH_M) & self._before(away_m[:, 1], away_m[:, 2]))
            n = int(near[0]) if len(near) else n
        if not n:
            return 0
        rows = np.empty((n, COLUMNS))
        rows[:, TOOL] = tools_m[:n]
        rows[:, OBJECT] = last[OBJECT]
        rows[:, WIDTH], rows[:, RATE] = last[WIDTH], 0.0
        steps_m = np.diff(tools_m[:n], axis=0, prepend=last[None, TOOL])
        rows[:, SPEED] = ENVELOPE_HZ * np.sqrt((steps_m**2).sum(axis=1))
        rows[:, FORCE.start :] = 0.0
        self._rows[np.arange(self.tick + 1, self.tick + 1 + n) % KEEP] = rows
        self.tick += n
        return n

    def step(self, tool_m: Floats, jaws: JawsDrive) -> None:
        """Follow tool and jaws through the next millisecond, at whose end both are."""
        last = self._rows[self.tick % KEEP]
        self.tick += 1
        row = self._rows[self.tick % KEEP]
        width_m, rate_m_s, contact_n = jaws.jaws.width_m, jaws.jaws.rate_m_s, jaws.jaws.contact_n
        moved_m = tool_m - last[TOOL]
        place_m = last[OBJECT] + (moved_m if self._held else 0.0)
        forces_n = self._touch(tool_m, place_m, width_m, contact_n)
        row[TOOL], row[OBJECT], row[WIDTH], row[RATE] = tool_m, place_m, width_m, rate_m_s
        row[SPEED] = ENVELOPE_HZ * math.hypot(*moved_m) + abs(rate_m_s)
        row[FORCE] = forces_n
        if self._lift is not None:
            row[OBJECT][2], row[LOAD] = self._lift.step(tool_m[2], contact_n if self._held else 0.0)

    def between(self, tool_m: Floats) -> bool:
        """Whether the jaws would close on the object, with the tool there."""
        if self.layout.thing is None or self.layout.scene == "ahead":
            return False
        away_m = self._away(self._rows[self.tick % KEEP, OBJECT], tool_m)
        return self._held or bool(self._before(away_m[1], away_m[2]))

    def _touch(
        self, tool_m: Floats, place_m: Floats, width_m: float, contact_n: float
    ) -> tuple[float, float]:
        """Forces on both fingers; pushes `place_m` where a finger would be in it."""
        thing, layout = self.layout.thing, self.layout
        away_m = self._away(place_m, tool_m)
        if thing is None or not self._before(away_m[1], away_m[2]):
            self._held = False
            return self._felt((False, False), (0.0, 0.0))
        right_m, left_m = self._gaps(away_m[:1], np.array([width_m]))[0].tolist()
        if layout.scene == "ahead":
            touching = right_m <= TOUCH_M
            return self._felt((touching, False), (layout.press_n_m * max(-right_m, 0.0), 0.0))
        self._held = right_m + left_m < -TOUCH_M
        if self._held:
            place_m[0] -= away_m[0]
            return self._felt((True, True), (contact_n, contact_n))
        if right_m < 0.0:
            place_m[0] += right_m
            left_m += right_m
        elif left_m < 0.0:
            place_m[0] -= left_m
            right_m += left_m
        touching = (right_m <= TOUCH_M, left_m <= TOUCH_M)
        return self._felt(touching, (layout.push_n * touching[0], layout.push_n * touching[1]))

    def _felt(self, touching: tuple[bool, bool], forces_n: tuple[float, float]) -> tuple[float, float]:
        t_s = self.tick / ENVELOPE_HZ
        for finger in range(2):
            if touching[finger] != self._touching[finger]:
                self._touching[finger] = touching[finger]
                self.contacts.append((t_s, touching[finger]))
                self.finger_contacts[finger].append((t_s, touching[finger]))
        return forces_n

    def _away(self, place_m: Floats, tool_m: Floats) -> Floats:
        """Place of the object from the tool, at the tool's height, shape (..., 3) of two such."""
        away_m: Floats = place_m - tool_m
        away_m[..., 0] -= self.layout.lean_rad * (away_m[..., 2] - self.layout.place_m[2])
        return away_m

    def _before(self, y_m: Floats | float, z_m: Floats | float) -> NDArray[np.bool_]:
        """Whether the object is before the fingers, by its place from the tool across and lengthwise."""
        thing = self.layout.thing
        assert thing is not None
        across = np.abs(y_m) < 0.5 * (thing.depth_m + PAD_WIDTH_M)
        found: NDArray[np.bool_] = (
            across & (z_m > -0.5 * PAD_LENGTH_M) & (z_m - thing.height_m < 0.5 * PAD_LENGTH_M)
        )
        return found

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


class Lift:
    """An object's height under its weight: on the table, held by friction, sliding in the fingers, or falling.

    Quasi-static where it is held: the fingers give elastically under the weight. Semi-implicit Euler, a step a
    millisecond, where it slides or falls.

    Args:
        weight: Of the object.
        table_m: Height of its upper end while it stands on the table.
        tool_m: Height of the tool now.
    """

    def __init__(self, weight: Weight, table_m: float, tool_m: float) -> None:
        self._weight = weight
        self._table_m = self._place_m = table_m
        self._tool_m = self._taken_m = tool_m
        self._slides_m_s: float | None = None

    @property
    def standing(self) -> bool:
        """Whether it stands on the table."""
        return self._place_m == self._table_m

    def step(self, tool_m: float, contact_n: float) -> tuple[float, float]:
        """Let a millisecond pass.

        Args:
            tool_m: Height of the tool at its end.
            contact_n: Force on either finger.

        Returns:
            Height of the object's upper end, m, and what the fingers hold of its weight, N.
        """
        weight, before_m = self._weight, self._tool_m
        self._tool_m = tool_m
        weight_n = weight.mass_kg * GRAVITY_M_S2
        most_n = 2.0 * weight.friction * contact_n
        # what they would hold if it stood on the table, by how far the tool is above where they took hold of it
        pulled_n = weight.hold_n_m * (tool_m - self._taken_m)
        held_n = min(pulled_n, weight_n)
        if self._slides_m_s is None and abs(held_n) <= STATIC * most_n:
            above_m = max(pulled_n - weight_n, 0.0) / weight.hold_n_m
            self._place_m = self._table_m + above_m
            return self._place_m, held_n
        if self.standing:
            held_n = min(max(pulled_n, -most_n), most_n)
        else:
            tool_m_s = ENVELOPE_HZ * (tool_m - before_m)
            slides_m_s = tool_m_s if self._slides_m_s is None else self._slides_m_s
            slides_m_s += (most_n - weight_n) / weight.mass_kg / ENVELOPE_HZ
            self._place_m = max(self._place_m + slides_m_s / ENVELOPE_HZ, self._table_m)
            caught = self.standing or slides_m_s >= tool_m_s
            self._slides_m_s = None if caught else slides_m_s
            held_n = most_n
        self._taken_m = tool_m - (self._place_m - self._table_m) - held_n / weight.hold_n_m
        return self._place_m, held_n
