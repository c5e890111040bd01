"""Recordings through detectors, on the command line: runs with the live events, files, sound."""

import json
from shutil import copytree

import numpy as np
import pytest
from scipy.io import wavfile

from config.assemble import make_detector
from config.recordings import _check_alike
from config.script import run_trials
from controller.campaign import EXIT_DONE
from controller.recording.tables import ReplayError
from tests.refusals import check_refusal

RATE_HZ = 1000.0
DRIVE_HZ = 40_000.0
REST, STEP = 0.09 + 0.04j, 0.012 - 0.006j


def refused(verb, *arguments):
    """The one line with which the program refuses."""
    code, out, err = verb(*arguments)
    assert (code, out) == (2, "")
    check_refusal(err)
    return err


def run(tmp_path_factory, profile, rows, **settings):
    out = tmp_path_factory.mktemp("runs")
    slowly = {"loop.rate_hz": "50.0"} | settings
    outcome, made = run_trials(profile, rows, settings=slowly, out=out, say=lambda line: None)
    assert outcome.exit_code == EXIT_DONE, outcome.line
    return made


# --- runs ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def touched(tmp_path_factory):
    """Two touches; in the second one a detector has another threshold, and one another setting."""
    varied = {"detectors.pretouch_ours.threshold": 200.0, "detectors.contact_ours.settle_s": 0.4}
    rows = [{"side": "normal"}, {"side": "normal", **varied}]
    return run(tmp_path_factory, "mock/touch", rows)


@pytest.fixture(scope="module")
def slipped(tmp_path_factory):
    """A slip for which the slip detectors are armed from the first recorded sample on."""
    return run(tmp_path_factory, "mock/slip", [{"sensor": "flexible_finger"}])


@pytest.fixture(scope="module")
def met(tmp_path_factory):
    """A contact with the resonant finger, with two detectors."""
    settings = {"behavior.settle_s": "2.0"}
    return run(tmp_path_factory, "mock/transient", [{"speed_m_s": 0.004843}], **settings)


def found_live(run, detector, trial):
    """A detector's events while the trial ran, as a replay prints them."""
    keys = ("t_s", "event", "value", "threshold")
    lines = [line for line in run.events if line["trial"] == trial and line.get("detector") == detector]
    return [tuple(line[key] for key in keys) for line in lines]


def replayed(verb, run, detector, *more):
    code, out, _ = verb("replay", run.folder.path, "--detector", detector, *more)
    assert code == 0
    return [
        tuple(line[key] for key in ("t_s", "event", "value", "threshold"))
        for line in map(json.loads, out.splitlines())
    ]


@pytest.mark.parametrize(
    ("fixture", "name", "kind"),
    [
        ("touched", "pretouch_ours", ["pretouch"]),
        ("touched", "pretouch_paper", ["pretouch.paper"]),
        ("touched", "contact_ours", ["level"]),
        ("touched", "contact_paper", ["level.paper"]),
        ("slipped", "flexible_ours", ["slip", "--set", "input=board.flexible"]),
        ("slipped", "flexible_paper", ["slip.paper", "--set", "input=board.flexible"]),
        ("met", "contact", ["resonance.paper"]),
        ("met", "ours", ["resonance"]),
    ],
)
def test_a_run_replays_to_the_very_events_of_the_live_run(request, verb, fixture, name, kind):
    run = request.getfixturevalue(fixture)
    live = found_live(run, name, trial=1)
    assert live
    assert replayed(verb, run, name) == live
    assert replayed(verb, run, *kind) == live


def test_a_detector_that_listened_late_is_replayed_from_then_on(verb, tmp_path_factory):
    slipped = run(tmp_path_factory, "mock/slip", [{"sensor": "fingertip"}])
    (rolling_s,) = (line["t_s"] for line in slipped.events if line["next"] == "ROLLING" != line["state"])
    live = found_live(slipped, "fingertip_ours", trial=1)
    assert live
    assert replayed(verb, slipped, "fingertip_ours") != live
    since = f"{rolling_s + 1.0 / RATE_HZ}:{rolling_s + 1.0}"  # the sample at that time was read before
    assert replayed(verb, slipped, "fingertip_ours", "--baseline", since) == live


def test_a_trials_own_settings_are_those_of_its_replay(verb, touched):
    live = found_live(touched, "pretouch_ours", trial=2)
    assert {threshold for *_, threshold in live} == {200.0}
    assert replayed(verb, touched, "pretouch", "--trial", 2) == live


