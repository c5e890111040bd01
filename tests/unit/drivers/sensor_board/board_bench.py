"""A bench in virtual time: what a board may be wired to, and a host whose time the test moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from random import Random
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import WallClock
from drivers.core.messages import SampleBlock, Status
from drivers.sensor_board.driver import SensorBoard
from simulator.devices.sensor_board import EmulatedSensorBoard

Floats = NDArray[np.float64]

PERIOD_S = 1.0 / 28.0
"""Of the events that the source makes."""


RESTS_MAX = 5000
"""Of a driver that waits for the board, 1 ms each: a test waits for less than a second."""


class Spec(NamedTuple):
    name: str
    channels: tuple[str, ...]
    unit: str
    scale: float
    rate_hz: float | None


SPECS = (
    Spec("accelerometer", ("x", "z"), "m/s2", 1e-3, 1000.0),
    Spec("load_cell", ("force",), "N", 1e-5, 1000.0),
    Spec("period", ("period",), "s", 1e-7, None),
)


class Source:
    """Accelerations 5 and 100 m/s2, a force of 1 N for each second since it began, and 28 periods a second."""

    def __init__(self, begin_s: float = 0.0) -> None:
        self.t_s = self.begin_s = begin_s
        self.observed: frozenset[str] = frozenset()
        self.sampled = {spec.name: 0 for spec in SPECS}
        self.switched: list[tuple[float, bool]] = []
        self.tendon_m = 0.0
        self._events: list[float] = []

    def streams(self) -> Sequence[Spec]:
        return SPECS

    def advance(self, t_s: float, observe: frozenset[str]) -> None:
        assert t_s >= self.t_s
        self.observed = observe
        first, last = int(self.t_s / PERIOD_S) + 1, int(t_s / PERIOD_S)
        self._events += [number * PERIOD_S for number in range(first, last + 1)]
        self.t_s = t_s

    def sample(self, stream: str, times_s: Floats) -> Floats:
        assert stream in self.observed
        assert np.all(times_s <= self.t_s)
        self.sampled[stream] += len(times_s)
        if stream == "accelerometer":
            return np.tile([5.0, 100.0], (len(times_s), 1))
        return times_s - self.begin_s

    def events(self, stream: str) -> tuple[Floats, Floats]:
        assert stream == "period"
        times_s, self._events = np.array(self._events), []
        self.sampled[stream] += len(times_s)
        return times_s, np.full(len(times_s), PERIOD_S)

    def excite(self, on: bool) -> None:
        self.switched.append((self.t_s, on))

    def set_tendon(self, position_m: float) -> None:
        self.tendon_m = position_m

    @property
    def excited(self) -> bool:
        return bool(self.switched) and self.switched[-1][1]


@dataclass
class Host:
    """A host's monotonic clock, and the line between it and a board, looked at every 0.2 to 1.2 ms.

    What the host writes goes through `cut` on its way, and what the board sends through `hush`.
    """

    board: EmulatedSensorBoard
    t_s: float
    fault: str | None = None
    cut: Callable[[bytes], bytes] = bytes
    hush: Callable[[bytes], bytes] = bytes
    written: list[bytes] = field(default_factory=list)
    arrived: list[tuple[float, bytes]] = field(default_factory=list)
    closed: bool = False
    chance: Random = field(default_factory=lambda: Random(4))

    # as a link

    def connect(self, *_: object) -> Any:
        self.closed = False
        return self

    def send(self, data: bytes) -> float | None:
        if self.fault or self.closed:
            return None
        self.written.append(data)
        self._arrive(self.board.receive(self.cut(data), self.t_s))
        return self.t_s

    def receive(self) -> list[tuple[float, bytes]]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def close(self) -> None:
        self.closed = True

    # as time

    def until(self, t_s: float) -> None:
        while self.t_s < t_s - 1e-9:
            self.t_s = min(self.t_s + self.chance.uniform(0.2e-3, 1.2e-3), t_s)
            self._arrive(self.board.step(self.t_s))

    def _arrive(self, data: bytes) -> None:
        data = self.hush(data)
        if data:
            self.arrived.append((self.t_s, data))


class HostClock(WallClock):
    """Bench time on such a host."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self.rests = 0
        self.restart()

    def now(self) -> float:
        return self._host.t_s - self._origin_s

    def monotonic_s(self) -> float:
        return self._host.t_s

    def rest(self, seconds: float) -> None:
        self.rests += 1
        assert self.rests < RESTS_MAX, "it waits for ever"
        self._host.until(self._host.t_s + seconds)

    def restart(self) -> None:
        self._origin_s = self._host.t_s


@dataclass
class Bench:
    """A driver on an emulated board in virtual time."""

    source: Source
    board: EmulatedSensorBoard
    host: Host
    clock: HostClock
    driver: SensorBoard

    def run(self, seconds: float, turn_s: float = 0.002) -> tuple[list[SampleBlock], list[Status]]:
        """Let the loop turn for a while; the driver's blocks and statuses."""
        blocks: list[SampleBlock] = []
        statuses: list[Status] = []
        until_s = self.host.t_s + seconds
        while self.host.t_s < until_s - 1e-9:
            self.host.until(min(self.host.t_s + turn_s, until_s))
            blocks += self.driver.read()
            statuses += self.driver.poll()
        return blocks, statuses
