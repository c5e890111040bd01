"""Validated profiles, and the messages for wrong ones."""

import dataclasses
from typing import Any

import pytest

from config import profile as module
from config.source import ProfileError
from config.trials import Trial

load_profile: Any = module.load_profile
load_resolved: Any = module.load_resolved
"""What a profile holds depends on its table."""


def refusal(name="touch.toml", overrides=None, **rows):
    with pytest.raises(ProfileError) as caught:
        load_profile(name, overrides, **rows)
    return caught.value.problems


def test_a_sound_profile_holds_every_section_with_its_defaults(write):
    profile = load_profile("touch.toml")
    assert (profile.name, profile.title, profile.experiment, profile.bench) == (
        "touch.toml",
        "A touch",
        "touch",
        "mock",
    )
    assert profile.devices["stage"].kind == "zaber_stage"
    assert profile.devices["stage"].settings.travel_m == 0.02
    assert profile.detectors["contact"].kind == "resonance.paper"
    assert profile.behavior.settle_s == 90.0
    assert profile.plant.settings.noise_scale == 1.0
    assert profile.faults == ()


def test_a_profile_cannot_be_changed(write):
    profile = load_profile("touch.toml")
    with pytest.raises(dataclasses.FrozenInstanceError):
        profile.experiment = "other"
    with pytest.raises(ValueError, match="frozen"):
        profile.limits.force_n = 9.0


def test_an_override_wins_over_every_file(write):
    assert load_profile("touch.toml", {"limits.force_n": "1.5"}).limits.force_n == 1.5


def test_the_resolved_profile_loads_again_to_the_same_settings(write):
    profile = load_profile("touch.toml", {"plant.noise_scale": "0.5"})
    again = load_resolved("manifest.json", profile.resolved)
    assert again.resolved == profile.resolved
    assert again.hash == profile.hash
    assert again.plant.settings.noise_scale == 0.5


def test_the_hash_follows_the_settings_and_not_the_files(write):
    write("same.toml", 'extends = "touch"\n# only a comment\n[limits]\nforce_n = 2')
    write("other.toml", 'extends = "touch"\n[limits]\nforce_n = 2.5')
    hashes = [load_profile(f"{name}.toml").hash for name in ("touch", "same", "other")]
    assert hashes[0] == hashes[1] != hashes[2]
    assert len(hashes[0]) == 64


def test_none_is_text_where_a_setting_can_be_none_and_survives_the_manifest(write):
    profile = load_profile("touch.toml", {"loop.rate_hz": "none"})
    assert profile.loop.rate_hz is None
    assert profile.resolved["loop"]["rate_hz"] == "none"
    assert load_resolved("manifest.json", profile.resolved).loop.rate_hz is None
    assert refusal(overrides={"limits.force_n": "none"})[0].endswith("must be a number, in N")


# --- mistakes: file, section, key, what is wrong, what was probably meant ---------------------------


