"""The client of a UR, its limits and its tool."""

import socket
import struct
import sys
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import pytest

from drivers.arm.link import ArmRow, LinkError
from drivers.core.clock import VirtualClock
from drivers.ur_arm.client import RtdeClient, RtdeSockets
from drivers.ur_arm.limits import joint_limits, limits_in
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import NO_TOOL, Tool, disagreement, stated
from simulator.devices.ur_controller.controller import UrController, UrControllerSettings
from simulator.devices.ur_controller.primary import PrimarySession, greeting

SETTINGS = UrArmSettings(host="127.0.0.1", start_pose=(0.3, 0.0, 0.3, 0.0, 3.14, 0.0))


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Callable[..., RtdeClient]:
    """A client of a control interface; `asked` notes the questions at the dashboard."""

    def make(
        control: object, clock: VirtualClock | None = None, asked: list[str] | None = None
    ) -> RtdeClient:
        notes = [] if asked is None else asked
        module = SimpleNamespace(RTDEControlInterface=lambda host: control)
        monkeypatch.setitem(sys.modules, "rtde_control", module)
        dashboard = SimpleNamespace(ask=lambda question: notes.append(question) or "true")
        row = ArmRow(0.0, 0.0, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6)
        return RtdeClient(SETTINGS, dashboard, clock or VirtualClock(), lambda: row, RtdeSockets())

    return make


class NotedClock(VirtualClock):
    """Bench time that notes its holds and releases."""

    def __init__(self, done: list[str]) -> None:
        super().__init__()
        self._done = done

    def hold(self, t_s: float, patience_s: float = 1.0) -> None:
        self._done.append("hold")

    def leave(self) -> None:
        self._done.append("leave")


def test_bench_time_waits_for_the_process_before_the_watchdog_counts(made: Callable[..., RtdeClient]) -> None:
    """A machine that holds the process up before its first cycle would have the watchdog end the program."""
    done: list[str] = []

    def called(name: str) -> object:
        return lambda *_: (done.append(name), True)[1]

    names = ("setWatchdog", "isConnected", "kickWatchdog", "reuploadScript")
    control = SimpleNamespace(**{name: called(name) for name in names}, getTCPOffset=lambda: [0.1] * 6)
    client = made(control, NotedClock(done))
    assert done == ["hold", "setWatchdog"]
    assert client.tcp_offset == (0.1,) * 6
    done.clear()
    assert client.recover() == ""
    assert done[-2:] == ["hold", "setWatchdog"]
    assert "leave" in done


def test_a_script_whose_watchdog_is_not_taken_does_not_run_on(made: Callable[..., RtdeClient]) -> None:
    """Left running, it would be another program to the next opening."""
    control = MagicMock(getTCPOffset=lambda: [0.1] * 6)
    control.setWatchdog.return_value = False
    asked: list[str] = []
    with pytest.raises(LinkError, match="takes no watchdog"):
        made(control, asked=asked)
    assert asked[-1] == "stop", "the controller ends it; the script itself does not answer"


def test_a_tool_that_was_set_is_set_again_after_a_recovery_and_taken_back_at_the_end(
    made: Callable[..., RtdeClient],
) -> None:
    sent: list[object] = []
    control = MagicMock(isConnected=lambda: True, getTCPOffset=lambda: [0.1] * 6)
    control.setTcp, control.setPayload = sent.append, lambda kg, cog: sent.append((kg, cog))
    client = made(control)
    own, tool = Tool((0.2,) * 6, 1.0, (0.0,) * 3), Tool((0.3,) * 6, 2.0, (0.0,) * 3)
    client.leave()
    assert sent == [], "nothing was set"
    client.mount(tool, own)
    assert client.recover() == ""
    client.leave()
    given = [[list(each.tcp_offset), (each.payload_kg, [0.0, 0.0, 0.0])] for each in (tool, tool, own)]
    assert sent == [line for each in given for line in each]


