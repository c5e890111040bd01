"""Whatever happens, the bench stands still afterwards, and what was measured is on the disk."""

from typing import Any

import pytest

from behaviors.transient import Transient
from controller.campaign import EXIT_DEVICE, EXIT_FAILED, EXIT_GUARD, EXIT_INTERRUPTED
from drivers.core.errors import SilentError
from drivers.core.messages import MOTION, Stop

UNDISTURBED: dict[str, Any] = {}


def when(run_profile, state, **settings):
    """Bench time in the middle of a state of an undisturbed trial, which is run once."""
    key = repr(settings)
    if key not in UNDISTURBED:
        UNDISTURBED[key] = run_profile(trials=(1,), **settings).script.seen
    seen = UNDISTURBED[key]
    names = [name for name, _ in seen]
    at = names.index(state)
    return (seen[at][1] + seen[at + 1][1]) / 2


def stands_still(bench):
    axis = bench.stage.axis
    return not axis.moving(bench.rig.clock.now())


@pytest.mark.parametrize("state", [state for state in Transient.states if state not in Transient.final])
@pytest.mark.parametrize("device", ["stage", "board"])
def test_a_fault_stops_every_mover_from_every_state(run_profile, state, device):
    at_s = when(run_profile, state)
    bench = run_profile(trials=(1, 2), faults=[{"device": device, "kind": "unplug", "at_s": at_s}])
    assert bench.outcome.exit_code == EXIT_DEVICE
    if device == "board":
        assert stands_still(bench)
    else:  # no command reaches a stage without its cable: it goes no farther than its own controller's limit
        assert 0.0 <= bench.stage.axis.target_m <= 0.010
        assert "NOT seen standing still: stage" in bench.outcome.line
    assert len(bench.run.trials) == 1, "nothing moves after an error: no second trial"
    assert bench.run.trials[0]["outcome"] == "fault"
    assert "the link is gone" in bench.outcome.line
    last = bench.run.events[-1]
    assert not any(command.startswith(kind.__name__) for command in last["commands"] for kind in MOTION)


@pytest.mark.parametrize(
    ("state", "start_m"), [("STARTING", "0.0026"), ("APPROACH", "0.0"), ("RETRACTING", "0.0")]
)
def test_a_silent_load_cell_stops_what_moves(run_profile, state, start_m):
    far = {"behavior__start_m": start_m}  # far enough for the motion to outlast limits.stale_s
    at_s = when(run_profile, state, **far)
    bench = run_profile(trials=(1,), faults=[{"device": "board", "kind": "silent", "at_s": at_s}], **far)
    assert bench.outcome.exit_code == EXIT_DEVICE
    assert "is silent" in bench.outcome.line
    assert "board." in bench.outcome.line
    assert stands_still(bench)


def test_a_stalled_stage_ends_the_run(run_profile):
    at_s = when(run_profile, "APPROACH")
    bench = run_profile(trials=(1,), faults=[{"device": "stage", "kind": "stall", "at_s": at_s}])
    assert bench.outcome.exit_code == EXIT_DEVICE
    assert "stalled" in bench.outcome.line


def test_a_force_beyond_the_limit_stops_the_approach_without_the_behavior(run_profile):
    bench = run_profile(trials=(1,), limits__force_n="0.02", detectors__contact__threshold_sigma="90.0")
    assert bench.outcome.exit_code == EXIT_GUARD
    assert "beyond limits.force_n = 0.02" in bench.outcome.line
    assert bench.run.trials[0]["outcome"] == "guard"
    assert stands_still(bench)


def test_a_command_beyond_the_travel_is_refused_before_anything_moves(run_profile):
    bench = run_profile(trials=(1,), behavior__approach_limit_m="0.011", limits__travel_m="0.0105")
    assert bench.outcome.exit_code == EXIT_GUARD
    assert "0.011 m is outside" in bench.outcome.line
    assert bench.run.trials[0]["outcome"] == "guard"
    assert stands_still(bench)


def test_a_sensor_that_reads_full_scale_stops_the_bench(run_profile):
    at_s = when(run_profile, "APPROACH")
    bench = run_profile(trials=(1,), faults=[{"device": "board", "kind": "full_scale", "at_s": at_s}])
    assert bench.outcome.exit_code == EXIT_GUARD
    assert stands_still(bench)


@pytest.mark.parametrize(
    "error", [RuntimeError("a bug"), SilentError("board", "reading", "no reply", "look")]
)
def test_an_exception_anywhere_stops_flushes_and_keeps_the_row(run_profile, tmp_path, error):
    """Raised out of the device's read, in the middle of the approach."""
    at_s = when(run_profile, "APPROACH")
    rigs = []

    def wrap(rig):
        rigs.append(rig)
        board = rig.devices["board"]
        read, spent = board.read, []

        def failing():
            if rig.clock.now() >= at_s and not spent:
                spent.append(True)
                raise error
            return read()

        board.read = failing

    bench = run_profile(trials=(1,), wrap=wrap)
    bug = isinstance(error, RuntimeError)
    assert bench.outcome.exit_code == (EXIT_FAILED if bug else EXIT_DEVICE)
    assert bench.outcome.error is (error if bug else None)
    assert bench.run.manifest["exit"]["reason"] == bench.outcome.line
    axis = rigs[0].devices["stage"].axis
    assert not axis.moving(rigs[0].clock.now())
    ledgers = [(folder / "trials.csv").read_text() for folder in (tmp_path / "runs").iterdir()]
    assert sum(",fault," in ledger for ledger in ledgers) == 1


def test_ctrl_c_once_pauses_and_the_trial_goes_on_after_a_new_baseline(run_profile, script):
    script.requests = {"APPROACH": ["pause"], "PAUSED": ["resume"]}
    bench = run_profile(trials=(1,), script=script)
    names = [name for name, _ in script.seen]
    paused = names.index("PAUSED")
    assert names[paused - 1] == "APPROACH"
    assert names[paused + 1 : paused + 5] == ["APPROACH", "STARTING", "BASELINE", "APPROACH"]
    assert bench.run.trials[0]["outcome"] == "contact"
    assert bench.outcome.exit_code == 0


def test_a_pause_stops_the_mover_at_once(run_profile, script):
    stops = []

    def spy(rig):
        stage = rig.devices["stage"]
        apply = stage.apply
        stage.apply = lambda command: (
            stops.append((rig.clock.now(), command)) if isinstance(command, Stop) else None,
            apply(command),
        )[1]

    script.requests = {"APPROACH": ["pause"], "PAUSED": ["resume"]}
    run_profile(trials=(1,), script=script, wrap=spy)
    paused_s = next(t_s for name, t_s in script.seen if name == "PAUSED")
    assert stops[0] == (paused_s, Stop("stage"))


def test_an_abort_stops_and_keeps_what_there_is(run_profile, script):
    script.requests = {"APPROACH": ["abort"]}
    bench = run_profile(trials=(1, 2), script=script)
    assert bench.outcome.exit_code == EXIT_INTERRUPTED
    assert stands_still(bench)
    assert [row["outcome"] for row in bench.run.trials] == ["aborted"]
    assert bench.run.manifest["exit"]["status"] == "aborted"
    assert bench.run.manifest["outcomes"] == {"aborted": 1}