@pytest.mark.parametrize(
    ("overrides", "line"),
    [
        (
            {"detectors.contact.threshold_sgima": "3"},
            "--set: [detectors.contact] threshold_sgima = 3: unknown key; did you mean 'threshold_sigma'?",
        ),
        (
            {"limits.force_kg": "2"},
            "--set: [limits] force_kg = 2: unknown key; SI is meant: force_n = 19.6133",
        ),
        (
            {"behavior.settle_ms": "500"},
            "--set: [behavior] settle_ms = 500: unknown key; SI is meant: settle_s = 0.5",
        ),
        ({"limits.force": "2"}, "--set: [limits] force = 2: unknown key; did you mean 'force_n'?"),
        ({"limits.force_n": "0"}, "--set: [limits] force_n = 0: must be > 0 and <= 10 N"),
        ({"limits.force_n": "20.5"}, "--set: [limits] force_n = 20.5: must be > 0 and <= 10 N"),
        ({"limits.force_n": "two"}, '--set: [limits] force_n = "two": must be a number, in N'),
        ({"limits.force_n": "true"}, "--set: [limits] force_n = true: must be a number, in N"),
        (
            {"detectors.contact.average_samples": "2.5"},
            "--set: [detectors.contact] average_samples = 2.5: must be a whole number",
        ),
        ({"behavior.ready": "1"}, "--set: [behavior] ready = 1: must be true or false"),
        (
            {"behavior.direction": "foward"},
            "--set: [behavior] direction = \"foward\": must be 'forward' or 'backward'; did you mean",
        ),
        ({"behavior.measures": "3"}, "--set: [behavior] measures = 3: must be a list"),
        (
            {"behavior.mover": "stag"},
            "--set: [behavior] mover = \"stag\": no device 'stag'; did you mean 'stage'?",
        ),
        (
            {"behavior.measures": '["boad.load"]'},
            "--set: [behavior] measures = \"boad.load\": no device 'boad'; known: stage",
        ),
        (
            {"devices.stage.driver": "zaber_stag"},
            "--set: [devices.stage] driver = \"zaber_stag\": unknown driver; did you mean 'zaber_stage'?",
        ),
        ({"devices.stage.port": '""'}, '--set: [devices.stage] port = "": write "mock"'),
        (
            {"detectors.contact.kind": "resonanse"},
            "--set: [detectors.contact] kind = \"resonanse\": unknown kind; did you mean 'resonance'",
        ),
        ({"detectors.contakt.kind": "8"}, "--set: [detectors.contakt] kind = 8: must be a text"),
        ({"experiment": "tuch"}, "--set: experiment = \"tuch\": unknown experiment; did you mean 'touch'?"),
        ({"plant.kind": "fingr"}, "--set: [plant] kind = \"fingr\": unknown kind; did you mean 'finger'?"),
        (
            {"plant.kind": "none"},
            "--set: [plant] kind is missing: which physics does the mock bench have (finger)?",
        ),
        ({"limts.force_n": "1"}, "did you mean 'limits'?"),
        ({"limits": "3"}, "--set: limits = 3: must be a table, under [limits]"),
        ({"devices.stage": "3"}, "--set: [devices] stage = 3: must be a table, under [devices.stage]"),
        ({"title": "3"}, "--set: title = 3: must be a text"),
        ({"faults": "3"}, "--set: faults = 3: must be tables, each under [[faults]]"),
        ({"trials.repeats": "0"}, "--set: [trials] repeats = 0: must be >= 1 and <= 10000"),
        ({"trials.list": "[]"}, "--set: [trials] list is empty: there is nothing to run"),
        (
            {"trials.grid": "{ plant.noise_scale = [] }"},
            "--set: [trials] grid is empty: there is nothing to run",
        ),
        ({"trials.order": "random"}, "--set: [trials] order = \"random\": must be 'listed' or 'shuffled'"),
    ],
)
def test_a_mistake_is_one_line_with_place_mistake_and_remedy(write, overrides, line):
    first = refusal(overrides=overrides)[0]
    assert first.startswith(line) or first.endswith(line)
    assert "\n" not in first


def test_the_file_in_the_chain_that_made_the_mistake_is_named(write):
    stage = '[devices.stage]\ndriver = "zaber_stage"\nport = "mock"\nspeed = 3\n'
    write("bench.toml", f'{stage}[plant]\nkind = "finger"')
    assert refusal()[0].startswith("bench.toml: [devices.stage] speed = 3: unknown key")


def test_a_misspelt_table_is_named_with_the_one_beside_it(write):
    problems = refusal(overrides={"detectors.contakt.average_samples": "5"})
    assert problems == ("--set: [detectors.contakt] kind is missing; did you mean 'contact'?",)


def test_every_mistake_is_listed_in_one_go(write):
    problems = refusal(
        overrides={"limits.force_n": "-1", "behavior.settle_s": "-1", "plant.noise_scale": "x"}
    )
    assert len(problems) == 3


def test_a_bench_alone_is_no_experiment(write):
    assert refusal("bench.toml")[0].startswith("bench.toml: experiment is missing: which of touch?")


