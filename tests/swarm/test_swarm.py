"""Cases that the swarm found once, and a few fresh seeds: everything that must hold does."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import pytest

from config.swarm import checkers
from config.swarm.hunt import Hunt, deep_of, examined, replayed, shrunk
from config.swarm.plan import SCENES, Plan, drawn, known, possible
from config.swarm.play import memory, play
from controller.loop import Loop
from drivers.core.messages import Stop
from tests.swarm.planted import DEFECTS, QUICK, source_of

CORPUS = sorted((Path(__file__).parent / "corpus").glob("*.toml"))


COMPARED = (
    *("force_that_blocks_cut", "late_and_still_on_its_way", "row_that_merged_turns_cut"),
    *("stuck_and_free_again_in_one_block", "stuck_twice_at_once", "tare_at_the_edge_of_the_baseline"),
)
"""Found beside a second story, the others by what they show alone."""


@pytest.mark.parametrize("path", CORPUS, ids=lambda path: path.stem)
def test_what_was_found_once_holds_ever_since(path: Path) -> None:
    assert replayed(path, compared=path.stem in COMPARED) == []


@pytest.mark.parametrize("first", range(0, 200, 20))
def test_fresh_seeds_hold(first: int) -> None:
    hunt = Hunt()
    for seed in range(first, first + 20):
        plan = drawn(seed, QUICK)
        assert examined(plan, deep_of(plan), hunt) == [], plan.toml()
    assert hunt.seen, "in twenty seeds some fault takes effect"


def test_a_plan_is_a_profile_of_at_most_ten_lines_and_a_seed_draws_the_same_each_time() -> None:
    for seed in range(200):
        plan = drawn(seed)
        assert len(plan.toml().splitlines()) <= 10
        assert len(plan.faults) <= 6
        assert plan == drawn(seed)


def broken() -> Plan:
    faults = [
        {"device": "board", "kind": "late", "after": "BASELINE", "amount": 0.005, "for_s": 0.1},
        {"device": "stage", "kind": "stall", "after": "APPROACH", "at_s": 0.1, "for_s": 0.5},
    ]
    settings = {"behavior.settle_s": 1.0, "detectors.ours": "none", "loop.rate_hz": 150.0}
    rows = [{"location": "f", "speed_m_s": 0.00254}, {"location": "a", "speed_m_s": 0.003785}]
    return Plan(1, "transient", settings, rows, faults)


def test_a_success_that_the_guard_or_a_failure_ended_is_found_and_made_small(monkeypatch) -> None:
    monkeypatch.setattr("controller.campaign._measured", lambda *_: ("contact", "", {}))
    violations = examined(broken())
    assert [each.end for each in violations] == ["DATA"] * len(violations) != []
    small, runs = shrunk(broken(), "", "DATA")
    assert (len(small.trials), len(small.faults), "loop.rate_hz" in small.settings) == (1, 1, False)
    assert small.faults[0].keys() <= {"device", "kind", "after"}
    assert runs <= 200


def test_a_mover_that_goes_on_after_a_failure_is_found(monkeypatch) -> None:
    send = Loop._send
    monkeypatch.setattr(
        Loop, "_send", lambda self, each: None if isinstance(each, Stop) else send(self, each)
    )
    faults = [{"device": "board", "kind": "silent", "after": "APPROACH", "at_s": 0.1}]
    plan = Plan(1, "transient", {"behavior.settle_s": 1.0}, [{"location": "f", "speed_m_s": 0.0045}], faults)
    assert "SAFETY" in {each.end for each in examined(plan)}


def test_a_run_that_broke_off_goes_on_to_the_same_bytes() -> None:
    assert examined(broken(), "resumed") == []


def test_a_slow_disk_takes_effect_and_shows_in_no_row_and_no_event():
    fast = Plan(1, "static", SCENES["static"].short, known("static").rows[:1], [])
    slow = replace(fast, faults=[{"device": "disk", "kind": "slow", "amount": 0.01, "after": "RECORDING"}])
    with memory() as folder:
        one, other = play(fast, folder), play(slow, folder)
    assert [effect["kind"] for effect in other.effects] == ["slow"]
    assert list(checkers.same(one, other, "")) == []
    assert list(checkers.check(other)) == []


def test_a_fault_is_marked_in_the_manifest_when_it_takes_effect() -> None:
    with memory() as folder:
        story = play(broken(), folder)
    kinds = {effect["kind"]: effect["effect_s"] for effect in story.effects}
    approach_s = dict(story.trials[0].states)["APPROACH"]
    assert kinds["stall"] == pytest.approx(approach_s + 0.1, abs=0.03)


@pytest.mark.parametrize(
    ("experiment", "fault", "exit_code", "says"),
    [
        ("transient", {"device": "disk", "kind": "full", "after": "APPROACH"}, 1, "No space left"),
        ("transient", {"device": "stage", "kind": "overrun", "amount": 0.02}, 4, "limits.follow_m"),
        ("transient_arm", {"device": "arm", "kind": "overrun", "amount": 0.02}, 4, "limits.follow_m"),
        ("transient_arm", {"device": "arm", "kind": "nan", "after": "APPROACH"}, 4, "arm.position is at nan"),
        (
            "touch",
            {"device": "gripper", "kind": "overheat", "after": "OPENING", "at_s": 0.1},
            3,
            "gripper stalled",
        ),
        ("touch", {"device": "gripper", "kind": "silent", "after": "OPENING"}, 3, "gripper"),
    ],
)
def test_what_goes_wrong_takes_effect_and_ends_the_run_with_its_reason(experiment, fault, exit_code, says):
    known_rows = known(experiment).rows[:1]
    settings = {**SCENES[experiment].short}
    if fault["kind"] == "overrun":
        settings |= {"detectors.contact.threshold_sigma": 100.0}
    with memory() as folder:
        story = play(Plan(1, experiment, settings, known_rows, [fault]), folder)
        assert (story.exit_code, [effect["kind"] for effect in story.effects]) == (exit_code, [fault["kind"]])
        assert says in story.line
        assert list(checkers.check(story)) == []


@pytest.mark.parametrize("defect", DEFECTS, ids=range(len(DEFECTS)))
def test_what_is_planted_is_still_there_to_be_changed(defect):
    assert defect.old in source_of(defect)


@pytest.mark.parametrize(
    ("device", "kind", "state", "at_s"),
    [
        ("keys", "pause", "BASELINE", 0.1),
        ("board", "unplug", "APPROACH", 0.0),
        ("stage", "stall", "APPROACH", 0.1),
    ],
)
def test_a_cell_has_the_state_that_a_fault_met_not_the_one_that_it_led_to(device, kind, state, at_s):
    fault = {"device": device, "kind": kind, "after": state, "at_s": at_s}
    hunt = Hunt()
    plan = Plan(1, "transient", SCENES["transient"].short, known("transient").rows[:1], [fault])
    assert examined(plan, "", hunt) == []
    assert list(hunt.seen) == [("transient", state, device, kind)]


def test_cells_that_cannot_be_are_not_counted():
    cells = set(possible())
    assert ("transient", "APPROACH", "stage", "refuse") in cells
    assert ("transient", "SETTLING", "stage", "refuse") not in cells, "nothing is commanded there"
    assert ("transient", "SETTLING", "board", "lose") not in cells, "nothing is listened to there"
    assert ("transient", "SETTLING", "board", "unplug") in cells


def test_the_table_counts_the_states_in_which_a_fault_was_seen():
    hunt = Hunt(
        seen=Counter(
            {("transient", "APPROACH", "stage", "refuse"): 2, ("transient", "HOMING", "loop", "hang"): 1}
        )
    )
    page = hunt.page()
    assert "| transient | stage | unplug 0/8," in page
    assert " refuse 1/4," in page, "of HOMING, STARTING, APPROACH and RETRACTING"
    assert "2 of " in hunt.summary()
