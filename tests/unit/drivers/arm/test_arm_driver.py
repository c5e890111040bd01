"""The arm's driver beside a process made of lists: what it sends on, and what it does when the process goes."""

from typing import Any

import pytest

from drivers.arm.driver import ArmDriver
from drivers.arm.link import ArmRow, LinkError, Opened
from drivers.arm.settings import ArmSettings
from drivers.core.clock import VirtualClock
from drivers.core.errors import CommandError, PortError, ProtocolError, RefusedError, SilentError
from drivers.core.messages import (
    Failed,
    Listen,
    Lost,
    MoveTo,
    Reached,
    Refused,
    Sent,
    Stalled,
    Standstill,
    Stop,
    Tare,
)
from tests.refusals import refused

START = (0.4, 0.0, 0.2, 0.0, 3.0, 0.0)
REST = (0.0,) * 6
OPENED = Opened(
    "UR5e",
    "2019",
    "5.11.6",
    ArmRow(0.0, 0.0, (0.4, 0.0, 0.19, 0.0, 3.0, 0.0), REST, REST),
    {"client": "none"},
)
GONE = LinkError(SilentError, "the cable is out", "is it in?")
MOVE, STOP = MoveTo("arm", 0.01, 0.02, id=4), Stop("arm", id=5)
BEGIN_S = 50.0


class Process:
    """What `ArmHost` is: notes what is sent, gives what the test puts in."""

    def __init__(self, name, settings, link, clock, again):
        assert link is ArmDriver.link
        self.started = (name, settings, again)
        self.clock, self.received_s = clock, clock.monotonic_s()
        self.inbox, self.sent, self.done, self.ended, self.turns = [], [], [], "", 0

    def send(self, command):
        self.sent.append(command)

    def heartbeat(self):
        self.turns += 1

    def receive(self):
        taken, self.inbox = self.inbox, []
        if taken:
            self.received_s = self.clock.monotonic_s()
        return taken

    def exit_reason(self):
        return self.ended

    def kill(self):
        self.done.append("kill")

    def close(self):
        self.done.append("close")


class Desk:
    """A driver, and every process that it has started; a row comes in each turn of 10 ms."""

    def __init__(self, monkeypatch, **changes):
        self.clock, self.processes, self.inbox = VirtualClock(), [], [OPENED]
        self.clock.rest(BEGIN_S)
        self.clock.restart()
        monkeypatch.setattr("drivers.arm.driver.ArmHost", self.start)
        self.settings = ArmSettings(host="10.0.0.9", rate_hz=500.0, start_pose=START, **changes)
        monkeypatch.setattr(ArmDriver, "link", object(), raising=False)  # the process would make it
        self.arm = ArmDriver("arm", self.settings, self.clock)
        self.statuses, self.info = [], None

    def start(self, *args, **named):
        self.processes.append(Process(*args, **named))
        self.processes[-1].inbox, self.inbox = self.inbox, []
        return self.processes[-1]

    @property
    def process(self):
        return self.processes[-1]

    def row(self):
        now_s = self.clock.monotonic_s()
        return ArmRow(now_s, now_s - BEGIN_S, START, REST, REST)

    def turn(self, seconds=0.01, *, rows=True):
        until_s = self.clock.now() + seconds
        while self.clock.now() < until_s - 1e-9:
            self.clock.rest(0.01)
            if rows:
                self.process.inbox.append(self.row())
            self.statuses += self.arm.poll()
        statuses, self.statuses = self.statuses, []
        return statuses

    def silent(self, seconds):
        return self.turn(seconds, rows=False)


@pytest.fixture
def make_desk(monkeypatch):
    def made(**changes):
        desk = Desk(monkeypatch, **changes)
        desk.info = desk.arm.open()
        return desk

    return made


@pytest.fixture
def desk(make_desk):
    return make_desk()


