"""The profiles that come with the program."""

import re

import pytest

from config.profile import load_resolved
from config.sections import referred
from config.source import PROFILES, ProfileError, profile_names, read_source
from controller.reports.papers import table
from tests.refusals import check_refusal, refused
from tests.unit.config.conftest import loaded, on_the_mock_bench

EXPERIMENTS = [name for name in profile_names() if "bench" not in name and not name.startswith("papers/")]

STREAMS = (
    *("position", "pose", "force", "width", "fingers", "taxels", "load", "strain_11"),
    *("accelerometer", "distal", "tendon", "load_cell", "period", "fingertip", "flexible"),
)
"""What the devices send, on any bench."""

TABLE_I = [
    *(("a", 3.785), ("b", 3.691), ("c", 4.919), ("d", 4.487), ("e", 4.885), ("f", 4.843), ("g", 4.555)),
    *(("h", 3.260), ("f", 2.540), ("f", 4.513), ("f", 6.435), ("f", 8.060), ("f", 10.685), ("f", 11.997)),
]
"""Backus and Dollar, Table I: location and mean speed in mm/s, row by row."""


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_it_is_valid_and_its_bench_is_that_of_its_folder(name):
    profile = loaded(name)
    assert profile.bench == name.split("/")[0]
    assert profile.title
    assert profile.trials(0)


@pytest.mark.parametrize("name", [name for name in profile_names() if "bench" in name])
def test_a_bench_is_there_to_be_extended_and_reports_it(name):
    with pytest.raises(ProfileError, match="experiment is missing"):
        loaded(name)


ASKED = ("experiment", "detectors", "signals")
"""What is asked on each bench alike."""

WEIGHTS = ("weights_x_n", "weights_y_n", "weights_t_n")


@pytest.mark.parametrize("bench", ["emulated", "hardware"])
@pytest.mark.parametrize(
    ("experiment", "same", "emulated"),
    [
        ("static", (*ASKED, "limits", "devices"), {"settle_s"}),
        ("transient", (*ASKED, "limits", "devices"), {"settle_s", "detector"}),
        ("transient_arm", (*ASKED, "limits", "devices"), {"settle_s", "detector"}),
        ("weights", (*ASKED, "limits", "devices"), {"cycles", "preloads", "swing_s", *WEIGHTS}),
        ("pointer", (*ASKED, "limits", "devices"), {"angles_rad"}),
        ("slip", (*ASKED, "limits"), {"stop_on_slip", "measures"}),
        ("centering", ASKED, set()),
        ("chirp", ASKED, set()),
        ("pretouch", ASKED, set()),
    ],
)
def test_other_benches_ask_for_the_same(bench, experiment, same, emulated):
    """The drivers' own settings follow from the ports.

    On an emulated bench our detector stops what moves, and what the title calls shortened is; on a real one closing
    takes the object along.
    """
    mock, other = (read_source(f"{each}/{experiment}").data for each in ("mock", bench))
    benches = [{**data, "devices": on_the_mock_bench(data["devices"])} for data in (mock, other)]
    for section in same:
        assert benches[0].get(section) == benches[1].get(section), section
    own = emulated if bench == "emulated" else {"grasp"} if experiment == "centering" else set()
    ours, theirs = mock["behavior"], other["behavior"]
    assert {key for key in ours | theirs if ours.get(key) != theirs.get(key)} == own
    if bench == "hardware" and experiment in ("weights", "pointer"):
        assert other["trials"] == mock["trials"]
    if bench == "emulated" and "devices" in same:
        assert "shortened" in other["title"]


def test_transient_runs_the_rows_of_table_i_three_times_each_by_the_papers_criterion():
    trials = sorted(loaded("mock/transient").trials(7), key=lambda trial: trial.id)
    rows = [(trial.factors["location"], round(trial.factors["speed_m_s"] * 1e3, 6)) for trial in trials]
    assert rows == [row for row in TABLE_I for _ in range(3)]
    assert [trial.repeat for trial in trials] == [1, 2, 3] * 14
    detector = loaded("mock/transient").detectors["contact"]
    assert detector.kind == "resonance.paper"
    settings = detector.settings
    assert (settings.average_samples, settings.baseline_s, settings.threshold_sigma) == (10, 1.0, 3.0)
    assert loaded("mock/transient").behavior.settle_s == 90.0


