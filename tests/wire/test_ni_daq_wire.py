"""The NI-DAQmx driver: the maker's own client over gRPC, to the emulated device's server of the calls that it makes."""

import threading
import time
from collections.abc import Iterator
from typing import Any

import nidaqmx
import numpy as np
import pytest
from nidaqmx.errors import DaqNotFoundError

from drivers.core.clock import WallClock
from drivers.core.errors import CommandError, PortError, RefusedError
from drivers.core.messages import Excite, Failed, Lost, Refused, Sent, Stop, Tare, Tone
from drivers.ni_daq.driver import NiDaq
from drivers.ni_daq.output import sine
from drivers.ni_daq.settings import DaqDrive, NiDaqSettings
from simulator.devices.ni_daq import DRIFT_PPM, EmulatedNiDaq
from simulator.devices.ni_daq_server import NiDaqServer
from simulator.physics.bench import StreamSpec
from tests.contracts.crank import Crank
from tests.refusals import refused

FORCE, AXES, TRAVEL, EVENTS = "daq.force", "daq.axes", "daq.travel", "daq.events"
STREAMS = {
    "force": {"inputs": ("ai2",), "unit": "N", "scale": -2.0, "offset": 0.5, "shows": ("ramp",)},
    "axes": {
        "inputs": ("ai0", "ai1"),
        "unit": "N",
        "channels": ("x", "y"),
        "shows": ("ramp", "ramp"),
        "noisy": True,
    },
    "travel": {"inputs": ("ctr0",), "unit": "N", "scale": -1e-3, "counts": "x4", "shows": ("ramp",)},
    "events": {"inputs": ("ctr1",), "unit": "N", "scale": 1e-10, "counts": "edges", "shows": ("ramp",)},
}
DRIVE = {"output": "ao0", "limit_v": 5.0, "on_v": 3.3, "rate_hz": 500_000.0}


class Ramp:
    """A bench with one stream, 1 N a second from its first sample on, and something that is excited."""

    origin_s = -1.0
    excited = False
    begun_s: float | None = None

    def streams(self) -> list[StreamSpec]:
        return [StreamSpec("ramp", ("ramp",), "N", 1.0, 1000.0)]

    def read(self, key: str, sources: frozenset[str]) -> None:
        pass

    def advance(self, t_s: float) -> None:
        pass

    def sample(self, source: str, times_s: Any) -> Any:
        if self.begun_s is None:
            self.begun_s = times_s[0]
        return times_s - self.begun_s

    def excite(self, on: bool) -> None:
        self.excited = on


class Served:
    """The emulated device, whose time passes with the wall's while `on`, and waits for who reads it."""

    def __init__(self) -> None:
        settings = NiDaqSettings.model_validate(
            {"port": "Dev1", "rate_hz": 1000.0, "streams": STREAMS, "drive": DRIVE}
        )
        self.bench = Ramp()
        self.server = NiDaqServer(settings, EmulatedNiDaq(settings, self.bench))  # type: ignore[arg-type]
        self.on = True
        self._begun_s = time.monotonic()
        self._thread = threading.Thread(target=self._run)
        self._thread.start()

    @property
    def where(self) -> str:
        return str(self.server.endpoint["server"])

    def close(self) -> None:
        self.on = False
        self._thread.join()
        self.server.unplug()

    def _run(self) -> None:
        t_s = 0.0
        while self.on:
            if not self.server.unread():  # the machine may be busy
                t_s = min(time.monotonic() - self._begun_s, t_s + 0.05)
                self.server.exchange((), t_s, t_s)
            time.sleep(0.002)


@pytest.fixture
def served() -> Iterator[Served]:
    made = Served()
    yield made
    made.close()


def daq(where: str | None, **changes: Any) -> NiDaq:
    # The machine may be busy: what is late by seconds is no fault here.
    given = {
        "port": "Dev1",
        "server": where,
        "rate_hz": 1000.0,
        "silence_timeout_s": 20.0,
        "streams": STREAMS,
        "drive": DRIVE,
    }
    return NiDaq("daq", NiDaqSettings.model_validate({**given, **changes}), WallClock())


