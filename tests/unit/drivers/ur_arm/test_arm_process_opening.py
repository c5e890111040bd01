"""The arm's process opens: what it queries, what it refuses and what it reports. In virtual time."""

from __future__ import annotations

import math
import os
import socket
import sys
from importlib.metadata import version
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import pytest

from drivers.bench_clock import BenchClock, ClockPage
from drivers.clock import WallClock
from drivers.ur_arm import child
from drivers.ur_arm.controller import PLAYING
from drivers.ur_arm.pipe import Broken, BrokenError, Opened, Pipe, Start
from tests.unit.drivers.ur_arm.arm_process_bench import BEGIN_S, SETTINGS, START, Arm, EndError

STOPPED, NORMAL, PROTECTIVE = 1, 1, 4
HOST = SETTINGS.host
CYCLE_S = 0.002
OTHER = Broken("refused", "another program runs on the controller", "stop it at the pendant, or its host")


class Dashboard:
    """Answers as a controller in remote control does, and notes the queries."""

    def __init__(self):
        self.asked, self.polyscope, self.stops = [], "5.9.4", lambda: None
        self.answers = {
            "is in remote control": "true",
            "get robot model": "UR5",
            "get serial number": "20195500",
            "stop": "Stopped",
        }

    def version(self):
        return self.polyscope

    def ask(self, line):
        self.asked.append(line)
        if line == "stop":
            self.stops()
        return self.answers[line]


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


class Opening(Arm):
    """A process that is not connected yet; the controller's rows come every 2 ms."""

    def __init__(self, monkeypatch):
        super().__init__(monkeypatch)
        self.receive.safety, self.receive.runtime = NORMAL, STOPPED
        self.dashboard, self.client, self.plays_s = Dashboard(), Client(), math.inf
        self.hosts, self.streams, self.uploads, self.threads, self.sockets = [], [], [], [], object()
        self.error = None
        module: Any = ModuleType("rtde_receive")
        module.RTDEReceiveInterface = self.connect
        monkeypatch.setitem(sys.modules, "rtde_receive", module)
        monkeypatch.setattr(child, "Dashboard", lambda host: self.hosts.append(host) or self.dashboard)
        monkeypatch.setattr(child, "RtdeSockets", lambda: self.sockets)
        monkeypatch.setattr(child, "RtdeClient", self.upload)
        monkeypatch.setattr(
            child, "_ask_for_realtime", lambda priority: priority == SETTINGS.realtime_priority
        )
        monkeypatch.setattr(child, "threading", SimpleNamespace(Thread=self.thread))
        self.clock.each = self.cycle

    def cycle(self):
        passed_s = self.clock.monotonic_s() - BEGIN_S
        self.receive.device_s = 7.0 + CYCLE_S * math.floor(passed_s / CYCLE_S + 1e-6)
        if self.clock.monotonic_s() >= self.plays_s:
            self.receive.runtime = PLAYING

    def connect(self, *stream):
        if self.error is not None:
            raise self.error
        self.streams.append(stream)
        return self.receive

    def upload(self, settings, dashboard, clock, latest, receiving):
        assert latest() is self.process._row
        self.uploads.append((settings, dashboard, clock, receiving))
        self.clock.rest(3.0)
        self.plays_s = self.clock.monotonic_s() + 0.05
        return self.client

    def thread(self, **given):
        def start():
            self.threads.append(
                (given, self.clock.monotonic_s(), self.process._heartbeat_s, self.process._row)
            )

        return SimpleNamespace(start=start)

    def opens(self, again=False):
        """Open, for a program that has exited by then: the first message."""
        self.ends[0].shutdown(socket.SHUT_WR)
        self.process.run(again)
        return self.messages()[0]

    def refuses(self, again=False):
        self.ends[0].shutdown(socket.SHUT_WR)  # a process that opens all the same ends
        with pytest.raises(BrokenError) as caught:
            self.process.run(again)
        assert self.uploads == self.threads == self.messages() == []
        return caught.value.broken


@pytest.fixture
def opening(monkeypatch):
    made = Opening(monkeypatch)
    yield made
    made.close()


def test_an_arm_that_opens_reports_what_it_is_and_has_a_listener_and_a_program_that_ends(opening):
    details = {"client": f"ur_rtde {version('ur_rtde')}", "realtime": True}
    assert opening.opens() == Opened("UR5", "20195500", "5.9.4", START, details)
    assert opening.hosts == [HOST]
    assert opening.streams == [(HOST, 500.0, child.VARIABLES)]
    assert opening.uploads == [(SETTINGS, opening.dashboard, opening.clock, opening.sockets)]
    ((thread, begun_s, heartbeat_s, row),) = opening.threads
    listener = {
        "target": opening.process._listen,
        "args": (opening.client,),
        "name": "listener",
        "daemon": True,
    }
    assert thread == listener, "a daemon does not keep the process alive"
    assert row.runtime == PLAYING
    assert begun_s == pytest.approx(opening.plays_s, abs=2 * CYCLE_S)
    assert heartbeat_s == begun_s, "the time to open is not taken for a client that is blocked"
    assert opening.client.calls[-1] == "leave"


@pytest.mark.parametrize("found", ["5.6.0", "5.10.1", "5.25.0.123"])
def test_a_polyscope_of_5_6_or_later_is_taken(opening, found):
    opening.dashboard.polyscope = found
    assert opening.opens().version == found


