"""The clock model against simulated arrivals whose truth is known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from drivers.core.clock_model import PATIENCE_S, SETTLING_S, WINDOW_S, DeviceClock
from drivers.core.messages import Floats
from drivers.core.numbering import GAP, StreamTrack

FRAME_S = 0.01
"""Between two frames of ten samples, at 1 kHz."""

PERIOD_S = 0.001


def pty_delays_s(rng: np.random.Generator, n: int) -> Floats:
    """Delays with the quantiles measured on a pty: 22 us p50, 3.6 ms p99, 16 ms at most."""
    delays_s = 22e-6 * np.exp(0.6 * rng.standard_normal(n))
    slow = rng.random(n) < 0.03
    delays_s[slow] = np.minimum(2.6e-3 * np.exp(0.8 * rng.standard_normal(slow.sum())), 16e-3)
    return delays_s


def bench(
    drift_ppm: float, seconds: float, frames_per_s: int = 100, seed: int = 0, uptime_s: float = 1e6
) -> tuple[Floats, Floats, Floats]:
    """Device times, true host times and arrivals in s; host and board have been up for long."""
    true_s = np.arange(1, round(seconds * frames_per_s) + 1) / frames_per_s
    device_s = np.rint(true_s * (1 + drift_ppm * 1e-6) * 1e6) * 1e-6 + 7_000_000.0
    arrivals_s = true_s + pty_delays_s(np.random.default_rng(seed), len(true_s))
    return device_s, uptime_s + true_s, uptime_s + arrivals_s


def fed(device_s: Floats, arrivals_s: Floats, model: DeviceClock | None = None) -> DeviceClock:
    model = model or DeviceClock()
    for shown_s, arrival_s in zip(device_s.tolist(), arrivals_s.tolist(), strict=True):
        model.observe(shown_s, arrival_s)
    return model


def errors_s(model: DeviceClock, device_s: Floats, true_s: Floats) -> Floats:
    return np.array([model.host_s(shown_s) for shown_s in device_s.tolist()]) - true_s


def dated(device_s: Floats, arrivals_s: Floats) -> Floats:
    """Host times of frames of ten samples, by the last of which the arrivals are: of each frame's first."""
    track = StreamTrack(DeviceClock(), 1.0 / PERIOD_S)
    arrived = zip(device_s.tolist(), arrivals_s.tolist(), strict=True)
    return np.array(
        [track.place(shown_s - 9 * PERIOD_S, arrival_s, n=10).t0_s for shown_s, arrival_s in arrived]
    )


def test_the_simulated_delays_have_the_measured_quantiles() -> None:
    p50, p99, most = np.percentile(pty_delays_s(np.random.default_rng(1), 500_000), [50, 99, 100])
    assert p50 == pytest.approx(22e-6, rel=0.1)
    assert p99 == pytest.approx(3.6e-3, rel=0.1)
    assert most == pytest.approx(16e-3)


@pytest.mark.parametrize("drift_ppm", [-100.0, -80.0, 0.0, 37.0, 100.0])
@pytest.mark.parametrize("seed", range(4))
def test_the_stated_bounds_hold_under_the_measured_jitter(drift_ppm: float, seed: int) -> None:
    device_s, true_s, arrivals_s = bench(drift_ppm, 20.0, seed=seed)
    model = DeviceClock()
    for at in range(len(device_s)):
        model.observe(float(device_s[at]), float(arrivals_s[at]))
        error_s = abs(model.host_s(float(device_s[at])) - true_s[at])
        if at >= 100:
            assert error_s < 2e-5
        if at >= 1000:
            assert error_s < 1e-5
            assert model.drift_ppm == pytest.approx(drift_ppm, abs=1.0)


def test_the_envelope_sees_a_drift_that_a_least_squares_line_does_not() -> None:
    # Delays that grow shorter while the experiment runs, as a busy host comes to rest, tilt a mean.
    device_s, true_s, arrivals_s = bench(-80.0, 6.0, frames_per_s=1000, seed=3)
    arrivals_s = arrivals_s + np.linspace(3e-3, 0.0, len(true_s)) * (np.arange(len(true_s)) % 4 > 0)
    slope = np.polyfit(device_s - device_s[0], arrivals_s - arrivals_s[0], 1)[0]
    assert abs((1.0 / slope - 1.0) * 1e6 + 80.0) > 30.0
    assert fed(device_s, arrivals_s).drift_ppm == pytest.approx(-80.0, abs=5.0)