def test_what_is_set_on_the_command_line_comes_last(verb, touched):
    (event,) = replayed(verb, touched, "pretouch", "--set", "threshold=21.5")[:1]
    assert event[3] == 21.5


def test_several_detectors_of_a_kind_are_distinguished_by_name_or_by_stream(verb, slipped):
    path = slipped.folder.path
    message = refused(verb, "replay", path, "--detector", "slip")
    assert "2 detectors of kind slip in trial 1; choose --detector flexible_ours or wrist_ours" in message
    message = refused(verb, "replay", path, "--detector", "slip", "--set", "input=board.nowhere")
    assert "trial 1 has no stream board.nowhere; it has arm.force" in message
    assert "did you mean 'wrist_ours'" in refused(verb, "replay", path, "--detector", "wrist_our")


def test_two_fingers_detectors_are_not_taken_for_each_other(verb, tmp_path_factory):
    centered = run(tmp_path_factory, "mock/centering", [{"method": "ours", "object_x_m": 0.006}])
    message = refused(verb, "replay", centered.folder.path, "--detector", "level")
    assert "2 detectors of kind level in trial 1; choose --detector left_contact or right_contact" in message
    assert replayed(verb, centered, "level", "--set", "input=signals.left") == replayed(
        verb, centered, "left_contact"
    )


def test_a_stream_that_was_not_recorded_is_refused_and_not_found_empty(verb, met):
    message = refused(verb, "replay", met.folder.path, "--detector", "pretouch")
    assert "trial 1 has no stream signals.right; it has board.accelerometer, board.load_cell" in message


def test_a_stream_that_is_no_envelope_is_refused(verb, met):
    message = refused(
        verb, "replay", met.folder.path, "--detector", "level", "--set", "input=board.load_cell"
    )
    assert "board.load_cell: N is no envelope of a finger" in message


def test_a_span_without_a_sample_is_refused(verb, touched):
    message = refused(verb, "replay", touched.folder.path, "--detector", "level", "--baseline", "900:901")
    assert "no sample of signals.right from --baseline on" in message


def test_settings_of_another_version_are_refused_with_the_file_that_has_them(verb, touched, tmp_path):
    copy = tmp_path / "old"
    copy.mkdir()
    for file in touched.folder.path.iterdir():
        if file.is_file():
            (copy / file.name).write_bytes(file.read_bytes())
    manifest = json.loads((copy / "manifest.json").read_text())
    manifest["profile"]["resolved"]["detectors"]["contact_ours"]["patience_s"] = 1.0
    (copy / "manifest.json").write_text(json.dumps(manifest))
    message = refused(verb, "replay", copy, "--detector", "level")
    assert "its level is of another version (patience_s = 1.0: unknown key" in message


def test_trials_whose_detector_is_set_otherwise_or_of_another_kind_make_no_one_threshold(verb, touched):
    path = touched.folder.path
    asked = ("calibrate", path, "--false-alarm-interval", "10", "--detector")
    message = refused(verb, *asked, "contact_ours")
    check_refusal(message, f"{path}, trial 2: settle_s = 0.4, but 0.5 in", "trial 1", "--trial", "--set")
    # the trials hold touches: what the recording carries is another matter
    for alike in (["--trial", "1"], ["--set", "settle_s=0.5"]):
        assert "settle_s" not in verb(*asked, "contact_ours", *alike)[2]
    assert verb(*asked, "pretouch_paper")[0] == 0
    slip, paper = (make_detector(kind, {}) for kind in ("slip", "slip.paper"))
    with pytest.raises(ReplayError, match=r"a\.csv: kind = SlipPaperDetector, but SlipDetector in b.csv"):
        _check_alike("b.csv", slip, "a.csv", paper)
    own, other = (type("Edge", (), {"settings": {"threshold": 1.0}})() for _ in range(2))
    _check_alike("b.csv", own, "a.csv", type(own)())
    with pytest.raises(ReplayError, match=r"a\.csv: kind = Edge, but another Edge in b.csv"):
        _check_alike("b.csv", own, "a.csv", other)