def test_the_study_crosses_noise_and_sample_rate_on_every_row():
    profile = loaded("mock/transient_study")
    varied = ("plant.noise_scale", "detectors.contact.sample_hz")
    cells = {tuple(trial.factors[name] for name in varied) for trial in profile.trials(0)}
    assert cells == {(noise, rate) for noise in (0.5, 1.0, 2.0) for rate in (10.0, 15.0, 28.0)}
    trial = profile.trials(0)[0]
    own = profile.for_trial(trial)
    assert own.plant.settings.noise_scale == trial.factors["plant.noise_scale"]
    assert own.detectors["contact"].settings.sample_hz == trial.factors["detectors.contact.sample_hz"]


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_with_the_arm_only_the_bench_changes(bench):
    stage, arm = read_source(f"{bench}/transient").data, read_source(f"{bench}/transient_arm").data
    assert "stage" not in arm["devices"]
    assert arm["devices"]["board"] == stage["devices"]["board"]
    for section in ("experiment", "detectors", "trials", "plant"):
        assert arm[section] == stage[section]
    carried = {"mover": "arm", "position_stream": "arm.position"}
    assert arm["behavior"] == {**stage["behavior"], **carried}
    assert arm["limits"] == {**stage["limits"], "position_stream": "arm.position", "travel_min_m": -0.02}


BY_ITSELF = {"contact"}
"""Of `aura`: a detector only where it is to touch, which its behavior sees to."""


def referring(settings, names):
    """Settings whose value is a name of the profile's, and whether their type declares so."""
    for key, field in type(settings).model_fields.items():
        value = getattr(settings, key)
        if isinstance(value, dict):
            for inner in value.values():
                yield from referring(inner, names) if hasattr(inner, "model_fields_set") else ()
        values = (value,) if isinstance(value, str) else value if isinstance(value, tuple) else ()
        if key not in BY_ITSELF and any(isinstance(one, str) and one in names for one in values):
            yield key, bool(referred(field))


@pytest.mark.parametrize("name", EXPERIMENTS)
def test_every_setting_that_names_a_device_a_stream_or_a_detector_has_a_type_for_it(name):
    profile = loaded(name)
    streams = {f"{device}.{stream}" for device in profile.devices for stream in STREAMS}
    streams |= {f"signals.{signal}" for signal in profile.signals}
    names = {*profile.devices, *profile.detectors, *streams}
    parts = [profile.behavior, profile.limits, *profile.faults]
    parts += [entry.settings for entry in (*profile.detectors.values(), *profile.signals.values())]
    found = [one for part in parts for one in referring(part, names)]
    assert found
    assert [key for key, typed in found if not typed] == []


CELL = 'devices.cell={{ driver = "serial_lines", port = "{port}", rate_hz = 500.0, streams.force = {force} }}'


def with_a_cell(port, force='{ columns = [1], unit = "N" }'):
    key, _, value = CELL.format(port=port, force=force).partition("=")
    ports = {"devices.stage.port": '"/dev/nowhere/1"', "devices.board.port": '"/dev/nowhere/2"'}
    with pytest.raises(ProfileError) as caught:
        loaded("hardware/transient", {**ports, key: value})
    return caught.value.problems


def test_two_devices_at_one_serial_port_are_named_before_either_is_opened():
    (line,) = with_a_cell("/dev/nowhere/../nowhere/1")
    check_refusal(line, "[devices.cell] port", "stage is there already", "one device")


def test_columns_by_name_are_one_mistake():
    (line,) = with_a_cell("/dev/nowhere/3", '{ columns = ["Kraft"], unit = "N" }')
    check_refusal(line, "[devices.cell.streams.force] columns #1", '"Kraft"', "integer")


