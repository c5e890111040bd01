"""What the columns and inputs that a profile describes show of the bench."""

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from drivers.core.errors import RefusedError
from drivers.core.messages import Floats
from drivers.core.scaled import ScaledStream
from simulator.physics.bench import Bench, StreamSpec, part

POSITION = StreamSpec("position", ("position",), "m", 1e-6, 1000.0)
"""What an encoder, or a distance sensor, at the mover shows: where it is on the approach axis."""


class ShownColumn(NamedTuple):
    """What a column shows: a channel of one of the plant's streams, as value / scale + offset."""

    source: str
    channel: int
    column: int | str
    scale: float
    offset: float


class ShownColumns:
    """What all columns of a device show.

    Attributes:
        columns: Numbers or names, in the order of `at`.

    Raises:
        RefusedError: a column that is named shows nothing of this bench.
    """

    def __init__(self, streams: Mapping[str, ScaledStream], bench: Bench, device: str) -> None:
        self._bench = bench
        self._shown = list(_shown_columns(streams, bench, device))
        self.columns = [one.column for one in self._shown]
        self._sources = frozenset(one.source for one in self._shown)
        self._read = self._sources - {POSITION.name}
        self._key = f"{device} {id(self)}"
        self._latest = np.zeros(len(self._shown))

    def watch(self, on: bool) -> None:
        """Whether anybody looks: what nobody looks at need not be computed."""
        self._bench.read(self._key, self._read if on else frozenset())

    def at(self, times_s: Floats) -> Floats:
        """What the columns show, shape (n, columns); of what was before a trial nothing is known: the latest stands."""
        felt = times_s > self._bench.origin_s
        shown = np.tile(self._latest, (len(times_s), 1))
        if felt.any():
            values = {source: self._sampled(source, times_s[felt]) for source in self._sources}
            for place, (source, channel, _, scale, offset) in enumerate(self._shown):
                shown[felt, place] = values[source][:, channel] / scale + offset
            self._latest = shown[-1].copy()
        return shown

    def _sampled(self, source: str, times_s: Floats) -> Floats:
        if source != POSITION.name:
            found = np.asarray(self._bench.sample(source, times_s))
        elif (mover := self._bench.mover) is None:
            found = np.zeros(len(times_s))
        else:
            found = np.array([mover.position(t_s) for t_s in times_s.tolist()])
        return found.reshape(len(times_s), -1)


def _shown_columns(streams: Mapping[str, ScaledStream], bench: Bench, device: str) -> Iterator[ShownColumn]:
    board = (spec for spec in part(bench, "streams", device)() if spec.rate_hz is not None)
    known = {spec.name: spec for spec in (*board, POSITION)}
    all_known = ", ".join(
        name if len(spec.channels) == 1 else f"{name}.{channel}"
        for name, spec in known.items()
        for channel in spec.channels
    )
    for name, stream in streams.items():
        where = f"streams.{name}.shows"
        for column, shown in zip(
            stream.sources, stream.shows or ("nothing",) * len(stream.sources), strict=True
        ):
            called = column if isinstance(column, str) else f"column {column}"
            source, _, channel = shown.partition(".")
            spec = known.get(source)
            if spec is None or channel not in (spec.channels if channel or len(spec.channels) > 1 else ("",)):
                raise RefusedError(
                    device,
                    "being wired to the bench",
                    f"{called} shows {shown}",
                    f"{where} is one of: {all_known}",
                )
            if spec.unit != stream.unit:
                reason = f"{called} is in {stream.unit}, and {shown} in {spec.unit}"
                raise RefusedError(device, "being wired to the bench", reason, f'write unit = "{spec.unit}"')
            place = spec.channels.index(channel) if channel else 0
            yield ShownColumn(source, place, column, stream.scale, stream.offset)
