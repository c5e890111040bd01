"""Envelope and encoder in step."""

import numpy as np
import pytest

from controller.detectors.envelope import UNKNOWN, EncoderSync
from drivers.core.messages import SampleBlock

ALONG_X = (1.0, 0.0, 0.0)


def envelope(first, n, rate_hz=1000.0):
    values = np.column_stack([np.arange(first, first + n), np.zeros(n)]).astype(float)
    return SampleBlock("signals.right", first, first / rate_hz, values, rate_hz=rate_hz)


def encoder(first, metres, rate_hz=500.0):
    values = np.asarray(metres, float)[:, None]
    return SampleBlock("arm.position", first, first / rate_hz, values, rate_hz=rate_hz)


def along(encoder="arm.position", direction=ALONG_X):
    return EncoderSync("signals.right", encoder, direction, "testing")


def test_a_sample_waits_until_the_encoder_has_reached_its_time():
    pair = along()
    assert len(pair.push(envelope(0, 10)).times_s) == 0
    samples = pair.push(encoder(0, [0.0, 0.001, 0.002]))
    assert samples.times_s.tolist() == [0.0, 0.001, 0.002, 0.003, 0.004]
    assert samples.position_m == pytest.approx([0.0, 0.0005, 0.001, 0.0015, 0.002])


def test_the_order_of_arrival_changes_nothing():
    signals = [envelope(k, 5) for k in range(0, 60, 5)]
    positions = [encoder(k, [k * 1e-3, 0.1]) for k in range(0, 30, 2)]
    rng = np.random.default_rng(1)

    def push_all(order):
        pair = along()
        found = [pair.push(block) for block in order]
        return [np.concatenate([getattr(part, name) for part in found]) for name in ("z", "position_m")]

    expected = push_all([*positions, *signals])
    for _ in range(5):
        mixed, left, right = [], list(signals), list(positions)
        while left or right:
            mixed.append((left if left and (not right or rng.random() < 0.5) else right).pop(0))
        for one, other in zip(push_all(mixed), expected, strict=True):
            assert np.array_equal(one, other)


def test_readings_that_are_not_finite_are_left_out_and_a_pose_is_measured_along_the_direction():
    pair = along()
    pair.push(envelope(0, 5))
    samples = pair.push(encoder(0, [0.0, np.nan, 0.002]))
    assert samples.position_m == pytest.approx([0.0, 0.0005, 0.001, 0.0015, 0.002])
    pair = along(direction=(0.0, 2.0, 0.0))
    pair.push(envelope(0, 3))
    poses = np.array([[1.0, 0.1, 5.0, 0, 0, 0], [1.0, 0.2, 5.0, 0, 0, 0]])
    samples = pair.push(SampleBlock("arm.position", 0, 0.0, poses, rate_hz=500.0))
    assert samples.position_m == pytest.approx([0.1, 0.15, 0.2])


def test_lost_samples_are_reported_and_no_position_is_made_up_over_a_long_silence():
    pair = along(encoder=None)
    pair.push(envelope(0, 5))
    assert pair.push(envelope(8, 2)).missing.tolist() == [3, 0]
    assert pair.push(envelope(0, 2)).missing.tolist() == [UNKNOWN, 0]
    pair = along()
    pair.push(envelope(0, 400))
    pair.push(encoder(0, [0.0, 0.0]))
    samples = pair.push(encoder(150, [0.01, 0.01]))
    assert np.isnan(samples.position_m[:-3]).all()
    assert samples.position_m[-1] == pytest.approx(0.01)
