"""A wave along the way, found by least squares that forget with the distance travelled. Compiled.

What an object reflects turns once around for each half wavelength that the finger moves, whatever the speed. So the
envelope is gathered in cells of distance, and to the last cells is fitted

    z(x) = offset + slope s + a exp(± j kappa x),   weights exp(-(s_now - s) / memory),

x the mover's position, s the way it has gone. What stands still in the room sends a wave of that length as well, but
one that hardly grows: its size is learned along a stretch of the way, and the object's wave must exceed it. The best of
all waves is held against the best that was there, the wave straight ahead in either sense against its own past: where
oblique walls send much, the second still shows a weak echo. The sums behind the fit are carried along from cell to
cell, so a sample costs the same after a minute as after a day.
docs/explanation/pretouch.md derives it.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]
Ints = NDArray[np.int64]

BEYOND_FS = 100.0
"""A larger magnitude is no measurement: a converter ends at 1."""

OUTLIER = 12.0
"""A cell that is farther from the fit than so many standard deviations of a cell is left out."""

PATIENCE = 4
"""After so many such cells in a row the fit begins anew: the level has changed."""

NUISANCES = 3.0
"""Complex numbers that are fitted: offset, slope, amplitude."""

FLOOR_FS = 1e-7
"""Standard deviation that a cell is always granted: the step of a 24-bit converter, 2^-23."""


STILL = 0.125
"""Share of a still background's power that counts as its spread. With a threshold of some ten an object's wave must
be a little larger than the background's. Chosen on simulated rooms (benchmarks/pretouch_rooms.py)."""

LEARNED = 4.0
"""A background that was learned may be so many times larger than one that is granted: the wave of a wall ahead grows
beyond what one would grant, but slower than that of an object. Chosen on simulated rooms: 2 to 13 do as well."""

SEVERAL = 0.87
"""Weight of the best of all waves beside the one straight ahead: of many waves one is larger by chance. Chosen on
simulated rooms with oblique walls."""

FORGET_M = 0.025
"""Distance after which what was learned beyond that counts for 1/e: an object that was near is not background at the
next approach. Chosen on simulated rooms: 0.05 does as well."""


WEIGHT, SLOPE, SQUARE, ENERGY, WEIGHT_2, LAST_M, GONE_M, CELL_FROM_M, CELL_X_M, REFERENCE_M = range(10)
"""Places among the scalars: sums of w, w s, w s^2, w |z|^2 and w^2; place of the last cell and way gone since the fit
began; where the present cell began, mean position in it; zero of the wave's phase."""

CELLS, INSIDE, DWELL, BAD, STRANGE, CANDIDATE, FRESH, SIZED = range(8)
"""Places among the counts: cells in the fit; samples in the present cell, averaged and since it began; bad samples in a
row; outliers in a row; which spatial frequency was the best; samples in the median filter; amplitudes since the fit
began."""

REFERENCE, CELL, LEVEL, RAMP, BEFORE, MIDDLE = range(6)
"""Places among the complex scalars: level that the sums are relative to; mean of the present cell; sums of w z and
w s z; the last two samples, for the median of three."""


class WaveFit(NamedTuple):
    """Constants and state of the fit; all arrays but the first are advanced in place.

    Attributes:
        kappa_rad_m: Spatial frequencies looked for, with their sign, shape (k,).
        memory_m: Distance at which a cell's weight has fallen to 1/e.
        least_m: Way to go before the fit is believed.
        longest: Samples that a cell averages at most: the last ones, when the mover creeps.
        background_fs: Largest amplitude that a still background may have before it is learned.
        straight: Which of the spatial frequencies are of an object straight ahead; each has a background of its own.
        lag: Cells after which a wave's size counts as background.
        stretch: Cells over which a background is learned at the least.
        pause: Samples after which a cell begun is forgotten and the fit begins anew: the offset has drifted.
        patience: Lost or bad samples in a row after which the fit begins anew.
        scalars: Shape (10,).
        counts: Shape (8,).
        levels: Complex scalars, shape (6,).
        waves: For each spatial frequency the sums of w e, w s e and w conj(e) z, shape (k, 3).
        middle_m: Position of the sample in the middle of the median filter, shape (1,).
        fitted: Of each spatial frequency the F ratio, NaN where there is none, and the amplitude, shape (k, 2).
        largest_fs: Largest amplitude up to each of the last cells, in turn, of all waves and of each straight one; what
            of it is beyond `background_fs` fades. Shape (1 + straight, lag).
    """

    kappa_rad_m: Floats
    straight: Ints
    cell_m: float
    memory_m: float
    least_m: float
    longest: int
    background_fs: float
    lag: int
    stretch: int
    pause: int
    patience: int
    scalars: Floats
    counts: Ints
    levels: Complexes
    waves: Complexes
    middle_m: Floats
    fitted: Floats
    largest_fs: Floats


