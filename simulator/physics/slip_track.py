"""What has lately come out of a slip plant, sample by sample, and the truth about contact and slip."""

from collections.abc import Iterator, Sequence

import numpy as np

from drivers.core.messages import Floats, Ints

KEEP_S = 4.0
"""How long samples are kept: longer than an emulated bench falls behind, and twice as long as the loop looks ahead (2 s
both)."""

PAUSE_S = 0.05
"""A contact that rests for longer than this has stopped slipping. Assumption: stick and slip on the study's structures
follow each other within some milliseconds."""


class Track:
    """The latest samples of a plant, by their numbers; number 0 is rest, when the trial begins.

    Attributes:
        count: Number of the last sample.
    """

    lasting = ("_kept",)

    def __init__(self, rate_hz: float, width: int) -> None:
        self._rate_hz = rate_hz
        self._kept = np.zeros((round(KEEP_S * rate_hz), width))
        self.count = 0

    def due(self, t_s: float) -> Iterator[Ints]:
        """Numbers of the samples that are missing up to a time since the trial began, as many as fit at once."""
        last = int(self.number(np.array(t_s)))
        while self.count < last:
            yield np.arange(self.count + 1, min(last, self.count + len(self._kept)) + 1)

    def number(self, times_s: Floats) -> Ints:
        """Number of the last sample at or before each time since the trial began; never below 0."""
        return np.asarray(np.maximum(np.floor(times_s * self._rate_hz + 1e-6), 0.0), np.int64)

    def push(self, rows: Floats) -> None:
        """The next samples, shape (n, width): those of `due`."""
        first = (self.count + 1) % len(self._kept)
        fitting = min(len(rows), len(self._kept) - first)
        self._kept[first : first + fitting] = rows[:fitting]
        self._kept[: len(rows) - fitting] = rows[fitting:]
        self.count += len(rows)

    def at(self, times_s: Floats) -> Floats:
        """The samples at times since the trial began, shape (n, width): what the converter held then."""
        return self.kept(self.known(times_s))

    def known(self, times_s: Floats) -> Ints:
        """Numbers of those samples, as far as they are still there, shape (n,)."""
        oldest = max(0, self.count - len(self._kept) + 1)
        return np.clip(self.number(times_s), oldest, self.count)

    def kept(self, numbers: Ints) -> Floats:
        """Some of the latest samples by their numbers, shape (n, width)."""
        return self._kept[numbers % len(self._kept)]


class SlipTruth:
    """When contact and slip really began and ended; for scoring alone.

    Args:
        origin_s: When the trial began, on the devices' clock.
    """

    def __init__(self, rate_hz: float, origin_s: float) -> None:
        self._rate_hz = rate_hz
        self._origin_s = origin_s
        self._touching = False
        self._slid_m = 0.0
        self._spans: list[tuple[int, int]] = []
        self.contacts: list[tuple[float, bool]] = []

    def follow(self, numbers: Ints, slid_m: Floats, normal_n: Floats) -> None:
        """Take the plant's next samples, each of shape (n,)."""
        touching = normal_n > 0.0
        if not self._touching and not touching.any():
            self._slid_m = float(slid_m[-1])
            return
        before = np.concatenate([[self._touching], touching[:-1]])
        changes = np.flatnonzero(touching != before)
        self.contacts += [(self._time(int(numbers[i])), bool(touching[i])) for i in changes]
        # a new contact has a new place without having slid there
        slid = (np.diff(slid_m, prepend=self._slid_m) != 0.0) & before & touching
        for number in numbers[slid].tolist():
            if self._spans and number - self._spans[-1][1] <= PAUSE_S * self._rate_hz:
                self._spans[-1] = (self._spans[-1][0], number)
            else:
                self._spans.append((number, number))
        self._touching, self._slid_m = bool(touching[-1]), float(slid_m[-1])

    @property
    def slips(self) -> Sequence[tuple[float, bool]]:
        """When the contact first moved (True), and when it last did (False), slip by slip."""
        return [
            (self._time(number), began)
            for span in self._spans
            for number, began in zip(span, (True, False), strict=True)
        ]

    def _time(self, number: int) -> float:
        return self._origin_s + number / self._rate_hz
