"""From the counts of fingers to I and Q: mixed, low-passed and thinned in one go, in whole numbers.

A fused filter: the mixer's wave is in the taps, so that a window of frames gives I and Q by two sums of products, once
an output sample. Counts and taps are whole numbers whose sums stay below 2^53: in float64 every sum is exact, in
whatever order it is added, so that blocks and processors change nothing.
"""

import math
from collections.abc import Sequence
from typing import Final, NamedTuple

import numpy as np
from numpy.typing import NDArray

from controller.signals.demodulation_kernel import cic_counts, cic_packed, fused_counts, fused_packed
from drivers.core.messages import Floats, Ints

Counts = NDArray[np.int32] | NDArray[np.uint8]

FULL_SCALE_BITS: Final = 23
"""Largest counts: 24 bits with their sign."""

TAP_BITS: Final = 30
"""Magnitudes of taps add up to 2^30 at the most, and sums stay below 2^53. Rounding them leaves at most -150 dBFS of
full-scale noise."""

CHUNK: Final = 4800
"""Frames that are taken at once: 38 kB of work a finger, within the caches of a core."""

SPAN: Final = 6
"""Length of the low-pass in periods of the output: 6 ms at 1 kHz, 576 taps at 96 kHz."""

COSINES: Final = (1.0, 1.99419295, 1.79909967, 1.05147552, 0.25617692, 0.00966375353, 0.000187100534)
"""Amplitudes of the harmonics of the low-pass, relative to its mean. Found by minimax (weighted least squares, iterated
on a grid of frequencies) for: flat up to a tenth of the output rate, nothing within a tenth of it around its multiples,
which fold onto that band, and -130 dB beyond 10 times the output rate, where the mixer's images are. Whole harmonics of
the window's length are nulls beyond the sixth: at 40 kHz the images fall on one."""

CIC_STAGES: Final = 3

CIC_DECIMATION_MAX: Final = 256
"""Most frames an output of three sums: the mixer's whole numbers then still have an amplitude of 2^16."""

STEPS_PER_HZ: Final = 1000
"""Frequencies are whole millihertz, as the drive's are."""

TABLE_MAX: Final = 96_000
"""Longest period that is kept as a table, frames: any whole number of hertz at 96 kHz; 1.5 MB."""

TWELFTHS: Final = 826_806
"""Amplitude of the whole-number wave where the period divides 12: its half is whole, and its half times the square root
of 3 is 716,035 less 7e-7 (413,403 / 716,035 is a convergent of 1 / sqrt 3), so that rounding leaves 1e-12."""


def cosine_taps(decimation: int) -> Floats:
    """The low-pass of `COSINES` for a decimation, sum 1, shape (6 decimation,).

    At an output of 1 kHz: within 0.0006 dB from 0 to 100 Hz, -0.07 dB at 200 Hz, -5.6 dB at 500 Hz; what folds onto 0
    to 100 Hz is down by at least 80 dB (93 dB from 3 kHz on, 130 dB from 10 kHz on).
    """
    n = SPAN * decimation
    k = np.arange(n) - 0.5 * (n - 1)
    taps = sum(a * np.cos(2.0 * np.pi * j / n * k) for j, a in enumerate(COSINES))
    return np.asarray(taps / np.sum(taps))


def cic_taps(decimation: int) -> Ints:
    """Impulse response of three sums over `decimation` frames in a row, whole numbers, shape (3 decimation - 2,)."""
    taps = np.ones(1, np.int64)
    for _ in range(CIC_STAGES):
        taps = np.convolve(taps, np.ones(decimation, np.int64))
    return taps


