"""Thresholds from recordings, on the command line."""

import json
import re

import numpy as np
import pytest

from run import cli
from tests.refusals import check_refusal


@pytest.fixture
def rolling(tmp_path):
    """Two minutes without slip at 1 kHz, two columns."""
    noise = 0.003 * np.random.default_rng(1).standard_normal((120_000, 2))
    np.savez(tmp_path / "rolling.npz", ft_v=noise[:, 0], fx_v=3.0 * noise[:, 1])
    return tmp_path / "rolling.npz"


@pytest.mark.parametrize("kind", ["slip", "slip.paper"])
def test_a_recording_without_slip_gives_one_json_line(verb, rolling, kind):
    asked = f"--detector {kind} --column ft_v --rate 1000 --false-alarm-interval 15"
    code, out, err = verb("calibrate", rolling, *asked.split())
    assert code == 0
    assert all("no gaps" in line or "left out" in line or "extrapolated" in line for line in err.splitlines())
    (line,) = out.splitlines()
    found = json.loads(line)
    assert list(found) == [
        *("detector", "threshold", "threshold_low", "threshold_high", "false_alarm_interval_s"),
        *("recording_s", "sees_s", "extrapolated", "pieces"),
        *("checked_interval_s", "checked_expected", "checked_found"),
    ]
    assert (found["detector"], found["false_alarm_interval_s"], found["extrapolated"]) == (kind, 15.0, False)
    assert 0.0 < found["threshold_low"] <= found["threshold"] <= found["threshold_high"]


def test_the_threshold_alarms_as_often_on_the_recording_as_was_asked_for(verb, rolling):
    recording = [rolling, "--detector", "slip.paper", "--column", "ft_v", "--rate", 1000]
    found = json.loads(verb("calibrate", *recording, "--false-alarm-interval", 12)[1])
    code, out, _ = verb("replay", *recording, "--set", f"threshold={found['threshold']}")
    alarms = [json.loads(line) for line in out.splitlines() if "SlipStarted" in line]
    assert code == 0
    # 120 s / 12 s are ten; the tenth largest second is the threshold itself and does not exceed it
    assert len({int(alarm["t_s"]) for alarm in alarms}) == 9


def test_what_a_recording_cannot_carry_is_said_and_how_it_held_on_what_was_left_out(verb, rolling):
    given = ["--detector", "slip.paper", "--column", "ft_v", "--rate", 1000]
    _, out, err = verb("calibrate", rolling, *given, "--false-alarm-interval", 600)
    found = json.loads(out)
    more_s = 5 * 600 - found["recording_s"]
    assert f"one in 600 s is extrapolated: record {more_s:.4g} s more" in err
    (times,) = map(float, re.findall(r"was asked for: (\S+) times as many \(95 %: ", err))
    assert times == pytest.approx(found["checked_found"] / found["checked_expected"], rel=0.05)
    _, _, err = verb("calibrate", rolling, *given, "--false-alarm-interval", 12)
    assert "is extrapolated" not in err


def test_the_input_begins_at_the_baselines_start(verb, rolling):
    arguments = ["calibrate", rolling, "--detector", "slip.paper", "--column", "ft_v", "--rate", 1000]
    code, out, _ = verb(*arguments, "--false-alarm-interval", 10, "--baseline", "20:21")
    assert (code, json.loads(out)["recording_s"]) == (0, 100.0)


@pytest.mark.parametrize(
    ("arguments", "named"),
    [
        (["slip", "--column", "ft_v"], "--rate HZ"),
        (["slip", "--rate", "1000"], "there are ft_v, fx_v"),
        (["slip", "--column", "ft_v", "--rate", "0"], "--rate"),
        (["slip", "--column", "ft_v", "--rate", "nan"], "nan is no number"),
        (["slip", "--column", "ft_v", "--false-alarm-interval", "inf"], "inf is not in the range"),
        (["slip", "--column", "ft_v", "--set", "threshold=nan"], "threshold = NaN"),
        (["slop", "--column", "ft_v", "--rate", "1000"], "did you mean 'slip'?"),
        (["slip.paper", "--column", "ft_v", "--rate", "1000", "--set", "block_s=0.001"], "no frequency"),
        (["slip", "--column", "ft_v", "--rate", "1000", "--set", "channel=3"], "no channel 3"),
        (["resonance.paper", "--column", "ft_v", "--rate", "1000"], "slip.paper"),
    ],
)
def test_a_mistake_is_one_line_and_exit_code_2(verb, rolling, arguments, named):
    code, out, err = verb("calibrate", rolling, "--false-alarm-interval", 10, "--detector", *arguments)
    assert (code, out) == (2, "")
    check_refusal(err, named)


