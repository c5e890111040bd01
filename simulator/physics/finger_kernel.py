"""The finger's pieces: their series, what ends them, what follows. Compiled.

Numbers in brackets are those of the equations in docs/explanation/finger_physics.md.
"""

import math

import numpy as np

from drivers.core.compiled import compiled
from drivers.core.messages import Floats, Ints
from simulator.physics.finger_scene import (
    BASE,
    BASE_RATE,
    CLIPPED,
    COMPARATOR,
    COMPARATOR_DOWN,
    COMPARATOR_UP,
    CONTROL,
    DISTAL,
    DRIVE_DOWN,
    DRIVE_UP,
    EXCITED,
    FILTERED,
    FREE,
    HIGH_1,
    HIGH_2,
    LOST,
    MADE,
    MODE,
    NOISE_HZ,
    OMEGA,
    OSCILLATOR,
    PHASE,
    PIECE,
    SLEEVE,
    SLIDING,
    STATES,
    THETA,
    TOUCHING,
    WANDER_EVERY,
    Books,
    FingerConstants,
    Moment,
    ProbePlan,
)
from simulator.physics.noise import normal
from simulator.physics.piecewise import DEGREE, SPAN, degree_for, parts_for, rising, value_slope

GUARDS = 6
DEPTH, SPEED, PUSH, COMPARED, TURNED, STRETCHED = range(GUARDS)
"""What can end a piece: overlap, its rate, spring and damper without the clip, output of the high-pass, phase, the
tendon's stretch in its sheath or, while it slides there, the base's rate."""

STREAM_ACCELEROMETER, STREAM_WANDER, STREAM_LOAD_CELL, STREAM_DISTAL = range(4)
"""Streams of the noise."""

ACCELEROMETER, FORCE, ALL_SWITCHES, SECOND = 1, 2, 4, 8
"""Bits of what a run is wanted to write down."""

DONE, SWITCHES_FULL, RECORDS_FULL, ENDLESS, NOT_FINITE = range(5)
"""Why `run` came back."""

_FAR = 10.0
"""An oscillator's edge more than this many pieces away is ignored."""


@compiled()
def _wander(finger: FingerConstants, moment: Moment, step: int) -> float:
    """The joint's relative wander at a step: a stationary Ornstein-Uhlenbeck process, from its innovations alone.

    What came more than 40 correlation times earlier weighs less than 1e-17, so that a run may begin anywhere.
    """
    keep = finger.wander_keep
    if moment.wander_step[0] < 0 or moment.wander_step[0] > step:
        moment.wander[0] = 0.0
        moment.wander_step[0] = step - 1 - (math.ceil(-40.0 / math.log(keep)) if keep > 0.0 else 0)
    while moment.wander_step[0] < step:
        moment.wander_step[0] += 1
        innovation = normal(finger.seed, finger.trial, STREAM_WANDER, moment.wander_step[0])
        moment.wander[0] = keep * moment.wander[0] + innovation
    return finger.wander * math.sqrt(1.0 - keep * keep) * float(moment.wander[0])


@compiled()
def probe_at(
    motion: ProbePlan, piece: int, whole: int, fraction: float, rest: float
) -> tuple[float, float, float]:
    """Position, velocity and acceleration of the probe."""
    elapsed = (whole - motion.whole[piece]) + (fraction - motion.fraction[piece]) + rest
    acceleration = motion.acceleration[piece]
    velocity = motion.velocity[piece]
    position = motion.position[piece] + elapsed * (velocity + 0.5 * acceleration * elapsed)
    return position, velocity + acceleration * elapsed, acceleration


