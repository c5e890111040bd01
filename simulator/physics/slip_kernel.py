"""The fingertip on its table, sample by sample: friction that sticks and slips, bumps, rolling noise, read-out.
Compiled.

The equations are those of docs/explanation/slip.md, numbers in brackets refer to it. Between two events (breaking
away, standing still, the next patch of the table) everything is linear: the pieces are solved exactly by
`piecewise`.
"""

import math
from typing import NamedTuple

import numpy as np

from drivers.core.compiled import compiled
from drivers.core.messages import Floats, Ints
from simulator.physics.noise import normal, philox
from simulator.physics.piecewise import DEGREE, SPAN, degree_for, parts_for, rising

STATES = 9
Q, P, Z, TRAVEL, ROLL_1, ROLL_2, LOAD, LOAD_FROM, LOAD_TO = range(STATES)
"""Places in the state: deflection of the tip against the arm (m), its speed over the table (m/s), deflection of the
contact (m), place of the contact on the table (m), rolling force before and after its second pole (N), present
force of the load steps (N), and the forces between which it goes (N)."""

FLAGS = 4
MODE, SIGN, PATCH, LOAD_SINCE = range(FLAGS)
"""Places in the flags: mode, sign of the sliding, number of the patch of the table, sample of the last load step."""

FREE, STUCK, SLIDING = range(3)
"""Modes: no contact; the contact holds and loads up; it slides at constant friction."""

STREAM_TABLE, STREAM_ROLLING, STREAM_BUMPS, STREAM_LOADS, STREAM_BRIDGE = range(5)
"""Streams of noise. The bridges take as many as there are channels, from the last on."""

DONE, ENDLESS, NOT_FINITE = range(3)
"""Why `advance` came back."""

PATIENCE = 1000
"""Pieces within one sample after which the kernel gives up: sliding at its worst makes about ten."""

LEAST_FRICTION = 0.2
"""The friction of a patch is never less than this share of the mean: a normal deviate has no lower end."""

_WORD = 2.0**-32
"""A 32-bit word to a number below 1."""


class Tip(NamedTuple):
    """The constants of the scene, SI units; symbols of docs/explanation/slip.md."""

    sample_s: float
    mass: float
    spring: float
    damper: float
    contact: float
    radius_rad_s: float
    stuck_rad_s: float
    normal_n_m: float
    friction: float
    static_excess: float
    roughness: float
    patch: float
    rolling_n: float
    rolling_keep: float
    bump_chance: float
    bump_n: float
    load_chance: float
    load_low_n: float
    load_high_n: float
    load_samples: int
    bounces: int
    bounce_samples: float
    bounce_ratio: float
    tremor_n: float
    tremor_rad: Floats
    stuck_step: Floats
    stuck_drive: Floats
    free_step: Floats
    free_drive: Floats
    seed: int
    trial: int


@compiled()
def _patch_friction(tip: Tip, patch: int) -> float:
    """Coefficient of kinetic friction of a patch of the table (5)."""
    deviate = normal(tip.seed, tip.trial, STREAM_TABLE, patch)
    return tip.friction * max(LEAST_FRICTION, 1.0 + tip.roughness * deviate)


@compiled()
def _uniforms(tip: Tip, stream: int, index: int) -> tuple[float, float]:
    """Two numbers in (0, 1] for a sample of a stream."""
    low = np.uint64(0xFFFFFFFF)
    seed, number = np.uint64(tip.seed), np.uint64(index)
    w0, w1, _, _ = philox(
        number & low,
        number >> np.uint64(32),
        np.uint64(stream),
        seed >> np.uint64(32),
        seed & low,
        np.uint64(tip.trial),
    )
    return (np.float64(w0) + 1.0) * _WORD, (np.float64(w1) + 1.0) * _WORD


class Electronics(NamedTuple):
    """What an amplifier adds to a force; times in samples.

    Attributes:
        noise: Standard deviation of one sample, output units.
        step: Of the converter, output units; 0 for none.
        tails: Heaviness of the noise's tails; 1 is normal.
        change: Sample from which the noise is another and hum is on.
        factor: Multiplies the noise from then on.
        hum: Amplitude of each sine of the hum, output units.
        hum_rad: Their phase from sample to sample, shape (sines,).
    """

    noise: float
    step: float
    tails: float
    change: int
    factor: float
    hum: float
    hum_rad: Floats


@compiled()
def _sines(rad: Floats, index: int) -> float:
    """Sum of sines of amplitude 1, each with a phase of its own."""
    total = 0.0
    for k in range(rad.size):
        total += math.sin(rad[k] * index + k)
    return total


