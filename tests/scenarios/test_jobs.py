"""A campaign is the same run folder on one core, on several, on a cluster, in shards, and after a worker died."""

import json
import multiprocessing
import os
import pickle
import select
import shutil
import signal
import tempfile
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import closing
from copy import deepcopy
from pathlib import Path
from types import SimpleNamespace

import pytest
from mcap.reader import make_reader

from config import jobs
from config.assemble import plan_campaign
from config.jobs import BATCH_S, DEATHS, Batch, Crew, JobsError, batches, cluster, cores, in_batches, order_of
from config.joined import add_manifest
from config.profile import load_profile
from controller.recording.joining import broken_off
from controller.recording.reader import open_run
from controller.recording.run_folder import RecordingError, RunFolderError
from controller.recording.stream_writer import StreamWriter
from tests.refusals import check_refusal, refused
from tests.scenarios.conftest import FEW, InTurn, Script, change_manifest, options, run_of, run_once

SHORT = (*options(FEW), "--no-report")


@pytest.fixture(scope="module")
def one(tmp_path_factory):
    """On one core, in this process."""
    return run_once(tmp_path_factory.mktemp("one"), *SHORT, "--jobs", "1")


def content(folder):
    """All messages of a recording by trial, with their times since the run began, and what is attached: as a reader of
    MCAP finds them."""
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
        attached = [one.name for one in reader.iter_attachments()]
    return messages, trials, topics, attached


def assert_same(folder, other):
    """Two runs cannot be distinguished, however they were made."""
    for name in ("trials.csv", "events.jsonl"):
        assert (folder / name).read_bytes() == (other / name).read_bytes(), name
    for mine, others in zip(content(folder), content(other), strict=True):
        assert mine == others
    mine, others = (json.loads((run / "manifest.json").read_text()) for run in (folder, other))
    seconds, expected = (manifest.pop("plant").pop("seconds") for manifest in (mine, others))
    assert seconds == pytest.approx(expected, rel=1e-2)  # a bench computes a turn more as it is closed
    assert {**mine, "started_utc": 0} == {**others, "started_utc": 0}
    assert open_run(folder).notes == []
    assert {path.name for path in folder.iterdir()} == {path.name for path in other.iterdir()}


def test_two_cores_write_the_folder_that_one_writes(verb, one, tmp_path, monkeypatch):
    monkeypatch.setattr("config.jobs.ProcessPoolExecutor", lambda *_, **__: InTurn())
    code, out, err = verb("run", "mock/transient", *SHORT, "--jobs", "2", "--out", tmp_path)
    assert (code, err) == (0, ""), out
    assert "[6/6]" in out
    assert_same(run_of(tmp_path), one)


def test_three_shards_are_merged_into_the_folder_that_one_run_writes(verb, one, tmp_path):
    for number in range(1, 4):
        shard = ("--shard", f"{number}/3", "--out", tmp_path / "shards")
        assert verb("run", "mock/transient", *SHORT, "--jobs", "1", *shard)[0] == 0
    shards = sorted((tmp_path / "shards").iterdir())
    code, out, err = verb("merge", *shards, "--out", tmp_path / "merged")
    assert code == 0, err
    merged = run_of(tmp_path / "merged")
    assert out == f"{merged}\n"
    assert_same(merged, one)
    for given, message in (
        (shards[1:], "in none of 2 shards; give the other shards as well"),
        ([*shards, shards[0]], "as well; give each shard once"),
        ([*shards[1:], one], "as well; give each shard once"),
    ):
        code, _, err = verb("merge", *given, "--out", tmp_path / "refused")
        assert code == 2
        assert message in err
        assert len(err.splitlines()) == 1
    assert not (tmp_path / "refused").exists()


def test_shards_of_different_runs_are_not_merged(verb, one, tmp_path):
    verb("run", "mock/transient", *SHORT, "--shard", "1/6", "--seed", "1", "--out", tmp_path)
    code, _, err = verb("merge", one, run_of(tmp_path))
    assert code == 2
    assert "not of the same run" in err
    assert "seed: 0 → 1" in err


