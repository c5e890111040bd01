"""Thresholds from a minute at rest on the bench, written into the lab's own profile."""

import errno
import stat
import tomllib
from datetime import date

import pytest

from controller.detectors.slip import SlipDetector
from tests.refusals import check_refusal

LAB = """# our bench
extends = "mock/slip"

[detectors]          # of the fingertip
touch_fingertip.threshold = "? run.py quiet"
fingertip_ours.threshold = 3.0      # a guess

[loop]
rate_hz = 50.0

[trials]
list = [{ sensor = "fingertip" }]   # what the tip carries
"""


@pytest.fixture
def lab(tmp_path):
    path = tmp_path / "lab.toml"
    path.write_text(LAB)
    return path


def thresholds(path):
    return {name: each["threshold"] for name, each in tomllib.loads(path.read_text())["detectors"].items()}


def test_quiet_writes_what_is_not_set_or_stands_in_the_file_and_leaves_all_else(verb, lab):
    code, out, err = verb("quiet", lab, "--seconds", "12")
    assert (code, err) == (0, "")
    assert thresholds(lab).keys() == {"touch_fingertip", "fingertip_ours"}
    # 0.02 N of noise: six deviations of its mean at the least, and far below the 0.3 N of a touch
    assert 0.02 < thresholds(lab)["touch_fingertip"] < 0.1
    assert 4.0 < thresholds(lab)["fingertip_ours"] < 12.0
    kept = [line for line in LAB.splitlines() if "threshold" not in line]
    written = lab.read_text().splitlines()
    assert [line for line in written if "threshold" not in line] == kept
    assert all(
        f"# quiet, {date.today()}" in line and "(95 %), n = 11.5 s, asked: a false alarm in 3600 s" in line
        for line in written
        if "touch_fingertip.threshold" in line
    )
    # the paper's stays as the paper prints it, unless it is named
    assert "fingertip_paper: stays as it is set elsewhere, 10" in out
    code, _, _ = verb("quiet", lab, "--seconds", "12", "--detector", "fingertip_paper")
    assert code == 0
    assert 0.0 < thresholds(lab)["fingertip_paper"] < 1.0
    assert verb("check", lab)[0] == 0


def test_the_threshold_alarms_as_rarely_as_was_asked(verb, lab, monkeypatch):
    heard = []
    plain = SlipDetector.statistic
    monkeypatch.setattr(SlipDetector, "statistic", lambda *given: heard.append(plain(*given)) or heard[-1])
    code, _, _ = verb("quiet", lab, "--seconds", "30", "--false-alarm-interval", "3")
    assert code == 0
    seconds = heard[0][1000:].reshape(-1, 1000)[:28]
    alarms = sum((second >= thresholds(lab)["fingertip_ours"]).any() for second in seconds)
    assert 4 <= alarms <= 17  # ten were asked for in half a minute (Poisson, 95 %)


def test_a_dry_run_shows_and_writes_nothing(verb, lab):
    code, out, _ = verb("quiet", lab, "--seconds", "12", "--dry-run")
    assert code == 0
    assert "touch_fingertip: threshold = 0.0" in out
    assert "expected" in out
    assert lab.read_text() == LAB


def test_a_disk_that_is_full_leaves_the_profile_as_it_was(verb, lab, monkeypatch):
    def full(self, *_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr("controller.recording.run_folder.os.fsync", full)
    code, out, err = verb("quiet", lab, "--seconds", "12")
    assert code == 2
    check_refusal(err, str(lab), "No space left on device", "it is as it was")
    assert f"{lab}: [detectors" not in out
    assert lab.read_text() == LAB
    assert [path.name for path in lab.parent.iterdir()] == [lab.name]


def test_a_link_to_the_profile_stays_one_and_its_mode_too(verb, lab):
    lab.chmod(0o640)
    link = lab.with_name("link.toml")
    link.symlink_to(lab.name)
    assert verb("quiet", link, "--seconds", "12")[0] == 0
    assert link.is_symlink()
    assert stat.S_IMODE(lab.stat().st_mode) == 0o640
    assert thresholds(lab)["touch_fingertip"] > 0.0


def test_what_rest_alone_cannot_set_is_named_with_what_can(verb):
    slowly = ("--dry-run", "--set", "loop.rate_hz=50.0")
    code, out, _ = verb("quiet", "mock/touch", "--seconds", "10", *slowly)
    assert code == 0
    for name in ("pretouch_paper", "pretouch_ours"):
        (line,) = [line for line in out.splitlines() if line.startswith(name)]
        check_refusal(line, "no threshold from rest", "moves", "calibrate")
    code, out, _ = verb(
        "quiet", "mock/transient", "--seconds", "20", *slowly, "--set", "behavior.settle_s=30.0"
    )
    assert code == 0
    (line,) = [line for line in out.splitlines() if line.startswith("contact:")]
    check_refusal(line, "no threshold from rest", "baseline")
    assert "ours: threshold = " in out


def test_a_shipped_profile_is_not_written_to(verb):
    for name in ("hardware/slip", "config/profiles/mock/slip.toml"):
        code, _, err = verb("quiet", name)
        assert code == 2
        check_refusal(err, name, "extends", "--dry-run")


def test_only_ports_and_what_signals_are_made_with_must_be_set(verb):
    code, _, err = verb("quiet", "hardware/slip", "--dry-run")
    assert code == 2
    lines = err.splitlines()
    assert [line.partition("] ")[2].split()[0] for line in lines] == ["port", "port", "gain_v_n"]


@pytest.mark.parametrize(
    ("fault", "code", "named"),
    [
        (
            '[{ device = "board", kind = "full_scale", at_s = 8.0 }]',
            1,
            ("not at rest", "signals.tip is beyond its range"),
        ),
        ('[{ device = "arm", kind = "silent", at_s = 5.0 }]', 3, ("arm",)),
    ],
)
def test_a_bench_that_is_not_at_rest_sets_nothing(verb, lab, fault, code, named):
    ended, _, err = verb("quiet", lab, "--seconds", "12", "--set", f"faults={fault}")
    assert ended == code
    check_refusal(err.splitlines()[0], *named)
    assert lab.read_text() == LAB


def test_trials_without_a_detector_have_no_threshold(verb):
    code, _, err = verb("quiet", "mock/chirp", "--dry-run")
    assert code == 2
    check_refusal(err, "mock/chirp", "arm no detector")
