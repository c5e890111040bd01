"""From the beats at which a gauge was asked to the numbers of its samples. Pure."""

from __future__ import annotations

from typing import NamedTuple

SLACK = 0.01
"""By how many beats due times and numbers of one question may disagree: rounding alone (assumption)."""


class Numbered(NamedTuple):
    """A sample's number, how many were lost before it, and whether a new segment begins with it."""

    seq: int
    lost: int
    begins: bool


class Numbering:
    """Numbers of one stream; they grow for ever.

    Beats of one question follow one another on its grid, and a beat without an answer is a lost sample. Another
    question has another grid: a new segment, whose numbers jump by the time that has passed, nothing being lost.

    Args:
        rate_hz: Beats a second.
    """

    def __init__(self, rate_hz: float) -> None:
        self._rate_hz = rate_hz
        self._last: tuple[int, float, int] | None = None

    def number(self, beat: int, due_s: float) -> Numbered:
        """The number of the answer to a beat that was due at monotonic time `due_s`."""
        if self._last is None:
            numbered = Numbered(beat, 0, True)
        else:
            last_beat, last_s, last_seq = self._last
            passed, beats = (due_s - last_s) * self._rate_hz, beat - last_beat
            if beats > 0 and abs(passed - beats) <= SLACK:
                numbered = Numbered(last_seq + beats, beats - 1, False)
            else:
                numbered = Numbered(last_seq + 1 + max(1, round(passed)), 0, True)
        self._last = (beat, due_s, numbered.seq)
        return numbered
