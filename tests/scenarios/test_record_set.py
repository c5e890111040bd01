"""A data set of a run, loaded by the ten lines of the page."""

import hashlib
import json
import re
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pandas as pd
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from controller.record_set import described, labels_of, moves
from controller.recording.series import Series, TrialRecording
from drivers.core.messages import SampleBlock

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "run_campaigns.md"


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("set")


@pytest.fixture
def slips(verb, folder):
    """The page's command on two trials of `mock/slip`: where the set is."""
    where = folder / "slips"
    if not where.exists():
        slowly = ("--set", "loop.rate_hz=50.0")
        given = ("--only", 1, "--only", 2, *slowly, "--no-report", "--out", folder / "runs")
        assert verb("run", "mock/slip", *given)[0] == 0
        publish = ("--licence", "CC-BY-4.0", "--by", "A lab")
        code, _, err = verb("record-set", "latest", "--out", folder / "runs", "--into", where, *publish)
        assert code == 0, err
    return where


def test_the_pages_loader_finds_each_slip_in_the_signal(slips):
    (loader,) = re.findall(r"```python\n# load_set.py\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    assert len(loader.strip().splitlines()) <= 10
    done = subprocess.run(
        [sys.executable, "-I", "-c", loader], cwd=slips.parent, capture_output=True, text=True, check=True
    )
    lines = [line.split() for line in done.stdout.splitlines()]
    assert [line[:2] for line in lines] == [["CC-BY-4.0", "1"], ["CC-BY-4.0", "2"]]
    assert all("simulation" in line for line in lines)


def test_labels_say_by_what_they_are_known_and_agree(slips):
    labels = pd.read_parquet(slips / "labels.parquet")
    for _, own in labels.groupby("trial"):
        at = own.set_index("what")
        touch_s, slip_s = at.loc["touch", "begin_s"], at.loc["slip", "begin_s"]
        assert at.loc["slip", "end_s"] > slip_s
        # the arm starts to drag 30 ms and more before the tip lets go
        arm = own[(own.what == "moves") & (own.stream == "arm.pose")]
        assert arm[arm.begin_s < slip_s].begin_s.max() == pytest.approx(slip_s, abs=0.06)
        taps = own[own.what == "tap"]
        assert len(taps) >= 1
        off = np.abs(taps.begin_s - touch_s) / taps.sigma_s
        assert (off < 3.0).all(), "each sensor's own time of the touch is true to its uncertainty"
    assert set(labels.source) == {"truth of the simulation", "encoder", "the sensor itself"}


def test_the_set_says_what_it_is_and_its_files_are_whole(slips):
    about = json.loads((slips / "dataset.json").read_text())
    assert (about["licence"], about["published_by"], about["name"]) == ("CC-BY-4.0", "A lab", "slips")
    assert about["origin"].startswith("simulated")
    assert about["streams"]["board.fingertip"] == {"unit": "V", "channels": 3, "rate_hz": 1000.0}
    for name, digest in about["sha256"].items():
        assert hashlib.sha256((slips / name).read_bytes()).hexdigest() == digest
    samples = pd.read_parquet(slips / "samples.parquet")
    one = samples[(samples.trial == 1) & (samples.stream == "board.fingertip") & (samples.channel == 0)]
    assert set(one.unit) == {"V"}
    with (slips / "trial_1.mcap").open("rb") as file:
        found = make_reader(file, decoder_factories=[DecoderFactory()]).iter_decoded_messages(
            "/board/fingertip"
        )
        assert np.array_equal([message.position[0] for _, _, _, message in found], one.value)


def test_a_mover_moves_where_its_encoder_leaves_its_own_noise():
    t_s = np.arange(5_000) / 500.0
    rng = np.random.default_rng(1)
    x = 1e-6 * rng.standard_normal((5_000, 1))
    x[:, 0] += 0.01 * np.clip(t_s - 4.0, 0.0, 2.0)
    (span,) = moves(Series(t_s, x, "m"))
    assert span == (pytest.approx(4.0, abs=0.02), pytest.approx(6.0, abs=0.02))


def test_a_slip_without_a_reference_is_known_by_the_truth_and_all_trials_streams_and_factors_are_described():
    one, other = TrialRecording(1, {"speed_m_s": 0.1}), TrialRecording(2, {"turn_rad": 0.1})
    for recording, stream in ((one, "board.a"), (other, "board.b")):
        recording.add(SampleBlock(stream, 0, 0.0, np.zeros((10, 1)), 100.0, unit="V"))
    rows = [
        {"trial": 1, "outcome": "kept", "slip_s": 2.5},
        {"trial": 2, "slip_s": 2.5, "reference": "command"},
    ]
    trials = {1: one, 2: other}
    run = SimpleNamespace(recorded_trials=[1, 2], trial=trials.__getitem__, trials=rows, manifest={})
    sources = [label.source for trial in trials for label in labels_of(run, trial)]
    assert sources == ["truth of the simulation", "command"]
    about = described(run, [], licence="CC0", name="x", by="me")
    assert about["factors"] == {"speed_m_s": "m/s", "turn_rad": "rad"}
    assert [*about["streams"]] == ["board.a", "board.b"]


def test_what_is_damaged_in_a_run_is_said_where_a_set_of_it_is_written(verb, slips, tmp_path, monkeypatch):
    (run,) = (slips.parent / "runs").iterdir()
    copy = Path(shutil.copytree(run, tmp_path / "run"))
    (copy / "trials.csv").write_bytes((copy / "trials.csv").read_bytes()[:-3])
    monkeypatch.setattr("controller.record_set.write_set", lambda *_, **__: [])
    code, _, err = verb("record-set", copy, "--into", tmp_path / "x", "--by", "me", "--licence", "CC0-1.0")
    assert code == 0
    assert "The last line of trials.csv is incomplete" in err


def test_a_set_needs_a_licence_and_something_recorded(verb, slips, tmp_path):
    code, _, err = verb("record-set", slips.parent / "runs", "--into", tmp_path / "x", "--by", "me")
    assert code == 2
    assert "--licence" in err


def test_a_certificate_is_of_the_trial_that_is_named(verb, slips):
    (run,) = (slips.parent / "runs").iterdir()
    given = ("characterize", run, "--stream", "board.fingertip", "--column", "2", "--quiet", "2.7:5")
    noise = []
    for trial in (1, 2):
        out = slips.parent / f"tip_{trial}"
        code, _, err = verb(*given, "--trial", trial, "--touch", "5.082", "--out", out)
        assert code == 0, err
        rows = json.loads(out.with_suffix(".json").read_text())["rows"]
        noise.append(next(row["value"] for row in rows if row["quantity"] == "noise, standard deviation"))
    assert noise[0] != noise[1]
    assert noise[0] == pytest.approx(noise[1], rel=0.2)
    code, _, err = verb(*given, "--trial", 9)
    assert code == 2
    assert "no recording of trial 9" in err
