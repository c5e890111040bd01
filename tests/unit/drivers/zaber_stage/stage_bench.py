"""A driver of a stage on the emulated one, with its line recorded: in virtual time, or on a pty (tests/wire)."""

from collections.abc import Callable
from typing import Any, TypeVar

from drivers.core.messages import Command, SampleBlock, Sent, Status
from drivers.zaber_stage.driver import ZaberStage
from simulator.devices.zaber_stage import EmulatedZaberStage
from simulator.physics.stage_axis import StageAxis

S = TypeVar("S", bound=Status)
STEP_M = 0.49609375e-6
EVERYTHING = frozenset({"stage.position"})


LATE_S = 0.15

SPOILT: dict[str, Callable[[bytes], bytes]] = {
    "lose": lambda reply: b"",
    "late": lambda reply: b"",
    "bad_lrc": lambda reply: reply[:-3] + bytes([reply[-3] ^ 1]) + reply[-2:],
    "corrupt": lambda reply: reply[:4] + bytes(byte ^ 0x80 for byte in reply[4:-2]) + reply[-2:],
}
"""What becomes of a reply on its way; a late one comes `LATE_S` later."""


class Wire:
    """The emulated stage; records what it receives.

    Attributes:
        spoils: What becomes of its next reply, of `SPOILT`; "" is nothing.
        loses: The reply to the next line with this is lost.
        silent: Nothing that it sends arrives.
    """

    def __init__(self, **settings: Any) -> None:
        self.axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026)
        self.device = EmulatedZaberStage(self.axis, **settings)
        self.received = b""
        self.deaf_to = b"\0"
        self.spoils, self.loses = "", b"\0"
        self.silent = False
        self._late: list[tuple[float, bytes]] = []

    def receive(self, data: bytes, t_s: float) -> bytes:
        self.received += data
        if self.loses in data:
            self.spoils, self.loses = "lose", b"\0"
        reply = b"" if self.deaf_to in data else self.device.receive(data, t_s)
        if reply and self.spoils:
            if self.spoils == "late":
                self._late.append((t_s + LATE_S, reply))
            reply, self.spoils = SPOILT[self.spoils](reply), ""
        return b"" if self.silent else reply

    def step(self, t_s: float) -> bytes:
        sent = self.device.step(t_s) + b"".join(reply for due_s, reply in self._late if due_s <= t_s)
        self._late = [(due_s, reply) for due_s, reply in self._late if due_s > t_s]
        return b"" if self.silent else sent

    def lines(self) -> list[str]:
        """The lines that it received, without device, axis, id and checksum."""
        return [line.partition(b":")[0].decode().split(" ", 3)[-1] for line in self.received.splitlines()]


class StageBench:
    """A stage, opened, and its wire."""

    def __init__(self, stage: ZaberStage, clock: Any, wire: Wire) -> None:
        self.stage, self.clock, self.wire = stage, clock, wire
        self.info = stage.open()
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def turn_until(self, condition: Callable[[], bool]) -> None:
        until_s = self.clock.monotonic_s() + 8.0
        while not condition():
            assert self.clock.monotonic_s() < until_s, f"not within 8 s; statuses: {self.statuses}"
            self.blocks += self.stage.read()
            statuses = self.stage.poll()
            assert all(one.device == "stage" and 0.0 <= one.t_s <= self.clock.now() for one in statuses)
            self.statuses += statuses
            self.clock.rest(0.001)

    def expect(self, kind: type[S]) -> S:
        """The next status of a kind; those before it are forgotten."""
        self.turn_until(lambda: any(isinstance(status, kind) for status in self.statuses))
        while True:
            status = self.statuses.pop(0)
            if isinstance(status, kind):
                return status

    def begin(self, command: Command) -> Sent:
        """Apply a motion and wait until it is on the wire."""
        self.stage.apply(command)
        return self.expect(Sent)
