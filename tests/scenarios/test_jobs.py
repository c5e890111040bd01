"""A campaign is the same run folder on one core, on several, on a cluster, in shards, and after a worker died."""

import json
import multiprocessing
import os
import signal
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from pathlib import Path

import pytest
from mcap.reader import make_reader

from config.assemble import Table, plan_campaign
from config.jobs import Crew, cores, in_parts
from config.profile import load_profile
from controller.recording.reader import open_run
from run import cli
from tests.scenarios.conftest import Script

SETS = {"behavior.settle_s": "2.0", "trials.repeats": "1", "detectors.contact.threshold_sigma": "3.0"}
"""Fourteen trials; the loop locks within a second."""

SHORT = (*(part for key, value in SETS.items() for part in ("--set", f"{key}={value}")), "--no-report")


def run_of(out):
    return next(path.parent for path in Path(out).glob("*/manifest.json"))


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """On one core, in this process."""
    out = tmp_path_factory.mktemp("one")
    with pytest.raises(SystemExit) as ended:
        cli.main(["run", "mock/transient", *SHORT, "--jobs", "1", "--out", str(out)])
    assert ended.value.code == 0
    return run_of(out)


def told(folder):
    """All messages of a recording by trial, with their times since the run began: as a reader of MCAP finds them."""
    with (folder / "recording.mcap").open("rb") as file:
        reader = make_reader(file)
        summary = reader.get_summary()
        begin_ns = summary.statistics.message_start_time
        messages = sorted(
            (
                message.log_time - begin_ns,
                channel.topic,
                message.sequence,
                message.publish_time - begin_ns,
                b"" if channel.topic == "/events" else message.data,
            )
            for _, channel, message in reader.iter_messages()
        )
        trials = [
            {key: value for key, value in record.metadata.items() if key != "base_ns"}
            for record in reader.iter_metadata()
        ]
        topics = sorted(channel.topic for channel in summary.channels.values())
    return messages, trials, topics


def assert_same(folder, other):
    """Nobody can tell which of two runs was made in which way."""
    for name in ("trials.csv", "events.jsonl"):
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    for mine, others in zip(told(folder), told(other), strict=True):
        assert mine == others
    mine, others = (json.loads((run / "manifest.json").read_text()) for run in (folder, other))
    seconds, expected = (manifest.pop("plant").pop("seconds") for manifest in (mine, others))
    assert seconds == pytest.approx(expected, rel=1e-2)  # a bench computes a turn more as it is closed
    assert {**mine, "started_utc": 0} == {**others, "started_utc": 0}
    assert open_run(folder).notes == []


def test_two_cores_write_the_folder_that_one_writes(verb, one, tmp_path):
    code, out, err = verb("run", "mock/transient", *SHORT, "--jobs", "2", "--out", tmp_path)
    assert (code, err) == (0, ""), out
    assert "[14/14]" in out
    assert_same(run_of(tmp_path), one)


def test_seven_shards_are_merged_into_the_folder_that_one_run_writes(verb, one, tmp_path):
    for number in range(1, 8):
        shard = ("--shard", f"{number}/7", "--out", tmp_path / "shards")
        assert verb("run", "mock/transient", *SHORT, "--jobs", "1", *shard)[0] == 0
    shards = sorted((tmp_path / "shards").iterdir())
    code, out, err = verb("merge", *shards, "--out", tmp_path / "merged")
    assert code == 0, err
    merged = run_of(tmp_path / "merged")
    assert out == f"{merged}\n"
    assert_same(merged, one)
    for given, said in (
        (shards[1:], "in none of 6 shards; give the other shards as well"),
        ([*shards, shards[0]], "as well; give each shard once"),
        ([*shards[1:], one], "as well; give each shard once"),
    ):
        code, _, err = verb("merge", *given, "--out", tmp_path / "refused")
        assert code == 2
        assert said in err
        assert len(err.splitlines()) == 1
    assert not (tmp_path / "refused").exists()


