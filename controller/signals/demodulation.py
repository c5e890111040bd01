"""From the counts of fingers to I and Q: mixed, low-passed and thinned in one go, in whole numbers.

A fused filter: the mixer's wave is in the taps, so that a window of frames gives I and Q by two sums of products, once
an output sample. Counts and taps are whole numbers whose sums stay below 2^53: in float64 every sum is exact, in
whatever order it is added, so that blocks and processors change nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from controller.signals.demodulation_kernel import cic_counts, cic_packed, fused_counts, fused_packed
from controller.signals.lowpass import CIC_DECIMATION_MAX, CIC_STAGES, cic_taps, cosine_taps
from controller.signals.oscillator import TABLE_MAX, TWELFTHS, Oscillator

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]
Counts = NDArray[np.int32] | NDArray[np.uint8]

FULL_SCALE_BITS: Final = 23
"""Largest counts: 24 bits with their sign."""

TAP_BITS: Final = 30
"""Magnitudes of taps add up to 2^30 at the most, and sums stay below 2^53. Rounding them leaves at most -150 dBFS of
full-scale noise."""

CHUNK: Final = 4800
"""Frames that are taken at once: 38 kB of work a finger, within the caches of a core."""


class Thinned(NamedTuple):
    """Consecutive outputs.

    Attributes:
        first: Number of the first: output m ends with frame (m + 1) decimation - 1.
        values: I and Q of each finger, shape (n, 2 fingers), float64, or int64 counts of the demodulator's `scale`.
    """

    first: int
    values: Floats | Ints


class Demodulator(Protocol):
    """Turns frames of fingers into I and Q at a lower rate.

    Where the tone is a cos(phase + p) and the drive cos(phase), I is a cos p and Q is a sin p.
    """

    delay_frames: float
    """From the middle of an output's window to its last frame."""
    scale: float
    """Counts (of the input's own) per count of `values`."""

    def push(self, counts: Counts, frame: int) -> Thinned:
        """Process the next frames; `frame` is the number of the first, and a jump is loss.

        Outputs with an incomplete window are omitted.

        Args:
            counts: int32, shape (n, channels), or packed little-endian 24-bit counts, uint8, shape (n, 3 channels).
            frame: The drive's phase is zero at 0.
        """

    def reset(self) -> None:
        """Drop all frames."""


class Fused:
    """A FIR of 6 periods of the output, 576 taps at 96 kHz and 1 kHz; see `lowpass.cosine_taps` for its response.

    Args:
        channels: Of the fingers, from 0; all are processed in one pass.
        oscillator: The drive.
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
        """See `Demodulator.reset`."""
        self._begin(0)

    def push(self, counts: Counts, frame: int) -> Thinned:
        """See `Demodulator.push`."""
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
        oscillator: The drive.
        decimation: Frames an output.

    Raises:
        ValueError: the decimation is above `CIC_DECIMATION_MAX`.
    """

    def __init__(self, channel: int, oscillator: Oscillator, decimation: int) -> None:
        self._channel = channel
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
        self._work = np.empty(CHUNK, np.int64)
        self._mixed = np.empty((2, CHUNK), np.int64)
        self._state = np.zeros((2, 2, CIC_STAGES), np.int64)
        self._begun = self._next = 0

    def reset(self) -> None:
        """See `Demodulator.reset`."""
        self._begin(0)

    def push(self, counts: Counts, frame: int) -> Thinned:
        """See `Demodulator.push`."""
        if frame != self._next:
            self._begin(frame)
        n, decimation = len(counts), self._decimation
        first, end = frame // decimation, (frame + n) // decimation
        out = np.empty((end - first, 2), np.int64)
        kernel = cic_packed if counts.dtype == np.uint8 else cic_counts
        kernel(
            counts,
            self._channel,
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
