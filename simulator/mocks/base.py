"""What mock drivers share, those over a line in memory and those by hand; faults begin when the scene sets them."""

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import Clock, last_tick
from drivers.core.messages import DeviceInfo, Failed, SampleBlock, Status, StreamInfo
from drivers.core.wire import Driver, WireDriver
from simulator.devices.faults import FaultSchedule, corrupted, inject_begun


class MemoryLine:
    """What `drivers.core.links.SerialLink` is, to an emulated device without a port.

    The device lives in bench time, which begins anew with every trial; what it sends arrives in monotonic time: when it
    is read, or where the device has a `due_s`, the time at which it next sends on its own, at that time, however
    seldom it is read; `printed(t_s)` of a device gives all that it sends by then at once, with the times.

    Args:
        device: The far end: `receive(data, t_s)` and `step(t_s)`, both bytes out, and `inject(kind, t_s)`.
        faults: What goes wrong with the device and its line, and when.

    Attributes:
        fault: Why the line is gone, or None.
    """

    def __init__(self, device: Any, clock: Clock, faults: FaultSchedule | None = None) -> None:
        self.fault: str | None = None
        self._device = device
        self._clock = clock
        self.faults = faults or FaultSchedule()
        self._arrived: list[tuple[float, bytes]] = []

    def connect(self, *_: object) -> Any:
        """What `open_serial` is, for this line; it is whole again."""
        self.fault = None
        self._arrived = []
        return self

    def send(self, data: bytes) -> float | None:
        """See `SerialLink.send`."""
        t_s = self._fail()
        if self.fault is not None:
            return None
        self._catch_up(t_s)
        self._take(self._device.receive(data, t_s), t_s)
        return self._clock.monotonic_s()

    def receive(self) -> list[tuple[float, bytes]]:
        """See `SerialLink.receive`."""
        t_s = self._fail()
        if self.fault is None:
            self._catch_up(t_s)
            self._take(self._device.step(t_s), t_s)
        taken, self._arrived = self._arrived, []
        return taken

    def close(self) -> None:
        """See `SerialLink.close`."""

    def _fail(self) -> float:
        """Let the faults happen that have begun; what time it is."""
        t_s = self._clock.now()
        if self.faults.begun(t_s, "unplug"):
            self.fault = "the port was taken away"
        inject_begun(self.faults, self._device, t_s, t_s)
        return t_s

    def _catch_up(self, t_s: float) -> None:
        """Take what was sent before `t_s`, each at its time."""
        if printed := getattr(self._device, "printed", None):
            for at_s, data in printed(t_s):
                self._take(data, at_s)
            return
        while (due_s := getattr(self._device, "due_s", math.inf)) < t_s:
            self._take(self._device.step(due_s), due_s)

    def _take(self, data: bytes, t_s: float) -> None:
        data = corrupted(self.faults, data, t_s, hasattr(self._device, "datagram"))
        if data:
            self._arrived.append((self._clock.monotonic_s() - (self._clock.now() - t_s), data))


class OverMemory(WireDriver[Any]):
    """A real driver as the mock of its device, over a line in memory: `class MockX(OverMemory, X)`.

    Its far end is switched on anew at each trial, and the driver opened. That takes none of the trial's time where the
    far end answers at once. Faults begin after it.

    Args:
        settings: `MockXSettings`: the real one's, without a port.
        bench: What the far end is wired to.
    """

    _far_end: Callable[[Any, Any], Any]
    """Makes the far end of the settings and the bench."""

    def __init__(
        self, name: str, settings: Any, clock: Clock, bench: Any, faults: FaultSchedule | None = None
    ) -> None:
        self._bench = bench
        self._carries: Any = None  # what the far end has mounted the bench's tool on
        self._faults = faults or FaultSchedule()
        super().__init__(name, settings, clock, self._switch_on)

    def _switch_on(self, *_: object) -> MemoryLine:
        if self._carries is not None:
            self._bench.mover = None
        bare = getattr(self._bench, "mover", None) is None
        self._twin = type(self)._far_end(self._settings, self._bench)
        self._carries = getattr(self._bench, "mover", None) if bare else None
        return MemoryLine(self._twin, self._clock, self._faults)

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        if self._link is not None:
            faults, self._faults = self._faults, FaultSchedule()
            self.open()
            self._faults = self._link.faults = faults


