"""The NI-DAQmx driver: the maker's own client over gRPC, to a server of the eleven calls that it makes."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from concurrent import futures
from typing import Any

import grpc
import nidaqmx
import numpy as np
import pytest
from nidaqmx._stubs import nidaqmx_pb2 as pb
from nidaqmx._stubs import nidaqmx_pb2_grpc
from nidaqmx.errors import DaqNotFoundError

from drivers.core.clock import WallClock
from drivers.core.errors import CommandError, PortError, RefusedError
from drivers.core.messages import Failed, Lost, Refused, Sent, Stop, Tare
from drivers.ni_daq.driver import NiDaq
from drivers.ni_daq.settings import NiDaqSettings
from tests.contracts.crank import Crank
from tests.refusals import refused

FORCE, AXES = "daq.force", "daq.axes"
STREAMS = {
    "force": {"inputs": ("ai2",), "unit": "N", "scale": -2.0, "offset": 0.5},
    "axes": {"inputs": ("ai0", "ai1"), "unit": "m/s2", "channels": ("x", "y")},
}
NO_DEVICE = -200220


class Device(nidaqmx_pb2_grpc.NiDAQmxServicer):  # type: ignore[misc]
    """`Dev1`: input c of a task shows c V and a tenth of a millivolt more with each sample."""

    def __init__(self) -> None:
        self.inputs: list[Any] = []
        self.rate_hz = self.given_hz = 0.0
        self.begun_s = 0.0
        self.number = 0
        self.cleared = 0

    def GetSystemInfoAttributeUInt32(self, request, context):  # noqa: N802
        return pb.GetSystemInfoAttributeUInt32Response()

    def GetDeviceAttributeString(self, request, context):  # noqa: N802
        if request.device_name != "Dev1":
            context.set_trailing_metadata((("ni-error", str(NO_DEVICE)),))
            context.abort(grpc.StatusCode.UNKNOWN, "Device identifier is invalid.\n\nTask Name: t")
        return pb.GetDeviceAttributeStringResponse(value="USB-6001")

    def GetDeviceAttributeUInt32(self, request, context):  # noqa: N802
        return pb.GetDeviceAttributeUInt32Response(value=0x1A2B3C)

    def CreateTask(self, request, context):  # noqa: N802
        response = pb.CreateTaskResponse(new_session_initialized=True)
        response.task.name = "t"
        return response

    def GetTaskAttributeString(self, request, context):  # noqa: N802
        names = ", ".join(made.physical_channel for made in self.inputs)
        return pb.GetTaskAttributeStringResponse(value=names)

    def CreateAIVoltageChan(self, request, context):  # noqa: N802
        self.inputs.append(request)
        return pb.CreateAIVoltageChanResponse()

    def CfgSampClkTiming(self, request, context):  # noqa: N802
        self.rate_hz = self.given_hz or request.rate
        return pb.CfgSampClkTimingResponse()

    def GetTimingAttributeDouble(self, request, context):  # noqa: N802
        return pb.GetTimingAttributeDoubleResponse(value=self.rate_hz)

    def StartTask(self, request, context):  # noqa: N802
        self.begun_s = time.monotonic()
        return pb.StartTaskResponse()

    def ReadAnalogF64(self, request, context):  # noqa: N802
        n = request.num_samps_per_chan
        number = self.number + np.arange(n)
        self.number += n
        time.sleep(max(0.0, self.begun_s + self.number / self.rate_hz - time.monotonic()))
        volts = np.arange(len(self.inputs))[:, None] + 1e-4 * number
        return pb.ReadAnalogF64Response(read_array=volts.ravel().tolist(), samps_per_chan_read=n)

    def ClearTask(self, request, context):  # noqa: N802
        self.cleared += 1
        return pb.ClearTaskResponse()


@pytest.fixture
def device() -> Device:
    return Device()


@pytest.fixture
def server(device: Device) -> Iterator[tuple[str, Callable[[], Any]]]:
    made = grpc.server(futures.ThreadPoolExecutor(4))
    nidaqmx_pb2_grpc.add_NiDAQmxServicer_to_server(device, made)
    port = made.add_insecure_port("127.0.0.1:0")
    made.start()
    yield f"127.0.0.1:{port}", lambda: made.stop(None)
    made.stop(None)


def daq(where: str | None, **changes: Any) -> NiDaq:
    # The machine may be busy: what is late by seconds is no fault here.
    given = {
        "port": "Dev1",
        "server": where,
        "rate_hz": 1000.0,
        "silence_timeout_s": 20.0,
        "streams": STREAMS,
    }
    return NiDaq("daq", NiDaqSettings.model_validate({**given, **changes}), WallClock())


def test_inputs_come_by_name_number_and_the_device_s_clock(server: Any, device: Device) -> None:
    bench = Crank(daq(server[0], terminal="rse", range_v=5.0), WallClock())
    assert (bench.info.model, bench.info.serial) == ("USB-6001", "1A2B3C")
    assert [one.physical_channel for one in device.inputs] == ["Dev1/ai2", "Dev1/ai0", "Dev1/ai1"]
    assert {(one.min_val, one.max_val) for one in device.inputs} == {(-5.0, 5.0)}
    bench.turn(0.05)
    assert bench.blocks == []
    bench.listen(FORCE, AXES)
    while sum(map(len, bench.blocks_of(AXES))) < 300:
        bench.turn(0.05)
    assert bench.of(Lost) == []
    force, axes = bench.blocks_of(FORCE), bench.blocks_of(AXES)
    numbers = np.concatenate([block.seq + np.arange(len(block)) for block in force])
    assert (np.diff(numbers) == 1).all()
    # -2 N a volt from 0.5 V on; input 0 shows 1e-4 V more with each sample.
    values = np.concatenate([block.physical[:, 0] for block in force])
    assert values == pytest.approx(-2.0 * (1e-4 * numbers - 0.5))
    second = np.concatenate([block.physical[:, 1] for block in axes])
    assert second == pytest.approx(2.0 + 1e-4 * numbers[: len(second)])
    times_s = np.concatenate([block.times for block in force])
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
    assert device.cleared == 1


def test_a_tare_takes_the_latest_samples_for_zero(server: Any) -> None:
    bench = Crank(daq(server[0]), WallClock())
    bench.device.apply(Tare("daq", FORCE))
    assert "listen to it first" in bench.until(Refused).reason
    bench.listen(FORCE)
    bench.turn(0.2)
    bench.statuses.clear()
    bench.device.apply(Tare("daq", FORCE))
    bench.until(Sent)
    bench.blocks.clear()
    bench.turn(0.1)
    assert abs(bench.blocks_of(FORCE)[0].physical[0, 0]) < 0.02, (
        "50 samples of 0.2 mN more each, and a few since"
    )
    with refused(CommandError, "daq: ", "Stop", "Listen and Tare"):
        bench.device.apply(Stop("daq"))
    bench.device.close()


def test_a_server_that_goes_ends_the_run(server: Any) -> None:
    bench = Crank(daq(server[0]), WallClock())
    bench.listen(FORCE)
    bench.turn(0.1)
    server[1]()
    assert "task has ended" in bench.until(Failed, 30.0).reason
    bench.device.close()


def test_what_does_not_fit_is_refused_at_opening(server: Any, device: Device) -> None:
    with refused(PortError, "daq: ", "Device identifier is invalid", "NI MAX"):
        daq(server[0], port="Dev2").open()
    device.given_hz = 1000.1
    with refused(RefusedError, "daq: ", "1000.1 times a second", "rate_hz = 1000.1"):
        daq(server[0]).open()
    assert device.cleared == 1
    with refused(PortError, "daq: ", "127.0.0.1:1", "gRPC Device Server"):
        daq("127.0.0.1:1", open_timeout_s=0.3).open()


def test_a_machine_without_the_maker_s_driver_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(*_: object) -> None:
        raise DaqNotFoundError("Could not find an installation of NI-DAQmx.")

    monkeypatch.setattr(nidaqmx.system, "Device", missing)
    with refused(PortError, "daq: ", "NI-DAQmx is not installed", "server ="):
        daq(None).open()


@pytest.mark.parametrize(
    ("wrong", "message"),
    [
        ({"force": {"inputs": ("ai0",), "unit": "N", "scale": 0.0}}, "scale is 0"),
        ({"force": {"inputs": ("ai0", "ai0"), "unit": "N"}}, "ai0 stands in two places"),
        ({"force": {"inputs": ("ai0",), "unit": "N", "shows": ("a", "b")}}, "shows has 2 names for 1 inputs"),
    ],
)
def test_settings_that_no_device_can_follow_are_refused(wrong: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        daq(None, streams=wrong)
