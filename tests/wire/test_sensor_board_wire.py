"""The real driver with real pyserial on a pty, an emulated board at its far end, on the wall clock."""

from typing import Any

import numpy as np

from drivers.core.messages import Excite, Failed, Floats, Lost
from drivers.sensor_board.driver import SensorBoard, SensorBoardSettings
from simulator.devices.sensor_board import EmulatedSensorBoard
from tests.contracts.crank import Crank
from tests.unit.drivers.sensor_board.conftest import Source
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

    def __init__(self, serve: Serve) -> None:
        self.source = Timed(serve.clock.monotonic_s())
        Wired.__init__(self, serve, EmulatedSensorBoard(self.source, adc_bits={}))
        # the machine may be busy with other tests
        settings = SensorBoardSettings(port=self.port, watchdog_s=5.0, silence_timeout_s=2.0)
        Crank.__init__(self, SensorBoard("board", settings, self.clock), self.clock)

    def lateness_s(self, stream: str) -> Any:
        """How much too late samples are dated in the middle: each holds the time at which it was taken."""
        true_s = self.values(stream)[:, 0] + self.clock.from_monotonic(self.source.begin_s)
        return np.median(np.abs(self.times(stream) - true_s))


def test_streams_come_whole_dated_by_the_board_and_a_closed_driver_leaves_nothing_on(serve: Serve) -> None:
    bench = Bench(serve)
    assert set(bench.info.streams) == {FORCE, ACCELERATION, PERIOD}
    bench.device.apply(Excite("board", True))
    bench.listen(FORCE, ACCELERATION, PERIOD)
    bench.turn(1.2)
    assert bench.source.excited
    bench.listen()
    bench.turn(0.1)
    bench.device.close()
    assert not bench.source.excited
    for stream in (FORCE, ACCELERATION):
        mine = bench.blocks_of(stream)
        assert sum(map(len, mine)) == bench.source.sampled[stream.partition(".")[2]] > 1000
        assert [block.seq for block in mine] == list(np.cumsum([0, *map(len, mine)])[:-1])
    for stream in (FORCE, ACCELERATION, PERIOD):
        # As late as the quickest of a second's frames at the most: the server looks every millisecond.
        assert bench.lateness_s(stream) < 5e-3
    assert bench.of(Lost) == bench.of(Failed) == []
