"""A gripper and an object, millisecond by millisecond: what touches, is pushed, held, lifted or dropped. Compiled."""

import math
from typing import NamedTuple

from drivers.core.compiled import compiled
from drivers.core.messages import Floats, Ints
from simulator.physics.aura_settings import PAD_LENGTH_M, PAD_WIDTH_M
from simulator.physics.held_kernel import HEIGHT, STEPS, TURN_M, Held, carried
from simulator.physics.held_kernel import LEAST as HELD_LEAST
from simulator.physics.held_kernel import LOAD as HELD_LOAD
from simulator.physics.held_kernel import SHARE as HELD_SHARE
from simulator.physics.held_kernel import SLID as HELD_SLID
from simulator.physics.held_kernel import TURNED as HELD_TURNED
from simulator.physics.jaws_kernel import PRESENT, RESTING, TICK_S, look
from simulator.physics.jaws_kernel import RATE as JAWS_RATE
from simulator.physics.jaws_kernel import WIDTH as JAWS_WIDTH
from simulator.physics.jaws_kernel import advance as run_jaws
from simulator.physics.jaws_kernel import contact_n as pressed_n

ROW_HZ = 1000
"""Rows a second (as `aura.ENVELOPE_HZ`)."""

JAWS_TICKS = round(1.0 / (TICK_S * ROW_HZ))
"""Ticks of the jaws' drive in a row."""

TOUCH_M = 1e-9
"""Nearer than this is touching: where a finger has pushed an object, the gap is zero but for rounding."""

TOOL, OBJECT, WIDTH, RATE, SPEED, FORCE, LOAD, SHARE, LEAST, SLID, TURNED, YAW = (
    0,
    3,
    6,
    7,
    8,
    9,
    *range(11, 17),
)
COLUMNS = 17
"""What a row holds: displacement of the tool and place of the object (three each, m), opening (m) and its rate (m/s),
speed of arm and jaws (m/s), force on the right and on the left finger (N); of an object with a weight what they carry
of it (N), the share of their friction that carries it, the least force that would hold it (N), how far it has slid in
them (m) and turned (rad); by how much the wrist has turned about the fingers' length (rad). Right and left are as if it
had not."""

RIGHT, LEFT, HELD, LOADED = range(4)
"""Flags: which finger touches, whether both hold the object, whether the jaws would close on it."""


class GripThing(NamedTuple):
    """An object as the kernel has it: see `AuraBenchSettings`; what is not there is not `present`."""

    present: bool
    ahead: bool
    fits: bool
    width_m: float
    depth_m: float
    height_m: float
    top_m: float
    lean_rad: float
    push_n: float
    press_n_m: float
    held: Held


@compiled()
def before(thing: GripThing, y_m: float, z_m: float) -> bool:
    """Whether the object is before the fingers, by its place from the tool across and lengthwise."""
    across = abs(y_m) < 0.5 * (thing.depth_m + PAD_WIDTH_M)
    return across and z_m > -0.5 * PAD_LENGTH_M and z_m - thing.height_m < 0.5 * PAD_LENGTH_M


@compiled()
def touched(thing: GripThing, flags: Ints, row: Floats, contact_n: float) -> tuple[bool, bool]:
    """Which fingers touch; writes their forces and pushes the object where a finger would be in it."""
    row[FORCE] = row[FORCE + 1] = 0.0
    z_m = row[OBJECT + 2] - row[TOOL + 2]
    if not thing.present or not before(thing, row[OBJECT + 1] - row[TOOL + 1], z_m):
        flags[HELD] = 0
        return False, False
    x_m = row[OBJECT] - row[TOOL] - thing.lean_rad * (z_m - thing.top_m)
    if thing.ahead:
        row[FORCE] = thing.press_n_m * max(-x_m, 0.0)
        return x_m <= TOUCH_M, False
    half_m = 0.5 * (row[WIDTH] - thing.width_m)
    right_m, left_m = half_m - x_m, half_m + x_m
    flags[HELD] = right_m + left_m < -TOUCH_M
    if flags[HELD]:
        row[OBJECT] -= x_m
        row[FORCE] = row[FORCE + 1] = contact_n
        return True, True
    if thing.held.mass_kg > 0.0:
        # the finger gives until the table no longer holds the object
        row[FORCE] = min(thing.press_n_m * max(-right_m, 0.0), thing.push_n)
        row[FORCE + 1] = min(thing.press_n_m * max(-left_m, 0.0), thing.push_n)
        row[OBJECT] += min(right_m + thing.push_n / thing.press_n_m, 0.0)
        row[OBJECT] -= min(left_m + thing.push_n / thing.press_n_m, 0.0)
        return right_m <= TOUCH_M, left_m <= TOUCH_M
    if right_m < 0.0:
        row[OBJECT] += right_m
        left_m += right_m
    elif left_m < 0.0:
        row[OBJECT] -= left_m
        right_m += left_m
    row[FORCE], row[FORCE + 1] = thing.push_n * (right_m <= TOUCH_M), thing.push_n * (left_m <= TOUCH_M)
    return right_m <= TOUCH_M, left_m <= TOUCH_M


