"""What a file's rows become, and the threshold that they ask for."""

import io
import json
import re
import tracemalloc
from dataclasses import replace
from zipfile import ZipFile

import numpy as np
import pytest
import soundfile
import zstandard
from mcap.writer import CompressionType, Writer
from scipy.io import savemat, wavfile

from behaviors.events import BaselineReady, SlipStarted
from config.assemble import make_detector
from controller.detectors.calibration import span_maxima, threshold_for
from controller.detectors.resonance_paper import ResonancePaperDetector, ResonancePaperSettings
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from controller.recording.mcap_file import McapWriter
from controller.recording.series import TrialRecording
from controller.recording.tables import ReplayError, read_columns
from controller.replay import (
    at_rail,
    between,
    calibration_line,
    enveloped,
    nearest,
    own_detectors,
    read_blocks,
    regular,
    replay,
)
from controller.replay_plot import draw
from controller.signals.iq import IqSettings
from drivers.core.messages import SampleBlock
from tests.refusals import refused

STREAM = "board.tangential"


def csv(path, times_s, values, name="ft_v", form="%.6f"):
    table = np.column_stack([times_s, values])
    np.savetxt(path, table, delimiter=",", header=f"t_s,{name}", comments="", fmt=form)
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


def test_missing_rows_are_a_jump_of_the_sequence_and_a_cut_keeps_sequence_and_times(tmp_path):
    kept = np.r_[0:100, 130:200]
    first, second = read_blocks(csv(tmp_path / "a.csv", kept / 1000.0, kept), STREAM)
    assert (first.seq, len(first), second.seq, len(second)) == (0, 100, 130, 70)
    assert second.t0_s == pytest.approx(0.130)
    assert second.values[0, 0] == 130.0
    assert second.rate_hz == pytest.approx(1000.0)
    (block, _) = between([first, second], 0.040)
    assert (block.seq, len(block), block.values[0, 0]) == (40, 60, 40.0)
    assert block.rate_hz == pytest.approx(1000.0)


def test_times_on_no_grid_stay_as_they_are_and_a_rate_replaces_them(tmp_path):
    times_s = np.cumsum(np.random.default_rng(1).exponential(size=300)) / 1000.0
    path = csv(tmp_path / "a.csv", times_s, np.zeros(300), form="%.9f")
    (block,) = read_blocks(path, STREAM)
    assert block.rate_hz is None
    with pytest.raises(ReplayError, match="irregular times while detecting slip"):
        list(replay([block], SlipDetector("slip", SlipSettings())))
    (block,) = read_blocks(path, STREAM, rate_hz=1000.0)
    assert (block.rate_hz, block.times_s) == (1000.0, None)
    assert block.t0_s == pytest.approx(times_s[0])


def test_periods_are_never_taken_for_samples_and_a_rate_beside_the_arrays_of_a_file_is_taken(tmp_path):
    times_s = np.arange(1, 100) / 28.0
    (block,) = read_blocks(csv(tmp_path / "a.csv", times_s, np.full(99, 1 / 28.0), name="period_s"), STREAM)
    assert block.rate_hz is None
    np.savez(tmp_path / "log.npz", force=np.arange(100.0), fs=2000)
    savemat(tmp_path / "log.mat", {"force": np.arange(100.0), "info": {"sample_rate": 2000.0}})
    for name in ("log.npz", "log.mat"):
        (block,) = read_blocks(tmp_path / name, "sensor")
        assert block.rate_hz == 2000.0


@pytest.mark.parametrize("kind", ["csv", "npz", "wav"])
@pytest.mark.parametrize("rate_hz", [1000, 2000, 8000])
def test_slip_is_found_in_every_kind_of_file_at_any_rate(tmp_path, kind, rate_hz):
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
    paper = SlipPaperDetector("paper", SlipPaperSettings(threshold=1.0))
    for detector in (SlipDetector("slip", SlipSettings()), paper):
        events = [e for e in replay(blocks, detector) if not isinstance(e, BaselineReady)]
        assert type(events[0]) is SlipStarted
        assert 3.0 < events[0].t_s < 3.2


def test_times_that_wander_are_resampled_which_is_reported_and_a_gap_in_them_stays_one(tmp_path):
    rng = np.random.default_rng(1)
    times_s = np.arange(5000) / 1000.0 + rng.uniform(-3e-4, 3e-4, 5000)
    notes = []
    path = csv(tmp_path / "a.csv", times_s, np.sin(2.0 * np.pi * 20.0 * times_s), form="%.9f")
    (block,) = read_blocks(path, STREAM, notes=notes)
    assert block.rate_hz == pytest.approx(1000.0, rel=1e-3)
    assert np.abs(block.values[5:-5, 0] - np.sin(2.0 * np.pi * 20.0 * block.times[5:-5])).max() < 2e-3
    assert re.search(r"a.csv: ft_v: 5\d\d\d samples, .* no gaps, V; .* resampled, .* 0\.\d+ ms", notes[0])
    kept = np.r_[0:1000, 1500:3000]
    first, second = read_blocks(csv(tmp_path / "a.csv", times_s[kept], kept, form="%.9f"), STREAM)
    assert second.seq - first.seq - len(first) == pytest.approx(500, abs=2)
    assert second.t0_s == pytest.approx(1.5, abs=1e-3)


@pytest.mark.parametrize("first", [0, 1])
@pytest.mark.parametrize("rows", [2000, 2001])
@pytest.mark.parametrize("rate_hz", [400.0, 440.0, 450.0])
def test_samples_whose_times_were_rounded_to_milliseconds_are_kept_as_they_are(rate_hz, rows, first):
    """Steps of 2 and 3 ms, whose median is either by chance; and with rows missing, one in forty or 300 in a row."""
    places = np.arange(first, first + rows)
    values = np.sin(places)[:, None]
    times_s = np.round(1e3 * places / rate_hz) / 1e3
    found = regular(times_s, values)
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-5), "better than a millisecond in 5 s"
    ((seq, piece, at_s),) = found.pieces
    assert seq == 0
    assert np.array_equal(piece, values)
    assert np.array_equal(at_s, times_s)
    for lost in (slice(20, None, 40), slice(500, 800)):
        kept = np.delete(np.arange(rows), lost)
        with_gaps = regular(times_s[kept], values[kept])
        numbers = np.concatenate([seq + np.arange(len(piece)) for seq, piece, _ in with_gaps.pieces])
        assert np.array_equal(numbers, kept)
        assert not with_gaps.resampled


