"""A run in other programs' formats is the run, and two runs beside each other show what differs."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
from mcap.reader import make_reader

from controller.comparing import compared, side_by_side
from controller.export import export, tidy
from controller.measures.transient import COLUMNS
from controller.recording.reader import open_run
from controller.recording.run_folder import RecordingError, RunFolderError
from controller.recording.series import TrialRecording
from controller.recording.tables import read_columns
from controller.reports.counts import pairs_of
from drivers.core.messages import SampleBlock
from tests.refusals import refused
from tests.scenarios.conftest import run_campaign

TRIALS = (2, 16)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Of a run that is only read."""
    return run_campaign(tmp_path_factory.mktemp("runs"), trials=TRIALS).outcome.folder


@pytest.fixture
def run(folder):
    return open_run(folder)


def test_parquet_holds_every_row_and_every_sample(run, tmp_path):
    trials, samples = export(run, "parquet", tmp_path)
    pd.testing.assert_frame_equal(pd.read_parquet(trials), run.table)
    said = {b"unit": b"s", b"meaning": COLUMNS["delay_s"].encode()}
    assert pq.read_schema(trials).field("delay_s").metadata == said
    table = pd.read_parquet(samples)
    for trial in TRIALS:
        for name in run.trial(trial).streams:
            series = run.trial(trial).stream(name)
            found = table[(table["trial"] == trial) & (table["stream"] == name) & (table["channel"] == 0)]
            np.testing.assert_array_equal(found["t_s"], series.times_s)
            np.testing.assert_array_equal(found["value"], series.values[:, 0])
            assert set(found["unit"]) == {series.unit}


def test_a_run_has_its_trials_as_parquet_beside_the_csv_where_pyarrow_is_there(run, monkeypatch):
    run.trials[0]["place"], run.trials[1]["place"] = "a", 1.5  # numbers and text: all text
    found = pd.read_parquet(tidy(run))
    assert list(found["place"]) == ["a", "1.5"]
    pd.testing.assert_frame_equal(found.drop(columns="place"), run.table.drop(columns="place"))
    monkeypatch.setattr("controller.export.find_spec", lambda _: None)
    assert tidy(run) is None


def test_an_export_that_cannot_be_written_is_one_line(run, tmp_path):
    (tmp_path / "file").write_text("in the way")
    with pytest.raises(RecordingError, match=r"move away .* or choose another .*--into$"):
        export(run, "csv", tmp_path / "file")
    for to, file in (
        ("csv", "trials.csv"),
        ("rosbag2", f"trial_{TRIALS[0]}.mcap"),
        ("parquet", "samples.parquet"),
    ):
        (tmp_path / to / file).mkdir(parents=True)
        with pytest.raises(RecordingError, match=f"while writing {tmp_path / to}"):
            export(run, to, tmp_path / to)


def test_csv_holds_the_same(run, tmp_path):
    paths = export(run, "csv", tmp_path)
    assert [path.name for path in paths] == ["trials.csv", "samples_2.csv", "samples_16.csv"]
    table = pd.read_csv(paths[2])
    force = run.trial(16).stream("board.load_cell")
    np.testing.assert_allclose(table[table["stream"] == "board.load_cell"]["value"], force.values[:, 0])


def test_a_bag_is_read_by_the_reader_of_ros_2_messages(run, tmp_path):
    bag = next(path for path in export(run, "rosbag2", tmp_path) if path.name == "trial_16.mcap")
    for column, stream in (
        ("/board/load_cell:wrench.force.x", "board.load_cell"),
        ("/stage/position:position.0", "stage.position"),
    ):
        series = run.trial(16).stream(stream)
        found = read_columns(bag, column, 1)
        np.testing.assert_allclose(found.values[:, 0], series.values[:, 0])
        assert found.times_s is not None
        np.testing.assert_allclose(np.diff(found.times_s), np.diff(series.times_s), atol=2e-9)


