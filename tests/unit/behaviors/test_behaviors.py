import math
from typing import Any

import pytest

from behaviors.events import BaselineReady, BaselineRefused, Contact, GuardStopped, Resumed, Tick
from behaviors.first_contact import FirstContactSettings
from behaviors.flexion import Flexion
from behaviors.machine import Behavior, StatePlan, on, trigger_of
from behaviors.static import Static, StaticFactors, StaticSettings
from behaviors.transient import Transient, TransientFactors, TransientSettings
from config.diagrams import PAGE, page
from config.profile import load_profile
from controller.own_modules import found
from controller.registry import EXPERIMENTS
from drivers.core.messages import (
    Excite,
    Failed,
    Home,
    MoveAt,
    MoveTo,
    Reached,
    Refused,
    Stalled,
    Standstill,
    Stop,
)
from tests.unit.behaviors.driving import lead, tell


def transient(detectors=("contact",), **settings):
    return Transient(TransientSettings(**settings), TransientFactors(speed_m_s=0.005), frozenset(detectors))


def contact(t_s, detector="contact"):
    return Contact(t_s, detector, 30.0, 29.0)


def ready(t_s, detector="contact"):
    return BaselineReady(t_s, detector, 28.0, 29.0)


def refused(t_s, detector):
    return BaselineRefused(t_s, detector, 28.0, math.nan, "no variance")


PATH: dict[str, list[Any]] = {
    "HOMING": [],
    "STARTING": [Reached(0.1, "stage", 0.0)],
    "SETTLING": [Reached(0.2, "stage", 0.0)],
    "BASELINE": [Tick(91.0)],
    "APPROACH": [ready(93.0)],
    "STOPPING": [contact(94.0)],
    "HOLDING": [Standstill(94.1, "stage", 0.004)],
    "RETRACTING": [Tick(95.0)],
}


def to(state, detectors=("contact",)):
    return lead(transient(detectors), PATH, state)[0]


def test_a_trial_goes_from_homing_to_done_with_its_commands():
    behavior = transient()
    assert behavior.begin(0.0) == [Excite("board", True), Home("stage")]
    assert behavior.handle(Reached(0.5, "stage", 0.0)) == [MoveTo("stage", 0.0, 0.01)]
    assert behavior.handle(Reached(1.0, "stage", 0.0)) == []
    assert behavior.handle(Tick(90.9)) == []
    assert behavior.state == "SETTLING"
    assert behavior.handle(Tick(91.0)) == []
    assert behavior.state == "BASELINE"
    assert behavior.handle(ready(93.0)) == [MoveAt("stage", 0.005, 0.01)]
    assert behavior.handle(contact(94.0)) == [Stop("stage")]
    assert behavior.handle(Standstill(94.1, "stage", 0.004)) == []
    assert behavior.handle(Tick(94.5)) == [MoveTo("stage", 0.0, 0.01)]
    assert behavior.handle(Reached(95.0, "stage", 0.0)) == [Excite("board", False)]
    assert behavior.done
    assert behavior.outcome == "contact"


@pytest.mark.parametrize("behavior", [found(entry.made) for entry in EXPERIMENTS.values()])
def test_every_state_has_a_deadline_and_something_follows_from_it(behavior):
    for state in behavior.states:
        if state in behavior.final:
            continue
        # Rows with a condition may come before; one without is what follows in any case.
        rows = [row for row in behavior.rows if row.trigger == "deadline" and not row.conditions]
        sources = [source for row in rows for source in row.sources]
        assert sources.count(state) == 1, state


def test_a_behavior_begins_where_its_table_does_and_what_no_state_listens_to_is_named_by_none():
    assert Transient.states[0] == "HOMING"
    assert Transient.final == {"DONE", "FAILED"}
    assert set(Flexion.states) == {*Transient.states, "FLEXING"}
    assert (trigger_of(GuardStopped(0.0, "")), trigger_of(contact(0.0))) == ("guard_stopped", "contact")
    behavior = to("SETTLING")
    assert behavior.plan.detectors == frozenset()
    assert behavior.plan.measures == frozenset()
    assert to("APPROACH").plan.detectors == {"contact"}


def test_a_plan_for_a_state_that_no_row_names_is_refused():
    class Misspelt(Transient):
        def _plan(self):
            return super()._plan() | {"APROACH": StatePlan(1.0)}

    with pytest.raises(AssertionError, match="APROACH"):
        Misspelt(TransientSettings(), TransientFactors(speed_m_s=0.005), frozenset({"contact"}))


