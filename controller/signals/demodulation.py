"""From the counts of a finger to I and Q: mixed, low-passed and thinned in one go, in whole numbers.

A fused filter: the mixer's wave is in the taps, so that a window of frames gives I and Q by two sums of products, once
an output sample. Counts and taps are whole numbers whose sums stay below 2^53: in float64 every sum is exact, in
whatever order it is added, so that blocks and processors change nothing.
"""

import math
from typing import Final, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled
from drivers.core.messages import Floats

FULL_SCALE_BITS: Final = 23
"""Largest counts: 24 bits with their sign."""

TAP_BITS: Final = 30
"""Magnitudes of taps add up to 2^30 at the most, and sums stay below 2^53. Rounding them leaves at most -150 dBFS of
full-scale noise."""

CHUNK: Final = 4800
"""Frames that are taken at once: 38 kB of work, within the caches of a core."""

SPAN: Final = 6
"""Length of the low-pass in periods of the output: 6 ms at 1 kHz, 576 taps at 96 kHz."""

COSINES: Final = (1.0, 1.99419295, 1.79909967, 1.05147552, 0.25617692, 0.00966375353, 0.000187100534)
"""Amplitudes of the harmonics of the low-pass, relative to its mean. Found by minimax (weighted least squares, iterated
on a grid of frequencies) for: flat up to a tenth of the output rate, nothing within a tenth of it around its multiples,
which fold onto that band, and -130 dB beyond 10 times the output rate, where the mixer's images are. Whole harmonics of
the window's length are nulls beyond the sixth: at 40 kHz the images fall on one."""

Variant = Literal["fused", "cic", "in_phase"]

STEPS_PER_HZ: Final = 1000
"""The drive's frequency is in whole millihertz: its phase is a whole number of steps, exact at every frame."""

ANY_ORDER: Final = {"reassoc", "contract"}
"""For sums that are exact: their order is the compiler's."""


def cosine_taps(decimation: int) -> Floats:
    """The low-pass of `COSINES` for a decimation, sum 1, shape (6 decimation,).

    At an output of 1 kHz: within 0.0006 dB from 0 to 100 Hz, -0.07 dB at 200 Hz, -5.6 dB at 500 Hz; what folds onto 0
    to 100 Hz is down by at least 80 dB (93 dB from 3 kHz on, 130 dB from 10 kHz on).
    """
    n = SPAN * decimation
    k = np.arange(n) - 0.5 * (n - 1)
    taps = sum(a * np.cos(2.0 * np.pi * j / n * k) for j, a in enumerate(COSINES))
    return np.asarray(taps / np.sum(taps))


def cic_taps(decimation: int) -> Floats:
    """Three means over `decimation` frames in a row, sum 1, shape (3 decimation - 2,): a cascade of three integrators
    and combs has the same response.

    At an output of 1 kHz -0.02 dB at 23 Hz and -0.43 dB at 100 Hz, and what folds onto 0 to 100 Hz is down by 58 dB at
    least; its delay is half of that of `cosine_taps`.
    """
    mean = np.full(decimation, 1.0 / decimation)
    return np.convolve(np.convolve(mean, mean), mean)


@compiled(nogil=True)
def peak(counts, channel):  # type: ignore[no-untyped-def]
    """Farthest count of one channel from zero, negative ones less by one: 2^23 - 1 is full scale either way."""
    farthest = 0
    for i in range(counts.shape[0]):
        value = np.int32(counts[i, channel])
        farthest = max(farthest, int(value ^ (value >> 31)))
    return farthest


