"""What a bench shows before a run: the doctor, and whether it rests."""

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from controller.doctor import LISTEN_S, computer, examine, summary
from controller.guard import GuardSettings
from controller.quiet import unrest
from controller.rig import Rig, TrialScene
from drivers.core.clock import VirtualClock
from drivers.core.errors import SilentError
from drivers.core.messages import DeviceInfo, Listen, Lost, SampleBlock, Saturated, Stalled, StreamInfo
from tests.refusals import check_refusal

SCENE = TrialScene(0, 0, {})


class Sensor:
    """A device with one stream of what the test gives it, once a turn."""

    def __init__(
        self, name, clock, value=1.0, rate_hz=100.0, error=None, noisy=False, details=None, ends_s=99.0,
        found=None,
    ):  # fmt: skip
        self.found = found or {}
        self.name, self.clock, self.value, self.rate_hz = name, clock, value, rate_hz
        self.error, self.noisy, self.details, self.ends_s = error, noisy, details or {}, ends_s
        self.commands, self.statuses, self.seq, self.closed = [], [], 0, False

    def open(self):
        if self.error:
            raise self.error
        stream = StreamInfo(f"{self.name}.force", ("fx",), "N", rate_hz=self.rate_hz, noisy=self.noisy)
        return DeviceInfo(self.name, "LC-5", serial="17", streams={stream.name: stream}, details=self.details)

    def close(self):
        self.closed = True

    def apply(self, command):
        self.commands.append(command)

    def read(self):
        now_s = self.clock.now()
        if self.value is None or now_s > self.ends_s:
            return []
        self.seq += 1
        values = np.array([[self.value(self.seq) if callable(self.value) else self.value]])
        return [SampleBlock(f"{self.name}.force", self.seq, now_s, values, rate_hz=100.0, unit="N")]

    def account(self):
        return self.found

    def poll(self):
        statuses, self.statuses = self.statuses, []
        return statuses


def lines(*devices, **more):
    clock = devices[0].clock
    return list(examine(Rig("mock", {device.name: device for device in devices}, clock), SCENE, **more))


@pytest.fixture
def clock():
    return VirtualClock()


def test_every_device_is_named_and_every_sensor_read_and_asked_for_nothing_but_to_listen(clock):
    sensor = Sensor("cell", clock, value=0.25)
    named, read = lines(sensor)
    assert named.line == "cell: LC-5, serial 17"
    assert read.line == "    cell.force: 100 samples in 1 s, fx 0.25 +- 0 N"
    assert named.verdict == read.verdict == "ok"
    assert sensor.commands == [Listen("cell", frozenset({"cell.force"})), Listen("cell", frozenset())]
    assert sensor.closed


def test_a_silent_sensor_is_found_and_an_irregular_one_may_be_silent(clock):
    silent = lines(Sensor("cell", clock, value=None))
    assert [finding.verdict for finding in silent] == ["ok", "fail"]
    assert summary(silent) == "1 ok, 0 warn, 1 fail"
    assert all(finding.verdict == "ok" for finding in lines(Sensor("cell", clock, value=None, rate_hz=None)))


def test_lost_samples_are_found_and_are_no_other_rate(clock):
    sensor = Sensor("cell", clock, rate_hz=112.0)
    sensor.statuses = [Lost(0.5, "cell", "cell.force", 12)]
    *others, finding = lines(sensor)
    assert finding.verdict == "fail"
    check_refusal(finding.line, "cell.force: 12 samples lost", "cable")
    assert {other.verdict for other in others} == {"ok"}


def test_what_is_lost_again_and_again_is_one_line_with_a_count(clock):
    sensor = Sensor("cell", clock, rate_hz=105.0)
    sensor.statuses = [Lost(0.1 * k, "cell", "cell.force", 1) for k in range(5)]
    sensor.statuses += [Stalled(0.5, "cell", "it is too hot")] * 3
    few, many = lines(sensor)[2:]
    assert few.verdict == "warn"
    check_refusal(few.line, "5 samples lost in 5 places")
    assert (many.verdict, many.line.strip()) == ("fail", "stalled: it is too hot (3 times)")


def test_a_device_that_does_not_open_hides_no_other_and_all_are_closed_where_the_reader_leaves(clock):
    deaf = Sensor("stage", clock, error=SilentError("stage", "opening", "no reply", "is it on?"))
    findings = lines(deaf, Sensor("cell", clock))
    assert (findings[0].verdict, findings[0].line) == ("fail", "stage: no reply while opening; is it on?")
    assert findings[1].line.startswith("cell: ")
    assert deaf.closed
    sensor = Sensor("cell", clock)
    early: Any = examine(Rig("mock", {"cell": sensor}, clock), SCENE)
    next(early)
    early.close()
    assert sensor.closed