def test_shards_that_the_guard_ends_whenever_they_are_resumed_are_merged_up_to_where_it_ends_one_run(
    verb, tmp_path
):
    low = ("--set", "limits.force_n=0.3", "--jobs", "1")
    assert verb("run", "mock/transient", *SHORT, *low, "--out", tmp_path / "one")[0] == 4
    one = run_of(tmp_path / "one")
    trials = [row["trial"] for row in open_run(one).trials]
    for number in (1, 2):
        shard = ("--shard", f"{number}/2", "--out", tmp_path / "shards")
        verb("run", "mock/transient", *SHORT, *low, *shard)
    shards = sorted((tmp_path / "shards").iterdir())
    (ended,) = (shard for shard in shards if open_run(shard).trials[-1]["trial"] == trials[-1])
    code, _, err = verb("merge", *shards, "--out", tmp_path / "merged")
    assert code == 2
    assert err.startswith(f"{ended.name}: ended at trial {trials[-1]} (trial {trials[-1]}: ")
    assert err.endswith("resume it first\n")
    assert not (tmp_path / "merged").exists()

    assert verb("resume", ended, "--no-report")[0] == 4
    code, _, err = verb("merge", *shards, "--out", tmp_path / "merged")
    assert (code, err) == (0, "")
    merged = run_of(tmp_path / "merged")
    for name in ("trials.csv", "events.jsonl"):
        assert (merged / name).read_bytes() == (one / name).read_bytes()
    mine, ones = open_run(merged).manifest, open_run(one).manifest
    for key in ("exit", "outcomes", "trials"):
        assert mine[key] == ones[key]


@pytest.mark.parametrize(("trial", "status", "code"), [("aborted", "failed", 1), ("success", "fault", 3)])
def test_a_merged_run_ends_as_its_worst_shard(verb, one, tmp_path, trial, status, code):
    shard = shutil.copytree(one, tmp_path / "shard")
    ended = {"status": status, "code": code, "reason": "trial 1: reason"}
    change_manifest(shard, lambda manifest: manifest.update(exit=ended))
    rows = (shard / "trials.csv").read_text().splitlines(keepends=True)
    number, _, more = rows[1].split(",", 2)
    (shard / "trials.csv").write_text("".join([rows[0], f"{number},{trial},{more}", *rows[2:]]))
    assert verb("merge", shard, "--out", tmp_path / "merged")[0] == 0
    assert open_run(run_of(tmp_path / "merged")).manifest["exit"] == ended


@pytest.mark.parametrize(
    ("name", "end", "said"),
    [
        ("trials.csv", -3, "the last row of trials.csv"),
        ("events.jsonl", -3, "line 1 column"),
        ("recording.mcap", 60_000, "is not whole"),
    ],
)
def test_a_shard_that_was_cut_off_is_to_be_resumed_first(verb, one, tmp_path, name, end, said):
    shard = Path(shutil.copytree(one, tmp_path / "shard"))
    (shard / name).write_bytes((shard / name).read_bytes()[:end])
    code, _, err = verb("merge", shard, "--out", tmp_path / "merged")
    assert code == 2
    check_refusal(err, str(shard), "damaged or cut off", said, "resume it first")
    assert not (tmp_path / "merged").exists()


def test_what_was_done_by_hand_before_any_shards_trials_is_in_the_merged_manifest(verb, tmp_path):
    did = [{"before_trial": number, "did": "home stage", "outcome": "done"} for number in (1, 2)]
    for number in (1, 2):
        few = ("--only", "1", "--only", "2", "--shard", f"{number}/2", "--out", tmp_path / "shards")
        verb("run", "mock/transient", *SHORT, *few)
    shards = sorted((tmp_path / "shards").iterdir())
    for shard, one in zip(shards, did, strict=True):
        change_manifest(shard, lambda manifest, one=one: manifest.update(by_hand=[one]))
    assert verb("merge", *shards, "--out", tmp_path / "merged")[0] == 0
    assert open_run(run_of(tmp_path / "merged")).manifest["by_hand"] == did


