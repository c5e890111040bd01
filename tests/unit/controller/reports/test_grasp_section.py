"""What the page says of grasps: goals with their bounds, told against true slips, NIST's measures."""

from types import SimpleNamespace

import pytest

from controller.reports.counts import Trials
from controller.reports.figures import Figures
from controller.reports.grasp import GRIP, _goals, _headline, _measures, _told, section
from tests.unit.controller.reports.synthetic_runs import begun, write_rows


def row(outcome="held", **about):
    usual = {"cycle_s": 30.0, "grip_over_least": 1.1, "arrested_m": 0.0, "push_n": 0.05, "felt_n": 6.7}
    told = {"slips": 1, "told_true": 1, "told_false": 0, "untold": 0}
    known = {"friction": 0.3, "friction_low": 0.27, "friction_high": 0.33, "friction_true": 0.31}
    return {"outcome": outcome, **usual, **told, **known, **about}


def found(rows):
    return {each["goal"]: (each["found"], each["met"]) for each in _goals(Trials(rows))}


def test_a_goal_has_its_figure_its_interval_and_whether_it_is_met():
    rows = [row(), row(), row("dropped"), row("crushed", told_false=1, grip_over_least=1.5)]
    goals = found(rows)
    assert goals["dropped, or never lifted"] == ("1 of 4: 4.56 to 69.9 %", False)
    assert goals["lifts with a slip acted on that was none"] == ("1 of 4, 25.0 %", False)
    assert goals["grip over least force, median"] == ("1.1", None), "four do not decide it"


def test_a_trial_that_lifted_nothing_counts_in_no_goal_of_lifts():
    none = [row(name, slips=None) for name in ("not_found", "not_gripped")] * 200
    goals = found([*none, row(), row("dropped")])
    assert goals["dropped, or never lifted"] == ("1 of 2: 9.45 to 90.5 %", False)
    assert found(none)["crushed"] == ("no lift", None)
    assert _measures(Trials([*none, row()]))["lifts"] == 1


def test_a_trial_that_was_broken_off_counts_in_no_share_and_no_goal(tmp_path, undrawn):
    measured = {name: cell for name, cell in row().items() if name != "outcome"}
    rows = [({}, outcome, measured) for outcome in [*["held"] * 8, *["guard"] * 2]]
    run = write_rows(begun(tmp_path, "grasp", "mock", {}), rows, list(measured))
    found = section([run], Figures(tmp_path))
    assert found.summary[0].text == "Held: 100.0 % (67.6 to 100.0)."
    assert [goal["found"] for goal in found.content["goals"]][:2] == ["0 of 8: 0 to 32.4 %"] * 2


def test_a_goal_is_met_where_so_many_trials_decide_it_and_slips_in_the_air_where_there_were_any():
    assert {met for _, met in found([row()] * 6).values()} == {None, True}
    assert found([row()] * 6)["grip over least force, median"] == ("1.1", True), "six of six: 61 % at least"
    many = found([row()] * 381)  # none of 381: at most 1.0 %
    assert {met for _, met in many.values()} == {True}
    assert found([row(push_n=0.2), *[row()] * 380])["side push at first touch, largest"][1] is False
    assert "slip in the air until held, median" not in found([row()])
    goals = found([row(), *[row(arrested_m=0.0015)] * 73, *[row(arrested_m=0.0005)] * 10])
    assert goals["slip in the air until held, median"][1] is False
    assert goals["slip in the air until held, 95 of 100"][1] is True


@pytest.mark.parametrize(("planned", "said"), [(381, "✓ met"), (382, "not judged")])
def test_where_trials_are_missing_no_goal_is_called_met(tmp_path, undrawn, planned, said):
    measured = {name: cell for name, cell in row().items() if name != "outcome"}
    folder = begun(tmp_path, "grasp", "mock", {}, trials=planned)
    run = write_rows(folder, [({}, "held", measured)] * 381, list(measured))
    assert {goal["met"] for goal in section([run], Figures(tmp_path)).content["goals"]} == {said}


def test_what_was_told_stands_against_what_was_and_the_measures_are_those_of_nist():
    acted, not_acted = _told(Trials([row(told_true=2, told_false=1, untold=3)]))
    assert (acted["a slip"], acted["none"], not_acted["a slip"]) == (2, 1, 3)
    assert _told(Trials([row(told_true=None)])) == [], "a real bench does not know"
    line = _measures(Trials([row(), row(friction_true=0.5)]))
    assert line["touch sensitivity, N"] == "6.7"
    assert line["friction within its 90 % interval"] == "1 of 2"


def test_what_the_least_grip_holds_anyway_does_not_count_in_the_grip_over_the_least_force():
    grips = ((1.1, 9.0), (1.3, 20.0), (6.9, 7.0))
    rows = [row(grip_over_least=over, grip_n=grip_n) for over, grip_n in grips]
    resolved = {"behavior": {"grip_force_n": 7.0}}
    head = _headline([SimpleNamespace(trials=rows, resolved=resolved)])
    assert head.ours == "1.2"
    assert head.of.startswith("median of 2 lifts ")
    assert "more than the first grip (1 not)" in head.of
    assert _headline([SimpleNamespace(trials=rows[2:], resolved=resolved)]) is None


def test_the_force_of_a_grip_is_read_from_its_record():
    assert GRIP.findall("Grip(gripper, 0.016, 0.06, 7.7)") == ["7.7"]
    assert GRIP.fullmatch("Release(gripper, 0.02)") is None
