"""A real driver and an emulated device in one process, in virtual time: what is written is answered at once."""

from __future__ import annotations

from typing import Any

from drivers.clock import VirtualClock


class MemoryLine:
    """What `SerialLink` is, to an emulated device without a port.

    Args:
        device: The far end: `receive(data, t_s)` and `step(t_s)`, both bytes out.
        clock: Of both ends.

    Attributes:
        lost: While True nothing gets through, either way.
    """

    def __init__(self, device: Any, clock: VirtualClock) -> None:
        self.fault: str | None = None
        self.lost = False
        self._device = device
        self._clock = clock
        self._arrived: list[tuple[float, bytes]] = []

    def connect(self, *_: Any) -> Any:
        """What `open_serial` is, for this line."""
        return self

    def send(self, data: bytes) -> float:
        now_s = self._clock.monotonic_s()
        if not self.lost:
            self._take(self._device.receive(data, now_s))
        return now_s

    def receive(self) -> list[tuple[float, bytes]]:
        said = self._device.step(self._clock.monotonic_s())
        if not self.lost:
            self._take(said)
        taken, self._arrived = self._arrived, []
        return taken

    def close(self) -> None:
        pass

    def _take(self, data: bytes) -> None:
        if data:
            self._arrived.append((self._clock.monotonic_s(), data))
