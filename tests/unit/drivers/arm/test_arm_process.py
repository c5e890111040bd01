"""The arm's process takes commands in every cycle, however long the client's calls take: in virtual time."""

import importlib
import os
import sys
import time
from pathlib import Path

import pytest

from drivers.arm.host import ArmHost
from drivers.arm.link import LinkError
from drivers.arm.settings import ArmSettings
from drivers.core.clock import WallClock
from drivers.core.errors import RefusedError
from drivers.core.messages import MoveAt, Stalled, Stop
from tests.unit.drivers.arm.arm_process_bench import REST, SETTINGS, Arm

CALL_S = 0.009
"""Longer than a cycle of commands, which is 8 ms."""

STUCK = 500
"""Calls after which a test gives up."""

MOVE = MoveAt("arm", 0.001, 0.04)


class SlowClient:
    """Every call takes longer than a cycle; the tool obeys at once. After so many calls it does something."""

    def __init__(self, arm, deeds):
        self.arm, self.deeds, self.twists, self.calls, self.turning = arm, deeds, [], 0, True

    def __getattr__(self, name):
        return lambda *details: name not in ("busy", "halt", "leave") and self._called(name, details)

    def _called(self, name, details):
        self.calls += 1
        assert self.calls < STUCK, "it never took a command"
        if name == "speed":
            self.twists.append(details[0])
        self.arm.clock.rest(CALL_S)
        now_s = self.arm.clock.monotonic_s()
        self.arm.sees(arrival_s=now_s, device_s=now_s, twist=self.twists[-1] if self.twists else REST)
        if self.turning:
            os.eventfd_write(self.arm.turns, 1)
        self.deeds.get(self.calls, lambda: None)()
        return True


@pytest.fixture
def arm(monkeypatch):
    made = Arm(monkeypatch)
    yield made
    made.close()


def obeys(arm, deeds, loop_timeout_s=5.0):
    """Carry out what the program sends until it hangs up; the client."""
    arm.process._settings = SETTINGS.model_copy(update={"loop_timeout_s": loop_timeout_s})
    ready = arm.process._pipe.wait
    arm.process._pipe.wait = lambda seconds: arm.clock.rest(seconds) or ready(0.0)
    client = arm.link.client = SlowClient(arm, deeds)
    arm.process._obey()
    return client


def test_a_stop_is_obeyed_in_the_next_cycle_whatever_each_call_takes(arm):
    stop = Stop("arm")
    client = obeys(
        arm, {5: lambda: arm.pipe.send(MOVE), 50: lambda: arm.pipe.send(stop), 90: arm.pipe.hang_up}
    )
    moving = [any(twist) for twist in client.twists]
    moved = moving.index(False)
    assert all(moving[:moved]) and not any(moving[moved:])
    assert 43 <= moved <= 46, "a call for each cycle from the fifth to the fiftieth, and then it brakes"


def test_a_program_whose_loop_hangs_moves_the_arm_no_longer_than_its_loop_timeout(arm):
    deeds = {5: lambda: arm.pipe.send(MOVE), 200: arm.pipe.hang_up}
    deeds[100] = lambda: setattr(arm.link.client, "turning", False)
    client = obeys(arm, deeds, loop_timeout_s=0.45)
    moving = [any(twist) for twist in client.twists]
    (stalled,) = [status for status in arm.messages() if isinstance(status, Stalled)]
    late = "50 calls of 9 ms after the last turn; before it, it goes on"
    assert 145 <= 5 + moving.index(False) <= 156, late
    assert "the program has not looked at it" in stalled.reason


def test_the_program_s_end_is_seen_whatever_each_call_takes(arm):
    client = obeys(arm, {5: lambda: arm.pipe.send(MOVE), 20: arm.pipe.hang_up})
    assert client.calls < 40
    assert not any(client.twists[-1])


def test_a_program_that_does_not_read_blocks_nothing(arm):
    row, sent = arm.process._seen.row, 0
    while not arm.process._outbox:
        arm.process._send(row)
        sent += 1
        assert sent < 100_000
    arm.process._send(row)
    read = len(arm.messages())
    arm.process._send(row)
    assert read + len(arm.messages()) == sent + 2, "what waited follows, in order, and nothing is lost"


OWN = """
from drivers.arm.link import LinkError
from drivers.core.errors import RefusedError

class OwnLink:
    package, extra = "pytest", "own"

    def __init__(self, settings, clock):
        pass

    def open(self, again):
        raise LinkError(RefusedError, "it is my own", "nothing to do")
"""


@pytest.mark.parametrize("place", ["own_arm_lab.py", "own_arm_lab/__init__.py"])
def test_a_link_beside_a_profile_is_found_by_the_arm_s_process(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    file = tmp_path / place
    file.parent.mkdir(exist_ok=True)
    file.write_text(OWN)
    with monkeypatch.context() as found:
        found.syspath_prepend(tmp_path)
        module = importlib.import_module("own_arm_lab")
    monkeypatch.delitem(sys.modules, "own_arm_lab", raising=False)
    monkeypatch.setitem(sys.modules, "own_arm_lab", module)
    settings = ArmSettings(host="-", rate_hz=500.0, start_pose=(0.4, 0.0, 0.2, 0.0, 3.0, 0.0))
    host = ArmHost("arm", settings, module.OwnLink, WallClock(), again=False)
    received: list[object] = []
    deadline_s = time.monotonic() + 100.0  # a busy machine starts Python slowly
    while not received and not host.exit_reason() and time.monotonic() < deadline_s:
        received = host.receive()
        time.sleep(0.01)
    host.kill()
    (error,) = received
    assert isinstance(error, LinkError)
    assert error.args == (RefusedError, "it is my own", "nothing to do")
