"""The arm's process begins: its first message, its priority, its clock, and what it reports. In virtual time."""

from __future__ import annotations

import os
import socket
import sys
import time
from importlib.metadata import version
from types import SimpleNamespace
from typing import ClassVar

import pytest

from drivers.arm import process
from drivers.arm.link import ArmRow, Broken, BrokenError, Opened
from drivers.arm.pipe import Pipe, Start
from drivers.core.bench_clock import BenchClock, ClockPage
from drivers.core.clock import WallClock
from tests.unit.drivers.arm.arm_process_bench import REST, SETTINGS, START, Arm, EndError


class Client:
    """Its arm stands; notes the calls."""

    def __init__(self):
        self.calls = []

    def kick(self):
        self.calls.append("kick")
        return True

    def busy(self):
        return False

    def leave(self):
        self.calls.append("leave")


def test_an_arm_that_opens_has_its_report_a_listener_and_a_program_that_ends(monkeypatch):
    arm, threads, again = Arm(monkeypatch), [], []
    opened = Opened("UR5", "20195500", "5.9.4", ArmRow(103.0, 9.0, START, REST, REST), {"tool": 2})

    def opens(replaces):
        again.append(replaces)
        arm.clock.rest(3.0)
        arm.link.client = Client()
        return opened

    def thread(**given):
        return SimpleNamespace(start=lambda: threads.append((given, arm.process._heartbeat_s)))

    arm.link.open = opens
    monkeypatch.setattr(process, "_ask_for_realtime", lambda priority: priority == SETTINGS.realtime_priority)
    monkeypatch.setattr(process, "threading", SimpleNamespace(Thread=thread))
    arm.ends[0].shutdown(socket.SHUT_WR)
    arm.process.run(True)
    report = arm.messages()[0]
    arm.close()
    assert again == [True]
    details = {"client": f"pytest {version('pytest')}", "realtime": True, "tool": 2}
    assert report == Opened("UR5", "20195500", "5.9.4", opened.row, details)
    ((listener, heartbeat_s),) = threads
    expected = {"target": arm.process._listen, "name": "listener", "daemon": True}
    assert listener == expected, "a daemon does not keep the process alive"
    assert heartbeat_s == 103.0, "the time to open is not taken for a client that is blocked"
    assert arm.link.client.calls[-1] == "leave"


@pytest.mark.parametrize(
    ("priority", "cores", "allowed", "asked"),
    [
        (10, 2, True, True),
        (10, 2, False, True),
        (10, 1, True, False),
        (0, 2, True, False),
        (1, 8, True, True),
    ],
)
def test_it_is_scheduled_first_where_that_is_asked_for_allowed_and_safe(
    monkeypatch, priority, cores, allowed, asked
):
    calls = []

    def schedule(process, policy, parameters):
        calls.append((process, policy, parameters.sched_priority))
        if not allowed:
            raise PermissionError

    monkeypatch.setattr(os, "sched_getaffinity", lambda process: {0: set(range(cores))}[process])
    monkeypatch.setattr(os, "sched_setscheduler", schedule)
    assert process._ask_for_realtime(priority) is (asked and allowed)
    assert calls == [(0, os.SCHED_FIFO, priority)] * asked


class MadeLink:
    """What `main` makes of the program's first message."""

    package, extra = "arm_client", "some_arm"

    def __init__(self, settings, clock):
        self.given = (settings, clock)


class Process:
    """The arm's process, as `main` begins and ends it."""

    error: BaseException | None = None
    made: ClassVar[Process]

    def __init__(self, *given):
        self.given, self.runs, self.reports = given, [], []
        Process.made = self

    def run(self, again):
        self.runs.append(again)
        if self.error is not None:
            raise self.error

    def end(self, broken):
        self.reports.append(broken)
        raise EndError(1)


@pytest.fixture
def begun(monkeypatch):
    """Begin a process with the program's first message; the process and its exit code."""

    def begin(error=None, clock=None, again=False):
        waits_s = []

        class PatientPipe(Pipe):
            def wait(self, seconds):
                waits_s.append(seconds)
                return super().wait(seconds)

        def leave(code):
            raise EndError(code)

        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        Pipe(ours).send(Start("arm", SETTINGS, MadeLink, again, 17, clock or WallClock()))
        monkeypatch.setattr(sys, "argv", ["process", str(theirs.detach())])
        monkeypatch.setattr(process, "Pipe", PatientPipe)
        monkeypatch.setattr(process, "ArmProcess", Process)
        monkeypatch.setattr(Process, "error", error)
        monkeypatch.setattr(os, "_exit", leave)
        with pytest.raises(EndError) as ended:
            process.main()
        pipe, *_ = Process.made.given
        pipe.send("up")
        assert Pipe(ours).receive() == "up"
        pipe.close()
        ours.close()
        assert waits_s == [process.START_S]
        return Process.made, ended.value.args

    return begin


@pytest.mark.parametrize("again", [False, True])
def test_the_process_begins_with_the_program_s_first_message_and_exits_with_0(begun, again):
    made, ended = begun(again=again)
    _, turns, name, settings, link, clock = made.given
    assert (turns, name, settings, type(clock)) == (17, "arm", SETTINGS, WallClock)
    assert isinstance(link, MadeLink) and link.given == (settings, clock)
    assert (made.runs, made.reports, ended) == ([again], [], (0,))


def test_the_process_is_handed_the_clock_of_the_bench_whichever_it_is(begun):
    page = ClockPage()
    made, _ = begun(clock=BenchClock(page))
    clock = made.given[-1]
    assert isinstance(clock, BenchClock)
    page.write(5000.0, time.monotonic(), 5000.0)
    assert clock.monotonic_s() == 5000.0, "it is the same time"


@pytest.mark.parametrize(
    ("error", "broken"),
    [
        (BrokenError("silent", "no data", "look"), Broken("silent", "no data", "look")),
        (
            ModuleNotFoundError("No module named 'arm_client'"),
            Broken(
                "refused",
                "the client is missing (No module named 'arm_client')",
                "install it: pip install 'touchbench[some_arm]'",
            ),
        ),
        (ValueError("a b"), Broken("protocol", "ValueError: a b", "report this with the recording")),
    ],
)
def test_whatever_ends_the_process_is_reported_first(begun, error, broken):
    made, ended = begun(error)
    assert (made.reports, ended) == ([broken], (1,))