def test_inputs_and_counters_come_by_name_number_and_the_device_s_clock(served: Served) -> None:
    bench = Crank(daq(served.where, terminal="rse", range_v=5.0), WallClock())
    assert (bench.info.model, bench.info.serial) == ("USB-6363", "1A2B3C")
    asked = [one for one in served.server.asked if hasattr(one, "physical_channel")]
    assert [one.physical_channel for one in asked] == ["Dev1/ai2", "Dev1/ai0", "Dev1/ai1"]
    assert {(one.min_val, one.max_val) for one in asked} == {(-5.0, 5.0)}
    assert bench.info.details["range_v"] == (-10.0, 10.0), "what it took"
    bench.turn(0.05)
    assert bench.blocks == []
    bench.listen(FORCE, AXES, TRAVEL, EVENTS)
    while sum(map(len, bench.blocks_of(EVENTS))) < 700 and not bench.of(Failed):
        bench.turn(0.05)
    assert bench.of(Lost) == []
    force = bench.blocks_of(FORCE)
    numbers = np.concatenate([block.seq + np.arange(len(block)) for block in force])
    assert (np.diff(numbers) == 1).all()
    # 1 N a second of the host's, from the first sample on; the device samples by its own clock
    ramp = numbers / (1000.0 * (1.0 + DRIFT_PPM * 1e-6))
    assert ramp[-1] > 0.43, "the counter of events, 1e10 a second, has been beyond its 32 bits"
    for stream, channels, step in ((FORCE, 1, 1e-9), (AXES, 2, 1e-9), (TRAVEL, 1, 0.6e-3), (EVENTS, 1, 1e-9)):
        values = bench.values(stream)
        assert values.shape == (len(ramp), channels)
        assert values == pytest.approx(np.tile(ramp[:, None], channels), abs=step), stream
    times_s = bench.times(FORCE)
    assert (np.diff(times_s) > 0.0).all(), (
        "while its clock is being learnt, times are squeezed, never in disorder"
    )
    assert [block.device_t0_s for block in force] == pytest.approx([block.seq * 1e-3 for block in force])
    bench.listen()
    bench.turn(0.05)
    bench.blocks.clear()
    bench.turn(0.05)
    assert bench.blocks == []
    bench.device.close()
    bench.device.close()
    assert served.server.tasks == 0


def test_a_tare_takes_the_latest_samples_for_zero(served: Served) -> None:
    bench = Crank(daq(served.where), WallClock())
    bench.device.apply(Tare("daq", FORCE))
    assert "listen to it first" in bench.until(Refused).reason
    bench.listen(FORCE)
    bench.turn(0.2)
    bench.statuses.clear()
    bench.device.apply(Tare("daq", FORCE))
    bench.until(Sent)
    zero_n = -2.0 * (bench.device.account()["zeros"][FORCE][0] - 0.5)
    latest = bench.values(FORCE)[:, 0]
    assert zero_n in [pytest.approx(latest[end - 50 : end].mean()) for end in range(50, len(latest) + 1)]
    with refused(CommandError, "daq: ", "Stop", "Excite, Tone, Listen and Tare"):
        bench.device.apply(Stop("daq"))
    bench.device.close()


def test_the_output_is_at_zero_but_for_what_is_ordered(served: Served) -> None:
    bench = Crank(daq(served.where), WallClock())
    written = served.server.written
    assert written == [0.0]
    bench.device.apply(Excite("daq", True, id=7))
    assert bench.until(Sent).command_id == 7
    bench.turn(0.05)
    assert written == [0.0, 3.3]
    until_s = time.monotonic() + 60.0  # its bench takes what was written in its own next step
    while not served.bench.excited and time.monotonic() < until_s:
        bench.turn(0.01)
    assert served.bench.excited
    bench.device.apply(Tone("daq", 40_000.0, 0.4))
    bench.until(Sent)
    assert written[2:] == [0.0, pytest.approx(2.0, rel=1e-2)]  # of 12.5 samples a period
    bench.device.apply(Excite("daq", False))
    bench.until(Sent)
    assert written[4:] == [0.0]
    bench.device.apply(Excite("daq", True))
    bench.until(Sent)
    bench.device.close()
    assert written[5:] == [3.3, 0.0, 0.0], "once before its samples end, once behind everything"


def test_an_output_that_begins_at_zero_volts_is_switched_and_plays_no_tone(served: Served) -> None:
    served.server.lowest_v = 0.0
    bench = Crank(daq(served.where), WallClock())
    bench.device.apply(Excite("daq", True))
    bench.until(Sent)
    assert served.server.written == [0.0, 3.3]
    bench.device.apply(Tone("daq", 40_000.0, 0.4))
    assert "no negative voltage" in bench.until(Refused).reason
    bench.device.close()