def test_a_profile_without_devices_is_refused(write):
    write("empty.toml", 'experiment = "touch"')
    assert refusal("empty.toml")[0] == "empty.toml: devices is missing: a bench has at least one device"


def test_mock_and_real_ports_cannot_be_mixed(write):
    overrides = {"devices.board.driver": "sensor_board", "devices.board.port": "/dev/ttyUSB0"}
    (only,) = refusal(overrides=overrides)
    assert only.startswith(
        'bench.toml: [devices.stage] port = "mock": virtual time cannot be shared with board'
    )
    assert 'write "emulated"' in only


def test_on_an_emulated_bench_a_real_port_is_known(write):
    emulated = {"devices.stage.port": "emulated"}
    assert load_profile("touch.toml", emulated).real_ports == {}
    own = {**emulated, "devices.board.driver": "sensor_board", "devices.board.port": "/dev/ttyUSB0"}
    assert load_profile("touch.toml", own).real_ports == {"board": "/dev/ttyUSB0"}
    assert load_profile("touch.toml", ARM).real_ports == {}


def test_the_port_chooses_the_settings_class(write):
    profile = load_profile("touch.toml", {"devices.stage.port": "emulated"})
    assert profile.bench == "emulated"
    assert profile.devices["stage"].settings.baud == 115200


ARM = {"devices.stage.driver": "ur_arm", "devices.stage.port": "192.0.2.10", "plant.kind": "none"}


def test_a_device_on_a_network_has_its_address_for_a_port(write):
    profile = load_profile("touch.toml", ARM)
    assert profile.devices["stage"].settings.address == "192.0.2.10"
    assert profile.bench == "hardware"
    assert profile.resolved["devices"]["stage"] == {
        "driver": "ur_arm",
        "port": "192.0.2.10",
        "patience_s": 1.0,
    }
    assert load_resolved("manifest.json", profile.resolved).hash == profile.hash


def test_an_address_beside_the_port_is_refused(write):
    assert refusal(overrides={**ARM, "devices.stage.address": "192.0.2.11"}) == (
        '--set: [devices.stage] address = "192.0.2.11": goes into port = "…"',
    )


def test_a_real_bench_has_neither_plant_nor_faults(write):
    write("real.toml", 'extends = "touch"\n[devices.stage]\nport = "/dev/ttyUSB0"')
    assert refusal("real.toml")[0].startswith(
        'bench.toml: [plant] kind = "finger": a real bench has no plant'
    )
    write("real.toml", 'extends = "touch"\n[devices.stage]\nport = "/dev/ttyUSB0"\n[plant]\nkind = "none"')
    assert load_profile("real.toml").plant is None
    fault = '[{ device = "stage", kind = "stall", at_s = 1 }]'
    assert refusal("real.toml", {"faults": fault})[0].startswith(
        "--set: faults: a real bench breaks by itself"
    )


def test_faults_are_validated_one_by_one(write):
    faults = '[{ device = "stage", kind = "stall", at_s = 1 }, { device = "stge", kind = "stll", at_s = 1 }]'
    problems = refusal(overrides={"faults": faults})
    assert problems[0].startswith("--set: [faults #2] kind = \"stll\": must be 'unplug' or 'stall'")
    sound = '[{ device = "stage", kind = "stall", at_s = 1 }]'
    assert load_profile("touch.toml", {"faults": sound}).faults[0].at_s == 1.0


# --- trials ------------------------------------------------------------------------------------------


def test_a_trials_dotted_factors_lie_over_the_profile_for_that_trial_alone(write):
    profile = load_profile("touch.toml", {"trials.grid": "{ plant.noise_scale = [0.5, 2.0] }"})
    quiet, loud = (profile.for_trial(trial) for trial in profile.trials(0))
    assert (quiet.plant.settings.noise_scale, loud.plant.settings.noise_scale) == (0.5, 2.0)
    assert profile.plant.settings.noise_scale == 1.0
    assert quiet.limits == profile.limits


def test_a_trials_own_factors_are_validated_settings(write):
    profile = load_profile("touch.toml")
    assert profile.factors_of(profile.trials(0)[0]).speed_m_s == 0.004


