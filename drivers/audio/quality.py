"""Whether what the fingers send is fit for use: clipped, silent, or of 16 bits. Pure."""

from typing import Final

import numpy as np
from numpy.typing import NDArray

from drivers.audio.settings import FINGERS, FULL_SCALE

CLIPPED_SHARE: Final = 1e-3
"""Of the frames of the look at `open`, at full scale. Assumption: a knock may be loud, a drive that is too loud is
so in every period."""

STILL_COUNTS: Final = 2
"""Peak to peak: a converter that moves no more has nothing at its input. Assumption: 24-bit converters' own noise
is some tens of counts, even with the input shorted."""

COARSE: Final = 0xFF
"""The bits of a count that 16-bit sound leaves empty."""

CLEAR_S: Final = 0.1
"""So long without a clipped frame ends an excursion (assumption)."""


def flaw(counts: NDArray[np.int32], seconds: float) -> tuple[str, str] | None:
    """What is wrong with some sound, and what to do; None where nothing is.

    Args:
        counts: 24-bit counts of the fingers, shape (n, 2).
        seconds: Their length, for the message.
    """
    spans = np.ptp(counts, axis=0)
    for finger, span in zip(FINGERS, spans, strict=True):
        if span <= STILL_COUNTS:
            return (
                f"the {finger} finger is silent: nothing has moved in {seconds:g} s",
                "is it plugged in, its preamplifier on, and `channels` right?",
            )
    if not (counts & COARSE).any():
        return (
            "its samples have 16 bits, not 24: the low 8 are empty",
            "choose a 24-bit format, and no converter or mixer on the way",
        )
    shares = np.mean(clipped(counts), axis=0)
    for finger, share in zip(FINGERS, shares, strict=True):
        if share > CLIPPED_SHARE:
            return (
                f"the {finger} finger is clipped: {share:.1%} of its frames are at full scale",
                "turn the gain of its preamplifier or the drive's level down",
            )
    return None


def clipped(counts: NDArray[np.int32]) -> NDArray[np.bool_]:
    """Which counts are at full scale; of their shape."""
    return (counts >= FULL_SCALE - 1) | (counts <= -FULL_SCALE)


class Excursions:
    """Where a finger leaves the range of its converter, once for each excursion.

    Args:
        rate_hz: Samples a second.
    """

    def __init__(self, rate_hz: float) -> None:
        self._clear = round(CLEAR_S * rate_hz)
        self.begin()

    def begin(self) -> None:
        """The stream is subscribed again."""
        self._since = [self._clear] * len(FINGERS)

    def push(self, full: NDArray[np.bool_]) -> list[tuple[int, int]]:
        """Take which of the next samples are at full scale, shape (n, 2).

        Returns:
            Place in the block and number of the finger of each excursion's first sample.
        """
        begun = []
        for number, one in enumerate(full.T):
            places = np.flatnonzero(one)
            if not len(places):
                self._since[number] += len(one)
                continue
            quiet = np.diff(places, prepend=-1 - self._since[number]) - 1
            begun += [(int(place), number) for place in places[quiet >= self._clear]]
            self._since[number] = len(one) - 1 - int(places[-1])
        return sorted(begun)


class Stillness:
    """Notices a finger that has fallen silent.

    Args:
        rate_hz: Frames a second.
        still_s: So long without a movement is too long.
    """

    def __init__(self, rate_hz: float, still_s: float) -> None:
        self._limit = round(still_s * rate_hz)
        self.begin()

    def begin(self) -> None:
        """The stream is subscribed again."""
        self._frames = [0] * len(FINGERS)
        self._lows = [0] * len(FINGERS)
        self._highs = [0] * len(FINGERS)

    def push(self, counts: NDArray[np.int32]) -> str | None:
        """The finger whose counts have not moved for too long, if one's have not; shape (n, 2)."""
        lows, highs = counts.min(axis=0).tolist(), counts.max(axis=0).tolist()
        for number, frames in enumerate(self._frames):
            low, high = lows[number], highs[number]
            if frames:
                low, high = min(low, self._lows[number]), max(high, self._highs[number])
            if high - low > STILL_COUNTS:
                self._frames[number] = 0
                continue
            self._frames[number] += len(counts)
            self._lows[number], self._highs[number] = low, high
            if self._frames[number] >= self._limit:
                return FINGERS[number]
        return None
