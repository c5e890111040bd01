"""What the arm's process does around the calls of ur_rtde, which stands in here as a list of what was called."""

import socket
import sys
from types import SimpleNamespace
from unittest.mock import MagicMock

import pytest

from drivers.arm.link import ArmRow, LinkError
from drivers.core.clock import VirtualClock
from drivers.ur_arm.client import RtdeClient, RtdeSockets
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import Tool

SETTINGS = UrArmSettings(host="127.0.0.1", start_pose=(0.3, 0.0, 0.3, 0.0, 3.14, 0.0))


class NotedClock(VirtualClock):
    """Bench time that notes its holds and releases."""

    def __init__(self, done: list[str]) -> None:
        super().__init__()
        self._done = done

    def hold(self, t_s: float, patience_s: float = 1.0) -> None:
        self._done.append("hold")

    def leave(self) -> None:
        self._done.append("leave")


def test_bench_time_waits_for_the_process_before_the_watchdog_counts(monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine that holds the process up before its first cycle would have the watchdog end the program."""
    done: list[str] = []

    def called(name: str) -> object:
        return lambda *_: (done.append(name), True)[1]

    names = ("setWatchdog", "isConnected", "kickWatchdog", "reuploadScript")
    control = SimpleNamespace(**{name: called(name) for name in names}, getTCPOffset=lambda: [0.1] * 6)
    module = SimpleNamespace(RTDEControlInterface=lambda host: control)
    monkeypatch.setitem(sys.modules, "rtde_control", module)
    dashboard = SimpleNamespace(ask=lambda question: "true")
    row = ArmRow(0.0, 0.0, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6)

    client = RtdeClient(SETTINGS, dashboard, NotedClock(done), lambda: row, RtdeSockets())
    assert done == ["hold", "setWatchdog"]
    assert client.tcp_offset == (0.1,) * 6
    done.clear()
    assert client.recover() == ""
    assert done[-2:] == ["hold", "setWatchdog"]
    assert "leave" in done


def test_a_script_whose_watchdog_is_not_taken_does_not_run_on(monkeypatch: pytest.MonkeyPatch) -> None:
    """Left running, it would be another program to the next opening."""
    control = MagicMock(getTCPOffset=lambda: [0.1] * 6)
    control.setWatchdog.return_value = False
    monkeypatch.setitem(
        sys.modules, "rtde_control", SimpleNamespace(RTDEControlInterface=lambda host: control)
    )
    row = ArmRow(0.0, 0.0, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6)
    asked: list[str] = []
    dashboard = SimpleNamespace(ask=lambda question: asked.append(question) or "true")
    with pytest.raises(LinkError, match="takes no watchdog"):
        RtdeClient(SETTINGS, dashboard, VirtualClock(), lambda: row, RtdeSockets())
    assert asked[-1] == "stop", "the controller ends it; the script itself does not answer"


def test_a_tool_that_was_set_is_set_again_after_a_recovery_and_taken_back_at_the_end(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    sent: list[object] = []
    control = MagicMock(isConnected=lambda: True, getTCPOffset=lambda: [0.1] * 6)
    control.setTcp, control.setPayload = sent.append, lambda kg, cog: sent.append((kg, cog))
    monkeypatch.setitem(
        sys.modules, "rtde_control", SimpleNamespace(RTDEControlInterface=lambda host: control)
    )
    row = ArmRow(0.0, 0.0, (0.0,) * 6, (0.0,) * 6, (0.0,) * 6)
    dashboard = SimpleNamespace(ask=lambda question: "true")
    client = RtdeClient(SETTINGS, dashboard, VirtualClock(), lambda: row, RtdeSockets())
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
