"""The arm's process takes commands in every cycle, however long the client's calls take: in virtual time."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator
from contextlib import closing
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.arm.link import ArmRow, Seen
from drivers.arm.pipe import Pipe, Start
from drivers.arm.process import ArmProcess
from drivers.arm.settings import ArmSettings, Pose
from drivers.core.clock import VirtualClock
from drivers.core.messages import Command, MoveAt, Stalled, Status, Stop

START: Pose = (0.3, 0.0, 0.3, 0.0, 3.14, 0.0)
SETTINGS = ArmSettings(host="127.0.0.1", rate_hz=500.0, start_pose=START, loop_timeout_s=5.0)
CALL_S = 0.009
"""Longer than a cycle of commands, which is 8 ms."""

STUCK = 500
"""Cycles after which a test gives up."""


class SlowClient:
    """Every call takes longer than a cycle; the tool obeys at once."""

    def __init__(self) -> None:
        self.twists: list[Pose] = []
        self.calls, self.turning = 0, True  # whether the program's loop turns
        self.after: Callable[[], object] = lambda: None

    def _call(self) -> bool:
        self.calls += 1
        self.clock.rest(CALL_S)
        twist = self.twists[-1] if self.twists else (0.0,) * 6
        now_s = self.clock.monotonic_s()
        self.process._seen = self.process._seen.then(ArmRow(now_s, now_s, START, twist, (0.0,) * 6))
        if self.turning:
            os.eventfd_write(self.process._turns, 1)
        self.after()
        return True

    def join(self, process: ArmProcess, clock: VirtualClock) -> None:
        self.process, self.clock = process, clock

    def speed(self, twist: Pose, acceleration_m_s2: float) -> bool:
        self.twists.append(twist)
        return self._call()

    def end_speed(self) -> bool:
        return self._call()

    def feed_watchdog(self) -> bool:
        return self._call()

    def busy(self) -> bool:
        return False

    def halt(self) -> None: ...

    def leave(self) -> None: ...


class VirtualPipe(Pipe):
    """To wait at it takes virtual time."""

    def __init__(self, end: socket.socket, clock: VirtualClock) -> None:
        super().__init__(end)
        self._clock = clock

    def wait(self, seconds: float) -> bool:
        self._clock.rest(seconds)
        return super().wait(0.0)


class Program:
    """The other end of the pipe."""

    def __init__(self, settings: ArmSettings = SETTINGS) -> None:
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        self.socket, self.pipe = ours, Pipe(ours)
        self._theirs, self._turns = theirs, os.eventfd(0, os.EFD_NONBLOCK)
        clock, self.client = VirtualClock(), SlowClient()
        clock.rest(100.0)
        link: Any = SimpleNamespace(client=self.client)
        start = Start("arm", settings, lambda *_: link, False, self._turns, clock)  # type: ignore[arg-type]
        self.process = ArmProcess(VirtualPipe(theirs, clock), start)
        self.client.join(self.process, clock)
        now_s = clock.monotonic_s()
        self.process._seen = Seen(ArmRow(now_s, now_s, START, (0.0,) * 6, (0.0,) * 6), now_s)

    def at(self, deeds: dict[int, Callable[[], object]]) -> None:
        """Do something after so many of the client's calls, and end at last."""

        def after() -> None:
            deeds.get(self.client.calls, lambda: None)()
            if self.client.calls == STUCK:
                raise AssertionError("it never took a command")

        self.client.after = after
        self.process._obey()

    def statuses(self) -> list[Status]:
        found = []
        while isinstance(message := self.pipe.receive(), Status):
            found.append(message)
        return found

    def send(self, *commands: Command) -> None:
        for command in commands:
            assert self.pipe.send(command)

    def hang_up(self) -> None:
        self.pipe.hang_up()

    def close(self) -> None:
        self.pipe.close()
        self._theirs.close()
        os.close(self._turns)


@pytest.fixture
def program() -> Iterator[Program]:
    made = Program()
    yield made
    made.close()


def test_a_stop_is_obeyed_in_the_next_cycle_whatever_each_call_takes(program: Program) -> None:
    program.at(
        {
            5: lambda: program.send(MoveAt("arm", 0.001, 0.04)),
            50: lambda: program.send(Stop("arm")),
            90: program.hang_up,
        }
    )
    moving = [any(twist) for twist in program.client.twists]
    moved = moving.index(False)
    assert all(moving[:moved]) and not any(moving[moved:])
    assert 43 <= moved <= 46, "a call for each cycle from the fifth to the fiftieth, and then it brakes"


def test_a_program_whose_loop_hangs_moves_the_arm_no_longer_than_its_loop_timeout() -> None:
    with closing(Program(SETTINGS.model_copy(update={"loop_timeout_s": 0.45}))) as program:
        program.at(
            {
                5: lambda: program.send(MoveAt("arm", 0.001, 0.04)),
                100: lambda: setattr(program.client, "turning", False),
                200: program.hang_up,
            }
        )
        moving = [any(twist) for twist in program.client.twists]
        (stalled,) = [status for status in program.statuses() if isinstance(status, Stalled)]
    assert 145 <= 5 + moving.index(False) <= 156, (
        "50 calls of 9 ms after the last turn; before it, it goes on"
    )
    assert "the program has not looked at it" in stalled.reason


def test_the_program_s_end_is_seen_whatever_each_call_takes(program: Program) -> None:
    program.at({5: lambda: program.send(MoveAt("arm", 0.001, 0.04)), 20: program.hang_up})
    assert program.client.calls < 40
    assert not any(program.client.twists[-1])


def test_a_program_that_does_not_read_blocks_nothing(program: Program) -> None:
    sent = 0
    while not program.process._outbox:
        program.process._send(program.process._seen.row)
        sent += 1
        assert sent < 100_000
    program.process._send(program.process._seen.row)
    read = 0
    while program.pipe.receive() is not None:
        read += 1
    program.process._send(program.process._seen.row)
    while program.pipe.receive() is not None:
        read += 1
    assert read == sent + 2, "what waited follows, in order, and nothing is lost"
