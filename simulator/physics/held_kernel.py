"""An object between two pressed pads: table, friction of either pad, sag, turn about the grip's axis. Compiled.

The equations: docs/explanation/grasp.md. Force and torque that friction takes up are one vector, the torque divided by
the pads' radius of friction (`TURN_M`): a circle bounds it (the limit surface of Howe and Cutkosky with equal axes),
and what slides moves along it. Each pad is `RINGS` springs in parallel, each of which sticks or slides by itself.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from drivers.core.compiled import compiled
from drivers.core.messages import Floats

GRAVITY_M_S2 = 9.80665
"""Standard gravity (CGPM 1901)."""

STEPS = 10
"""Steps of a millisecond. Halving them changes when slip begins and how far it goes by less than what
tests/simulator/physics/test_held_object.py bounds."""

STATIC = 1.05
"""How much larger static friction is (as `SlipPlantSettings.static_excess`)."""

TURN_M = 0.0033
"""Radius at which friction takes up torque: two thirds of a round pad's, of 5 mm under even pressure (assumption)."""

RINGS = 4
PRESSED = np.array([0.2, 0.235, 0.265, 0.3])
"""Shares of the pressure of springs that are equally stiff: the first slides at 0.8 of the load at which all would if
they were pressed alike, so that partial slip comes before gross slip (assumption: a soft pad, little less pressed at
its rim)."""

RELAX_S = 3e-3
"""Damping of a pad over its stiffness (assumption: a rubber's loss factor of 0.2 at 10 Hz)."""

NUMBERS = 13 + 3 * RINGS
(
    HEIGHT,
    SPEED,
    TURNED,
    SPIN,
    TOOL_BEFORE,
    FORCE_BEFORE,
    TOOL_SPEED,
    AIR_S,
    LOAD,
    TORQUE,
    SHARE,
    LEAST,
    SLID,
) = range(13)
ALONG, ROUND, SLIDES = 13, 13 + RINGS, 13 + 2 * RINGS
"""State: height over the place where it stood and its speed, turn times `TURN_M` and its rate (m, m/s); of the last
millisecond height of the tool (m), force of either pad (N), speed of the tool (m/s); time that the tool has been up
(s); what the pads carry and their torque over `TURN_M` (N), share of their friction that carries it, least force of
either that would hold the object (N), how far all of it has slid so far (m). Then of each ring where it holds, along
and round (m), and whether it slides."""


class Held(NamedTuple):
    """An object with a weight as the kernel has it; `mass_kg` 0 is none.

    Attributes:
        friction: Coefficient of kinetic friction of either pad.
        hold_n_m: Tangential stiffness of both pads together.
        lever_m: How far the centre of mass is beside the grip's axis.
        gyration_m: Radius of gyration about the centre of mass.
        up_m: The tool is up where it is so far above where it gripped; then times count.
        added: Load that is hung on, as a share of the mass, from `added_s` for `added_for_s`.
        tap_n: Peak of a tap from below, half a sine of `tap_for_s`, from `tap_s` on.
    """

    mass_kg: float
    friction: float
    hold_n_m: float
    lever_m: float
    gyration_m: float
    up_m: float
    added: float
    added_s: float
    added_for_s: float
    tap_n: float
    tap_s: float
    tap_for_s: float


@compiled()
def pulled(thing: Held, x: Floats, force_n: float, tool_m: float, tool_m_s: float) -> tuple[float, float]:
    """What the pads exert on the object, along and round, N; rings that are overloaded slide.

    Args:
        force_n: With which each pad presses.
    """
    each_n_m = thing.hold_n_m / RINGS
    along_m, round_m = tool_m - x[HEIGHT], -x[TURNED]
    along_m_s, round_m_s = tool_m_s - x[SPEED], -x[SPIN]
    along_n = round_n = 0.0
    nearest_m = math.inf
    for ring in range(RINGS):
        most_n = 2.0 * thing.friction * force_n * PRESSED[ring]
        stretch_m, twist_m = along_m - x[ALONG + ring], round_m - x[ROUND + ring]
        if x[SLIDES + ring]:
            x[SLIDES + ring] = each_n_m * math.hypot(stretch_m, twist_m) >= most_n * (1.0 - 1e-12)
        if not x[SLIDES + ring]:
            pull_n = each_n_m * (stretch_m + RELAX_S * along_m_s)
            turn_n = each_n_m * (twist_m + RELAX_S * round_m_s)
            if math.hypot(pull_n, turn_n) <= STATIC * most_n:
                along_n += pull_n
                round_n += turn_n
                nearest_m = 0.0
                continue
            x[SLIDES + ring] = 1.0
        size_m = math.hypot(stretch_m, twist_m)
        share = most_n / (each_n_m * size_m) if size_m > 0.0 else 0.0
        x[ALONG + ring] += (1.0 - share) * stretch_m
        x[ROUND + ring] += (1.0 - share) * twist_m
        nearest_m = min(nearest_m, abs(1.0 - share) * size_m)
        along_n += each_n_m * share * stretch_m
        round_n += each_n_m * share * twist_m
    if force_n > 0.0:
        x[SLID] += nearest_m
    return along_n, round_n


