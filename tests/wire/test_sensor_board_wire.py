"""The real driver with real pyserial on a pty, an emulated board at its far end, on the wall clock."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import pytest

from drivers.core.messages import Excite, Failed, Lost
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from simulator.devices.sensor_board import EmulatedSensorBoard, EmulatedSensorBoardSettings
from tests.contracts.crank import Crank
from tests.unit.drivers.sensor_board.conftest import Floats, Source
from tests.wire.conftest import Serve, Wired

FORCE, ACCELERATION, PERIOD = "board.load_cell", "board.accelerometer", "board.period"


class Timed(Source):
    """Every stream is the true time, in seconds of the bench since the source was made."""

    def sample(self, stream: str, times_s: Floats) -> Floats:
        sampled = super().sample(stream, times_s)
        return np.column_stack([times_s - self.begin_s] * 2) if sampled.ndim == 2 else sampled

    def events(self, stream: str) -> tuple[Floats, Floats]:
        times_s, _ = super().events(stream)
        return times_s, times_s - self.begin_s


class Bench(Wired, Crank):
    """An open driver, and the board and source at the far end of its port."""

    def __init__(self, serve: Serve, board: dict[str, Any], driver: dict[str, Any]) -> None:
        self.source = Timed(serve.clock.monotonic_s())
        settings = EmulatedSensorBoardSettings(adc_bits={}, **board)
        Wired.__init__(self, serve, EmulatedSensorBoard(settings, self.source))
        opened = SensorBoard("board", SensorBoardSettings(port=self.port, **driver), self.clock)
        Crank.__init__(self, opened, self.clock)

    def lateness_s(self, stream: str) -> Any:
        """How much too late samples are dated in the middle: each holds the time at which it was taken."""
        blocks = self.blocks_of(stream)
        true_s = np.concatenate([block.physical[:, 0] for block in blocks])
        origin_s = self.clock.from_monotonic(self.source.begin_s)
        return np.median(np.abs(np.concatenate([block.times for block in blocks]) - (true_s + origin_s)))


@contextmanager
def opened(serve: Serve, board: dict[str, Any] | None = None, **driver: Any) -> Iterator[Bench]:
    patient = {"watchdog_s": 5.0, "silence_timeout_s": 2.0}  # the machine may be busy with other tests
    bench = Bench(serve, board or {}, {**patient, **driver})
    try:
        yield bench
    finally:
        bench.device.close()


def test_streams_come_whole_and_dated_by_the_board(serve: Serve) -> None:
    with opened(serve) as bench:
        assert set(bench.info.streams) == {FORCE, ACCELERATION, PERIOD}
        bench.listen(FORCE, ACCELERATION, PERIOD)
        bench.turn(1.2)
        bench.listen()
        bench.turn(0.1)
        for stream in (FORCE, ACCELERATION):
            mine = bench.blocks_of(stream)
            assert sum(map(len, mine)) == bench.source.sampled[stream.partition(".")[2]] > 1000
            assert [block.seq for block in mine] == list(np.cumsum([0, *map(len, mine)])[:-1])
        for stream in (FORCE, ACCELERATION, PERIOD):
            # As late as the quickest of a second's frames at the most: the server looks every millisecond.
            assert bench.lateness_s(stream) < 5e-3
        assert bench.of(Lost) == bench.of(Failed) == []


def test_a_poor_clocks_drift_is_recovered_from_its_arrivals(serve: Serve) -> None:
    """480 ppm slow, seen within 100 ppm after 2.4 s: 0.24 ms of disagreement between quickest frames."""
    with opened(serve, {"drift_ppm": -480.0, "block_samples": 2}, max_drift_ppm=2000.0) as bench:
        bench.listen(FORCE)
        for _ in range(10):  # a machine that stalls makes arrivals late: then it takes longer
            bench.blocks.clear()
            bench.turn(2.4)
            if abs(bench.device.account()["drift_ppm"] + 480.0) < 100.0:
                break
        assert bench.device.account()["drift_ppm"] == pytest.approx(-480.0, abs=100.0)
        assert bench.lateness_s(FORCE) < 5e-3


def test_a_closed_driver_leaves_nothing_on(serve: Serve) -> None:
    with opened(serve) as bench:
        bench.device.apply(Excite("board", True))
        bench.listen(FORCE)
        bench.turn(0.1)
        assert bench.source.excited
    assert not bench.source.excited
