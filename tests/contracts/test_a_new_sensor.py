"""A serial sensor made by docs/how-to/add_a_device.md, on its emulated twin, in virtual time."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from simulator.look_ahead import Snapshot
from simulator.physics.bench import Bench
from tests.contracts.crank import Crank
from tests.contracts.sensor_suite import SensorContract
from tests.data.force_sensor.device import EmulatedForceSensor, MockForceSensor
from tests.data.force_sensor.driver import ForceSensor, ForceSensorSettings, encode
from touchbench import (
    CodecError,
    Failed,
    Fault,
    FaultSchedule,
    LineIdentity,
    LineSample,
    Listen,
    Lost,
    MoveTo,
    Sent,
    Settings,
    SilentError,
    StageAxis,
    StreamInfo,
    VirtualClock,
)

FORCE = "scale.force"

ROOM = Path("tests/data/force_sensor")


class Weighed:
    """A bench whose tool is pressed with 1.5 N, all the time."""

    def feel(self, on: bool) -> None:
        """There is nothing to compute."""

    advance = feel

    def wrench(self, times_s: np.ndarray, direction: tuple[float, ...]) -> np.ndarray:
        return np.tile([*(-1.5 * np.array(direction)), 0.0, 0.0, 0.0], (len(times_s), 1))


def sensor(*faults: Fault) -> MockForceSensor:
    settings = ForceSensorSettings(port="mock")
    return MockForceSensor("scale", settings, VirtualClock(), Weighed(), FaultSchedule(faults))


@pytest.fixture
def bench() -> Crank:
    return Crank(sensor())


def test_a_new_serial_sensor_with_far_end_and_mock_costs_less_than_130_lines_of_its_own() -> None:
    own = [line for name in ("driver.py", "device.py") for line in (ROOM / name).read_text().splitlines()]
    assert len(own) < 130
    assert len((ROOM / "driver.py").read_text().splitlines()) < 70


@pytest.mark.parametrize(
    ("line", "message"),
    [
        (
            b"id FS1 0042 100 0.001 *31",
            LineIdentity(
                "FS1",
                "0042",
                StreamInfo(FORCE, ("force",), "N", 0.001, 100.0, noisy=True),
                4294967.296,
                65536,
            ),
        ),
        (b"s 65535 655350 -12 *4D", LineSample((-12,), 655.35, 65535)),
    ],
)
def test_golden_lines(line: bytes, message: LineIdentity | LineSample) -> None:
    assert ForceSensor("scale", ForceSensorSettings(port="mock"), VirtualClock()).parse(line) == message


@pytest.mark.parametrize(
    "line", [b"s 1 2 3 *00", b"s 1 2 3", encode("s 1 2 x")[:-1], encode("hello")[:-1], b"\xff *00"]
)
def test_a_line_that_is_not_its_own_is_an_error_of_the_codec(line: bytes) -> None:
    with pytest.raises(CodecError):
        ForceSensor("scale", ForceSensorSettings(port="mock"), VirtualClock()).parse(line)


def test_a_number_that_is_none_is_counted_and_does_not_end_the_loop() -> None:
    one = ForceSensor("scale", ForceSensorSettings(port="mock"), VirtualClock())
    assert list(one._messages(encode("id FS1 0042 fast 0.001"))) == []
    assert one.account()["malformed"] == 1


class TestForceSensor(SensorContract):
    stream = FORCE
    senseless = (MoveTo("scale", 0.0, 0.01), Listen("scale", frozenset({"scale.torque"})))


def test_it_identifies_itself_and_what_it_sends(bench: Crank) -> None:
    assert (bench.info.model, bench.info.serial) == ("FS1", "0042")
    assert bench.info.streams[FORCE].unit == "N"


def test_samples_are_numbered_dated_and_scaled(bench: Crank) -> None:
    bench.listen(FORCE)
    bench.turn(2.0)
    assert len(bench.of(Sent)) == 1
    blocks = bench.blocks_of(FORCE)
    assert sum(map(len, blocks)) == 200
    for before, after in pairwise(blocks):
        assert after.seq == before.seq + len(before)
        assert after.t0_s > before.t0_s
    assert blocks[-1].physical[-1, 0] == pytest.approx(1.5)
    assert not bench.of(Lost)


def test_decimals_that_a_sensor_prints_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = ForceSensor.parse

    def decimal(self: ForceSensor, line: bytes) -> LineIdentity | LineSample | None:
        found = whole(self, line)
        return found._replace(counts=(found.counts[0] / 8.0,)) if isinstance(found, LineSample) else found

    monkeypatch.setattr(ForceSensor, "parse", decimal)
    bench = Crank(sensor())
    bench.listen(FORCE)
    bench.turn(0.2)
    assert bench.blocks_of(FORCE)[-1].physical[-1, 0] == pytest.approx(1.5 / 8.0)  # 187.5 counts


def test_lost_samples_are_reported() -> None:
    bench = Crank(sensor(Fault(device="scale", kind="lose", at_s=1.0, for_s=0.1)))
    bench.listen(FORCE)
    bench.turn(2.0)
    assert sum(lost.samples for lost in bench.of(Lost)) == pytest.approx(10, abs=1)


def test_one_that_falls_silent_fails_once() -> None:
    bench = Crank(sensor(Fault(device="scale", kind="silent", at_s=1.0)))
    bench.listen(FORCE)
    bench.turn(3.0)
    (failed,) = bench.of(Failed)
    assert failed.reason == "no sample in 0.5 s; is it powered?"


def test_one_that_is_not_there_is_reported_as_silent() -> None:
    device = sensor(Fault(device="scale", kind="silent", at_s=0.0))
    with pytest.raises(
        SilentError, match=r"^scale: no answer in 2 s while asking who is at mock; is it powered"
    ):
        device.open()


def test_one_that_is_opened_again_hands_out_nothing_of_before(bench: Crank) -> None:
    bench.listen(FORCE)
    assert bench.device._statuses
    bench.device.close()
    bench.device.open()
    assert (bench.device.read(), bench.device.poll()) == ([], [])


def test_each_sample_arrives_when_it_was_sent_however_seldom_anybody_looks() -> None:
    """The mock bench takes quiet turns together, and goes back where something happened in them."""
    found = []
    for turns in (1, 40):
        device = sensor()
        device.open()
        clock = device._clock
        device.apply(Listen("scale", frozenset({FORCE})))
        blocks = []
        for turn in range(turns, 401, turns):
            before = Snapshot([clock, device])
            clock.wait_until(turn * 0.005)
            device.read()
            before.restore()
            clock.wait_until(turn * 0.005)
            blocks += device.read()
        times_s = np.concatenate([block.t0_s + np.arange(len(block)) / block.rate_hz for block in blocks])
        found.append(times_s)
    assert len(found[0]) == 200
    np.testing.assert_allclose(found[0], found[1], rtol=0.0, atol=1e-9)
    np.testing.assert_allclose(found[0], np.arange(1, 201) / 100.0, rtol=0.0, atol=1e-9)


@pytest.mark.parametrize("trial_s", [2.0, 20.0])
def test_a_trial_begins_anew(trial_s: float) -> None:
    device = sensor()
    bench = Crank(device, device._clock)
    for _ in range(2):
        bench.listen(FORCE)
        bench.turn(trial_s)
        assert bench.blocks_of(FORCE)[0].t0_s == pytest.approx(0.01)
        assert bench.of(Lost) == []
        bench.listen()
        bench.clock.restart()
        device.restart()
        bench.blocks.clear()


def test_a_far_end_that_carries_the_tool_is_mounted_anew_at_each_trial() -> None:
    class Carrying(MockForceSensor):
        """Its far end moves the tool."""

        @staticmethod
        def _far_end(settings: object, bench: Bench) -> EmulatedForceSensor:  # type: ignore[override]
            bench.mount(StageAxis(acceleration_m_s2=1.0, max_speed_m_s=0.1))
            return EmulatedForceSensor(settings, bench)

    bench = Bench(Settings(), "probe")
    device = Carrying("scale", ForceSensorSettings(port="mock"), VirtualClock(), bench)
    device.open()
    first = bench.mover
    device.restart()
    assert bench.mover is not first
