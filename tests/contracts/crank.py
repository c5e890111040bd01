"""Devices without a loop, and a hand to turn its crank."""

from typing import Any

import numpy as np

from drivers.core.messages import Command, Listen, SampleBlock, Status

TURN_S = 0.005
"""Time between two turns, as of a loop at 200 Hz."""


class Crank:
    """A device, its blocks and statuses so far.

    Args:
        device: Closed.
        clock: Its clock; None is the one that it keeps.
        opens: Whether it is opened now.

    Attributes:
        turn_s: Time between two turns.
    """

    turn_s = TURN_S

    def __init__(self, device: Any, clock: Any = None, opens: bool = True) -> None:
        self.device = device
        self.devices = [device]
        self.clock = device._clock if clock is None else clock
        if opens:
            self.info = device.open()
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def turn(self, seconds: float) -> None:
        end_s = self.clock.now() + seconds
        while self.clock.now() < end_s:
            self.clock.wait_until(self.clock.now() + self.turn_s)
            for device in self.devices:
                self.blocks += device.read()
                self.statuses += device.poll()

    def listen(self, *streams: str) -> None:
        self.device.apply(Listen(self.device.name, frozenset(streams)))

    def answers(self, command: Command, seconds: float = 1.0) -> list[Any]:
        """Sends a command, turns the crank; the statuses meanwhile."""
        self.statuses.clear()
        self.device.apply(command)
        self.turn(seconds)
        return list(self.statuses)

    def blocks_of(self, stream: str) -> list[SampleBlock]:
        return [block for block in self.blocks if block.stream == stream and len(block)]

    def values(self, stream: str) -> Any:
        """All samples of a stream, in its unit, shape (n, channels)."""
        return np.concatenate([block.physical for block in self.blocks_of(stream)])

    def times(self, stream: str) -> Any:
        """The time of each, shape (n,)."""
        return np.concatenate([block.times for block in self.blocks_of(stream)])

    def of(self, kind: type[Status]) -> list[Any]:
        return [status for status in self.statuses if isinstance(status, kind)]

    def take(self, kind: type[Status]) -> list[Any]:
        """The statuses of a kind, which are then forgotten."""
        taken = self.of(kind)
        self.statuses = [status for status in self.statuses if not isinstance(status, kind)]
        return taken

    def until(self, kind: type[Status], seconds: float = 10.0, device: str = "") -> Any:
        """The next status of a kind; of any device where none is named."""
        end_s = self.clock.now() + seconds
        while self.clock.now() < end_s:
            self.turn(self.turn_s)
            for status in self.statuses:
                if isinstance(status, kind) and device in ("", status.device):
                    self.statuses.remove(status)
                    return status
        raise AssertionError(f"no {kind.__name__} {device} in {seconds} s, but {self.statuses}")