@pytest.fixture
def way(tmp_path):
    """Two minutes to and fro before nothing: noise in I and Q, and the mover's position."""
    i, q = 0.09 + 5e-5 * np.random.default_rng(3).standard_normal((2, 120_000))
    x_m = np.abs((np.arange(120_000) * 1e-5 + 0.02) % 0.08 - 0.04)
    np.savez(tmp_path / "way.npz", i_fs=i, q_fs=q, x_m=x_m)
    return [tmp_path / "way.npz", "--rate", 1000, "--column", "i_fs,q_fs"]


def test_pre_touch_is_calibrated_on_i_q_and_position(verb, way):
    recording = [*way, "--column", "x_m", "--detector", "pretouch"]
    code, out, err = verb("calibrate", *recording, "--false-alarm-interval", 12)
    assert code == 0
    assert all("no gaps" in line or "left out" in line or "extrapolated" in line for line in err.splitlines())
    found = json.loads(out)
    assert found["recording_s"] == 119.0  # of 120 s; the first 5 mm, at 1 cm/s, decide nothing
    assert found["background_fs"] < 5e-5  # of full scale: there is no wave but noise
    own = [f"--set={name}={found[name]}" for name in ("threshold", "background_fs")]
    code, out, _ = verb("replay", *recording, *own)
    seen = [json.loads(line) for line in out.splitlines()]
    alarms = {int(line["t_s"]) for line in seen if line["event"] == "PreTouch"}
    # ten are asked for; the tenth is the threshold itself, and one alarm may outlast the next second's
    assert code == 0
    assert 5 <= len(alarms) <= 9


def test_a_position_in_millimetres_gives_the_threshold_of_metres_and_what_is_none_is_refused(verb, way):
    path = way[0]
    arrays = np.load(path)
    asked = ["--detector", "pretouch", "--false-alarm-interval", 12]
    found = json.loads(verb("calibrate", *way, "--column", "x_m", *asked)[1])
    others = {"x_mm": 1e3 * arrays["x_m"], "x_rad": arrays["x_m"]}
    np.savez(path, i_fs=arrays["i_fs"], q_fs=arrays["q_fs"], **others)
    line = json.loads(verb("calibrate", *way, "--column", "x_mm", *asked)[1])
    assert line["threshold"] == pytest.approx(found["threshold"], rel=1e-6)
    assert line["background_fs"] == pytest.approx(found["background_fs"], rel=1e-6)
    for name in ("calibrate", "replay"):
        options = asked if name == "calibrate" else asked[:2]
        code, out, err = verb(name, *way, "--column", "x_rad", *options)
        assert (code, out) == (2, "")
        check_refusal(err, "arm.position: rad is no position", "in m")


def test_a_background_that_is_given_is_not_proposed(verb, way):
    asked = [*way, "--column", "x_m", "--detector", "pretouch", "--false-alarm-interval", 12]
    given = json.loads(verb("calibrate", *asked, "--set", "background_fs=1e-4")[1])
    assert "background_fs" not in given
    assert given["threshold"] < json.loads(verb("calibrate", *asked)[1])["threshold"]


def test_a_detector_of_two_streams_is_not_calibrated_on_one(verb, way):
    code, out, err = verb("calibrate", *way, "--detector", "pretouch", "--false-alarm-interval", 15)
    assert (code, out) == (2, "")
    assert "the inputs are signals.right and arm.position" in err


@pytest.fixture(scope="module")
def run_folder(tmp_path_factory):
    """A trial with a baseline of a minute: so long nothing touches the load cell."""
    out = tmp_path_factory.mktemp("runs")
    settings = [
        "behavior.settle_s=2.0",
        "behavior.baseline_timeout_s=70.0",
        "detectors.contact.baseline_s=60.0",
    ]
    arguments = ["run", "mock/transient", "--only", "16", "--no-report", "--out", str(out)]
    with pytest.raises(SystemExit):
        cli.main([*arguments, *(part for each in settings for part in ("--set", each))], prog_name="run.py")
    (folder,) = out.iterdir()
    return folder


