"""The how-to pages, followed as they are printed: their files are written, their commands are run."""

import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
PAGES = ROOT / "docs" / "how-to"
PROGRAM = [".venv/bin/python", "run.py"]
SHELL = ("mkdir", "cp")


@pytest.fixture
def follow(verb, tmp_path, monkeypatch):
    """Follows a page in an empty folder; gives each command's output."""
    monkeypatch.chdir(tmp_path)

    def run(name):
        page = (PAGES / name).read_text(encoding="utf-8")
        for path, text in re.findall(r"```\w+\n# (\S+)\n(.*?)```", page, re.DOTALL):
            (tmp_path / path).parent.mkdir(parents=True, exist_ok=True)
            (tmp_path / path).write_text(text, encoding="utf-8")
        outputs = []
        for command in re.findall(r"^    (\S.*)$", page, re.MULTILINE):
            words = shlex.split(command)
            if words[0] in SHELL:
                subprocess.run(
                    [ROOT / word if word.startswith("tests/") else word for word in words], check=True
                )
            elif words[:3] == [PROGRAM[0], "-m", "pytest"]:
                there = {
                    **os.environ,
                    "PYTHONPATH": str(ROOT),
                }  # the page is followed in the project's folder
                tested = subprocess.run(
                    [sys.executable, *words[1:]], env=there, capture_output=True, check=True
                )
                assert b" 1 passed" in tested.stdout
            elif words[:2] == PROGRAM:
                code, out, err = verb(*words[2:])
                assert code == 0, f"{command}: {err}"
                outputs.append(out)
        return outputs

    return run


def test_a_detector_is_added_as_the_page_says(follow):
    checked, run, replayed = follow("add_a_detector.md")
    assert 'kind = "my_lab.edge:Edge"' in checked
    assert "detectors.contact: keeps the contract" in checked
    assert "3 contact" in run
    events = [json.loads(line)["event"] for line in replayed.splitlines()]
    assert events[:2] == ["BaselineReady", "Contact"]


def test_a_device_is_added_as_the_page_says(follow, tmp_path):
    checked, run, wired, wired_run = follow("add_a_device.md")
    assert 'driver = "my_lab.device:ForceSensor"' in checked
    assert "devices.scale: keeps the contract" in checked
    assert "3 contact" in run
    assert "scale: FS1, serial 0042, port /dev/pts/" in wired
    assert "devices.scale: keeps the contract" in wired
    assert "1 stopped at a contact" in wired_run
    first, second = sorted(tmp_path.glob("runs/*"))
    for folder, trials in ((first, 3), (second, 1)):
        rows = (folder / "trials.csv").read_text().splitlines()[1:]
        events = [json.loads(line) for line in (folder / "events.jsonl").read_text().splitlines()]
        contacts = [
            event for event in events if (event["event"], event.get("detector")) == ("Contact", "contact")
        ]
        assert len(contacts) == len(rows) == trials
        assert all(event["value"] > event["threshold"] for event in contacts)


def test_an_experiment_is_added_as_the_page_says(follow, tmp_path):
    checked, run, _ = follow("add_an_experiment.md")
    assert 'experiment = "my_lab.tap:Tap"' in checked
    assert "6 contact" in run
    (folder,) = tmp_path.glob("runs/*")
    header, *rows = (folder / "trials.csv").read_text().splitlines()
    assert header == "trial,outcome,speed_m_s,force_mean_n,force_peak_n"
    assert all(float(row.split(",")[-1]) > 0.1 for row in rows)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "force" in page