@pytest.mark.parametrize(
    ("found", "called"),
    [
        ("5.5.9", "5.5.9"),
        ("4.9.0", "4.9.0"),
        ("3.15.4", "3.15.4"),
        ("6.8.0", "6.8.0"),
        ("", "of unknown version"),
    ],
)
def test_another_polyscope_is_refused_before_any_other_query(opening, found, called):
    opening.dashboard.polyscope = found
    assert opening.refuses() == Broken(
        "refused", f"PolyScope {called} is not supported", "it takes 5.6 or a later 5.x"
    )
    assert opening.dashboard.asked == opening.streams == []


def test_a_client_that_does_not_connect_is_a_port_that_does_not_answer(opening):
    opening.error = RuntimeError("Connection refused")
    assert opening.refuses() == Broken(
        "port", "the client reports: Connection refused", "is the controller on, and is the address right?"
    )


@pytest.mark.parametrize("what", ["connected", "device_s"])
def test_a_controller_that_sends_no_data_is_silent(opening, what):
    setattr(opening.receive, what, {"connected": False, "device_s": 0.0}[what])
    assert opening.refuses() == Broken(
        "silent", f"no data come from {HOST}", "is the controller up, and RTDE switched on at the pendant?"
    )
    assert opening.clock.monotonic_s() == BEGIN_S


def test_a_controller_that_is_not_in_remote_control_is_refused(opening):
    opening.dashboard.answers["is in remote control"] = "false"
    assert opening.refuses() == Broken("refused", "remote control is off", "switch it on at the pendant")


def test_an_arm_that_may_not_move_is_refused_and_not_released(opening):
    opening.receive.safety = NORMAL | PROTECTIVE
    assert opening.refuses(again=True) == Broken(
        "refused", "the arm is in a protective stop", "look at the arm, and release it at the pendant"
    )
    assert opening.dashboard.asked == ["is in remote control"]


def test_a_program_of_another_host_is_not_stopped_but_refused_after_a_second(opening):
    opening.receive.runtime = PLAYING
    assert opening.refuses() == OTHER
    assert opening.clock.monotonic_s() - BEGIN_S == pytest.approx(1.0, abs=2 * CYCLE_S)
    assert "stop" not in opening.dashboard.asked


def test_a_program_that_ends_within_a_second_does_not_matter(opening):
    opening.receive.runtime = PLAYING
    cycle, opening.clock.each = opening.clock.each, lambda: (cycle(), ends())

    def ends():
        if BEGIN_S + 0.5 < opening.clock.monotonic_s() < opening.plays_s:
            opening.receive.runtime = STOPPED

    assert isinstance(opening.opens(), Opened)
    assert "stop" not in opening.dashboard.asked


@pytest.mark.parametrize(("runtime", "stops"), [(PLAYING, 1), (STOPPED, 0)])
def test_a_process_that_replaces_another_stops_the_program_that_the_other_has_left(opening, runtime, stops):
    opening.receive.runtime = runtime
    opening.dashboard.stops = lambda: setattr(opening.receive, "runtime", STOPPED)
    assert isinstance(opening.opens(again=True), Opened)
    assert opening.dashboard.asked.count("stop") == stops


def test_a_program_that_goes_on_though_it_was_stopped_is_refused(opening):
    opening.receive.runtime = PLAYING
    assert opening.refuses(again=True) == OTHER
    assert opening.dashboard.asked.count("stop") == 1


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
    assert child._ask_for_realtime(priority) is (asked and allowed)
    assert calls == [(0, os.SCHED_FIFO, priority)] * asked


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

    def begin(error=None, clock="", again=False):
        waits_s = []

        class PatientPipe(Pipe):
            def wait(self, seconds):
                waits_s.append(seconds)
                return super().wait(seconds)

        def leave(code):
            raise EndError(code)

        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        Pipe(ours).send(Start("arm", SETTINGS.model_dump_json(), again, 17, clock))
        monkeypatch.setattr(sys, "argv", ["child", str(theirs.detach())])
        monkeypatch.setattr(child, "Pipe", PatientPipe)
        monkeypatch.setattr(child, "ArmProcess", Process)
        monkeypatch.setattr(Process, "error", error)
        monkeypatch.setattr(os, "_exit", leave)
        with pytest.raises(EndError) as ended:
            child.main()
        pipe, *_ = Process.made.given
        pipe.send("up")
        assert Pipe(ours).receive() == "up"
        pipe.close()
        ours.close()
        assert waits_s == [child.START_S]
        return Process.made, ended.value.args

    return begin


@pytest.mark.parametrize("again", [False, True])
def test_the_process_begins_with_the_program_s_first_message_and_exits_with_0(begun, again):
    process, ended = begun(again=again)
    _, turns, name, settings, clock = process.given
    assert (turns, name, settings, type(clock)) == (17, "arm", SETTINGS, WallClock)
    assert (process.runs, process.reports, ended) == ([again], [], (0,))


def test_the_process_joins_the_clock_of_an_emulated_bench(begun):
    page = ClockPage()
    process, _ = begun(clock=page.path)
    clock = process.given[-1]
    assert isinstance(clock, BenchClock)
    assert clock.path == page.path


@pytest.mark.parametrize(
    ("error", "broken"),
    [
        (BrokenError("silent", "no data", "look"), Broken("silent", "no data", "look")),
        (
            ModuleNotFoundError("No module named 'rtde_receive'"),
            Broken(
                "refused", "the client is missing (No module named 'rtde_receive')", "pip install ur_rtde"
            ),
        ),
        (ValueError("a b"), Broken("protocol", "ValueError: a b", "report this with the recording")),
    ],
)
def test_whatever_ends_the_process_is_reported_first(begun, error, broken):
    process, ended = begun(error)
    assert (process.reports, ended) == ([broken], (1,))
