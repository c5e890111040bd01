"""The how-to pages, followed as they are printed: their files are written, their commands are run."""

import json
import re
import shlex
from pathlib import Path

import pytest

PAGES = Path(__file__).parents[2] / "docs" / "how-to"
PROGRAM = [".venv/bin/python", "run.py"]


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
        for command in re.findall(r"^    (\S+python run\.py .*)$", page, re.MULTILINE):
            *program, asked, profile = shlex.split(command)[:4]
            code, out, err = verb(asked, profile, *shlex.split(command)[4:])
            assert (program, code) == (PROGRAM, 0), f"{command}: {err}"
            outputs.append(out)
        return outputs

    return run


def test_a_detector_is_added_as_the_page_says(follow):
    checked, run, replayed = follow("add_a_detector.md")
    assert 'kind = "my_lab.edge:Edge"' in checked
    assert "3 contact" in run
    events = [json.loads(line)["event"] for line in replayed.splitlines()]
    assert events[:2] == ["BaselineReady", "Contact"]


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
