"""A run that broke off goes on to the rows that it would have had."""

import errno
import gc
import json
import os
import random
import shutil
import signal
import subprocess
import time
import weakref
from pathlib import Path

import numpy as np
import pytest

from config.source import ProfileError
from controller import holding
from controller.campaign import Campaign
from controller.loop import Loop
from controller.measures import transient
from controller.recording.joining import broken_off, hold
from controller.recording.reader import open_run
from controller.recording.run_folder import RunFolder
from drivers.core.messages import Failed
from simulator.mocks.zaber_stage import MockZaberStage
from tests.program import PATIENCE_S, program
from tests.refusals import check_refusal
from tests.scenarios.conftest import FEW, change_manifest, options, run_of, run_once
from touchbench import run_trials

SHORT = (*options(FEW), "--no-report")


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """An uninterrupted run."""
    return run_once(tmp_path_factory.mktemp("whole"), *SHORT)


def cut(path, rng, least=0):
    data = path.read_bytes()
    path.write_bytes(data[: rng.randint(least, len(data))])


def broken(whole, tmp_path, rows, rng=None):
    """A copy of a run, as a kill leaves it in the middle of the trial after `rows`."""
    run = tmp_path / whole.name
    shutil.copytree(whole, run)
    change_manifest(run, lambda m: m.update(exit={"status": "running", "code": None, "reason": ""}))
    lines = (run / "trials.csv").read_bytes().splitlines(keepends=True)
    (run / "trials.csv").write_bytes(b"".join(lines[: rows + 1]) + lines[rows + 1][:7])
    if rng is not None:
        cut(run / "events.jsonl", rng)
        cut(run / "recording.mcap", rng, least=100)
    return run


