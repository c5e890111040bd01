"""The arm's process begins: its first message, its priority, its clock, and what it reports. In virtual time."""

import os
import socket
import sys
import time
from importlib.metadata import version
from types import SimpleNamespace
from typing import ClassVar

import pytest

from drivers.arm import process
from drivers.arm.link import ArmRow, LinkError, Opened
from drivers.arm.pipe import Pipe, Start
from drivers.core.clock import WallClock
from drivers.core.errors import WHEELS_TO, ProtocolError, RefusedError, SilentError
from simulator.wiring.bench_clock import BenchClock, ClockPage
from tests.unit.drivers.arm.arm_process_bench import REST, SETTINGS, START, Arm, Deaf, EndError


@pytest.mark.parametrize(("priority", "package"), [(10, "pytest"), (0, "pytest"), (0, "")])
def test_an_arm_that_opens_has_its_report_a_listener_and_a_program_that_ends(monkeypatch, priority, package):
    arm, threads, again = Arm(monkeypatch), [], []
    arm.link.package = package
    arm.process._settings = SETTINGS.model_copy(update={"realtime_priority": priority})
    opened = Opened("UR5", "20195500", "5.9.4", ArmRow(103.0, 9.0, START, REST, REST), {"tool": 2})

    def opens(replaces):
        again.append(replaces)
        arm.clock.rest(3.0)
        arm.link.client = Deaf()
        return opened

    def thread(**given):
        return SimpleNamespace(start=lambda: threads.append((given, arm.process._heartbeat_s)))

    arm.link.open = opens
    monkeypatch.setattr(process, "_ask_for_realtime", lambda given: given == priority)
    monkeypatch.setattr(process, "threading", SimpleNamespace(Thread=thread))
    arm.ends[0].shutdown(socket.SHUT_WR)
    arm.process.run()
    report = arm.messages()[0]
    arm.close()
    assert again == [False]
    details = {"client": f"pytest {version('pytest')}"} if package else {}
    details |= {"tool": 2}
    details |= {"realtime": True} if priority else {}  # what is not asked for is not missing
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
    """What the process makes of the program's first message; it does not open."""

    package, extra = "arm_client", "some_arm"
    error: ClassVar[Exception]
    opened: ClassVar[list[tuple[object, ...]]]

    def __init__(self, settings, clock):
        self.settings, self.clock = settings, clock

    def open(self, again):
        self.opened.append((self.settings, self.clock, again))
        raise self.error


@pytest.fixture
def begun(monkeypatch):
    """Begin a process with the program's first message; what it reports, and its exit code."""

    def begin(error, clock=None, again=False):
        def leave(code):
            raise EndError(code)

        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        pipes = []
        monkeypatch.setattr(process, "Pipe", lambda end: pipes.append(Pipe(end)) or pipes[0])
        monkeypatch.setattr(sys, "argv", ["process", str(theirs.detach())])
        monkeypatch.setattr(MadeLink, "error", error, raising=False)
        monkeypatch.setattr(MadeLink, "opened", [], raising=False)
        monkeypatch.setattr(os, "_exit", leave)
        with ours:
            pipe = Pipe(ours)
            pipe.send(Start("arm", SETTINGS, MadeLink, again, 17, clock or WallClock()))
            with pytest.raises(EndError) as ended:
                process.main()
            pipes[0].close()
            return pipe.receive(), ended.value.args

    return begin


@pytest.mark.parametrize("again", [False, True])
def test_the_process_begins_with_the_program_s_first_message(begun, again):
    begun(ValueError(), again=again)
    ((settings, clock, replaces),) = MadeLink.opened
    assert (settings, type(clock), replaces) == (SETTINGS, WallClock, again)


def test_a_process_whose_program_has_ended_exits_with_0(begun, monkeypatch):
    monkeypatch.setattr(process.ArmProcess, "run", lambda self: self._pipe.send("left"))
    assert begun(ValueError()) == ("left", (0,))


def test_the_process_is_handed_the_clock_of_the_bench_whichever_it_is(begun):
    page = ClockPage()
    begun(ValueError(), BenchClock(page))
    ((_, clock, _),) = MadeLink.opened
    assert isinstance(clock, BenchClock)
    page.write(5000.0, time.monotonic(), 5000.0)
    assert clock.monotonic_s() == 5000.0, "it is the same time"


@pytest.mark.parametrize(
    ("error", "report"),
    [
        (LinkError(SilentError, "no data", "look"), (SilentError, "no data", "look")),
        (
            ModuleNotFoundError("No module named 'arm_client'"),
            (
                RefusedError,
                "the client is missing (No module named 'arm_client')",
                "install it: pip install 'touchbench[some_arm]'",
            ),
        ),
        (ValueError("a b"), (ProtocolError, "ValueError: a b", "report this with the recording")),
    ],
)
def test_whatever_ends_the_process_is_reported_first(begun, error, report):
    sent, ended = begun(error)
    assert (sent.args, ended) == (report, (1,))


def test_a_client_that_no_extra_brings_is_installed_by_its_own_name(begun, monkeypatch):
    monkeypatch.setattr(MadeLink, "extra", "")
    sent, _ = begun(ModuleNotFoundError("No module named 'arm_client'"))
    assert sent.args[2] == "install it: pip install arm_client"


def test_a_client_that_has_no_wheel_for_this_python_needs_an_earlier_one(begun, monkeypatch):
    monkeypatch.setitem(WHEELS_TO, "some_arm", (3, 10))
    sent, _ = begun(ModuleNotFoundError("No module named 'arm_client'"))
    assert sent.args[2] == "use Python 3.10"