@compiled()
def _expand(
    finger: FingerConstants,
    joint: float,
    noise: tuple[float, float],
    probe: tuple[float, float, float],
    depth: float,
    flags: Ints,
    seconds: float,
    length: float,
    degree: int,
    x: Floats,
    series: Floats,
    guards: Floats,
) -> None:
    """Terms of the states and of what can end the piece: equations (1) to (9), order by order.

    Args:
        joint: K, with the present wander.
        noise: n of either accelerometer, held in this piece.
        probe: Position, velocity and acceleration at its start.
        depth: Overlap there.
        seconds: Time at its start, which ripple and vibration are at.
        length: Of the piece in seconds.
        degree: Highest order wanted.
        x: State at its start.
        series: Written, shape (DEGREE + 1, STATES).
        guards: Written, shape (GUARDS, DEGREE + 1).
    """
    theta, omega, b, beta = x[THETA], x[OMEGA], x[BASE], x[BASE_RATE]
    a, g1, g2, v, phi = x[FILTERED], x[HIGH_1], x[HIGH_2], x[CONTROL], x[PHASE]
    z, a2, signal, signal_2 = x[SLEEVE], x[DISTAL], noise[0], noise[1]
    for state in range(STATES):  # an assignment in one would check shapes, which takes 2 s to compile
        series[0, state] = x[state]
    # (1) and (2), gathered by state: fewer operations wait for one another. Spring and damper act through the overlap
    # and its rate: theta is a million times an overlap in stiff contact, and its rounding would be force.
    moving = probe[1] != 0.0 or probe[2] != 0.0
    push_arm = push_base = 0.0
    if flags[MODE] == TOUCHING:
        push_arm, push_base = finger.push_arm if moving else finger.arm, finger.base_arm
    k_theta = -joint / finger.inertia
    c_omega = -(finger.joint_damping + push_arm * finger.contact_damping * finger.arm) / finger.inertia
    k_b, c_beta = joint / finger.inertia, finger.joint_damping / finger.inertia
    base_k_theta, base_c_omega = joint / finger.base_inertia, finger.joint_damping / finger.base_inertia
    base_k_b = -(joint + finger.base) / finger.base_inertia
    base_c_beta = -(finger.joint_damping + finger.base_damping) / finger.base_inertia
    base_c_beta -= push_base * finger.contact_damping * finger.base_arm / finger.base_inertia
    base_push = push_base / finger.base_inertia
    base_depth, base_kick = base_push * finger.contact, base_push * finger.contact_damping * probe[1]
    base_kick_1 = base_push * finger.contact_damping * probe[2] * length
    base_z = -finger.sleeve / finger.base_inertia
    gripped = 1.0 if flags[SLIDING] == 0 else 0.0
    inverse_quality = 1.0 / finger.quality
    # what comes from outside: terms 0 and 1 of the probe's velocity, and of the angular acceleration
    speed, speed_1 = probe[1], probe[2] * length
    drive = 0.0
    if flags[EXCITED]:
        drive = finger.drive if flags[OSCILLATOR] else -finger.drive
    push_lever = push_arm / finger.inertia
    k_depth = push_lever * finger.contact
    kick = drive / finger.inertia + push_lever * finger.contact_damping * speed
    kick_1 = push_lever * finger.contact_damping * speed_1
    # ripple and vibration: a sine and a cosine each, order by order
    ripple, shake = finger.ripple * drive / finger.inertia, finger.vibration if moving else 0.0
    r_sin, r_cos = math.sin(finger.ripple_rad_s * seconds), math.cos(finger.ripple_rad_s * seconds)
    s_sin, s_cos = math.sin(finger.vibration_rad_s * seconds), math.cos(finger.vibration_rad_s * seconds)
    detected = float(flags[COMPARATOR] ^ flags[OSCILLATOR])
    lowest = finger.lowest_hz
    for k in range(degree + 1):
        compared = a - inverse_quality * g1 - g2
        depth_rate = speed - finger.arm * omega - finger.base_arm * beta
        guards[DEPTH, k] = depth
        guards[SPEED, k] = depth_rate
        guards[COMPARED, k] = compared
        guards[TURNED, k] = phi
        guards[STRETCHED, k] = z if flags[SLIDING] == 0 else beta
        if k == degree:
            break
        omega_rate = (k_depth * depth + kick + k_theta * theta + k_b * b) + (c_omega * omega + c_beta * beta)
        beta_rate = (base_k_theta * theta + base_k_b * b) + (base_c_omega * omega + base_c_beta * beta)
        beta_rate += (base_depth * depth + base_kick) + base_z * z
        shaken = shake * s_sin
        omega_rate += ripple * r_sin - finger.shaken_1_m * shaken
        beta_rate -= finger.shaken_1_m * shaken
        step = length / (k + 1)
        theta, b, depth = step * omega, step * beta, step * depth_rate
        z = step * gripped * beta
        omega, beta = step * omega_rate, step * beta_rate
        a = step * finger.filter_rad_s * (signal - shaken - finger.lever * beta_rate - a)
        a2 = step * finger.filter_rad_s * (signal_2 - shaken - finger.distal_lever * omega_rate - a2)
        r_sin, r_cos = step * finger.ripple_rad_s * r_cos, -step * finger.ripple_rad_s * r_sin
        s_sin, s_cos = step * finger.vibration_rad_s * s_cos, -step * finger.vibration_rad_s * s_sin
        g2 = step * finger.high_rad_s * g1
        g1 = step * finger.high_rad_s * compared
        phi = step * (lowest + finger.range_hz * v)
        v = step * finger.control_rad_s * (detected - v)
        series[k + 1, THETA] = theta
        series[k + 1, OMEGA] = omega
        series[k + 1, BASE] = b
        series[k + 1, BASE_RATE] = beta
        series[k + 1, FILTERED] = a
        series[k + 1, HIGH_1] = g1
        series[k + 1, HIGH_2] = g2
        series[k + 1, CONTROL] = v
        series[k + 1, PHASE] = phi
        series[k + 1, SLEEVE] = z
        series[k + 1, DISTAL] = a2
        signal = signal_2 = detected = lowest = 0.0
        kick, kick_1 = kick_1, 0.0
        base_kick, base_kick_1 = base_kick_1, 0.0
        speed, speed_1 = speed_1, 0.0
    # (3)
    for k in range(degree + 1):
        guards[PUSH, k] = finger.contact * guards[DEPTH, k] + finger.contact_damping * guards[SPEED, k]


