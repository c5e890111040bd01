"""Running NI-DAQmx tasks, and the thread that reads them."""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable
from contextlib import ExitStack, suppress
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import Clock
from drivers.core.errors import DeviceError, PortError, RefusedError, first_line, lacking
from drivers.core.links import JOIN_TIMEOUT_S, drained
from drivers.ni_daq.output import DaqOutput
from drivers.ni_daq.settings import NiDaqSettings

BUFFER_S = 2.0
"""How much the driver of the device keeps while nobody reads (assumption); what is beyond ends the task."""

READ_S = 0.5
"""Longest wait for a block beyond its own length: how long closing may take (assumption)."""

RATE_ERROR = 1e-5
"""How far the device's rate may be from the profile's: 10 ppm (assumption; it divides its own clock)."""

COUNTER_MODULUS = 1 << 32
"""Counters have 32 bits."""

TERMINALS = {"default": "DEFAULT", "rse": "RSE", "nrse": "NRSE", "differential": "DIFF"}


Read = tuple[Callable[..., int], NDArray[Any]]
"""What reads samples of a task, and the array that it fills."""


class DaqBlock(NamedTuple):
    """Samples that were read together.

    Attributes:
        first: Number of the first since the task began.
        values: Volts of the analog inputs, then counts of the counters; shape (n, inputs).
        arrival_s: Monotonic time at which they were in hand.
    """

    first: int
    values: NDArray[np.float64]
    arrival_s: float


def open_daq(device: str, settings: NiDaqSettings, clock: Clock) -> DaqLink:
    """Begin to sample.

    Raises:
        PortError: library, driver, server or device are missing.
        RefusedError: the device does not take what is asked for.
    """
    doing = f"opening {settings.port}"
    try:
        import nidaqmx
        from nidaqmx.errors import DaqNotFoundError
    except ImportError as error:
        raise PortError(device, doing, *lacking("nidaqmx", "daq")) from error
    remote = {} if settings.server is None else _server(device, settings)
    ending = ExitStack()  # what is to be closed, from the last to the first
    if remote:
        ending.callback(remote["grpc_options"].grpc_channel.close)
    try:
        found = nidaqmx.system.Device(settings.port, **remote)
        model, serial = found.product_type, f"{found.serial_num:X}"
        output = None
        if settings.drive is not None:
            terminal = f"{settings.port}/{settings.drive.output}"
            lowest_v = min(found.ao_voltage_rngs, default=0.0)
            output = DaqOutput(device, terminal, lowest_v, settings.drive, remote, clock)
            ending.callback(output.close)
        task, range_v, reads = _inputs(device, settings, remote, ending)
        reads += [
            _counter(name, counts, settings, remote, ending) for name, counts in settings.counters.items()
        ]
        task.start()  # its clock is the counters'
    except BaseException as error:
        _end(ending)
        if isinstance(error, DaqNotFoundError):
            advice = 'install NI-DAQmx here, or name a server: server = "HOST:31763"'
            raise PortError(device, doing, "NI-DAQmx is not installed", advice) from error
        if isinstance(error, DeviceError) or not isinstance(error, Exception):
            raise
        advice = "compare port, inputs, range_v and terminal with what NI MAX shows"
        raise PortError(device, doing, first_line(error), advice) from error
    return DaqLink(device, ending, reads, settings, clock, (model, serial), range_v, output)


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


def _inputs(
    device: str, settings: NiDaqSettings, remote: dict[str, Any], ending: ExitStack
) -> tuple[Any, tuple[float, float], list[Read]]:
    """The task of all analog inputs, not started, the range that the device took for them, and what reads it."""
    import nidaqmx
    from nidaqmx.constants import TerminalConfiguration
    from nidaqmx.stream_readers import AnalogMultiChannelReader

    task = nidaqmx.Task("", **remote)
    ending.callback(task.close)
    for name in settings.analog:
        channel = task.ai_channels.add_ai_voltage_chan(
            f"{settings.port}/{name}",
            terminal_config=TerminalConfiguration[TERMINALS[settings.terminal]],
            min_val=-settings.range_v,
            max_val=settings.range_v,
        )
    task.timing.cfg_samp_clk_timing(settings.rate_hz, **_sampling(settings))
    rate_hz = task.timing.samp_clk_rate
    if abs(rate_hz / settings.rate_hz - 1.0) > RATE_ERROR:
        reason = f"it samples {rate_hz:.9g} times a second, not {settings.rate_hz:g}"
        raise RefusedError(device, f"opening {settings.port}", reason, f"set rate_hz = {rate_hz:.9g}")
    reader = AnalogMultiChannelReader(task.in_stream)
    reader.verify_array_shape = False
    range_v = channel.ai_rng_low, channel.ai_rng_high  # the same of all: they are asked for the same
    return task, range_v, [(reader.read_many_sample, np.empty((len(settings.analog), settings.block)))]


