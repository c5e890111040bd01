"""docs/how-to/run_campaigns.md: what it has for batch systems, carried out by the program in this process.

The shell script is run by bash as SLURM would, the rules' commands as Snakemake fills them in: neither is here.
"""

import ast
import re
import shlex
import subprocess
from pathlib import Path
from types import SimpleNamespace

import pytest
from distributed.cli import dask_scheduler, dask_worker

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
    monkeypatch.chdir(tmp_path)
    (tmp_path / "my_campaign.toml").write_text(CAMPAIGN)
    for name, module in (("scheduler", dask_scheduler), ("worker", dask_worker)):
        (asked,) = re.findall(rf"^    dask {name}(.*)&$", PAGE, re.MULTILINE)
        module.main.make_context(name, shlex.split(asked))
    (run,) = re.findall(r"^    touchbench (run .*--scheduler) \S+$", PAGE, re.MULTILINE)
    code, out, err = verb(*shlex.split(run), local_cluster.scheduler_address, "--no-report")
    assert code == 0, (out, err)
