import numpy as np
import pytest

from behaviors.events import BaselineReady, BaselineRefused, Impact, SlipEnded, SlipStarted
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from drivers.core.messages import SampleBlock
from simulator.physics.slip import SENSORS, SlipPlant

STREAM = "board.tangential"


def block(values, rate_hz=1000.0, seq=0):
    values = np.asarray(values, dtype=float)
    columns = values[:, None] if values.ndim == 1 else values
    return SampleBlock(STREAM, seq, seq / rate_hz, columns, rate_hz=rate_hz, unit="V")


def shaken(n, knock_share, rate_hz=1000.0, seed=1, frequency=180.0, size=0.1, noise=0.003):
    """Noise, and a structure that rings at every knock."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(0.2 * rate_hz)) / rate_hz
    ring = np.exp(-34.0 * t_s) * np.sin(2 * np.pi * frequency * t_s)
    knocks = (rng.random(n) < knock_share) * rng.standard_normal(n) * size
    return noise * rng.standard_normal(n) + np.convolve(knocks, ring)[:n]


def slip_after_quiet(rate_hz=1000.0, seed=1, quiet_s=3.0, slip_s=1.0):
    quiet, slip = round(quiet_s * rate_hz), round(slip_s * rate_hz)
    parts = ((quiet, 0.0), (slip, 200.0 / rate_hz), (quiet, 0.0))
    return np.concatenate([shaken(n, share, rate_hz, seed + k) for k, (n, share) in enumerate(parts)])


# --- the paper's ---------------------------------------------------------------------------------


def test_the_papers_detector_decides_at_the_last_sample_of_the_block_that_decides():
    tone = 0.3 * np.sin(2 * np.pi * 187.5 * np.arange(64) / 1000.0)
    x = np.concatenate([np.zeros(128), tone, tone, np.zeros(64)])
    events = SlipPaperDetector("slip", SlipPaperSettings()).push(block(x))
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert [event.t_s for event in events] == [pytest.approx(0.191), pytest.approx(0.319)]
    # a tone on a bin: N / 4 x amplitude^2 x frequency
    assert events[0].value == pytest.approx(16 * 0.09 * 187.5, rel=1e-9)


def test_the_block_is_as_long_at_every_rate():
    for rate_hz, block_s, size in ((1000.0, 0.064, 64), (100.0, 0.16, 16), (2000.0, 0.064, 128)):
        detector = SlipPaperDetector("slip", SlipPaperSettings(block_s=block_s))
        statistic = detector.statistic(np.random.default_rng(1).standard_normal((4 * size, 1)), rate_hz)
        assert np.flatnonzero(~np.isnan(statistic)).tolist() == [k * size - 1 for k in (1, 2, 3, 4)]


def test_the_papers_channel_with_the_highest_frequency_decides_and_a_lost_block_starts_its_block_anew():
    n = np.arange(64)
    strong_and_slow = 3.0 * np.sin(2 * np.pi * 2 * n / 64)
    weak_and_fast = 0.01 * np.sin(2 * np.pi * 20 * n / 64)
    detector = SlipPaperDetector("slip", SlipPaperSettings())
    product = detector.statistic(np.column_stack([strong_and_slow, weak_and_fast]), 1000.0)[-1]
    assert product == pytest.approx(16 * 1e-4 * 312.5, rel=1e-6)
    tone = 0.3 * np.sin(2 * np.pi * 187.5 * np.arange(96) / 1000.0)
    detector = SlipPaperDetector("slip", SlipPaperSettings())
    assert detector.push(block(tone[:32])) == []
    assert detector.push(block(tone[:63], seq=64)) == []
    assert [event.t_s for event in detector.push(block(tone[63:64], seq=127))] == [pytest.approx(0.127)]


# --- ours ----------------------------------------------------------------------------------------


def events_of(detector, *blocks):
    """Its slip events."""
    return [e for each in blocks for e in detector.push(each) if isinstance(e, SlipStarted | SlipEnded)]


def ours(**settings):
    return SlipDetector("slip", SlipSettings(**{"threshold": 25.0, **settings}))


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 2000.0, 4000.0])
def test_slip_is_found_and_its_end_too_at_any_rate(rate_hz):
    events = events_of(ours(), block(slip_after_quiet(rate_hz), rate_hz))
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert 3.0 < events[0].t_s < 3.1
    assert 4.0 < events[1].t_s < 4.4
    assert events[0].value > events[0].threshold


@pytest.mark.parametrize("frequency", [125.0, 180.0, 375.0])
def test_bumps_are_not_slip(frequency):
    """Ten minutes of one bump a second, half as strong again as the knocks of slip above."""
    x = shaken(600_000, 0.001, seed=5, frequency=frequency, size=0.15)
    assert events_of(ours(threshold=40.0), block(x)) == []


def test_an_offset_a_ramp_a_step_and_weak_hum_that_is_switched_on_are_not_slip():
    x = shaken(20_000, 0.0, seed=6) + 3.0
    x[8000:] += 0.0001 * np.arange(12_000)
    x[12_000:] += 1.0
    x[16_000:] -= 1.0
    assert events_of(ours(), block(x)) == []
    x = shaken(8000, 0.0, seed=10)
    x[4000:] += 0.006 * np.sin(2.0 * np.pi * 160.0 * np.arange(4000) / 1000.0)
    assert events_of(ours(), block(x)) == []


def test_it_reports_the_quiet_level_and_refuses_slip_that_runs_at_reset_where_one_is_stored():
    first, *more = ours().push(block(shaken(3000, 0.0, seed=7)))
    assert type(first) is BaselineReady
    assert first.t_s == pytest.approx(1.0, abs=0.02)
    assert 0.001 < first.value < 0.004
    assert more == []
    quiet = ours().push(block(shaken(3000, 0.0, seed=7)))[0].value
    running = np.concatenate([shaken(3000, 0.2, seed=8), shaken(4000, 0.0, seed=9)])
    events = ours(quiet_rms=quiet).push(block(running))
    assert type(events[0]) is BaselineRefused
    assert "stored quiet" in events[0].reason
    assert type(events[-1]) is BaselineReady
    assert events[-1].t_s > 3.0


@pytest.mark.parametrize("dead", [np.zeros(5000), np.full(5000, np.nan)])
def test_a_sensor_of_which_no_quiet_can_be_learned_is_refused_once(dead):
    events = ours().push(block(dead))
    assert [type(event) for event in events] == [BaselineRefused]
    assert "is the sensor alive" in events[0].reason


LOUDER = [(1e3, 2, 0), (2.2e3, 2, 0), (1e4, 2, 0), (1e4, 3, 0.5)]


@pytest.mark.parametrize(("rate_hz", "factor", "allowed_s"), LOUDER)
def test_noise_that_doubles_is_not_slip_nor_for_long_thrice_as_much_at_a_high_rate(
    rate_hz, factor, allowed_s
):
    n = round(3.0 * rate_hz)
    for seed in range(5):
        noise = np.random.default_rng(seed).standard_normal((2 * n, 1))
        noise[n:] *= factor
        above = np.flatnonzero(ours().statistic(noise, rate_hz)[n:] > 25.0)
        assert above.size == 0 or above[-1] <= allowed_s * rate_hz


@pytest.mark.parametrize("sensor", ["fingertip", "flexible_finger"])
def test_a_slip_of_a_second_and_a_half_is_not_followed_as_noise(sensor):
    settings = SENSORS[sensor].model_copy(update={"bridges": SENSORS[sensor].bridges[-1:]})
    plant, n = SlipPlant(settings), 4000
    plant.begin(key=(7, 1), press_m=1e-3)
    arm_m = 0.01 * np.maximum(0.0, np.arange(1, n + 1) / 1000.0 - 2.5)
    values = plant.advance(arm_m, np.full(n, 1e-3), np.zeros(n))
    slid = np.flatnonzero(np.diff(plant.slid_m) > 0.0)
    events = events_of(ours(threshold=20.0), block(values))
    assert 2.5 < events[0].t_s < slid[0] / 1000.0 + 0.1
    assert len(events) == 1, "no end is reported"


def test_slip_at_low_frequencies_is_detected_that_no_second_difference_shows():
    """A soft fingertip's slip: noise of 10 to 80 Hz, ten times the quiet; within a quarter of a period, about."""
    from scipy.signal import butter, sosfilt

    rng = np.random.default_rng(11)
    x = rng.standard_normal(3 * 2200)
    low = sosfilt(butter(2, [10.0, 80.0], "bandpass", fs=2200.0, output="sos"), rng.standard_normal(2200))
    x[2 * 2200 :] += 20.0 * low / low.std()
    started = events_of(ours(threshold=11.0), block(x[: 3 * 2200], 2200.0))
    assert started
    assert 2.0 < started[0].t_s < 2.05