def wave_fit(kappa_rad_m: Floats, straight: Ints, lag: int, **constants: Any) -> WaveFit:
    """A fit in its initial state; arguments are the constants of `WaveFit`."""
    fit = WaveFit(
        kappa_rad_m,
        straight,
        lag=lag,
        **constants,
        scalars=np.zeros(10),
        counts=np.zeros(8, np.int64),
        levels=np.zeros(6, np.complex128),
        waves=np.zeros((len(kappa_rad_m), 3), np.complex128),
        middle_m=np.full(1, np.nan),
        fitted=np.zeros((len(kappa_rad_m), 2)),
        largest_fs=np.zeros((1 + len(straight), lag)),
    )
    fit.scalars[CELL_FROM_M] = np.nan
    return fit


@compiled()
def _middle(a: float, b: float, c: float) -> float:
    return max(min(a, b), min(max(a, b), c))


@compiled()
def median(a: complex, b: complex, c: complex) -> complex:
    """Of three samples: one bad sample never gets through, whatever its size."""
    return complex(_middle(a.real, b.real, c.real), _middle(a.imag, b.imag, c.imag))


@compiled()
def _forget(f: WaveFit) -> None:
    """The fit begins anew; the sample that comes next is the first of a cell."""
    f.scalars[:] = 0.0
    f.scalars[CELL_FROM_M] = np.nan
    f.counts[CELLS] = f.counts[INSIDE] = f.counts[DWELL] = f.counts[STRANGE] = f.counts[SIZED] = 0
    f.waves[:] = 0.0
    f.levels[:BEFORE] = 0.0  # the filter keeps what it has


@compiled()
def _travel(f: WaveFit, step_m: float) -> None:
    """Let all sums forget a step, and count the way from here."""
    v, levels, waves = f.scalars, f.levels, f.waves
    keep = math.exp(-step_m / f.memory_m)
    # the order matters: each line uses the sums of lower order as they were
    v[SQUARE] = keep * (v[SQUARE] - 2.0 * step_m * v[SLOPE] + step_m * step_m * v[WEIGHT])
    v[SLOPE] = keep * (v[SLOPE] - step_m * v[WEIGHT])
    v[WEIGHT] *= keep
    v[WEIGHT_2] *= keep * keep
    v[ENERGY] *= keep
    levels[RAMP] = keep * (levels[RAMP] - step_m * levels[LEVEL])
    levels[LEVEL] *= keep
    for k in range(waves.shape[0]):
        waves[k, 1] = keep * (waves[k, 1] - step_m * waves[k, 0])
        waves[k, 0] *= keep
        waves[k, 2] *= keep


@compiled()
def _variance(kept: float, weight: float, freedom: float) -> float:
    """Of a cell, from a weighted sum of squares: a weighted mean, brought to an unbiased one."""
    return kept / weight * (freedom + NUISANCES) / freedom + FLOOR_FS * FLOOR_FS


