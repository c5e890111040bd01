"""What a certificate says of a sensor whose truth is known."""

import json
import re
from functools import cache

import numpy as np
import pytest
from scipy.io import wavfile

from config.assemble import make_detector
from controller.characterize import SensorRecording, Truth, certificate, differences, page
from drivers.core.messages import SampleBlock

RATE_HZ = 500.0
TOUCHES_S = 21.0 + 1.7 * np.arange(22)


def load_cell(seed=1):
    """A minute of a cell: 6 mN of noise in steps of 5 mN, drift of 6 mN a minute, hum of 20 mN at 50 Hz, touches of
    0.2 N that it shows 4 ms after a hammer."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(30_000) / RATE_HZ
    force = 0.006 * rng.standard_normal(len(t_s)) + 1e-4 * t_s + 0.02 * np.sin(2.0 * np.pi * 50.0 * t_s)
    hammer = 2e-3 * rng.standard_normal(len(t_s))
    for at_s in TOUCHES_S:
        force[(t_s > at_s + 0.003) & (t_s < at_s + 0.3)] += 0.2
        hammer[(t_s > at_s - 0.001) & (t_s < at_s + 0.02)] += 1.0
    return t_s, np.round(force / 0.005) * 0.005, hammer


def block_of(values):
    return [SampleBlock("sensor", 0, 0.0, values[:, None], rate_hz=RATE_HZ, unit="N")]


@cache
def certified(name="cell", seed=1):
    _, force, hammer = load_cell(seed)
    detectors = {"force.threshold": lambda: make_detector("force.threshold", {})}
    recorded = [SensorRecording("cell.log", block_of(force), block_of(hammer))]
    return certificate(recorded, Truth([(0.0, 20.0)]), detectors, name=name, per_newton=2.0)


def test_a_threshold_that_is_given_is_refused_for_it_would_change_nothing(verb, tmp_path):
    np.savez(tmp_path / "cell.npz", x=np.zeros(10))
    code, out, err = verb(
        "characterize", tmp_path / "cell.npz", "--detector", "slip", "--set", "threshold=18"
    )
    assert (code, out) == (2, "")
    assert "--set threshold: characterize finds the thresholds itself" in err


def test_a_certificate_finds_what_was_put_into_a_signal():
    found = certified()
    rows = {row["quantity"]: row for row in found["rows"]}
    assert rows["quantisation"]["value"] == pytest.approx(0.005, rel=0.01)
    assert rows["drift"]["value"] == pytest.approx(0.006, abs=0.003)
    assert rows["mains at 50 Hz, amplitude"]["value"] == pytest.approx(0.02, rel=0.05)
    assert rows["mains at 60 Hz, amplitude"]["value"] is None
    # noise of 6 mN and its rounding, in a band of 250 Hz
    expected = np.hypot(0.006, 0.005 / np.sqrt(12.0)) / np.sqrt(250.0)
    assert rows["noise density at 10 Hz"]["value"] == pytest.approx(expected, rel=0.15)
    assert rows["latency"]["value"] == pytest.approx(4.0, abs=0.1)
    assert rows["latency"]["n"] == found["touches"] == 22
    assert rows["jitter"]["value"] < 1.0
    at = "force.threshold at 100 false alarms an hour: "
    assert rows[f"{at}smallest touch"]["value"] == pytest.approx(rows[f"{at}threshold"]["value"] / 2.0)
    assert rows[f"{at}contact told"]["value"] >= 0.9
    assert 4.0 <= rows[f"{at}contact delay, median"]["value"] <= 12.0
    assert any("slip" in line for line in found["cannot_say"])
    assert not any("all of it was taken for quiet" in line for line in found["cannot_say"])


def test_two_certificates_are_compared_in_the_same_words():
    lines = list(differences(certified(), certified("other", seed=2)))
    assert lines[0] == "cell | other"
    assert any(line.startswith("latency: 4 | 4 ms, x 1") for line in lines)
    shown = page(certified("<cell>"))
    assert re.search(r"<td[^>]*>latency</td>", shown)
    assert "&lt;cell&gt;" in shown
    # the delays of one detector: nine in ten dashed, and an interval of the median at each of three rates
    assert re.search(r"<text[^>]*>force.threshold</text>", shown)
    assert "stroke-dasharray: 3.7" in shown
    intervals = re.search(r'id="[^"]*LineCollection_1".*?</g>', shown, re.DOTALL)
    assert intervals is not None
    assert intervals[0].count("<path") == 3


def test_from_a_loggers_file_to_a_page(verb, tmp_path):
    t_s, force, hammer = load_cell()
    lines = (f"{1e3 * t:.0f}\t{f:.3f}\t{h:.4f}\n" for t, f, h in zip(t_s, force, hammer, strict=True))
    log = tmp_path / "cell.log"
    log.write_text("Logger 3.2\nSerial: 4411, B\n\nTime [ms]\tForce\tHammer\nms\tN\tV\n" + "".join(lines))
    given = ("--column", "Force", "--reference", "Hammer", "--quiet", "0:20", "--out", tmp_path / "cell")
    code, out, err = verb("characterize", log, *given, "--detector", "force.threshold")
    assert code == 0, err
    assert (tmp_path / "cell.html").is_file()
    stored = json.loads((tmp_path / "cell.json").read_text())
    assert stored["touches"] == 22
    assert "cannot say: newtons" not in out, "the line below the names has the units"
    assert "latency: 4 | 4 ms, x 1" in verb("compare", tmp_path / "cell.json", tmp_path / "cell.json")[1]


def test_quiet_outside_of_the_recording_is_told_from_when_to_when_it_goes(verb, tmp_path):
    rows = "".join(f"{10.0 + i / 100:.2f},{i % 7}\n" for i in range(300))
    (tmp_path / "cell.csv").write_text("t_s,F\n" + rows)
    code, _, err = verb("characterize", tmp_path / "cell.csv", "--quiet", "0:2", "--out", tmp_path / "cell")
    assert code != 0
    assert "its times go from 10 to 12.99 s" in err


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t_s,force_N\n", "a.csv: 100 Hz, N; but b.csv: 50 Hz, N"),
        ("t_s,force_V\n", "a.csv: 100 Hz, N; but b.csv: 100 Hz, V"),
        ("t_s,force_N\n0.001,1\n0.0011,2\n0.003,1\n", "b.csv: samples at irregular times"),
    ],
)
def test_recordings_of_two_rates_or_units_are_refused(verb, tmp_path, text, said):
    step_s = 0.02 if "50 Hz" in said else 0.01
    (tmp_path / "a.csv").write_text("t_s,force_N\n" + "".join(f"{k / 100:.2f},{k % 7}\n" for k in range(300)))
    rows = "".join(f"{step_s * (k + 1):.2f},{k % 7}\n" for k in range(300 if text.count("\n") == 1 else 3))
    (tmp_path / "b.csv").write_text(text + rows)
    code, out, err = verb("characterize", tmp_path / "a.csv", tmp_path / "b.csv", "--out", tmp_path / "cell")
    assert (code, out) == (2, "")
    assert said in err
    assert not (tmp_path / "cell.json").exists()


def of_quiet(values, reference=None):
    """The certificate of quiet alone."""
    recorded = SensorRecording("log", block_of(values), () if reference is None else block_of(reference))
    return certificate([recorded], Truth([]), {}, name="log")


@pytest.mark.parametrize(("column", "told"), [("force_N", True), ("F[N]", True), ("counts", False)])
def test_what_reads_in_newtons_needs_no_weight(verb, tmp_path, column, told):
    values = np.random.default_rng(7).standard_normal(2_000)
    lines = "".join(f"{value:.3f}\n" for value in values)
    (tmp_path / "cell.csv").write_text(f"# sample rate: 500 Hz\n{column}\n{lines}")
    options = ("--detector", "force.threshold", "--out", tmp_path / "cell")
    code, out, err = verb("characterize", tmp_path / "cell.csv", *options)
    assert code == 0, err
    assert ("cannot say: newtons" not in out) == told
    rows = {row["quantity"]: row for row in json.loads((tmp_path / "cell.json").read_text())["rows"]}
    at = "force.threshold at 1 false alarms an hour: "
    least_n = rows[f"{at}smallest touch"]["value"]
    assert least_n == (rows[f"{at}threshold"]["value"] if told else None)


def test_what_a_recording_cannot_tell_has_its_row_too():
    """So that two certificates have the same rows."""
    quiet = np.random.default_rng(6).standard_normal(1_000)
    detectors = {"force.threshold": lambda: make_detector("force.threshold", {})}
    found = certificate([SensorRecording("log", block_of(quiet))], Truth([]), detectors, name="log")
    rows = {row["quantity"]: row for row in found["rows"]}
    missing = {"latency", "jitter", "bandwidth of touches", "drift"}
    missing |= {f"force.threshold at {rate} false alarms an hour: smallest touch" for rate in (1, 10, 100)}
    assert {name for name in missing if rows[name]["value"] is None and rows[name]["how"]} == missing
    told = certified()
    known = {row["quantity"] for row in told["rows"] if row["value"] is not None}
    assert known >= missing
    lines = list(differences(found, told))
    assert any(re.match(r"latency: – \| 4 ms$", line) for line in lines)
    assert not any("– | –" in line for line in lines)


def test_what_vibrates_is_not_taken_for_a_sensors_noise():
    """Narrow noise at 30 Hz, each half second about independent: its deviation is known to some ten percent alone."""
    rng = np.random.default_rng(3)
    t_s = np.arange(5_000) / RATE_HZ
    sway = np.repeat(rng.standard_normal((2, 20)), 250, axis=1)
    found = of_quiet(sway[0] * np.cos(60.0 * np.pi * t_s) + sway[1] * np.sin(60.0 * np.pi * t_s))
    (said,) = (line for line in found["cannot_say"] if line.startswith("whose noise it is"))
    assert float(re.findall(r"about (\S+) Hz", said)[0]) == pytest.approx(30.0, abs=2.0), (
        "as wide as half a second makes"
    )
    row = next(row for row in found["rows"] if row["quantity"] == "noise, standard deviation")
    assert row["low"] < 1.0 < row["high"], "the true deviation; white noise's interval would be within 2 %"
    white = of_quiet(rng.standard_normal(len(t_s)))
    assert not any(line.startswith("whose noise") for line in white["cannot_say"])
    row = next(row for row in white["rows"] if row["quantity"] == "noise, standard deviation")
    assert row["high"] - row["low"] == pytest.approx(2 * 1.96 / np.sqrt(2 * len(t_s)), rel=0.3)


def test_a_line_beside_mains_is_not_taken_for_it():
    rng = np.random.default_rng(4)
    t_s = np.arange(1_000) / RATE_HZ
    found = of_quiet(0.1 * np.sin(2.0 * np.pi * 60.55 * t_s) + 1e-3 * rng.standard_normal(len(t_s)))
    (row,) = (row for row in found["rows"] if row["quantity"] == "mains at 60 Hz, amplitude")
    assert row["value"] is None
    assert float(re.findall(r"a line at (\S+) Hz", row["how"])[0]) == pytest.approx(60.55, abs=0.1)


@pytest.mark.parametrize(("seconds", "mains_hz"), [(2.0, 50.0), (10.0, 50.02), (30.0, 50.05), (65.0, 49.73)])
def test_mains_that_is_off_is_found_in_quiet_of_any_length(seconds, mains_hz):
    """Of amplitude 1; in noise of 0.1 no line is told where there is none."""
    rng = np.random.default_rng(11)
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    found = of_quiet(np.sin(2.0 * np.pi * mains_hz * t_s) + 0.1 * rng.standard_normal(len(t_s)))
    at_50, at_60 = (row for row in found["rows"] if row["quantity"].startswith("mains at"))
    assert at_50["value"] == pytest.approx(1.0, abs=0.02)
    assert at_60["value"] is None


@pytest.mark.parametrize("seconds", [2, 10])
def test_nineteen_of_twenty_intervals_of_the_noise_density_have_the_true_one_in_them(seconds):
    """White noise of deviation 1: 2/rate in power. Of 240 at 95 % at least 216 are right in 99.9 of 100 cases."""
    rng, true = np.random.default_rng(21), np.sqrt(2.0 / RATE_HZ)
    found = [of_quiet(rng.standard_normal(round(seconds * RATE_HZ)))["rows"] for _ in range(80)]
    rows = [row for each in found for row in each if row["quantity"].startswith("noise density")]
    right = [row["low"] <= true <= row["high"] for row in rows]
    assert len(right) == 240
    assert 216 <= sum(right) <= 239
    values = [row["value"] for row in rows if row["quantity"] == "noise density at 100 Hz"]
    assert np.mean(values) == pytest.approx(true, rel=0.03)


def touched(touches, seconds=3.0, late_s=0.0, amplitude=0.0, seed=1, reference=True):
    """The rows of noise of deviation 1 with touches of 0.1 s at 50 Hz, `late_s` after those of the reference."""
    rng = np.random.default_rng(seed)
    at_s = seconds + 0.7 * np.arange(1, touches + 1)
    t_s = np.arange(round(RATE_HZ * (at_s[-1] + 1.0))) / RATE_HZ
    values, hammer = rng.standard_normal((2, len(t_s)))
    for begin_s, wait_s in zip(at_s, np.broadcast_to(late_s, touches), strict=True):
        since_s = t_s - begin_s - wait_s
        shakes = (since_s > -0.001) & (since_s < 0.099)
        values[shakes] += amplitude * np.cos(2.0 * np.pi * 50.0 * since_s[shakes])
        hammer[(t_s > begin_s - 0.001) & (t_s < begin_s + 0.02)] += 100.0
    shown = block_of(hammer) if reference else ()
    truth = Truth([(0.0, seconds)], touches=[] if reference else list(at_s))
    found = certificate([SensorRecording("log", block_of(values), shown)], truth, {}, name="log")
    return {row["quantity"]: row for row in found["rows"]}


def test_the_interval_of_a_latency_goes_by_ranks_and_takes_six_touches():
    late_s = [0.010, 0.012, 0.014, 0.016, 0.018, 0.020, 0.030]
    row = touched(7, late_s=late_s, amplitude=100.0)["latency"]
    # seven values: 1/64 lies beyond the least and the largest, 1/8 beyond the next ones
    assert [row["low"], row["value"], row["high"]] == pytest.approx([10.0, 16.0, 30.0])
    row = touched(5, late_s=late_s[:5], amplitude=100.0)["latency"]
    assert (row["value"], row["low"], row["high"]) == (pytest.approx(14.0), None, None)
    assert "takes six" in row["how"]


def test_noise_alone_has_no_bandwidth():
    """Of three touches that nothing shows, at most one in fifty; of one there is none to tell, whatever it shows."""
    told = [touched(3, seed=seed, reference=False)["bandwidth of touches"]["value"] for seed in range(60)]
    assert sum(value is not None for value in told) <= 4, "5 of 60 at 2 % come about once in 125"
    alone = touched(1, amplitude=5.0, reference=False)["bandwidth of touches"]
    assert (alone["value"], alone["n"]) == (None, 1)
    # a Hann window shows five whole periods in three bins of 10 Hz: 208 times the noise in one, 52 in those beside it
    assert touched(3, amplitude=5.0, reference=False)["bandwidth of touches"]["value"] == pytest.approx(60.0)


def test_a_rail_and_a_reference_without_touches_stand_on_the_certificate():
    rng = np.random.default_rng(5)
    values, reference = rng.standard_normal((2, 5_000))
    found = of_quiet(np.minimum(np.where(np.arange(5_000) // 100 == 7, 9.0, values), 9.0), reference)
    assert any("at its rail (9) in 100 samples" in line for line in found["cannot_say"])
    assert any("the reference shows none" in line for line in found["cannot_say"])


def test_events_before_any_quiet_are_named():
    _, force, _ = load_cell()
    detectors = {"force.threshold": lambda: make_detector("force.threshold", {})}
    truth = Truth([(50.0, 59.0)], touches=[21.0, 22.7, 59.5])
    found = certificate([SensorRecording("cell.log", block_of(force))], truth, detectors, name="cell")
    assert any("delays of 2 of 3 events: no quiet comes before them" in line for line in found["cannot_say"])


def test_a_recording_of_which_nothing_is_known_says_where_it_knocks_to_be_pasted(verb, tmp_path):
    """A sound file alone; then the line that was printed, as it stands."""
    rng = np.random.default_rng(3)
    x, at_s = 0.01 * rng.standard_normal(8 * 8000), (3.2, 4.1, 5.3, 6.6, 7.1)
    for t_s in at_s:
        begin = round(8000 * t_s)
        x[begin : begin + 400] += 0.4 * np.exp(-np.arange(400) / 80.0) * np.sin(np.arange(400))
    file = tmp_path / "desk.wav"
    wavfile.write(file, 8000, np.round(32767 * np.clip(x, -1.0, 1.0)).astype(np.int16))
    code, out, err = verb("characterize", file, "--out", tmp_path / "desk")
    assert code == 0, err
    (offered,) = re.findall(r"cannot say: what onset hears in desk.wav: 5 knocks.*?a touch: (.*)", out)
    pasted = offered.split()
    assert [float(each) for each in pasted[3::2]] == pytest.approx(at_s, abs=1e-3)
    assert pasted[1] == "0:3.1"
    code, out, err = verb("characterize", file, *pasted, "--out", tmp_path / "desk")
    assert code == 0, err
    stored = {row["quantity"]: row for row in json.loads((tmp_path / "desk.json").read_text())["rows"]}
    told = stored["onset at 100 false alarms an hour: contact told"]
    assert (told["value"], told["n"]) == (1.0, 5)
    assert "what onset hears" not in out


def test_a_log_of_an_older_windows_with_decimal_commas_and_its_own_words_is_read(verb, tmp_path):
    rng = np.random.default_rng(4)
    rows = (
        f"{k / 80.0:.4f};{v:.4f}\n".replace(".", ",") for k, v in enumerate(0.01 * rng.standard_normal(2400))
    )
    file = tmp_path / "waage.txt"
    file.write_bytes(
        ("Gerät: Wägezelle\nStart: 25.11.2026\n\nZeit;Kraft [N]\n" + "".join(rows)).encode("latin-1")
    )
    code, _, err = verb("characterize", file, "--column", "Kraft [N]", "--out", tmp_path / "cell")
    assert code == 0, err
    assert "2400 samples, 80 Hz" in err
    stored = json.loads((tmp_path / "cell.json").read_text())
    assert (stored["unit"], stored["rate_hz"]) == ("N", 80.0)