@compiled()
def _state(series: Floats, degree: int, u: float, x: Floats) -> None:
    """The state at `u`, written to `x`. One name for each state: a loop over them would pass through memory."""
    theta = omega = b = beta = a = g1 = g2 = v = phi = z = a2 = 0.0
    for k in range(degree, -1, -1):
        theta = theta * u + series[k, THETA]
        omega = omega * u + series[k, OMEGA]
        b = b * u + series[k, BASE]
        beta = beta * u + series[k, BASE_RATE]
        a = a * u + series[k, FILTERED]
        g1 = g1 * u + series[k, HIGH_1]
        g2 = g2 * u + series[k, HIGH_2]
        v = v * u + series[k, CONTROL]
        phi = phi * u + series[k, PHASE]
        z = z * u + series[k, SLEEVE]
        a2 = a2 * u + series[k, DISTAL]
    x[THETA] = theta
    x[OMEGA] = omega
    x[BASE] = b
    x[BASE_RATE] = beta
    x[FILTERED] = a
    x[HIGH_1] = g1
    x[HIGH_2] = g2
    x[CONTROL] = v
    x[PHASE] = phi
    x[SLEEVE] = z
    x[DISTAL] = a2


# The helpers of `run` are passed arrays and numbers, not the tuples that hold them: a tuple is passed field by field,
# and that costs more than the work.


@compiled()
def _to_corner(
    starts: Ints, fractions: Floats, flags: Ints, whole: int, fraction: float, rest: float
) -> float:
    """Seconds to the next corner of the probe's plan, or infinity; corners that have passed are left behind."""
    while flags[PIECE] + 1 < starts.size:
        following = flags[PIECE] + 1
        ahead = (starts[following] - whole) + (fractions[following] - fraction) - rest
        if ahead > 0.0:
            return float(ahead)
        flags[PIECE] = following
    return math.inf