@compiled()
def _bump(tip: Tip, index: int) -> float:
    """Push of a bump that begins with sample `index`, N; 0 for none."""
    chance, size = _uniforms(tip, STREAM_BUMPS, index)
    if chance > 2.0 * tip.bump_chance:
        return 0.0
    # the lower half of the chances pushes one way, the upper half the other: one draw for both
    bump = -tip.bump_n * math.log(size)
    return bump if chance <= tip.bump_chance else -bump


@compiled()
def _outer_force(tip: Tip, x: Floats, flags: Ints, index: int, moving: bool, loaded: bool) -> float:
    """Force on the tip during sample `index`, N: rolling (6), bumps (7), load steps (8), tremor."""
    force = 0.0
    if tip.rolling_n > 0.0:
        push = tip.rolling_n * normal(tip.seed, tip.trial, STREAM_ROLLING, index) if moving else 0.0
        x[ROLL_1] = tip.rolling_keep * x[ROLL_1] + (1.0 - tip.rolling_keep) * push
        x[ROLL_2] = tip.rolling_keep * x[ROLL_2] + (1.0 - tip.rolling_keep) * x[ROLL_1]
        force += x[ROLL_2]
    if tip.bump_chance > 0.0:
        force += _bump(tip, index)
        since, left = 0.0, 1.0
        for _ in range(tip.bounces):
            since += left * tip.bounce_samples
            left *= tip.bounce_ratio
            if index >= since:
                force += left * _bump(tip, index - round(since))
    if loaded and tip.tremor_n > 0.0:
        force += tip.tremor_n * _sines(tip.tremor_rad, index)
    if tip.load_chance > 0.0:
        chance, size = _uniforms(tip, STREAM_LOADS, index)
        if chance <= tip.load_chance:
            flags[LOAD_SINCE] = index
            x[LOAD_FROM] = x[LOAD]
            x[LOAD_TO] = (
                0.0 if x[LOAD_TO] > 0.0 else tip.load_low_n + size * (tip.load_high_n - tip.load_low_n)
            )
        done = min(1.0, (index - flags[LOAD_SINCE] + 1) / tip.load_samples)
        x[LOAD] = x[LOAD_FROM] + done * (x[LOAD_TO] - x[LOAD_FROM])
        force += x[LOAD]
    return force


@compiled()
def _linear_sample(step: Floats, drive: Floats, x: Floats, arm_m_s: float, push: float) -> None:
    """One whole sample without an event: the exact recursion for held inputs."""
    q, p, z = x[Q], x[P], x[Z]
    for row in range(3):
        x[row] = (
            step[row, 0] * q
            + step[row, 1] * p
            + step[row, 2] * z
            - drive[row, 0] * arm_m_s
            + drive[row, 1] * push
        )


@compiled()
def _surely_holds(tip: Tip, x: Floats, arm_m_s: float, push: float, limit_m: float) -> bool:
    """Whether the contact cannot break away within a sample: a bound, not an estimate.

    While it holds, the tip's speed swings about `steady`; what damping takes away only helps.
    """
    steady = tip.spring * arm_m_s / (tip.spring + tip.contact)
    a = push - (tip.spring * x[Q] + tip.damper * x[P] + tip.contact * x[Z]) / tip.mass
    swing = abs(x[P] - steady) + abs(a) / tip.stuck_rad_s
    reached_m: float = abs(x[Z]) + tip.sample_s * (abs(steady) + 2.0 * swing)
    return reached_m < limit_m


@compiled()
def _jump(tip: Tip, x: Floats, flags: Ints, z: float) -> None:
    """Lets the contact's deflection jump to `z`: its place advances by as much, maybe into another patch.

    A place on an edge belongs to the patch ahead; the edges are products, never quotients, so that a place that was
    set to an edge stays on it.
    """
    x[TRAVEL] += x[Z] - z
    x[Z] = z
    sign = flags[SIGN]
    flags[PATCH] = math.floor(x[TRAVEL] / tip.patch)  # near enough for the edges to decide
    while sign * x[TRAVEL] >= sign * tip.patch * (flags[PATCH] + (1 if sign > 0 else 0)):
        flags[PATCH] += sign
    while sign * x[TRAVEL] < sign * tip.patch * (flags[PATCH] + (0 if sign > 0 else 1)):
        flags[PATCH] -= sign


@compiled()
def _land(tip: Tip, x: Floats, flags: Ints, z: float, load_n: float) -> None:
    """A jump, after which the patch may hold: then the contact is stuck."""
    _jump(tip, x, flags, z)
    if abs(z) * tip.contact < _patch_friction(tip, flags[PATCH]) * load_n * (1.0 - 1e-12):
        flags[MODE] = STUCK