def test_trials_that_broke_off_are_named_where_a_threshold_is_set_on_them(verb, touched, tmp_path):
    copy = tmp_path / "broken"
    copytree(touched.folder.path, copy)
    head, first, second = (copy / "trials.csv").read_text().splitlines()
    place = head.split(",").index("outcome")
    cells = second.split(",")
    (copy / "trials.csv").write_text(
        "\n".join([head, first, ",".join([*cells[:place], "guard", *cells[place + 1 :]])]) + "\n"
    )
    asked = ("--false-alarm-interval", "10", "--detector", "pretouch_paper")
    code, _, err = verb("calibrate", copy, *asked)
    assert code == 0
    assert err.count("broken: trials that broke off are included: 2 (guard)") == 1
    assert "broke off" not in verb("calibrate", touched.folder.path, *asked)[2]


# --- files ---------------------------------------------------------------------------------------


@pytest.fixture
def approach(touched, tmp_path):
    """The first touch as a table: I, Q, and where the arm was at each sample."""
    recording = touched.trial(1)
    fingers, arm = recording.stream("signals.right"), recording.stream("arm.pose")
    inside = (fingers.times_s >= arm.times_s[0]) & (fingers.times_s <= arm.times_s[-1])
    x_m = np.interp(fingers.times_s[inside], arm.times_s, arm.values[:, 0])
    columns = {
        "t_s": fingers.times_s[inside],
        "i": fingers.values[inside, 0],
        "q": fingers.values[inside, 1],
        "x_m": x_m,
    }
    table = np.column_stack(list(columns.values()))
    np.savetxt(tmp_path / "a.csv", table, delimiter=",", header=",".join(columns), comments="", fmt="%.12g")
    np.savez(tmp_path / "a.npz", **columns)
    return tmp_path


@pytest.mark.parametrize("name", ["a.csv", "a.npz"])
def test_pre_touch_is_found_in_a_table_of_i_q_and_position(verb, touched, approach, name):
    columns = ["--column", "i,q", "--column", "x_m"]
    code, out, _ = verb("replay", approach / name, "--detector", "pretouch", *columns)
    assert code == 0
    found = [json.loads(line) for line in out.splitlines()]
    live = found_live(touched, "pretouch_ours", trial=1)
    assert [line["event"] for line in found] == [event for _, event, *_ in live]
    # positions are interpolated once more, and rounded
    assert found[0]["t_s"] == pytest.approx(live[0][0], abs=0.02)


def test_contact_is_found_in_a_table_of_i_and_q(verb, touched, approach):
    code, out, _ = verb("replay", approach / "a.csv", "--detector", "level", "--column", "i,q")
    live = found_live(touched, "contact_ours", trial=1)
    assert code == 0
    assert [(line["t_s"], line["event"]) for line in map(json.loads, out.splitlines())] == [
        # the table begins some samples later, where the encoder does
        (pytest.approx(t_s, abs=0.005), event)
        for t_s, event, *_ in live
    ]


@pytest.mark.parametrize(
    ("columns", "reason"),
    [
        ([], "the inputs are signals.right and arm.position, in this order; give --column for each"),
        (["--column", "i,q"], "give --column for each, for example --column i,q --column x_m"),
        (["--column", "i,q", "--column", "y_m"], "no column y_m; there are i, q, x_m"),
    ],
)
def test_a_table_without_the_encoders_column_is_refused(verb, approach, columns, reason):
    assert reason in refused(verb, "replay", approach / "a.csv", "--detector", "pretouch", *columns)


@pytest.mark.parametrize("name", [["replay"], ["calibrate", "--false-alarm-interval", "60"]])
def test_a_trial_of_a_file_and_a_rate_of_a_run_folder_are_refused(verb, approach, slipped, name):
    message = refused(verb, *name, approach / "a.csv", "--detector", "level", "--trial", "3")
    assert "a.csv is a file, only a run folder has trials; leave it out" in message
    message = refused(verb, *name, slipped.folder.path, "--detector", "slip", "--rate", "500")
    assert "is a run folder and has its own times; leave it out" in message


def test_more_columns_than_streams_are_refused(verb, approach):
    columns = ["--column", "i", "--column", "q"]
    message = refused(verb, "replay", approach / "a.csv", "--detector", "level", *columns)
    assert "2 times --column, but signals.right is the only input; join them: i,q" in message


# --- sound ---------------------------------------------------------------------------------------


