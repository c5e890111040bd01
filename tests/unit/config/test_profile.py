"""Validated profiles, and the refusals of wrong ones."""

import dataclasses
from typing import Any

import pytest

from config import profile as module
from config.source import ProfileError
from config.trials import Trial
from tests.refusals import check_refusal

load_profile: Any = module.load_profile
load_resolved: Any = module.load_resolved
"""What a profile holds depends on its table."""

ARM = {"devices.stage.driver": "ur_arm", "devices.stage.port": "192.0.2.10", "plant.kind": "none"}
BOARD = {"devices.board.driver": "sensor_board", "devices.board.port": "mock"}
MORE = {**BOARD, "signals.near.kind": "scaled"}


def refusal(name="touch.toml", overrides=None, **rows):
    """The lines of a refusal."""
    with pytest.raises(ProfileError) as caught:
        load_profile(name, overrides, **rows)
    return caught.value.problems


def test_a_sound_profile_holds_every_section_with_its_defaults(write):
    profile = load_profile("touch.toml")
    assert (profile.name, profile.title, profile.experiment) == ("touch.toml", "A touch", "touch")
    assert profile.bench == "mock"
    assert profile.devices["stage"].kind == "zaber_stage"
    assert profile.devices["stage"].settings.travel_m == 0.02
    assert profile.detectors["contact"].kind == "resonance.paper"
    assert profile.behavior.settle_s == 90.0
    assert profile.plant.settings.noise_scale == 1.0
    assert profile.faults == ()


def test_a_profile_cannot_be_changed_and_its_hash_follows_the_settings_and_not_the_files(write):
    profile = load_profile("touch.toml")
    with pytest.raises(dataclasses.FrozenInstanceError):
        profile.experiment = "other"
    with pytest.raises(ValueError, match="frozen"):
        profile.limits.force_n = 9.0
    write("same.toml", 'extends = "touch"\n# only a comment\n[limits]\nforce_n = 2')
    write("other.toml", 'extends = "touch"\n[limits]\nforce_n = 2.5')
    hashes = [load_profile(f"{name}.toml").hash for name in ("touch", "same", "other")]
    assert hashes[0] == hashes[1] != hashes[2]
    assert len(hashes[0]) == 64


def test_the_resolved_profile_loads_again_to_the_same_settings(write):
    near = '[signals.near]\nkind = "scaled"\n[detectors.contact]\ninput = "signals.near"'
    write("armed.toml", f'extends = "touch"\n{near}')
    profile = load_profile("armed.toml", {"plant.noise_scale": "0.5", "loop.rate_hz": "none"})
    assert (profile.loop.rate_hz, profile.resolved["loop"]["rate_hz"]) == (None, "none")
    again = load_resolved("manifest.json", profile.resolved)
    assert (again.resolved, again.hash) == (profile.resolved, profile.hash)
    assert (again.plant.settings.noise_scale, again.loop.rate_hz) == (0.5, None)
    assert again.signals["near"].settings.input == "stage.position"
    assert again.detectors["contact"].settings.input == "signals.near"


# --- refusals: file, section, key, what is wrong, what was probably meant ----------------------------


