"""An emulated device at the far end of a link, and the host's time: no port, no bus, no thread."""

from collections.abc import Callable
from typing import Any

from drivers.core.clock import WallClock

BEGIN_S = 5000.0
"""Monotonic time at which a test begins: the host has been up for a while."""

RESTS_MAX = 30_000
"""Of a driver that waits for its device, 1 ms each: a test waits for less than half a minute."""


def spoilt(kind: str, pieces: int = 1) -> Callable[[bytes], bytes]:
    """For `FarEnd.hush`: the next pieces that a device sends are dropped, have one bit flipped, or are truncated."""
    left = iter(range(pieces))

    def hush(data: bytes) -> bytes:
        if not data or next(left, None) is None:
            return data
        if kind == "flip":
            middle = len(data) // 2
            return data[:middle] + bytes([data[middle] ^ 4]) + data[middle + 1 :]
        return data[: len(data) // 2] if kind == "truncate" else b""

    return hush


class Other:
    """Another device at a port: answers everything with a line, or, None, with what it hears."""

    def __init__(self, line: bytes | None) -> None:
        self._line = line

    def receive(self, data: bytes, t_s: float) -> bytes:
        return data if self._line is None else self._line

    def step(self, t_s: float) -> bytes:
        return b""


class FarEnd:
    """What a link is to a driver, and time, which passes in small steps.

    Args:
        device: `receive(data, t_s)` and `step(t_s)`, both what it sends.
        step_s: How long the next step is.

    Attributes:
        t_s: The host's monotonic time.
        fault: Why the link is gone, or None.
        cut: What becomes of what the host writes, on its way.
        hush: What becomes of what the device sends.
        written: By the host.
        arrived: What has arrived and was not taken, with its time.
        closed: Whether the driver has closed it.
    """

    def __init__(self, device: Any, step_s: Callable[[], float] = lambda: 1e-3) -> None:
        self.device = device
        self.t_s = BEGIN_S
        self.fault: str | None = None
        self.cut: Callable[[Any], Any] = lambda data: data
        self.hush: Callable[[Any], Any] = lambda data: data
        self.written: list[Any] = []
        self.arrived: list[Any] = []
        self.closed = False
        self._step_s = step_s

    def connect(self, *_: object) -> Any:
        """What a driver opens its link with."""
        self.closed = False
        return self

    def send(self, data: Any) -> float | None:
        if self.fault or self.closed:
            return None
        self.written.append(data)
        self.arrive(self.device.receive(self.cut(data), self.t_s))
        return self.t_s

    def receive(self) -> list[Any]:
        arrived, self.arrived = self.arrived, []
        return arrived

    def close(self) -> None:
        self.closed = True

    def until(self, t_s: float) -> None:
        """Let time pass."""
        while self.t_s < t_s - 1e-9:
            self.t_s = min(self.t_s + self._step_s(), t_s)
            self.arrive(self.device.step(self.t_s))

    def wait(self, seconds: float) -> None:
        """The same."""
        self.until(self.t_s + seconds)

    def arrive(self, data: Any) -> None:
        """The device has sent this."""
        data = self.hush(data)
        if data:
            self.arrived.append((self.t_s, data))


class FarClock(WallClock):
    """Bench time that begins with a far end's."""

    def __init__(self, far: FarEnd) -> None:
        self._far = far
        self._rests = 0
        self.restart()

    def now(self) -> float:
        return self._far.t_s - self._origin_s

    def monotonic_s(self) -> float:
        return self._far.t_s

    def rest(self, seconds: float) -> None:
        self._rests += 1
        assert self._rests < RESTS_MAX, "it waits for ever"
        self._far.wait(max(seconds, 0.0))

    def restart(self) -> None:
        self._origin_s = self._far.t_s