def test_open_starts_one_process_and_reports_what_it_found(desk):
    (process,) = desk.processes
    assert process.started == ("arm", desk.settings, False)
    assert process.done == process.sent == []
    info = desk.info
    assert (info.device, info.model, info.serial, info.version, info.mover) == (
        "arm",
        "UR5e",
        "2019",
        "5.11.6",
        True,
    )
    assert info.clock == "arm controller"
    assert set(info.streams) == {"arm.position", "arm.pose", "arm.force"}
    assert info.details == {
        "client": "none",
        "host": "10.0.0.9",
        "position_m": pytest.approx(0.01),
        "travel_m": (-0.05, 0.05),
        "max_speed_m_s": 0.05,
    }


@pytest.mark.parametrize("error", [PortError, SilentError, RefusedError, ProtocolError])
def test_a_process_that_cannot_open_says_why_and_is_killed(monkeypatch, error):
    desk = Desk(monkeypatch)
    desk.inbox = [LinkError(error, "it is off", "switch it on")]
    with pytest.raises(error, match=r"^arm: it is off while opening; switch it on$"):
        desk.arm.open()
    assert desk.process.done == ["kill"]
    desk.arm.apply(STOP)
    assert desk.arm.poll() == [Refused(0.0, "arm", STOP, "it is not open")]


def test_a_process_that_dies_while_opening_is_reported(monkeypatch):
    desk = Desk(monkeypatch)
    desk.inbox = []
    monkeypatch.setattr(Process, "exit_reason", lambda self: "the arm's process ended with 3")
    with pytest.raises(
        SilentError, match=r"^arm: the arm's process ended with 3 while opening; is anything else"
    ):
        desk.arm.open()
    assert desk.process.done == ["kill"]


def test_a_controller_that_sends_nothing_is_given_up_after_its_time(monkeypatch):
    desk = Desk(monkeypatch, open_timeout_s=2.0)
    desk.inbox = [desk.row()]
    message = r"^arm: 10.0.0.9 accepts the connection and then sends nothing for 2 s while opening; is the controller"
    with pytest.raises(SilentError, match=message):
        desk.arm.open()
    assert desk.clock.now() == pytest.approx(2.0, abs=0.006)
    assert desk.process.done == ["kill"]


def test_one_that_is_opened_again_hands_out_nothing_of_before_and_nothing_between_is_lost(desk):
    desk.arm.apply(Listen("arm", frozenset({"arm.force"})))
    desk.turn()  # polled alone: the block waits to be read
    lost = desk.arm.account()["rows_lost"]
    desk.arm.close()
    desk.clock.rest(5.0)
    desk.inbox = [OPENED]
    opened_s = desk.clock.now()
    desk.arm.open()
    desk.arm.apply(Listen("arm", frozenset({"arm.force"})))
    assert (desk.arm.read(), desk.arm.poll()) == ([], [])
    desk.clock.rest(0.01)
    desk.process.inbox.append(desk.row())
    (block,) = desk.arm.read()
    assert block.t0_s > opened_s
    assert desk.arm.poll() == []
    assert desk.arm.account()["rows_lost"] == lost


def test_closing_lets_the_process_stop_the_arm_once_and_refuses_what_follows(desk):
    desk.arm.apply(Listen("arm", frozenset({"arm.force"})))
    desk.arm.close()
    desk.arm.close()
    assert desk.process.done == ["close"]
    desk.arm.apply(STOP)
    assert desk.arm.poll() == [Refused(0.0, "arm", STOP, "it is not open")]
    assert desk.process.sent == []
    desk.inbox = [OPENED]
    desk.arm.open()
    desk.turn()
    assert desk.arm.read() == [], "it is unsubscribed"
    assert len(desk.processes) == 2


def test_opening_again_closes_first(desk):
    desk.inbox = [OPENED]
    desk.arm.open()
    assert [process.done for process in desk.processes] == [["close"], []]


