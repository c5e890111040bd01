"""The first touch of a new bench: slow, light, and no motion without a person's word."""

import pytest

from controller.recording.reader import open_run
from tests.refusals import check_refusal

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
    check_refusal(err.strip().splitlines()[-1], "operator", "stage", "forward", "approach_axis", "reversed")
    (row,) = run.trials
    assert row["outcome"] == "aborted"
    way_m = run.trial(1).stream("stage.position").values
    assert 0.0 < way_m.max() < 0.001


def test_an_unplugged_load_cell_ends_before_the_first_millimetre(touch):
    code, err, run = touch("--only", "1", "--set", 'faults=[{device="board",kind="stuck",at_s=0.5}]')
    assert code == 3
    check_refusal(err.strip().splitlines()[-1], "board.load_cell", "sticks", "power and cable")
    assert run.trial(1).stream("stage.position").values.max() < 0.001