def numbers_of(found):
    return np.concatenate([seq + np.arange(len(piece)) for seq, piece, _ in found.pieces])


@pytest.mark.parametrize("rounding", [np.floor, np.rint])
@pytest.mark.parametrize("rate_hz", [300.0, 400.0, 600.0, 700.0, 800.0, 900.0, 1200.0, 1700.0, 2500.0])
def test_a_rate_in_whole_milliseconds_is_that_of_the_span_whatever_the_usual_step_is(rate_hz, rounding):
    places = np.arange(3000)
    values = np.sin(places)[:, None]
    times_s = 90.0 + 1e-3 * rounding(1e3 * places / rate_hz + 0.01)
    found = regular(times_s, values)
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-5)
    ((seq, piece, at_s),) = found.pieces
    assert seq == 0
    assert np.array_equal(piece, values)
    assert np.abs(at_s - 90.0 - places / rate_hz).max() < 1.1e-3
    assert (np.diff(at_s) > 0.0).all()
    kept = np.delete(places, np.r_[700:760, 1500:1520])
    with_gaps = regular(times_s[kept], values[kept])
    assert with_gaps.rate_hz == pytest.approx(rate_hz, rel=1e-4)
    assert len(with_gaps.pieces) == 3
    assert np.abs(numbers_of(with_gaps) - kept).max() <= (1 if rate_hz > 1000.0 else 0)


@pytest.mark.parametrize("rate_hz", [953.0, 965.3, 978.1, 990.4, 996.45])
def test_a_rate_a_little_below_a_thousand_hertz_in_whole_milliseconds_is_that_rate(rate_hz):
    places = np.arange(10_000)
    found = regular(1e-3 * np.floor(1e3 * places / rate_hz), np.sin(places)[:, None])
    assert found.rate_hz == pytest.approx(rate_hz, rel=1e-5)
    assert len(found.pieces) == 1


@pytest.mark.parametrize("seed", range(5))
def test_a_thousand_hertz_with_rows_missing_is_that_however_they_are_missing(seed):
    rng, places = np.random.default_rng(seed), np.arange(3000)
    for lost in (
        slice(30, None, 40),
        slice(500, 512),
        rng.choice(places[1:-1], 30, replace=False),
        rng.choice(places[1:-1], 600, replace=False),
    ):
        kept = np.delete(places, lost)
        found = regular(kept / 1000.0, np.zeros((len(kept), 1)))
        assert found.rate_hz == pytest.approx(1000.0, rel=1e-9)
        assert np.array_equal(numbers_of(found), kept)


def test_times_that_repeat_are_read_where_they_are_those_of_a_steady_rate(tmp_path):
    places = np.arange(400)
    steady, burst = tmp_path / "steady.csv", tmp_path / "burst.csv"
    steady.write_text("t_ms,a\n" + "".join(f"{int(k / 1.2)},{k}\n" for k in places))
    (block,) = read_blocks(steady, STREAM)
    assert block.rate_hz == pytest.approx(1200.0, rel=1e-3)
    burst.write_text("t_ms,a\n" + "".join(f"{k // 40 * 30 + k % 2},{k}\n" for k in sorted(places)))
    with refused(ReplayError, "rounded too coarsely", "--rate HZ"):
        read_blocks(burst, STREAM)


def test_two_steps_of_which_neither_is_usual_are_no_samples():
    assert regular(np.array([0.0, 0.01, 1.01]), np.zeros((3, 1))) is None


# --- calibration ---------------------------------------------------------------------------------


def noise_blocks(n=120_000, size=1000, seed=2, spoiled=None):
    x = np.random.default_rng(seed).standard_normal((n, 1))
    if spoiled is not None:
        x[spoiled] = np.nan
    places = range(0, n, size)
    return [SampleBlock(STREAM, at, at / 1000.0, x[at : at + size], rate_hz=1000.0) for at in places]


def paper():
    return SlipPaperDetector("paper", SlipPaperSettings())


def asked(blocks, interval_s=10.0):
    """What the paper's detector gets from a recording in one piece."""
    return calibration_line([(paper(), blocks)], "slip.paper", interval_s)


def test_pieces_are_read_one_by_one_their_seams_are_no_events_and_a_long_gap_begins_a_new_one():
    """An offset between two pieces would be a step, and a detector that learned from one would judge the other."""
    first, second = noise_blocks(60_000, seed=2), noise_blocks(60_000, seed=3)
    moved = [replace(b, values=b.values + 500.0) for b in second]
    line = calibration_line([(paper(), first), (paper(), moved)], "slip.paper", 10.0)
    assert line["pieces"] == 2
    assert line["threshold"] == pytest.approx(asked(noise_blocks())["threshold"], rel=0.15)
    blocks = noise_blocks()
    late = [replace(b, seq=b.seq + 5000, t0_s=b.t0_s + 5.0, values=b.values + 500.0) for b in blocks[60:]]
    assert asked(blocks[:60] + late)["pieces"] == 2


def test_thresholds_set_without_a_piece_give_the_false_alarms_that_were_asked_for_on_it():
    pieces = [(paper(), noise_blocks(60_000, seed=seed)) for seed in range(10)]
    line = calibration_line(pieces, "slip.paper", 20.0)
    assert (line["checked_interval_s"], line["checked_expected"]) == (20.0, pytest.approx(30.0, rel=0.01))
    assert 15 <= line["checked_found"] <= 60


