"""A server of the gRPC calls that NI's `nidaqmx` makes for analog inputs, counters and an analog output."""

import threading
from collections.abc import Callable, Collection, Mapping
from concurrent import futures
from typing import Any

import grpc
import numpy as np
from nidaqmx._stubs import nidaqmx_pb2 as pb
from nidaqmx._stubs import nidaqmx_pb2_grpc

from drivers.ni_daq.settings import NiDaqSettings
from simulator.devices.far_end import FarEnd
from simulator.devices.ni_daq import EmulatedNiDaq

Fields = Mapping[str, Any]
Call = Callable[[Any, Any], Fields]

PORT = "Dev1"
"""Name of the device, as the first one in a computer has it."""

KEPT_S = 2.0
"""How long samples wait to be read; then their task ends (assumption: a buffer as long as the driver asks for)."""

UNREAD_S = 0.02
"""Samples of so much time that lie unread hold the bench's time back (assumption: two blocks)."""

WAIT_S = 0.1
"""How often one who waits for samples looks whether there will be any (assumption)."""

NO_DEVICE, TOO_LATE, TIMED_OUT, BEYOND = -200220, -200279, -200284, -200077
"""NI's numbers of errors."""


class DaqTask:
    """A task: its channels, what it has read or will write.

    Attributes:
        columns: Places of its inputs among the device's; None of an output.
        started: Whether it samples, a counter with the analog inputs.
        number: Next sample to be read; None before there is one.
        volts: What waits for the start.
    """

    def __init__(self) -> None:
        self.channels: list[str] = []
        self.columns: list[int] = []
        self.started = False
        self.number: int | None = None
        self.limit_v = 0.0
        self.volts: float | None = None
        self.asked_hz = 0.0


