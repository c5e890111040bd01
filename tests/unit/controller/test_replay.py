"""What a file's rows become, and the threshold that they ask for."""

import numpy as np
import pytest
from scipy.io import wavfile

from behaviors.events import SlipStarted
from controller.detectors.calibration import calibrate
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.replay import ReplayError, between, calibration_line, read_blocks, replay
from drivers.messages import SampleBlock

STREAM = "board.tangential"


def csv(path, times_s, values, name="ft_v", form="%.6f"):
    np.savetxt(
        path, np.column_stack([times_s, values]), delimiter=",", header=f"t_s,{name}", comments="", fmt=form
    )
    return path


def shaken(n, seed=1, rate_hz=1000.0):
    """Noise, and in the last second knocks that ring at 180 Hz."""
    rng = np.random.default_rng(seed)
    since_s = np.arange(round(0.2 * rate_hz)) / rate_hz
    ring = np.exp(-34.0 * since_s) * np.sin(2.0 * np.pi * 180.0 * since_s)
    x = 0.003 * rng.standard_normal(n)
    last = round(rate_hz)
    knocks = np.where(rng.random(last) < 200.0 / rate_hz, 0.3 * rng.standard_normal(last), 0.0)
    x[-last:] += np.convolve(knocks, ring)[:last]
    return x


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 4000.0])
def test_times_on_a_grid_give_the_rate_and_are_kept(tmp_path, rate_hz):
    times_s = 2.0 + np.arange(5000) / rate_hz
    (block,) = read_blocks(csv(tmp_path / "a.csv", times_s, np.arange(5000.0)), STREAM)
    assert block.rate_hz == pytest.approx(rate_hz, rel=1e-6)
    assert block.times.tolist() == pytest.approx(times_s.tolist(), abs=1e-6)
    assert block.unit == "V"


def test_missing_rows_are_a_jump_of_the_sequence(tmp_path):
    kept = np.r_[0:100, 130:200]
    first, second = read_blocks(csv(tmp_path / "a.csv", kept / 1000.0, kept), STREAM)
    assert (first.seq, len(first), second.seq, len(second)) == (0, 100, 130, 70)
    assert second.t0_s == pytest.approx(0.130)
    assert second.values[0, 0] == 130.0
    assert second.rate_hz == pytest.approx(1000.0)


def test_times_on_no_grid_stay_as_they_are_and_a_rate_replaces_them(tmp_path):
    times_s = np.cumsum(np.random.default_rng(1).uniform(0.5, 1.5, 300)) / 1000.0
    path = csv(tmp_path / "a.csv", times_s, np.zeros(300), form="%.9f")
    (block,) = read_blocks(path, STREAM)
    assert block.rate_hz is None
    with pytest.raises(ReplayError, match="irregular times while detecting slip"):
        list(replay([block], SlipDetector("slip", SlipSettings())))
    (block,) = read_blocks(path, STREAM, rate_hz=1000.0)
    assert (block.rate_hz, block.times_s) == (1000.0, None)
    assert block.t0_s == pytest.approx(times_s[0])


def test_periods_are_never_taken_for_samples(tmp_path):
    times_s = np.arange(1, 100) / 28.0
    (block,) = read_blocks(csv(tmp_path / "a.csv", times_s, np.full(99, 1 / 28.0), name="period_s"), STREAM)
    assert block.rate_hz is None


@pytest.mark.parametrize("kind", ["csv", "npz", "wav"])
@pytest.mark.parametrize("rate_hz", [1000, 2000, 8000])
def test_slip_is_found_in_every_kind_of_file_at_any_rate(tmp_path, kind, rate_hz):
    from scipy.io import wavfile

    n = 4 * rate_hz
    x = shaken(n, rate_hz=rate_hz)
    path, given = tmp_path / f"drag.{kind}", {}
    if kind == "csv":
        csv(path, np.arange(n) / rate_hz, x, form="%.9f")
    elif kind == "npz":
        np.savez(path, ft_v=x)
        given = {"rate_hz": float(rate_hz)}
    else:
        wavfile.write(path, rate_hz, x.astype(np.float32))
    blocks = read_blocks(path, STREAM, **given)
    for detector in (
        SlipDetector("slip", SlipSettings()),
        SlipPaperDetector("paper", SlipPaperSettings(threshold=1.0)),
    ):
        events = list(replay(blocks, detector))
        assert type(events[0]) is SlipStarted
        assert 3.0 < events[0].t_s < 3.2


def test_a_recording_is_cut_with_its_sequence_and_times(tmp_path):
    blocks = read_blocks(csv(tmp_path / "a.csv", np.arange(100) / 1000.0, np.arange(100.0)), STREAM)
    (block,) = between(blocks, 0.040)
    assert (block.seq, len(block), block.values[0, 0]) == (40, 60, 40.0)
    assert block.rate_hz == pytest.approx(1000.0)


# --- calibration ---------------------------------------------------------------------------------


def noise_blocks(n=120_000, size=1000, seed=2, spoiled=None):
    x = np.random.default_rng(seed).standard_normal((n, 1))
    if spoiled is not None:
        x[spoiled] = np.nan
    return [
        SampleBlock(STREAM, at, at / 1000.0, x[at : at + size], rate_hz=1000.0) for at in range(0, n, size)
    ]


