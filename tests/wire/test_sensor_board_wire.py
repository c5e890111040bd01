"""The real driver with real pyserial on a pty, an emulated board at its far end, on the wall clock."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
import pytest
from numpy.typing import NDArray

from drivers.core.messages import Excite, Failed, Listen, Lost, SampleBlock, Status
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from simulator.devices.sensor_board import EmulatedSensorBoard, EmulatedSensorBoardSettings

FORCE = "board.load_cell"
ACCELERATION = "board.accelerometer"
PERIOD = "board.period"

Floats = NDArray[np.float64]


class Spec(NamedTuple):
    name: str
    channels: tuple[str, ...]
    unit: str
    scale: float
    rate_hz: float | None


class Source:
    """Every stream is the true time, in seconds of the bench since the source was made."""

    def __init__(self, begin_s: float) -> None:
        self.begin_s = begin_s
        self.sampled = {spec.name: 0 for spec in self.streams()}
        self.excited = False
        self._reported_s = self._t_s = 0.0

    def streams(self) -> Sequence[Spec]:
        return (
            Spec("accelerometer", ("z",), "m/s2", 1e-6, 1000.0),
            Spec("load_cell", ("force",), "N", 1e-6, 1000.0),
            Spec("period", ("period",), "s", 1e-6, None),
        )

    def advance(self, t_s: float, observe: frozenset[str]) -> None:
        self._t_s = t_s - self.begin_s

    def sample(self, stream: str, times_s: Floats) -> Floats:
        self.sampled[stream] += len(times_s)
        return times_s - self.begin_s

    def events(self, stream: str) -> tuple[Floats, Floats]:
        """30 a second."""
        times_s = np.arange(np.floor(self._reported_s * 30) + 1, np.floor(self._t_s * 30) + 1) / 30
        self._reported_s = self._t_s
        return times_s + self.begin_s, times_s

    def excite(self, on: bool) -> None:
        self.excited = on

    def set_tendon(self, position_m: float) -> None:
        pass


class Bench:
    """An open driver, and the board and source at the far end of its port."""

    def __init__(self, serve: Any, board: dict[str, Any], driver: dict[str, Any]) -> None:
        self.clock = serve.clock
        self.source = Source(self.clock.monotonic_s())
        settings = EmulatedSensorBoardSettings(adc_bits={}, **board)
        self.board = EmulatedSensorBoard(settings, self.source)
        self.port = serve(self.board)
        self._lock = serve.lock(self.port)
        self.driver = SensorBoard("board", SensorBoardSettings(port=self.port, **driver), self.clock)
        self.info = self.driver.open()

    def listen(self, *streams: str) -> None:
        self.driver.apply(Listen("board", frozenset(streams)))

    def inject(self, kind: Any, frames: int = 1) -> None:
        with self._lock:
            self.board.inject(kind, self.clock.monotonic_s(), frames)

    def run(self, seconds: float) -> tuple[list[SampleBlock], list[Status]]:
        blocks: list[SampleBlock] = []
        statuses: list[Status] = []
        until_s = self.clock.monotonic_s() + seconds
        while self.clock.monotonic_s() < until_s:
            blocks += self.driver.read()
            statuses += self.driver.poll()
            self.clock.rest(0.002)
        return blocks, statuses

    def lateness_s(self, blocks: list[SampleBlock]) -> Floats:
        """By how much samples are dated too late: each holds the time at which it was taken."""
        true_s = np.concatenate([block.physical[:, 0] for block in blocks])
        origin_s = self.clock.from_monotonic(self.source.begin_s)
        return np.concatenate([block.times for block in blocks]) - (true_s + origin_s)


@contextmanager
def opened(serve: Any, board: dict[str, Any] | None = None, **driver: Any) -> Iterator[Bench]:
    patient = {"watchdog_s": 5.0, "silence_timeout_s": 2.0}  # the machine may be busy with other tests
    bench = Bench(serve, board or {}, {**patient, **driver})
    try:
        yield bench
    finally:
        bench.driver.close()


def of(kind: type, statuses: list[Status]) -> list[Any]:
    return [status for status in statuses if isinstance(status, kind)]


def test_streams_come_whole_and_dated_by_the_board(serve: Any) -> None:
    with opened(serve) as bench:
        assert set(bench.info.streams) == {FORCE, ACCELERATION, PERIOD}
        bench.listen(FORCE, ACCELERATION, PERIOD)
        blocks, statuses = bench.run(1.2)
        bench.listen()
        tail, more = bench.run(0.1)
        for stream in (FORCE, ACCELERATION):
            mine = [block for block in blocks + tail if block.stream == stream]
            assert sum(map(len, mine)) == bench.source.sampled[stream.partition(".")[2]] > 1000
            assert [block.seq for block in mine] == list(np.cumsum([0, *map(len, mine)])[:-1])
            # As late as the quickest of a second's frames at the most: the server looks every millisecond.
            assert np.median(np.abs(bench.lateness_s(mine))) < 5e-3
        periods = [block for block in blocks if block.stream == PERIOD]
        assert np.median(np.abs(bench.lateness_s(periods))) < 5e-3
        assert of(Lost, statuses + more) == of(Failed, statuses + more) == []


def test_a_poor_clocks_drift_is_recovered_from_its_arrivals(serve: Any) -> None:
    """480 ppm slow, seen within 100 ppm after 2.4 s: 0.24 ms of disagreement between quickest frames."""
    with opened(serve, {"drift_ppm": -480.0, "block_samples": 2}, max_drift_ppm=2000.0) as bench:
        bench.listen(FORCE)
        for _ in range(10):  # a machine that stalls makes arrivals late: then it takes longer
            blocks, _ = bench.run(2.4)
            if abs(bench.driver.account()["drift_ppm"] + 480.0) < 100.0:
                break
        assert bench.driver.account()["drift_ppm"] == pytest.approx(-480.0, abs=100.0)
        assert np.median(np.abs(bench.lateness_s(blocks))) < 5e-3


def test_loss_is_counted_to_the_sample_under_drops_flips_and_truncations(serve: Any) -> None:
    with opened(serve) as bench:
        bench.listen(FORCE, ACCELERATION)
        blocks, statuses = bench.run(0.2)
        for kind in ("drop", "flip", "truncate") * 3:
            bench.inject(kind)
            more = bench.run(0.1)
            blocks += more[0]
            statuses += more[1]
        last = bench.run(0.2)
        bench.listen()
        tail = bench.run(0.1)
        blocks += last[0] + tail[0]
        statuses += last[1] + tail[1]
        for stream in (FORCE, ACCELERATION):
            came = sum(len(block) for block in blocks if block.stream == stream)
            lost = sum(status.samples for status in of(Lost, statuses) if status.stream == stream)
            assert came + lost == bench.source.sampled[stream.partition(".")[2]]
        # Each fault costs a frame of ten, and each lost delimiter its neighbour, unless that is a reply.
        assert 90 <= sum(status.samples for status in of(Lost, statuses)) <= 120
        assert of(Failed, statuses) == []


def test_a_closed_driver_leaves_nothing_on(serve: Any) -> None:
    with opened(serve) as bench:
        bench.driver.apply(Excite("board", True))
        bench.listen(FORCE)
        bench.run(0.1)
        assert bench.source.excited
    assert not bench.source.excited


def test_a_pulled_plug_has_failed_once(serve: Any) -> None:
    with opened(serve) as bench:
        bench.listen(FORCE)
        bench.run(0.1)
        serve.unplug(bench.port)
        (failed,) = of(Failed, bench.run(0.3)[1])
        assert "the port" in failed.reason