@compiled(nogil=True, fastmath=ANY_ORDER)
def sums(work, i_taps, q_taps, decimation, out):  # type: ignore[no-untyped-def]
    """Sums of products of whole numbers below 2^53, for windows `decimation` apart.

    Args:
        work: Counts, shape (frames,).
        i_taps: Shape (size,).
        q_taps: Shape (size,), or (0,) where Q is not wanted.
        decimation: From window to window.
        out: Written, shape (windows, 2).
    """
    size, windows = i_taps.size, out.shape[0]
    # five windows at a time share the taps' way from memory: a block of 5 or 10 ms has no others; at the end of others
    # some are the last one again
    for m in range(0, windows, 5):
        m1, m2 = min(m + 1, windows - 1), min(m + 2, windows - 1)
        m3, m4 = min(m + 3, windows - 1), min(m + 4, windows - 1)
        x0 = work[m * decimation : m * decimation + size]
        x1 = work[m1 * decimation : m1 * decimation + size]
        x2 = work[m2 * decimation : m2 * decimation + size]
        x3 = work[m3 * decimation : m3 * decimation + size]
        x4 = work[m4 * decimation : m4 * decimation + size]
        i0, i1, i2, i3, i4, q0, q1, q2, q3, q4 = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        if q_taps.size == 0:
            for k in range(size):
                i0 += i_taps[k] * x0[k]
                i1 += i_taps[k] * x1[k]
                i2 += i_taps[k] * x2[k]
                i3 += i_taps[k] * x3[k]
                i4 += i_taps[k] * x4[k]
        else:
            for k in range(size):
                i0 += i_taps[k] * x0[k]
                q0 += q_taps[k] * x0[k]
                i1 += i_taps[k] * x1[k]
                q1 += q_taps[k] * x1[k]
                i2 += i_taps[k] * x2[k]
                q2 += q_taps[k] * x2[k]
                i3 += i_taps[k] * x3[k]
                q3 += q_taps[k] * x3[k]
                i4 += i_taps[k] * x4[k]
                q4 += q_taps[k] * x4[k]
        out[m, 0], out[m1, 0], out[m2, 0], out[m3, 0], out[m4, 0] = i0, i1, i2, i3, i4
        out[m, 1], out[m1, 1], out[m2, 1], out[m3, 1], out[m4, 1] = q0, q1, q2, q3, q4


@compiled(nogil=True)
def turn(out, steps, jump, whole, unit):  # type: ignore[no-untyped-def]
    """Turn I + jQ back by the drive's phase at the beginning of each window, and scale.

    Args:
        out: Turned in place, shape (windows, 2).
        steps: Phase of the first, of `whole` a cycle.
        jump: From window to window.
        whole: Steps of a cycle.
    """
    for m in range(out.shape[0]):
        if steps == 0:
            out[m, 0] *= unit
            out[m, 1] *= unit
        else:
            angle = 2.0 * math.pi * steps / whole
            c, s = unit * math.cos(angle), unit * math.sin(angle)
            i, q = out[m, 0], out[m, 1]
            out[m, 0] = i * c + q * s
            out[m, 1] = q * c - i * s
        steps += jump
        if steps >= whole:
            steps -= whole