def test_a_threshold_is_the_same_from_blocks_and_from_the_whole():
    blocks = noise_blocks()
    whole = np.concatenate([block.physical for block in blocks])
    detector = SlipPaperDetector("paper", SlipPaperSettings())
    line = calibration_line(blocks, detector, "slip.paper", 10.0)
    expected = calibrate(detector, whole, 1000.0, 10.0)
    assert line["threshold"] == expected.threshold
    assert line["threshold_low"] < line["threshold"] < line["threshold_high"]
    assert (line["detector"], line["extrapolated"], line["recording_s"]) == ("slip.paper", False, 120.0)
    assert line["false_alarm_interval_s"] == 10.0


def test_an_interval_longer_than_the_recording_is_extrapolated_and_says_so():
    line = calibration_line(noise_blocks(), SlipPaperDetector("p", SlipPaperSettings()), "slip.paper", 3600.0)
    assert line["extrapolated"] is True
    assert line["threshold_low"] < line["threshold"] < line["threshold_high"]


def test_what_it_learns_from_is_not_counted_as_quiet():
    """Two times half a second: the first whole second says nothing."""
    line = calibration_line(noise_blocks(), SlipDetector("s", SlipSettings()), "slip", 10.0)
    assert line["recording_s"] == 119.0


def test_the_scale_of_raw_counts_is_heeded():
    counts = [
        SampleBlock(b.stream, b.seq, b.t0_s, np.rint(1e4 * b.values).astype(np.int32), 1000.0, scale=1e-4)
        for b in noise_blocks()
    ]
    found = [
        calibration_line(blocks, SlipPaperDetector("p", SlipPaperSettings()), "slip.paper", 10.0)["threshold"]
        for blocks in (noise_blocks(), counts)
    ]
    assert found[1] == pytest.approx(found[0], rel=1e-3)


def test_lost_samples_are_a_gap_and_not_a_step():
    blocks = noise_blocks()
    lossy = [
        SampleBlock(b.stream, b.seq, b.t0_s, b.values + (500.0 if b.seq >= 60_000 else 0.0), b.rate_hz)
        for b in blocks
        if b.seq != 60_000
    ]
    detector = SlipPaperDetector("p", SlipPaperSettings())
    whole, gapped = (calibration_line(each, detector, "slip.paper", 10.0) for each in (blocks, lossy))
    # an offset after the gap would be a spectrum of its own in the block that straddles it
    assert gapped["threshold"] == pytest.approx(whole["threshold"], rel=0.2)


@pytest.mark.parametrize(
    ("blocks", "said"),
    [
        (noise_blocks(spoiled=5000), r"a value at 5 s is not finite"),
        (noise_blocks(20_000), r"20 s in which the detector decides are too few; record 40 s or more"),
        ([], r"holds no sample"),
        (noise_blocks()[:10] + noise_blocks()[:10], r"begins anew"),
        (noise_blocks()[::3], r"samples are missing"),
        (
            [SampleBlock(STREAM, 0, 0.0, np.zeros((60_000, 1)), rate_hz=1000.0)],
            r"threshold of 0, which is none",
        ),
        (
            [SampleBlock(STREAM, 0, 0.0, np.zeros((3, 1)), times_s=np.array([0.0, 0.1, 0.3]))],
            r"irregular times .* --rate HZ",
        ),
    ],
)
def test_a_recording_that_says_nothing_is_refused_in_one_line(blocks, said):
    with pytest.raises(ReplayError, match=said) as refused:
        calibration_line(blocks, SlipPaperDetector("p", SlipPaperSettings()), "slip.paper", 10.0)
    assert str(refused.value).startswith("slip.paper: ")
    assert "\n" not in str(refused.value)


def test_a_file_that_is_damaged_or_ambiguous_is_refused_in_one_line(tmp_path):
    def made(name, content):
        (tmp_path / name).write_bytes(content)
        return tmp_path / name

    def refused(path, says):
        with pytest.raises(ReplayError, match=says) as error:
            read_blocks(path, STREAM, rate_hz=1000.0)
        assert str(path) in str(error.value)

    refused(
        made("cut.wav", b"RIFF\x24\x08\0\0WAVEfmt \x10\0\0\0\x01\0\x02\0"), "no WAV file that can be read"
    )
    wavfile.write(tmp_path / "none.wav", 1000, np.zeros((0, 1), np.int16))
    refused(tmp_path / "none.wav", "has no rows")
    refused(made("twice.csv", b"a,a\n1,2\n"), "two columns are called 'a'")
    refused(made("empty.csv", b""), "has no rows")
    for times in (b"0\n1e-320\n2e-320\n", b"0\n1e-10\n1\n", b"0\n1\n1e300\n"):
        refused(
            made("times.csv", b"t_s,a\n" + times.replace(b"\n", b",1\n")), "seconds that rise from row to row"
        )
    refused(made("no.npz", b"PK\x03\x04 and no more"), "no NPZ file of numbers")
    np.savez(tmp_path / "complex.npz", a=np.array([1j, 2.0]))
    refused(tmp_path / "complex.npz", "no NPZ file of numbers")