@compiled()
def _next_mode(mode: int, damped: bool, guards: Floats, degree: int, parts: int) -> tuple[float, int]:
    """When the present mode ends, as a fraction of the piece, and the mode that follows."""
    if mode == FREE:
        return rising(guards[DEPTH], degree, parts, 1.0, 0.0), TOUCHING
    if mode == TOUCHING:
        # without a damper the force ends where the overlap does
        return rising(guards[PUSH], degree, parts, -1.0, 0.0), (CLIPPED if damped else FREE)
    apart = rising(guards[DEPTH], degree, parts, -1.0, 0.0)
    pressed = rising(guards[PUSH], degree, parts, 1.0, 0.0)
    return (apart, FREE) if apart <= pressed else (pressed, TOUCHING)


@compiled()
def _after_corner(mode: int, depth: float, push: float) -> int:
    """The mode that (4) requires where the probe's velocity may have jumped; the overlap cannot jump."""
    if mode == TOUCHING and push < 0.0:
        return CLIPPED if depth > 0.0 else FREE
    if mode == CLIPPED and push > 0.0 and depth > 0.0:
        return TOUCHING
    return mode


@compiled()
def _gives(
    sliding: int, stretched: Floats, friction_rad: float, degree: int, parts: int
) -> tuple[float, int]:
    """When the tendon begins to slide in its sheath or ceases to, and which way it slides then: a Jenkins element."""
    if sliding != 0:
        return rising(stretched, degree, parts, -1.0 * sliding, 0.0), 0
    forward = rising(stretched, degree, parts, 1.0, friction_rad)
    back = rising(stretched, degree, parts, -1.0, friction_rad)
    return (forward, 1) if forward <= back else (back, -1)


@compiled()
def _first_end(
    flags: Ints, damped: bool, hysteresis: float, friction_rad: float, guards: Floats, degree: int, parts: int
) -> tuple[float, int, int]:
    """What ends the piece: when, as a fraction of its length; which flag changes, `PIECE` for none; the next mode."""
    end, next_mode = _next_mode(flags[MODE], damped, guards, degree, parts)
    cause = MODE
    compared = rising(guards[COMPARED], degree, parts, -1.0 if flags[COMPARATOR] else 1.0, hysteresis)
    if compared < end:
        end, cause = compared, COMPARATOR
    # one part, and not the constant 1, for which numba would compile the search once more
    turned = rising(guards[TURNED], degree, min(parts, 1), 1.0, 0.5)
    if turned < end:
        end, cause = turned, OSCILLATOR
    if friction_rad > 0.0:
        given, sliding = _gives(flags[SLIDING], guards[STRETCHED], friction_rad, degree, parts)
        if given < end:
            end, cause, next_mode = given, SLIDING, sliding
    return (end, cause, next_mode) if end <= 1.0 else (1.0, PIECE, next_mode)


@compiled()
def _go_on(whole: Ints, fraction: Floats, seconds: float, grid: float) -> None:
    """Put the clock forward, in double-double, or to an instant of the noise's grid: rounding does not pile up."""
    if grid >= 0.0:
        fraction[0], fraction[1] = grid, 0.0
    else:
        total = fraction[0] + seconds
        shift = total - fraction[0]
        rest = fraction[1] + ((fraction[0] - (total - shift)) + (seconds - shift))
        fraction[0] = total + rest
        fraction[1] = rest - (fraction[0] - total)
    if fraction[0] >= 1.0:
        whole[0] += 1
        fraction[0] -= 1.0


