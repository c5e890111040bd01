"""How-to pages are done as they say."""

import ast
import json
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

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
    assert "contact: 3" in run
    events = [json.loads(line)["event"] for line in replayed.splitlines()]
    assert events[:2] == ["BaselineReady", "Contact"]


def test_a_device_is_added_as_the_page_says(follow, tmp_path):
    checked, run, wired, wired_run = follow("add_a_device.md")
    assert 'driver = "my_lab.device:ForceSensor"' in checked
    assert "devices.scale: keeps the contract" in checked
    assert "contact: 3" in run
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
    assert "contact: 6" in run
    (folder,) = tmp_path.glob("runs/*")
    header, *rows = (folder / "trials.csv").read_text().splitlines()
    assert header == "trial,outcome,speed_m_s,force_mean_n,force_peak_n"
    assert all(float(row.split(",")[-1]) > 0.1 for row in rows)
    page = (folder / "report.html").read_text(encoding="utf-8")
    assert "force" in page


PAGE = (Path(__file__).parents[2] / "docs/how-to/run_campaigns.md").read_text("utf-8")
LATER = 'touchbench() { printf "%s\\n" "$*" >> asked; }\n'
"""Bash keeps what it was to run: starting Python for each takes seconds."""

CAMPAIGN = """
extends = "mock/transient"
[behavior]
settle_s = 2.0
[detectors.contact]
threshold_sigma = 8.0
[trials]
repeats = 1
list = [{ location = "f" }]
[trials.grid]
speed_m_s = [0.003, 0.006, 0.009]
"""


@pytest.fixture
def carried_out(verb, tmp_path, monkeypatch):
    """Has bash run a text in an empty folder, and the program what bash would have had it run."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_campaign.toml").write_text(CAMPAIGN)

    def carried_out(text, **variables):
        (tmp_path / "asked").write_text("")
        subprocess.run(["bash", "-ec", LATER + text], env=variables, check=True)
        for line in (tmp_path / "asked").read_text().splitlines():
            code, _, err = verb(*shlex.split(line))
            assert not code, err

    return carried_out


def block(language):
    (text,) = re.findall(rf"```{language}\n(.*?)```", PAGE, re.DOTALL)
    assert len(text.splitlines()) <= 10
    return text


def joined(tmp_path, carried_out):
    """The rows that the shards came to, and those of one run."""
    carried_out("touchbench run my_campaign.toml --no-report --out whole")
    return [next((tmp_path / name).glob("*/trials.csv")).read_bytes() for name in ("runs", "whole")]


def test_the_array_of_slurm_comes_to_the_rows_of_one_run(carried_out, tmp_path):
    script = block("bash")
    ((first, last),) = re.findall(r"--array=(\d+)-(\d+)", script)
    for number in range(int(first), int(last) + 1):
        carried_out(script, SLURM_ARRAY_TASK_ID=str(number))
    (merge,) = re.findall(r"^    (touchbench merge .*)$", PAGE, re.MULTILINE)
    carried_out(merge)
    found, whole = joined(tmp_path, carried_out)
    assert found == whole
    assert list((tmp_path / "runs").glob("*/report.html"))


def test_the_rules_of_snakemake_come_to_the_rows_of_one_run(carried_out, tmp_path):
    text = block("snakemake")
    (count,) = map(int, re.findall(r"^N = (\d+)", text))
    whole, shard = (ast.literal_eval(line) for line in re.findall(r'shell: (".*")', text))
    for number in range(1, count + 1):
        carried_out(shard.format(wildcards=SimpleNamespace(i=number), N=count))
    carried_out(whole)
    found, expected = joined(tmp_path, carried_out)
    assert found == expected


def test_the_commands_of_dask_are_those_that_it_knows(verb, local_cluster, tmp_path, monkeypatch):
    from distributed.cli import dask_scheduler, dask_worker

    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_campaign.toml").write_text(CAMPAIGN)
    for name, module in (("scheduler", dask_scheduler), ("worker", dask_worker)):
        (asked,) = re.findall(rf"^    dask {name}(.*)&$", PAGE, re.MULTILINE)
        module.main.make_context(name, shlex.split(asked))
    (run,) = re.findall(r"^    touchbench (run .*--scheduler) \S+$", PAGE, re.MULTILINE)
    code, out, err = verb(*shlex.split(run), local_cluster.scheduler_address, "--no-report")
    assert code == 0, (out, err)


def test_an_arm_and_a_six_axis_sensor_are_a_bench_by_the_page(verb, tmp_path):
    page = (PAGES.parent / "tutorial" / "first_run.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n# my_bench/arm_and_ft.toml\n(.*?)```", page, re.DOTALL)
    assert len(text.splitlines()) <= 40
    own = tmp_path / "own.toml"
    own.write_text(text, encoding="utf-8")
    code, _, err = verb("check", own)
    assert code == 0, f"nothing is left to give: {err}"
    mock = re.sub(r'port = "[\d.]+"', 'port = "mock"', text.replace("hardware/", "mock/"))
    own.write_text(mock, encoding="utf-8")
    slowly = ("--set", "loop.rate_hz=50.0")
    code, out, err = verb("certify", own, "--out", tmp_path, *slowly)
    assert (code, "26 of 26 limits acted" in out) == (0, True), err
    code, out, err = verb("run", own, "--out", tmp_path)
    assert code == 0, err
    assert list(tmp_path.glob("*/report.html"))
    (rows,) = tmp_path.glob("*/trials.csv")
    assert rows.read_text().splitlines()[1].startswith("1,contact,0.001,")


def test_an_arm_touches_first_as_the_page_says(verb, tmp_path):
    page = (PAGES / "first_day_slip.md").read_text(encoding="utf-8")
    (text,) = re.findall(r"```toml\n# my_touch.toml\n(.*?)```", page, re.DOTALL)
    (tmp_path / "my_touch.toml").write_text(text.replace('"console"', '"mock"'), encoding="utf-8")
    (tmp_path / "my_bench.toml").write_text('extends = "mock/bench_slip"\n', encoding="utf-8")
    profile = ("my_touch.toml", "--out", tmp_path)
    code, _, err = verb("run", tmp_path / profile[0], *profile[1:], "--no-report")
    assert code == 0, err
    (trials,) = tmp_path.glob("*/trials.csv")
    rows = trials.read_text().splitlines()
    heading = rows[0].split(",")
    for row in rows[1:]:
        touch = dict(zip(heading, row.split(","), strict=True))
        assert touch["outcome"] == "contact"
        assert 1.0 < float(touch["force_peak_n"]) < 5.0, "a tip of steel on a table"
        assert 0.003 < float(touch["position_m"]) < 0.0035, "the table is at 3 mm"


@pytest.mark.parametrize("bench", ["resonance", "slip", "sonic"])
def test_on_a_first_day_thresholds_are_set_before_limits_are_driven_past(bench):
    """A profile with a threshold that is not set is refused by `certify`."""
    page = (PAGES / f"first_day_{bench}.md").read_text(encoding="utf-8")
    assert page.index("`run.py stop") < page.index("`run.py quiet") < page.index("`run.py certify")