def test_what_is_too_rare_to_be_checked_is_checked_at_a_shorter_interval_and_estimated_with_its_width():
    line = asked(noise_blocks(), 3600.0)
    assert line["extrapolated"] is True
    assert line["threshold_low"] < line["threshold"] < line["threshold_high"]
    assert (line["checked_interval_s"], line["checked_expected"]) == (12.0, 10.0)
    assert line["sees_s"] == 24.0
    line = asked(noise_blocks(4000))
    assert line["extrapolated"] is True
    assert line["threshold_high"] - line["threshold_low"] > 0.5 * line["threshold"]


def test_a_threshold_is_the_same_from_blocks_and_from_the_whole():
    blocks = noise_blocks()
    line = asked(blocks)
    whole = np.concatenate([block.physical for block in blocks])
    maxima = span_maxima(paper().statistic(whole, 1000.0), 1000.0)
    assert line["threshold"] == threshold_for(maxima, 10.0).threshold
    assert line["threshold_low"] < line["threshold"] < line["threshold_high"]
    assert (line["detector"], line["extrapolated"], line["recording_s"]) == ("slip.paper", False, 120.0)
    assert line["false_alarm_interval_s"] == 10.0


def test_what_it_learns_from_is_not_quiet_raw_counts_have_a_scale_and_lost_samples_are_no_step():
    """Two times half a second: the first whole second is no estimate."""
    line = calibration_line([(SlipDetector("s", SlipSettings()), noise_blocks())], "slip", 10.0)
    assert line["recording_s"] == 119.0
    blocks = noise_blocks()
    counts = [replace(b, values=np.rint(1e4 * b.values).astype(np.int32), scale=1e-4) for b in blocks]
    assert asked(counts)["threshold"] == pytest.approx(asked(blocks)["threshold"], rel=1e-3)
    blocks = noise_blocks()
    lossy = [replace(b, values=b.values + 500.0 * (b.seq >= 60_000)) for b in blocks if b.seq != 60_000]
    # an offset after the gap would be a spectrum of its own in the block that straddles it
    assert asked(lossy)["threshold"] == pytest.approx(asked(blocks)["threshold"], rel=0.2)


def block_of(values, **times):
    return SampleBlock(STREAM, 0, 0.0, values, **times)


@pytest.mark.parametrize(
    ("blocks", "reason"),
    [
        (noise_blocks(spoiled=5000), "a value at 5 s is not finite"),
        (noise_blocks(400), "s in which the detector decides are too few"),
        ([], "holds no sample"),
        (noise_blocks(size=500)[::3], "samples are missing"),
        ([block_of(np.zeros((60_000, 1)), rate_hz=1000.0)], "threshold of 0, which is none"),
        ([block_of(np.zeros((3, 1)), times_s=np.array([0.0, 0.1, 0.3]))], "--rate HZ"),
    ],
)
def test_a_recording_that_allows_no_estimate_is_refused_in_one_line(blocks, reason):
    with refused(ReplayError, "slip.paper: ", reason):
        asked(blocks)


TIMES = "times must be finite and rise"


@pytest.mark.parametrize(
    ("name", "content", "named"),
    [
        ("cut.wav", b"RIFF\x24\x08\0\0WAVEfmt \x10\0\0\0\x01\0\x02\0", ["no WAV file"]),
        ("twice.csv", b"a,a\n1,2\n", ["two columns", "'a'"]),
        ("empty.csv", b"", ["no rows"]),
        ("head.csv", b"t_s,a\n", ["column a", "no rows"]),
        ("tiny.csv", b"t_s,a\n0,1\n1e-320,1\n2e-320,1\n", [TIMES]),
        ("close.csv", b"t_s,a\n0,1\n1e-10,1\n1,1\n", [TIMES]),
        ("late.csv", b"t_s,a\n0,1\n1,1\n1e300,1\n", [TIMES]),
        ("back.csv", b"t_s,a\n0,1\n0.1,2\n0.05,3\n", ["t_s: 0.05 s in row 3", TIMES]),
        ("coarse.csv", b"t_s,a\n0,1\n0,2\n0.001,3\n", ["t_s: 0 s in row 2", "rounded", "--rate HZ"]),
        ("short.csv", b"t_s,a\n" + 9 * b"1,1,2\n", ["(t_s, a)", "3 fields in the row below"]),
        ("dead.csv", b"t_s,a\n0,nan\n0.1,\n0.2,inf\n", ["a: no value is a finite number"]),
        ("text.csv", b"t_s,a\n0,1\n0.1,ERR\n", ["column a holds 'ERR' in row 2"]),
        ("end.csv", b"t_s,a\n0,1\nend,\n", ["column t_s holds 'end' in row 2"]),
        ("day.csv", b"time,a\n2026-01-01,1\nnoon,2\n", ["column time holds 'noon' in row 2"]),
        ("zeros.csv", bytes(10), ["byte 0"]),
        ("wide.csv", ",".join(map(str, range(99))).encode(), ["which column", "18, 19, …"]),
        ("no.npz", b"PK\x03\x04 and no more", ["no NPZ file"]),
        ("time.csv", b"ttime_", ["time.csv"]),
        ("one.csv", b"t_s,a\n0,1,2,3\n1,2\n", ["one.csv"]),
    ],
)
def test_a_file_that_is_damaged_or_ambiguous_is_refused_in_one_line(tmp_path, name, content, named):
    (tmp_path / name).write_bytes(content)
    with refused(ReplayError, str(tmp_path / name), *named):
        read_blocks(tmp_path / name, STREAM, rate_hz=1000.0)


def test_a_file_without_numbers_is_refused_in_one_line(tmp_path):
    wavfile.write(tmp_path / "none.wav", 1000, np.zeros((0, 1), np.int16))
    with refused(ReplayError, "none.wav", "no rows"):
        read_blocks(tmp_path / "none.wav", STREAM)
    np.savez(tmp_path / "complex.npz", a=np.array([1j, 2.0]))
    with refused(ReplayError, "column a", "1j"):
        read_blocks(tmp_path / "complex.npz", STREAM, rate_hz=1000.0)