@compiled()
def _judge(f: WaveFit) -> tuple[float, complex, complex, float]:
    """The best spatial frequency's F ratio, its amplitude at the reference, the offset that goes with it, and the
    residual's variance of a cell; those of each frequency go to `fitted`."""
    v, waves = f.scalars, f.waves
    f.fitted[:] = math.nan
    s0, s1, s2 = v[WEIGHT], v[SLOPE], v[SQUARE]
    t0, t1 = f.levels[LEVEL], f.levels[RAMP]
    freedom = s0 * s0 / v[WEIGHT_2] - NUISANCES if v[WEIGHT_2] > 0.0 else 0.0
    determinant = s0 * s2 - s1 * s1
    if freedom < 2.0 or not determinant > 1e-12 * s0 * s2:
        return math.nan, 0j, 0j, math.nan
    # G^-1 [t0, t1]
    level, ramp = (s2 * t0 - s1 * t1) / determinant, (s0 * t1 - s1 * t0) / determinant
    left = v[ENERGY] - (level.conjugate() * t0 + ramp.conjugate() * t1).real
    best, amplitude, at_level, kept = -1.0, 0j, level, math.nan
    for k in range(waves.shape[0]):
        c0, c1 = waves[k, 0], waves[k, 1]
        e_level, e_ramp = (s2 * c0 - s1 * c1) / determinant, (s0 * c1 - s1 * c0) / determinant
        size = s0 - (e_level.conjugate() * c0 + e_ramp.conjugate() * c1).real
        if not size > 1e-6 * s0:
            continue
        across = waves[k, 2] - (e_level.conjugate() * t0 + e_ramp.conjugate() * t1)
        explained = (across.real * across.real + across.imag * across.imag) / size
        rest = _variance(max(left - explained, 0.0), s0, freedom)
        f.fitted[k, 0] = explained / s0 * (freedom + NUISANCES) / rest
        f.fitted[k, 1] = abs(across) / size
        if explained > best:
            best, kept = explained, rest
            amplitude = across / size
            at_level = level - amplitude * e_level
            f.counts[CANDIDATE] = k
    if best < 0.0:
        return math.nan, 0j, 0j, math.nan
    return f.fitted[f.counts[CANDIDATE], 0], amplitude, at_level, kept


@compiled()
def _above_background(f: WaveFit, row: int, ratio: float, size_fs: float) -> float:
    """An F ratio with a still background's share added to what is left. Takes note of the wave's size.

    The background is the largest wave that was there a lag ago, or the largest that one may have until a stretch of the
    way has been seen: of two walls whose waves cancel at one place it knows nothing yet.
    """
    at, largest_fs = f.counts[SIZED], f.largest_fs[row]
    place = at % f.lag
    learned = at >= f.lag + f.stretch
    still_fs = min(largest_fs[place], LEARNED * f.background_fs) if learned else f.background_fs
    before_fs = largest_fs[(at - 1) % f.lag] if at > 0 else 0.0
    kept_fs = max(min(before_fs, f.background_fs), before_fs * math.exp(-f.cell_m / FORGET_M))
    largest_fs[place] = max(kept_fs, size_fs)
    return ratio / (1.0 + STILL * ratio * (still_fs / size_fs) ** 2) if size_fs > 0.0 else ratio


