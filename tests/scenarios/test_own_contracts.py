"""`run.py check` tries the promises of a user's own device, signal and detector: a line for each that is broken."""

import re
import shutil
from pathlib import Path
from typing import Any

import pytest

from tests.refusals import check_refusal
from tests.scenarios.test_own_kinds import DETECTOR, SIGNAL

PROFILE = """
extends = "mock/transient"

[devices.scale]
driver = "my_lab.flawed:Flawed"
port = "mock"

[detectors.contact]
kind = "my_lab.edge:Edge"
input = "scale.force"
threshold_n = 2.0

[trials]
list = [ { location = "f", speed_m_s = 0.003 } ]
"""

FLAWED = """
from dataclasses import replace

import numpy as np

from touchbench import Failed, Listen, Lost
from my_lab.device import MockForceSensor
from my_lab.driver import ForceSensor, ForceSensorSettings

FlawedSettings = ForceSensorSettings


class Flawed(ForceSensor):
    pass


class MockFlawed(MockForceSensor):
    def _blocks_as(self, **changes):
        return [replace(block, **changes) for block in super().read()]

FLAW
"""


@pytest.fixture
def checked(verb: Any, tmp_path: Path) -> Any:
    """Checks a profile whose device has a flaw, or whose detector has; gives code, output and errors."""

    def check(flaw: str = "", *changed: str) -> tuple[int, str, str]:
        shutil.copytree("tests/data/force_sensor", tmp_path / "my_lab")
        (tmp_path / "my_lab" / "flawed.py").write_text(FLAWED.replace("FLAW", flaw))
        detector = DETECTOR.replace(*changed) if changed else DETECTOR
        assert changed == () or detector != DETECTOR
        (tmp_path / "my_lab" / "edge.py").write_text(detector)
        (tmp_path / "scale.toml").write_text(PROFILE)
        found: tuple[int, str, str] = verb("check", tmp_path / "scale.toml")
        return found

    return check


def test_sound_classes_keep_their_promises(checked: Any) -> None:
    code, out, err = checked()
    assert (code, err) == (0, "")
    assert re.search(r"^ok +devices\.scale: keeps the contract \(\d+ promises\)$", out, re.MULTILINE)
    assert re.search(r"^ok +detectors\.contact: keeps the contract \(6 promises\)$", out, re.MULTILINE)


@pytest.mark.parametrize(
    ("flaw", "named"),
    [
        (
            "    def open(self):\n        return replace(super().open(), device='weight')",
            ("DeviceInfo", "weight"),
        ),
        (
            "    def open(self):\n"
            "        info = super().open()\n"
            "        return replace(info, streams={k: replace(s, unit='') for k, s in info.streams.items()})",
            ("stream scale.force", "a unit"),
        ),
        (
            "    def restart(self):\n"
            "        super().restart()\n"
            "        self.apply(Listen(self.name, frozenset({'scale.force'})))",
            ("nobody listens", "Listen"),
        ),
        ("    def _valid(self, command):\n        return command", ("no_such_stream", "CommandError")),
        (
            "    def read(self):\n        return self._blocks_as(scale=1.0)",
            ("scale.force", "scale", "StreamInfo"),
        ),
        (
            "    def read(self):\n        return self._blocks_as(values=np.zeros((1, 2)))",
            ("scale.force", "shape (1, 2)", "(n, 1)"),
        ),
        (
            "    def read(self):\n        return self._blocks_as(values=np.full((1, 1), np.nan))",
            ("scale.force", "not finite"),
        ),
        ("    def read(self):\n        return self._blocks_as(seq=3)", ("scale.force", "number 3", "within")),
        (
            "    def read(self):\n        super().read()\n        return []",
            ("scale.force", "no sample in 0.5 s"),
        ),
        ("    def read(self):\n        return 1 / 0", ("ZeroDivisionError", "flawed.py, line")),
        ("    def poll(self):\n        super().poll()", ("poll() returns None", "not a list")),
        (
            "    def poll(self):\n        return [Lost(0.0, self.name, 'scale.force', 3)]",
            ("loses samples", "3 of scale.force"),
        ),
        (
            "    def poll(self):\n        return [Failed(0.0, self.name, 'it is hot')]",
            ("fails: it is hot",),
        ),
        (
            "    def _identity(self, arrived):\n"
            "        found = super()._identity(arrived)\n"
            "        half = found and replace(found.stream, rate_hz=found.stream.rate_hz / 2)\n"
            "        return found and found._replace(stream=half)",
            ("scale.force", "samples in 0.5 s", "rate_hz"),
        ),
    ],
    ids=lambda given: given[-1] if isinstance(given, tuple) else "",
)
def test_a_promise_that_a_device_breaks_is_one_line(checked: Any, flaw: str, named: tuple[str, ...]) -> None:
    code, _, err = checked(flaw)
    assert code == 2
    lines = [line for line in err.splitlines() if "devices.scale: " in line]
    assert lines, err
    check_refusal(lines[0], "devices.scale", *named)


def test_a_promise_that_a_detector_breaks_is_one_line(checked: Any) -> None:
    """Each of them: tests/contracts/test_detectors.py."""
    code, _, err = checked("", "        events = []\n", "        events, self._contact = [], False\n")
    assert code == 2
    (line, *_) = [line for line in err.splitlines() if "detectors.contact: " in line]
    check_refusal(line, "detectors.contact", "blocks of any size", "blocks of 1")


def test_a_detector_that_finds_nothing_in_what_is_shown_is_not_called_broken(checked: Any) -> None:
    code, out, err = checked("", "not math.isfinite(force_n)", "True")
    assert (code, err) == (0, "")
    assert "detectors.contact: not tried: it finds nothing in" in out
    assert "check_contract" in out


def test_a_stream_that_nothing_sends_is_named(checked: Any) -> None:
    code, _, err = checked("", "    threshold_n", '    other: StreamName = "scale.torque"\n    threshold_n')
    assert code == 2
    check_refusal(err, "scale.torque", "did you mean scale.force?")


@pytest.mark.parametrize(
    ("right", "wrong", "named"),
    [
        ("", "", ()),
        ("2.0 * block", "block.t0_s + block", ("blocks of 7", "other values")),
        ("        self.count = 0", "        pass\n    count = 0", ("after a reset", "numbers")),
        (
            "block.t0_s, values, times_s=block.times",
            "block.t0_s + 9.0, values, times_s=block.times + 9.0",
            ("later than its inputs",),
        ),
        ('f"signals.{name}"', "name", ("signals.double", "give it")),
        ("2.0 * block.physical", "np.nan_to_num(block.physical)", ("all nan",)),
        ("values = 2.0", "values = 1 / 0", ("ZeroDivisionError", "double.py, line")),
    ],
)
def test_what_a_signal_of_ones_own_breaks_is_one_line(
    verb: Any, tmp_path: Path, right: str, wrong: str, named: tuple[str, ...]
) -> None:
    (tmp_path / "double.py").write_text(SIGNAL.replace(right, wrong))
    (tmp_path / "own.toml").write_text(
        'extends = "mock/transient"\n[signals.double]\nkind = "double:Double"\n'
    )
    code, out, err = verb("check", tmp_path / "own.toml")
    if not named:
        assert (code, err) == (0, "")
        assert re.search(r"^ok +signals\.double: keeps the contract \(7 promises\)$", out, re.MULTILINE)
        return
    assert code == 2
    lines = [line for line in err.splitlines() if "signals.double: " in line]
    assert lines, err
    check_refusal(lines[0], "signals.double", *named)