def test_a_connection_that_was_made_again_is_another_link_however_quickly(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        where = server.getsockname()
        monkeypatch.setattr("drivers.ur_arm.client.RTDE_PORT", where[1])
        with socket.create_connection(where) as receiving:
            first = RtdeSockets()
            controlling = socket.create_connection(where)
            second = RtdeSockets(first)
            assert first.stands() and second.stands()
            number = controlling.fileno()
            controlling.close()
            assert not second.stands()
            with socket.create_connection(where) as again:
                assert again.fileno() == number, "the number is the same"
                assert first.stands() and not second.stands()
            receiving.close()
            assert not first.stands()


DEGREES_180 = bytes.fromhex("400921fb54442d18")
MINUS_360, PLUS_360 = bytes.fromhex("c01921fb54442d18"), bytes.fromhex("401921fb54442d18")
FORTY = bytes.fromhex("4044000000000000")

CONFIGURATION = (
    bytes.fromhex("000001bd 06") + (MINUS_360 + PLUS_360) * 6 + (DEGREES_180 + FORTY) * 6 + bytes(248)
)
"""445 bytes: limits, speeds and accelerations; usual speeds, dimensions and types, which are not read."""

KINEMATICS = bytes.fromhex("00000007 05 0102")
STATE = bytes.fromhex("000001c9 10") + KINEMATICS + CONFIGURATION
MESSAGE = bytes.fromhex("00000008 14 ffffff")


def test_limits_are_found_behind_messages_and_other_parts() -> None:
    found = limits_in(MESSAGE + STATE)
    assert found is not None
    assert found["joint_limits_rad"] == [pytest.approx([-6.283185307, 6.283185307])] * 6
    assert found["joint_speed_limits_rad_s"] == pytest.approx([3.141592654] * 6)


@pytest.mark.parametrize("data", [b"", MESSAGE, STATE[:-1], bytes(5), STATE[:4] + b"\x14" + STATE[5:]])
def test_what_has_no_whole_configuration_has_no_limits(data: bytes) -> None:
    assert limits_in(data) is None


def test_a_controller_without_that_port_is_recorded_as_such() -> None:
    assert "30001" in str(joint_limits("127.0.0.254")["joint_limits_rad"])


def test_the_emulated_controller_sends_its_version_and_ten_states_a_second() -> None:
    controller = UrController(UrControllerSettings.model_validate({}))
    size, kind, _, _, message, length = struct.unpack_from(">IBQbbB", first := greeting(controller))
    assert (size, kind, message) == (len(first), 20, 3)
    assert struct.unpack_from(">BBi", first, 16 + length) == (5, 11, 1)
    session = PrimarySession(controller)
    states = [state for state in (session.step() for _ in range(500)) if state]
    assert len(states) == 10
    places, at = {}, 5
    while at < len(states[0]):
        size, kind = struct.unpack_from(">IB", states[0], at)
        places[kind], at = (at + 5, size), at + size
    # sizes of version 5 (client interface manual)
    assert {kind: size for kind, (_, size) in places.items()} == {0: 47, 1: 251, 4: 101, 6: 445}
    assert struct.unpack_from(">7?B", states[0], places[0][0] + 8) == (*[True] * 3, *[False] * 4, 7)
    joints = [struct.unpack_from(">d", states[0], places[1][0] + 41 * joint)[0] for joint in range(6)]
    assert joints == pytest.approx(list(controller.settings.joints_rad))
    assert struct.unpack_from(">6d", states[0], places[4][0]) == pytest.approx(controller.arm.pose)
    assert limits_in(states[0]) is not None


FOUND = Tool((0.0, 0.0, 0.12, 0.0, 0.0, 3.1414), 1.25, (0.0, 0.01, 0.06))


def settings(**tool: Any) -> UrArmSettings:
    return UrArmSettings(host="arm", start_pose=(0.4, 0.0, 0.2, 0.0, 3.14, 0.0), **tool)


@pytest.mark.parametrize(
    "tool",
    [
        {},
        FOUND._asdict(),
        {"tcp_offset": (0.00005, 0.0, 0.12, 0.0, 0.0, 3.1414)},
        {"tcp_offset": (0.0, 0.0, 0.12, 0.0, 0.0, -3.1414)},  # half a turn either way, but for 0.4 mrad
        {"payload_kg": 1.255},
        {"payload_cog_m": (0.0005, 0.01, 0.06)},
    ],
    ids=["nothing stated", "equal", "rounded", "turned the other way", "10 g", "0.5 mm"],
)
def test_what_is_not_stated_or_differs_by_a_rounding_agrees(tool: dict[str, Any]) -> None:
    assert disagreement(settings(**tool), FOUND) == ""


@pytest.mark.parametrize(
    ("tool", "words"),
    [
        ({"tcp_offset": (0.0, 0.0, 0.1202, 0.0, 0.0, 3.1414)}, "tcp_offset is [0, 0, 0.12, 0, 0, 3.1414]"),
        ({"tcp_offset": (0.0, 0.0, 0.12, 0.0, 0.0, 3.1394)}, "the profile's [0, 0, 0.12, 0, 0, 3.1394]"),
        ({"payload_kg": 0.0}, "payload_kg is 1.25, the profile's 0"),
        (
            {"payload_cog_m": (0.0, 0.01, 0.062)},
            "payload_cog_m is [0, 0.01, 0.06], the profile's [0, 0.01, 0.062]",
        ),
        (NO_TOOL._asdict(), "payload_kg is 1.25"),
    ],
    ids=["0.2 mm", "2 mrad", "payload", "centre of gravity", "all of it"],
)
def test_another_tool_is_shown_beside_the_profile_s(tool: dict[str, Any], words: str) -> None:
    assert words in disagreement(settings(**tool), FOUND)


def test_the_manifest_has_the_tool_and_what_the_profile_does_not_state_of_it() -> None:
    given = settings(payload_kg=1.25)
    assert FOUND.details(given) == {
        **FOUND._asdict(),
        "not_stated_by_the_profile": ("tcp_offset", "payload_cog_m"),
    }
    assert stated(given) == NO_TOOL._replace(payload_kg=1.25)