def envelope():
    """A contact from 2 s to 3.5 s, at 1 kHz."""
    t_s = np.arange(5000) / RATE_HZ
    rng = np.random.default_rng(1)
    on = (t_s >= 2.0) & (t_s < 3.5)
    return REST + STEP * on + 2e-5 * (rng.standard_normal(5000) + 1j * rng.standard_normal(5000))


def sound(path, rate_hz=96_000, drive_hz=DRIVE_HZ, fingers=2):
    """The same as the right finger's sound, silence beside it."""
    times_s = np.arange(5 * rate_hz) / rate_hz
    z = np.interp(times_s, np.arange(5000) / RATE_HZ, envelope())
    right = (z * np.exp(2j * np.pi * drive_hz * times_s)).real
    wavfile.write(path, rate_hz, np.column_stack([right, 0.0 * right][:fingers]).squeeze().astype(np.float32))
    return path


@pytest.mark.parametrize("kind", ["level", "level.paper"])
def test_a_fingers_sound_goes_through_the_chain(verb, tmp_path, kind):
    path = sound(tmp_path / "finger.wav")
    code, out, _ = verb("replay", path, "--detector", kind, "--column", 0)
    lines = [json.loads(line) for line in out.splitlines()]
    assert code == 0
    assert lines[0]["event"] == "Contact"
    assert 2.0 < lines[0]["t_s"] < 2.15
    if kind == "level":
        assert [line["event"] for line in lines] == ["Contact", "ContactHeld", "ContactLost"]
        assert 3.5 < lines[2]["t_s"] < 3.55


def test_a_channel_without_sound_is_no_contact_and_no_result(verb, tmp_path):
    path = sound(tmp_path / "a.wav")
    message = refused(verb, "replay", path, "--detector", "level.paper", "--column", 1)
    # of 5000 samples at 1 kHz, less the chain's window: no 480,000
    assert "nothing was compared with the threshold in 4" in message
    assert "the recording is too short or the sensor is dead" in message
    code, out, err = verb(
        "replay", path, "--detector", "level.paper", "--column", 0, "--set", "threshold=1000"
    )
    assert (code, out) == (0, "")
    assert "found nothing in 4" in err
    assert "of 1e+03 at " in err


def test_a_drive_of_another_frequency_is_set_in_the_chain_and_the_detector(verb, tmp_path):
    path = sound(tmp_path / "finger.wav", drive_hz=39_000.0)
    drive = ["--set", "iq.drive_hz=39000.0", "--set", "drive_hz=39000.0"]
    code, out, _ = verb("replay", path, "--detector", "level", "--column", 0, *drive)
    assert (code, json.loads(out.splitlines()[0])["event"]) == (0, "Contact")
    message = refused(verb, "replay", path, "--detector", "level", "--column", 0, *drive[:2])
    assert "the detector has drive_hz = 40000; set both alike" in message


def test_sound_that_makes_no_envelope_is_refused(verb, tmp_path):
    both = sound(tmp_path / "both.wav")
    assert "choose with --column; there are 0, 1" in refused(verb, "replay", both, "--detector", "level")
    message = refused(verb, "replay", both, "--detector", "level", "--column", "0,1")
    assert "2 channels of sound; choose one finger's" in message
    slow = sound(tmp_path / "slow.wav", rate_hz=48_000, drive_hz=8000.0, fingers=1)
    message = refused(verb, "replay", slow, "--detector", "level")
    assert "48000 frames a second" in message
    assert "record at 96000 Hz" in message
    message = refused(verb, "replay", both, "--detector", "pretouch", "--column", 0)
    assert "the inputs are signals.right and arm.position" in message
    wavfile.write(tmp_path / "short.wav", 96_000, np.zeros(100, np.float32))
    message = refused(verb, "replay", tmp_path / "short.wav", "--detector", "level")
    assert "too short for an envelope" in message


def test_a_setting_of_the_chain_where_there_is_none_is_refused(verb, touched, tmp_path):
    path = sound(tmp_path / "finger.wav", fingers=1)
    message = refused(verb, "replay", path, "--detector", "slip", "--set", "iq.drive_hz=39000.0")
    assert "--set iq.drive_hz: slip takes no envelope of a sound" in message
    message = refused(verb, "replay", path, "--detector", "level", "--set", "iq.drive_khz=39.0")
    assert "--set iq.drive_khz = 39.0: unknown key; SI is meant: drive_hz" in message
