"""`stop` from a fresh process, beside a run of an emulated bench that moves, hangs or has gone."""

import json
import signal
import subprocess
import sys
import time

import pytest

from drivers.core.messages import MoveAt, Stalled
from drivers.ur_arm.aside import stop_beside
from drivers.ur_arm.settings import UrArmSettings
from tests.program import ROOT, program
from tests.refusals import check_refusal
from tests.wire.emulated_ur import resting
from tests.wire.ur_hand import settings

SAID = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT}


@pytest.fixture
def notes(tmp_path, monkeypatch):
    """A folder of notes of this test's own."""
    runtime = tmp_path / "runtime"
    runtime.mkdir()
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(runtime))
    return runtime


@pytest.fixture
def running(notes, tmp_path):
    """Runs a profile until a state of its first trial; whatever it is, it has ended when the test has."""
    runs = []

    def until(state, *arguments):
        out = tmp_path / f"runs{len(runs)}"
        short = ("--set", "behavior.settle_s=0.5", "--no-report", "--out", out)
        run = program("run", *arguments, *short, **SAID)
        runs.append(run)
        end_s = time.monotonic() + 120.0
        while not any(f'"{state}"' in path.read_text() for path in out.glob("*/events.jsonl")):
            assert run.poll() is None, run.stdout.read()
            assert time.monotonic() < end_s, f"never in {state}"
            time.sleep(0.05)
        return run, out

    yield until
    for run in runs:
        run.send_signal(signal.SIGCONT)
        run.kill()
        run.communicate(timeout=100.0)


@pytest.fixture
def bench_json(tmp_path):
    """Devices of emulated/transient that outlive the program which moves them: the file with their addresses."""
    path = tmp_path / "bench.json"
    with path.open("w") as out:
        process = program("emulate", "emulated/transient", stdout=out)
    while not path.read_text().endswith("\n"):
        assert process.poll() is None
        time.sleep(0.05)
    yield path
    process.send_signal(signal.SIGINT)
    process.wait(100.0)


def stop(*arguments):
    stopped = program("stop", *arguments, **SAID)
    said, _ = stopped.communicate(timeout=100.0)
    return stopped.returncode, said


def test_a_run_that_moves_is_stopped_and_says_that_it_stands(running, notes):
    run, out = running("APPROACH", "emulated/transient")
    code, said = stop("emulated/transient")
    assert code == 0, said
    assert f"(process {run.pid}) is asked to stop" in said
    assert "stage: stopped by run of emulated/transient" in said
    assert run.wait(100.0) == 130
    (manifest,) = out.glob("*/manifest.json")
    assert json.loads(manifest.read_text())["exit"]["reason"] == "interrupted: the bench is still"
    assert not list(notes.glob("*/*.json")), "a note goes with its program"


def test_a_bench_that_outlives_its_run_is_opened_and_seen_to_stand(running, bench_json):
    run, _ = running("APPROACH", "emulated/transient", "--endpoints", bench_json)
    code, said = stop("emulated/transient", "--endpoints", bench_json)
    assert code == 0, said
    assert "stage: stopped, and stands still" in said
    assert "board: does not move by itself" in said
    assert run.wait(100.0) == 130


def test_a_stage_whose_program_hangs_cannot_be_reached_and_says_what_to_press(running):
    run, _ = running("APPROACH", "emulated/transient")
    run.send_signal(signal.SIGSTOP)
    code, said = stop("emulated/transient")
    assert code == 3, said
    (line,) = [line for line in said.splitlines() if line.startswith("stage:")]
    check_refusal(line, "NOT seen standing still", str(run.pid), "emergency stop", f"kill -9 {run.pid}")
    run.kill()
    run.wait(100.0)
    code, said = stop("emulated/transient")
    assert code == 0
    assert "no program has this bench" in said


ASIDE = """
import sys
from drivers.ur_arm.aside import stop_beside
from drivers.ur_arm.settings import UrArmSettings
print(stop_beside(UrArmSettings.model_validate_json(sys.argv[1])) or "it stands still")
"""


def test_an_arm_is_stopped_beside_the_program_that_holds_it(hand):
    one = hand()
    one.set_out(MoveAt("arm", 0.02, 0.04))
    command = [sys.executable, "-c", ASIDE, settings(one.emulated).model_dump_json()]
    beside = subprocess.Popen(command, cwd=ROOT, text=True, stdout=subprocess.PIPE)
    while beside.poll() is None:
        one.turn()
    said, _ = beside.communicate()
    assert said == "it stands still\n"
    assert any(isinstance(status, Stalled) for status in one.statuses), "its own program is told, too"
    assert resting(one.emulated.order())


def test_an_arm_that_is_not_there_is_not_said_to_stand():
    nowhere = UrArmSettings(host="127.9.9.9", start_pose=(0.4, 0.0, 0.3, 0.0, 3.14, 0.0))
    check_refusal(stop_beside(nowhere), "127.9.9.9", "is the controller on")