def test_exact_arrivals_are_reproduced_to_a_microsecond() -> None:
    device_s, true_s, _ = bench(55.0, 5.0)
    assert np.abs(errors_s(fed(device_s, true_s), device_s, true_s)).max() < 1.5e-6


def test_uptimes_of_seventy_days_cost_no_precision() -> None:
    short = bench(25.0, 5.0, uptime_s=0.0)
    long = bench(25.0, 5.0, uptime_s=70 * 86_400.0)
    errors = [errors_s(fed(shown, arrivals), shown, true) for shown, true, arrivals in (short, long)]
    assert errors[0] == pytest.approx(errors[1], abs=1e-8)


def test_the_first_arrival_gives_a_time_at_once() -> None:
    model = DeviceClock()
    assert not model.ready
    model.observe(5.0, 100.0)
    assert model.ready
    assert [model.host_s(5.0), model.host_s(5.01)] == pytest.approx([100.0, 100.01])
    assert model.drift_ppm == 0.0


def test_a_late_first_arrival_is_forgotten_as_soon_as_a_quick_one_comes() -> None:
    model = DeviceClock()
    model.observe(0.0, 10.016)
    model.observe(0.01, 10.010)
    assert model.host_s(0.01) == pytest.approx(10.010)


@pytest.mark.parametrize("drift_ppm", [-100.0, 0.0, 100.0])
def test_a_host_that_stalls_for_two_seconds_moves_nothing(drift_ppm: float) -> None:
    device_s, true_s, arrivals_s = bench(drift_ppm, 10.0)
    stall = (true_s > true_s[0] + 5.0) & (true_s < true_s[0] + 7.0)
    arrivals_s[stall] = true_s[0] + 7.0 + 1e-3
    model = DeviceClock()
    for at in range(len(device_s)):
        model.observe(float(device_s[at]), float(arrivals_s[at]))
        assert at < 100 or abs(model.host_s(float(device_s[at])) - true_s[at]) < 2e-5


def test_bursts_of_late_arrivals_in_half_of_the_time_move_nothing() -> None:
    device_s, true_s, arrivals_s = bench(60.0, 30.0, seed=4)
    late = (true_s - true_s[0]) % 3.0 > 1.4
    arrivals_s = np.maximum.accumulate(
        arrivals_s + late * np.random.default_rng(7).exponential(20e-3, len(late))
    )
    times_s = dated(device_s, arrivals_s)
    settled = true_s - true_s[0] > SETTLING_S
    assert np.abs(times_s + 9 * PERIOD_S - true_s)[settled].max() < 3e-5


def test_where_all_arrivals_are_later_for_good_the_line_follows() -> None:
    device_s, true_s, arrivals_s = bench(-30.0, 40.0)
    arrivals_s[true_s > true_s[0] + 20.0] += 4e-3
    model = fed(device_s, arrivals_s)
    assert model.host_s(float(device_s[-1])) - true_s[-1] == pytest.approx(4e-3, abs=1e-4)
    assert true_s[-1] - true_s[0] > 20.0 + PATIENCE_S


def test_where_all_arrivals_are_quicker_for_good_the_line_follows_at_once() -> None:
    device_s, true_s, arrivals_s = bench(-30.0, 40.0)
    arrivals_s[true_s < true_s[0] + 20.0] += 4e-3
    model = fed(device_s[:2010], arrivals_s[:2010])
    assert model.host_s(float(device_s[2009])) - true_s[2009] == pytest.approx(0.0, abs=1e-4)


def test_the_drift_stays_within_its_bound_whatever_comes() -> None:
    rng = np.random.default_rng(5)
    model = DeviceClock(max_drift_ppm=150.0)
    for at in range(400):
        model.observe(at * 0.01, 50.0 + at * 0.01 + float(rng.exponential(0.5)))
        assert abs(model.drift_ppm) < 150.1


def test_a_drift_that_changes_is_followed() -> None:
    first = bench(-20.0, 100.0, frames_per_s=20)
    second = bench(30.0, 100.0, frames_per_s=20, seed=1)
    model = fed(first[0], first[2])
    shift_device_s = first[0][-1] - second[0][0] + 0.05
    shift_s = first[1][-1] - second[1][0] + 0.05
    model = fed(second[0] + shift_device_s, second[2] + shift_s, model)
    assert model.drift_ppm == pytest.approx(30.0, abs=3.0)


