"""The clock model against simulated arrivals whose truth is known."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from drivers.clock_model import BUCKET_S, WINDOW_S, ClockModel, Timeline

Floats = NDArray[np.float64]
Integers = NDArray[np.int64]


def pty_delays_s(rng: np.random.Generator, n: int) -> Floats:
    """Delays with the quantiles measured on a pty: 22 us p50, 3.6 ms p99, 16 ms at most."""
    delays_s = 22e-6 * np.exp(0.6 * rng.standard_normal(n))
    slow = rng.random(n) < 0.03
    delays_s[slow] = np.minimum(2.6e-3 * np.exp(0.8 * rng.standard_normal(slow.sum())), 16e-3)
    return delays_s


def bench(
    drift_ppm: float, seconds: float, frames_per_s: int = 100, seed: int = 0, uptime_s: float = 1e6
) -> tuple[Integers, Floats, Floats]:
    """Device times in us, true host times and arrivals in s; host and board have been up for long."""
    true_s = np.arange(1, round(seconds * frames_per_s) + 1) / frames_per_s
    device_us = np.rint(true_s * (1 + drift_ppm * 1e-6) * 1e6).astype(np.int64) + 7_000_000_000_000
    arrivals_s = true_s + pty_delays_s(np.random.default_rng(seed), len(true_s))
    return device_us, uptime_s + true_s, uptime_s + arrivals_s


def fed(device_us: Integers, arrivals_s: Floats, model: ClockModel | None = None) -> ClockModel:
    model = model or ClockModel()
    for us, arrival_s in zip(device_us.tolist(), arrivals_s.tolist(), strict=True):
        model.observe(us, arrival_s)
    return model


def test_the_simulated_delays_have_the_measured_quantiles() -> None:
    p50, p99, most = np.percentile(pty_delays_s(np.random.default_rng(1), 500_000), [50, 99, 100])
    assert p50 == pytest.approx(22e-6, rel=0.1)
    assert p99 == pytest.approx(3.6e-3, rel=0.1)
    assert most == pytest.approx(16e-3)


@pytest.mark.parametrize("drift_ppm", [-100.0, -80.0, 0.0, 37.0, 100.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_stated_bounds_hold_under_the_measured_jitter(drift_ppm: float, seed: int) -> None:
    device_us, true_s, arrivals_s = bench(drift_ppm, 20.0, seed=seed)
    model = ClockModel()
    for at in range(len(device_us)):
        model.observe(int(device_us[at]), float(arrivals_s[at]))
        error_s = abs(model.host_s(device_us[at : at + 1])[0] - true_s[at])
        if at >= 100:
            assert error_s < 1e-4
        if at >= 1000:
            assert error_s < 3e-5
            assert model.drift_ppm == pytest.approx(drift_ppm, abs=3.0)


def test_the_envelope_sees_a_drift_that_a_least_squares_line_does_not() -> None:
    # Delays that grow shorter while the experiment runs, as a busy host comes to rest, tilt a mean.
    device_us, true_s, arrivals_s = bench(-80.0, 6.0, frames_per_s=1000, seed=3)
    arrivals_s = arrivals_s + np.linspace(3e-3, 0.0, len(true_s)) * (np.arange(len(true_s)) % 4 > 0)
    slope = np.polyfit((device_us - device_us[0]) * 1e-6, arrivals_s - arrivals_s[0], 1)[0]
    assert abs((1.0 / slope - 1.0) * 1e6 + 80.0) > 30.0
    assert fed(device_us, arrivals_s).drift_ppm == pytest.approx(-80.0, abs=5.0)


def test_exact_arrivals_are_reproduced_to_a_microsecond() -> None:
    device_us, true_s, _ = bench(55.0, 5.0)
    model = fed(device_us, true_s)
    assert np.abs(model.host_s(device_us) - true_s).max() < 1.5e-6


def test_long_uptimes_cost_no_precision() -> None:
    short = bench(25.0, 5.0, uptime_s=0.0)
    long = bench(25.0, 5.0, uptime_s=1e7)
    errors = [fed(us, arrivals).host_s(us) - true for us, true, arrivals in (short, long)]
    assert errors[0] == pytest.approx(errors[1], abs=1e-8)


def test_the_first_arrival_gives_a_time_at_once() -> None:
    model = ClockModel()
    assert not model.ready
    model.observe(5_000_000, 100.0)
    assert model.ready
    assert model.host_s(np.array([5_000_000, 5_010_000])).tolist() == pytest.approx([100.0, 100.01])
    assert model.drift_ppm == 0.0


def test_a_late_first_arrival_is_forgotten_as_soon_as_a_quick_one_comes() -> None:
    model = ClockModel()
    model.observe(0, 10.016)
    model.observe(10_000, 10.010)
    assert model.host_s(np.array([10_000]))[0] == pytest.approx(10.010)


def test_a_stalled_host_moves_nothing() -> None:
    device_us, true_s, arrivals_s = bench(40.0, 10.0)
    stall = (true_s > true_s[0] + 5.0) & (true_s < true_s[0] + 7.0)
    arrivals_s[stall] = true_s[0] + 7.0 + 1e-3
    model = fed(device_us, arrivals_s)
    assert np.abs(model.host_s(device_us) - true_s).max() < 1e-4


def test_the_drift_stays_within_its_bound_whatever_comes() -> None:
    rng = np.random.default_rng(5)
    model = ClockModel(max_drift_ppm=150.0)
    for at in range(400):
        model.observe(at * 10_000, 50.0 + at * 0.01 + float(rng.exponential(0.5)))
        assert abs(model.drift_ppm) < 150.1


def test_a_drift_that_changes_is_followed() -> None:
    first = bench(-20.0, 100.0, frames_per_s=20)
    second = bench(30.0, 100.0, frames_per_s=20, seed=1)
    model = fed(first[0], first[2])
    shift_us = first[0][-1] - second[0][0] + 50_000
    shift_s = first[1][-1] - second[1][0] + 0.05
    model = fed(second[0] + shift_us, second[2] + shift_s, model)
    assert model.drift_ppm == pytest.approx(30.0, abs=3.0)


def test_after_an_hour_of_silence_the_known_drift_carries_on_and_the_offset_is_new() -> None:
    device_us, true_s, arrivals_s = bench(60.0, 20.0)
    model = fed(device_us, arrivals_s)
    later_us = int(device_us[-1]) + round(3600.0 * (1 + 60e-6) * 1e6)
    model.observe(later_us, float(true_s[-1]) + 3600.0 + 20e-6)
    assert model.host_s(np.array([later_us]))[0] - true_s[-1] == pytest.approx(3600.0, abs=1e-4)
    assert model.drift_ppm == pytest.approx(60.0, abs=3.0)


def test_memory_is_bounded() -> None:
    device_us, _, arrivals_s = bench(10.0, 200.0, frames_per_s=20)
    model = fed(device_us, arrivals_s)
    assert len(model._points) <= WINDOW_S / BUCKET_S + 2


def test_the_inverse_gives_the_device_time_back() -> None:
    device_us, _, arrivals_s = bench(-90.0, 10.0)
    model = fed(device_us, arrivals_s)
    for us in (int(device_us[0]), int(device_us[-1]), int(device_us[-1]) + 600_000_000):
        assert model.device_us(float(model.host_s(np.array([us]))[0])) == pytest.approx(us, abs=1)


def test_no_sample_is_dated_after_its_arrival() -> None:
    device_us, _, arrivals_s = bench(70.0, 10.0, seed=9)
    model = ClockModel()
    for us, arrival_s in zip(device_us.tolist(), arrivals_s.tolist(), strict=True):
        model.observe(us, arrival_s)
        assert model.host_s(np.array([us]))[0] <= arrival_s + 1e-9


@settings(max_examples=50, deadline=None)
@given(st.lists(st.floats(0.0, 0.05), min_size=2, max_size=80), st.floats(-150.0, 150.0))
def test_times_that_were_given_out_never_turn_back(delays_s: list[float], drift_ppm: float) -> None:
    model = ClockModel()
    timeline = Timeline(model)
    latest_s = -np.inf
    for at, delay_s in enumerate(delays_s):
        device_us = round(at * 0.01 * (1 + drift_ppm * 1e-6) * 1e6)
        model.observe(device_us, 1000.0 + at * 0.01 + delay_s)
        times_s = timeline.host_s(np.array([device_us - 4_000, device_us], dtype=np.int64))
        timeline.hold(device_us, float(times_s[-1]))
        assert times_s[0] >= latest_s
        assert times_s[1] >= times_s[0]
        latest_s = times_s[1]


def test_a_timeline_goes_on_in_host_time_when_the_board_counts_from_anew() -> None:
    model = ClockModel()
    timeline = Timeline(model)
    model.observe(9_000_000, 50.0)
    timeline.hold(9_000_000, float(timeline.host_s(np.array([9_000_000]))[0]))
    after = ClockModel()
    after.observe(0, 49.5)  # an arrival cannot be earlier; the timeline holds all the same
    timeline.restart(after)
    assert timeline.host_s(np.array([0]))[0] >= 50.0