class NiDaqServer(FarEnd):
    """A far end of its own: calls are answered by threads of grpc's, the samples come from `exchange`.

    Args:
        device: Whose inputs are sampled.

    Attributes:
        given_hz: Rate at which it samples instead of the one that is asked for; 0: at that.
        asked: Analog inputs as they were asked for, in order.
        lowest_v: Least voltage of its output; 0 of a USB-6008.
        written: Volts that were written to the output, in order; of a sine its amplitude.
    """

    def __init__(self, settings: NiDaqSettings, device: EmulatedNiDaq) -> None:
        self._settings, self._device = settings, device
        self._columns = [*settings.analog, *settings.counters]
        self._tasks: dict[str, DaqTask] = {}
        self._made = 0
        self._changed = threading.Condition()
        self._kept = np.empty((0, len(self._columns)))
        self._next = 0  # of the sample behind those that are kept
        self._pending: list[float] = []
        self.given_hz, self.lowest_v = 0.0, -10.0
        self.asked: list[Any] = []
        self.written: list[float] = []
        self._server = grpc.server(futures.ThreadPoolExecutor(8))
        servicer = nidaqmx_pb2_grpc.NiDAQmxServicer()
        for name, call in self._calls().items():
            setattr(servicer, name, _answering(name, call))
        nidaqmx_pb2_grpc.add_NiDAQmxServicer_to_server(servicer, self._server)
        port = self._server.add_insecure_port("127.0.0.1:0")
        self._server.start()
        self.endpoint: Mapping[str, Any] = {"port": PORT, "server": f"127.0.0.1:{port}"}
        self._plugged, self._now_s = True, 0.0

    @property
    def tasks(self) -> int:
        """How many have been made and not been cleared."""
        return len(self._tasks)

    # as a far end

    def inject(self, kind: str, t_s: float) -> None:
        """See `FarEnd.inject`."""
        self._device.inject(kind, t_s)

    def unread(self) -> bool:
        """See `FarEnd.unread`."""
        longest = UNREAD_S * self._settings.rate_hz + self._settings.block
        with self._changed:
            return any(t.number is not None and self._next - t.number > longest for t in self._tasks.values())

    def _carry(self, ready: Collection[Any], t_s: float, trial_s: float) -> bool:
        with self._changed:
            self._now_s = t_s
            for volts in self._pending:
                self._device.drive(volts, t_s)
            self._pending = []
            running = [task for task in self._tasks.values() if task.number is not None]
            if running and self._plugged:
                taken = self._device.take(t_s)
                if not self._faults.active(trial_s, "silent"):
                    kept = round(KEPT_S * self._settings.rate_hz)
                    self._kept = np.concatenate([self._kept, taken])[-kept:]
                    self._next += len(taken)
                    self._changed.notify_all()
        return bool(running)

    def unplug(self) -> None:
        """See `FarEnd.unplug`: every call fails."""
        self._plugged = False
        self._server.stop(None)

    # the calls: each returns the fields of its response

    def _calls(self) -> Mapping[str, Call]:
        return {
            "GetSystemInfoAttributeUInt32": lambda request, context: {},
            "GetDeviceAttributeString": self._model,
            "GetDeviceAttributeDoubleArray": lambda request, context: {"value": [self.lowest_v, 10.0]},
            "GetDeviceAttributeUInt32": lambda request, context: {"value": 0x1A2B3C},
            "CreateTask": self._create,
            "GetTaskAttributeString": lambda request, _: {"value": ", ".join(self._task(request).channels)},
            "CreateAIVoltageChan": self._add_input,
            "CreateCICountEdgesChan": self._add_input,
            "CreateCIAngEncoderChan": self._add_input,
            "CreateAOVoltageChan": self._add_output,
            "GetChanAttributeDouble": self._range,
            "CfgSampClkTiming": self._clock,
            "GetTimingAttributeDouble": lambda request, _: {"value": self._task(request).asked_hz},
            "StartTask": self._start,
            "ReadAnalogF64": self._read,
            "ReadCounterF64Ex": self._read,
            "ReadCounterU32Ex": self._read,
            "WriteAnalogScalarF64": self._constant,
            "WriteAnalogF64": self._waveform,
            "ClearTask": self._clear,
        }

    def _model(self, request: Any, context: Any) -> Fields:
        if request.device_name != PORT:
            _refuse(context, NO_DEVICE, "Device identifier is invalid.")
        return {"value": "USB-6363"}

    def _create(self, request: Any, context: Any) -> Fields:
        with self._changed:
            self._made += 1
            name = f"_unnamedTask<{self._made:X}>"
            self._tasks[name] = DaqTask()
        return {"task": {"name": name}, "new_session_initialized": True}

    def _add_input(self, request: Any, context: Any) -> Fields:
        self.asked.append(request)
        channel = getattr(request, "counter", "") or request.physical_channel
        name = channel.removeprefix(f"{PORT}/")
        if name not in self._columns:
            _refuse(context, NO_DEVICE, f"Physical channel {name} is not wired on this bench.")
        task = self._task(request)
        task.channels.append(channel)
        task.columns.append(self._columns.index(name))
        return {}

    def _add_output(self, request: Any, context: Any) -> Fields:
        task = self._task(request)
        task.channels.append(request.physical_channel)
        task.limit_v = request.max_val
        if request.min_val < self.lowest_v:
            _refuse(context, BEYOND, "Requested value is not a supported value for this property.")
        return {}

    def _range(self, request: Any, context: Any) -> Fields:
        low = request.attribute_raw == pb.CHANNEL_ATTRIBUTE_AI_RNG_LOW
        return {"value": -self._device.range_v if low else self._device.range_v}

    def _clock(self, request: Any, context: Any) -> Fields:
        self._task(request).asked_hz = self.given_hz or request.rate
        return {}

    def _start(self, request: Any, context: Any) -> Fields:
        with self._changed:
            task = self._task(request)
            task.started = True
            if task.volts is not None:
                self._write(task.volts)
            elif task.columns[0] < len(self._settings.analog):
                for one in self._tasks.values():
                    if one.started and one.columns:
                        one.number = self._next
        return {}

    def _read(self, request: Any, context: Any) -> Fields:
        task, n = self._task(request), request.num_samps_per_chan
        assert task.number is not None
        with self._changed:
            end, until_s = task.number + n, self._now_s + request.timeout  # bench time: it may stand still
            while self._next < end and self._now_s <= until_s and self._plugged:
                self._changed.wait(WAIT_S)
            if self._next < end:
                _refuse(
                    context, TIMED_OUT, "Some or all of the samples requested have not yet been acquired."
                )
            first = task.number - (self._next - len(self._kept))
            if first < 0:
                _refuse(context, TOO_LATE, "The application is not able to keep up with the hardware.")
            task.number = end
            values: Any = self._kept[first : first + n, task.columns].T.ravel()
        if isinstance(request, pb.ReadCounterU32ExRequest):
            values = values.astype(np.int64) % (1 << 32)
        return {"read_array": values.tolist(), "samps_per_chan_read": n}

    def _constant(self, request: Any, context: Any) -> Fields:
        self._check(request, abs(request.value), context)
        with self._changed:
            self._write(request.value)
        return {}

    def _waveform(self, request: Any, context: Any) -> Fields:
        volts = max(map(abs, request.write_array))
        self._check(request, volts, context)
        self._task(request).volts = volts
        return {"samps_per_chan_written": request.num_samps_per_chan}

    def _clear(self, request: Any, context: Any) -> Fields:
        with self._changed:
            self._tasks.pop(request.task.name, None)
        return {}

    def _task(self, request: Any) -> DaqTask:
        return self._tasks[request.task.name]

    def _check(self, request: Any, volts: float, context: Any) -> None:
        if volts > self._task(request).limit_v:
            _refuse(context, BEYOND, "Requested value is not a supported value for this property.")

    def _write(self, volts: float) -> None:
        self.written.append(volts)
        self._pending.append(volts)


def _answering(name: str, call: Call) -> Callable[[Any, Any], Any]:
    """The call in the form that grpc wants."""
    response = getattr(pb, f"{name}Response")
    return lambda request, context: response(**call(request, context))


def _refuse(context: Any, number: int, reason: str) -> None:
    """End the call as NI's server does."""
    context.set_trailing_metadata((("ni-error", str(number)),))
    context.abort(grpc.StatusCode.UNKNOWN, f"{reason}\n\nStatus Code: {number}")