@pytest.mark.parametrize(
    ("setting", "place", "remedy"),
    [
        ("detectors.contact.threshold_sgima=3", "[detectors.contact] threshold_sgima", "'threshold_sigma'"),
        ("limits.force_kg=2", "[limits] force_kg = 2", "force_n = 19.6133"),
        ("limits.force_n=0", "[limits] force_n = 0", "greater than 0, in N"),
        ("limits.force_n=two", '[limits] force_n = "two"', "number, in N"),
        ("limits.force_n=none", '[limits] force_n = "none"', "number, in N"),
        ("limits.force_n=nan", "[limits] force_n = NaN", "finite"),
        ("limits.force_n=07:00:00", '[limits] force_n = "07:00:00"', "number, in N"),
        ("behavior.ready=1", "[behavior] ready = 1", "boolean"),
        ("behavior.direction=foward", '[behavior] direction = "foward"', "did you mean 'forward'"),
        ("behavior.mover=stag", '[behavior] mover = "stag"', "did you mean 'stage'"),
        ("behavior.measures=['boad.load']", 'measures = "boad.load"', "did you mean 'board'"),
        ("behavior.measures=['stage.load']", 'measures = "stage.load"', "known: stage.position"),
        ("devices.stage.driver=zaber_stag", "[devices.stage] driver", "did you mean 'zaber_stage'"),
        ("devices.stage.port=''", '[devices.stage] port = ""', 'write "mock"'),
        ("detectors.contact.kind=resonanse", "[detectors.contact] kind", "did you mean 'resonance'"),
        ("detectors.contakt.kind=8", "[detectors.contakt] kind = 8", "known: level"),
        ("detectors.contakt.sample_hz=5", "[detectors.contakt] kind is missing", "did you mean 'contact'"),
        ("detectors.contakt=none", '[detectors] contakt = "none"', "did you mean 'contact'"),
        ("experiment=tuch", 'experiment = "tuch"', "did you mean 'touch'"),
        ("plant.kind=none", '[plant] kind = "none" on the mock bench', "finger"),
        ("limts.force_n=1", "limts", "did you mean 'limits'"),
        ("limits=3", "limits = 3", "table"),
        ("devices.stage=3", "[devices] stage = 3", "table"),
        ("trials.repeats=0", "[trials] repeats = 0", "greater than or equal to 1"),
        ("trials.list=[]", "trials", "0 trials"),
        ("trials.grid={ plant.noise_scale = [] }", "trials", "0 trials"),
        ("trials.grid={ speed_m_s = [0.001] }", "trials: speed_m_s", "in the list or in the grid"),
        ("trials.order=random", '[trials] order = "random"', "'listed' or 'shuffled'"),
        ("signals.near.input=signals.near", "[signals] near", "circle"),
        ("detectors.contact.input=signals.neat", "[detectors.contact] input", "'near'"),
        ("faults=[{ device = 'stge', kind = 'stll', at_s = 1 }]", "[faults #1] kind", "'stall'"),
        ("faults=[{ device = 'board', kind = 'stall', at_s = 1 }]", "[faults #1] kind", "drift, late, stuck"),
        ("devices.stage.port=/dev/x", '[devices.board] port = "mock"', 'stage at "/dev/x"; write "emulated"'),
        ("devices.signals={ driver = 'zaber_stage', port = 'mock' }", "[devices] signals", "choose another"),
        (
            "devices.detector={ driver = 'zaber_stage', port = 'mock' }",
            "[devices] detector",
            "choose another",
        ),
    ],
)
def test_a_mistake_is_one_line_with_place_mistake_and_remedy(write, setting, place, remedy):
    key, _, value = setting.partition("=")
    check_refusal(refusal(overrides={**MORE, key: value})[0], place, remedy)


@pytest.mark.parametrize(
    ("key", "value", "named"),
    [
        ("limits.force_n", "1" * 5000, ["[limits] force_n = ", "number, in N"]),
        ("limits.force_n", "[" * 2000, ["limits.force_n = [[[", "nested too deep"]),
        ("devices.stage.address", "192.0.2.11", ["[devices.stage] address", "goes into port"]),
        ("plant.kind", "finger", ['[plant] kind = "finger" on the hardware bench', 'write "none"']),
        ("faults", "[{}]", ["faults", "a real bench", "remove"]),
    ],
)
def test_a_mistake_on_a_real_bench_is_one_line_likewise(write, key, value, named):
    check_refusal(refusal(overrides={**ARM, key: value})[0], "--set: ", *named)


def test_the_file_in_the_chain_that_made_the_mistake_is_named(write):
    write("empty.toml", 'extends = "touch"\n[detectors.second]\n')
    check_refusal(refusal("empty.toml")[0], "empty.toml: [detectors.second] kind")
    write("none.toml", 'experiment = "touch"')
    check_refusal(refusal("none.toml")[0], "none.toml: devices is missing", "at least one")
    check_refusal(refusal("bench.toml")[0], "bench.toml: experiment is missing", "a bench alone is there to")
    write("bench.toml", '[devices.stage]\ndriver = "zaber_stage"\nport = "mock"\nspeed = 3')
    check_refusal(refusal()[0], "bench.toml: [devices.stage] speed = 3")


def test_every_mistake_is_listed_in_one_go_and_a_line_break_in_a_name_does_not_break_its_line(write):
    wrong = {"limits.force_n": "-1", "behavior.settle_s": "-1", "plant.noise_scale": "x"}
    assert len(refusal(overrides=wrong)) == 3
    for name in (r"a\nb", r"detectors.a\rb.c", r"a\u2028b"):
        write("broken.toml", f'extends = "touch"\n[trials.grid]\n"{name}" = [1]\n')
        for problem in refusal("broken.toml"):
            check_refusal(problem, name.removesuffix(".c"))


# --- benches and ports -------------------------------------------------------------------------------


def test_the_port_chooses_bench_and_settings_class_and_a_real_one_on_an_emulated_bench_is_known(write):
    profile = load_profile("touch.toml", {"devices.stage.port": "emulated"})
    assert (profile.bench, profile.real_ports) == ("emulated", {})
    assert profile.devices["stage"].settings.baud == 115200
    own = {"devices.stage.port": "emulated", **BOARD, "devices.board.port": "/dev/ttyUSB0"}
    assert load_profile("touch.toml", own).real_ports == {"board": "/dev/ttyUSB0"}
    assert load_profile("touch.toml", ARM).real_ports == {}


