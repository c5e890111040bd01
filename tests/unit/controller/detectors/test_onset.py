"""When a knock began, and how well that is known."""

import numpy as np
import pytest

from behaviors.events import BaselineReady, BaselineRefused, Onset
from controller.detectors.onset import OnsetDetector, OnsetSettings, began
from drivers.core.messages import SampleBlock

RATE_HZ = 10_000.0


def heard(values, rate_hz=RATE_HZ, seq=0, listener=None, **settings):
    listener = listener or OnsetDetector("knock", OnsetSettings(**settings))
    values = np.asarray(values, dtype=float)[:, None]
    return listener.push(SampleBlock("board.accelerometer", seq, seq / rate_hz, values, rate_hz=rate_hz))


def onsets(values, **given):
    return [event for event in heard(values, **given) if isinstance(event, Onset)]


def noise(n, seed=1):
    return 1e-3 * np.random.default_rng(seed).standard_normal(n)


def knock(n, rise_s, hz=900.0, decay_s=0.01):
    """A ring that grows as the square of time for `rise_s`, then dies away."""
    t_s = (np.arange(n) + 1) / RATE_HZ
    return np.minimum(1.0, t_s / rise_s) ** 2 * np.exp(-t_s / decay_s) * np.sin(2.0 * np.pi * hz * t_s)


@pytest.mark.parametrize(("rise_s", "amplitude"), [(1e-4, 0.02), (1e-4, 0.5), (2e-3, 0.05), (2e-3, 1.0)])
def test_the_time_of_a_knock_lies_within_what_is_said_of_it(rise_s, amplitude):
    """Drawn 60 times: its interval of 95 % holds the truth in 47 at least, far from what a normal law would allow for
    one that is half as wide; nor is it wide enough to say nothing."""
    found = []
    for seed in range(60):
        x = noise(9_000, seed)
        x[8_000:] += amplitude * knock(1_000, rise_s)
        (event,) = onsets(x)
        # it began between the last sample without it and the first with it
        found.append((event.began_s - 7_999.5 / RATE_HZ, event.sigma_s))
        assert event.t_s >= event.began_s
    off, sigma = np.array(found).T
    assert np.sum(np.abs(off) < 1.96 * sigma) >= 47
    assert np.median(np.abs(off)) < 1e-4 + 0.6 * rise_s
    assert np.median(sigma) < 1e-4 + rise_s


def test_a_knock_is_dated_to_a_sample_and_one_vibration_that_lasts_is_one_onset():
    left = np.random.default_rng(2).standard_normal(60)
    left[50:] *= 100.0
    ago, sigma = began(left)
    assert ago == pytest.approx(9.5 + 0.5, abs=1.0), "ten samples are of the knock"
    assert sigma < 1.0
    x = noise(40_000)
    x[10_000:14_000] += noise(4_000, seed=2) * 30.0
    x[30_000:30_100] += noise(100, seed=3) * 30.0
    first, second = onsets(x)
    assert (first.began_s, second.began_s) == (pytest.approx(1.0, abs=2e-3), pytest.approx(3.0, abs=2e-3))


@pytest.mark.parametrize("rate_hz", [1_000.0, 10_000.0, 100_000.0])
@pytest.mark.parametrize("kind", ["normal", "t3", "t4", "one in a hundred five times as large"])
def test_outliers_are_no_onset_at_any_rate(kind, rate_hz):
    rng, n = np.random.default_rng(5), round(min(60.0, 2e6 / rate_hz) * rate_hz)
    x = {
        "normal": lambda: rng.standard_normal(n),
        "t3": lambda: rng.standard_t(3, n),
        "t4": lambda: rng.standard_t(4, n),
    }.get(kind, lambda: rng.standard_normal(n) * np.where(rng.random(n) < 0.01, 5.0, 1.0))()
    assert onsets(x, rate_hz=rate_hz) == []


def test_hum_drift_and_slow_noise_are_quiet():
    n = 60_000
    t_s = np.arange(n) / RATE_HZ
    x = noise(n) * (1.0 + 0.3 * t_s / 6.0) + 0.05 * np.sin(2.0 * np.pi * 50.0 * t_s) + 0.02 * t_s
    assert onsets(x) == []
    x[40_000:40_300] += noise(300, seed=4) * 20.0
    (event,) = onsets(x)
    assert event.began_s == pytest.approx(4.0, abs=1e-3)


def test_a_knock_in_the_quiet_is_refused_once_and_the_quiet_learned_after_it():
    x = noise(20_000)
    x[2_000:2_200] += 0.5 * noise(200, seed=2) / 1e-3
    refused, ready = heard(x)
    assert isinstance(refused, BaselineRefused)
    assert "something knocked while the quiet was learned" in refused.reason
    assert isinstance(ready, BaselineReady)
    assert ready.t_s == pytest.approx(0.9999)


def test_a_dead_sensor_is_refused_lost_samples_are_no_onset_and_a_long_gap_learns_anew():
    (refused,) = heard(np.full(20_000, 2.5))
    assert "the quiet is constant" in refused.reason
    (refused,) = heard(np.full(20_000, np.nan))
    assert "a value of the quiet is not finite" in refused.reason
    listener = OnsetDetector("knock", OnsetSettings())
    heard(noise(10_000), listener=listener)
    assert heard(5.0 + noise(10_000, seed=2), seq=12_000, listener=listener) == []
    (ready,) = heard(noise(10_000, seed=3), seq=90_000, listener=listener)
    assert isinstance(ready, BaselineReady)


@pytest.mark.parametrize("learned", [0.12, 0.3])
@pytest.mark.parametrize("sigma", [0.0, 0.05, 0.12])
def test_a_converter_that_goes_from_one_code_to_the_edge_of_two_is_no_onset_and_a_knock_is(learned, sigma):
    """In steps of the converter, at 1 kHz: noise at its middle is learned, less of it stands there for 13 s, moves to
    the edge and stays, or makes one step where there is none; then something knocks."""
    rng = np.random.default_rng(7)
    place = np.concatenate([np.zeros(13_500), np.full(8_000, 0.5 if sigma else 1.0)])
    x = place + np.where(np.arange(21_500) < 500, learned, sigma) * rng.standard_normal(21_500)
    x[100] = 1.0  # the quiet shows one step at least
    assert onsets(0.05 * np.round(x), rate_hz=1000.0) == []
    x[21_000:21_040] += 5.0 * rng.standard_normal(40)
    (event,) = onsets(0.05 * np.round(x), rate_hz=1000.0)
    assert event.began_s == pytest.approx(21.0, abs=0.01)