@pytest.mark.parametrize(
    ("rows", "line"),
    [
        ("[{ speed_mm_s = 4 }]", "speed_mm_s = 4: unknown key; SI is meant: speed_m_s = 0.004"),
        ("[{ location = 'f' }]", "--set: [trials] list row 1: speed_m_s is missing: Speed of the approach"),
        (
            "[{ speed_m_s = 0.004 }, { speed_m_s = 4.0 }]",
            "--set: [trials] list row 2: speed_m_s = 4.0: must be > 0 and <= 0.05 m/s",
        ),
        (
            "[{ speed_m_s = 0.004, loop.rate_hz = 3 }]",
            "--set: [trials] list row 1: loop.rate_hz: not for a trial to change; a trial may change",
        ),
        (
            "[{ speed_m_s = 0.004, detectors.contat.sample_hz = 3 }]",
            "list row 1: detectors.contat.sample_hz: no detector 'contat'; did you mean 'contact'?",
        ),
        (
            "[{ speed_m_s = 0.004, plant.noise_scale = -1 }]",
            "--set: [trials] list row 1: [plant] noise_scale = -1: must be >= 0",
        ),
        (
            "[{ speed_m_s = [1] }]",
            "--set: [trials.list #1] speed_m_s = [1]: must be a number, text, true or false",
        ),
    ],
)
def test_a_mistake_in_a_trial_is_named_with_its_row(write, rows, line):
    assert line in refusal(overrides={"trials.list": rows})[0]


def test_a_mistake_in_the_grid_is_named_there(write):
    first = refusal(overrides={"trials.grid": "{ detectors.contact.sample_hz = [15, -1] }"})[0]
    assert first.endswith("[detectors.contact] sample_hz = -1: must be > 0 and <= 1000 Hz")


def test_a_factor_is_listed_or_crossed_but_not_both(write):
    first = refusal(overrides={"trials.grid": "{ speed_m_s = [0.001] }"})[0]
    assert first == "--set: [trials.grid] speed_m_s: is in the list too; a factor is either listed or crossed"


def test_rows_from_elsewhere_take_the_place_of_list_and_grid(write):
    overrides = {"trials.grid": "{ plant.noise_scale = [0.5, 2.0] }", "trials.repeats": "2"}
    profile = load_profile("touch.toml", overrides, rows=[{"speed_m_s": 0.001}, {"speed_m_s": 0.002}])
    assert profile.trials(0) == [
        Trial(1, {"speed_m_s": 0.001}, 1),
        Trial(2, {"speed_m_s": 0.001}, 2),
        Trial(3, {"speed_m_s": 0.002}, 1),
        Trial(4, {"speed_m_s": 0.002}, 2),
    ]


def test_a_mistake_in_rows_from_elsewhere_is_named_with_their_label(write):
    first = refusal(rows=[{"speed_m_s": "fast"}], labels=["trials.csv: row 2"])[0]
    assert first == 'trials.csv: row 2, column speed_m_s = "fast": must be a number, in m/s'
    first = refusal(rows=[{"plant": {"noise_scale": -1}, "speed_m_s": 0.001}])[0]
    assert first == "row 1: [plant] noise_scale = -1: must be >= 0"


def test_a_detector_may_use_a_signal(write):
    write(
        "armed.toml",
        """
extends = "touch"
[signals.near]
kind = "scaled"
input = "stage.position"
[detectors.contact]
input = "signals.near"
""",
    )
    profile = load_profile("armed.toml")
    assert profile.signals["near"].settings.input == "stage.position"
    assert profile.detectors["contact"].settings.input == "signals.near"
    assert load_resolved("again", profile.resolved).hash == profile.hash


def test_a_signal_that_is_not_there_is_named(write):
    write(
        "armed.toml",
        """
extends = "touch"
[signals.near]
kind = "scaled"
[detectors.contact]
input = "signals.neat"
""",
    )
    (problem,) = refusal("armed.toml")
    assert "[detectors.contact] input = 'signals.neat': no signal 'neat'" in problem.replace('"', "'")
    assert "near" in problem


