"""How long something takes: CPU time of this process, median of repeats after a warm-up.

CPU time and medians, because others use the machine too; what they do to caches and clocks remains. So what is compared
is measured in turns, and ratios within one run hold while absolute times do not.
"""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

AT_LEAST_S = 0.004
"""A measurement shorter than this is repeated inside: a thousand times what reading the clock costs."""

ROUNDS = 11
"""Measurements of what is fast."""

FEWEST = 3
"""Measurements of what is slow."""

PATIENCE_S = 2.0
"""What has taken this long is measured no more than `FEWEST` times, the first time included: it needs no warm-up."""


class Work(NamedTuple):
    """What is to be timed."""

    run: Callable[[], object]
    before: Callable[[], object] = lambda: None
    """What has to be done before every run and is not timed."""

    def once_s(self) -> float:
        """CPU time of one run."""
        self.before()
        begun_s = time.process_time()
        self.run()
        return time.process_time() - begun_s


def side_by_side_s(works: Sequence[Work]) -> list[float]:
    """Median CPU time in s of a run of each, measured in turns: other load on the machine slows all of them."""
    firsts_s = [work.once_s() for work in works]
    taken: list[list[float]] = [[first_s] if first_s > PATIENCE_S else [] for first_s in firsts_s]
    inners = [max(1, min(100, int(AT_LEAST_S / max(first_s, 1e-6)))) for first_s in firsts_s]
    for _ in range(ROUNDS):
        for work, inner, times_s in zip(works, inners, taken, strict=True):
            if len(times_s) < FEWEST or sum(times_s) * inner < PATIENCE_S:
                times_s.append(sum(work.once_s() for _ in range(inner)) / inner)
    return [statistics.median(times_s) for times_s in taken]