class Oscillator:
    """cos and sin of 2 pi f n / rate at frame n, zero phase at frame 0.

    Args:
        frequency_hz: Rounded to whole millihertz.
        rate_hz: Frames a second, a whole number.

    Attributes:
        step: Of the phase from frame to frame, in steps.
        whole: Steps of a cycle; also frames after which any such tone is where it began.
        period: Frames after which this one is.

    Raises:
        ValueError: the frequency is not between 0 and half the rate, or the rate is no whole number.

    Example:
        >>> Oscillator(40_000.0, 96_000.0).period
        12
    """

    def __init__(self, frequency_hz: float, rate_hz: float) -> None:
        if not rate_hz > 0.0 or rate_hz != round(rate_hz):
            raise ValueError(f"{rate_hz:g} frames a second are no whole number")
        if not 0.0 < frequency_hz < 0.5 * rate_hz:
            raise ValueError(f"{frequency_hz:g} Hz are not between 0 and half of {rate_hz:g} frames a second")
        self.step = round(frequency_hz * STEPS_PER_HZ)
        self.whole = round(rate_hz) * STEPS_PER_HZ
        self.period = self.whole // math.gcd(self.step, self.whole)

    def steps(self, frames: Ints) -> Ints:
        """Phase at each frame, steps of 1/`whole` of a cycle, shape (n,)."""
        # both factors are below 2^30 at any rate up to 1 MHz
        return np.asarray(self.step * (frames % self.whole) % self.whole)

    def wave(self, frames: Ints) -> NDArray[np.complex128]:
        """cos + j sin at each frame, shape (n,)."""
        return np.asarray(np.exp(2j * np.pi / self.whole * self.steps(frames)))

    def table(self, amplitude: int) -> Ints:
        """One period of cos and of minus sin in whole numbers, shape (2, period); the period is at most `TABLE_MAX`."""
        return whole_numbers(self.wave(np.arange(self.period, dtype=np.int64)), amplitude)

    def coarse_and_fine(self, amplitude: int) -> tuple[Ints, Ints]:
        """Two tables whose product is the wave at any phase: of `amplitude`, and of 2^30.

        The phase in steps is `a` times the length of the second, plus `b`: indices into the tables.

        Returns:
            cos and minus sin at the coarse phases, shape (2, A), and at the fine ones, shape (2, B); A B = `whole`.
        """
        fine = max(k for k in range(1, math.isqrt(self.whole) + 1) if self.whole % k == 0)
        angle = 2j * np.pi / self.whole
        coarse_wave = np.exp(angle * fine * np.arange(self.whole // fine))
        return whole_numbers(coarse_wave, amplitude), whole_numbers(np.exp(angle * np.arange(fine)), 1 << 30)


def whole_numbers(wave: NDArray[np.complex128], amplitude: int) -> Ints:
    """cos and minus sin, times an amplitude, rounded, shape (2, n)."""
    return np.rint(amplitude * np.stack([wave.real, -wave.imag])).astype(np.int64)


class Thinned(NamedTuple):
    """Consecutive outputs.

    Attributes:
        first: Number of the first: output m ends with frame (m + 1) decimation - 1.
        values: I and Q of each finger, shape (n, 2 fingers), float64, or int64 counts of the demodulator's `scale`.
    """

    first: int
    values: Floats | Ints


class Fused:
    """A FIR of 6 periods of the output, 576 taps at 96 kHz and 1 kHz; see `cosine_taps` for its response.

    Where the tone is a cos(phase + p) and the drive cos(phase), I is a cos p and Q is a sin p.

    Attributes:
        delay_frames: From the middle of an output's window to its last frame.
        scale: Counts (of the input's own) per count of the outputs.

    Args:
        channels: Of the fingers, from 0; all are processed in one pass.
        decimation: Frames an output.
        quadrature: False gives I alone, and Q as 0: the paper's chain (Rupavatharam et al., III.B).
    """

    scale = 1.0

    def __init__(
        self, channels: Sequence[int], oscillator: Oscillator, decimation: int, quadrature: bool = True
    ) -> None:
        self._channels = np.array(channels, np.int64)
        self._decimation = decimation
        self._step, self._whole = oscillator.step, oscillator.whole
        self._jump = oscillator.step * decimation % oscillator.whole
        low_pass = cosine_taps(decimation)
        frames = np.arange(len(low_pass), dtype=np.int64)
        taps = 2.0 * low_pass * oscillator.wave(frames).conj()
        self._unit = 2.0 ** (1 - TAP_BITS)
        self._i_taps = np.rint(taps.real / self._unit)
        self._q_taps = np.rint(taps.imag / self._unit)
        assert max(np.abs(self._i_taps).sum(), np.abs(self._q_taps).sum()) < 2.0 ** (53 - FULL_SCALE_BITS)
        self._quadrature = quadrature
        # a window that begins at phase zero needs no turning, and without quadrature no Q
        if not quadrature and self._jump == 0:
            self._q_taps = np.empty(0)
        self.delay_frames = 0.5 * (len(low_pass) - 1)
        self._size = len(low_pass)
        self._work = np.empty((len(channels), len(low_pass) + CHUNK))
        self._next = self._first = self._fill = 0

    def reset(self) -> None:
        """Drop all frames."""
        self._begin(0)

    def push(self, counts: Counts, frame: int) -> Thinned:
        """Process the next frames; `frame` is the number of the first, and a jump is loss.

        Outputs with an incomplete window are omitted.

        Args:
            counts: int32, shape (n, channels), or packed little-endian 24-bit counts, uint8, shape (n, 3 channels).
            frame: The drive's phase is zero at 0.
        """
        if frame != self._next:
            self._begin(frame)
        self._next = frame + len(counts)
        # frames before the first whole window
        start = min(len(counts), max(0, self._first + self._fill - frame))
        decimation, whole = self._decimation, self._whole
        first = (self._first + self._size) // decimation - 1
        self._fill += len(counts) - start
        out = np.empty((max(0, (self._fill - self._size) // decimation + 1), 2 * len(self._channels)))
        kernel = fused_packed if counts.dtype == np.uint8 else fused_counts
        kernel(
            counts,
            start,
            self._channels,
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
            out[:, 1::2] = 0.0
        return Thinned(first, out)

    def _begin(self, frame: int) -> None:
        """Frames begin anew; windows begin at whole multiples of the decimation."""
        self._next = frame
        self._first, self._fill = -(-frame // self._decimation) * self._decimation, 0


class Cic:
    """Mixer and a cascade of three integrators and combs, in int64 throughout: equal to the bit, for ever.

    The integrators run over their ends and back: differences of their readings are right nevertheless (Hogenauer 1981).
    Its delay is half of the fused filter's, its response that of three averages over one output's time each: at an
    output of 1 kHz -0.02 dB at 23 Hz and -0.43 dB at 100 Hz, and what folds onto 0 to 100 Hz is down by 58 dB at least.

    Args:
        channel: Of the finger, from 0.
        decimation: Frames an output.

    Raises:
        ValueError: the decimation is above `CIC_DECIMATION_MAX`.
    """

    def __init__(self, channel: int, oscillator: Oscillator, decimation: int) -> None:
        self._channels = np.array([channel], np.int64)
        self._decimation = decimation
        if decimation > CIC_DECIMATION_MAX:
            raise ValueError(f"{decimation} frames an output leave no room; {CIC_DECIMATION_MAX} at the most")
        gain = decimation**CIC_STAGES
        # one bit is the sign's
        room = (1 << (63 - FULL_SCALE_BITS)) // gain
        amplitude = TWELFTHS if 12 % oscillator.period == 0 and room >= TWELFTHS else min(room, 1 << 20)
        self.scale = 2.0 / (amplitude * gain)
        self._oscillator = oscillator
        # one table of a whole period where there is room for it, else two
        self._table = self._coarse = self._fine = np.empty((2, 0), np.int64)
        if oscillator.period <= TABLE_MAX:
            self._table = oscillator.table(amplitude)
        else:
            self._coarse, self._fine = oscillator.coarse_and_fine(amplitude)
        self._span = len(cic_taps(decimation))
        self.delay_frames = 0.5 * (self._span - 1)
        self._work = np.empty((1, CHUNK), np.int64)
        self._mixed = np.empty((2, CHUNK), np.int64)
        self._state = np.zeros((2, 2, CIC_STAGES), np.int64)
        self._begun = self._next = 0

    def reset(self) -> None:
        """See `Fused.reset`."""
        self._begin(0)

    def push(self, counts: Counts, frame: int) -> Thinned:
        """See `Fused.push`."""
        if frame != self._next:
            self._begin(frame)
        n, decimation = len(counts), self._decimation
        first, end = frame // decimation, (frame + n) // decimation
        out = np.empty((end - first, 2), np.int64)
        kernel = cic_packed if counts.dtype == np.uint8 else cic_counts
        kernel(
            counts,
            self._channels,
            self._work,
            self._mixed,
            self._table,
            self._coarse,
            self._fine,
            frame,
            self._oscillator.step,
            self._oscillator.whole,
            self._state,
            decimation,
            out,
        )
        self._next = frame + n
        # outputs whose window begins before the frames do
        missing = min(len(out), max(0, -(-(self._begun + self._span) // decimation) - 1 - first))
        return Thinned(first + missing, out[missing:])

    def _begin(self, frame: int) -> None:
        self._begun = self._next = frame
        self._state[:] = 0
