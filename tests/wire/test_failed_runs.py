"""What is shown of a test of this folder that fails: how its runs ended, and what happened in them last."""

import json
import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

CONFTEST = "from tests.wire.conftest import pytest_runtest_makereport, runs"

FAILS = """
from pathlib import Path
from controller.campaign import Campaign, Outcome

Campaign.run = lambda campaign: Outcome(3, Path(__file__).parent, "trial 7: stage stalled")

def test_fails():
    assert Campaign.run(None).exit_code == 0
"""


def test_a_test_that_fails_shows_the_last_line_and_the_last_events_of_its_runs(tmp_path: Path) -> None:
    lost = json.dumps({"event": "Lost"})
    events = [json.dumps({"event": "Saturated", "t_s": k}) for k in range(20)]
    (tmp_path / "events.jsonl").write_text("\n".join([lost, *events, lost]))
    (tmp_path / "conftest.py").write_text(CONFTEST)
    (tmp_path / "test_fails.py").write_text(FAILS)
    (tmp_path / "pytest.ini").write_text("[pytest]")
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", tmp_path],
        env={**os.environ, "PYTHONPATH": str(ROOT)},
        capture_output=True,
        text=True,
        check=False,
    )
    shown = done.stdout.partition("how its run ended")[2].splitlines()
    assert shown[1:14] == ["trial 7: stage stalled", *events[-12:]], done.stdout
