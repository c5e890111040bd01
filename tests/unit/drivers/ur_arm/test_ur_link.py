"""The link to a UR controller: what it queries, what it refuses, what it makes of rows. In virtual time."""

import math
import sys
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest

from drivers.arm.link import ArmRow, LinkError, Opened
from drivers.core.clock import VirtualClock
from drivers.core.errors import PortError, RefusedError, SilentError
from drivers.ur_arm import link
from drivers.ur_arm.client import PLAYING
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import Tool
from tests.refusals import refused

START = (0.3, 0.0, 0.3, 0.0, 3.14, 0.0)
REST = (0.0,) * 6
FORCE = (1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
STOPPED, NORMAL, PROTECTIVE = 1, 1, 4
SETTINGS = UrArmSettings(host="127.0.0.1", start_pose=START)
HOST = SETTINGS.host
BEGIN_S = 100.0
CYCLE_S = 0.002
TCP = (0.0, 0.0, 0.12, 0.0, 0.0, 1.57)
OTHER = (RefusedError, "another program runs on the controller", "stop it at the pendant, or its host")


class Receive:
    """The client's receive interface: the controller's latest row, and its time."""

    def __init__(self):
        self.device_s, self.connected, self.torn = 7.0, True, False
        self.safety, self.runtime, self.payload_kg = NORMAL, STOPPED, 1.25
        self.getTimestamp = lambda: self.device_s
        self.getActualTCPPose = lambda: list(START)
        self.getActualTCPSpeed = lambda: list(REST)
        self.getPayload = lambda: self.payload_kg
        self.getPayloadCog = lambda: [0.0, 0.01, 0.06]
        self.getTargetSpeedFraction = lambda: 0.5
        self.getSafetyStatusBits = lambda: self.safety
        self.getRuntimeState = lambda: self.runtime
        self.isConnected = lambda: self.connected

    def getActualTCPForce(self):  # noqa: N802
        if self.torn:
            self.device_s += 0.002
        return list(FORCE)


class Dashboard:
    """Answers as a controller in remote control does, and notes the queries."""

    def __init__(self):
        self.asked, self.polyscope, self.stops = [], "5.9.4", lambda: None
        self.answers = {
            "is in remote control": "true",
            "get robot model": "UR5",
            "get serial number": "20195500",
            "robotmode": "Robotmode: RUNNING",
            "safetystatus": "Safetystatus: NORMAL",
            "stop": "Stopped",
        }

    def version(self):
        return self.polyscope

    def ask(self, line):
        self.asked.append(line)
        if line == "stop":
            self.stops()
        return self.answers[line]


class Opening:
    """A link that is not open yet; the controller's rows come every 2 ms."""

    def __init__(self, monkeypatch):
        self.clock, self.receive, self.dashboard = VirtualClock(), Receive(), Dashboard()
        self.clock.rest(BEGIN_S)
        self.link = link.UrLink(SETTINGS, self.clock)
        self.hosts, self.streams, self.uploads, self.left = [], [], [], 0
        self.error, self.row_s, self.plays_s = None, CYCLE_S, math.inf
        self.each = lambda: None
        self.mounted, self.takes_payload = [], True
        self.stands = self.controls = True
        self.sockets = SimpleNamespace(stands=lambda: self.stands)
        module: Any = ModuleType("rtde_receive")
        module.RTDEReceiveInterface = self.connect
        monkeypatch.setitem(sys.modules, "rtde_receive", module)
        monkeypatch.setattr(link, "Dashboard", lambda host: self.hosts.append(host) or self.dashboard)
        monkeypatch.setattr(link, "RtdeSockets", lambda: self.sockets)
        monkeypatch.setattr(link, "RtdeClient", self.upload)
        monkeypatch.setattr(link, "rest", self.rest)
        monkeypatch.setattr(link, "joint_limits", lambda host: {"joint_limits_rad": f"of {host}"})

    def rest(self, seconds):
        self.clock.rest(seconds)
        passed_s = self.clock.monotonic_s() - BEGIN_S
        self.receive.device_s = 7.0 + self.row_s * math.floor(passed_s / self.row_s + 1e-6)
        if self.clock.monotonic_s() >= self.plays_s:
            self.receive.runtime = PLAYING
        self.each()

    def connect(self, *stream):
        if self.error is not None:
            raise self.error
        self.streams.append(stream)
        return self.receive

    def upload(self, settings, dashboard, clock, latest, receiving):
        assert (latest().fault, latest().running) == ("the controller's program has stopped", False)
        self.uploads.append((settings, dashboard, clock, receiving))
        self.rest(3.0)
        self.plays_s = self.clock.monotonic_s() + 0.05
        return SimpleNamespace(
            tcp_offset=TCP, leave=self.leave, connected=lambda: self.controls, mount=self.mount
        )

    def mount(self, tool, found):
        self.mounted.append((tool, found))
        self.receive.payload_kg = tool.payload_kg if self.takes_payload else 1.25

    def leave(self):
        self.left += 1

    def opens(self, again=False):
        return self.link.open(again)

    def refuses(self, again=False):
        with pytest.raises(LinkError) as caught:
            self.link.open(again)
        assert self.uploads == []
        return caught.value.args


@pytest.fixture
def opening(monkeypatch):
    return Opening(monkeypatch)


def test_a_link_that_opens_reports_what_the_arm_is_and_its_program_runs(opening):
    opened = opening.opens()
    at_s = opened.row.arrival_s
    row = ArmRow(at_s, opened.row.device_s, START, REST, FORCE, "", True)
    details = {
        "tcp_offset": TCP,
        "payload_kg": 1.25,
        "payload_cog_m": (0.0, 0.01, 0.06),
        "not_stated_by_the_profile": ("tcp_offset", "payload_kg", "payload_cog_m"),
        "watchdog_hz": 10.0,
        "remote_control": "true",
        "robot_mode": "RUNNING",
        "safety_status": "NORMAL",
        "speed_slider": 0.5,
        "joint_limits_rad": f"of {HOST}",
    }
    assert opened == Opened("UR5", "20195500", "5.9.4", row, details)
    assert at_s == pytest.approx(opening.plays_s, abs=2 * CYCLE_S)
    assert opening.hosts == [HOST]
    assert opening.streams == [(HOST, 500.0, link.VARIABLES)]
    assert opening.uploads == [(SETTINGS, opening.dashboard, opening.clock, opening.sockets)]


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
    assert opening.refuses() == (
        RefusedError,
        f"PolyScope {called} is not supported",
        "it takes 5.6 or a later 5.x",
    )
    assert opening.dashboard.asked == opening.streams == []


def test_a_client_that_does_not_connect_is_a_port_that_does_not_answer(opening):
    opening.error = RuntimeError("Connection refused")
    assert opening.refuses() == (
        PortError,
        "the client reports: Connection refused",
        "is the controller on, and is the address right?",
    )


@pytest.mark.parametrize("what", ["connected", "device_s"])
def test_a_controller_that_sends_no_data_is_silent(opening, what):
    setattr(opening.receive, what, {"connected": False, "device_s": 0.0}[what])
    assert opening.refuses() == (
        SilentError,
        f"no data come from {HOST}",
        "is the controller up, and RTDE switched on at the pendant?",
    )
    assert opening.clock.monotonic_s() == BEGIN_S


def test_a_controller_that_is_not_in_remote_control_is_refused(opening):
    opening.dashboard.answers["is in remote control"] = "false"
    assert opening.refuses() == (RefusedError, "remote control is off", "switch it on at the pendant")


def test_an_arm_that_may_not_move_is_refused_and_not_released(opening):
    opening.receive.safety = NORMAL | PROTECTIVE
    assert opening.refuses(again=True) == (
        RefusedError,
        "the arm is in a protective stop",
        "look at the arm, and release it at the pendant",
    )
    assert opening.dashboard.asked == ["is in remote control"]


def test_a_program_of_another_host_is_not_stopped_but_refused_after_a_second(opening):
    opening.receive.runtime = PLAYING
    assert opening.refuses() == OTHER
    rows_s = link.ROWS * CYCLE_S
    assert opening.clock.monotonic_s() - BEGIN_S == pytest.approx(1.0 + rows_s, abs=3 * CYCLE_S)
    assert "stop" not in opening.dashboard.asked


def test_a_program_that_ends_within_a_second_does_not_matter(opening):
    opening.receive.runtime = PLAYING

    def ends():
        if BEGIN_S + 0.5 < opening.clock.monotonic_s() < opening.plays_s:
            opening.receive.runtime = STOPPED

    opening.each = ends
    assert isinstance(opening.opens(), Opened)
    assert "stop" not in opening.dashboard.asked


def test_a_controller_of_which_no_row_comes_is_not_said_to_run_another_program(opening):
    opening.row_s = 1e6
    error, message, _ = opening.refuses()
    assert (error, message) == (SilentError, "no row came in 1 s")


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


def test_an_arm_with_another_tool_than_the_profile_states_is_refused_and_its_program_ended(opening):
    opening.link._settings = SETTINGS.model_copy(update={"tcp_offset": TCP, "payload_kg": 0.5})
    with pytest.raises(LinkError) as caught:
        opening.link.open(False)
    refused = caught.value
    assert (refused.kind, refused.reason) == (RefusedError, "its payload_kg is 1.25, the profile's 0.5")
    assert "pendant" in refused.advice
    assert opening.left == 1


def test_an_arm_of_another_model_than_the_profile_states_is_refused_before_its_program_starts(opening):
    opening.link._settings = SETTINGS.model_copy(update={"model": "UR10"})
    with refused(LinkError, "it is a UR5", "UR10", "correct port or model"):
        opening.link.open(False)
    assert opening.left == 0
    opening.link._settings = SETTINGS.model_copy(update={"model": "UR5"})
    assert opening.opens().model == "UR5"


FOUND = Tool(TCP, 1.25, (0.0, 0.01, 0.06))


@pytest.mark.parametrize(
    ("payload_kg", "mounted"), [(0.5, [(FOUND._replace(payload_kg=0.5), FOUND)]), (1.25, [])]
)
def test_an_arm_is_given_the_profile_s_tool_where_the_profile_says_so(opening, payload_kg, mounted):
    opening.link._settings = SETTINGS.model_copy(update={"payload_kg": payload_kg, "tool": "set"})
    details = opening.opens().details
    assert opening.mounted == mounted
    assert details["payload_kg"] == payload_kg
    assert details.get("tool_found") == (FOUND._asdict() if mounted else None)


def test_an_arm_that_does_not_take_the_tool_is_refused(opening):
    opening.takes_payload = False
    opening.link._settings = SETTINGS.model_copy(update={"payload_kg": 0.5, "tool": "set"})
    with refused(LinkError, "payload_kg is 1.25", "0.5", "pendant"):
        opening.link.open(False)
    assert opening.left == 1


def test_rows_that_a_busy_machine_misses_at_first_are_no_other_rate(opening):
    opening.row_s = 2 * CYCLE_S

    def seen_all():
        if opening.clock.monotonic_s() > BEGIN_S + 0.5:
            opening.row_s = CYCLE_S

    opening.each = seen_all
    assert isinstance(opening.opens(), Opened)


@pytest.mark.parametrize(("asked_hz", "row_s"), [(500.0, 0.008), (125.0, 0.002)])
def test_rows_at_another_rate_than_the_profile_states_are_refused_with_theirs(opening, asked_hz, row_s):
    opening.link._settings = SETTINGS.model_copy(update={"rate_hz": asked_hz})
    opening.row_s = row_s
    kind, reason, advice = opening.refuses()
    assert (kind, advice) == (RefusedError, f"set rate_hz = {1.0 / row_s:g}")
    assert f"not {asked_hz:g}" in reason


def test_each_new_row_is_read_once_whole_and_with_the_time_of_its_arrival(opening):
    first = opening.opens().row
    assert opening.link.read() is None, "it has come already"
    opening.receive.device_s, opening.receive.torn = 20.0, True
    assert opening.link.read() is None, "the next row came while this one was read"
    opening.receive.torn = False
    opening.clock.rest(0.001)
    arrival_s = opening.clock.monotonic_s()
    row = opening.link.read()
    assert row == first._replace(arrival_s=arrival_s, device_s=opening.receive.device_s)


@pytest.mark.parametrize(
    ("safety", "runtime", "fault", "running"),
    [
        (NORMAL, PLAYING, "", True),
        (NORMAL, STOPPED, "the controller's program has stopped", False),
        (NORMAL | PROTECTIVE, PLAYING, "the arm is in a protective stop", True),
        (NORMAL | PROTECTIVE | 1 << 7, STOPPED, "the emergency stop is pressed", False),
    ],
)
def test_a_row_says_why_the_arm_will_not_move(opening, safety, runtime, fault, running):
    opening.opens()
    opening.receive.safety, opening.receive.runtime, opening.receive.device_s = safety, runtime, 20.0
    row = opening.link.read()
    assert (row.fault, row.running) == (fault, running)


@pytest.mark.parametrize(
    ("what", "reason"),
    [
        ("stands", "the receive link is gone"),
        ("receive", "the receive link is gone"),
        ("controls", "the control link is gone"),
    ],
)
def test_a_link_that_is_gone_is_found_so(opening, what, reason):
    opening.opens()
    opening.link.check()
    if what == "receive":
        opening.receive.connected = False
    else:
        setattr(opening, what, False)
    with pytest.raises(LinkError) as caught:
        opening.link.check()
    assert caught.value.args == (SilentError, reason, "is the cable in, and the controller up?")
