"""Levels: how far a sample is from its own window, and jumps off the circle that an undulation draws. Compiled."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.signals.undulation import BEYOND_FS, FLOOR_FS, median
from drivers.core.compiled import compiled

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]

# --- the paper's: a sample against its own window ------------------------------------------------

SHIFT, SUM, SQUARES = range(3)
"""Places among the scalars of a window: what is subtracted from each sample, sums of the rest and of its squares."""

COUNT, PLACE = range(2)
"""Places among its counts: samples in it, where the next one goes."""


class Window(NamedTuple):
    """The last samples; arrays are advanced in place.

    Attributes:
        ring: Samples, shape (n,).
        scalars: Shape (3,).
        counts: Shape (2,).
    """

    ring: Floats
    scalars: Floats
    counts: Ints


def window(size: int) -> Window:
    """An empty window."""
    return Window(np.zeros(size), np.zeros(3), np.zeros(2, np.int64))


@compiled()
def z_scores(w: Window, y: Floats, missing: Ints, out: Floats) -> None:
    """(y - mean) / std of the last n samples, the newest among them; std with n - 1.

    The sums are relative to the window's mean at the last wrap of the ring, and recomputed there: rounding does not
    accumulate.

    Args:
        w: State, advanced.
        y: Samples, shape (n,); one that is not finite is left out.
        missing: Samples lost just before each, shape (n,): the window restarts there.
        out: Written: NaN until the window is full, and where it does not vary. Shape (n,).
    """
    ring, v, counts = w.ring, w.scalars, w.counts
    n = ring.size
    for i in range(y.size):
        out[i] = math.nan
        if missing[i] != 0:
            counts[COUNT] = counts[PLACE] = 0
        if not abs(y[i]) < BEYOND_FS:
            continue
        old = ring[counts[PLACE]] - v[SHIFT]
        new = y[i] - v[SHIFT]
        ring[counts[PLACE]] = y[i]
        counts[PLACE] += 1
        if counts[COUNT] == n:
            v[SUM] += new - old
            v[SQUARES] += new * new - old * old
        else:
            counts[COUNT] += 1
        if counts[PLACE] == n:
            counts[PLACE] = 0
            v[SHIFT] = ring.sum() / n
            v[SUM] = v[SQUARES] = 0.0
            for j in range(n):
                off = ring[j] - v[SHIFT]
                v[SUM] += off
                v[SQUARES] += off * off
        if counts[COUNT] == n:
            mean = v[SUM] / n
            variance = (v[SQUARES] - n * mean * mean) / (n - 1)
            # below: rounding of a constant window
            if variance > 1e-15 * v[SHIFT] * v[SHIFT]:
                out[i] = (y[i] - v[SHIFT] - mean) / math.sqrt(variance)


# --- ours: jumps, and whether the level stays ----------------------------------------------------


CLIP = 9.0
"""A deviation enters its scale with no more than this many times the scale: outliers do not desensitize it."""

PAST = 4
"""Turns from span to span from which the next one is predicted."""

GROWTH = 1.5
"""An echo grows by no more than this factor from span to span: ten times the growth at 0.03 m/s."""

RADIAL = 0.25
"""Effect of braking on the wave's size, as a share of that on its phase. Assumption: none, but the level at rest, from
which both are measured, may be off by a quarter of the wave."""

STEADY = 0.5
"""The level's rate, had it been the same since the jump, makes no more than this share of the step. Of a wave that goes
on turning it makes all of it or more; of a contact that rises exponentially never more than 0.37."""

NOISY = 3.0
"""Prediction error of white noise, in variances of a span's mean: 1 of the new value, up to 1 of the values before,
half as much again because an arm's noise is not quite white. Assumption."""

SURE = 6.0
"""A change of level is so many times the standard deviation that the shortest span's mean has in white noise like
that in which the level stays: the level before the jump is known no better."""

STILL_M = 5e-5
"""A mover that goes less far while the longest span passes stands still, one that goes twice as far moves. Assumption:
several times an encoder's noise."""

ENCODER_M = 3e-5
"""How far from the truth a displacement is that an encoder says. Assumption: an arm's."""

BACK = 0.5
"""Contact is over when this share of the step has gone back."""

WANDER = 0.3
"""The contact's own level follows slow changes by no more than this share of the step, so that a slow release is still
detected."""

NOTHING, BEGAN, HELD, ENDED = range(4)
"""Changes at a sample."""

FILLED, SINCE, SEEN_BAD, RETURNING, LASTED, FRESH, AGE, MOVING, STOOD = range(9)
"""Places among the counts: samples in the ring since its restart; samples since the beginning, up to `learn`; bad
ones in a row; samples in a row that are back; samples since contact began, -1 while there is none; samples in the
median filter; samples since the jump that is remembered; whether the mover moves; samples since it last stopped."""