def test_shards_of_different_files_of_the_users_own_are_not_merged(verb, one, tmp_path):
    folders = [shutil.copytree(one, tmp_path / name) for name in ("a", "b")]
    for folder in folders:
        own = {"my_lab": {"folder": str(folder), "sha256": folder.name * 64}}  # on each machine elsewhere
        change_manifest(folder, lambda manifest, own=own: manifest["profile"].update(own=own))
    code, _, err = verb("merge", *folders, "--out", tmp_path / "merged")
    assert code == 2
    assert f"own.my_lab: {'a' * 64} → {'b' * 64}" in err


class Killer(Script):
    """Kills a worker when the first trial is done."""

    def trial_ended(self, trial, outcome, row):
        if not self.rows:
            os.kill(multiprocessing.active_children()[0].pid, signal.SIGKILL)
        super().trial_ended(trial, outcome, row)


def in_turn():
    return Crew(2, InTurn, lambda _: None)


def in_two(tmp_path, console, crew=in_turn, **sets):
    """A short campaign by two workers, in this process where a test does not ask for others."""
    profile = load_profile("mock/transient", {**FEW, **sets})
    plan = plan_campaign(profile, profile.trials(0), 0)
    with closing(crew()) as workers:
        return in_batches(workers, profile, plan, console, tmp_path).run()


def test_a_killed_worker_costs_no_trial_and_doubles_none(one, tmp_path):
    console = Killer()
    outcome = in_two(tmp_path, console, lambda: cores(1))
    assert outcome.exit_code == 0, outcome.line
    assert (outcome.folder / "trials.csv").read_bytes() == (one / "trials.csv").read_bytes()
    assert (outcome.folder / "events.jsonl").read_bytes() == (one / "events.jsonl").read_bytes()
    assert content(outcome.folder) == content(one)
    assert [row[0] for row in console.rows] == [row["trial"] for row in open_run(one).trials]
    assert not multiprocessing.active_children()


def test_a_commit_while_a_campaign_runs_does_not_end_it(tmp_path, monkeypatch):
    class Committer(Script):
        def trial_ended(self, trial, outcome, row):
            monkeypatch.setattr(
                "controller.campaign.subprocess.run", lambda *_, **__: SimpleNamespace(stdout="0" * 12)
            )
            super().trial_ended(trial, outcome, row)

    outcome = in_two(tmp_path, console := Committer())
    assert (outcome.exit_code, len(console.rows)) == (0, 6), outcome.line


def test_the_guard_ends_a_campaign_in_parts_where_it_ends_one_on_one_core(run_profile, tmp_path):
    whole = run_profile(trials=(), seed=0, **FEW, **{"limits.force_n": "0.3"})
    outcome = in_two(tmp_path, Script(), **{"limits.force_n": "0.3"})
    assert outcome.exit_code == whole.outcome.exit_code == 4
    assert outcome.line == whole.outcome.line
    assert (outcome.folder / "trials.csv").read_text() == whole.csv
    manifests = [open_run(folder).manifest for folder in (outcome.folder, whole.outcome.folder)]
    assert manifests[0]["exit"] == manifests[1]["exit"]


def test_nothing_is_joined_from_a_batch_whose_own_disk_was_full_on(one, tmp_path):
    numbers = [row["trial"] for row in open_run(one).trials]
    full = f'[{{ device = "disk", kind = "full", after = "APPROACH", trial = {numbers[2]} }}]'
    outcome = in_two(tmp_path, Script(), faults=full)
    assert (outcome.exit_code, outcome.error) == (1, None)
    assert outcome.line.startswith("recorder: No space left on device")
    assert [row["trial"] for row in open_run(outcome.folder).trials] == numbers[:2]


