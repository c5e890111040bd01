"""The profiles that come with the program."""

import pytest

from config.sections import referred
from config.source import ProfileError, profile_names, read_source
from tests.refusals import check_refusal
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