@compiled()
def _add(f: WaveFit, z: complex, x_m: float) -> tuple[float, float]:
    """Take a cell into the fit; returns F and the amplitude in full scales, NaN while it is not believed."""
    v, counts, levels, waves = f.scalars, f.counts, f.levels, f.waves
    if counts[CELLS] == 0:
        levels[REFERENCE], v[REFERENCE_M], v[LAST_M] = z, x_m, x_m
    step_m = abs(x_m - v[LAST_M])
    v[GONE_M] += step_m
    v[LAST_M] = x_m
    _travel(f, step_m)
    z = z - levels[REFERENCE]
    if v[GONE_M] >= f.least_m:
        _, amplitude, level, variance = _judge(f)
        if math.isfinite(variance):
            phase = f.kappa_rad_m[counts[CANDIDATE]] * (x_m - v[REFERENCE_M])
            predicted = level + amplitude * complex(math.cos(phase), math.sin(phase))
            # the prediction may be as wrong as the residual
            if abs(z - predicted) ** 2 > OUTLIER * OUTLIER * variance:
                counts[STRANGE] += 1
                if counts[STRANGE] >= PATIENCE:
                    _forget(f)
                return math.nan, math.nan
    counts[STRANGE] = 0
    counts[CELLS] += 1
    v[WEIGHT] += 1.0
    v[WEIGHT_2] += 1.0
    v[ENERGY] += z.real * z.real + z.imag * z.imag
    levels[LEVEL] += z
    for k in range(waves.shape[0]):
        phase = f.kappa_rad_m[k] * (x_m - v[REFERENCE_M])
        wave = complex(math.cos(phase), math.sin(phase))
        waves[k, 0] += wave
        waves[k, 2] += wave.conjugate() * z
    if v[GONE_M] < f.least_m:
        return math.nan, math.nan
    ratio, amplitude, _, _ = _judge(f)
    size_fs = abs(amplitude)
    if not math.isfinite(ratio) or size_fs == 0.0:
        return ratio, size_fs
    best = _above_background(f, 0, ratio, size_fs) * (
        SEVERAL if f.kappa_rad_m.size > f.straight.size else 1.0
    )
    for row in range(f.straight.size):
        own, own_fs = f.fitted[f.straight[row]]
        if math.isfinite(own):
            best = max(best, _above_background(f, 1 + row, own, own_fs))
    f.counts[SIZED] += 1
    return best, size_fs


@compiled()
def fit_wave(
    f: WaveFit, z: Complexes, x_m: Floats, missing: Ints, ratios: Floats, amplitudes_fs: Floats
) -> None:
    """Process n samples.

    Args:
        f: The fit, advanced.
        z: Envelope, full scales, shape (n,); a value that is not finite is left out.
        x_m: Position of the mover, shape (n,); NaN where unknown.
        missing: Samples lost just before each, negative where unknown, shape (n,).
        ratios: Written: at the sample that completes a cell, what the wave explains over what is left, both for one
            cell and degree of freedom (an F ratio), a still background's share added to what is left; NaN elsewhere,
            and while the fit is not believed. Shape (n,).
        amplitudes_fs: Written: the wave's amplitude there, shape (n,).
    """
    v, counts, levels = f.scalars, f.counts, f.levels
    for i in range(z.size):
        ratios[i] = amplitudes_fs[i] = math.nan
        if missing[i] != 0:
            counts[FRESH] = 0
            counts[INSIDE] = 0  # a cell with a hole in it has no middle
            counts[BAD] += missing[i] if missing[i] > 0 else f.patience
        if not (abs(z[i].real) < BEYOND_FS and abs(z[i].imag) < BEYOND_FS and math.isfinite(x_m[i])):
            counts[BAD] += 1
            continue
        if counts[BAD] >= f.patience:
            _forget(f)
            counts[FRESH] = 0
        counts[BAD] = 0
        before, middle, at_m = levels[BEFORE], levels[MIDDLE], f.middle_m[0]
        levels[BEFORE], levels[MIDDLE], f.middle_m[0] = middle, z[i], x_m[i]
        counts[FRESH] += 1
        if counts[FRESH] < 3:
            continue
        counts[FRESH] = 3
        sample = median(before, middle, z[i])
        if not math.isfinite(v[CELL_FROM_M]):
            v[CELL_FROM_M] = at_m
        counts[DWELL] += 1
        counts[INSIDE] = min(counts[INSIDE] + 1, f.longest)
        share = 1.0 / counts[INSIDE]
        if counts[INSIDE] == 1:
            levels[CELL], v[CELL_X_M] = sample, at_m
        else:
            levels[CELL] += share * (sample - levels[CELL])
            v[CELL_X_M] += share * (at_m - v[CELL_X_M])
        if counts[DWELL] == f.pause:
            _forget(f)
        elif abs(at_m - v[CELL_FROM_M]) >= f.cell_m:
            cell, cell_m = levels[CELL], v[CELL_X_M]
            v[CELL_FROM_M] = at_m
            counts[INSIDE] = counts[DWELL] = 0
            ratios[i], amplitudes_fs[i] = _add(f, cell, cell_m)
