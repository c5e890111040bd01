"""A stage and an arm led by keys on a terminal: real drivers, emulated devices."""

import json
import re
from contextlib import closing
from typing import Any

import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from config.verbs.by_hand import session_on
from tests.program import Terminal
from tests.scenarios.test_by_hand import Hand

READY = "q ends"


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Devices that outlive the program which moves them: the file with their addresses."""
    with closing(start_emulator(load_profile("emulated/transient"))) as emulator:
        path = tmp_path_factory.mktemp("bench") / "bench.json"
        path.write_text(json.dumps(emulator.endpoints))
        yield path


def stage_now(bench):
    """Two positions of the stage, half a second apart."""
    endpoints = json.loads(bench.read_text())
    with session_on(load_profile("emulated/transient"), ["stage"], Hand(), endpoints) as session:
        found = []
        for t_s, _ in session.listen(["stage.position"]):
            values = session.latest.values("stage.position")
            if t_s > 0.5 * (len(found) + 1) and len(values):
                found.append(values[-1, 0])
            if len(found) == 2:
                return found
    raise AssertionError("it ended")


def test_a_stage_goes_home_and_forward_by_keys_and_tells_where_it_stands(bench):
    terminal = Terminal(["jog", "emulated/transient", "stage", "--endpoints", str(bench)])
    terminal.until(READY)
    terminal.hold(b"h", "by hand: stands still", 1.0)
    terminal.hold(b"\x1b[C", "by hand: forward", 0.5)
    terminal.until("by hand: stands still")
    terminal.press(b"q")
    ended = terminal.until("for example in [behavior]")
    assert terminal.close() == 0
    (shown,) = re.findall(r"start_m = (\S+)", ended)
    place_m = float(shown)
    # keys for a second or so at 2 mm/s, as long as the screen takes to show it
    assert 0.0003 < place_m < 0.01
    assert stage_now(bench) == pytest.approx([place_m, place_m], abs=1e-6)


def test_a_terminal_that_goes_away_leaves_a_stage_that_stands(bench):
    terminal = Terminal(["jog", "emulated/transient", "stage", "--endpoints", str(bench)])
    terminal.until(READY)
    terminal.hold(b"h", "by hand: stands still", 1.0)
    terminal.hold(b"f", "by hand: forward", 0.3)
    assert terminal.hang_up() in (130, 1)
    first_m, second_m = stage_now(bench)
    assert first_m == pytest.approx(second_m, abs=1e-6)
    assert 0.0 < first_m < 0.01


def test_an_arm_is_led_along_its_axis_and_aside_and_its_pose_can_be_pasted():
    terminal = Terminal(["jog", "emulated/slip", "arm"])
    terminal.until(READY)
    terminal.hold(b"h", "by hand: home")
    terminal.hold(b"h", "by hand: stands still")
    terminal.press(b"g")
    terminal.until("by hand: led by hand")
    terminal.press(b" ")
    terminal.until("by hand: stands still")
    terminal.hold(b"d", "by hand: tool +x", 0.5)
    terminal.until("by hand: stands still")
    terminal.press(b"\x03")
    ended = terminal.until("# in [devices.arm]")
    assert terminal.close() == 130
    (shown,) = re.findall(r"start_pose = (\[.*\])", ended)
    pose = json.loads(shown)
    start: Any = load_profile("emulated/slip").resolved["devices"]["arm"]["start_pose"]
    assert abs(pose[0] - start[0]) > 0.0003
    assert pose[1:3] == pytest.approx(start[1:3], abs=2e-4)