HUGE = b"{'descr': '<f8', 'fortran_order': False, 'shape': (900000000,), }\n"


def claims(array: bytes, data: bytes) -> bytes:
    """An NPZ file with one array, whose header claims what it likes."""
    packed = io.BytesIO()
    with ZipFile(packed, "w") as opened:
        opened.writestr("a.npy", b"\x93NUMPY\x01\x00" + len(array).to_bytes(2, "little") + array + data)
    return packed.getvalue()


SOUND = b"RIFF\xf0\xff\xff\x7fWAVEfmt \x10\0\0\0\1\0\1\0\x40\x1f\0\0\x80\x3e\0\0\2\0\x10\0"
"""The head of a file of 16 bits at 8 kHz that claims 2 GiB."""


def chunk_of(size: int) -> bytes:
    """An MCAP file of some kilobytes with a chunk that unpacks to `size` bytes."""
    body = bytes(16) + size.to_bytes(8, "little") + bytes(4) + b"\4\0\0\0zstd"
    packed = zstandard.ZstdCompressor().compress(bytes(size))
    body += len(packed).to_bytes(8, "little") + packed
    return b"\x89MCAP0\r\n" + b"\6" + len(body).to_bytes(8, "little") + body


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.npz", claims(HUGE, bytes(80)), "no .900000000,. of float64"),
        ("a.wav", SOUND + b"data\0\xff\xff\x7f" + bytes(80), "Reached EOF prematurely"),
        ("a.mcap", chunk_of(65 << 20), "unpacks to 68157440 bytes"),
    ],
)
def test_a_file_that_claims_more_than_it_holds_gets_no_room_for_it(tmp_path, name, content, reason):
    (tmp_path / name).write_bytes(content)
    tracemalloc.start()
    with pytest.raises(ReplayError, match=reason):
        read_columns(tmp_path / name, "/topic:field" if name == "a.mcap" else None)
    peak_bytes = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak_bytes < 32 << 20


# --- tables of other programs --------------------------------------------------------------------

TEXTS = {
    "semicolons and decimal commas": "t_s;ft_v\n0,000;1,5\n0,001;2,5\n0,002;3,5\n",
    "spaces and decimal commas": "t_s ft_v\n0,000 1,5\n0,001 2,5\n0,002 3,5\n",
    "tabs": "t_s\tft_v\n0\t1.5\n0.001\t2.5\n0.002\t3.5\n",
    "spaces": "t_s ft_v\n0 1.5\n0.001  2.5\n0.002 3.5\n",
    "comments and empty lines": "# a lab\n\nt_s,ft_v\n0,1.5\n# knocked\n0.001,2.5\n0.002,3.5\n",
    "names in a comment": "% a lab\n% t_s,ft_v\n0,1.5\n0.001,2.5\n0.002,3.5\n",
    "a comma after each row": "t_s,ft_v,\n0,1.5,\n0.001,2.5,\n0.002,3.5,\n",
    "milliseconds": "t_ms,ft_v\n0,1.5\n1,2.5\n2,3.5\n",
    "a line of units": "Time,ft_v\n(ms),(V)\n\n0,1.5\n1,2.5\n2,3.5\n",
    "Greek microseconds": "time (\u03bcs),ft_v\n0,1.5\n1000,2.5\n2000,3.5\n",
    "a unit in brackets": "Time [ms],ft_v\n0,1.5\n1,2.5\n2,3.5\n",
    "microseconds since 1970": "timestamp,ft_v\n1760000000000000,1.5\n1760000000001000,2.5\n1760000000002000,3.5\n",
    "nanoseconds since 1970": "time,ft_v\n1760000000000000000,1.5\n1760000000001000000,2.5\n1760000000002000000,3.5\n",
    "dates": "time,ft_v\n2026-01-01T00:00:00.000Z,1.5\n2026-01-01T00:00:00.001Z,2.5\n2026-01-01T00:00:00.002Z,3.5\n",
    "a preamble and empty cells": "a lab\nt_s;ft_v;b\n0;1.5;\n0.001;2.5;\n0.002;3.5;4\n",
    "text beside the numbers": "t_s,state,ft_v\n0,rest,1.5\n0.001,rest,2.5\n0.002,drag,3.5\n",
}


@pytest.mark.parametrize("text", TEXTS.values(), ids=TEXTS)
def test_text_as_other_programs_write_it_is_read(tmp_path, text):
    (tmp_path / "a.csv").write_text(text, "utf-8")
    (block,) = read_blocks(tmp_path / "a.csv", STREAM, column="ft_v")
    assert block.values[:, 0].tolist() == [1.5, 2.5, 3.5]
    assert block.rate_hz == pytest.approx(1000.0, rel=1e-6)
    assert block.t0_s == 0.0


def test_samples_that_are_no_numbers_and_times_that_look_like_milliseconds_are_reported(tmp_path):
    values = np.arange(100.0)
    values[[40, 41, 60]] = np.nan, np.inf, np.nan
    notes = []
    read_blocks(csv(tmp_path / "a.csv", np.arange(100) / 100.0, values), STREAM, notes=notes)
    read_blocks(csv(tmp_path / "a.csv", np.arange(100), np.zeros(100)), STREAM, notes=notes)
    assert notes[0].endswith("; 3 samples are no finite numbers, the first at 0.4 s")
    assert "100 samples, 1 Hz, 99 s" in notes[1]
    assert "are these milliseconds? then call the column t_ms" in notes[1]


def test_rows_without_names_are_columns_by_number_and_commas_may_come_after_whole_numbers(tmp_path):
    (tmp_path / "a.txt").write_text("0.5 7\n0.6 8\n")
    (block,) = read_blocks(tmp_path / "a.txt", STREAM, column="1", rate_hz=1000.0)
    assert block.values[:, 0].tolist() == [7.0, 8.0]
    (tmp_path / "a.csv").write_text("t_ms;a\n0;1\n1;2,5\n")
    assert read_columns(tmp_path / "a.csv", "a").values[:, 0].tolist() == [1.0, 2.5]