@compiled()
def meets(thing: GripThing, flags: Ints, row: Floats, tool_m: Floats, x: Floats, jaws_flags: Ints) -> None:
    """Set whether the jaws have something to close on, or would still come to it."""
    between = thing.present and not thing.ahead
    if between and not flags[HELD]:
        between = before(thing, row[OBJECT + 1] - tool_m[1], row[OBJECT + 2] - tool_m[2])
    if between == flags[LOADED] or not thing.fits or (between and x[JAWS_WIDTH] < thing.width_m):
        return
    flags[LOADED] = jaws_flags[PRESENT] = between
    jaws_flags[RESTING] = 0


@compiled()
def follow(
    thing: GripThing,
    x: Floats,
    jaws_flags: Ints,
    flags: Ints,
    lift: Floats,
    rows: Floats,
    tick: int,
    tools_m: Floats,
    contacts: Ints,
    polls: Ints,
    seen: Floats,
) -> int:
    """Follow tool and jaws through milliseconds.

    Args:
        x: State of the jaws.
        flags: Those above.
        lift: State of an object with a weight: see `held_kernel`.
        rows: The latest milliseconds, by their number, shape (kept, columns).
        tick: Number of the last one that is known.
        tools_m: Displacement of the tool in those that follow, shape (n, 3).
        contacts: What touched and ceased to: number, finger, whether it touches; (2 n, 3), written from the first.
        polls: After which milliseconds the drive is polled, growing, shape (m,).
        seen: Its states, shape (m, columns): see `jaws_kernel.look`.

    Returns:
        How many of the contacts were written.
    """
    written = looked = 0
    for number in range(len(tools_m)):
        while looked < len(polls) and polls[looked] <= tick:
            look(x, jaws_flags, seen[looked])
            looked += 1
        last, tool_m = rows[tick % len(rows)], tools_m[number]
        meets(thing, flags, last, tool_m, x, jaws_flags)
        run_jaws(x, jaws_flags, tick * JAWS_TICKS, (tick + 1) * JAWS_TICKS)
        tick += 1
        row = rows[tick % len(rows)]
        way_m2 = 0.0
        for k in range(3):
            moved_m = tool_m[k] - last[TOOL + k]
            way_m2 += moved_m**2
            row[TOOL + k] = tool_m[k]
            row[OBJECT + k] = last[OBJECT + k] + (moved_m if flags[HELD] else 0.0)
        row[WIDTH], row[RATE] = x[JAWS_WIDTH], x[JAWS_RATE]
        row[SPEED] = ROW_HZ * math.sqrt(way_m2) + abs(x[JAWS_RATE])
        touching = touched(thing, flags, row, pressed_n(x, jaws_flags))
        for finger in range(2):
            if touching[finger] != flags[finger]:
                flags[finger] = touching[finger]
                contacts[written, 0], contacts[written, 1], contacts[written, 2] = tick, finger, flags[finger]
                written += 1
        row[LOAD:YAW] = 0.0
        if thing.held.mass_kg > 0.0:
            pressed = row[FORCE] if flags[HELD] else 0.0
            carried(thing.held, lift, tool_m[2], pressed, 1.0 / ROW_HZ, STEPS)
            row[LOAD], row[SHARE], row[LEAST] = lift[HELD_LOAD], lift[HELD_SHARE], lift[HELD_LEAST]
            row[SLID], row[TURNED] = lift[HELD_SLID], lift[HELD_TURNED] / TURN_M
            row[OBJECT + 2] = thing.top_m + lift[HEIGHT]
    for late in range(looked, len(polls)):
        look(x, jaws_flags, seen[late])
    return written