def test_another_detectors_contact_does_not_stop_the_approach_and_none_ends_it_at_its_limit():
    behavior = to("APPROACH")
    assert behavior.handle(contact(94.0, "shadow")) == []
    assert behavior.state == "APPROACH"
    assert behavior.handle(Reached(96.0, "stage", 0.01)) == [MoveTo("stage", 0.0, 0.01)]
    behavior.handle(Reached(97.0, "stage", 0.0))
    assert behavior.outcome == "no_contact"


def test_the_approach_waits_for_every_detectors_baseline_and_begins_in_no_contact():
    behavior = to("BASELINE", ("contact", "shadow"))
    assert behavior.handle(ready(93.0)) == []
    assert behavior.handle(ready(102.0, "shadow")) == [MoveAt("stage", 0.005, 0.01)]
    behavior = to("BASELINE", ("contact", "shadow"))
    behavior.handle(ready(93.0))
    assert behavior.handle(contact(95.0)) == [MoveTo("stage", 0.0, 0.01)]
    assert behavior.state == "RETRACTING"


@pytest.mark.parametrize("order", [1, -1])
def test_a_detector_that_only_listens_and_refuses_its_baseline_is_gone_on_without(order):
    behavior = to("BASELINE", ("contact", "shadow"))
    first, last = [ready(93.0), refused(93.0, "shadow")][::order]
    assert behavior.handle(first) == []
    assert behavior.handle(last) == [MoveAt("stage", 0.005, 0.01)]


ACTING = {
    "transient": {"contact"},
    "transient_arm": {"contact"},
    "flexion": {"following"},
    "first_contact": {"contact"},
    "slip": {"touch_fingertip"},
    "pointer": {"touch"},
    "pretouch": set(),
    "touch": {"contact_ours"},
    "objects": {"contact_ours"},
    "centering": {"left_ours", "right_ours", "left_contact", "right_contact"},
    "grasp": {"left_ours", "right_ours", "left_contact", "right_contact", "slip_ours", "load"},
}
"""Detectors that a trial of a profile acts on; of `slip` and `centering` that of the fingertip, and one by our way."""


def first_trial(name):
    profile = load_profile(f"mock/{name}")
    others = ("paper", "flexible_finger", "barrett_finger", "wrist", "dsa")
    trial = next(trial for trial in profile.trials(0) if not {*others} & {*trial.factors.values()})
    made = found(EXPERIMENTS[profile.experiment].made)
    return lambda: made(profile.behavior, profile.factors_of(trial), frozenset(profile.detectors))


FINGER = [Stop("stage"), Excite("board", False)]
SONIC = [Stop("arm"), Stop("gripper"), Excite("audio", False)]
STOPS = {
    **dict.fromkeys(("static", "transient", "flexion", "proximal", "tradeoff"), FINGER),
    **dict.fromkeys(("pretouch", "touch", "objects", "centering", "grasp"), SONIC),
    **{name: [Stop("arm")] for name in ("pointer", "slip")},
    "chirp": [Excite("audio", False)],
    "first_contact": [Stop("stage")],
    "weights": [],
}
"""What a trial commands when it cannot go on."""

ENDINGS: list[tuple[Any, str]] = [
    (Failed(95.0, "board", "the link is gone"), "fault"),
    (Stalled(95.0, "stage", "protective stop"), "fault"),
    (Refused(95.0, "stage", Stop("stage"), "not homed"), "fault"),
    (GuardStopped(95.0, "3 N"), "guard"),
]


@pytest.mark.parametrize("name", STOPS)
def test_what_ends_a_trial_in_any_state_stops_all_that_moves(name):
    made = first_trial(name)
    for state in set(made().states) - made().final:
        for event, outcome in ENDINGS:
            behavior = made()
            behavior.state = state
            assert behavior.handle(event) == STOPS[name], state
            assert (behavior.done, behavior.outcome) == (True, outcome)
            assert event.reason in behavior.reason and getattr(event, "device", "") in behavior.reason


@pytest.mark.parametrize("name", ACTING)
def test_a_baseline_that_is_refused_ends_the_trial_of_a_detector_that_it_acts_on_and_of_no_other(name):
    made = first_trial(name)
    armed = [(state, detector) for state, plan in made().plans.items() for detector in plan.detectors]
    assert ACTING[name] <= {detector for _, detector in armed}
    for state, detector in armed:
        behavior = made()
        behavior.state = state
        behavior.handle(refused(1.0, detector))
        assert behavior.done == (detector in ACTING[name]), (state, detector)