def test_a_valid_command_is_sent_on_at_once_and_nothing_else(desk):
    assert desk.arm.apply(MOVE) == MOVE
    assert desk.arm.apply(MoveTo("arm", 0.01, 9.0)).speed_m_s == 0.05
    desk.arm.apply(STOP)
    with pytest.raises(CommandError, match=r"^arm: its travel"):
        desk.arm.apply(MoveTo("arm", 1.0, 0.02))
    with pytest.raises(CommandError, match=r"its streams are arm.force, arm.pose, arm.position$"):
        desk.arm.apply(Tare("arm", "arm.pose"))
    assert desk.process.sent == [MOVE, MoveTo("arm", 0.01, 0.05), STOP]


def test_what_is_listened_to_goes_to_no_process_and_names_of_others_are_passed_over(desk):
    listen = Listen("arm", frozenset({"arm.force", "stage.position"}))
    desk.clock.rest(0.25)
    assert desk.arm.apply(listen) == listen
    assert desk.process.sent == []
    desk.turn(0.02)
    assert [block.stream for block in desk.arm.read()] == ["arm.force"] * 2


def test_each_turn_tells_the_process_and_gives_statuses_in_bench_time(desk):
    desk.turn(0.05)
    assert desk.process.turns == 5
    at_s = desk.clock.monotonic_s()
    desk.process.inbox = [Sent(at_s, "arm", MOVE), Reached(at_s - 0.01, "arm", 0.01, command_id=4)]
    assert desk.arm.poll() == [
        Sent(pytest.approx(desk.clock.now()), "arm", MOVE),
        Reached(pytest.approx(desk.clock.now() - 0.01), "arm", 0.01, command_id=4),
    ]


def test_a_missing_row_is_reported(desk):
    desk.arm.apply(Listen("arm", frozenset({"arm.force"})))
    desk.turn(0.02)
    ((lost),) = [status for status in desk.turn(0.01) if isinstance(status, Lost)]
    assert (lost.stream, lost.samples) == ("arm.force", 4)
    assert desk.arm.account() == {"rows": 3, "rows_lost": 8, "links_lost": 0}


@pytest.mark.parametrize("how", ["it reports it", "it ends", "it hangs"])
def test_a_link_that_is_lost_is_a_stall_and_another_process_is_started(desk, how):
    desk.turn(0.1)
    if how == "it reports it":
        desk.process.inbox, reason = [GONE], "the cable is out"
    elif how == "it ends":
        desk.process.ended = reason = "the arm's process died (SIGSEGV)"
    else:
        reason = "the arm's process hangs"
        assert desk.silent(0.40) == [], "rows may be away for 0.3 s and a time-out of 0.1 s"
    assert desk.silent(0.01) == [Stalled(desk.clock.now(), "arm", f"{reason}; connecting again")]
    first = desk.processes[0]
    assert first.done == ["kill"]
    if how != "it reports it":
        assert len(desk.processes) == 1
        desk.silent(0.01)
    assert [process.started for process in desk.processes[1:]] == [("arm", desk.settings, True)]
    assert desk.arm.account()["links_lost"] == 1
    desk.process.inbox = [OPENED]
    assert desk.turn(0.5) == []
    desk.arm.apply(MOVE)
    assert desk.process.sent == [MOVE]


def test_a_motion_while_connecting_again_is_refused_and_a_stop_waits_for_the_link(desk):
    desk.turn(0.1)
    desk.process.inbox = [GONE]
    desk.silent(0.02)
    desk.arm.apply(MOVE)
    desk.arm.apply(STOP)
    assert desk.silent(0.01) == [
        Refused(desk.clock.now() - 0.01, "arm", MOVE, "the cable is out; connecting again")
    ]
    assert desk.process.sent == []
    desk.process.inbox = [OPENED]
    desk.turn()
    assert desk.process.sent == [STOP]