def test_of_several_channels_the_one_that_slips_decides():
    slipping = slip_after_quiet()
    still = shaken(len(slipping), 0.0, seed=9)
    both = events_of(ours(), block(np.column_stack([still, slipping])))
    alone = events_of(ours(channel=1), block(np.column_stack([still, slipping])))
    other = events_of(ours(channel=0), block(np.column_stack([still, slipping])))
    assert [event.t_s for event in both] == [event.t_s for event in alone]
    assert len(alone) == 2
    assert other == []


def test_without_a_hold_slip_ends_below_the_threshold_alone_and_lost_samples_do_not_end_it():
    events = events_of(ours(hold_s=0.0), block(slip_after_quiet()))
    kinds = [type(event) for event in events]
    assert kinds == [SlipStarted, SlipEnded] * (len(kinds) // 2)
    assert all(event.value < event.threshold for event in events[1::2])
    x = slip_after_quiet()
    events = events_of(ours(), block(x[:3500]), block(x[3550:], seq=3550))
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert 4.0 < events[1].t_s < 4.4


@pytest.mark.parametrize("lost", [700, -2000])
def test_after_a_long_gap_or_a_stream_begun_anew_quiet_is_learned_anew(lost):
    x = slip_after_quiet()
    detector = ours()
    started = events_of(detector, block(x[:3500]))
    after = detector.push(block(shaken(1500, 0.0, seed=8), seq=3500 + lost))
    assert [type(event) for event in (*started, *after)] == [SlipStarted, SlipEnded, BaselineReady]
    assert after[0].t_s == pytest.approx((3500 + lost) / 1000.0)
    assert after[1].t_s > after[0].t_s + 0.9


@pytest.mark.parametrize("size", [1, 10, 997])
def test_a_slip_at_reset_is_reported_once_however_blocks_are_cut(size):
    x = 0.1 * np.random.default_rng(2).standard_normal(6000)
    whole = ours(quiet_rms=0.01).push(block(x))
    detector = ours(quiet_rms=0.01)
    cut = [e for n in range(0, len(x), size) for e in detector.push(block(x[n : n + size], seq=n))]
    assert [(type(e), e.t_s) for e in whole] == [(type(e), pytest.approx(e.t_s)) for e in cut]
    assert sum(isinstance(event, BaselineRefused) for event in whole) == 1


def struck(x, at, size, rate_hz=1000.0):
    """The same with an impact of a broad ring that is over in 0.1 s, and bounces of a tenth."""
    t_s = np.arange(len(x) - at) / rate_hz
    ring = np.exp(-t_s / 0.01) * np.random.default_rng(3).standard_normal(len(t_s))
    for late in (0, 20, 45):
        x[at + late :] += (size if late == 0 else 0.1 * size) * ring[: len(x) - at - late]
    return x


def test_an_impact_that_bounces_is_one_and_no_slip_and_what_shakes_after_it_is_quiet():
    x = struck(shaken(6000, 0.0, seed=12), 3000, 1.0)
    events = [event for event in ours().push(block(x)) if not isinstance(event, BaselineReady)]
    assert [type(event) for event in events] == [Impact]
    assert events[0].began_s == pytest.approx(3.0, abs=0.003)
    assert events[0].t_s == pytest.approx(3.1, abs=0.003)
    assert events[0].value > events[0].threshold == pytest.approx(40.0)
    x = struck(shaken(9000, 0.0, seed=12), 3000, 1.0)
    x[3000:] += 0.006 * np.random.default_rng(13).standard_normal(6000)
    x[7000:8000] += shaken(1000, 0.2, seed=14)
    started, ended = events_of(ours(), block(x))
    assert 7.0 < started.t_s < 7.3
    assert ended.t_s > 8.0


def test_a_slip_that_begins_like_an_impact_and_goes_on_is_slip():
    x = shaken(6000, 0.0, seed=15)
    x[3000:5000] += shaken(2000, 0.2, seed=16, size=3.0)
    events = ours().push(block(x))
    assert [type(event) for event in events[1:]] == [SlipStarted, SlipEnded]
    assert 3.0 < events[1].t_s < 3.3


def test_vibration_that_lasts_is_slip_at_the_default_though_no_knock_stands_out():
    rng = np.random.default_rng(17)
    x = rng.standard_normal(6 * 2200)
    soft = np.convolve(rng.standard_normal(2200), np.hanning(30), "same")
    x[3 * 2200 : 4 * 2200] += 1.5 * soft + 1.5 * rng.standard_normal(2200)
    (started, ended) = events_of(ours(), block(x, 2200.0))
    assert 3.1 < started.t_s < 3.5
    assert 4.0 < ended.t_s < 4.5


@pytest.mark.parametrize("rate_hz", [1e3, 1e4, 1e5])
@pytest.mark.parametrize("kind", ["student's", "outliers"])
def test_noise_with_outliers_is_not_slip_at_any_rate(kind, rate_hz):
    rng, n = np.random.default_rng(18), round(10.0 * rate_hz)
    if kind == "outliers":
        x = rng.standard_normal(n) * np.where(rng.random(n) < 0.01, 5.0, 1.0)
    else:
        x = rng.standard_t(3, n)
    assert events_of(ours(), block(x, rate_hz)) == []


@pytest.mark.parametrize(("sigma", "steps_a_s"), [(0.05, 0.1), (0.1, 0.1), (0.15, 0.02), (0.2, 0.1)])
def test_drift_across_the_edge_of_a_coarse_converters_code_is_no_slip_and_a_slip_is(sigma, steps_a_s):
    """Noise below a converter's step of 10 mV, for a minute, then a slip of some of its steps."""
    rng, n = np.random.default_rng(19), 61_000
    x = rng.uniform() + steps_a_s * np.arange(n) / 1000.0 + sigma * rng.standard_normal(n)
    x[60_000:] += 100.0 * shaken(1000, 0.2, seed=20, noise=0.0)
    (started,) = events_of(ours(), block(0.01 * np.round(x)))
    assert 60.0 < started.t_s < 60.2


def received(x, lost, seed):
    """Blocks of what is left where samples were lost at random."""
    keep = np.flatnonzero(np.random.default_rng(seed).random(len(x)) >= lost)
    return [block(x[run], seq=int(run[0])) for run in np.split(keep, np.flatnonzero(np.diff(keep) > 1) + 1)]


@pytest.mark.parametrize("lost", [0.1, 0.2])
@pytest.mark.parametrize("seed", range(5))
def test_where_every_tenth_or_fifth_sample_is_lost_a_slip_is_detected_as_soon(lost, seed):
    x = slip_after_quiet(seed=30 + 3 * seed)
    events = events_of(ours(), *received(x, lost, seed))
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert 3.0 < events[0].t_s < 3.15


@pytest.mark.parametrize("frequency", [125.0, 375.0])
def test_bumps_of_which_samples_are_lost_are_no_slip(frequency):
    """Two minutes: what rings after a bump would be a knock at each lost sample, if the last were held."""
    x = shaken(120_000, 0.001, seed=5, frequency=frequency, size=0.15)
    assert events_of(ours(threshold=40.0), *received(x, 0.1, 1)) == []


def test_a_lost_sample_is_one_that_is_not_finite():
    x = slip_after_quiet(seed=60)
    blocks = received(x, 0.15, 2)
    whole = np.full(len(x), np.nan)
    for each in blocks:
        whole[each.seq : each.seq + len(each)] = each.values[:, 0]
    lost = events_of(ours(), *blocks)
    assert [event.t_s for event in lost] == [event.t_s for event in events_of(ours(), block(whole))]
    assert len(lost) == 2


def test_losses_that_leave_it_deaf_are_refused_once_and_by_name():
    x = shaken(12_000, 0.0, seed=7)
    detector, quiet = ours(), block(x[:3000])
    rest = [each for each in received(x, 0.5, 3) if each.seq > 3000]
    ready, *events = [event for each in (quiet, *rest) for event in detector.push(each)]
    assert isinstance(ready, BaselineReady)
    assert [type(event) for event in events] == [BaselineRefused]
    assert 4.0 < events[0].t_s < 6.0
    assert "deaf for 1 s" in events[0].reason
    detector = ours()
    (refused, *_) = [event for each in received(x, 0.6, 4) for event in detector.push(each)]
    assert isinstance(refused, BaselineRefused)
    assert "of 2000 samples are lost" in refused.reason
    assert refused.t_s == pytest.approx(2.0, abs=0.02)


def test_one_hole_and_every_fifth_sample_lost_are_not_reported():
    x = shaken(12_000, 0.0, seed=7)
    detector, blocks = ours(), received(x, 0.2, 5)
    events = [event for each in blocks if not 6.0 < each.times[0] < 6.4 for event in detector.push(each)]
    assert [type(event) for event in events] == [BaselineReady]
