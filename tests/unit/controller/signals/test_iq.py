"""Sound in, I and Q out: times, losses, excursions, and what is refused."""

import numpy as np
import pytest
from pydantic import ValidationError

from controller.signals.iq import Iq, IqSettings
from drivers.audio.oscillator import tone
from drivers.core.messages import SampleBlock, Saturated

RATE_HZ = 96_000
FS = 2.0**-23


def iq(**settings):
    return Iq("finger", IqSettings(**settings))


def sound(values, seq=0, t0_s=0.0, **more):
    about = {"rate_hz": float(RATE_HZ), "unit": "FS", "scale": FS, **more}
    return SampleBlock("audio.fingers", seq, t0_s, values, **about)


def fingers(z_right, z_left, frame=0, drive_hz=40_000.0):
    """Counts of both fingers whose envelopes are these, each shape (n,), at the drive of the audio device."""
    n = len(z_right)
    cosine = tone(frame, n, drive_hz, 1.0)
    # a quarter of a period later the cosine is a sine: taken from the drive's own arithmetic where it has one
    steps = round(drive_hz * 1000) * (np.arange(frame, frame + n) % 96_000_000) % 96_000_000
    phase = 2 * np.pi * steps / 96e6
    waves = [z.real * cosine - z.imag * np.sin(phase) for z in (z_right, z_left)]
    return np.rint(np.column_stack(waves) * 2**23).astype(np.int32)


def outputs(signal, values, sizes, seq=0, t0_s=0.0):
    """Everything that comes out when these frames go in, in blocks of these sizes over and over."""
    out, place, turn = [], 0, 0
    while place < len(values):
        part = values[place : place + sizes[turn % len(sizes)]]
        out += signal.push(sound(part, seq + place, t0_s + place / RATE_HZ))
        place, turn = place + len(part), turn + 1
    return out


def joined(blocks):
    """Numbers, times and I + jQ."""
    seq = np.concatenate([block.seq + np.arange(len(block)) for block in blocks])
    times_s = np.concatenate([block.times for block in blocks])
    values = np.concatenate([block.physical for block in blocks])
    return seq, times_s, values[:, 0] + 1j * (values[:, 1] if values.shape[1] > 1 else 0.0)


def right(t):
    return 0.2 - 0.1j + 0.01 * np.exp(2j * np.pi * 12.0 * t)


def left(t):
    return -0.05 + 0.3j + 0.02 * np.exp(-2j * np.pi * 30.0 * t)


@pytest.mark.parametrize("drive_hz", [40_000.0, 39_876.543])
@pytest.mark.parametrize(("variant", "limit_db"), [("fused", -119.0), ("cic", -80.0)])
@pytest.mark.parametrize(("channel", "finger"), [(0, right), (1, left)])
def test_each_finger_gives_its_own_envelope_at_its_own_time(channel, finger, variant, limit_db, drive_hz):
    frame, t = 10**8, np.arange(48_000) / RATE_HZ
    signal = iq(channel=channel, variant=variant, drive_hz=drive_hz)
    _, times_s, z = joined(outputs(signal, fingers(right(t), left(t), frame, drive_hz), [960], frame, 5.0))
    # cic: its droop at 30 Hz, 0.4 % of an undulation of 0.02
    assert 20 * np.log10(np.abs(z - finger(times_s - 5.0)).max()) < limit_db


def test_in_phase_alone_is_one_channel():
    t = np.arange(9600) / RATE_HZ
    signal = iq(variant="in_phase")
    blocks = outputs(signal, fingers(right(t), left(t)), [1000])
    _, times_s, z = joined(blocks)
    assert signal.info.channels == ("I",)
    assert blocks[0].values.shape[1] == 1
    assert z == pytest.approx(right(times_s).real, abs=1e-6)


@pytest.mark.parametrize("drive_hz", [40_000.0, 40_123.457, 25_000.001])
@pytest.mark.parametrize("variant", ["fused", "cic", "in_phase"])
def test_blocks_of_any_size_give_the_same_to_the_bit(variant, drive_hz):
    values = np.random.default_rng(1).integers(-(1 << 23), 1 << 23, (20_000, 2)).astype(np.int32)
    settings, first = {"variant": variant, "drive_hz": drive_hz}, 10**9 + 5
    made = outputs(iq(**settings), values, [20_000], first)
    seq, times_s, z = joined([each for each in made if isinstance(each, SampleBlock)])
    for sizes in ([1, 1, 95, 700, 13], [96], [480, 481]):
        made = outputs(iq(**settings), values, sizes, first)
        again = joined([each for each in made if isinstance(each, SampleBlock)])
        assert np.array_equal(again[0], seq)
        assert again[1] == pytest.approx(times_s, abs=1e-12)
        assert np.array_equal(again[2], z)