AT, STEP, FIRST, LAST, BEFORE, LEFT, REST = range(7)
"""Places among the levels: the contact's own, now; from the level before to it; as it was at first; the last good
sample, and the one before it; the level before the jump that is remembered; the level at rest."""


class StepSearch(NamedTuple):
    """Constants and state of the search for steps; the arrays of the state, from `ring` on, are advanced in place.

    Attributes:
        spans: Lengths at which a jump is looked for, samples, growing, shape (k,).
        hops: Interval between looks at each, samples, shape (k,).
        bends: For each by how much a mover's acceleration bends the envelope, as a share of its distance from the
            level at rest, shape (k,).
        kappa_rad_m: By how much a wave turns with the mover's way.
        keeps: Decay of the slow and the fast scale of each per look, shape (k, 2).
        delays: Looks after which a jump enters the scales, so that it is not compared with itself, shape (k,).
        settle: Samples for which a jump is remembered.
        third: A third of the time for which the level must stay, samples.
        flat: Largest distance of each third from their mean, as a share of the step.
        learn: Samples averaged for the level at rest; no events before their end.
        drift_fs: Largest change of the level at rest per sample.
        end: Samples in a row that must be back for contact to be over.
        hold: Samples after which contact persists.
        keep_level: Decay of the contact's own level per sample.
        patience: Bad samples in a row that are bridged.
        ringing: Samples after a stop of the mover in which no jump counts.
        ring: The last samples, twice, so that any run of them is in one piece, shape (2 * size,).
        places_m: Of the mover at each of them, NaN where unknown, shape (2 * size,).
        scales: For each span the mean square of its deviation, slow and fast, 0 while unknown, shape (k, 2).
        late: Squared deviations still to enter the scales, shape (k, looks).
        counts: Shape (9,).
        looks: Looks at each span since the ring's restart, shape (k,).
        levels: Shape (7,).
        jump: The jump that is remembered, in scales; its square; one over its span; shape (3,).
    """

    spans: Ints
    hops: Ints
    bends: Floats
    kappa_rad_m: float
    keeps: Floats
    delays: Ints
    settle: int
    third: int
    flat: float
    learn: int
    drift_fs: float
    end: int
    hold: int
    keep_level: float
    patience: int
    ringing: int
    ring: Complexes
    places_m: Floats
    scales: Floats
    late: Floats
    counts: Ints
    looks: Ints
    levels: Complexes
    jump: Floats


def step_search(spans: Ints, delays: Ints, third: int, **constants: Any) -> StepSearch:
    """A search in its initial state; arguments are the constants of `StepSearch`."""
    counts = np.zeros(9, np.int64)
    counts[LASTED] = -1
    counts[STOOD] = constants["ringing"]
    size = max((PAST + 3) * int(spans[-1]), 3 * third)
    return StepSearch(
        spans,
        delays=delays,
        third=third,
        **constants,
        ring=np.zeros(2 * size, np.complex128),
        places_m=np.full(2 * size, np.nan),
        scales=np.zeros((len(spans), 2)),
        late=np.zeros((len(spans), int(delays.max()))),
        counts=counts,
        looks=np.zeros(len(spans), np.int64),
        levels=np.zeros(7, np.complex128),
        jump=np.zeros(3),
    )


@compiled()
def _mean(ring: Complexes, end: int, n: int) -> complex:
    """Mean of the n samples before place `end`."""
    total = 0j
    for j in range(end - n, end):
        total += ring[j]
    return total / n


@compiled()
def _squared(z: complex) -> float:
    return z.real * z.real + z.imag * z.imag