def test_the_refused_baseline_of_what_decides_or_of_what_is_armed_unnamed_ends_the_trial():
    behavior = to("BASELINE")
    assert Stop("stage") in behavior.handle(refused(93.0, "contact"))
    assert (behavior.outcome, behavior.reason) == ("fault", "contact baseline refused: no variance")

    class Mine(Behavior):
        table = (on("deadline", "LISTENING", "DONE"),)

    behavior = Mine({"LISTENING": StatePlan(1.0, frozenset({"mine"}))})
    behavior.begin(0.0)
    behavior.handle(refused(0.5, "mine"))
    assert behavior.outcome == "fault"


def test_a_state_that_outlives_its_deadline_ends_the_trial_and_is_named_with_what_came_and_what_did_not():
    behavior = to("STOPPING")
    assert behavior.handle(Tick(94.0 + 30.0)) == [Stop("stage"), Excite("board", False)]
    said = "STOPPING took longer than 30 s: it waited for standstill of stage; nothing came"
    assert behavior.reason == said
    assert behavior.outcome == "fault", "a mover that does not stop is no matter of the experiment"
    behavior = to("APPROACH")
    assert behavior.handle(Tick(93.0 + 30.0 + 0.01 / 0.005)) == [Stop("stage"), Excite("board", False)]
    assert (behavior.outcome, behavior.done) == ("fault", True), "nor is one that never answers an approach"
    behavior = to("BASELINE", ("contact", "other"))
    tell(behavior, ready(93.0), Tick(125.0))
    assert behavior.reason == (
        "BASELINE took longer than 30 s: it waited for baseline ready or contact of contact, other, stage;"
        " baseline ready of contact came"
    )


@pytest.mark.parametrize("state", ["BASELINE", "APPROACH"])
def test_after_a_pause_it_goes_back_and_takes_a_new_baseline(state):
    behavior = to(state)
    assert behavior.handle(Resumed(100.0)) == [MoveTo("stage", 0.0, 0.01)]
    behavior.handle(Reached(101.0, "stage", 0.0))
    assert behavior.state == "BASELINE", "the finger has settled already"
    assert behavior.handle(ready(103.0)) == [MoveAt("stage", 0.005, 0.01)]


@pytest.mark.parametrize("state", ["STOPPING", "HOLDING", "RETRACTING"])
def test_a_contact_that_was_found_stands_after_a_pause(state):
    behavior = to(state)
    assert behavior.handle(Resumed(100.0)) == [MoveTo("stage", 0.0, 0.01)]
    behavior.handle(Reached(101.0, "stage", 0.0))
    assert behavior.done
    assert behavior.outcome == "contact"


@pytest.mark.parametrize(("condition", "position_m"), [("none", 0.0), ("light", 0.003), ("full", 0.0045)])
def test_static_places_the_probe_by_its_condition(condition, position_m):
    settings = StaticSettings(light_m=0.003, full_m=0.0045)
    behavior: Behavior = Static(settings, StaticFactors(condition=condition), frozenset())
    behavior.begin(0.0)
    tell(behavior, Reached(0.1, "stage", 0.0), Reached(0.2, "stage", 0.0), Tick(89.2))
    assert (behavior.state, behavior.plan.measures) == ("ZEROING", {"board.load_cell"})
    assert behavior.handle(Tick(90.2)) == [MoveTo("stage", position_m, 0.002)]


def test_a_row_that_names_a_method_in_quotes_is_refused_with_its_place():
    for named in ("note", ["note"]):
        with pytest.raises(TypeError, match="on\\('reached', 'HOMING'\\): 'note' is no function"):
            on("reached", "HOMING", "DONE", do=named)
    with pytest.raises(TypeError, match="'from_mover' is no function"):
        on("reached", "HOMING", "DONE", "from_mover")


def test_the_diagrams_in_the_docs_are_those_of_the_tables():
    assert PAGE.read_text(encoding="utf-8") == page(), "run: make diagrams"


@pytest.mark.parametrize("settings", [TransientSettings, FirstContactSettings])
@pytest.mark.parametrize("limit_m", [0.002, 0.001])
def test_an_approach_that_would_go_back_is_refused(settings, limit_m):
    with pytest.raises(
        ValueError,
        match=r"approach_limit_m = .* not beyond start_m = 0.002.*turn the stage round.*approach_axis",
    ):
        settings(start_m=0.002, approach_limit_m=limit_m)
    assert settings(start_m=0.002, approach_limit_m=0.003).approach_limit_m == 0.003


def test_a_nudge_that_leads_to_the_approachs_end_or_beyond_is_refused():
    assert FirstContactSettings(start_m=0.004, nudge_m=0.0009, approach_limit_m=0.005)
    with pytest.raises(ValueError, match=r"nudge_m = 0.001 .*approach_limit_m = 0.005"):
        FirstContactSettings(start_m=0.004, nudge_m=0.001, approach_limit_m=0.005)
