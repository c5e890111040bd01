"""The chain in whole numbers, against references of other arithmetic."""

import math
from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest

from controller.signals.demodulation import CHUNK, Cic, Fused, Oscillator, cic_taps, cosine_taps

RATE_HZ = 96_000.0
DECIMATION = 96
DRIVES_HZ = (40_000.0, 40_123.457, 25_000.001)


def made(kind, drive_hz=40_000.0, channel=0):
    oscillator = Oscillator(drive_hz, RATE_HZ)
    if kind == "cic":
        return Cic(channel, oscillator, DECIMATION)
    return Fused((channel,), oscillator, DECIMATION, quadrature=kind == "fused")


def noise(n, seed=1):
    return np.random.default_rng(seed).integers(-(1 << 23), 1 << 23, (n, 2)).astype(np.int32)


def whole_cycles(drive_hz, frame):
    """The phase at a frame as a fraction of a cycle, in exact arithmetic."""
    return Fraction(round(drive_hz * 1000) * frame, round(RATE_HZ) * 1000) % 1


def decibels(x):
    return 20.0 * np.log10(np.max(np.abs(x)) + 1e-300)


@pytest.mark.parametrize("frame", [0, 7, 10**9 + 1, 2**40])
@pytest.mark.parametrize("drive_hz", DRIVES_HZ)
def test_the_phase_is_that_of_exact_fractions_however_late(drive_hz, frame):
    oscillator = Oscillator(drive_hz, RATE_HZ)
    steps = oscillator.steps(np.arange(frame, frame + 5, dtype=np.int64))
    expected = [whole_cycles(drive_hz, frame + k) for k in range(5)]
    assert [Fraction(int(step), oscillator.whole) for step in steps] == expected


def test_a_tone_beyond_half_the_rate_and_sums_over_more_frames_than_whole_numbers_hold_are_refused():
    with pytest.raises(ValueError, match="48000 Hz are not between 0 and half"):
        Oscillator(48_000.0, RATE_HZ)
    with pytest.raises(ValueError, match=r"257 frames an output leave no room; 256 at the most"):
        Cic(0, Oscillator(40_000.0, RATE_HZ), 257)
    # at the most an oscillator of 2^16 is left
    assert Cic(0, Oscillator(40_000.0, RATE_HZ), 256).scale == pytest.approx(2.0 / (2**16 * 256**3))


@pytest.mark.parametrize("drive_hz", DRIVES_HZ)
@pytest.mark.parametrize("kind", ["fused", "cic", "in_phase"])
def test_blocks_of_any_size_give_the_same_to_the_bit(kind, drive_hz):
    counts, frame = noise(3 * CHUNK + 11), 10**9 + 5
    at_once = made(kind, drive_hz).push(counts, frame)
    chain, parts, place = made(kind, drive_hz), [], 0
    sizes = np.random.default_rng(2).integers(1, 900, len(counts))
    for size in [1, 1, 95, 96, 97, *sizes]:
        if place < len(counts):
            parts.append(chain.push(counts[place : place + size], frame + place))
            place += size
    given = [part for part in parts if len(part.values)]
    assert np.array_equal(np.concatenate([part.values for part in given]), at_once.values)
    numbers = np.concatenate([part.first + np.arange(len(part.values)) for part in given])
    assert np.array_equal(numbers, at_once.first + np.arange(len(at_once.values)))


@pytest.mark.parametrize("kind", ["fused", "cic"])
def test_packed_bytes_and_counts_give_the_same(kind):
    counts = noise(5000)
    packed = counts.astype("<i4").view(np.uint8).reshape(-1, 2, 4)[:, :, :3].reshape(-1, 6)
    for channel in (0, 1):
        a, b = (made(kind, channel=channel).push(one, 3) for one in (counts, packed))
        assert np.array_equal(a.values, b.values)
        assert a.first == b.first


@pytest.mark.parametrize("fingers", [(0, 1), (1, 0)])
def test_both_fingers_in_one_pass_give_what_each_gives_alone_to_the_bit(fingers):
    counts, oscillator = noise(2 * CHUNK + 7), Oscillator(40_123.457, RATE_HZ)
    packed = counts.astype("<i4").view(np.uint8).reshape(-1, 2, 4)[:, :, :3].reshape(-1, 6)
    alone = np.hstack([Fused((finger,), oscillator, DECIMATION).push(counts, 3).values for finger in fingers])
    for sound in (counts, packed):
        both = Fused(fingers, oscillator, DECIMATION)
        # cuts that leave one, two and three frames beside the fours
        parts = [both.push(sound[a:b], 3 + a) for a, b in pairwise((0, 2001, 4003, 6006, len(sound)))]
        assert np.array_equal(np.concatenate([part.values for part in parts]), alone)


@pytest.mark.parametrize("drive_hz", DRIVES_HZ)
def test_the_fused_filter_is_its_low_pass_in_long_arithmetic_to_150_db(drive_hz):
    counts, frame = noise(2000), 10**9 + 5
    out = made("fused", drive_hz).push(counts, frame)
    taps = cosine_taps(DECIMATION).astype(np.longdouble)
    turns = [float(whole_cycles(drive_hz, n)) for n in range(frame, frame + len(counts))]
    angle = 2 * np.array(turns, np.longdouble) * np.longdouble(math.pi)
    mixed = counts[:, 0] * np.exp(-1j * angle)
    for m, (i, q) in enumerate(out.values):
        last = (out.first + m + 1) * DECIMATION - 1 - frame
        expected = 2 * np.sum(taps * mixed[last - len(taps) + 1 : last + 1])
        assert decibels((i + 1j * q - complex(expected)) / 2**23) < -150.0


