"""What is done to every frame of a carrier. Compiled."""

import math
from collections.abc import Callable
from typing import Final

import numpy as np

from drivers.core.compiled import compiled

ANY_ORDER: Final = {"reassoc", "contract"}
"""For sums that are exact: their order is the compiler's."""


@compiled(nogil=True)
def take_counts(counts, start, n, channels, work, fill):  # type: ignore[no-untyped-def]
    """Copy channels of int32 frames, shape (frames, channels), to a row of `work` each, from `fill` on."""
    for row in range(channels.size):
        for i in range(n):
            work[row, fill + i] = counts[start + i, channels[row]]


@compiled(nogil=True)
def take_packed(packed, start, n, channels, work, fill):  # type: ignore[no-untyped-def]
    """The same of packed little-endian 24-bit counts, uint8, shape (frames, 3 channels)."""
    done = 0
    if packed.shape[1] == 6 and channels.size == 2 and channels[0] == 0 and channels[1] == 1:
        fours = n // 4
        done = 4 * fours
        words = packed[start : start + done].reshape(-1).view(np.int64)
        _take_words(words, fours, work[0, fill : fill + done], work[1, fill : fill + done])
    for row in range(channels.size):
        first = 3 * channels[row]
        frames = packed[start + done : start + n, first : first + 3]
        into = work[row, fill + done : fill + n]
        for i in range(n - done):
            # sums, not shifts: compilers make vectors of them; the sign is the highest byte's
            low, middle, high = (
                np.int32(frames[i, 0]),
                np.int32(frames[i, 1]),
                np.int32(np.int8(frames[i, 2])),
            )
            into[i] = low + 256 * middle + 65_536 * high


@compiled(nogil=True)
def _take_words(words, fours, right, left):  # type: ignore[no-untyped-def]
    """Counts of both channels: four frames are three 64-bit words."""
    for i in range(fours):
        first, second, third = words[3 * i], words[3 * i + 1], words[3 * i + 2]
        # each count comes to the highest bytes of 32 bits, and down again with its sign
        right[4 * i] = np.int32(first << 8) >> 8
        left[4 * i] = np.int32(first >> 16) >> 8
        right[4 * i + 1] = np.int32(((first >> 40) & 0xFFFF00) | (second << 24)) >> 8
        left[4 * i + 1] = np.int32(second) >> 8
        right[4 * i + 2] = np.int32(second >> 24) >> 8
        left[4 * i + 2] = np.int32(((second >> 48) & 0xFF00) | (third << 16)) >> 8
        right[4 * i + 3] = np.int32(third >> 8) >> 8
        left[4 * i + 3] = np.int32(third >> 32) >> 8


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
def mix_table(work, n, table, place, mixed):  # type: ignore[no-untyped-def]
    """Multiply frames by the wave, from a table of one period, shape (2, period), entered at `place`."""
    period = table.shape[1]
    start = 0
    while start < n:
        run = min(period - place, n - start)
        for k in range(run):
            mixed[0, start + k] = work[start + k] * table[0, place + k]
            mixed[1, start + k] = work[start + k] * table[1, place + k]
        start += run
        place = 0


@compiled(nogil=True)
def mix_tables(work, n, coarse, fine, steps, step, mixed):  # type: ignore[no-untyped-def]
    """The same by the product of two tables, rounded: any phase in steps, in whole numbers alone."""
    length, cycle = fine.shape[1], coarse.shape[1]
    a, b = steps // length, steps % length
    step_a, step_b = step // length, step % length
    for k in range(n):
        c = (coarse[0, a] * fine[0, b] - coarse[1, a] * fine[1, b] + (1 << 29)) >> 30
        s = (coarse[0, a] * fine[1, b] + coarse[1, a] * fine[0, b] + (1 << 29)) >> 30
        mixed[0, k] = work[k] * c
        mixed[1, k] = work[k] * s
        a += step_a
        b += step_b
        if b >= length:
            b -= length
            a += 1
        if a >= cycle:
            a -= cycle


@compiled(nogil=True)
def cascade(mixed, n, state, place, decimation, out):  # type: ignore[no-untyped-def]
    """Three integrators, and three combs at the lower rate; int64 that wraps.

    Args:
        mixed: Shape (2, frames).
        n: Frames in it.
        state: Of I and of Q: integrators and last inputs of the combs, shape (2, 2, 3), advanced.
        place: Of the first frame in its output, 0 to `decimation` - 1.
        decimation: Frames an output.
        out: Written, shape (outputs, 2).

    Returns:
        How many outputs.
    """
    made = 0
    for row in range(2):
        first, second, third = state[row, 0, 0], state[row, 0, 1], state[row, 0, 2]
        start, made, left = 0, 0, decimation - place
        while start < n:
            run = min(left, n - start)
            for k in range(start, start + run):
                first += mixed[row, k]
                second += first
                third += second
            start += run
            left -= run
            if left == 0:
                value = third
                for stage in range(3):
                    last = state[row, 1, stage]
                    state[row, 1, stage] = value
                    value -= last
                out[made, row] = value
                made += 1
                left = decimation
        state[row, 0, 0], state[row, 0, 1], state[row, 0, 2] = first, second, third
    return made


def _fused(take: Callable[..., None]) -> Callable[..., None]:
    """The fused filter of frames that are copied by `take`."""

    @compiled(nogil=True)
    def fused(  # type: ignore[no-untyped-def]
        counts, start, channels, work, fill, i_taps, q_taps, decimation, steps, jump, whole, unit, out
    ):
        """Process frames from `start` on; `take_counts`, `sums` and `turn` explain the arguments.

        `out` has two columns for each row of `work`; what the outputs leave moves to the beginning of `work`.
        """
        done = 0
        while start < counts.shape[0]:
            taken = min(work.shape[1] - fill, counts.shape[0] - start)
            take(counts, start, taken, channels, work, fill)
            start += taken
            fill += taken
            ready = max(0, (fill - i_taps.size) // decimation + 1)
            passed = ready * decimation
            for row in range(work.shape[0] if ready else 0):
                part = out[done : done + ready, 2 * row : 2 * row + 2]
                sums(work[row], i_taps, q_taps, decimation, part)
                turn(part, (steps + done * jump) % whole, jump, whole, unit)
                for k in range(fill - passed):
                    work[row, k] = work[row, passed + k]
            done += ready
            fill -= passed

    return fused


def _cic(take: Callable[..., None]) -> Callable[..., None]:
    """Mixer and cascade of frames that are copied by `take`."""

    @compiled(nogil=True)
    def cic(counts, channels, work, mixed, table, coarse, fine, frame, step, whole, state, decimation, out):  # type: ignore[no-untyped-def]
        """Process frames, the first of them `frame`; `take_counts` and `cascade` explain the arguments.

        A table without columns means the other two.
        """
        start, done = 0, 0
        while start < counts.shape[0]:
            taken, now = min(work.shape[1], counts.shape[0] - start), frame + start
            take(counts, start, taken, channels, work, 0)
            if table.shape[1] > 0:
                mix_table(work[0], taken, table, now % table.shape[1], mixed)
            else:
                mix_tables(work[0], taken, coarse, fine, step * (now % whole) % whole, step, mixed)
            done += cascade(mixed, taken, state, now % decimation, decimation, out[done:])
            start += taken

    return cic


fused_counts, fused_packed = _fused(take_counts), _fused(take_packed)
cic_counts, cic_packed = _cic(take_counts), _cic(take_packed)
