"""Pauses of the sonic fingers, and sweeps from files."""

import json
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from behaviors.aura import Aura
from behaviors.centering import Centering
from config import assemble
from config.profile import load_profile
from controller.campaign import EXIT_DONE, EXIT_FAILED, Campaign
from controller.recording.reader import open_run

SLOWLY = {"loop.rate_hz": "50.0"}

PAUSE_AFTER = 8
"""Turns from a state's beginning to the pause: the arm is under way by then."""

START_X_M = 0.4
"""Base frame: devices.arm.start_pose of mock/bench_aura."""


def run_one(out, operator, name, row, code=EXIT_DONE, **sets):
    profile = load_profile(name, SLOWLY | {"trials.repeats": "1"} | sets, rows={"the trial": row})
    plan = assemble.plan_campaign(profile, profile.trials(0), 1)
    rig = replace(assemble.build_rig(profile), ahead=None)  # turn by turn: the operator counts them
    outcome = Campaign(plan, rig, operator, out).run()
    assert outcome.exit_code == code, outcome.line
    return open_run(outcome.folder)


def pause_everywhere(script, behavior):
    requests = {state: [None] * PAUSE_AFTER + ["pause"] for state in behavior.states}
    script.requests = requests | {"PAUSED": ["resume"] * 100}


def paused_in(script):
    return {before for before, state in pairwise(name for name, _ in script.seen) if state == "PAUSED"}


def alive(behavior):
    return set(behavior.states) - {"DONE", "FAILED"}


def test_a_touch_that_is_paused_everywhere_is_made_and_goes_no_deeper_than_its_path(tmp_path, script):
    pause_everywhere(script, Aura)
    row = {"side": "back", "speed_m_s": 0.01}
    run = run_one(tmp_path, script, "mock/touch", row, **{"behavior.cycles": "2"})
    assert paused_in(script) >= alive(Aura) - {"STOPPING"}, "it stands within fewer turns"
    (measured,) = run.trials
    assert (measured["outcome"], measured["approaches"]) == ("contact", 2), measured
    assert measured["felt_ours"] == measured["touches"] >= 2, measured
    assert run.trial(1).stream("arm.pose").values[:, 0].max() < START_X_M + 0.0565 + 1e-4


def test_a_search_that_is_paused_everywhere_finds_the_middle_and_touches_nothing(tmp_path, script):
    pause_everywhere(script, Centering)
    row = {"object_x_m": 0.006, "speed_m_s": 0.03, "method": "ours"}
    (measured,) = run_one(tmp_path, script, "mock/centering", row, code=EXIT_FAILED).trials
    braking = {"REVERSING", "TURNING", "STOPPING"}
    after_a_grip_that_was_not_broken_off = {"CONFIRMING", "HOLDING", "BACKING_OFF"}
    turned = {"HALF_TURN"}
    assert paused_in(script) >= alive(Centering) - braking - turned - after_a_grip_that_was_not_broken_off
    assert measured["outcome"] == "not_gripped", "a pause broke the grip off"
    assert measured["touched"] == 0
    assert abs(measured["error_m"]) < 0.0032, "docs: the level crossing of the matched filter"


def test_a_grip_that_was_confirmed_stands_after_a_pause(tmp_path, script):
    script.requests = {"HOLDING": ["pause"], "PAUSED": ["resume"]}
    row = {"object_x_m": 0.006, "speed_m_s": 0.03, "method": "ours"}
    (measured,) = run_one(tmp_path, script, "mock/centering", row).trials
    names = [name for name, _ in script.seen]
    after = names[names.index("PAUSED") + 1 :]
    assert after == ["HOLDING", "RELEASING", "LEAVING", "DONE"]
    assert measured["outcome"] == "centered"


@pytest.fixture
def pair(tmp_path):
    """Two transducers face to face, in kilohertz, as an oscilloscope's user writes it down."""
    f_khz = np.linspace(39.0, 42.0, 31)
    detuned = [q * (f_khz / f0 - f0 / f_khz) for f0, q in ((40.2, 40.0), (40.7, 40.0))]
    volts = 12.0 / np.sqrt((1.0 + detuned[0] ** 2) * (1.0 + detuned[1] ** 2))
    path = tmp_path / "pair.dat"
    np.savetxt(path, np.column_stack([f_khz, volts]), fmt="%.1f", header="two transducers, face to face")
    return path


def test_a_sweep_in_kilohertz_without_names_gives_figures_and_a_picture(verb, pair, tmp_path):
    code, out, err = verb("sweep", pair, "--plot", tmp_path / "pair.png")
    found = json.loads(out)
    assert code == 0
    assert "31 points, 39 to 42 kHz, amplitude; taken for kHz" in err
    assert found["peak_hz"] == pytest.approx(40_450.0, abs=100.0)
    assert [one["frequency_hz"] for one in found["resonances"]] == pytest.approx(
        [40_200.0, 40_700.0], abs=50.0
    )
    assert (tmp_path / "pair.png").stat().st_size > 10_000


PUBLIC_PAIR = """
    39.0 1.6  39.2 2.2  39.5 3.8  39.7 5.8  39.8 7.0  39.9 8.2  40.0 9.3  40.1 10.1  40.2 10.7  40.3 11.3  40.4 11.6
    40.5 11.6  40.6 10.9  40.7 9.6  40.8 8.2  40.9 6.9  41.0 5.8  41.2 4.3  41.5 3.1  41.7 2.7  42.0 2.3  42.5 1.3"""
"""kHz and V of two cheap transducers, taped together (J. Desbonnet, LPC824_Ultrasonic_Ranger, 2017)."""


def test_a_pair_that_was_measured_has_its_peak_its_sharpness_and_two_resonances(verb, tmp_path):
    path = tmp_path / "public.dat"
    np.savetxt(path, np.array(PUBLIC_PAIR.split(), float).reshape(22, 2))
    _, out, _ = verb("sweep", path)
    found = json.loads(out)
    assert 40_400.0 <= found["peak_hz"] <= 40_500.0
    assert found["q"] == pytest.approx(45.0, abs=1.0)
    assert [one["frequency_hz"] for one in found["resonances"]] == pytest.approx([40_100, 40_600], abs=50.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--span", "50000:60000"], "no frequency from 50000 to 60000 Hz"),
        (["--column", "0"], "two columns, frequency and response"),
        (["--plot", "pair.gif"], "is no picture"),
    ],
)
def test_a_mistake_is_one_line(verb, pair, arguments, message):
    code, _, err = verb("sweep", pair, *arguments)
    assert code == 2
    assert message in err.splitlines()[-1]
