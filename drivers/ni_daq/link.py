"""A running NI-DAQmx task, and the thread that reads it."""

from __future__ import annotations

import threading
from collections import deque
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import Clock
from drivers.core.errors import DeviceError, PortError, RefusedError, lacking
from drivers.core.links import JOIN_TIMEOUT_S
from drivers.ni_daq.settings import NiDaqSettings

BUFFER_S = 2.0
"""How much the driver of the device keeps while nobody reads (assumption); what is beyond ends the task."""

READ_S = 0.5
"""Longest wait for a block beyond its own length: how long closing may take (assumption)."""

RATE_ERROR = 1e-5
"""How far the device's rate may be from the profile's: 10 ppm (assumption; it divides its own clock)."""

TERMINALS = {"default": "DEFAULT", "rse": "RSE", "nrse": "NRSE", "differential": "DIFF"}


class DaqBlock(NamedTuple):
    """Samples that were read together.

    Attributes:
        first: Number of the first since the task began.
        volts: Shape (n, inputs).
        arrival_s: Monotonic time at which they were in hand.
    """

    first: int
    volts: NDArray[np.float64]
    arrival_s: float


def open_daq(device: str, settings: NiDaqSettings, clock: Clock) -> DaqLink:
    """Begin to sample.

    Args:
        device: Name in the profile, for errors.
        clock: Time-stamps what is read.

    Raises:
        PortError: library, driver, server or device are missing.
        RefusedError: the device does not take what is asked for.
    """
    doing = f"opening {settings.port}"
    try:
        import nidaqmx
        from nidaqmx.constants import AcquisitionType, TerminalConfiguration
        from nidaqmx.errors import DaqNotFoundError
        from nidaqmx.stream_readers import AnalogMultiChannelReader
    except ImportError as error:
        raise PortError(device, doing, *lacking("nidaqmx", "daq")) from error
    remote = {} if settings.server is None else _server(device, settings)
    inputs = [name for stream in settings.streams.values() for name in stream.inputs]
    ending = ExitStack()  # what is to be closed, from the last to the first
    if remote:
        ending.callback(remote["grpc_options"].grpc_channel.close)
    try:
        found = nidaqmx.system.Device(settings.port, **remote)
        model, serial = found.product_type, f"{found.serial_num:X}"
        task = nidaqmx.Task("", **remote)
        ending.callback(task.close)
        for name in inputs:
            task.ai_channels.add_ai_voltage_chan(
                f"{settings.port}/{name}",
                terminal_config=TerminalConfiguration[TERMINALS[settings.terminal]],
                min_val=-settings.range_v,
                max_val=settings.range_v,
            )
        task.timing.cfg_samp_clk_timing(
            settings.rate_hz,
            sample_mode=AcquisitionType.CONTINUOUS,
            samps_per_chan=max(1, round(BUFFER_S * settings.rate_hz)),
        )
        rate_hz = task.timing.samp_clk_rate
        if abs(rate_hz / settings.rate_hz - 1.0) > RATE_ERROR:
            reason = f"it samples {rate_hz:.9g} times a second, not {settings.rate_hz:g}"
            raise RefusedError(device, doing, reason, f"set rate_hz = {rate_hz:.9g}")
        task.start()
    except BaseException as error:
        _end(ending)
        if isinstance(error, DaqNotFoundError):
            advice = 'install NI-DAQmx here, or name a server: server = "HOST:31763"'
            raise PortError(device, doing, "NI-DAQmx is not installed", advice) from error
        if isinstance(error, DeviceError) or not isinstance(error, Exception):
            raise
        advice = "compare port, inputs, range_v and terminal with what NI MAX shows"
        raise PortError(device, doing, _first(error), advice) from error
    reader = AnalogMultiChannelReader(task.in_stream)
    reader.verify_array_shape = False
    samples = max(1, round(settings.block_s * settings.rate_hz))
    return DaqLink(device, ending, reader, (len(inputs), samples), settings, clock, (model, serial))


def _server(device: str, settings: NiDaqSettings) -> dict[str, Any]:
    import grpc
    import nidaqmx

    assert settings.server is not None
    channel = grpc.insecure_channel(settings.server)
    try:
        grpc.channel_ready_future(channel).result(settings.open_timeout_s)
    except grpc.FutureTimeoutError as error:
        channel.close()
        reason = f"no gRPC server answers at {settings.server} in {settings.open_timeout_s:g} s"
        advice = "is the NI gRPC Device Server running there?"
        raise PortError(device, "connecting", reason, advice) from error
    return {"grpc_options": nidaqmx.GrpcSessionOptions(channel, "")}


class DaqLink:
    """A task with its reader thread, which fills a queue and raises nothing.

    Args:
        device: Name in the profile.
        ending: Closes task and server.
        reader: Of the task.
        shape: Inputs, and samples of a block.
        found: The device's model and serial number.

    Attributes:
        fault: Why the task has ended, or None while it runs.
        found: As given.
    """

    def __init__(
        self,
        device: str,
        ending: ExitStack,
        reader: Any,
        shape: tuple[int, int],
        settings: NiDaqSettings,
        clock: Clock,
        found: tuple[str, str],
    ) -> None:
        self.fault: str | None = None
        self.found = found
        self._ending, self._reader, self._shape, self._clock = ending, reader, shape, clock
        self._wait_s = READ_S + shape[1] / settings.rate_hz
        self._arrived: deque[DaqBlock] = deque()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"{device}-daq", daemon=True)
        self._thread.start()

    def receive(self) -> list[DaqBlock]:
        """What has been read since the last call, in order."""
        taken = []
        with suppress(IndexError):
            while True:
                taken.append(self._arrived.popleft())
        return taken

    def close(self) -> None:
        """End the task and wait for the thread. Never raises; may be called twice."""
        self._closing = True
        self._thread.join(self._wait_s + JOIN_TIMEOUT_S)
        _end(self._ending)

    def _run(self) -> None:
        number, samples = 0, self._shape[1]
        volts = np.empty(self._shape)
        while not self._closing:
            try:
                self._reader.read_many_sample(volts, samples, timeout=self._wait_s)
            except Exception as error:
                if not self._closing:
                    self.fault = self.fault or f"its task has ended ({_first(error)})"
                return
            self._arrived.append(DaqBlock(number, volts.T.copy(), self._clock.monotonic_s()))
            number += samples


def _end(ending: ExitStack) -> None:
    with suppress(Exception):  # the device may be gone
        ending.close()


def _first(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
