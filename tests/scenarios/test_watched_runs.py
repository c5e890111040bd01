"""A run that is watched is the run that it would have been."""

import json
import os
import socket
from contextlib import closing
from pathlib import Path

import pytest

from config.assemble import build_rig, plan_campaign
from config.profile import load_profile
from config.script import run_trials
from controller.by_hand import HandResult
from controller.campaign import EXIT_DONE, Campaign
from controller.console import Console, ConsoleOperator
from controller.reports.run_account import facts_of
from controller.watching.feed import SOCKET, Watched, at
from controller.watching.page import after, trial_signals
from tests.scenarios.conftest import QUICK, SHORTER


def rows(out, watchers):
    """The rows of a run of two trials with so many clients that never read."""
    profile = load_profile("mock/transient", QUICK)
    plan = plan_campaign(profile, profile.trials(0)[:2], 0)
    deaf = [socket.socket(socket.AF_UNIX) for _ in range(watchers)]

    def began(folder):
        for each in deaf:
            with at(folder / SOCKET) as name:
                each.connect(name)

    with Path(os.devnull).open() as keyboard, closing(build_rig(profile)) as rig:
        console = Console()
        Watched(console, ConsoleOperator(keyboard), began)
        outcome = Campaign(plan, rig, console, out).run()
    for each in deaf:
        each.close()
    assert (outcome.exit_code, outcome.error) == (0, None)
    assert not (outcome.folder / SOCKET).exists()
    assert after(outcome.folder) | {"folder": "", "reason": ""} == {
        "status": "done",
        "code": 0,
        "reason": "",
        "folder": "",
        "report": False,
    }
    signals = trial_signals(outcome.folder, plan.left[0].id)["signals"]
    assert next(iter(signals)).startswith("detector."), "what decides comes first"
    assert all(len(each["t"]) == len(each["y"]) > 1 for each in signals.values())
    return (outcome.folder / "trials.csv").read_bytes()


def test_rows_are_the_same_with_clients_that_do_not_read(tmp_path):
    assert rows(tmp_path / "alone", 0) == rows(tmp_path / "watched", 3)


class Person(Console):
    """Holds the run after its first trial, acts there as the page does, and goes on."""

    def __init__(self, operator, acts):
        super().__init__(operator)
        self.acts, self.refused, self.watched = list(acts), [], None

    def poll(self):
        news = self.watched.between.news()
        if news["offer"] and not news["doing"]:
            self.act(self.acts.pop(0) if self.acts else {"do": "resume"})
        return super().poll()

    def trial_started(self, *about):
        super().trial_started(*about)
        for act in ({"do": "home", "target": "stage"}, {"do": "hold"}):
            self.act(act)

    def act(self, act):
        self.refused.append(self.watched.receive(json.dumps(act).encode()))


def held(out, acts, name="mock/transient", quick=QUICK):
    profile = load_profile(name, quick)
    plan = plan_campaign(profile, profile.trials(0)[:2], 0)
    with Path(os.devnull).open() as keyboard, closing(build_rig(profile)) as rig:
        operator = ConsoleOperator(keyboard)
        person = Person(operator, acts)
        person.watched = Watched(person, operator)
        outcome = Campaign(plan, rig, person, out).run()
    return outcome, person.refused, json.loads((outcome.folder / "manifest.json").read_text("utf-8"))


def test_between_two_trials_a_mover_goes_home_and_a_force_is_tared_and_the_rows_stay(tmp_path):
    acts = [
        {"do": "home", "target": "stage"},
        {"do": "tare", "target": "stage"},
        {"do": "tare", "target": "board.load_cell"},
    ]
    outcome, refused, manifest = held(tmp_path / "held", acts)
    assert outcome.exit_code == 0
    second = 2 + len(acts) + 1  # what was answered before the second trial
    assert [line.partition(":")[0] for line in refused[:second]] == ["home", "", "", "tare", "", ""]
    assert "a trial runs" in refused[0]
    assert "board.load_cell" in refused[3], "what can be tared"
    assert [(note["did"], note["outcome"]) for note in manifest["by_hand"]] == [
        ("home stage", "done"),
        ("tare board.load_cell", "done"),
    ]
    assert (outcome.folder / "trials.csv").read_bytes() == rows(tmp_path / "alone", 0)