@pytest.mark.parametrize("kind", ["npz", "mat"])
def test_columns_of_an_array_of_two_dimensions_go_by_number(tmp_path, kind):
    array = np.arange(12.0).reshape(6, 2)
    path = tmp_path / f"a.{kind}"
    if kind == "npz":
        np.savez(path, force=array, t_ms=np.arange(6.0))
    else:
        savemat(path, {"force": array, "t_ms": np.arange(6.0)})
    (block,) = read_blocks(path, STREAM, column="force.1")
    assert block.values[:, 0].tolist() == [1.0, 3.0, 5.0, 7.0, 9.0, 11.0]
    assert block.rate_hz == pytest.approx(1000.0)


def foreign_mcap(path, stamp=(), **stored):
    with path.open("wb") as file:
        writer = Writer(file, **stored)
        writer.start()
        schema = writer.register_schema("wrench", "jsonschema", b"{}")
        topic = writer.register_channel("/wrench", "json", schema)
        for place in range(100):
            message = {"force": {"z": 0.5 * place}, "raw": [place, "text"]}
            if stamp:
                message["header"] = {"stamp": dict(zip(stamp, (7, place * 2_000_000), strict=True))}
            at_ns = 5_000_000_000 + place * 1_000_000
            writer.add_message(topic, log_time=at_ns, publish_time=at_ns, data=json.dumps(message).encode())
        writer.finish()
    return path