class MockDriver(Driver):
    """A device in the process.

    Args:
        settings: Of the device: `MockXSettings` beside `MockX`.

    Raises:
        RefusedError: the bench has not what the device needs.
    """

    def __init__(
        self, name: str, settings: Any, clock: Clock, bench: Any, faults: FaultSchedule | None = None
    ) -> None:
        super().__init__(name, clock)
        self._settings, self._bench = settings, bench
        self._faults = faults or FaultSchedule()
        self._wire()
        self.restart()

    def _wire(self) -> None:
        """Be wired to the bench; raises `RefusedError`."""

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._statuses = []
        self._unheard: dict[str, int] = {}
        self._faults.restart()

    def close(self) -> None:
        """Nothing to release."""

    def poll(self) -> Sequence[Status]:
        """What became of the commands."""
        now_s = self._clock.now()
        if (fault := self._faults.begun(now_s, "unplug")) is not None:
            self._cut_off(now_s)
            reason = f"the link is gone ({fault.kind} injected at {fault.at_s:g} s)"
            self._report(Failed(now_s, self.name, reason))
        return super().poll()

    def _cut_off(self, now_s: float) -> None:
        """What the device does by itself once its link is gone."""

    def _gone(self, now_s: float) -> bool:
        """Whether nothing passes its link."""
        return self._faults.active(now_s, "silent", "unplug")

    def _unheard_of(self, stream: str, samples: int) -> None:
        """Samples that did not pass its link: their numbers are missing in what is heard next. One that was unplugged
        has failed, and is not counted any more."""
        if not self._faults.active(self._clock.now(), "unplug"):
            self._unheard[stream] = self._unheard.get(stream, 0) + samples

    def _heard(self, now_s: float) -> None:
        """Something passes its link again: tell what is missing, as the real driver does by the numbers."""
        for stream, samples in self._unheard.items():
            self._lost(now_s, stream, samples)
        self._unheard.clear()

    def _garbled(self, now_s: float) -> bool:
        """Whether nothing that it sends arrives whole."""
        return self._faults.active(now_s, "lose", "corrupt")

    def _passed(self, blocks: Sequence[SampleBlock], now_s: float) -> Sequence[SampleBlock]:
        """What of some blocks passes its link whole; what does not is lost."""
        if self._gone(now_s):
            for block in blocks:
                self._unheard_of(block.stream, len(block))
            return ()
        self._heard(now_s)
        if self._garbled(now_s):
            for block in blocks:
                self._lost(now_s, block.stream, len(block))
            return ()
        return blocks


class MockSensor(MockDriver):
    """A sensor in the process: sample k of a stream is at k / rate, computed while subscribed, and may be lost."""

    model: ClassVar[str]
    """What it calls itself."""

    _infos: Mapping[str, StreamInfo]
    """Its streams, by name; set before the first `restart`."""

    _longest = 4096
    """Samples of a block, at the most."""

    def restart(self) -> None:
        """Begin a trial: bench time is zero again."""
        self._next: dict[str, int] = {}  # of each subscribed stream: number of its next sample
        self._seq = dict.fromkeys(self._infos, 0)
        super().restart()

    def open(self) -> DeviceInfo:
        """Nothing to connect to."""
        return DeviceInfo(self.name, model=self.model, streams=self._infos, clock="bench")

    def _subscribe(self, streams: Iterable[str], now_s: float) -> None:
        """Sample these from now on; one that is sampled already goes on."""
        begins = {stream: last_tick(now_s, self._infos[stream].rate_hz or 1.0) + 1 for stream in streams}
        self._next = {stream: self._next.get(stream, begins[stream]) for stream in sorted(begins)}

    def read(self) -> Sequence[SampleBlock]:
        """What was sampled since the last call."""
        now_s = self._clock.now()
        self._advance(now_s)
        return self._passed([block for stream in self._next for block in self._due(stream, now_s)], now_s)

    def _advance(self, now_s: float) -> None:
        """Let the bench's time pass."""
        self._bench.advance(now_s)

    def _due(self, stream: str, now_s: float) -> Sequence[SampleBlock]:
        """What has become due of a stream."""
        first, rate_hz = self._next[stream], self._infos[stream].rate_hz
        assert rate_hz is not None
        last = last_tick(now_s, rate_hz)
        if last < first:
            return ()
        self._next[stream] = last + 1
        times_s = np.arange(first, last + 1) / rate_hz
        values = self._counts(stream, times_s)
        cuts = [slice(start, start + self._longest) for start in range(0, len(values), self._longest)]
        return [self._block(stream, float(times_s[cut.start]), values[cut], now_s) for cut in cuts]

    def _counts(self, stream: str, times_s: NDArray[np.float64]) -> Any:
        """What the converter reads at these times, shape (n, channels)."""
        raise NotImplementedError

    def _block(
        self, stream: str, t0_s: float, values: Any, now_s: float, times_s: NDArray[np.float64] | None = None
    ) -> SampleBlock:
        seq = self._seq[stream]
        self._seq[stream] += len(values)
        return self._infos[stream].block(
            seq, t0_s, values, times_s=times_s, device_t0_s=t0_s, arrival_s=now_s
        )