@pytest.mark.parametrize("variant", ["fused", "cic"])
@pytest.mark.parametrize("lost", [1, 2, 50, 4000])
def test_a_lost_frame_leaves_a_jump_in_the_numbers_and_no_step(variant, lost):
    rng = np.random.default_rng(2)
    n = 30_000
    noise = 1e-4 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    values = fingers(np.full(n, 0.2 - 0.1j) + noise, np.zeros(n))
    signal = iq(variant=variant)
    before = [b for b in signal.push(sound(values[:10_000])) if len(b)]
    after = signal.push(sound(values[10_000 + lost :], 10_000 + lost, (10_000 + lost) / RATE_HZ))
    assert after[0].seq > before[-1].seq + len(before[-1])
    _, times_s, z = joined([*before, *after])
    sigma = np.std(joined(before)[2])
    assert np.abs(z - (0.2 - 0.1j)).max() < 6 * sigma
    # times stay on the grid of outputs, whatever was lost
    assert np.diff(times_s) * 1000.0 == pytest.approx(np.rint(np.diff(times_s) * 1000.0), abs=1e-6)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_counts_as_lost(bad):
    t = np.arange(9600) / RATE_HZ
    values = fingers(right(t), left(t)) * FS
    good = joined(iq().push(sound(values.copy(), scale=1.0)))
    values[5000:5003, 0] = bad
    seq, _, z = joined(iq().push(sound(values, scale=1.0)))
    assert np.isfinite(z).all()
    lost = set(good[0].tolist()) - set(seq.tolist())
    assert lost == set(range(5000 // 96, 5000 // 96 + 6))
    assert np.array_equal(z, good[2][np.isin(good[0], seq)])
    # the other finger is unaffected
    assert len(joined(iq(channel=1).push(sound(values, scale=1.0)))[0]) == len(good[0])


@pytest.mark.parametrize("size", [96, 1000, 40_000])
def test_an_excursion_to_full_scale_is_reported_once(size):
    values = np.zeros((40_000, 2), np.int32)
    values[5000:9000:12, 0] = (1 << 23) - 1
    values[30_000, 0] = -(1 << 23)
    found = [thing for thing in outputs(iq(), values, [size]) if isinstance(thing, Saturated)]
    assert {one.stream for one in found} == {"signals.finger"}
    assert [round(one.t_s * RATE_HZ) for one in found] == [5000, 30_000]
    assert [one.value for one in found] == pytest.approx([1.0, -1.0], abs=1e-6)
    assert not [thing for thing in outputs(iq(channel=1), values, [size]) if isinstance(thing, Saturated)]


def test_an_envelope_is_passed_on_and_its_bad_samples_left_out():
    values = np.arange(40.0).reshape(10, 4) * 1e-3
    block = sound(values, 7, 1.0, rate_hz=1000.0, scale=1.0)
    (made,) = iq(channel=1).push(block)
    assert (made.seq, made.t0_s, made.rate_hz, made.stream) == (7, 1.0, 1000.0, "signals.finger")
    assert np.array_equal(made.values, values[:, 2:])
    values[4, 3] = np.nan
    parts = iq(channel=1).push(sound(values, 7, 1.0, rate_hz=1000.0, scale=1.0))
    assert [(part.seq, len(part), part.t0_s) for part in parts] == [(7, 4, 1.0), (12, 5, 1.005)]


def test_clocks_20_ppm_apart_are_measured_and_tracked():
    n = 8 * RATE_HZ
    t = np.arange(n) / RATE_HZ
    beat = np.exp(2j * np.pi * 20e-6 * 40_000.0 * t)
    values = fingers((0.1 + 0.05j) * beat, np.zeros(n))
    watching = iq(clocks="watched")
    _, _, z = joined(outputs(watching, values, [9600]))
    assert watching.drift_ppm == pytest.approx(20.0, abs=0.01)
    assert np.ptp(np.unwrap(np.angle(z))) > 30.0
    tracking = iq(clocks="tracked")
    _, times_s, z = joined(outputs(tracking, values, [9600]))
    assert times_s[0] == pytest.approx(1.003, abs=0.002)
    assert np.ptp(np.unwrap(np.angle(z))) < 1e-3
    assert np.isnan(iq().drift_ppm)
    assert watching.account()["drift_ppm"] == watching.drift_ppm
    assert "signals.finger: drive and converter are 20 ppm apart" in watching.account()["warning"]
    # a removed beat needs no warning
    assert tracking.account() == {"clocks": "tracked", "drift_ppm": pytest.approx(20.0, abs=0.01)}


@pytest.mark.parametrize("clocks", ["watched", "locked"])
def test_one_clock_is_no_cause_for_a_warning_and_measured_only_where_it_is_watched(clocks):
    rng = np.random.default_rng(1)
    n = 5 * RATE_HZ
    noise = 1e-4 * (rng.standard_normal(n) + 1j * rng.standard_normal(n))
    signal = iq(clocks=clocks)
    assert signal.account() == {}
    outputs(signal, fingers(0.2 + noise, np.zeros(n)), [9600])
    account = signal.account()
    assert ("drift_ppm" in account) == (clocks == "watched")
    assert abs(account.get("drift_ppm", 0.0)) < 0.01
    assert "warning" not in account


def test_a_reset_forgets_and_in_phase_alone_cannot_track():
    values = np.random.default_rng(1).integers(-(1 << 20), 1 << 20, (5000, 2)).astype(np.int32)
    signal = iq()
    first = joined(signal.push(sound(values)))
    signal.reset()
    assert np.array_equal(joined(signal.push(sound(values)))[2], first[2])
    with pytest.raises(ValidationError, match="in-phase alone cannot show a beat"):
        IqSettings(variant="in_phase", clocks="tracked")


@pytest.mark.parametrize(
    ("settings", "more", "shape", "reason"),
    [
        ({}, {"rate_hz": 44_100.0}, (10, 2), "44100 frames a second are no multiple"),
        ({}, {"rate_hz": 48_000.0}, (10, 2), "can do 3000 to 22500 Hz; record at"),
        ({"channel": 1}, {}, (10, 1), "1 channel where signals.finger needs 2"),
        ({"channel": 1}, {"rate_hz": 1000.0}, (10, 2), "2 channels where signals.finger needs 4"),
        ({}, {"rate_hz": None, "times_s": np.arange(10.0)}, (10, 2), "irregular times"),
        ({}, {"scale": 2.0**-31}, (10, 2), "counts of more than 24 bits"),
    ],
)
def test_a_stream_that_will_not_do_is_refused_in_one_line(settings, more, shape, reason):
    with pytest.raises(ValueError, match=reason) as error:
        iq(**settings).push(sound(np.zeros(shape, np.int32), **more))
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("variant", ["fused", "in_phase", "cic"])
def test_once_warmed_up_sound_brings_nothing_new_to_compile(variant):
    from controller.signals import demodulation as kernel

    def signatures():
        return {name: len(vars(kernel)[name].signatures) for name in ("fused", "peak")}

    signal = iq(variant=variant)
    signal.warm_up()
    compiled = signatures()
    assert compiled["peak"] and compiled["fused"]
    z = 0.1 * np.ones(960)
    counts = fingers(z, z, frame=4_320_000_000)
    first = signal.push(sound(counts, seq=4_320_000_000))
    assert first
    assert signatures() == compiled
    unwarmed = iq(variant=variant).push(sound(counts, seq=4_320_000_000))
    assert [block.seq for block in first] == [block.seq for block in unwarmed]
    assert all(np.array_equal(a.values, b.values) for a, b in zip(first, unwarmed, strict=True))


@pytest.mark.parametrize(
    ("settings", "key", "reason"),
    [
        ({"drive_hz": 46_500.0}, None, ""),
        ({"drive_hz": 3000.0}, None, ""),
        ({"drive_hz": 43_000.0, "variant": "cic"}, None, ""),
        ({"drive_hz": 40_000.0, "output_hz": 4000.0}, None, ""),
        ({"drive_hz": 46_501.0}, "drive_hz", "can do 3000 to 46500 Hz; lower output_hz to 989.691"),
        ({"drive_hz": 2999.0}, "drive_hz", "can do 3000 to 46500 Hz; lower output_hz to 989.691"),
        ({"drive_hz": 44_000.0, "variant": "cic"}, "drive_hz", "10000 to 43000 Hz; lower output_hz to 800"),
        ({"output_hz": 4000.0, "variant": "cic"}, "drive_hz", "no drive at all; lower output_hz to 1600"),
        ({"drive_hz": 47_990.0}, "drive_hz", "choose another drive"),
        ({"output_hz": 900.0}, "output_hz", "no multiple"),
    ],
)
def test_settings_name_the_unsuitable_and_its_remedy(settings, key, reason):
    unsuitable = IqSettings(**settings).unsuitable()
    assert (unsuitable[0] if unsuitable else None) == key
    assert unsuitable is None or reason in unsuitable[1]


@pytest.mark.parametrize(
    ("variant", "output_hz"),
    [("fused", 100.0), ("fused", 1000.0), ("fused", 4000.0), ("cic", 100.0), ("cic", 1000.0)],
)
def test_at_either_end_of_the_range_image_and_offset_are_down(variant, output_hz):
    guard, limit_db = {"fused": (3.0, -95.0), "cic": (10.0, -90.0)}[variant]
    z = np.full(round(40 * RATE_HZ / output_hz), 0.2 + 0.1j)
    # half an output away from where the sums have a zero
    away_hz = (guard + 0.5) * output_hz
    for drive_hz in (away_hz, 0.5 * (RATE_HZ - away_hz)):
        assert IqSettings(variant=variant, output_hz=output_hz, drive_hz=drive_hz).unsuitable() is None
        counts = fingers(z, z, drive_hz=drive_hz) + round(0.1 * 2**23)
        chain = iq(variant=variant, output_hz=output_hz, drive_hz=drive_hz)
        _, _, found = joined(outputs(chain, counts, [9600]))
        # twice the offset is mixed onto the drive, and the image is as large as the envelope
        assert 20 * np.log10(np.abs(found - z[0]).max() / 0.3) < limit_db + 6.0