def test_a_stop_that_has_no_standstill_yet_is_sent_again_to_the_next_process(desk):
    desk.arm.apply(STOP)
    desk.turn(0.1)
    desk.process.ended = "it died"
    desk.silent(0.02)
    desk.process.inbox = [OPENED]
    desk.turn()
    assert desk.process.sent == [STOP]
    desk.process.inbox = [Standstill(desk.clock.monotonic_s(), "arm", 0.0, command_id=5)]
    assert [status.command_id for status in desk.turn()] == [5]
    desk.process.ended = "it died"
    desk.silent(0.02)
    desk.process.inbox = [OPENED]
    desk.turn()
    assert desk.process.sent == [], "it was answered"


def test_a_stop_of_an_earlier_session_is_forgotten(desk):
    desk.arm.apply(STOP)
    desk.arm.close()
    desk.inbox = [OPENED]
    desk.arm.open()
    desk.process.ended = "it died"
    desk.silent(0.02)
    desk.process.inbox = [OPENED]
    desk.turn()
    assert len(desk.processes) == 3
    assert desk.process.sent == []


def test_a_lost_link_is_tried_again_every_half_second_and_then_the_arm_has_failed(make_desk):
    desk = make_desk(reconnect_s=1.2)
    desk.turn(0.1)
    desk.process.inbox = [GONE]
    desk.silent(0.01)
    lost_s, begun_s = desk.clock.now(), []
    statuses = []
    while desk.clock.now() < lost_s + 2.0:
        known = len(desk.processes)
        if desk.process.done == []:
            desk.process.inbox = [LinkError(PortError, "nothing listens", "-")]
        statuses += desk.silent(0.01)
        begun_s += [desk.clock.now() - lost_s] * (len(desk.processes) - known)
    assert begun_s == pytest.approx([0.51, 1.02], abs=0.021)
    assert statuses == [
        Failed(
            pytest.approx(lost_s + 1.2, abs=0.015),
            "arm",
            "nothing listens; is 10.0.0.9 up, and the cable in?",
        )
    ]
    assert all("kill" in process.done for process in desk.processes)
    desk.arm.apply(STOP)
    (refused,) = desk.silent(0.01)
    assert refused.reason == "nothing listens; is 10.0.0.9 up, and the cable in?"
    count = len(desk.processes)
    desk.silent(1.0)
    assert len(desk.processes) == count


def test_an_arm_that_gives_up_kills_the_process_that_is_still_opening(make_desk):
    desk = make_desk(reconnect_s=0.3)
    desk.process.inbox = [GONE]
    desk.silent(0.02)
    assert len(desk.processes) == 2
    assert [type(status) for status in desk.silent(0.5)] == [Failed]
    assert desk.process.done == ["kill"]
    desk.arm.close()
    assert desk.process.done == ["kill"]


def test_an_arm_that_shall_not_connect_again_fails_at_once(make_desk):
    desk = make_desk(reconnect_s=0.0)
    desk.process.inbox = [GONE]
    assert [type(status) for status in desk.silent(0.01)] == [Stalled, Failed]
    assert len(desk.processes) == 1


def test_a_program_that_was_away_does_not_blame_the_process(desk):
    """What came meanwhile may still be on its way."""
    desk.turn(0.1)
    for away_s in (3.0, 0.16):
        desk.clock.rest(away_s)
        assert desk.arm.poll() == []
    assert desk.turn(0.1) == []
    desk.clock.rest(3.0)
    assert desk.arm.poll() == []
    desk.clock.rest(0.01)
    assert [type(status) for status in desk.arm.poll()] == [Stalled], "the turn after that was in time"


@pytest.mark.parametrize("package", ["", "numpy"])
def test_a_client_that_is_missing_is_told_before_the_arm_is_made(package):
    def check(needed):
        link = type("Link", (), {"package": needed, "extra": ""})
        made: Any = type("Other", (ArmDriver,), {"link": link})
        made.check_installed("arm")

    check(package)
    with refused(RefusedError, "arm", "no_such_client is not installed", "pip install no_such_client"):
        check("no_such_client")