def test_a_failed_input_switches_the_output_off(served: Served) -> None:
    bench = Crank(daq(served.where, silence_timeout_s=0.5), WallClock())
    bench.listen(FORCE)
    bench.device.apply(Excite("daq", True))
    bench.until(Sent)
    served.on = False  # no sample any more
    assert "no sample in 0.5 s" in bench.until(Failed, 30.0).reason
    until_s = time.monotonic() + 60.0
    while served.server.written[-1] != 0.0 and time.monotonic() < until_s:
        bench.turn(0.01)
    assert served.server.written == [0.0, 3.3, 0.0]
    bench.device.close()


def test_a_sine_has_the_frequency_that_was_asked_for_in_whole_periods() -> None:
    for frequency_hz in (40_000.0, 39_999.0, 123.4, 10.0):
        volts = sine(Tone("daq", frequency_hz, 0.5), DaqDrive.model_validate(DRIVE))
        periods = np.argmax(np.abs(np.fft.rfft(volts)))
        assert periods * DRIVE["rate_hz"] / len(volts) == pytest.approx(frequency_hz, abs=1.0)
        assert np.abs(volts).max() <= 2.5
        assert np.sqrt(np.mean(volts**2)) == pytest.approx(2.5 / np.sqrt(2.0), rel=1e-6)


@pytest.mark.parametrize(
    ("command", "drive", "said"),
    [
        (Excite("daq", True), {"on_v": None}, "no on_v"),
        (Tone("daq", 40_000.0, 1.2), {}, "level is 1.2"),
        (Tone("daq", 1.0, 0.5), {}, "a period of 1 Hz"),
        (Tone("daq", 7.0, 0.5), {}, "choose 10 Hz or more"),
        (Tone("daq", 40_000.0, 0.5), {"rate_hz": 50_000.0}, "80000 samples a second"),
        (Tone("daq", 40_000.0, 0.5), {"rate_hz": None}, "80000 samples a second"),
    ],
)
def test_what_the_output_cannot_give_is_refused(command: Any, drive: Any, said: str) -> None:
    with refused(CommandError, "daq: ", said):
        daq(None, drive=DRIVE | drive).apply(command)


def test_a_server_that_goes_ends_the_run(served: Served) -> None:
    bench = Crank(daq(served.where), WallClock())
    bench.listen(FORCE)
    bench.turn(0.1)
    served.server.unplug()
    assert "task has ended" in bench.until(Failed, 30.0).reason
    bench.device.close()


def test_what_does_not_fit_is_refused_at_opening(served: Served) -> None:
    with refused(PortError, "daq: ", "Device identifier is invalid", "NI MAX"):
        daq(served.where, port="Dev2").open()
    with refused(PortError, "daq: ", "ai7 is not wired", "NI MAX"):
        daq(served.where, streams={"force": {"inputs": ("ai7",), "unit": "N"}}).open()
    served.server.given_hz = 1000.1
    with refused(RefusedError, "daq: ", "1000.1 times a second", "rate_hz = 1000.1"):
        daq(served.where).open()
    assert (served.server.tasks, served.server.written[-1]) == (0, 0.0)
    with refused(PortError, "daq: ", "127.0.0.1:1", "gRPC Device Server"):
        daq("127.0.0.1:1", open_timeout_s=0.3).open()


def test_a_machine_without_the_maker_s_driver_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise DaqNotFoundError("Could not find an installation of NI-DAQmx.")

    monkeypatch.setattr(nidaqmx.system, "Device", missing)
    with refused(PortError, "daq: ", "NI-DAQmx is not installed", "server ="):
        daq(None).open()


AI = {"inputs": ("ai0",), "unit": "N"}


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"streams": {"force": AI | {"scale": 0.0}}}, "scale is 0"),
        ({"streams": {"force": AI | {"inputs": ("ai0", "ai0")}}}, "ai0 stands in two places"),
        ({"streams": {"force": AI | {"shows": ("a", "b")}}}, "shows has 2 names for 1 sources"),
        ({"streams": {"force": AI | {"inputs": ("ctr0",)}}}, "ctr0: a counter"),
        ({"streams": {"force": AI | {"counts": "x4"}}}, "ai0: a counter"),
        ({"streams": {"turn": AI | {"inputs": ("ctr0",), "counts": "x4"}}}, "clock of the analog inputs"),
        ({"streams": {"two": AI | {"inputs": ("ctr0", "ctr1"), "counts": "x4"}}}, "a stream of its own"),
        ({"drive": DRIVE | {"on_v": -5.1}}, "on_v is -5.1, beyond limit_v, 5"),
        ({"drive": {"output": "ao0", "limit_v": 5.0}}, "it can give nothing"),
    ],
)
def test_settings_that_no_device_can_follow_are_refused(wrong: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        daq(None, **wrong)