@compiled(nogil=True)
def fused(counts, start, channel, work, fill, i_taps, q_taps, decimation, steps, jump, whole, unit, out):  # type: ignore[no-untyped-def]
    """Filter one channel of int32 frames, shape (frames, channels), from `start` on; see `sums` and `turn`.

    Args:
        work: The channel's frames that are still needed, `fill` of them; those of the next windows move to its start.
        out: Written, shape (windows, 2).
    """
    done = 0
    while start < counts.shape[0]:
        taken = min(work.size - fill, counts.shape[0] - start)
        for i in range(taken):
            work[fill + i] = counts[start + i, channel]
        start += taken
        fill += taken
        ready = max(0, (fill - i_taps.size) // decimation + 1)
        passed = ready * decimation
        if ready:
            part = out[done : done + ready]
            sums(work, i_taps, q_taps, decimation, part)
            turn(part, (steps + done * jump) % whole, jump, whole, unit)
            for k in range(fill - passed):
                work[k] = work[passed + k]
        done += ready
        fill -= passed


class Fused:
    """A FIR: `cosine_taps`, 576 at 96 kHz and 1 kHz, or `cic_taps`, 286.

    Where the tone is a cos(phase + p) and the drive cos(phase), I is a cos p and Q is a sin p.

    Attributes:
        delay_frames: From the middle of an output's window to its last frame.

    Args:
        channel: Of the finger, from 0.
        drive_hz: Rounded to whole millihertz; below half of the rate.
        rate_hz: Frames a second, a whole number.
        decimation: Frames an output.
        variant: `cic` has the other taps; `in_phase` gives I alone, and Q as 0: the paper's chain (Rupavatharam et al.,
            III.B).

    Raises:
        ValueError: the rate is no whole number.
    """

    def __init__(
        self, channel: int, drive_hz: float, rate_hz: float, decimation: int, variant: Variant = "fused"
    ) -> None:
        if not rate_hz > 0.0 or rate_hz != round(rate_hz):
            raise ValueError(f"{rate_hz:g} frames a second are no whole number")
        self._channel = channel
        self._decimation = decimation
        # of the phase: from frame to frame, and of a cycle; after as many frames any such tone is where it began
        self._step, self._whole = round(drive_hz * STEPS_PER_HZ), round(rate_hz) * STEPS_PER_HZ
        self._jump = self._step * decimation % self._whole
        low_pass = cic_taps(decimation) if variant == "cic" else cosine_taps(decimation)
        self.delay_frames = 0.5 * (len(low_pass) - 1)
        # a window is as long as whole outputs
        low_pass = np.concatenate([np.zeros(-len(low_pass) % decimation), low_pass])
        frames = np.arange(len(low_pass), dtype=np.int64)
        taps = 2.0 * low_pass * np.exp(2j * np.pi / self._whole * (self._step * frames % self._whole)).conj()
        self._unit = 2.0 ** (1 - TAP_BITS)
        self._i_taps = np.rint(taps.real / self._unit)
        self._q_taps = np.rint(taps.imag / self._unit)
        assert max(np.abs(self._i_taps).sum(), np.abs(self._q_taps).sum()) < 2.0 ** (53 - FULL_SCALE_BITS)
        quadrature = self._quadrature = variant != "in_phase"
        # a window that begins at phase zero needs no turning, and without quadrature no Q
        if not quadrature and self._jump == 0:
            self._q_taps = np.empty(0)
        self._size = len(low_pass)
        self._work = np.empty(len(low_pass) + CHUNK)
        self._next = self._first = self._fill = 0

    def reset(self) -> None:
        """Drop all frames."""
        self._begin(0)

    def push(self, counts: NDArray[np.int32], frame: int) -> tuple[int, Floats]:
        """Process the next frames; `frame` is the number of the first, and a jump is loss.

        Outputs with an incomplete window are omitted.

        Args:
            counts: Shape (n, channels).
            frame: The drive's phase is zero at 0.

        Returns:
            Number of the first output (number m ends with frame (m + 1) decimation - 1), and I and Q of consecutive
            ones in counts of the input, shape (n, 2).
        """
        if frame != self._next:
            self._begin(frame)
        self._next = frame + len(counts)
        # frames before the first whole window
        start = min(len(counts), max(0, self._first + self._fill - frame))
        decimation, whole = self._decimation, self._whole
        first = (self._first + self._size) // decimation - 1
        self._fill += len(counts) - start
        out = np.empty((max(0, (self._fill - self._size) // decimation + 1), 2))
        fused(
            counts,
            start,
            self._channel,
            self._work,
            self._fill - (len(counts) - start),
            self._i_taps,
            self._q_taps,
            decimation,
            self._step * (self._first % whole) % whole,
            self._jump,
            whole,
            self._unit,
            out,
        )
        self._first += len(out) * decimation
        self._fill -= len(out) * decimation
        if not self._quadrature:
            out[:, 1] = 0.0
        return first, out

    def _begin(self, frame: int) -> None:
        """Frames begin anew; windows begin at whole multiples of the decimation."""
        self._next = frame
        self._first, self._fill = -(-frame // self._decimation) * self._decimation, 0