@pytest.mark.parametrize("drive_hz", DRIVES_HZ)
def test_the_cic_equals_whole_number_arithmetic_to_the_bit(drive_hz):
    counts, frame = noise(1000), 10**9 + 5
    chain = made("cic", drive_hz)
    out = chain.push(counts, frame)
    wave = _whole_wave(chain, drive_hz, range(frame, frame + len(counts)))
    mixed = [[int(x) * w for x, w in zip(counts[:, 0], row, strict=True)] for row in wave]
    taps = [int(tap) for tap in cic_taps(DECIMATION)]
    assert len(out.values) > 5
    for m, pair in enumerate(out.values):
        last = (out.first + m + 1) * DECIMATION - 1 - frame
        window = slice(last - len(taps) + 1, last + 1)
        assert window.start >= 0
        expected = [sum(t * x for t, x in zip(taps, row[window], strict=True)) for row in mixed]
        assert [int(value) for value in pair] == expected


def _whole_wave(chain, drive_hz, frames):
    """The oscillator's whole numbers at some frames, by Python's own integers and fractions."""
    if chain._table.size:
        amplitude = round(2.0 / chain.scale) // DECIMATION**3
        cycles = [float(whole_cycles(drive_hz, n)) for n in frames]
        return (
            [round(amplitude * math.cos(2 * math.pi * c)) for c in cycles],
            [round(-amplitude * math.sin(2 * math.pi * c)) for c in cycles],
        )
    coarse, fine = ([[int(v) for v in row] for row in table] for table in (chain._coarse, chain._fine))
    length, whole = len(fine[0]), round(RATE_HZ) * 1000
    pairs = [divmod(round(drive_hz * 1000) * n % whole, length) for n in frames]
    half = 1 << 29
    return (
        [(coarse[0][a] * fine[0][b] - coarse[1][a] * fine[1][b] + half) >> 30 for a, b in pairs],
        [(coarse[0][a] * fine[1][b] + coarse[1][a] * fine[0][b] + half) >> 30 for a, b in pairs],
    )


@pytest.mark.parametrize("drive_hz", DRIVES_HZ)
def test_the_wave_in_whole_numbers_is_the_wave(drive_hz):
    chain = made("cic", drive_hz)
    amplitude = round(2.0 / chain.scale) // DECIMATION**3
    frames = range(10**9, 10**9 + 500)
    cosine, minus_sine = _whole_wave(chain, drive_hz, frames)
    angles = 2 * np.pi * np.array([float(whole_cycles(drive_hz, n)) for n in frames])
    # at 40 kHz the amplitude is chosen so that rounding leaves nothing; else half a count of 2^20
    limit = -230.0 if drive_hz == 40_000.0 else -119.0
    assert decibels(np.array(cosine) / amplitude - np.cos(angles)) < limit
    assert decibels(np.array(minus_sine) / amplitude + np.sin(angles)) < limit


def test_the_cic_survives_a_full_scale_that_runs_over_its_integrators():
    chain = made("cic")
    frames = np.arange(960_000)
    near = np.isin(5 * frames % 12, [10, 11, 0, 1, 2])
    square = np.where(near, (1 << 23) - 1, -(1 << 23)).astype(np.int32)
    values = chain.push(square[:, None], 0).values
    assert np.array_equal(values, np.broadcast_to(values[0], values.shape))
    assert abs(chain._state[:, 0]).max() > 2**61


def response(taps, hz):
    k = np.arange(len(taps)) - 0.5 * (len(taps) - 1)
    return np.cos(2 * np.pi * np.outer(np.asarray(hz) / RATE_HZ, k)) @ taps


def test_the_filters_are_flat_where_undulations_are_stop_what_folds_on_them_and_droop_as_documented():
    taps = cosine_taps(DECIMATION)
    assert decibels(response(taps, np.linspace(0, 100, 501)) - 1.0) < -83.0  # 0.0006 dB
    near = [1000.0 * m + np.linspace(-100, 100, 201) for m in range(1, 48)]
    assert decibels(response(taps, near[0])) < -80.0
    assert decibels(response(taps, np.concatenate(near[2:]))) < -93.0
    assert decibels(response(taps, np.linspace(10_000, 48_000, 38_001))) < -129.5
    taps = cic_taps(DECIMATION) / DECIMATION**3
    droop = 20 * np.log10(response(taps, [23.0, 100.0]))
    assert droop == pytest.approx([-0.02, -0.43], abs=0.006)
    assert decibels(response(taps, np.linspace(900, 1100, 201))) < -57.0


@pytest.mark.parametrize("kind", ["fused", "cic"])
def test_a_gap_leaves_out_the_windows_that_span_it_and_turns_nothing(kind):
    """A tone of constant phase: what follows a gap of any length reads as what came before."""
    for lost in (1, 7, 95, 96, 1000):
        chain = made(kind)
        frames = np.arange(20_000)
        kept = np.flatnonzero((frames < 5000) | (frames >= 5000 + lost))
        tone = np.rint(0.5 * 2**23 * np.cos(2 * np.pi * 40_000.0 / RATE_HZ * frames + 0.7)).astype(np.int32)
        parts = [chain.push(tone[part, None], int(part[0])) for part in np.split(kept, [5000])]
        span = round(2 * chain.delay_frames) + 1
        assert parts[0].first + len(parts[0].values) == 5000 // DECIMATION
        # the first output whose whole window comes after the gap
        assert parts[1].first == math.ceil((5000 + lost + span) / DECIMATION) - 1
        values = np.concatenate([part.values for part in parts]) * chain.scale / 2**23
        exact = 0.5 * np.array([math.cos(0.7), math.sin(0.7)])
        assert decibels(values - exact) < -150.0
