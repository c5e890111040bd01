"""A2 on the mock bench: what a trial is, and what it leaves behind."""

import numpy as np
import pytest

from drivers.core.messages import Listen
from tests.scenarios.conftest import run_campaign


def row_of(bench):
    (row,) = bench.run.trials
    return row


@pytest.fixture(scope="module")
def first(tmp_path_factory):
    """A trial, and what the board was told to send in it."""
    told = []

    def spy(rig):
        board = rig.devices["board"]
        apply = board.apply
        board.apply = lambda command: (
            told.append(command) if isinstance(command, Listen) else None,
            apply(command),
        )[1]

    return run_campaign(tmp_path_factory.mktemp("runs"), trials=(1,), wrap=spy), told


@pytest.fixture(scope="module")
def three(tmp_path_factory):
    """Three trials, in the order of the profile, which is shuffled."""
    return run_campaign(tmp_path_factory.mktemp("runs"), trials=(2, 9, 33))


def test_a_trial_ends_by_contact_with_a_stop_certificate(first):
    row = row_of(first[0])
    assert row["outcome"] == "contact"
    assert row["truth_contact_s"] <= row["onset_s"] + 1e-9
    assert row["onset_s"] < row["detect_s"] <= row["command_s"] < row["standstill_s"]
    # The command goes out in the turn that receives the deciding sample: at most one turn later.
    assert row["command_s"] - row["detect_s"] <= 1 / 200 + 1e-9
    # From 3.785 mm/s at 0.5 m/s2: 7.57 ms to a standstill.
    assert row["standstill_s"] - row["command_s"] == pytest.approx(0.003785 / 0.5, abs=1e-6)
    braking_m = 0.003785**2 / (2 * 0.5)
    cruising_m = 0.003785 * (row["command_s"] - row["detect_s"])
    assert row["stop_travel_m"] == pytest.approx(braking_m + cruising_m, abs=1e-5)  # positions come at 100 Hz
    # The last report before the detection and the first one after it straddle up to 5 ms of braking: 6 um.
    assert row["extent_m"] == pytest.approx(0.003785 * row["delay_s"], abs=7e-6)


def test_another_seed_gives_another_row(three, run_profile):
    """The same one the same, however the board cuts its blocks: the swarm."""
    assert run_profile(trials=(9,), seed=2).csv.splitlines()[1] not in three.csv


def test_the_order_of_trials_changes_no_row(three, run_profile):
    forward = run_profile(trials=(2, 9, 33), trials__order="listed")
    lines, shuffled = forward.csv.splitlines(), three.csv.splitlines()
    assert [line.partition(",")[0] for line in shuffled] != [line.partition(",")[0] for line in lines]
    assert sorted(lines) == sorted(shuffled)
    assert run_profile(trials=(9,)).csv.splitlines()[1] in lines


def test_a_stream_without_a_subscriber_is_neither_sent_nor_recorded(first):
    bench, told = first
    streams = {stream for command in told for stream in command.streams}
    assert streams == {"board.accelerometer", "board.load_cell", "board.period"}
    recording = bench.run.trial(1)
    entered_s = dict(bench.script.seen)
    waveform = recording.stream("board.accelerometer")
    assert waveform.times_s[-1] < entered_s["STOPPING"] + 0.1, "no detector listens to a probe that stands"
    force = recording.stream("board.load_cell")
    settled_s = entered_s["BASELINE"]
    assert not force.gaps, "a skipped span is no loss"
    starting = force.times_s[force.times_s < settled_s]
    assert len(starting) <= 20, "the mover's first command is watched for a turn or two, settling is not"


def test_a_false_contact_is_counted_against_the_truth(run_profile):
    bench = run_profile(trials=(1,), detectors__contact__threshold_sigma="0.2")
    row = row_of(bench)
    assert row["outcome"] == "false_contact"
    assert row["false_contacts"] == 1
    assert row["truth_contact_s"] is None or row["detect_s"] < row["truth_contact_s"]
    assert row["delay_s"] is None
    assert bench.outcome.exit_code == 1, "none of its trials succeeded"


def test_an_approach_that_meets_nothing_reports_it(run_profile):
    bench = run_profile(trials=(1,), plant__surface_m="0.05", detectors__contact__threshold_sigma="50.0")
    row = row_of(bench)
    assert row["outcome"] == "no_contact"
    assert bench.stage.axis.target_m == 0.0


def test_a_recording_holds_what_the_row_was_measured_from(first):
    """The row again, from the file alone."""
    bench, _ = first
    row, recording = row_of(bench), bench.run.trial(1)
    force = recording.stream("board.load_cell")
    position = recording.stream("stage.position")
    begun_s = next(t_s for name, t_s in bench.script.seen if name == "APPROACH")
    zero_n = force.values[force.times_s < begun_s, 0][-1000:].mean()
    above = force.times_s[(force.times_s >= begun_s) & (force.values[:, 0] - zero_n >= 0.005)]
    assert above[0] == pytest.approx(row["onset_s"], abs=2e-3)
    at = np.interp([row["onset_s"], row["detect_s"]], position.times_s, position.values[:, 0])
    assert at[1] - at[0] == pytest.approx(row["extent_m"], abs=1e-7)
