"""A sensor board's driver on an emulated board in virtual time, and what the board may be wired to."""

from collections.abc import Callable, Sequence
from functools import partial
from random import Random
from typing import Any, NamedTuple

import numpy as np
import pytest

from drivers.core.messages import Floats, SampleBlock
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from simulator.devices.sensor_board import EmulatedSensorBoard
from tests.contracts.crank import Crank
from tests.unit.drivers.far_end import BEGIN_S, FarClock, FarEnd

PERIOD_S = 1.0 / 28.0
"""Of the events that the source makes."""


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


class Bench(Crank):
    """A driver on an emulated board in virtual time, closed; the line is looked at every 0.2 to 1.2 ms."""

    def __init__(self, board: dict[str, Any], driver: dict[str, Any]) -> None:
        self.source = Source(BEGIN_S)
        self.board = EmulatedSensorBoard(self.source, **board)
        self.host = FarEnd(self.board, partial(Random(4).uniform, 0.2e-3, 1.2e-3))
        settings = SensorBoardSettings(port="/dev/board", **driver)
        clock = FarClock(self.host)
        device = SensorBoard("board", settings, clock, self.host.connect)
        super().__init__(device, clock, opens=False)

    def run(self, seconds: float, turn_s: float = 0.002) -> tuple[list[SampleBlock], list[Any]]:
        """Let the loop turn for a while; the driver's blocks and statuses."""
        blocks: list[SampleBlock] = []
        statuses: list[Any] = []
        until_s = self.host.t_s + seconds
        while self.host.t_s < until_s - 1e-9:
            self.host.until(min(self.host.t_s + turn_s, until_s))
            blocks += self.device.read()
            statuses += self.device.poll()
        return blocks, statuses


@pytest.fixture
def make_bench() -> Callable[..., Bench]:
    """`make_bench(board={…}, driver={…})`: both with their defaults but for these settings; not yet open."""

    def made(board: dict[str, Any] | None = None, driver: dict[str, Any] | None = None) -> Bench:
        return Bench(board or {}, driver or {})

    return made


@pytest.fixture
def bench(make_bench: Callable[..., Bench]) -> Bench:
    """An open board."""
    made = make_bench()
    made.device.open()
    return made