def test_shards_of_different_runs_are_not_merged(verb, one, tmp_path):
    assert verb("run", "mock/transient", *SHORT, "--shard", "1/14", "--seed", "1", "--out", tmp_path)[0] == 0
    code, _, err = verb("merge", one, run_of(tmp_path))
    assert code == 2
    assert "not of the same run" in err
    assert "seed: 0 → 1" in err


class Killer(Script):
    """Kills a worker when the first trial is done."""

    def trial_ended(self, trial, outcome, row):
        if not self.rows:
            os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
        super().trial_ended(trial, outcome, row)


def threads():
    return Crew(2, lambda: ThreadPoolExecutor(2), lambda executor: executor.shutdown(cancel_futures=True))


def in_two(tmp_path, console, crew=threads, **sets):
    """A short campaign by two workers, threads where a test does not ask for processes."""
    profile = load_profile("mock/transient", {**SETS, **sets}, table=Table())
    plan = plan_campaign(profile, profile.trials(0), 0)
    with closing(crew()) as workers:
        return in_parts(workers, profile, plan, console, tmp_path).run()


def test_a_killed_worker_costs_no_trial_and_doubles_none(one, tmp_path):
    console = Killer()
    outcome = in_two(tmp_path, console, lambda: cores(2))
    assert outcome.exit_code == 0, outcome.line
    assert (outcome.folder / "trials.csv").read_bytes() == (one / "trials.csv").read_bytes()
    assert (outcome.folder / "events.jsonl").read_bytes() == (one / "events.jsonl").read_bytes()
    assert told(outcome.folder) == told(one)
    assert [row[0] for row in console.rows] == [row["trial"] for row in open_run(one).trials]
    assert not multiprocessing.active_children()


def test_the_guard_ends_a_campaign_in_parts_where_it_ends_one_on_one_core(run_profile, tmp_path):
    whole = run_profile(trials=(), seed=0, **SETS, **{"limits.force_n": "0.3"})
    outcome = in_two(tmp_path, Script(), **{"limits.force_n": "0.3"})
    assert outcome.exit_code == whole.outcome.exit_code == 4
    assert outcome.line == whole.outcome.line
    assert (outcome.folder / "trials.csv").read_text() == whole.csv
    manifests = [open_run(folder).manifest for folder in (outcome.folder, whole.outcome.folder)]
    assert manifests[0]["exit"] == manifests[1]["exit"]


def test_an_operator_ends_a_campaign_in_parts(one, tmp_path):
    class Leaver(Script):
        def poll(self):
            return "abort" if self.rows else None

    outcome = in_two(tmp_path, Leaver())
    assert outcome.exit_code == 130
    rows = (outcome.folder / "trials.csv").read_text()
    assert (one / "trials.csv").read_text().startswith(rows)
    assert open_run(outcome.folder).manifest["exit"]["status"] == "aborted"


def test_a_cluster_writes_the_folder_that_one_core_writes(verb, one, tmp_path):
    from distributed import LocalCluster

    with LocalCluster(n_workers=1, threads_per_worker=1, processes=False, dashboard_address=None) as cluster:
        arguments = ("--scheduler", cluster.scheduler_address, "--out", tmp_path)
        code, out, err = verb("run", "mock/transient", *SHORT, *arguments)
    assert (code, err) == (0, ""), out
    assert_same(run_of(tmp_path), one)


def test_a_bench_that_is_there_once_is_not_run_by_several(verb):
    code, _, err = verb("run", "hardware/transient", "--jobs", "2")
    assert code == 2
    assert "there is one hardware bench" in err


@pytest.mark.parametrize("said", ["0/7", "8/7", "3", "a/b"])
def test_a_shard_that_is_none_is_refused(verb, said):
    code, _, err = verb("run", "mock/transient", "--shard", said)
    assert code == 2
    assert "is no shard" in err