@pytest.mark.parametrize("seed", range(2))
def test_a_run_cut_at_any_byte_goes_on_to_the_same_rows(verb, whole, tmp_path, seed):
    rng = random.Random(seed)
    run = broken(whole, tmp_path, rng.randint(0, 4), rng)
    code, out, err = verb("resume", run, "--no-report")
    assert (code, err) == (0, ""), out
    assert (run / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()
    resumed = open_run(run)
    assert resumed.manifest["exit"]["status"] == "done"
    assert resumed.manifest["outcomes"] == open_run(whole).manifest["outcomes"]
    assert len(resumed.manifest["resumed_utc"]) == 1


def unnumbered(event):
    """Commands are numbered within a process."""
    return {key: value for key, value in event.items() if key != "command_id"}


def test_a_killed_run_goes_on_to_the_same_rows_and_events(verb, whole, tmp_path):
    where = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}
    process = program("run", "mock/transient", *SHORT, "--out", tmp_path, **where)
    give_up_s = time.monotonic() + PATIENCE_S
    while not any(path.read_bytes().count(b"\n") > 2 for path in tmp_path.glob("*/trials.csv")):
        assert process.poll() is None, process.stdout.read()
        assert time.monotonic() < give_up_s, "no second trial ended"
    process.send_signal(signal.SIGKILL)
    process.communicate()
    run = run_of(tmp_path)
    code, out, err = verb("resume", run, "--no-report")
    assert (code, err) == (0, ""), out
    assert (run / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()
    resumed, expected = open_run(run), open_run(whole)
    assert [unnumbered(event) for event in resumed.events] == [unnumbered(event) for event in expected.events]
    assert resumed.recorded_trials == expected.recorded_trials


def test_a_trial_that_ended_the_run_is_run_again(verb, whole, tmp_path):
    run = broken(whole, tmp_path, 5)
    lines = (run / "trials.csv").read_bytes().splitlines(keepends=True)
    number = lines[5].split(b",")[0]
    lines[5] = number + b",guard" + lines[5][lines[5].index(b",", len(number) + 1) :]
    (run / "trials.csv").write_bytes(b"".join(lines[:6]))
    assert verb("resume", run, "--no-report")[0] == 0
    assert (run / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()
    torn = [json.loads(line) for line in (run / "interrupted.jsonl").read_text().splitlines()]
    assert int(number) in {event["trial"] for event in torn}


def test_a_trial_whose_measure_raised_is_run_again(verb, whole, tmp_path, monkeypatch):
    tared, measured = transient.tared, []

    def failing_once(*given):
        measured.append(given)
        if len(measured) == 2:
            raise IndexError("of a measure")
        return tared(*given)

    monkeypatch.setattr(transient, "tared", failing_once)
    found = tmp_path / "found"
    code, _, err = verb("run", "mock/transient", *SHORT, "--jobs", "1", "--out", found)
    assert (code, "IndexError: of a measure" in err) == (1, True)
    run = run_of(found)
    assert open_run(run).manifest["outcomes"]["fault"] == 1
    assert verb("resume", run, "--no-report")[0] == 0
    assert (run / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()


def test_a_run_that_is_done_reports_it(verb, whole):
    before = (whole / "manifest.json").read_bytes()
    code, out, _ = verb("resume", whole)
    assert code == 0
    assert "all 6 trials are done" in out
    assert (whole / "manifest.json").read_bytes() == before


def test_what_a_script_ran_is_resumed_with_its_own_trials_and_is_found_while_it_runs(verb, tmp_path):
    notes = []

    def say(_):
        notes.append(list(holding.folder().glob(f"{os.getpid()}-*.json")))

    rows = [{"location": "f", "speed_m_s": 0.002 * np.float64(step)} for step in (1, 2, 3)]
    settings = {"behavior.settle_s": "2.0"}
    outcome, run = run_trials("mock/transient", rows, settings=settings, seed=3, out=tmp_path, say=say)
    assert outcome.exit_code == 0
    assert notes and all(notes)
    whole = run.folder.trials_path.read_bytes()
    run.folder.trials_path.write_bytes(b"".join(whole.splitlines(keepends=True)[:2]))
    code, _, err = verb("resume", run.folder.path, "--no-report")
    assert (code, err) == (0, "")
    assert run.folder.trials_path.read_bytes() == whole


def test_a_script_is_refused_what_the_guard_would_refuse_before_anything_is_written(tmp_path):
    with pytest.raises(ProfileError, match="a run would be refused"):
        run_trials("mock/transient", [{"location": "f", "speed_m_s": 0.9}], out=tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_scripts_trial_whose_device_failed_is_repeated(tmp_path, monkeypatch):
    failing(monkeypatch, 1)
    said = []
    rows = [{"location": "f", "speed_m_s": 0.004}] * 2
    settings = {"behavior.settle_s": "2.0", "trials.reconnects": "1"}
    outcome, run = run_trials("mock/transient", rows, settings=settings, out=tmp_path, say=said.append)
    assert outcome.exit_code == 0
    assert [row["trial"] for row in run.trials] == [1, 2]
    assert any("reconnected, 1 of 1" in line for line in said)


@pytest.mark.parametrize(
    ("change", "code", "message"),
    [
        (lambda m: m.update(commit="0123456789ab"), 2, "was run by another program (commit: 0123456789ab → "),
        (lambda m: m["versions"].update(numpy="1.0"), 2, "another program (versions.numpy: 1.0 → "),
        (
            lambda m: m["profile"]["resolved"]["limits"].update(force_n=1.25),
            2,
            "its profile was changed since (limits.force_n: 1.25 → 2.0)",
        ),
        (lambda m: m["devices"]["stage"].update(serial="7"), 3, "its serial was 7 and is"),
    ],
)
def test_another_program_profile_or_device_is_refused_by_name(verb, whole, tmp_path, change, code, message):
    run = broken(whole, tmp_path, 3)
    change_manifest(run, change)
    found, out, err = verb("resume", run, "--no-report")
    assert found == code, out + err
    assert message in err
    assert len(err.splitlines()) == 1


@pytest.mark.parametrize("given", [("resume",), ("merge", "--out", "joined")])
def test_a_manifest_that_lacks_what_it_has_today_is_refused_by_name(verb, whole, tmp_path, given):
    run = (
        broken(whole, tmp_path, 3) if given == ("resume",) else Path(shutil.copytree(whole, tmp_path / "run"))
    )
    change_manifest(run, lambda m: m.pop("commit"))
    code, _, err = verb(given[0], run, *given[1:])
    assert code == 2
    check_refusal(err, "'commit'", "another version", "run it anew")


def test_a_recording_that_lacks_what_it_has_today_is_damaged_and_refused_by_name(verb, whole, tmp_path):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    recording = run / "recording.mcap"
    recording.write_bytes(recording.read_bytes().replace(b"base_ns", b"else_ns"))
    code, _, err = verb("replay", run, "--detector", "resonance")
    assert code == 2
    check_refusal(err, str(recording), "damaged", "base_ns")
    code, out, err = verb("export", run, "--to", "csv")
    assert code == 0
    assert out.splitlines() == [str(run / "csv" / "trials.csv")]
    check_refusal(err, str(recording), "damaged")


def test_a_run_that_goes_on_elsewhere_is_left_alone(verb, whole, tmp_path):
    run = broken(whole, tmp_path, 3)
    before = (run / "trials.csv").read_bytes()
    held = hold(RunFolder(run))
    try:
        code, _, err = verb("resume", run, "--no-report")
    finally:
        os.close(held)
    assert code == 2
    assert "goes on in another program" in err
    assert (run / "trials.csv").read_bytes() == before


def test_a_resume_that_began_while_another_one_went_on_deletes_nothing(verb, whole, tmp_path, monkeypatch):
    run = broken(whole, tmp_path, 3)

    def waited(folder):
        shutil.copy(whole / "trials.csv", run)
        return hold(folder)

    monkeypatch.setattr("controller.recording.joining.hold", waited)
    code, _, err = verb("resume", run, "--no-report")
    assert code == 2
    check_refusal(err, run.name, "another program", "resume it again")
    assert (run / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()


def test_a_trial_whose_samples_are_not_whole_is_run_again_and_the_run_is_merged_then(verb, whole, tmp_path):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    recording = (run / "recording.mcap").read_bytes()
    (run / "recording.mcap").write_bytes(recording[: len(recording) * 3 // 4])
    code, _, err = verb("merge", run, "--out", tmp_path / "refused")
    assert code == 2
    check_refusal(err, "is not whole", "resume it first")
    code, out, err = verb("resume", run, "--no-report")
    assert (code, err) == (0, "")
    last = open_run(whole).trials[-1]["trial"]
    assert f"{last}: these are run again" in out
    assert (run / "trials.csv").read_bytes() == (whole / "trials.csv").read_bytes()
    (run / "recording_3.mcap").touch()  # of a resume that a full disk ended at once
    code, out, err = verb("merge", run, "--out", tmp_path / "merged")
    assert (code, err) == (0, "")
    merged = open_run(run_of(tmp_path / "merged"))
    assert merged.recorded_trials == open_run(whole).recorded_trials


def test_the_rows_of_a_run_whose_recording_was_taken_away_stay(whole, tmp_path):
    run = Path(shutil.copytree(whole, tmp_path / "run"))
    (run / "recording.mcap").unlink()
    assert len(broken_off(RunFolder(run)).done) == 6


def test_a_file_system_without_locks_is_no_other_program(whole, monkeypatch):
    def unknown(_):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr("controller.recording.joining.lock", unknown)
    held = hold(RunFolder(whole))
    os.close(held)
    assert held > 0


def failing(monkeypatch, times):
    """The stage fails in the second trial, each time that this is begun, so often; a moment later it answers again."""
    poll, failed, trial = MockZaberStage.poll, set(), []

    def polled(self):
        statuses = poll(self)
        if trial[-1:] == [2] and len(trial) not in failed and len(failed) < times and self._clock.now() > 0.5:
            failed.add(len(trial))
            return [Failed(self._clock.now(), self.name, "its link is gone")]
        return statuses

    begin = Campaign._trial

    def begun(self, plan, *given):
        trial.append(plan.trial)
        return begin(self, plan, *given)

    monkeypatch.setattr(Campaign, "_trial", begun)
    monkeypatch.setattr(MockZaberStage, "poll", polled)


RECONNECTING = ("--set", "trials.order=listed", "--jobs", "1", "--only", "1", "--only", "2", "--only", "3")


def test_a_trial_whose_device_failed_is_repeated_with_devices_opened_anew(verb, tmp_path, monkeypatch):
    expected = tmp_path / "expected"
    assert verb("run", "mock/transient", *SHORT, *RECONNECTING, "--out", expected)[0] == 0
    failing(monkeypatch, 2)
    found = tmp_path / "found"
    twice = ("--set", "trials.reconnects=2")
    code, _, err = verb("run", "mock/transient", *SHORT, *RECONNECTING, *twice, "--out", found)
    assert code == 0, err
    assert "its link is gone" in err
    assert "reconnected, 1 of 2" in err
    assert "reconnected, 2 of 2" in err
    assert (run_of(found) / "trials.csv").read_bytes() == (run_of(expected) / "trials.csv").read_bytes()
    assert len(open_run(run_of(found)).manifest["resumed_utc"]) == 2


def test_a_bench_is_not_reconnected_where_a_person_pressed_ctrl_c_while_its_devices_closed(
    verb, tmp_path, monkeypatch, at_terminal
):
    failing(monkeypatch, 1)
    close = Campaign._close
    monkeypatch.setattr(Campaign, "_close", lambda self: (signal.raise_signal(signal.SIGINT), close(self))[1])
    twice = ("--set", "trials.reconnects=2")
    code, _, err = verb("run", "mock/transient", *SHORT, *RECONNECTING, *twice, "--out", tmp_path)
    assert code == 3
    assert "reconnected" not in err


def test_nothing_is_kept_of_a_bench_that_was_reconnected(verb, tmp_path, monkeypatch):
    failing(monkeypatch, 2)
    benches, alive, go = [], [], Campaign.run

    def counted(self):
        benches.append(weakref.ref(self._rig))
        gc.collect()
        alive.append(sum(one() is not None for one in benches))
        return go(self)

    monkeypatch.setattr(Campaign, "run", counted)
    twice = ("--set", "trials.reconnects=2")
    assert verb("run", "mock/transient", *SHORT, *RECONNECTING, *twice, "--out", tmp_path)[0] == 0
    assert alive == [1, 1, 1]


def test_it_is_repeated_no_oftener_than_the_profile_says(verb, tmp_path, monkeypatch):
    failing(monkeypatch, 3)
    code, _, err = verb(
        "run", "mock/transient", *SHORT, *RECONNECTING, "--set", "trials.reconnects=1", "--out", tmp_path
    )
    assert code == 3
    assert err.count("reconnected") == 1
    assert "its link is gone" in err.splitlines()[-1]


def test_a_bench_on_which_something_may_still_move_is_not_reconnected(verb, tmp_path, monkeypatch):
    failing(monkeypatch, 1)
    halt = Loop.halt

    def halted(self):
        halt(self)
        if self.account.outcome:
            self.account.not_at_rest.append("stage")

    monkeypatch.setattr(Loop, "halt", halted)
    code, _, err = verb(
        "run", "mock/transient", *SHORT, *RECONNECTING, "--set", "trials.reconnects=1", "--out", tmp_path
    )
    assert code == 3
    assert "it is not reconnected: something may still move" in err
    assert "NOT seen standing still: stage" in err