# --- the fingertip and the sonic fingers


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_weights_go_to_the_papers_largest_load_through_the_middle(bench):
    behavior = loaded(f"{bench}/weights").behavior
    for paper in table("fernandez_bridges"):
        weights_n = behavior.weights_n(paper["bridge"])
        assert weights_n[-1] == paper["top_n"]
        assert paper["top_n"] / 2.0 in weights_n


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_pointer_covers_the_range_of_figure_11_in_both_directions_and_its_fingertip_is_watched(bench):
    profile = loaded(f"{bench}/pointer")
    turns = list(profile.behavior.turns_rad)
    assert (profile.behavior.angles_rad[0], profile.behavior.angles_rad[-1]) == (-1.5, 1.5)
    assert turns == turns[::-1]
    assert set(profile.devices) == {"arm", "board"}
    assert profile.limits.range_streams == ("signals.tip",)
    assert profile.limits.reach_rad >= 1.5 - -1.5


def test_the_pointer_touches_with_several_forces_below_the_sensors_limit():
    forces = [trial.factors["detectors.touch.threshold"] for trial in loaded("mock/pointer").trials(0)]
    assert len(set(forces)) >= 3
    assert max(forces) < 10.0


@pytest.mark.parametrize("listener", ["signals.left", "detectors.right_ours"])
def test_a_listener_for_another_frequency_than_the_drives_is_refused(listener):
    with pytest.raises(ProfileError) as refusal:
        loaded("mock/centering", {f"{listener}.drive_hz": "41000.0"})
    assert f"[{listener}] drive_hz = 41000.0: [behavior] has drive_hz = 40000.0" in str(refusal.value)


def test_a_drive_that_the_chain_cannot_do_is_refused_with_the_profile():
    with refused(
        ProfileError, "[signals.left] drive_hz = 40000: ", "no drive at all; lower output_hz to 1600"
    ):
        loaded("mock/centering", {"signals.left.variant": "cic", "signals.left.output_hz": "4000.0"})


def test_who_tracks_the_clocks_needs_a_rest_in_which_detectors_can_learn():
    tracked = {"signals.left.clocks": "tracked"}
    with pytest.raises(ProfileError) as refusal:
        loaded("mock/centering", tracked)
    (line,) = str(refusal.value).splitlines()
    assert line.endswith(
        "[behavior] baseline_s = 1.0: [signals.left] tracks for 1.01 s before it gives anything, and"
        " [detectors.left_contact] learns for 0.3 s; make it 1.31 or longer"
    )
    assert loaded("mock/centering", tracked | {"behavior.baseline_s": "1.31"}).behavior.baseline_s == 1.31
    with refused(ProfileError, "baseline_s = 0.1: [detectors.touch] learns for 0.3 s; make it 0.3 or longer"):
        level = {"detectors.left_contact": "none", "detectors.right_contact": "none"}
        touch = {"detectors.touch.kind": "level", "detectors.touch.input": "signals.left"}
        loaded("mock/centering", level | touch | {"behavior.baseline_s": "0.1"})


def test_a_bench_that_is_driven_at_another_frequency_throughout_is_taken():
    wanted = {"behavior.drive_hz": "41000.0"}
    listeners = [f"detectors.{side}_{what}" for side in ("left", "right") for what in ("ours", "contact")]
    listeners += ["signals.left", "signals.right"]
    profile = loaded("mock/centering", wanted | {f"{listener}.drive_hz": "41000.0" for listener in listeners})
    assert profile.behavior.drive_hz == 41_000.0


@pytest.mark.parametrize("experiment", ["pretouch", "touch"])
def test_a_real_bench_is_run_a_side_at_a_time_as_the_gripper_is_not_turned_between_trials(experiment):
    sides = {trial.factors["side"] for trial in loaded(f"hardware/{experiment}").trials(0)}
    assert sides == {"normal"}
    assert len({trial.factors["side"] for trial in loaded(f"mock/{experiment}").trials(0)}) == 5


# --- slip: what it asks for is what the paper prints, and the three benches ask for the same