@pytest.mark.parametrize(
    ("sensor", "verdict", "named"),
    [
        ({"value": lambda k: 0.01 * k + 0.001 * (k % 2)}, "warn", ["drifts by 0.5 N", "warm up"]),
        ({"value": np.nan}, "fail", ["not finite"]),
        ({"value": 0.25, "noisy": True}, "fail", ["repeats one value", "plugged in"]),
        ({"value": lambda k: k % 2, "rate_hz": 104.0}, "warn", ["100 Hz", "104", "correct its rate"]),
        ({"value": lambda k: k % 2, "found": {"warning": "cell: its clock"}}, "warn", ["cell: its clock"]),
        ({"value": lambda k: k % 2, "details": {"safety_status": "FAULT"}}, "warn", ["is FAULT", "pendant"]),
        ({"value": lambda k: k % 2, "details": {"speed_slider": 0.3}}, "warn", ["speed_slider is 0.3", "slider"]),
    ],
)  # fmt: skip
def test_what_is_wrong_with_a_sensor_or_a_state_is_one_line_with_a_remedy(clock, sensor, verdict, named):
    (finding,) = [finding for finding in lines(Sensor("cell", clock, **sensor)) if finding.verdict != "ok"]
    assert finding.verdict == verdict
    check_refusal(finding.line, "cell", *named)


def test_a_watchdog_is_left_to_act_and_one_that_does_not_is_a_failure(clock):
    for ends_s, verdict in ((LISTEN_S + 1.0, "ok"), (99.0, "fail")):
        finding = lines(Sensor("cell", clock, ends_s=ends_s), watchdogs={"cell": 1.0})[-1]
        assert finding.verdict == verdict
        check_refusal(finding.line, "cell", "watchdog of 1 s")


@pytest.mark.parametrize("rate_hz", [100.0, None])
def test_of_a_device_that_sends_nothing_no_watchdog_is_said_to_act(clock, rate_hz):
    finding = lines(Sensor("cell", clock, value=None, rate_hz=rate_hz), watchdogs={"cell": 1.0})[-1]
    assert finding.verdict == "warn"
    check_refusal(finding.line, "cell", "watchdog of 1 s is not shown")


def test_a_port_that_this_user_may_not_open_is_named_with_what_to_do(monkeypatch, tmp_path):
    port = SimpleNamespace(
        device=str(tmp_path / "ttyACM0"), manufacturer="Zaber", product="X-MCC", description="", vid=0x2939, pid=0x495B
    )  # fmt: skip
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    monkeypatch.setattr("os.access", lambda *_: False)
    monkeypatch.setattr("os.geteuid", lambda: 1000)
    monkeypatch.setattr("resource.getrlimit", lambda _: (0, 0))
    used, realtime = computer({"stage": port.device})
    assert (used.verdict, realtime.verdict) == ("fail", "warn")
    check_refusal(used.line, "Zaber, X-MCC", "stage", "usermod -aG dialout", 'idVendor}=="2939"', '"495b"')
    check_refusal(realtime.line, "rtprio", "limits.d")
    monkeypatch.setattr("os.access", lambda *_: True)
    (other, _) = computer({"stage": "/dev/elsewhere"})
    assert other.verdict == "ok"
    assert "not used by this profile" in other.line


WATCHED = {"force_stream": "board.load_cell", "position_stream": "stage.position"}
LIMITS = GuardSettings(travel_m=0.01, speed_m_s=0.01, force_n=2.0, **WATCHED)

NOISE_N = 0.01 * np.random.default_rng(1).standard_normal((10_000, 1))


def of(stream, values):
    """Ten seconds of a stream, in blocks."""
    parts = np.array_split(values, 100)
    places = np.cumsum([0, *map(len, parts)])
    rate_hz = len(values) / 10.0
    cut = zip(places[:-1], parts, strict=True)
    return [SampleBlock(stream, int(at), at / rate_hz, part, rate_hz=rate_hz) for at, part in cut]


def reasons(*blocks, events=(), limits=LIMITS):
    return list(unrest([each for own in blocks for each in own], events, limits))


def test_noise_a_place_that_stays_slow_drift_and_a_wave_are_rest():
    places_m = 0.003 + 1e-5 * NOISE_N / NOISE_N.std()
    assert reasons(of("board.load_cell", NOISE_N), of("stage.position", places_m)) == []
    assert reasons(of("board.taxel", np.zeros((1000, 2)))) == []
    ramp = NOISE_N + np.linspace(0.0, 0.1, 10_000)[:, None]
    wave = np.sin(2.0 * np.pi * 28.0 * np.arange(10_000) / 1000.0)[:, None]
    assert reasons(of("board.load_cell", ramp), of("board.accelerometer", wave)) == []
    none = LIMITS.model_copy(update={"force_n": None})
    assert reasons(of("board.load_cell", NOISE_N + 0.3), limits=none) == [], "a load without a limit"


@pytest.mark.parametrize(
    ("stream", "values", "named"),
    [
        ("stage.position", 0.001 + np.linspace(0.0, 2e-4, 1000)[:, None], ("went 0.20 mm",)),
        ("board.load_cell", NOISE_N + 0.3, ("reads 0.3 N", "tare")),
        ("board.load_cell", NOISE_N - 0.3, ("reads 0.3 N",)),
        ("board.finger", NOISE_N + 0.1 * (np.arange(10_000) >= 4000)[:, None], ("4 s after", "touched")),
    ],
)
def test_motion_a_load_and_a_touch_are_none(stream, values, named):
    (line,) = reasons(of(stream, values))
    check_refusal(line, stream, *named)


def test_a_stream_beyond_its_range_is_none():
    (line,) = reasons(events=[Saturated(1.0, "signals", "signals.tip", 12.0)])
    check_refusal(line, "signals.tip", "12")