def test_after_an_hour_of_silence_the_known_drift_carries_on_and_the_offset_is_new() -> None:
    device_s, true_s, arrivals_s = bench(60.0, 20.0)
    model = fed(device_s, arrivals_s)
    later_s = float(device_s[-1]) + 3600.0 * (1 + 60e-6)
    model.observe(later_s, float(true_s[-1]) + 3600.0 + 20e-6)
    assert model.host_s(later_s) - true_s[-1] == pytest.approx(3600.0, abs=1e-4)
    assert model.drift_ppm == pytest.approx(60.0, abs=3.0)
    assert not model.settled


def test_memory_is_bounded() -> None:
    device_s, _, arrivals_s = bench(10.0, 4 * WINDOW_S, frames_per_s=20)
    model = fed(device_s, arrivals_s)
    assert sum(len(hull._vertices) for hull in model._hulls) < 100


def test_the_inverse_gives_the_device_time_back() -> None:
    device_s, _, arrivals_s = bench(-90.0, 10.0)
    model = fed(device_s, arrivals_s)
    for shown_s in (float(device_s[0]), float(device_s[-1]), float(device_s[-1]) + 600.0):
        assert model.device_s(model.host_s(shown_s)) == pytest.approx(shown_s, abs=1e-6)


def test_no_sample_is_dated_after_its_arrival() -> None:
    device_s, _, arrivals_s = bench(70.0, 10.0, seed=9)
    model = DeviceClock()
    for shown_s, arrival_s in zip(device_s.tolist(), arrivals_s.tolist(), strict=True):
        model.observe(shown_s, arrival_s)
        assert model.host_s(shown_s) <= arrival_s + 1e-9


def bursts_s(n: int) -> st.SearchStrategy[Floats]:
    """Delays of n frames: quick ones, with bursts of up to a second that are up to 0.2 s late."""
    burst = st.tuples(st.integers(0, n - 1), st.integers(1, 100), st.floats(0.0, 0.2))

    def delays(bursts: list[tuple[int, int, float]], seed: int) -> Floats:
        delays_s = pty_delays_s(np.random.default_rng(seed), n)
        for begin, length, late_s in bursts:
            delays_s[begin : begin + length] += late_s
        return delays_s

    return st.builds(delays, st.lists(burst, max_size=8), st.integers(0, 1000))


@settings(max_examples=60, deadline=None)
@given(bursts_s(600), st.floats(-100.0, 100.0), st.floats(0.0, 70 * 86_400.0))
def test_times_ascend_whatever_arrives_when(delays_s: Floats, drift_ppm: float, uptime_s: float) -> None:
    true_s = 1000.0 + FRAME_S * np.arange(len(delays_s))
    arrivals_s = np.maximum.accumulate(true_s + delays_s)
    times_s = dated(uptime_s + (true_s - 1000.0) * (1 + drift_ppm * 1e-6), arrivals_s)
    spacings_s = times_s[1:] - (times_s[:-1] + 9 * PERIOD_S)
    assert spacings_s.min() >= 0.99 * GAP * PERIOD_S


@settings(max_examples=60, deadline=None)
@given(bursts_s(600), st.floats(0.0, 70 * 86_400.0))
def test_after_a_second_no_step_is_above_fifty_microseconds_for_a_clock_of_constant_offset(
    delays_s: Floats, uptime_s: float
) -> None:
    true_s = 1000.0 + FRAME_S * np.arange(len(delays_s))
    times_s = dated(uptime_s + (true_s - 1000.0), np.maximum.accumulate(true_s + delays_s))
    steps_s = np.abs(np.diff(times_s) - FRAME_S)[true_s[1:] > true_s[0] + SETTLING_S]
    assert steps_s.max() < 50e-6


@settings(max_examples=40, deadline=None)
@given(st.floats(-100.0, 100.0), st.integers(0, 1000), st.lists(st.floats(3.0, 19.0), max_size=5))
def test_a_drift_of_up_to_100_ppm_is_followed_through_bursts(
    drift_ppm: float, seed: int, stalls_s: list[float]
) -> None:
    device_s, true_s, arrivals_s = bench(drift_ppm, 20.0, seed=seed)
    for stall_s in stalls_s:
        stalled = (true_s - true_s[0] > stall_s) & (true_s - true_s[0] < stall_s + 0.5)
        arrivals_s[stalled] += 0.3
    times_s = dated(device_s, np.maximum.accumulate(arrivals_s)) + 9 * PERIOD_S
    assert np.abs(times_s - true_s)[true_s > true_s[0] + 2.0].max() < 5e-5