def test_no_device_may_bear_the_name_of_the_signals(write):
    write(
        "odd.toml",
        """
extends = "touch"
[devices.signals]
driver = "zaber_stage"
port = "mock"
""",
    )
    assert "the name is taken" in refusal("odd.toml")[0]


def test_a_trial_may_change_a_signal(write):
    write(
        "armed.toml",
        """
extends = "touch"
[signals.near]
kind = "scaled"
""",
    )
    profile = load_profile("armed.toml")
    changed = profile.for_trial(Trial(1, {"speed_m_s": 0.004, "signals.near.gamma": 5.0}))
    assert changed.signals["near"].settings.gamma == 5.0


def test_a_fault_that_its_device_never_shows_is_refused_with_those_that_it_does(write):
    board = '[{ device = "board", kind = "stall", at_s = 1 }]'
    more = {"devices.board.driver": "sensor_board", "devices.board.port": "mock"}
    (message,) = refusal(overrides={**more, "faults": board})
    assert message == '--set: [faults #1] kind = "stall": board never shows it; it can show unplug'
    shown = board.replace("stall", "unplug")
    assert load_profile("touch.toml", {**more, "faults": shown}).faults[0].kind == "unplug"


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("limits.force_n", "07:00:00", "--set: limits.force_n = 07:00:00: is a date or a time of day"),
        ("limits.force_n", "nan", "--set: limits.force_n = nan: must be finite"),
        ("limits.force_n", "1" * 5000, "--set: [limits] force_n = "),
        (
            "limits.force_n",
            "[" * 2000,
            "--set: limits.force_n = [[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[...: tables",
        ),
        (
            "trials.list",
            '[{ speed_m_s = 0.004, plant.kind = "slip" }]',
            "--set: [trials] list row 1: plant.kind: ",
        ),
    ],
)
def test_what_no_setting_can_be_is_refused_in_one_line(write, key, value, message):
    (line,) = refusal(overrides={key: value})
    assert line.startswith(message)
    assert "\n" not in line


def test_more_trials_than_a_run_can_have_are_counted_before_they_are_built(write):
    values = "[" + ",".join(str(0.001 + 1e-6 * i) for i in range(400)) + "]"
    grid = "{ speed_m_s = " + values + ", location = " + values + ", plant.noise_scale = " + values + "}"
    (line,) = refusal(overrides={"trials.grid": grid, "trials.list": "[{}]"})
    assert (
        "64000000 trials (list of 1, grid of 400 x 400 x 400, 1 repeats): a run has 100000 at the most"
        in line
    )


def test_a_name_that_no_file_system_holds_is_no_profile():
    with pytest.raises(ProfileError, match=r"no profile 'aaaaaaaa.*\.\.\.'"):
        load_profile("a" * 300)


def test_a_file_with_a_byte_order_mark_is_read(write):
    write("marked.toml", "\ufeff" + 'extends = "touch"\n[limits]\nforce_n = 1.5\n')
    assert load_profile("marked.toml").limits.force_n == 1.5


def test_a_line_break_in_a_name_does_not_break_the_line_of_the_error(write):
    for name, shown in (
        (r"a\nb", r"a\nb"),
        (r"detectors.a\rb.c", r"detectors.a\rb.c"),
        (r"a\u2028b", r"a\u2028b"),
    ):
        write("broken.toml", f'extends = "touch"\n[trials.grid]\n"{name}" = [1]\n')
        for problem in refusal("broken.toml"):
            assert len(problem.splitlines()) == 1
            assert shown in problem


def test_a_file_that_is_nested_too_deep_is_refused(write):
    write("deep.toml", "a = " + "[" * 3000)
    assert refusal("deep.toml")[0].startswith("deep.toml: tables and lists are nested too deep")


def test_what_an_empty_table_lacks_is_blamed_on_the_file_that_wrote_it(write):
    write("empty.toml", 'extends = "touch"\n[detectors.second]\n')
    assert refusal("empty.toml")[0].startswith("empty.toml: [detectors.second] kind is missing")