def test_of_a_batch_whose_samples_cannot_be_taken_over_no_row_is(one, tmp_path, monkeypatch):
    copy, copied = StreamWriter.copy, []

    def full(self, *given):
        copied.append(given)
        if len(copied) > 5:
            raise OSError(28, "No space left on device")
        copy(self, *given)

    monkeypatch.setattr(StreamWriter, "copy", full)
    outcome = in_two(tmp_path, Script())
    assert outcome.exit_code == 1
    assert "No space left on device" in outcome.line
    run = open_run(outcome.folder)
    assert 0 < len(run.trials) < 6
    assert not broken_off(run.folder).unrecorded


def test_what_another_version_of_the_program_ran_is_refused_also_where_all_workers_have_it(one):
    ran = open_run(one).manifest

    def taken_over(**versions):
        host = {**deepcopy(dict(ran)), "devices": {}}
        host["versions"] = {
            name: ran["versions"][name] for name in ("python", "platform", "numpy")
        } | versions
        add_manifest(host, ran)
        return host["versions"]

    assert taken_over() == ran["versions"], "a worker has loaded more"
    assert taken_over(platform="another kernel") == ran["versions"], "a cluster's workers have another"
    with refused(RunFolderError, "another program", "versions.numpy: 1.0", "everywhere"):
        taken_over(numpy="1.0")
    with refused(RunFolderError, "another program", "commit", "everywhere"):
        add_manifest({**deepcopy(dict(ran)), "devices": {}, "commit": "0" * 12}, ran)


def test_shards_that_an_older_program_ran_are_merged_as_its_run(verb, one, tmp_path):
    run = Path(shutil.copytree(one, tmp_path / "run"))
    change_manifest(run, lambda m: m.update(commit="0" * 12))
    code, _, err = verb("merge", run, "--out", tmp_path / "merged")
    assert (code, err) == (0, "")
    assert open_run(run_of(tmp_path / "merged")).manifest["commit"] == "0" * 12


def test_what_a_worker_reports_of_its_disk_comes_back_from_it():
    error = RecordingError(Path("runs"), "opening", OSError(28, "No space left on device"))
    assert str(pickle.loads(pickle.dumps(error))) == str(error)


def test_a_result_goes_through_a_pipe_in_one_piece_that_no_kill_cuts(tmp_path):
    profile = load_profile("mock/transient", FEW)
    plan = plan_campaign(profile, profile.trials(0), 0)
    batch = jobs.run_batch(order_of(profile, plan), plan.left[:2], tmp_path)
    assert len(pickle.dumps(batch)) < select.PIPE_BUF


def test_an_operator_ends_a_campaign_in_batches(one, tmp_path, monkeypatch):
    class Leaver(Script):
        def poll(self):
            return "abort" if self.rows else None

    left = tmp_path / "left"
    left.mkdir()
    monkeypatch.setattr(tempfile, "tempdir", str(left))
    outcome = in_two(tmp_path, Leaver())
    assert outcome.exit_code == 130
    assert not list(left.iterdir())
    rows = (outcome.folder / "trials.csv").read_text()
    assert (one / "trials.csv").read_text().startswith(rows)
    assert open_run(outcome.folder).manifest["exit"]["status"] == "aborted"


def test_a_cluster_writes_the_folder_that_one_core_writes(verb, one, tmp_path, local_cluster):
    arguments = ("--scheduler", local_cluster.scheduler_address, "--out", tmp_path)
    code, out, err = verb("run", "mock/transient", *SHORT, *arguments)
    assert code == 0, (out, err)  # Dask may warn on standard error
    assert_same(run_of(tmp_path), one)


def dying(*_):
    from distributed import KilledWorker

    raise KilledWorker("part", SimpleNamespace(address="tcp://10.0.0.7:8786"), 3)


def test_a_part_that_a_cluster_gave_up_is_reported_in_a_line(local_cluster, monkeypatch):
    monkeypatch.setattr(jobs, "run_batch_afar", dying)
    with closing(cluster(local_cluster.scheduler_address)) as crew:
        crew.submit(None, [], None)  # begun
        found = batches(crew, None, [SimpleNamespace(id=5), SimpleNamespace(id=6)], None, lambda: None)
        with pytest.raises(JobsError, match="trials 5 or beside them; is there memory enough"):
            next(found)