def test_a_device_on_a_network_has_its_address_for_a_port(write):
    profile = load_profile("touch.toml", ARM)
    assert profile.devices["stage"].settings.address == "192.0.2.10"
    assert (profile.bench, profile.plant) == ("hardware", None)
    resolved = {"driver": "ur_arm", "port": "192.0.2.10", "patience_s": 1.0}
    assert profile.resolved["devices"]["stage"] == resolved
    assert load_resolved("manifest.json", profile.resolved).hash == profile.hash


def test_a_fault_that_its_device_can_show_is_taken(write):
    faults = '[{ device = "stage", kind = "stall", at_s = 1 }]'
    assert load_profile("touch.toml", {"faults": faults}).faults[0].at_s == 1.0


# --- trials ------------------------------------------------------------------------------------------


def test_a_trials_dotted_factors_lie_over_the_profile_for_that_trial_alone(write):
    grid = "{ plant.noise_scale = [0.5, 2.0] }"
    profile = load_profile("touch.toml", {"trials.grid": grid, "signals.near.kind": "scaled"})
    quiet, loud = (profile.for_trial(trial) for trial in profile.trials(0))
    assert (quiet.plant.settings.noise_scale, loud.plant.settings.noise_scale) == (0.5, 2.0)
    assert profile.plant.settings.noise_scale == 1.0
    assert quiet.limits is profile.limits  # what ten thousand trials do not change is there once
    assert quiet.detectors is profile.detectors
    assert profile.factors_of(profile.trials(0)[0]).speed_m_s == 0.004
    changed = profile.for_trial(Trial(1, {"speed_m_s": 0.004, "signals.near.gamma": 5.0}))
    assert changed.signals["near"].settings.gamma == 5.0


@pytest.mark.parametrize(
    ("row", "named"),
    [
        ("speed_mm_s = 4", ["row 1", "speed_mm_s = 4", "speed_m_s = 0.004"]),
        ("location = 'f'", ["row 1", "speed_m_s is missing", "Speed of the approach"]),
        ("speed_m_s = 4.0", ["row 1", "speed_m_s = 4.0", "less than or equal to 0.05, in m/s"]),
        ("speed_m_s = 0.004, loop.rate_hz = 3", ["row 1", "loop.rate_hz", "a trial may change signals"]),
        ("speed_m_s = 0.004, plant.kind = 'slip'", ["row 1", "plant.kind", "set up once"]),
        ("speed_m_s = 0.004, detectors.contat.sample_hz = 3", ["row 1", "[detectors.contat]", "'contact'"]),
        ("speed_m_s = 0.004, plant.noise_scale = -1", ["row 1", "[plant] noise_scale = -1", "greater than"]),
        ("speed_m_s = [1]", ["[trials.list #1] speed_m_s = [1]", "number, text, true or false"]),
    ],
)
def test_a_mistake_in_a_trial_is_named_with_its_row(write, row, named):
    check_refusal(refusal(overrides={"trials.list": f"[{{ {row} }}]"})[0], "--set: ", *named)


def test_a_mistake_in_the_grid_or_in_rows_from_elsewhere_is_named_there(write):
    first = refusal(overrides={"trials.grid": "{ detectors.contact.sample_hz = [15, -1] }"})[0]
    check_refusal(first, "[detectors.contact] sample_hz = -1", "greater than 0, in Hz")
    first = refusal(rows={"trials.csv: row 2": {"speed_m_s": "fast"}})[0]
    check_refusal(first, "trials.csv: row 2, column speed_m_s", "number, in m/s")
    first = refusal(rows={"row 1": {"plant": {"noise_scale": -1}, "speed_m_s": 0.001}})[0]
    check_refusal(first, "row 1: [plant] noise_scale = -1")


def test_rows_from_elsewhere_take_the_place_of_list_and_grid(write):
    overrides = {"trials.grid": "{ plant.noise_scale = [0.5, 2.0] }", "trials.repeats": "2"}
    rows = {"first": {"speed_m_s": 0.001}, "second": {"speed_m_s": 0.002}}
    profile = load_profile("touch.toml", overrides, rows=rows)
    assert [(trial.id, trial.factors["speed_m_s"], trial.repeat) for trial in profile.trials(0)] == [
        *((1, 0.001, 1), (2, 0.001, 2)),
        *((3, 0.002, 1), (4, 0.002, 2)),
    ]


def test_more_trials_than_a_run_can_have_are_counted_before_they_are_built(write):
    values = "[" + ",".join(str(0.001 + 1e-6 * i) for i in range(400)) + "]"
    grid = "{ speed_m_s = " + values + ", location = " + values + ", plant.noise_scale = " + values + "}"
    (line,) = refusal(overrides={"trials.grid": grid, "trials.list": "[{}]"})
    check_refusal(line, "64000000 trials", "grid of 400 x 400 x 400", "100000")