def test_a_hold_says_whether_it_holds_however_often_it_is_sent():
    watched = Watched(Console(), ConsoleOperator())
    watched.between.possible = True
    seen = []
    for message in ('{"do": "hold"}', '{"do": "hold", "on": true}', '{"do": "hold", "on": false}') * 2:
        assert watched.receive(message.encode()) == ""
        assert watched.receive(message.encode()) == ""
        seen.append(watched.between.hold)
    assert seen == [True, True, False] * 2


def test_a_bench_whose_guard_watches_a_computed_signal_is_tared_and_goes_home_between_trials(tmp_path):
    acts = [{"do": "tare", "target": "arm.force"}, {"do": "home", "target": "arm"}]
    outcome, refused, manifest = held(tmp_path, acts, "mock/pointer", SHORTER["mock/pointer"])
    assert [(note["did"], note["outcome"]) for note in manifest["by_hand"]] == [
        ("tare arm.force", "done"),
        ("home arm", "done"),
    ], (outcome.line, refused)
    assert outcome.exit_code == 0


@pytest.mark.parametrize(
    ("act", "result", "code"),
    [
        ("home", HandResult("fault", "stage: does not answer"), 3),
        ("home", HandResult("guard", "guard: force", not_at_rest=["stage"]), 4),
        ("home", HandResult("interrupted", ""), 130),
        ("stop", None, 130),
    ],
)
def test_what_ends_badly_by_hand_ends_the_run_before_the_next_trial(tmp_path, monkeypatch, act, result, code):
    monkeypatch.setattr("controller.by_hand.home", lambda *_: result)
    outcome, _, manifest = held(tmp_path, [{"do": act, "target": "stage"}])
    assert outcome.exit_code == code
    assert list(outcome.not_at_rest) == list(result.not_at_rest if result else [])
    assert result is None or result.reason in outcome.line
    assert sum(manifest["outcomes"].values()) == 1


def one_approach(out, clocks="watched"):
    row = {"side": "normal", "speed_m_s": 0.03, "object": "pipe"}
    settings = {"signals.right.clocks": clocks}
    return run_trials("mock/pretouch", [row], settings=settings, seed=1, out=out, say=lambda line: None)


def test_one_clock_stands_in_manifest_and_report_and_in_no_warning(tmp_path):
    outcome, run = one_approach(tmp_path)
    assert outcome.exit_code == EXIT_DONE
    assert run.manifest["signals"].keys() == {"right"}
    assert abs(run.manifest["signals"]["right"]["drift_ppm"]) < 0.01
    assert "ppm" not in outcome.line
    assert any("drift_ppm" in text for _, text in facts_of(run))


def test_two_clocks_that_were_taken_for_one_are_reported_in_the_last_line(tmp_path, monkeypatch):
    monkeypatch.setattr("controller.signals.iq.DRIFT_MAX_PPM", 0.0)
    slow = "its clock is too slow; raise max_drift_ppm"
    monkeypatch.setattr(
        "drivers.core.wire.Driver.account", lambda device: {"warning": f"{device.name}: {slow}"}
    )
    outcome, run = one_approach(tmp_path)
    assert outcome.exit_code == EXIT_DONE
    assert 'set clocks = "tracked", or use one card for both' in outcome.line
    assert outcome.line.count("ppm apart") == 1
    assert run.manifest["signals"]["right"]["warning"] in outcome.line
    links = [found["link"] for found in run.manifest["devices"].values()]
    warned = [link["warning"] for link in links if "warning" in link]
    assert warned
    assert all(warning in outcome.line for warning in warned), "a device's own clock likewise"


def test_without_a_request_nothing_is_reported(tmp_path):
    _, run = one_approach(tmp_path, "locked")
    assert run.manifest["signals"] == {}
