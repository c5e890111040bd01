"""An analog output of a NI-DAQmx device, and the thread that writes to it."""

import threading
from collections import deque
from collections.abc import Mapping
from contextlib import suppress
from fractions import Fraction
from queue import SimpleQueue
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import Clock
from drivers.core.errors import first_line
from drivers.core.links import JOIN_TIMEOUT_S, drained
from drivers.core.messages import Command, Excite, Tone
from drivers.ni_daq.settings import DaqDrive

LONGEST = 50_000
"""Samples of a sine that are repeated, at the most (assumption: a tenth of a second, 0.4 MB to send)."""

FREQUENCY_ERROR = 1e-3
"""How far the frequency of whole periods among these may be from the one asked for (assumption)."""


def periods(frequency_hz: float, rate_hz: float) -> Fraction | None:
    """How many periods of a sine to repeat, over in how many samples; None where these cannot have its frequency."""
    share = Fraction(frequency_hz / rate_hz).limit_denominator(LONGEST)
    return (
        share
        if abs(share * Fraction(rate_hz) - Fraction(frequency_hz)) <= FREQUENCY_ERROR * frequency_hz
        else None
    )


def sine(tone: Tone, drive: DaqDrive) -> NDArray[np.float64]:
    """Whole periods of a tone in volts, to be repeated: its frequency is met within rate / (LONGEST n) Hz,
    shape (n,)."""
    assert drive.rate_hz is not None
    share = periods(tone.frequency_hz, drive.rate_hz)
    assert share is not None  # else it was refused
    turns = np.arange(share.denominator) * (share.numerator / share.denominator)
    return np.asarray(drive.limit_v * tone.level * np.sin(2.0 * np.pi * turns))


class DaqOutput:
    """Volts at an output: 0 from the beginning to the end, but for what is ordered between.

    Args:
        terminal: The output, as `Dev1/ao0`.
        lowest_v: Least voltage that the device has for it: 0 of a USB-6008.
        remote: Where the device is, as `nidaqmx.Task` takes it.

    Attributes:
        least_v: Least voltage that it may be given.
        fault: Why it can no longer be written to, or None.

    Raises:
        Exception: what the library raises where the output is not there or not free.
    """

    def __init__(
        self,
        device: str,
        terminal: str,
        lowest_v: float,
        drive: DaqDrive,
        remote: Mapping[str, Any],
        clock: Clock,
    ) -> None:
        self.least_v = max(-drive.limit_v, lowest_v)
        self.fault: str | None = None
        self._terminal, self._drive, self._remote, self._clock = terminal, drive, remote, clock
        self._task: Any = None
        self._orders: SimpleQueue[Command | Literal["off", "end"]] = SimpleQueue()
        self._done: deque[tuple[Command, float]] = deque()
        try:
            self._constant(0.0)
        except BaseException:
            self._end()
            raise
        self._thread = threading.Thread(target=self._run, name=f"{device}-output", daemon=True)
        self._thread.start()

    def order(self, command: Command | Literal["off"]) -> None:
        """Obey an `Excite` or a `Tone`, soon; "off" is 0 V."""
        self._orders.put(command)

    def done(self) -> list[tuple[Command, float]]:
        """Orders that the device has taken since the last call, and the monotonic time at which it had."""
        return drained(self._done)

    def close(self) -> None:
        """0 V, and the end. Never raises; may be called twice."""
        self._orders.put("end")
        self._thread.join(JOIN_TIMEOUT_S)

    def _run(self) -> None:
        while (order := self._orders.get()) != "end" and self.fault is None:
            try:
                if isinstance(order, Tone):
                    self._repeat(sine(order, self._drive))
                else:
                    self._constant(
                        (self._drive.on_v or 0.0) if isinstance(order, Excite) and order.on else 0.0
                    )
                if isinstance(order, Command):
                    self._done.append((order, self._clock.monotonic_s()))
            except Exception as error:
                self.fault = f"its output cannot be written to ({first_line(error)})"
        with suppress(Exception):  # the device may be gone
            self._constant(0.0)
        self._end()

    def _constant(self, volts: float) -> None:
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        AnalogSingleChannelWriter(self._fresh().out_stream).write_one_sample(volts)

    def _repeat(self, volts: NDArray[np.float64]) -> None:
        from nidaqmx.constants import AcquisitionType
        from nidaqmx.stream_writers import AnalogSingleChannelWriter

        self._constant(0.0)  # where it ends is where a sine was broken off
        task = self._fresh()
        task.timing.cfg_samp_clk_timing(
            self._drive.rate_hz, sample_mode=AcquisitionType.CONTINUOUS, samps_per_chan=len(volts)
        )
        writer = AnalogSingleChannelWriter(task.out_stream, auto_start=False)
        writer.verify_array_shape = False
        writer.write_many_sample(volts)
        task.start()

    def _fresh(self) -> Any:
        """A task in place of the former; the device itself refuses what is beyond the limit."""
        import nidaqmx

        self._end()
        self._task = nidaqmx.Task("", **self._remote)
        self._task.ao_channels.add_ao_voltage_chan(
            self._terminal, min_val=self.least_v, max_val=self._drive.limit_v
        )
        return self._task

    def _end(self) -> None:
        task, self._task = self._task, None
        if task is not None:
            with suppress(Exception):
                task.close()