def test_a_lerobot_dataset_holds_every_sample_at_its_own_time(run, tmp_path):
    """Read as LeRobot 0.4 does (load_info, load_tasks, load_nested_dataset), without its torch."""
    export(run, "lerobot", tmp_path)
    info = json.loads((tmp_path / "meta/info.json").read_text())
    assert (info["codebase_version"], info["fps"], info["total_episodes"]) == ("v3.0", 1000, len(TRIALS))
    tasks = pd.read_parquet(tmp_path / "meta/tasks.parquet")
    (listed,) = tmp_path.glob("meta/episodes/*/*.parquet")
    episodes = pd.read_parquet(listed)
    assert set(tasks.index) == {task for (task,) in episodes["tasks"]}
    frames = pd.concat(pd.read_parquet(path) for path in sorted(tmp_path.glob("data/*/*.parquet")))
    assert len(frames) == info["total_frames"] == episodes["dataset_to_index"].iloc[-1]
    assert set(frames.columns) == set(info["features"])
    np.testing.assert_array_equal(frames["index"], np.arange(len(frames)))
    for episode, trial in enumerate(TRIALS):
        own = frames[frames["episode_index"] == episode]
        np.testing.assert_allclose(own["timestamp"], own["frame_index"] / 1000, rtol=1e-6)
        for name in run.trial(trial).streams:
            series = run.trial(trial).stream(name)
            present = own.dropna(subset=f"time.{name}").drop_duplicates(f"time.{name}")
            np.testing.assert_array_equal(present[f"time.{name}"], series.times_s)
            values = np.stack(present[f"observation.{name}"].to_list()).reshape(series.values.shape)
            np.testing.assert_allclose(values, series.values, rtol=1e-6)


def test_an_acceleration_is_an_imu(tmp_path):
    recording = TrialRecording(1)
    values = np.array([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]])
    recording.add(SampleBlock("board.accelerometer", 0, 0.5, values, 1000.0, None, "m/s2"))
    run = SimpleNamespace(recorded_trials=[1], trial=lambda _: recording)
    (bag,) = export(run, "rosbag2", tmp_path)
    found = read_columns(bag, "/board/accelerometer:linear_acceleration.x,linear_acceleration.z", 2)
    np.testing.assert_array_equal(found.values, values[:, [0, 2]])


@pytest.mark.parametrize(("unit", "width"), [("N", 2), ("m/s2", 2), ("m/s2", 6)])
def test_channels_that_make_no_vector_are_all_there_by_name(tmp_path, unit, width):
    recording = TrialRecording(1)
    values = np.arange(1.0, 2.0 * width + 1.0).reshape(2, width)
    recording.add(SampleBlock("board.own", 0, 0.5, values, 1000.0, None, unit))
    run = SimpleNamespace(recorded_trials=[1], trial=lambda _: recording)
    (bag,) = export(run, "rosbag2", tmp_path)
    columns = ",".join(f"position.{channel}" for channel in range(width))
    np.testing.assert_array_equal(read_columns(bag, f"/board/own:{columns}", width).values, values)


def recorded(notes, **blocks):
    """A run of one trial with these streams."""
    recording = TrialRecording(1)
    for name, given_s in blocks.items():
        times_s = np.asarray(given_s, dtype=float)
        values = np.arange(float(len(times_s)))[:, None]
        recording.add(SampleBlock(f"board.{name}", 0, times_s[0], values, times_s=times_s, unit="N"))
    return SimpleNamespace(recorded_trials=[1], trial=lambda _: recording, manifest={}, notes=notes)


def episode(folder, stream):
    (path,) = folder.glob("data/*/*.parquet")
    return pd.read_parquet(path)[f"time.board.{stream}"].dropna().unique()


@pytest.mark.parametrize("rate_hz", [1000.4, 26.67, 1000.0, 1.0 / 3.0])
def test_a_lerobot_dataset_holds_every_sample_at_any_rate(tmp_path, rate_hz):
    times_s, notes = 5.0 + np.arange(5000) / rate_hz, []
    export(recorded(notes, force=times_s), "lerobot", tmp_path)
    np.testing.assert_array_equal(episode(tmp_path, "force"), times_s)
    assert json.loads((tmp_path / "meta/info.json").read_text())["fps"] == int(np.ceil(rate_hz))
    assert notes == []