@compiled()
def _spans_gone(f: StepSearch, end: int, m: int) -> float:
    """How far the mover has gone in the last two spans of m samples, in mean spans before them; NaN where that is not
    known, or where it went too slowly to say."""
    newest, near = f.places_m[end - 1 - m // 2], f.places_m[end - 1 - 2 * m - m // 2]
    oldest = f.places_m[end - 1 - (2 + PAST) * m - m // 2]
    each_m = (near - oldest) / PAST
    slow_m = STILL_M * m / f.spans[-1]
    return (newest - near) / each_m if abs(each_m) > slow_m else math.nan


@compiled()
def _follow(f: StepSearch, end: int, x_m: float) -> None:
    """Notice that the mover stops: a jump of the last span is its ringing, and so are those that come after."""
    counts, still = f.counts, f.spans[-1]
    counts[STOOD] = min(counts[STOOD] + 1, f.ringing)
    if counts[FILLED] <= still:
        return
    gone_m = abs(x_m - f.places_m[end - 1 - still])
    if gone_m > 2.0 * STILL_M:
        counts[MOVING] = 1
    elif gone_m < STILL_M and counts[MOVING] == 1:
        counts[MOVING] = counts[STOOD] = 0
        if counts[AGE] <= still:
            f.jump[0] = 0.0


@compiled()
def _look(f: StepSearch, end: int) -> None:
    """Check all spans that are due, and keep the largest jump."""
    counts, scales = f.counts, f.scales
    rest = f.levels[REST]
    for k in range(f.spans.size):
        m = f.spans[k]
        if counts[FILLED] < (PAST + 3) * m or counts[FILLED] % f.hops[k] != 0:
            continue
        # a steady turn continues, two spans from the last of them to the newest
        near = _mean(f.ring, end - 2 * m, m) - rest
        new, across, size = near, 0j, 0.0
        for j in range(PAST):
            old = _mean(f.ring, end - (3 + j) * m, m) - rest
            across += old.conjugate() * new
            size += _squared(old)
            new = old
        turn = across / (size + FLOOR_FS * FLOOR_FS)
        if _squared(turn) > GROWTH * GROWTH:
            turn *= GROWTH / abs(turn)
        spans = _spans_gone(f, end, m)
        known = math.isfinite(spans)
        if known:
            angle_rad = spans * math.atan2(turn.imag, turn.real)
            turn = abs(turn) ** spans * complex(math.cos(angle_rad), math.sin(angle_rad))
        else:
            turn *= turn
        jump = _mean(f.ring, end, m) - rest - near * turn
        squared = _squared(jump)
        place = f.looks[k] % f.delays[k]
        if f.looks[k] >= f.delays[k]:
            old_squared = f.late[k, place]
            for speed in range(2):
                if scales[k, speed] == 0.0:
                    scales[k, speed] = old_squared
                else:
                    share = 1.0 - f.keeps[k, speed]
                    kept = min(old_squared, CLIP * scales[k, speed])
                    scales[k, speed] += share * (kept - scales[k, speed])
            # a braking mover turns the wave less than predicted, and hardly changes its size
            size = _squared(near)
            along = (near.real * jump.real + near.imag * jump.imag) ** 2 / (size + FLOOR_FS * FLOOR_FS)
            off = f.kappa_rad_m * ENCODER_M if known else f.bends[k]
            bend = off * off * size
            noise = max(scales[k, 0], scales[k, 1]) + FLOOR_FS * FLOOR_FS
            score = math.sqrt(along / (noise + RADIAL * RADIAL * bend) + (squared - along) / (noise + bend))
            if (
                counts[STOOD] >= f.ringing
                and counts[SINCE] >= f.learn
                and (score > f.jump[0] or counts[AGE] > f.settle)
            ):
                # past a step the prediction runs on and may jump further than the step itself: a jump is the remembered
                # one again where that is within its spans and most of the change came before the last of them
                earlier, later = near + rest - f.levels[LEFT], _mean(f.ring, end, m) - rest - near
                again = counts[AGE] < (PAST + 3) * m and _squared(earlier) > _squared(later)
                if f.jump[0] == 0.0 or not again:
                    f.levels[LEFT], counts[AGE] = near + rest, 0
                f.jump[0], f.jump[1], f.jump[2] = score, squared, 1.0 / m
        f.late[k, place] = squared
        f.looks[k] += 1


@compiled()
def _stays(f: StepSearch, end: int) -> tuple[float, complex]:
    """The remembered jump, in scales, if the level has stayed away since, else 0; and the change of level."""
    third = f.third
    if f.counts[AGE] > f.settle or f.counts[AGE] < 2 * third or f.counts[FILLED] < 3 * third:
        return 0.0, 0j
    old = _mean(f.ring, end - 2 * third, third)
    mid = _mean(f.ring, end - third, third)
    new = _mean(f.ring, end, third)
    level = (old + mid + new) / 3.0
    change = level - f.levels[LEFT]
    allowed = f.flat * f.flat * _squared(change)
    for part in (old, mid, new):
        if not _squared(part - level) < allowed:
            return 0.0, 0j
    # a steady change since the jump reaches at least its chord
    gone = _squared(new - old) * (f.counts[AGE] / (2.0 * third)) ** 2
    if not gone < STEADY * STEADY * _squared(change):
        return 0.0, 0j
    # a starting arm makes noise at once: neither jump nor change may come from it
    noise = 0.0
    for i in range(end - 3 * third, end):
        noise += _squared(f.ring[i] - level)
    noise = noise / (3.0 * third) + FLOOR_FS * FLOOR_FS
    if not _squared(change) > SURE * SURE * noise / f.spans[0]:
        return 0.0, 0j
    return min(f.jump[0], math.sqrt(f.jump[1] / (NOISY * noise * f.jump[2]))), change


@compiled()
def _rest(f: StepSearch, z: complex) -> None:
    """One sample without contact: the mean of the first ones is the level at rest, which then follows drift alone."""
    counts, levels = f.counts, f.levels
    if counts[SINCE] < f.learn:
        counts[SINCE] += 1
        levels[REST] += (z - levels[REST]) / counts[SINCE]
        return
    off = z - levels[REST]
    away = abs(off)
    levels[REST] += off if away <= f.drift_fs else off * (f.drift_fs / away)


@compiled()
def _restart(f: StepSearch) -> None:
    """Drop the samples so far; scales are kept."""
    f.counts[FILLED] = 0
    f.looks[:] = 0
    f.jump[0] = 0.0


@compiled()
def _turn(f: StepSearch, z: complex) -> None:
    """First sample after a gap, over which the drive's phase may have stepped: the levels turn with it, sizes stay."""
    turn = z * f.levels[LAST].conjugate()
    size = abs(turn)
    if 0.0 < size < BEYOND_FS:
        f.levels[:] *= turn / size


@compiled()
def _touch(f: StepSearch, z: complex) -> tuple[float, int]:
    """One sample of a contact; returns the share of the step left, and the change."""
    counts, levels = f.counts, f.levels
    counts[LASTED] += 1
    step = levels[STEP]
    size = _squared(step)
    off = z - levels[AT]
    left = 1.0 + (step.real * off.real + step.imag * off.imag) / size
    if left < BACK:
        counts[RETURNING] += 1
        if counts[RETURNING] >= f.end:
            counts[LASTED] = -1
            counts[RETURNING] = 0
            _restart(f)
            return left, ENDED
    else:
        counts[RETURNING] = 0
        levels[AT] += (1.0 - f.keep_level) * off
        away = levels[AT] - levels[FIRST]
        if _squared(away) > WANDER * WANDER * size:
            levels[AT] = levels[FIRST] + away * (WANDER * math.sqrt(size / _squared(away)))
    return left, HELD if counts[LASTED] == f.hold else NOTHING


@compiled()
def find_steps(
    f: StepSearch, threshold: float, z: Complexes, x_m: Floats, missing: Ints, scores: Floats, changes: Ints
) -> None:
    """Process n samples.

    Args:
        f: The search, advanced.
        threshold: Scales that a jump must have.
        z: Envelope, full scales, shape (n,).
        x_m: Position of the mover, NaN where it is not known, shape (n,).
        missing: Samples lost just before each, shape (n,).
        scores: Written: without contact the jump, in scales, after which the level stays, NaN where it does not; in
            contact the share of the step that is left. Shape (n,).
        changes: Written: `NOTHING`, `BEGAN`, `HELD` or `ENDED`, shape (n,).
    """
    counts, levels, ring = f.counts, f.levels, f.ring
    size = ring.size // 2
    for i in range(z.size):
        scores[i], changes[i] = math.nan, NOTHING
        if missing[i] != 0:
            counts[FRESH] = 0
            counts[SEEN_BAD] = f.patience + 1
            _turn(f, z[i])
        if not (abs(z[i].real) < BEYOND_FS and abs(z[i].imag) < BEYOND_FS):
            counts[SEEN_BAD] += 1
            continue
        if counts[SEEN_BAD] > f.patience:
            _restart(f)
            counts[RETURNING] = 0
        counts[SEEN_BAD] = 0
        before, last = levels[BEFORE], levels[LAST]
        levels[BEFORE], levels[LAST] = last, z[i]
        counts[FRESH] += 1
        if counts[FRESH] < 3:
            continue
        counts[FRESH] = 3
        sample = median(before, last, z[i])
        if counts[LASTED] >= 0:
            scores[i], changes[i] = _touch(f, sample)
            continue
        place = counts[FILLED] % size
        ring[place] = ring[place + size] = sample
        f.places_m[place] = f.places_m[place + size] = x_m[i]
        end = place + size + 1
        counts[FILLED] += 1
        counts[AGE] += 1
        _follow(f, end, x_m[i])
        _rest(f, sample)
        _look(f, end)
        if f.jump[0] <= 0.0:
            continue
        jump, change = _stays(f, end)
        if jump > 0.0:
            scores[i] = jump
            if jump > threshold:
                levels[AT] = levels[FIRST] = levels[LEFT] + change
                levels[STEP] = change
                counts[LASTED] = counts[RETURNING] = 0
                changes[i] = BEGAN
