import json
import signal
from pathlib import Path
from typing import Any

import pytest

from benchmarks.wire_plans import ACTS, EXPERIMENTS, Act, _failures, act_of, profile_of
from config.profile import load_profile

SEEDS = range(20)


def test_each_plan_is_a_profile_of_an_emulated_bench(tmp_path: Path) -> None:
    benches, drawn = set(), []
    for seed in SEEDS:
        bench, path = profile_of(seed, tmp_path)
        benches.add(bench)
        drawn.append(load_profile(str(path), {}))
    assert {profile.bench for profile in drawn} == {"emulated"}
    assert benches == set(EXPERIMENTS)
    assert any(profile.faults for profile in drawn)


def test_half_of_the_plans_end_a_process_and_only_an_arm_has_one_of_its_own() -> None:
    acts = [act_of(seed, "transient_arm") for seed in range(400)]
    done = [act for act in acts if act is not None]
    assert 150 < len(done) < 250
    assert {act.victim for act in done} == {"program", "emulator", "arm"}
    assert {act.what for act in done} == set(ACTS)
    assert "arm" not in {act.victim for seed in range(400) if (act := act_of(seed, "static")) is not None}


def failures(tmp_path: Path, **changes: Any) -> list[str]:
    """What is found of a run of one trial in which nothing went wrong, and of one that is changed so."""
    run = tmp_path / "runs" / "one"
    run.mkdir(parents=True)
    (run / "manifest.json").write_text(
        json.dumps({"trials": 1, "exit": {"status": changes.pop("status", "done")}})
    )
    (run / "trials.csv").write_text(changes.pop("rows", "trial,outcome\n1,contact\n"))
    given: dict[str, Any] = {
        "profile": load_profile("emulated/transient", {}),
        "folder": tmp_path,
        "act": None,
        "code": 0,
        "output": "1 contact",
        "places": [0.0, 0.004],
        "after": [0.004, 0.004],
    }
    return list(_failures(**{**given, **changes}))


def test_a_sound_run_has_no_failure(tmp_path: Path) -> None:
    assert failures(tmp_path) == []


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"places": [0.0, 0.0264]}, "SAFETY: the mover was at"),
        ({"places": [-0.001, 0.0]}, "SAFETY: the mover was at"),
        ({"after": [0.004, 0.0042]}, "SAFETY: it moves on"),
        ({"output": "Traceback (most recent call last)"}, "CRASH"),
        ({"code": -11}, "CRASH: exit code -11"),
        ({"code": None}, "LIVENESS: it does not end"),
        ({"status": "running"}, "DATA: the manifest says that it still runs"),
        ({"rows": "trial,outcome\n1,\n"}, "DATA: a row without an outcome"),
        ({"rows": "trial,outcome\n"}, "DATA: 0 rows of 1 trials"),
    ],
)
def test_what_does_not_hold_is_found(tmp_path: Path, changes: dict[str, Any], found: str) -> None:
    assert any(found in each for each in failures(tmp_path, **changes))


def test_a_program_that_was_killed_may_have_left_a_manifest_that_says_it_runs(tmp_path: Path) -> None:
    act = Act("program", "SIGKILL", 1.0)
    assert failures(tmp_path, act=act, code=-signal.SIGKILL, status="running") == []