@compiled()
def _frictional_sample(tip: Tip, x: Floats, flags: Ints, arm_m_s: float, push: float, load_n: float) -> int:
    """One sample in contact, piece by piece."""
    terms = np.empty((3, DEGREE + 1))
    left_s = tip.sample_s
    friction_n = _patch_friction(tip, flags[PATCH]) * load_n
    for _ in range(PATIENCE):
        length_s = min(left_s, SPAN / tip.radius_rad_s)
        sliding = flags[MODE] == SLIDING
        degree = degree_for(length_s * tip.radius_rad_s)
        parts = parts_for(length_s * tip.radius_rad_s)
        _expand(tip, x, arm_m_s, push, sliding, length_s, degree, terms)
        if sliding:
            sign = float(flags[SIGN])
            edge = tip.patch * (flags[PATCH] + (1 if sign > 0.0 else 0))
            stands = rising(terms[1], degree, parts, -sign, 0.0)
            event = min(stands, rising(terms[2], degree, parts, sign, sign * (edge - x[TRAVEL])))
        else:
            stands = math.inf
            limit_m = (1.0 + tip.static_excess) * friction_n / tip.contact
            forward = rising(terms[2], degree, parts, 1.0, limit_m - x[Z])
            event = min(forward, rising(terms[2], degree, parts, -1.0, limit_m + x[Z]))
        u = min(event, 1.0)
        moved_m = _value(terms[2], degree, u)
        x[Q], x[P] = _value(terms[0], degree, u), _value(terms[1], degree, u)
        if sliding:
            x[TRAVEL] += moved_m
        else:
            x[Z] += moved_m
        left_s -= u * length_s
        if event > 1.0:
            if left_s <= 0.0:
                return DONE
            continue
        if not sliding:
            flags[MODE] = SLIDING
            flags[SIGN] = 1 if event == forward else -1
            _land(tip, x, flags, flags[SIGN] * friction_n / tip.contact, load_n)
        elif event == stands:
            x[P] = 0.0
            flags[MODE] = STUCK
        else:
            x[TRAVEL] = edge
            flags[PATCH] += flags[SIGN]
            friction_n = _patch_friction(tip, flags[PATCH]) * load_n
            if friction_n > tip.contact * abs(x[Z]):
                flags[MODE] = STUCK
            else:
                _land(tip, x, flags, flags[SIGN] * friction_n / tip.contact, load_n)
        friction_n = _patch_friction(tip, flags[PATCH]) * load_n
    return ENDLESS


@compiled()
def _expand(
    tip: Tip,
    x: Floats,
    arm_m_s: float,
    push: float,
    sliding: bool,
    length_s: float,
    degree: int,
    terms: Floats,
) -> None:
    """Series of deflection, speed and way of the tip (1), (2), in fractions of the piece."""
    terms[0, 0], terms[1, 0], terms[2, 0] = x[Q], x[P], 0.0
    for k in range(degree):
        scale = length_s / (k + 1)
        contact = x[Z] if k == 0 else 0.0
        if not sliding:
            contact += terms[2, k]
        pull = tip.spring * terms[0, k] + tip.damper * terms[1, k] + tip.contact * contact
        terms[0, k + 1] = scale * (terms[1, k] - (arm_m_s if k == 0 else 0.0))
        terms[1, k + 1] = scale * ((push if k == 0 else 0.0) - pull / tip.mass)
        terms[2, k + 1] = scale * terms[1, k]


@compiled()
def _value(terms: Floats, degree: int, u: float) -> float:
    """A polynomial at `u` (Horner)."""
    total = float(terms[degree])
    for k in range(degree - 1, -1, -1):
        total = total * u + terms[k]
    return total


@compiled()
def _rests(x: Floats) -> bool:
    """Whether the tip stands exactly still, and no rolling force is left."""
    rests: bool = x[Q] == 0.0 and x[P] == 0.0 and x[Z] == 0.0 and x[ROLL_1] == 0.0 and x[ROLL_2] == 0.0
    return rests


