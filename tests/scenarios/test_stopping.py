"""Whatever happens, the bench stands still afterwards, and what was measured is kept; first touches wait."""

from typing import Any

import pytest

from behaviors.transient import Transient
from controller.campaign import EXIT_DEVICE, EXIT_FAILED
from controller.recording.reader import open_run
from drivers.core.errors import SilentError
from drivers.core.messages import MOTION
from tests.refusals import check_refusal

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
    tables = [(folder / "trials.csv").read_text() for folder in (tmp_path / "runs").iterdir()]
    assert sum(",fault," in table for table in tables) == 1


def test_ctrl_c_once_pauses_and_the_trial_goes_on_after_a_new_baseline(run_profile, script):
    script.requests = {"APPROACH": ["pause"], "PAUSED": ["resume"]}
    bench = run_profile(trials=(1,), script=script)
    names = [name for name, _ in script.seen]
    paused = names.index("PAUSED")
    assert names[paused - 1] == "APPROACH"
    assert names[paused + 1 : paused + 5] == ["APPROACH", "STARTING", "BASELINE", "APPROACH"]
    assert bench.run.trials[0]["outcome"] == "contact"
    assert bench.outcome.exit_code == 0


MOTIONS = ("Home(", "MoveTo(", "MoveAt(")


@pytest.fixture
def touch(verb, tmp_path):
    """Runs the profile; gives exit code, errors and the run."""

    def touch(*more):
        code, _, err = verb("run", "mock/first_contact", "--no-report", "--out", tmp_path, *more)
        return code, err, open_run(max(tmp_path.iterdir(), key=lambda folder: folder.stat().st_mtime_ns))

    return touch


def test_each_motion_of_a_first_touch_waits_for_a_person(touch):
    code, _, run = touch()
    assert code == 0
    assert [row["outcome"] for row in run.trials] == ["contact"] * 3
    for row in run.trials:
        assert 0.02 < float(row["force_peak_n"]) < 0.05
        assert 0.0 <= float(row["stop_travel_m"]) < 1e-4
        assert 0.0029 < float(row["position_m"]) < 0.0035, "the finger's surface is at 3 mm"
    words = motions = 0
    for event in (event for event in run.events if event["trial"] == 1):
        words += event["event"] == "Answered"
        motions += any(command.startswith(MOTIONS) for command in event["commands"])
        assert motions <= words, event
    assert (words, motions) == (5, 5)


@pytest.mark.parametrize("state", ["STARTING", "NUDGING", "APPROACH", "RETRACTING"])
def test_nothing_moves_where_nobody_answers(touch, state):
    _, _, run = touch("--only", "1")
    at_s = next(event["t_s"] for event in run.events if event["next"] == state) - 0.6
    fault = f'faults=[{{device="operator",kind="silent",at_s={at_s}}}]'
    code, err, run = touch("--only", "1", "--set", fault, "--set", "behavior.answer_timeout_s=5.0")
    assert code == 1
    assert "operator" in err
    assert [row["outcome"] for row in run.trials] == ["aborted"]
    after = [event for event in run.events if event["t_s"] > at_s]
    assert not any(command.startswith(MOTIONS) for event in after for command in event["commands"])


def test_a_reversed_axis_ends_in_the_first_millimetre_by_the_persons_word(touch):
    _, _, run = touch("--only", "1")
    asked_s = next(event["t_s"] for event in run.events if event["next"] == "READY_FOR_TOUCH")
    fault = f'faults=[{{device="operator",kind="refuse",at_s={asked_s - 0.01}}}]'
    code, err, run = touch("--only", "1", "--set", fault)
    assert code == 1
    check_refusal(err.strip().splitlines()[-1], "operator", "stage", "approach_axis", "wrong way round")
    (row,) = run.trials
    assert row["outcome"] == "aborted"
    way_m = run.trial(1).stream("stage.position").values
    assert 0.0 < way_m.max() < 0.001


def test_an_unplugged_load_cell_ends_before_the_first_millimetre(touch):
    code, err, run = touch("--only", "1", "--set", 'faults=[{device="board",kind="stuck",at_s=0.5}]')
    assert code == 3
    check_refusal(err.strip().splitlines()[-1], "board.load_cell", "sticks", "power and cable")
    assert run.trial(1).stream("stage.position").values.max() < 0.001