@compiled()
def accelerations(thing: Held, mass_kg: float, along_n: float, round_n: float) -> tuple[float, float]:
    """Of the height and of the turn, m/s^2: two coordinates, coupled where the centre of mass is beside the axis."""
    arm = thing.lever_m / TURN_M
    turn_kg = mass_kg * (thing.gyration_m**2 + thing.lever_m**2) / TURN_M**2
    coupled_kg = mass_kg * arm
    down_n = along_n - mass_kg * GRAVITY_M_S2
    round_n -= coupled_kg * GRAVITY_M_S2
    whole = mass_kg * turn_kg - coupled_kg**2
    return (turn_kg * down_n - coupled_kg * round_n) / whole, (
        mass_kg * round_n - coupled_kg * down_n
    ) / whole


@compiled()
def kick(thing: Held, x: Floats, mass_kg: float, along_n: float, round_n: float, step_s: float) -> None:
    """Change speed and spin for a time; the table holds what does not rise from it."""
    rises_m_s2, turns_m_s2 = accelerations(thing, mass_kg, along_n, round_n)
    stands = x[HEIGHT] <= 0.0 and along_n <= mass_kg * GRAVITY_M_S2
    if stands:
        x[SPEED] = x[SPIN] = 0.0
        return
    x[SPEED] += step_s * rises_m_s2
    x[SPIN] += step_s * turns_m_s2


@compiled()
def carried(thing: Held, x: Floats, tool_m: float, force_n: float, row_s: float, steps: int) -> None:
    """Let a millisecond pass for the object: leapfrog, in steps.

    Args:
        x: State, shape (NUMBERS,); written.
        tool_m: Height of the tool at its end.
        force_n: With which each pad presses then, 0 where one does not touch.
        row_s: A millisecond, s.
        steps: Of it.
    """
    step_s = row_s / steps
    before_m, before_n = x[TOOL_BEFORE], x[FORCE_BEFORE]
    tool_m_s = (tool_m - before_m) / row_s
    rises_m_s2 = (tool_m_s - x[TOOL_SPEED]) / row_s
    x[TOOL_BEFORE], x[FORCE_BEFORE], x[TOOL_SPEED] = tool_m, force_n, tool_m_s
    if x[AIR_S] > 0.0 or (tool_m >= thing.up_m and force_n > 0.0):
        x[AIR_S] += row_s
    hung = thing.added_s <= x[AIR_S] < thing.added_s + thing.added_for_s and x[AIR_S] > 0.0
    mass_kg = thing.mass_kg * (1.0 + thing.added) if hung else thing.mass_kg
    tap_n = 0.0
    if x[AIR_S] > 0.0 and thing.tap_s <= x[AIR_S] < thing.tap_s + thing.tap_for_s:
        tap_n = thing.tap_n * math.sin(math.pi * (x[AIR_S] - thing.tap_s) / thing.tap_for_s)
    along_n, round_n = x[LOAD], x[TORQUE]
    for step in range(1, steps + 1):
        kick(thing, x, mass_kg, along_n + tap_n, round_n, 0.5 * step_s)
        x[HEIGHT] += step_s * x[SPEED]
        x[TURNED] += step_s * x[SPIN]
        if x[HEIGHT] <= 0.0:
            x[HEIGHT] = 0.0
            x[SPEED] = max(x[SPEED], 0.0)
        part = step / steps
        pressed_n = before_n + part * (force_n - before_n)
        along_n, round_n = pulled(thing, x, pressed_n, before_m + part * (tool_m - before_m), tool_m_s)
        kick(thing, x, mass_kg, along_n + tap_n, round_n, 0.5 * step_s)
    size_n = math.hypot(along_n, round_n)
    x[LOAD], x[TORQUE] = along_n, round_n
    x[SHARE] = abs(along_n) / size_n if size_n > 0.0 else 1.0
    if x[HEIGHT] > 0.0:
        size_n = mass_kg * max(GRAVITY_M_S2 + rises_m_s2, 0.0) * math.hypot(1.0, thing.lever_m / TURN_M)
    x[LEAST] = size_n / (2.0 * thing.friction)


@compiled()
def resting(x: Floats) -> bool:
    """Whether it stands on the table and no pad touches it."""
    still: bool = x[HEIGHT] == 0.0 and x[SPEED] == 0.0 and x[FORCE_BEFORE] == 0.0
    return still