PRINTED_SLIP_S = {
    "fingertip": [3.6],  # 6.20 to 9.8 s
    "flexible_finger": [1.41, 1.05],  # 3.24 to 4.65 s, and back from 5.01 to 6.06 s
    "barrett_finger": [0.75],  # 5.50 to 6.25 s
    "wrist": [2.02],  # 1.53 to 3.55 s
    "dsa": [3.0],  # 4 to 7 s
}
"""Fernandez et al., 4.3 and 5.1 to 5.4."""


@pytest.mark.parametrize("sensor", PRINTED_SLIP_S)
def test_each_sensor_slips_for_as_long_as_the_papers_did(sensor):
    steps = loaded("mock/slip").behavior.sensors[sensor].steps
    assert [step.duration_s for step in steps if step.do == "slip"] == PRINTED_SLIP_S[sensor]


def test_each_sensor_rolls_and_slips_in_the_papers_order_with_the_papers_blocks_and_thresholds():
    sensors = loaded("mock/slip").behavior.sensors
    assert [step.do for step in sensors["wrist"].steps] == ["hold", "slip", "hold", "roll", "hold"]
    assert [step.do for step in sensors["fingertip"].steps] == ["hold", "roll", "load", "slip", "hold"]
    detectors = loaded("mock/slip").detectors
    assert detectors["fingertip_paper"].settings.threshold == 10.0
    assert detectors["flexible_paper"].settings.threshold == 0.25
    assert detectors["dsa_paper"].settings.block_s == 0.16
    assert {entry.kind for name, entry in detectors.items() if name.endswith("_paper")} == {"slip.paper"}


def test_the_line_that_the_real_benchs_profile_gives_runs_another_sensor():
    text = (PROFILES / "hardware" / "slip.toml").read_text()
    ((key, value),) = re.findall(r'--set "(trials\.list)=(.*)"', text)
    assert {trial.factors["sensor"] for trial in loaded("hardware/slip", {key: value}).trials(0)} == {"wrist"}


def test_with_bumps_nothing_else_changes():
    calm, bumpy = read_source("mock/slip").data, read_source("mock/slip_bumps").data
    assert {**bumpy, "plant": calm["plant"], "title": calm["title"]} == calm
    assert bumpy["plant"]["bumps_hz"] == 1.0


def test_a_name_that_is_not_there_is_reported_with_its_place_in_a_table_of_tables():
    with refused(ProfileError, "[behavior.sensors.dsa]", "no device 'matric'; did you mean 'matrix'"):
        loaded("mock/slip", {"behavior.sensors.dsa.stream": "matric.taxels"})


LIFT = {"limits.movers.arm.travel_m": "0.1", "limits.movers.arm.speed_m_s": "0.03"}


def test_limits_of_another_mover_are_in_the_resolved_profile_and_load_again():
    profile = loaded("mock/slip", LIFT)
    assert profile.limits.movers["arm"].speed_m_s == 0.03
    assert "position_stream" not in profile.resolved["limits"]["movers"]["arm"]
    again = load_resolved("again", profile.resolved)
    assert again.limits == profile.limits
    assert again.hash == profile.hash


def test_a_home_is_held_to_the_limits_of_its_own_mover_in_each_trial_and_that_must_be_there():
    with pytest.raises(ProfileError, match=r"home_speed_m_s = 0.031: faster than"):
        loaded("mock/slip", {**LIFT, "devices.arm.home_speed_m_s": "0.031"})
    loaded("mock/slip", {**LIFT, "devices.arm.home_speed_m_s": "0.029"})
    rows = '[{ sensor = "wrist" }, { sensor = "wrist", limits.speed_m_s = 0.01 }]'
    with pytest.raises(ProfileError, match=r"home_speed_m_s = 0.02: faster than .* = 0.01"):
        loaded("mock/slip", {"trials.list": rows})
    with pytest.raises(ProfileError, match=r"\[limits\] movers = .lift.: no device 'lift'; known: "):
        loaded("mock/slip", {"limits.movers.lift.travel_m": "0.1"})