LOAD_CELL = ["--detector", "slip.paper", "--set", "input=board.load_cell"]


def test_a_run_folder_is_calibrated_like_a_file(verb, run_folder):
    code, out, err = verb("calibrate", run_folder, *LOAD_CELL, "--false-alarm-interval", 5)
    assert code == 0
    assert all("no gaps" in line or "left out" in line or "extrapolated" in line for line in err.splitlines())
    found = json.loads(out)
    assert found["recording_s"] > 40.0
    assert 0.0 < found["threshold_low"] < found["threshold"] < found["threshold_high"]


def test_a_run_folder_is_replayed_by_channel(verb, run_folder):
    code, out, err = verb("replay", run_folder, *LOAD_CELL, "--set", "threshold=1e-12", "--column", 0)
    assert (code, err.count("no gaps")) == (0, err.count("\n"))
    assert json.loads(out.splitlines()[0])["event"] == "SlipStarted"
    code, _, err = verb("replay", run_folder, *LOAD_CELL, "--column", 7)
    assert code == 2
    assert "board.load_cell has no channel 7; there are 0 to 0" in err


def test_from_a_table_to_a_threshold_and_a_picture_in_two_commands(verb, tmp_path):
    """Milliseconds, semicolons, a comment and five columns, as a lab's own program writes them."""
    rng = np.random.default_rng(4)
    x = 0.003 * rng.standard_normal(40_000)
    x[30_000:31_000] += 0.05 * rng.standard_normal(1000)
    table = np.column_stack([np.arange(40_000) * 0.5, x, x, x, x])
    path = tmp_path / "drag.csv"
    np.savetxt(path, table, delimiter=";", header="# a lab\nt_ms;a;b;c;d", comments="", fmt="%.6g")
    asked = "--detector slip.paper --column b --span 0:7 --span 7:14 --false-alarm-interval 60"
    code, out, err = verb("calibrate", path, *asked.split())
    assert (code, json.loads(out)["pieces"]) == (0, 2)
    assert "40000 samples, 2000 Hz, 19.9995 s, no gaps, no unit; times from t_ms" in err
    threshold = json.loads(out)["threshold_high"]
    asked = f"--detector slip.paper --column b --set threshold={threshold} --plot {tmp_path / 'drag.png'}"
    code, out, err = verb("replay", path, *asked.split())
    assert code == 0
    assert 15.0 <= json.loads(out.splitlines()[0])["t_s"] <= 15.2
    assert (tmp_path / "drag.png").stat().st_size > 10_000


def sensor(path, spoil):
    """A minute of noise at 1 kHz with times, spoiled."""
    x = 0.003 * np.random.default_rng(6).standard_normal(60_000)
    spoil(x)
    np.savez(path, t_s=np.arange(60_000) / 1000.0, x=x)
    return [path, "--detector", "slip", "--false-alarm-interval", 10]


def test_a_value_that_is_not_finite_is_named_with_its_file_and_spans_around_it_hold(verb, tmp_path):
    asked = sensor(tmp_path / "hole.npz", lambda x: x.__setitem__(28_000, np.nan))
    code, out, err = verb("calibrate", *asked)
    assert (code, out) == (2, "")
    check_refusal(err, "hole.npz", "at 28 s", "--span")
    assert verb("calibrate", *asked, "--span", "0:27.9", "--span", "28.1:60")[0] == 0


def test_a_recording_with_events_is_told_from_a_quiet_one(verb, tmp_path):
    rng = np.random.default_rng(7)

    def slips(x):
        for at in range(5500, 60_000, 6000):
            x[at : at + 500] += 0.1 * rng.standard_normal(500)

    said = "slip's own threshold of 25 is reached in"
    code, _, err = verb("calibrate", *sensor(tmp_path / "slips.npz", slips))
    assert code == 0
    assert said in err
    assert "--span" in err
    assert said not in verb("calibrate", *sensor(tmp_path / "quiet.npz", lambda x: None))[2]
