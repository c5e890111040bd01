"""Contact by level on envelopes that no plant made."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from behaviors.events import Contact, ContactHeld, ContactLost
from controller.detectors.calibration import calibrate_pieces, courses_of, span_maxima
from controller.detectors.level import LevelDetector, LevelPaperDetector, LevelPaperSettings, LevelSettings
from drivers.core.messages import SampleBlock

RATE_HZ = 1000.0
REST = 0.09 + 0.04j
STEP = 0.012 - 0.006j
KAPPA_RAD_M = 1465.0


def noise(n, sigma=2e-5, seed=1):
    rng = np.random.default_rng(seed)
    return sigma * (rng.standard_normal(n) + 1j * rng.standard_normal(n))


def block(z, seq=0):
    values = np.column_stack([z.real, z.imag])
    return SampleBlock("signals.right", seq, seq / RATE_HZ, values, rate_hz=RATE_HZ, unit="FS")


def ours(**settings):
    return LevelDetector("touch", LevelSettings(**settings))


def paper(**settings):
    return LevelPaperDetector("touch", LevelPaperSettings(**settings))


def events_of(detector, *blocks):
    return [event for part in blocks for event in detector.push(part)]


def kinds(events):
    return [type(event) for event in events]


def pressed(t_s, begun_s, ended_s, rise_s=0.01):
    """Share of the step: rises exponentially, falls likewise."""
    on = np.where(t_s >= begun_s, -np.expm1(-(t_s - begun_s).clip(0.0) / rise_s), 0.0)
    off = np.where(t_s >= ended_s, -np.expm1(-(t_s - ended_s).clip(0.0) / rise_s), 0.0)
    return on - off


def level(seconds, begun_s, ended_s, **more):
    t_s = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    return REST + STEP * pressed(t_s, begun_s, ended_s, **more) + noise(len(t_s))


def approach(speed_m_s, end_m, size=0.015, seed=1, rest_s=1.5, hold_s=1.0):
    """Undulations of a finger that comes from 5 cm to a distance, waits, and goes back; braking at 0.5 m/s2."""
    accel = speed_m_s / 0.5
    length_m = 0.05 - end_m
    cruise_s = length_m / speed_m_s - accel
    ramp = np.linspace(0.0, 1.0, max(2, round(accel * RATE_HZ)))
    leg = speed_m_s * np.concatenate([ramp, np.ones(round(cruise_s * RATE_HZ)), ramp[::-1]])
    rest, hold = np.zeros(round(rest_s * RATE_HZ)), np.zeros(round(hold_s * RATE_HZ))
    way_m = np.cumsum(np.concatenate([rest, leg, hold, -leg, hold])) / RATE_HZ
    gap_m = 0.05 - way_m
    echo = size * (1.0 + gap_m / 0.01) ** -2 * np.exp(-1j * KAPPA_RAD_M * gap_m)
    return REST + echo + noise(len(way_m), 5e-5, seed)


def ringing(way_m, seed=1):
    """A mover that goes towards an object quietly, but not to it, and rings at 1e-4 after each stop; its encoder."""
    gap_m, n = way_m[-1] + 0.004 - way_m, len(way_m)
    z = 0.006 * (1.0 + gap_m / 0.01) ** -2 * np.exp(-1j * KAPPA_RAD_M * gap_m)
    stops = np.flatnonzero((np.diff(way_m[:-1]) != 0.0) & (np.diff(way_m[1:]) == 0.0)) + 2
    for stop in stops:
        t_s = np.arange(n - stop) / RATE_HZ
        z[stop:] += 1e-4 * np.exp(-t_s / 0.15) * np.cos(2.0 * np.pi * 30.0 * t_s)
    encoder = way_m[::2] + 1e-5 * np.random.default_rng(seed).standard_normal(len(way_m[::2]))
    values = SampleBlock("arm.position", 0, 0.0, encoder[:, None], rate_hz=RATE_HZ / 2.0, unit="m")
    return block(REST + z + noise(n, 1e-5, seed)), values


def stop_and_go(*legs):
    """Way of a mover: (speed in m/s, seconds) after each other, each begun and ended at 0.5 m/s2, shape (n,)."""
    speeds = [np.zeros(1)]
    for speed, seconds in legs:
        ramp = np.linspace(0.0, speed, max(2, round(speed / 0.5 * RATE_HZ)))
        speeds += [ramp, np.full(round(seconds * RATE_HZ), speed), ramp[::-1]]
    return np.cumsum(np.concatenate(speeds)) / RATE_HZ


# --- ours ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("channels", [1, 2])
def test_start_persistence_and_end_of_a_contact_are_reported_in_time_of_one_channel_or_two(channels):
    pressed_ = block(level(5.0, 2.0, 3.5))
    events = events_of(ours(), replace(pressed_, values=pressed_.values[:, :channels]))
    assert kinds(events) == [Contact, ContactHeld, ContactLost]
    assert 2.0 < events[0].t_s < 2.15
    assert events[1].t_s == pytest.approx(events[0].t_s + 0.5, abs=0.002)
    assert 3.5 < events[2].t_s < 3.55


@pytest.mark.parametrize("speed_m_s", [0.005, 0.01, 0.03])
@pytest.mark.parametrize("end_m", [0.004, 0.02])
def test_undulations_are_no_contact_even_where_the_finger_stops_and_sets_out_again(speed_m_s, end_m):
    for seed in range(3):
        assert events_of(ours(), block(approach(speed_m_s, end_m, seed=seed))) == []


def test_a_contact_that_drifts_for_ten_minutes_is_held_and_one_that_goes_slowly_is_seen_to_go():
    n = 600_000
    t_s = np.arange(n) / RATE_HZ
    z = REST + STEP * pressed(t_s, 2.0, 590.0) + 0.003 * np.sin(2.0 * np.pi * t_s / 300.0) + noise(n)
    events = events_of(ours(), *(block(z[k : k + 5000], k) for k in range(0, n, 5000)))
    assert kinds(events) == [Contact, ContactHeld, ContactLost]
    assert events[2].t_s == pytest.approx(590.0, abs=0.1)
    t_s = np.arange(20_000) / RATE_HZ
    z = REST + STEP * (pressed(t_s, 2.0, 1e9) * np.interp(t_s, [5.0, 15.0], [1.0, 0.0])) + noise(len(t_s))
    events = events_of(ours(), block(z))
    assert kinds(events) == [Contact, ContactHeld, ContactLost]
    assert 10.0 < events[2].t_s < 15.0
    z = np.concatenate([level(4.0, 2.0, 3.0) for _ in range(5)])
    assert kinds(events_of(ours(), block(z))) == 5 * [Contact, ContactHeld, ContactLost]


@pytest.mark.parametrize("rise_s", [1e-9, 3e-4, 7e-4, 2e-3])
@pytest.mark.parametrize("echo_fs", [0.0, 0.001, 0.004])
def test_a_contact_that_is_complete_within_a_few_samples_is_felt_wherever_it_begins(rise_s, echo_fs):
    for late in range(20):
        begun_s = 1.0 + late / RATE_HZ
        t_s = np.arange(round(2.0 * RATE_HZ)) / RATE_HZ
        way_m = 0.02 * (t_s.clip(0.4, begun_s) - 0.4)
        echo = echo_fs * np.exp(1j * KAPPA_RAD_M * way_m)
        events = events_of(ours(), block(level(2.0, begun_s, 9.0, rise_s=rise_s) + echo))
        assert kinds(events) == [Contact, ContactHeld], late
        assert 0.0 < events[0].t_s - begun_s < 0.1


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1.0, -50.0])
def test_a_single_bad_sample_is_no_contact_and_no_end_of_one(bad):
    z = level(5.0, 2.0, 3.5)
    z[[1200, 2800]] = bad
    events = events_of(ours(), block(z))
    assert kinds(events) == [Contact, ContactHeld, ContactLost]
    assert events[0].t_s > 2.0
    assert events[2].t_s > 3.5


def test_lost_samples_are_no_contact_though_the_level_has_changed_and_end_none():
    still = REST + noise(4000)
    assert events_of(ours(), block(still[:2000]), block(still[2100:] + 0.001, 2100)) == []
    z = level(6.0, 2.0, 5.0)
    events = events_of(ours(), block(z[:3000]), block(z[3300:], 3300))
    assert kinds(events) == [Contact, ContactHeld, ContactLost]
    assert events[2].t_s > 5.0


@pytest.mark.parametrize("turned_rad", [0.0, 0.6, -2.2])
@pytest.mark.parametrize("size_fs", [0.001, 0.005])
@pytest.mark.parametrize("towards_rad", [0.3, 1.9])
def test_after_a_gap_over_which_the_drives_phase_stepped_small_contacts_are_seen_as_before(
    turned_rad, size_fs, towards_rad
):
    t_s = np.arange(8000) / RATE_HZ
    z = REST + size_fs * np.exp(1j * towards_rad) * pressed(t_s, 5.0, 7.0) + noise(len(t_s), seed=2)
    z[3000:] *= np.exp(1j * turned_rad)
    events = events_of(ours(), block(z[:3000]), block(z[3037:], 3037))
    assert kinds(events) == [Contact, ContactHeld, ContactLost]
    assert events[0].t_s == pytest.approx(5.0, abs=0.1)
    assert events[2].t_s == pytest.approx(7.0, abs=0.1)


def test_what_rings_after_a_stop_is_a_touch_without_the_encoder_and_none_with_it():
    way_m = stop_and_go((0.0, 1.0), (0.01, 2.0), (0.0, 1.0), (0.03, 1.0), (0.0, 1.0))
    felt: dict[str | None, int] = dict.fromkeys((None, "arm.position"), 0)
    for seed, name in itertools.product(range(5), felt):
        felt[name] += len(kinds(events_of(ours(position_input=name), *ringing(way_m, seed))))
    assert felt[None] > 0
    assert felt["arm.position"] == 0


def test_noise_that_comes_at_once_and_ten_minutes_of_it_are_no_contact():
    for seed in range(20):
        z = REST + np.concatenate([noise(2000, 1e-5, seed), noise(4000, 1e-4, seed + 100)])
        assert events_of(ours(), block(z)) == []
    z = REST + noise(600_000, 5e-5)
    assert events_of(ours(), *(block(z[k : k + 10_000], k) for k in range(0, len(z), 10_000))) == []


def test_a_smaller_step_gives_a_smaller_value_and_a_threshold_above_it_silences_it():
    values = []
    for share in (0.03, 0.01):
        t_s = np.arange(4000) / RATE_HZ
        z = REST + share * STEP * pressed(t_s, 2.0, 1e9) + noise(4000)
        values.append(events_of(ours(), block(z))[0].value)
    assert values[1] < values[0]
    z = REST + 0.01 * STEP * pressed(t_s, 2.0, 1e9) + noise(4000)
    assert events_of(ours(threshold=1.5 * values[1]), block(z)) == []


def unsettled(count, gap_s=1.25, seed=1):
    """Noise, and steps of many sizes: what a bench does that is no contact."""
    rng = np.random.default_rng(seed)
    sizes = rng.exponential(1e-3, count) * np.exp(2j * np.pi * rng.random(count))
    z = REST + np.repeat(np.cumsum(sizes), round(gap_s * RATE_HZ))
    return np.column_stack([z.real, z.imag]) + 3e-5 * rng.standard_normal((len(z), 2))


def test_it_can_be_calibrated_on_a_recording_without_contact():
    columns = unsettled(200)
    recorded = [(ours(), [SampleBlock("signals.right", 0, 0.0, columns, rate_hz=RATE_HZ)])]
    found = calibrate_pieces(recorded, 25.0)
    scores = ours().statistic(columns, RATE_HZ)
    scores = span_maxima(np.append(scores[~np.isnan(scores)], np.zeros(500)), RATE_HZ)
    # 250 s but the half in which it learns, once in 25: nine are above, and the tenth is the threshold itself
    assert np.sum(scores > found.threshold) == 9
    beyond = calibrate_pieces(recorded, 3600.0)
    assert beyond.extrapolated
    assert beyond.threshold > found.threshold


def test_with_an_encoder_it_is_calibrated_on_what_the_bench_compares():
    """A mover that rings after its stops, whose encoder ends half a second early; by time alone it jumps there."""
    way_m = stop_and_go((0.0, 1.0), (0.01, 2.0), (0.0, 1.0), (0.03, 1.0), (0.0, 1.0))
    signal, encoder = ringing(way_m)
    encoder = replace(encoder, values=encoder.values[:-250])
    detector = ours(position_input="arm.position", threshold=1e9)
    assert events_of(detector, signal, encoder) == []
    live = detector.readings[detector.readings[:, 1] > 0.0]
    (course,) = courses_of(detector, [signal, encoder])
    decided = np.flatnonzero(course.statistic > 0.0)
    assert course.times_s[decided].tolist() == live[:, 0].tolist()
    assert course.statistic[decided].tolist() == live[:, 1].tolist()
    assert np.isnan(course.statistic[-499:]).all()
    by_time = ours().statistic(signal.values, RATE_HZ)
    assert np.nanmax(by_time) > 1.5 * np.nanmax(course.statistic)
    with pytest.raises(ValueError, match=r"level: .* three columns"):
        detector.statistic(signal.values, RATE_HZ)


@pytest.mark.parametrize("interval_s", [15.0, 3600.0])
def test_a_quiet_recording_asks_for_no_threshold_and_is_not_called_dead(interval_s):
    quiet = REST + noise(120_000, 5e-5)
    with pytest.raises(ValueError, match=r"of 120 pieces hold anything .* too quiet to ask for a threshold"):
        calibrate_pieces([(ours(), [block(quiet)])], interval_s)
    with pytest.raises(ValueError, match="is the sensor alive"):
        calibrate_pieces([(ours(), [block(np.full(120_000, 0.09 + 0.09j))])], interval_s)


def test_spans_that_do_not_grow_are_refused():
    with pytest.raises(ValueError, match="longer"):
        LevelSettings(spans_s=(0.008, 0.004))


# --- the paper's ---------------------------------------------------------------------------------


@pytest.mark.parametrize("n", [3, 5, 10])
def test_with_gamma_3_the_papers_window_of_ten_samples_or_fewer_never_fires(n):
    """|z| is at most (n - 1) / sqrt(n): 2.85 for n = 10."""
    z = REST + noise(5000)
    z[2500:] += 10.0 * STEP
    assert events_of(paper(window_s=n / RATE_HZ, threshold=3.0), block(z)) == []


def test_the_paper_forgets_a_contact_once_it_fills_a_tenth_of_the_window():
    """A level that fills the share p of the window is sqrt((1 - p) / p) from its mean: 3 at p = 0.1."""
    z = REST + noise(8000, 1e-6)
    z[4000:] += STEP
    events = events_of(paper(window_s=2.0, threshold=3.0, hold_s=0.1), block(z))
    during = [event for event in events if event.t_s >= 4.0]
    assert kinds(during[:3]) == [Contact, ContactHeld, ContactLost]
    assert during[2].t_s - during[0].t_s == pytest.approx(0.2, abs=0.01)


def test_the_papers_window_reports_nothing_until_it_is_full_and_takes_a_forgotten_ones_end_for_a_contact():
    z = level(3.0, 1.0, 2.0)
    events = events_of(paper(window_s=1.5), block(z))
    assert all(event.t_s >= 1.499 for event in events)
    z = level(12.0, 4.0, 8.0)
    starts = [event.t_s for event in events_of(paper(threshold=8.0), block(z)) if isinstance(event, Contact)]
    assert [round(t_s) for t_s in starts] == [4, 8]
