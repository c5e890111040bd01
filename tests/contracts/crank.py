"""One device by itself, with a hand to turn the loop's crank."""

from __future__ import annotations

from typing import Any

from drivers.core.messages import Listen, SampleBlock, Status

TURN_S = 0.005
"""Time between two turns, as of a loop at 200 Hz."""


class Crank:
    """An open device, its blocks and statuses so far.

    Args:
        device: Closed.
        clock: Its clock.
    """

    def __init__(self, device: Any, clock: Any) -> None:
        self.device = device
        self.clock = clock
        self.info = device.open()
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def turn(self, seconds: float) -> None:
        end_s = self.clock.now() + seconds
        while self.clock.now() < end_s:
            self.clock.wait_until(self.clock.now() + TURN_S)
            self.blocks += self.device.read()
            self.statuses += self.device.poll()

    def listen(self, *streams: str) -> None:
        self.device.apply(Listen(self.device.name, frozenset(streams)))

    def blocks_of(self, stream: str) -> list[SampleBlock]:
        return [block for block in self.blocks if block.stream == stream]

    def of(self, kind: type[Status]) -> list[Any]:
        return [status for status in self.statuses if isinstance(status, kind)]