@compiled()
def _change(x: Floats, flags: Ints, cause: int, next_mode: int) -> int:
    """Do what the end of a piece requires; the switch that this was, or -1."""
    if cause == MODE:
        mode, flags[MODE] = flags[MODE], next_mode
        if next_mode == TOUCHING:
            return MADE
        return LOST if mode == TOUCHING else -1
    if cause == COMPARATOR:
        flags[COMPARATOR] ^= 1
        return COMPARATOR_UP if flags[COMPARATOR] else COMPARATOR_DOWN
    if cause == SLIDING:
        flags[SLIDING] = next_mode
        if next_mode == 0:
            # gripped, it is within its limit: rounding must not make it slide at once
            x[SLEEVE] *= 1.0 - 1e-12
        return -1
    if cause == OSCILLATOR:
        flags[OSCILLATOR] ^= 1
        x[PHASE] = 0.0
        return DRIVE_UP if flags[OSCILLATOR] else DRIVE_DOWN
    return -1


@compiled()
def run(
    finger: FingerConstants,
    motion: ProbePlan,
    moment: Moment,
    until_whole: int,
    until_fraction: float,
    settle: bool,
    wanted: int,
    most: int,
    books: Books,
) -> int:
    """Advance to an instant.

    The moment is that at the start of the piece under way: an instant inside a piece leaves it where it is, so that
    the cuts of the caller leave no trace.

    Args:
        moment: Changed.
        until_whole, until_fraction: The instant, seconds.
        settle: Move the state to the instant itself, for something is about to change there.
        wanted: Sum of `ACCELEROMETER` and `FORCE`, to record them, and `ALL_SWITCHES`, to write down more than contacts
            and rising edges of the drive.
        most: Pieces after which it gives up.
        books: Written.

    Returns:
        `DONE`, or why it stopped before.
    """
    x, flags = moment.x, moment.flags
    series = np.empty((DEGREE + 1, STATES))
    guards = np.empty((GUARDS, DEGREE + 1))
    noisy = finger.noise > 0.0 or finger.wander > 0.0 or finger.drift_1_s != 0.0
    recording = wanted & (ACCELEROMETER | FORCE | SECOND)
    noise, noise_2, joint = 0.0, 0.0, finger.joint
    for _ in range(most):
        whole, fraction, rest = moment.whole[0], moment.fraction[0], moment.fraction[1]
        if books.filled[0] >= books.switch.size:
            return SWITCHES_FULL
        if recording and books.filled[1] >= books.record_whole.size:
            return RECORDS_FULL
        touching = flags[MODE] == TOUCHING
        radius = finger.touching_radius if touching else finger.free_radius
        frequency = finger.touching_frequency if touching else finger.free_frequency
        piece = flags[PIECE]
        length = min(SPAN / radius, _to_corner(motion.whole, motion.fraction, flags, whole, fraction, rest))
        # equal parts up to the oscillator's next edge: no series is longer than it need be
        turn = 1.02 * (0.5 - x[PHASE]) / (finger.lowest_hz + finger.range_hz * x[CONTROL])
        if 0.0 < turn < _FAR * length:
            length = turn / math.ceil(turn / length)
        grid = -1.0
        if noisy:
            tick = int(fraction * NOISE_HZ)
            index = whole * NOISE_HZ + tick
            noise = finger.noise * normal(finger.seed, finger.trial, STREAM_ACCELEROMETER, index)
            if finger.distal_lever > 0.0:
                noise_2 = finger.noise * normal(finger.seed, finger.trial, STREAM_DISTAL, index)
            joint = finger.joint * (1.0 + _wander(finger, moment, index // WANDER_EVERY))
            joint *= 1.0 + finger.drift_1_s * (index / NOISE_HZ)
            ahead = (tick + 1) / NOISE_HZ - fraction - rest
            if ahead <= length:
                length, grid = ahead, (tick + 1) / NOISE_HZ
        degree, parts = degree_for(length * radius), parts_for(length * frequency)
        probe = probe_at(motion, flags[PIECE], whole, fraction, rest)
        corner = flags[PIECE] != piece or math.isnan(moment.depth[0])
        if flags[MODE] == FREE or corner:
            moment.depth[0] = probe[0] - finger.gap - finger.arm * x[THETA] - finger.base_arm * x[BASE]
        seconds = whole + fraction + rest
        _expand(
            finger,
            joint,
            (noise, noise_2),
            probe,
            moment.depth[0],
            flags,
            seconds,
            length,
            degree,
            x,
            series,
            guards,
        )
        if corner:
            # A probe whose velocity jumps takes the damper's force along: (4) decides anew.
            jumped = _after_corner(flags[MODE], guards[DEPTH, 0], guards[PUSH, 0])
            if jumped != flags[MODE]:
                place = books.filled[0]
                books.switch_whole[place], books.switch_fraction[place] = whole, fraction
                books.switch[place] = MADE if jumped == TOUCHING else LOST
                books.filled[0] += 1
                flags[MODE] = jumped
                continue
        damped = finger.contact_damping > 0.0
        end, cause, next_mode = _first_end(
            flags, damped, finger.hysteresis, finger.friction_rad, guards, degree, parts
        )
        elapsed = end * length
        remaining = (until_whole - whole) + (until_fraction - fraction) - rest
        if recording and (elapsed > 0.0 or elapsed > remaining):
            record = books.filled[1]
            books.record_whole[record], books.record_fraction[record] = whole, fraction
            books.record_length[record], books.record_degree[record] = length, degree
            for k in range(degree + 1):
                if wanted & ACCELEROMETER:
                    books.record_terms[record, 0, k] = series[k, FILTERED]
                if wanted & FORCE:
                    books.record_terms[record, 1, k] = guards[PUSH, k] if touching else 0.0
                if wanted & SECOND:
                    books.record_terms[record, 2, k] = series[k, DISTAL]
            books.filled[1] += 1
        if elapsed > remaining:
            if settle:
                _state(series, degree, remaining / length, x)
                moment.depth[0] = value_slope(guards[DEPTH], degree, remaining / length)[0]
                moment.whole[0] = until_whole
                moment.fraction[0], moment.fraction[1] = until_fraction, 0.0
            return DONE
        _state(series, degree, end, x)
        if flags[MODE] != FREE or cause == MODE:
            moment.depth[0] = value_slope(guards[DEPTH], degree, end)[0]
        if not math.isfinite(x[THETA] + x[BASE] + x[FILTERED] + x[PHASE]):
            return NOT_FINITE
        _go_on(moment.whole, moment.fraction, elapsed, grid if cause == PIECE else -1.0)
        switch = _change(x, flags, cause, next_mode)
        if switch >= 0 and (switch <= LOST or switch == DRIVE_UP or wanted & ALL_SWITCHES):
            place = books.filled[0]
            books.switch_whole[place], books.switch_fraction[place] = moment.whole[0], moment.fraction[0]
            books.switch[place] = switch
            books.filled[0] += 1
    return ENDLESS


@compiled()
def read(books: Books, which: int, times: Floats, out: Floats) -> None:
    """Sample recorded pieces at ascending times; an instant between two pieces belongs to the later one.

    Args:
        books: With the records.
        which: 0 for the accelerometer, 1 for the force, 2 for the second accelerometer.
        times: Ascending, shape (n,), seconds.
        out: Written, shape (n,).
    """
    record, count = 0, books.filled[1]
    for i in range(times.size):
        while (
            record + 1 < count
            and _since(times[i], books.record_whole[record + 1], books.record_fraction[record + 1]) >= 0.0
        ):
            record += 1
        elapsed = _since(times[i], books.record_whole[record], books.record_fraction[record])
        terms, degree = books.record_terms[record, which], books.record_degree[record]
        out[i] = value_slope(terms, degree, elapsed / books.record_length[record])[0]


@compiled()
def _since(t: float, whole: int, fraction: float) -> float:
    """Seconds from an instant in whole seconds and a fraction to a time."""
    floor = math.floor(t)
    return (floor - whole) + ((t - floor) - fraction)