def test_a_field_of_a_foreign_recording_is_read_and_a_ros_2_message_has_its_own_time_stamp(tmp_path):
    path = foreign_mcap(tmp_path / "a.mcap")
    (block,) = read_blocks(path, STREAM, column="/wrench:force.z,raw.0")
    assert block.values[:3].tolist() == [[0.0, 0.0], [0.5, 1.0], [1.0, 2.0]]
    assert block.rate_hz == pytest.approx(1000.0)
    assert block.t0_s == 0.0
    from mcap_ros2.writer import Writer as Ros2Writer

    schema_text = (
        "std_msgs/Header header\nfloat64 x\n"
        + "=" * 80
        + ("\nMSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n" + "=" * 80)
        + "\nMSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    path = tmp_path / "ros.mcap"
    with path.open("wb") as file:
        writer = Ros2Writer(file)
        schema = writer.register_msgdef("lab/Force", schema_text)
        for place in range(50):
            stamp = {"sec": 100, "nanosec": place * 2_000_000}
            message = {"header": {"stamp": stamp, "frame_id": ""}, "x": float(place)}
            late_ns = 7_000_000_000 + place * 2_000_000 + (place % 3) * 700_000
            writer.write_message("/force", schema, message, log_time=late_ns, publish_time=late_ns)
        writer.finish()
    notes = []
    (block,) = read_blocks(path, STREAM, column="/force:x", notes=notes)
    assert block.rate_hz == pytest.approx(500.0)
    assert "times from header.stamp" in notes[0]


@pytest.mark.parametrize(
    "stored",
    [
        {"compression": CompressionType.LZ4},
        {"compression": CompressionType.NONE, "enable_crcs": False},
        {"use_chunking": False},
        {"repeat_channels": False, "repeat_schemas": False, "chunk_size": 500},
    ],
)
def test_a_foreign_recording_is_read_however_it_is_stored_and_one_that_is_cut_off_is_refused(
    tmp_path, stored
):
    path = foreign_mcap(tmp_path / "a.mcap", **stored)
    found = read_columns(path, "/wrench:raw.0")
    assert found.values[:, 0].tolist() == list(range(100))
    assert found.times_s == pytest.approx(np.arange(100) / 1000.0, abs=1e-9)
    path.write_bytes(path.read_bytes()[:-1000])
    with refused(ReplayError, "a.mcap", "cut off"):
        read_columns(path, "/wrench:raw.0")


@pytest.mark.parametrize("stamp", [("sec", "nanosec"), ("secs", "nsecs")])
def test_a_message_in_json_has_its_own_time_stamp_as_well(tmp_path, stamp):
    (block,) = read_blocks(foreign_mcap(tmp_path / "a.mcap", stamp), STREAM, column="/wrench:force.z")
    assert block.rate_hz == pytest.approx(500.0)


def test_a_runs_own_recording_is_refused_for_its_samples_are_in_its_folder(tmp_path):
    McapWriter(tmp_path / "recording.mcap").finish()
    with refused(ReplayError, "recording.mcap", "give its folder"):
        read_columns(tmp_path / "recording.mcap", "/board/load_cell:force_n")


@pytest.mark.parametrize(
    ("column", "reason"),
    [
        (None, "choose with --column TOPIC:FIELD; topics are /wrench"),
        ("/other:x", "topics are /wrench"),
        ("/wrench:force.x", "/wrench has no number force.x"),
        ("/wrench:raw.1", "/wrench has no number raw.1"),
    ],
)
def test_a_field_that_is_not_there_is_refused_in_one_line(tmp_path, column, reason):
    with refused(ReplayError, reason):
        read_blocks(foreign_mcap(tmp_path / "a.mcap"), STREAM, column=column)


def pictured(path, blocks, detector):
    """The notes of a picture, and it."""
    notes = draw(path, blocks, detector, list(replay(blocks, detector)))
    picture = path.read_text("utf-8")
    assert picture.count('<g id="axes_') == 2
    return notes, picture


def test_a_picture_shows_signal_statistic_threshold_and_events_with_a_break_at_what_is_not_finite(tmp_path):
    values = shaken(8000)
    blocks, detector = [block_of(values[:, None], rate_hz=1000.0)], SlipDetector("slip", SlipSettings())
    assert not pictured(tmp_path / "drag.svg", blocks, detector)[0]
    with pytest.raises(ReplayError, match="is no picture"):
        draw(tmp_path / "drag.gif", blocks, detector, [])
    values[[3000, 5000]] = np.nan, np.inf
    (note,) = pictured(tmp_path / "drag.svg", blocks, SlipDetector("slip", SlipSettings()))[0]
    assert note.endswith("only where it was compared: a value at 3 s is not finite; cut the recording there")


@pytest.mark.parametrize("largest", [1.2e306, 1.7e308])
def test_values_that_are_too_large_to_be_drawn_are_refused(tmp_path, largest):
    blocks = [block_of(largest * np.sin(np.arange(400.0))[:, None], rate_hz=1000.0)]
    with pytest.raises(ReplayError, match=r"--plot: .*e\+30. is too large to be drawn"):
        draw(tmp_path / "drag.svg", blocks, SlipDetector("slip", SlipSettings()), [])


@pytest.mark.parametrize("kind", ["slip", "slip.paper", "resonance", "level", "level.paper"])
def test_a_recording_that_is_too_short_for_its_detector_is_refused(kind):
    blocks = [SampleBlock("board.force", 0, 0.0, np.array([[1.0], [2.0]]), rate_hz=1000.0)]
    with pytest.raises(ReplayError, match=r"in 2 samples \(0.001 s\): the recording is too short$"):
        list(replay(blocks, make_detector(kind, {"input": "board.force"})))


def test_a_quiet_recording_of_sufficient_length_has_no_events_and_no_error():
    values = 0.01 + 1e-5 * np.random.default_rng(1).standard_normal((2000, 1))
    detector = make_detector("level", {"input": "board.force", "threshold": "30.0"})
    assert list(replay([SampleBlock("board.force", 0, 0.0, values, rate_hz=1000.0)], detector)) == []


def test_a_picture_of_periods_shows_the_frequency_and_what_is_held_against_the_threshold(tmp_path):
    periods_s = 1.0 / np.concatenate([28.0 + 0.05 * np.sin(np.arange(60)), np.full(20, 30.0)])
    times_s = np.cumsum(periods_s)
    blocks = [
        SampleBlock("board.period", n, t_s, periods_s[n : n + 1, None], None, times_s[n : n + 1], "s")
        for n, t_s in enumerate(times_s)
    ]
    detector = ResonancePaperDetector("contact", ResonancePaperSettings(sample_hz=15.0))
    _, picture = pictured(tmp_path / "contact.svg", blocks, detector)
    assert "board.period, Hz" in picture
    assert "contact: statistic" in picture


def table(separator=",", rows=6):
    return "".join(f"{0.01 * i:.2f}{separator}{0.5 * i:.3f}\n" for i in range(rows))


@pytest.mark.parametrize(
    ("above", "rate_hz"),
    [
        ("# sample_rate_hz = 500\nforce", 500.0),
        ("# Fs: 1e3\n# low pass 200 Hz, baud rate: 115200\nforce", 1000.0),
        ("Sample Rate (Hz),2000\nDevice,4411\n\nforce", 2000.0),
        ("% sampled at 10 kHz, gain 3", 10_000.0),
        ("# Sampling rate: 1,000 Hz\nforce", 1000.0),
        ("# dt = 0.5 ms\nforce", 2000.0),
        ("Delta_X\t0.001\n***End_of_Header***\nforce\tComment", 1000.0),
    ],
)
def test_a_rate_that_stands_above_a_table_without_times_is_taken_and_told(tmp_path, above, rate_hz):
    path, notes = tmp_path / "log.txt", []
    path.write_text(above + "\n" + "".join(f"{n % 7}.5\n" for n in range(100)))
    (block,) = read_blocks(path, "sensor", notes=notes)
    assert block.rate_hz == pytest.approx(rate_hz)
    assert "rate from its line" in notes[0]
    for asked_hz in (50.0, rate_hz):
        (asked,) = read_blocks(path, "sensor", rate_hz=asked_hz, notes=notes)
        assert asked.rate_hz == asked_hz
        assert (f"says {rate_hz:.6g} Hz, and --rate was taken" in notes[-1]) == (asked_hz == 50.0)


@pytest.mark.parametrize(
    "above",
    [
        *(
            "# 500 Hz\n# 1000 Hz",
            "# low pass 200 Hz",
            "# baud rate: 9600",
            "# rate: 0 Hz",
            "# fs: 1.2.3 of it",
        ),
        *("# sample rate: 1e999 Hz", "# dt = 1e-300 s", "# sample rate: 1.000,5 Hz"),
    ],
)
def test_what_states_no_rate_or_two_leaves_it_to_the_user(tmp_path, above):
    path = tmp_path / "log.txt"
    path.write_text(above + "\nforce\n" + "".join(f"{n % 7}.5\n" for n in range(100)))
    with pytest.raises(ReplayError, match="--rate HZ"):
        read_blocks(path, "sensor")


@pytest.mark.parametrize(
    ("name", "text", "column"),
    [
        ("preamble.csv", "Cell logger 2\nSerial: 5, channel 3\n2 Nov 2024\nt_s,force\ns,N\n" + table(), "force"),
        ("title.csv", "Monday\nt_s,force\n" + table(), "force"),
        ("no_names.txt", "a logger of mine\nrate 100\n" + table(" "), "1"),
        ("labview.lvm", "LabVIEW\t\n***End_of_Header***\t\nDelta_X\t0.01\n***End_of_Header***\t\nX_Value\tF\tComment\n"
         + table("\t"), "F"),
        ("scales.txt", "Sampling - 100\nMon, Jul 9\nTime\tF\nSec\tV\n0 0 0\t0\n\n" + table("\t"), "F"),
        ("labels.csv", "STARTING NEW RUN\n" + "".join(f"d,{0.5 * i},{10 * i}\n" for i in range(6)) + "STOPPED\n", "1"),
        ("packed.csv", "t_s,p0,p1\n0.00,0.0,0.5\n0.02,1.0,1.5\n0.04,2.0,2.5\n", "p0..p1"),
    ],
)  # fmt: skip
def test_tables_below_a_preamble_and_samples_side_by_side_are_read(tmp_path, name, text, column):
    (tmp_path / name).write_text(text)
    found = read_columns(tmp_path / name, column)
    assert found.values[:, 0] == pytest.approx([0.0, 0.5, 1.0, 1.5, 2.0, 2.5])
    assert found.times_s is None or found.times_s == pytest.approx(0.01 * np.arange(6))


@pytest.mark.parametrize(
    ("name", "unit", "metres"),
    [
        ("x_m", "m", 1.0),
        ("way_mm", "m", 1e-3),
        ("Position [mm]", "m", 1e-3),
        ("X_CM", "m", 1e-2),
        ("way(um)", "m", 1e-6),
        ("Weg [\u00b5m]", "m", 1e-6),
        ("Weg_\u03bcm", "m", 1e-6),
        ("x_deg", "", 1.0),
        ("torque_n_mm", "", 1.0),
        ("stiffness [N/mm]", "N/mm", 1.0),
        ("speed_m_s", "m/s", 1.0),
        ("gear_mm2", "", 1.0),
        ("mm", "m", 1e-3),
    ],
)
def test_lengths_are_read_in_metres_each_column_by_its_own_name(tmp_path, name, unit, metres):
    rows = "".join(f"{i / 100:.2f},{2 * i},{i}\n" for i in range(50))
    (tmp_path / "a.csv").write_text(f"t_s,{name},r_rad\n{rows}", "utf-8")
    (block,) = read_blocks(tmp_path / "a.csv", STREAM, column=f"{name},r_rad")
    assert block.unit == unit
    assert block.values[:, 0] == pytest.approx(2.0 * metres * np.arange(50), rel=1e-12)
    assert block.values[:, 1].tolist() == list(range(50))


@pytest.mark.parametrize("separator", [",", ";", " "])
def test_a_line_of_units_below_the_names_holds_for_the_columns_that_state_none(tmp_path, separator):
    rows = "".join(separator.join((f"{i}.0", f"{2 * i}", f"{i}")) + "\n" for i in range(50))
    head = "a logger of mine\nTime,Position,way_mm\n[ms],mm,mm\n".replace(",", separator)
    (tmp_path / "a.csv").write_text(head + rows)
    (block,) = read_blocks(tmp_path / "a.csv", STREAM, column="Position,way_mm")
    assert (block.unit, block.rate_hz) == ("m", pytest.approx(1000.0))
    assert block.values[7] == pytest.approx([0.014, 0.007])


def test_times_in_a_unit_that_is_not_known_are_refused(tmp_path):
    (tmp_path / "a.csv").write_text("Time,F\nmin,N\n" + table())
    with refused(ReplayError, "Time [min]", "s, ms, us or ns", "mark", "#"):
        read_columns(tmp_path / "a.csv", "F")


def labview(*segments, x_columns="One"):
    """A file of LabVIEW's with a header for each segment: its first time, and its rows."""
    text = f"LabVIEW Measurement\t\nX_Columns\t{x_columns}\n***End_of_Header***\t\t\n\t\t\n"
    for begin_s, values in segments:
        text += f"Channels\t1\t\t\nTime\t12:00:00\t\t\nX0\t{begin_s}\t\t\nDelta_X\t0.01\t\t\n"
        text += "***End_of_Header***\t\t\t\nX_Value\tF\tComment\n"
        for place, value in enumerate(values):
            text += f"{begin_s + 0.01 * place:.2f}\t{value}\n" if x_columns == "One" else f"\t{value}\n"
        text += "\n"
    return text


def test_all_segments_of_a_labview_file_are_read_with_the_gap_between_them(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_text(labview((0.0, range(20)), (0.2, range(20, 40)), (0.5, range(40, 60))))
    first, second = read_blocks(path, STREAM)
    assert np.concatenate([first.values, second.values])[:, 0].tolist() == list(range(60))
    assert (second.seq, first.rate_hz) == (50, pytest.approx(100.0))


def test_a_labview_file_without_times_has_the_rate_of_its_header_and_its_segments_are_no_one_table(tmp_path):
    path = tmp_path / "a.lvm"
    path.write_text(labview((0.0, range(20)), x_columns="No"))
    (block,) = read_blocks(path, STREAM)
    assert (block.rate_hz, block.values[:, 0].tolist()) == (pytest.approx(100.0), list(range(20)))
    path.write_text(labview((0.0, range(20)), (0.5, range(20)), x_columns="No"))
    with refused(ReplayError, "2 segments", "no times", "file of its own"):
        read_columns(path, None)
    path.write_text(labview((0.0, range(20)), (0.5, range(20))).replace("F\t", "G\t", 1))
    with refused(ReplayError, "2 segments", "other names", "file of its own"):
        read_columns(path, None)


def test_a_length_in_an_array_is_one_too(tmp_path):
    np.savez(tmp_path / "a.npz", way_mm=np.arange(40.0).reshape(20, 2), fs=100)
    (block,) = read_blocks(tmp_path / "a.npz", STREAM, column="way_mm.1")
    assert (block.unit, block.values[3, 0]) == ("m", pytest.approx(0.007))


def test_a_row_of_many_samples_before_a_gap_is_as_long_as_the_others(tmp_path):
    """100 rows of 22 samples a second; 3 s of them are missing after row 200, counted from 0."""
    rows = np.r_[0:201, 501:600]
    lines = (f"{row / 100:.2f},{','.join(str(22 * row + k) for k in range(22))}\n" for row in rows)
    (tmp_path / "a.csv").write_text("t_s," + ",".join(f"p{k}" for k in range(22)) + "\n" + "".join(lines))
    found = read_columns(tmp_path / "a.csv", "p0..p21")
    assert found.times_s == pytest.approx(found.values[:, 0] / 2200)
    first, second = read_blocks(tmp_path / "a.csv", STREAM, column="p0..p21")
    assert (len(first), second.seq) == (201 * 22, 501 * 22)


def test_where_no_column_has_the_times_it_is_said_how_one_is_called_and_a_line_not_understood_is_named(
    tmp_path,
):
    (tmp_path / "a.csv").write_text("# data_rate = 2000.0 Hz\ncount,a_x\n0,0.1\n1,0.2\n2,0.1\n3,0.3\n")
    with refused(ReplayError, "there are count, a_x", "called t_s, t_ms, time"):
        read_columns(tmp_path / "a.csv", None)
    assert read_columns(tmp_path / "a.csv", "a_x").rate_hz == 2000.0, "a count of samples is no time"
    (tmp_path / "a.txt").write_text("one\ntwo words\nthree of them\nand so on\n")
    with refused(ReplayError, "two words"):
        read_columns(tmp_path / "a.txt", None)


def test_structures_of_mat_files_and_flac_are_read(tmp_path):
    wave = 0.1 * np.random.default_rng(1).standard_normal(500)
    savemat(tmp_path / "a.mat", {"run": {"force": wave, "note": "x"}})
    soundfile.write(tmp_path / "a.flac", wave, 8000)
    assert read_columns(tmp_path / "a.mat", "run.force").values[:, 0] == pytest.approx(wave)
    found = read_columns(tmp_path / "a.flac", None)
    assert (found.rate_hz, found.values[:, 0]) == (8000.0, pytest.approx(wave, abs=1e-4))


@pytest.mark.parametrize(("limit", "said"), [(0.02, True), (1.0, False)])
def test_a_converter_at_its_rail_is_named(tmp_path, limit, said):
    """A touch that clips, and the same in a wider range."""
    t_s = np.arange(2000) / 1000.0
    values = np.clip(0.003 * np.random.default_rng(1).standard_normal(2000) + 0.05 * (t_s > 1.5), -1.0, limit)
    notes = []
    read_blocks(csv(tmp_path / "a.csv", t_s, values), STREAM, notes=notes)
    assert ("at its rail (0.02)" in notes[0] and "1.501 s" in notes[0]) == said


def test_a_rail_is_named_in_whichever_channel_and_a_mover_at_an_end_of_its_way_has_none(tmp_path):
    i, q = 0.003 * np.random.default_rng(1).standard_normal((2, 2000))
    np.savez(tmp_path / "a.npz", i=i, q=np.minimum(q, 0.0005))
    notes = []
    read_blocks(tmp_path / "a.npz", STREAM, column="i,q", rate_hz=1000.0, notes=notes)
    assert "at its rail (0.0005)" in notes[0]
    places_m = np.clip(0.002 * np.arange(1000.0)[:, None] / 100.0, 0.0, 0.01)
    assert "rail" in at_rail([SampleBlock("a.b", 0, 0.0, places_m, rate_hz=100.0, unit="N")])
    assert at_rail([SampleBlock("a.b", 0, 0.0, places_m, rate_hz=100.0, unit="m")]) == ""


@pytest.mark.parametrize("bits", [24, 16])
def test_sound_at_full_scale_is_no_envelope(bits):
    """As counts of a sound card, and as the shares of full scale that a file of 16 bits holds."""
    full = 2 ** (bits - 1)
    tone = 1.2 * full * np.sin(2.0 * np.pi * 40_000.0 / 96_000.0 * np.arange(48_000))
    counts = np.clip(tone, 1 - full, full - 1).astype(np.int32)[:, None]
    values, scale = (counts, 1.0 / full) if bits == 24 else (counts / full, 1.0)
    block = SampleBlock("signals.right", 0, 0.0, values, rate_hz=96_000.0, scale=scale, unit="FS")
    with pytest.raises(ReplayError, match="at full scale"):
        enveloped([block], "signals.right", IqSettings(channel=0))


def test_a_detector_without_an_event_says_how_near_it_came_and_what_to_set():
    x = np.random.default_rng(4).standard_normal(6000)
    x[4000:4300] += 2.5 * np.random.default_rng(5).standard_normal(300)
    blocks = [SampleBlock(STREAM, 0, 0.0, x[:, None], rate_hz=1000.0)]
    detector = SlipDetector("slip", SlipSettings(threshold=60.0))
    assert [type(event) for event in replay(blocks, detector)] == [BaselineReady]
    said = nearest(blocks, detector)
    found = re.fullmatch(r"largest evidence of slip (\S+) of 60 at (\S+) s: .* --set threshold=(\S+)", said)
    value, t_s, advised = map(float, found.groups())
    assert value == pytest.approx(detector.statistic(x[:, None], 1000.0)[1010:].max(), rel=0.01)
    assert 4.0 < t_s < 4.5
    fresh = SlipDetector("slip", SlipSettings(threshold=advised))
    assert any(isinstance(event, SlipStarted) for event in replay(blocks, fresh))


def test_a_trials_settings_of_a_detector_are_of_the_trials_kind_in_whichever_order_they_stand():
    manifest = {"profile": {"resolved": {"detectors": {"near": {"kind": "slip", "threshold": 5.0}}}}}
    factors = {"detectors.near.threshold": 3.0, "detectors.near.kind": "slip.paper"}
    for order in (1, -1):
        recording = TrialRecording(1, dict([*factors.items()][::order]))
        assert own_detectors(manifest, recording) == {"near": {"kind": "slip.paper", "threshold": 3.0}}


@pytest.mark.parametrize("rate_hz", [250.0, 2500.0, 2490.0, None])
def test_a_rate_that_the_times_deny_is_taken_and_said(tmp_path, rate_hz):
    path = csv(tmp_path / "a.csv", np.arange(5000) / 2500.0, np.arange(5000) % 7)
    notes: list[str] = []
    blocks = read_blocks(path, STREAM, rate_hz=rate_hz, notes=notes)
    assert blocks[0].rate_hz == pytest.approx(rate_hz or 2500.0)
    for said in ("but t_s says 2500 Hz", "--rate"):
        assert (said in notes[0]) == (rate_hz == 250.0)