def test_a_scheduler_that_is_gone_is_reported_in_a_line():
    class Gone(Executor):
        def submit(self, fn, /, *args, **kwargs):
            future = Future()
            future.cancel()  # what Dask's client makes of a connection that is lost
            future.set_running_or_notify_cancel()
            return future

    with pytest.raises(JobsError, match="the scheduler is gone"):
        next(batches(Crew(1, Gone, lambda _: None), None, [SimpleNamespace(id=5)], None, lambda: None))


class Broken(Executor):
    """Finds out that a worker died when it is given a part, or when that part is awaited."""

    def __init__(self, at_once):
        self.at_once = at_once

    def submit(self, fn, /, *args, **kwargs):
        if self.at_once:
            raise BrokenProcessPool("a worker died")
        lost = Future()
        lost.set_exception(BrokenProcessPool("a worker died"))
        return lost


@pytest.mark.parametrize("at_once", [True, False])
def test_workers_are_renewed_whenever_their_death_is_found_but_not_for_ever(at_once):
    begun = []

    def begin():
        begun.append(Broken(at_once))
        return begun[-1]

    trials = [SimpleNamespace(id=number) for number in range(5)]
    with pytest.raises(JobsError, match="trials 0 or beside them"):
        list(batches(Crew(2, begin, lambda _: None), None, trials, None, lambda: None))
    assert len(begun) == DEATHS


@pytest.mark.parametrize("at_once", [True, False])
def test_new_workers_run_what_was_lost_and_nothing_twice(at_once):
    crews = [Broken(at_once), Broken(at_once), ThreadPoolExecutor(2)]
    seen = []

    def part(order, trials, scratch):
        seen.extend(trials)
        return Batch(scratch, ",".join(str(trial.id) for trial in trials), BATCH_S)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(jobs, "run_batch", part)
        crew = Crew(2, lambda: crews.pop(0), lambda executor: executor.shutdown())
        trials = [SimpleNamespace(id=number) for number in range(9)]
        found = [part.error for part in batches(crew, None, trials, None, lambda: None)]
    assert found == [str(number) for number in range(9)]
    assert len(seen) == 9


def test_a_bench_that_is_there_once_is_not_run_by_several(verb):
    code, _, err = verb("run", "emulated/transient", "--jobs", "2")
    assert code == 2
    assert "there is one emulated bench" in err


@pytest.mark.parametrize("shard", ["0/7", "8/7", "3", "a/b"])
def test_a_shard_that_is_none_is_refused(verb, shard):
    code, _, err = verb("run", "mock/transient", "--shard", shard)
    assert code == 2
    assert "is no shard" in err


def test_a_shard_without_a_trial_is_refused(verb, tmp_path):
    only = ["--only", "1", "--only", "2", "--only", "3"]
    code, out, err = verb("run", "mock/transient", *only, "--shard", "7/9", "--out", tmp_path)
    assert (code, out, len(err.splitlines())) == (2, "", 1)
    assert "7/9 holds none of the 3 trials; shards 1 to 3 hold them all" in err
    assert list(tmp_path.iterdir()) == []


def test_ctrl_c_at_the_terminal_does_not_reach_a_worker_however_early(monkeypatch):
    monkeypatch.setattr("config.jobs.run_batch", pow)  # anything that a worker can do
    before = set(multiprocessing.active_children())
    crew = cores(1)
    try:
        assert crew.submit(7, 2, 5).result() == 4
        (worker,) = set(multiprocessing.active_children()) - before
        status = Path(f"/proc/{worker.pid}/status").read_text()
        (blocked,) = [int(line.split()[1], 16) for line in status.splitlines() if line.startswith("SigBlk")]
        assert blocked >> (signal.SIGINT - 1) & 1  # from its first instruction on: it has inherited this
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    finally:
        crew.close()
