"""Words: outcomes of trials, commands and events as text."""

import ast
import inspect
import sys
from importlib import import_module

import pytest

from behaviors.events import Contact, GuardStopped
from behaviors.machine import Behavior
from controller.outcomes import UNMEASURED, counted, exit_of, is_success
from controller.own_modules import found
from controller.registry import EXPERIMENTS, experiment_of
from controller.scales import as_text
from drivers.core.messages import Excite, Gripped, Listen, MoveAt, MoveTo, Reached, Refused, Sent, Stop


def concluded(behavior):
    """Words that the behavior's classes conclude, as they stand in their sources."""
    words = set()
    for made in behavior.__mro__:
        if not issubclass(made, Behavior) or made is Behavior:
            continue
        for node in ast.walk(ast.parse(inspect.getsource(sys.modules[made.__module__]))):
            if isinstance(node, ast.Call) and ast.unparse(node.func).endswith(("conclude", "concluding")):
                words |= texts(node.args[0])
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "attr", "") == "outcome":
                words |= texts(node.value)
    return words - {*UNMEASURED}


def texts(node):
    return {each.value for each in ast.walk(node) if isinstance(each, ast.Constant)}


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_word_that_a_behavior_concludes_is_declared(name):
    experiment = EXPERIMENTS[name]
    renamed = getattr(import_module(experiment.measures), "RENAMED", {})
    words = {renamed.get(word, word) for word in concluded(found(experiment.made))}
    assert words, "a behavior that concludes nothing"
    assert words - {"no_contact"} <= set(experiment.outcomes)
    assert experiment.successes, "no way to succeed"


def test_no_word_is_success_in_one_experiment_and_failure_in_another():
    meanings = {}
    for experiment in EXPERIMENTS.values():
        for word, success in experiment.outcomes.items():
            meanings.setdefault(word, set()).add(success)
    assert [word for word, meant in meanings.items() if len(meant) > 1] == []
    assert meanings.keys().isdisjoint(UNMEASURED)


@pytest.mark.parametrize("word", UNMEASURED)
def test_a_trial_that_was_broken_off_is_never_success(word):
    assert not is_success(word, None)
    assert not is_success(word, [word])


def test_an_own_experiment_declares_its_words_or_gets_those_of_the_fragments(tmp_path):
    module = "class Tap:\n    pass\nCOLUMNS = ()\ndef measure(*given): ...\n"
    (tmp_path / "silent_tap.py").write_text(module)
    (tmp_path / "told_tap.py").write_text(module + 'OUTCOMES = {"tapped": True, "slid": False}\n')
    silent, told = (experiment_of(f"{name}:Tap", [tmp_path]).successes for name in ("silent_tap", "told_tap"))
    for word, fragments, own in (
        *(("tapped", True, True), ("contact", True, False)),
        *(("no_contact", False, False), ("not_found", False, False), ("slid", True, False)),
    ):
        assert (is_success(word, silent), is_success(word, told)) == (fragments, own), word


def test_the_counts_say_how_many_succeeded_where_not_all_did_and_a_run_in_which_none_did_failed():
    assert counted({"held": 6}, ["held"]) == "held: 6"
    mixed = {"not_found": 1, "held": 4, "fault": 1}
    assert counted(mixed, ["held"]) == "fault: 1, held: 4, not found: 1; 4 of 6 succeeded"
    for outcomes, code in (({"held": 1, "dropped": 5}, 0), ({"dropped": 6}, 1), ({}, 0), ({"held": 6}, 0)):
        assert exit_of({"successes": ["held"], "outcomes": outcomes})[0] == code


MOVE = MoveTo("stage", 0.003, 0.005)


@pytest.mark.parametrize(
    ("message", "text"),
    [
        (MOVE, "stage: move to 3 mm, speed 5 mm/s"),
        (MoveAt("stage", -0.0038, 0.012), "stage: move at −3.8 mm/s, limit 12 mm"),
        (Stop("stage"), "stage: stop"),
        (Excite("board", on=False), "board: excite, off"),
        (Listen("board", frozenset({"board.b", "board.a"})), "board: listen, board.a, board.b"),
        (Sent(1.0, "stage", MOVE), "stage: sent “move to 3 mm, speed 5 mm/s”"),
        (Refused(1.0, "stage", MOVE, "not homed"), "stage: refused “move to 3 mm, speed 5 mm/s”, not homed"),
        (Reached(1.0, "stage", 0.0031234), "stage: reached, position 3.123 mm"),
        (Gripped(1.0, "hand", True, 0.02, 1.5), "hand: gripped, object, width 20 mm, force 1.5 N"),
        (Contact(1.0, "ours", 28.71, 28.6), "ours: contact, value 28.71, threshold 28.6"),
        (GuardStopped(1.0, "force 2.1 N above 2 N"), "guard stopped, force 2.1 N above 2 N"),
    ],
)
def test_commands_and_events_are_text_with_units(message, text):
    assert as_text(message) == text