@compiled()
def advance(
    tip: Tip,
    x: Floats,
    flags: Ints,
    first: int,
    tracks: Floats,
    tangential_n: Floats,
    normal_n: Floats,
    slid_m: Floats,
) -> int:
    """Lets n samples pass and writes what the sensor's spring feels at the end of each.

    Args:
        x: State, shape (STATES,), advanced.
        flags: Shape (FLAGS,), advanced.
        first: Number of the first sample.
        tracks: Place of the arm along the table at the n + 1 sample instants (in between its speed is constant), how
        far it presses (0 at first touch), and its angle, shape (3, n + 1).
        tangential_n: Written: force in the tangential spring, positive where the arm drags the tip forward, shape
        (n,).
        normal_n: Written: normal force, shape (n,).
        slid_m: Written: place of the contact on the table, shape (n,).

    Returns:
        DONE, ENDLESS or NOT_FINITE.
    """
    arm_m, press_m, roll_rad = tracks[0], tracks[1], tracks[2]
    at_peace = tip.bump_chance <= 0.0 and tip.load_chance <= 0.0
    for i in range(tangential_n.size):
        arm_m_s = (arm_m[i + 1] - arm_m[i]) / tip.sample_s
        load_n = tip.normal_n_m * max(0.0, press_m[i + 1])
        if at_peace and load_n == 0.0 and arm_m_s == 0.0 and _rests(x):
            # in the air nothing shakes it: it stays as it is
            flags[MODE] = FREE
            tangential_n[i], normal_n[i], slid_m[i] = -tip.spring * x[Q], load_n, x[TRAVEL]
            continue
        moving = arm_m[i + 1] != arm_m[i] or press_m[i + 1] != press_m[i] or roll_rad[i + 1] != roll_rad[i]
        force = _outer_force(tip, x, flags, first + i, moving and load_n > 0.0, load_n > 0.0)
        push = (force + tip.damper * arm_m_s) / tip.mass
        if load_n == 0.0:
            flags[MODE] = FREE
            x[Z] = 0.0
            _linear_sample(tip.free_step, tip.free_drive, x, arm_m_s, push)
        else:
            if flags[MODE] == FREE:
                flags[MODE] = STUCK
                x[TRAVEL] = arm_m[i] + x[Q]
                flags[PATCH] = math.floor(x[TRAVEL] / tip.patch)
            friction_n = _patch_friction(tip, flags[PATCH]) * load_n if flags[MODE] == SLIDING else 0.0
            if flags[MODE] == SLIDING and abs(x[Z]) * tip.contact != friction_n:
                # the normal force has changed: so has the friction
                _jump(tip, x, flags, flags[SIGN] * friction_n / tip.contact)
            limit_m = LEAST_FRICTION * tip.friction * load_n / tip.contact
            if flags[MODE] == STUCK and not _surely_holds(tip, x, arm_m_s, push, limit_m):
                limit_m = (
                    (1.0 + tip.static_excess) * _patch_friction(tip, flags[PATCH]) * load_n / tip.contact
                )
            if flags[MODE] == STUCK and _surely_holds(tip, x, arm_m_s, push, limit_m):
                _linear_sample(tip.stuck_step, tip.stuck_drive, x, arm_m_s, push)
            else:
                status = _frictional_sample(tip, x, flags, arm_m_s, push, load_n)
                if status != DONE:
                    return status
        if not math.isfinite(x[P]):
            return NOT_FINITE
        tangential_n[i] = -tip.spring * x[Q]
        normal_n[i] = load_n
        slid_m[i] = x[TRAVEL]
    return DONE


@compiled()
def strain_bridge(
    force_n: Floats, gain: float, play_n: float, play_share: float, play: Floats, out: Floats
) -> None:
    """What a bridge puts out under a force: hysteresis (9) and gain.

    Args:
        force_n: Shape (n,).
        gain: Output units per newton.
        play_n: Half the width of the play, N.
        play_share: Share of the force that passes through the play.
        play: State of the play, shape (1,), advanced.
        out: Written, shape (n,).
    """
    held = play[0]
    for i in range(force_n.size):
        held = min(max(held, force_n[i] - play_n), force_n[i] + play_n)
        out[i] = gain * (force_n[i] + play_share * (held - force_n[i]))
    play[0] = held


@compiled()
def amplify(
    values: Floats, numbers: Ints, e: Electronics, key: tuple[int, int], stream: int, out: Floats
) -> None:
    """What an amplifier shows of what a bridge puts out: noise, hum, steps of the converter.

    Args:
        values: Shape (n,).
        numbers: Of the samples, shape (n,).
        key: Seed of the run and number of the trial.
        out: Written, shape (n,).
    """
    for i in range(values.size):
        value = values[i]
        changed = numbers[i] >= e.change
        if e.noise > 0.0:
            deviate = normal(key[0], key[1], stream, numbers[i])
            if e.tails > 1.0:
                deviate = math.sinh(e.tails * math.asinh(deviate)) / math.sinh(e.tails * math.asinh(1.0))
            value += (e.noise * e.factor if changed else e.noise) * deviate
        if changed and e.hum > 0.0:
            value += e.hum * _sines(e.hum_rad, numbers[i])
        out[i] = round(value / e.step) * e.step if e.step > 0.0 else value