def _counter(
    name: str, counts: str, settings: NiDaqSettings, remote: dict[str, Any], ending: ExitStack
) -> Read:
    """What reads a counter that waits for the clock of the analog inputs."""
    import nidaqmx
    from nidaqmx.constants import AngleUnits, EncoderType
    from nidaqmx.stream_readers import CounterReader

    task = nidaqmx.Task("", **remote)
    ending.callback(task.close)
    where, edges = f"{settings.port}/{name}", counts == "edges"
    if edges:
        task.ci_channels.add_ci_count_edges_chan(where)
    else:
        decoding = EncoderType[f"X_{counts[1]}"]
        task.ci_channels.add_ci_ang_encoder_chan(where, decoding_type=decoding, units=AngleUnits.TICKS)
    source = f"/{settings.port}/ai/SampleClock"
    task.timing.cfg_samp_clk_timing(settings.rate_hz, source=source, **_sampling(settings))
    task.start()
    reader = CounterReader(task.in_stream)
    reader.verify_array_shape = False
    if edges:
        return reader.read_many_sample_uint32, np.empty(settings.block, np.uint32)
    return reader.read_many_sample_double, np.empty(settings.block)


def _sampling(settings: NiDaqSettings) -> dict[str, Any]:
    from nidaqmx.constants import AcquisitionType

    samples = max(1, round(BUFFER_S * settings.rate_hz))
    return {"sample_mode": AcquisitionType.CONTINUOUS, "samps_per_chan": samples}


class DaqLink:
    """Tasks with their reader thread, which fills a queue and raises nothing.

    Args:
        ending: Closes tasks and server.
        reads: Reads samples into the array beside it, of each task.
        found: The device's model and serial number.
        range_v: Ends of the range of its inputs.
        output: Its analog output, where it has one.
    """

    def __init__(
        self,
        device: str,
        ending: ExitStack,
        reads: list[Read],
        settings: NiDaqSettings,
        clock: Clock,
        found: tuple[str, str],
        range_v: tuple[float, float],
        output: DaqOutput | None,
    ) -> None:
        self.found, self.range_v, self.output = found, range_v, output
        self._fault: str | None = None
        self._ending, self._reads, self._clock = ending, reads, clock
        self._samples = settings.block
        self._wait_s = READ_S + settings.block / settings.rate_hz
        self._arrived: deque[DaqBlock] = deque()
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"{device}-daq", daemon=True)
        self._thread.start()

    @property
    def fault(self) -> str | None:
        """Why a task has ended, or None while all run."""
        return self._fault or (self.output.fault if self.output else None)

    def off(self) -> None:
        """0 V, soon."""
        if self.output is not None:
            self.output.order("off")

    def receive(self) -> list[DaqBlock]:
        """What has been read since the last call, in order."""
        return drained(self._arrived)

    def close(self) -> None:
        """End the tasks and wait for the thread. Never raises; may be called twice."""
        self._closing = True
        self.off()
        self._thread.join(self._wait_s + JOIN_TIMEOUT_S)
        _end(self._ending)

    def _run(self) -> None:
        number, counted = 0, np.zeros((1, len(self._reads) - 1))
        while not self._closing:
            try:
                for read, values in self._reads:
                    read(values, self._samples, timeout=self._wait_s)
            except Exception as error:
                if not self._closing:
                    self._fault = self._fault or f"its task has ended ({first_line(error)})"
                    self.off()
                return
            volts, counts = self._reads[0][1].T, np.array([values for _, values in self._reads[1:]])
            if counts.size:  # 32 bits, which wrap
                counted = np.unwrap(np.vstack([counted[-1:], counts.T]), period=COUNTER_MODULUS, axis=0)[1:]
                volts = np.hstack([volts, counted])
            self._arrived.append(DaqBlock(number, volts.copy(), self._clock.monotonic_s()))
            number += self._samples


def _end(ending: ExitStack) -> None:
    with suppress(Exception):  # the device may be gone
        ending.close()
