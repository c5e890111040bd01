"""A board that prints lines, over a pty: real pyserial, and the finger's trial on it alone."""

import csv
from pathlib import Path

import pytest

from tests.program import Verb

PROFILE = Path("tests/data/serial_lines.toml")


def test_the_finger_is_touched_with_one_such_board_alone(verb: Verb, tmp_path: Path) -> None:
    sets = [
        "devices.stage.port=emulated",
        "devices.uno.port=emulated",
        "behavior.settle_s=1.0",
        "detectors.contact.baseline_s=2.0",
        "trials.repeats=1",
        'trials.list=[{ location = "f", speed_m_s = 0.0045 }]',
        # the machine may be busy: what is read late here is no sensor's silence
        "limits.stale_s=5.0",
        "devices.uno.silence_timeout_s=5.0",
    ]
    options = [part for each in sets for part in ("--set", each)]
    assert verb("run", PROFILE, *options, "--out", tmp_path)[0] == 0
    (run,) = tmp_path.iterdir()
    (row,) = csv.DictReader((run / "trials.csv").read_text().splitlines())
    assert row["outcome"] == "contact"
    assert 0.0 < float(row["delay_s"]) < 0.1
    assert float(row["baseline_hz"]) == pytest.approx(28.0, abs=0.5)
    page = (run / "report.html").read_text()
    assert "uno.force" in page