def test_samples_closer_together_than_frames_are_told(tmp_path):
    times_s, notes = np.arange(1000) / 100.0, []
    times_s[500] += 0.009
    export(recorded(notes, force=times_s, way=times_s[::10]), "lerobot", tmp_path)
    lost = 1000 - len(episode(tmp_path, "force"))
    assert lost > 0
    assert notes == [
        f"The dataset has 100 frames a second; samples between two are in none: {lost} of board.force."
    ]


def test_episodes_of_another_dataset_are_not_mixed_with_a_runs(run, tmp_path):
    export(run, "lerobot", tmp_path)
    export(run, "lerobot", tmp_path)  # the same again
    with refused(RunFolderError, "file-001.parquet", "another dataset", "--into"):
        export(recorded([], force=np.arange(10.0)), "lerobot", tmp_path)
    assert json.loads((tmp_path / "meta/info.json").read_text())["total_episodes"] == len(TRIALS)


def test_a_factor_that_is_a_number_in_one_run_and_a_word_in_the_other_pairs_nothing():
    def pairs(*values):
        runs = [SimpleNamespace(factors=["object"])] * 2
        return pairs_of(*runs, *([{"trial": 1, "outcome": "contact", "object": value}] for value in values))

    assert len(pairs(1, "cup")) == 0
    assert len(pairs(1, 1.0)) == len(pairs("cup", "cup")) == 1


def test_two_runs_are_compared_by_settings_and_by_pairs_of_trials(run_profile, run):
    other = run_profile(trials=(*TRIALS, 30), seed=2, behavior__hold_s="0.2").run
    lines = list(compared(run, open_run(other.folder.path)))
    assert lines[:2] == ["behavior.hold_s: 0.3 → 0.2", "seed: 1 → 2"]
    assert "2 pairs of trials, of 2 and 3" in lines
    assert "outcome: equal in 2" in lines
    (delay,) = [line for line in lines if line.startswith("delay, s: ")]
    both = run.table.merge(other.table, on="trial")
    assert f"{(both['delay_s_y'] - both['delay_s_x']).mean():+.4g} (".replace("-", "−") in delay
    assert delay.endswith("n = 2")


def test_two_runs_tables_and_figures_stand_side_by_side_on_one_page(run, run_profile, monkeypatch):
    monkeypatch.setattr("controller.reports.figures.Figures.save", lambda *_: "<svg/>")
    other = run_profile(trials=TRIALS, seed=2).run
    page = side_by_side(run, other, ["a < b"])[0].read_text()
    assert "<li>a &lt; b</li>" in page
    beside = page[page.index('id="compared"') : page.index('id="part1"')]
    assert beside.count("<figure>") == 6, "of each run its places on both sides and its speeds"
    assert page.count("<figure>") == 6, "and nowhere else"
    assert page.count('class="verdict-line"') == 3, "of both, and of each"
    cells = [re.findall(r"<td[^>]*>([^<]*)</td>", row) for row in page.split("<tr>")]
    delays = [{row["trial"]: row["delay_s"] for row in each.trials} for each in (run, other)]
    (means,) = [row for row in cells if row[:1] == ["delay, ms"]]
    assert [float(cell.split()[0]) for cell in means[1:3]] == pytest.approx(
        [1e3 * np.mean([*each.values()]) for each in delays], rel=1e-3
    )
    (pair,) = [row for row in cells if row[:1] == ["2"]]
    assert [f"{1e3 * each[2]:.4g}" in pair for each in delays] == [True, True]


def test_a_recording_bears_its_profile_and_its_manifest(run):
    with run.folder.recordings[0].open("rb") as file:
        attached = {each.name: json.loads(each.data) for each in make_reader(file).iter_attachments()}
    assert attached["profile.json"] == run.manifest["profile"]["resolved"]
    assert attached["manifest.json"]["profile"] == run.manifest["profile"]
