"""The program's side of the arm's process, in whose place a test has the other end of the pipe."""

import os
import signal
import socket
import subprocess
from typing import Any

import pytest

from drivers.arm import host
from drivers.arm.pipe import Pipe, Start
from drivers.core.clock import VirtualClock
from drivers.core.messages import Stop
from tests.unit.drivers.arm.arm_process_bench import SETTINGS, Link


class Process:
    """What `subprocess.Popen` starts: its ends of pipe and counter, how it has ended, and what was done to it."""

    def __init__(self, *_, pass_fds, **__):
        theirs, turns = map(os.dup, pass_fds)
        self.pipe, self.turns = Pipe(socket.socket(fileno=theirs)), turns
        self.code, self.obeys, self.done = None, True, []

    def poll(self):
        return self.code

    def kill(self):
        self.done.append("kill")

    def wait(self, patience_s):
        self.done.append("wait")
        if not self.obeys:
            raise subprocess.TimeoutExpired("arm", patience_s)


@pytest.fixture
def started(monkeypatch):
    """A host, its process and its clock."""
    monkeypatch.setattr(subprocess, "Popen", Process)
    clock = VirtualClock()
    made = host.ArmHost("arm", SETTINGS, Link, clock, True)
    process: Any = made._process
    yield made, process, clock
    process.pipe.close()
    os.close(process.turns)


def test_it_hands_over_what_the_process_needs_then_commands_and_turns(started):
    arm, process, _ = started
    start = process.pipe.receive()
    assert isinstance(start, Start)
    assert (start.name, start.settings, start.link, start.again) == ("arm", SETTINGS, Link, True)
    arm.send(Stop("arm"))
    assert process.pipe.receive() == Stop("arm")
    for _ in range(3):
        arm.heartbeat()
    assert os.eventfd_read(process.turns) == 3
    arm.kill()
    assert process.done == ["kill", "wait"]


@pytest.mark.parametrize(
    ("code", "after_s", "reason"),
    [
        (None, 0.0, ""),
        (None, 0.5, "the arm's process closed its pipe"),
        (-signal.SIGKILL, 0.0, "the arm's process died (SIGKILL)"),
        (1, 0.0, "the arm's process gave up, for the program did not read"),
        (3, 0.0, "the arm's process ended with 3"),
    ],
)
def test_how_a_process_ended_is_said_once_its_messages_are_read(started, code, after_s, reason):
    arm, process, clock = started
    process.pipe.receive()
    process.pipe.send("its last word")
    process.pipe.close()
    process.code = code
    assert arm.exit_reason() == "", "it has left things to be received"
    assert arm.receive() == ["its last word"]
    clock.rest(after_s)
    assert arm.exit_reason().startswith(reason)
    assert bool(arm.exit_reason()) == bool(reason)
    arm.send(Stop("arm"))  # to a process that is gone: no error
    arm.kill()


@pytest.mark.parametrize("obeys", [True, False])
def test_a_process_is_asked_to_stop_the_arm_and_killed_where_it_does_not_end(started, obeys):
    arm, process, _ = started
    process.obeys = obeys
    process.pipe.receive()
    arm.close()
    with pytest.raises(EOFError):  # the end of the program's messages
        process.pipe.receive()
    assert process.done == ["wait", "kill", "wait"]
