import numpy as np
import pytest

from behaviors.events import BorderLeft, BorderNear
from controller.detectors.border import BorderDetector, BorderSettings
from drivers.core.messages import SampleBlock

RATE_HZ = 1000.0


def forces(angle_rad, force_n=4.0, noise_n=0.0):
    angle_rad = np.asarray(angle_rad, dtype=float)
    found = force_n * np.column_stack([np.sin(angle_rad), np.cos(angle_rad)])
    return found + noise_n * np.random.default_rng(3).standard_normal(found.shape)


def events_of(forces_n, **settings):
    detector = BorderDetector("border", BorderSettings(**settings))
    return detector.push(SampleBlock("signals.tip", 0, 0.0, forces_n, rate_hz=RATE_HZ))


def test_it_reports_the_side_and_the_return():
    there = np.concatenate([np.linspace(0.0, -1.0, 1001), np.linspace(-1.0, 0.0, 1001)])
    near, left = events_of(forces(there))
    assert (type(near), type(left)) == (BorderNear, BorderLeft)
    # the mean of 20 samples lags by 9.5 ms, 9.5 mrad of a ramp of a radian a second
    assert near.t_s == pytest.approx(0.81, abs=0.0015)
    assert (near.value, near.angle_rad) == pytest.approx((0.8, -0.8), abs=0.002)
    assert left.value == pytest.approx(0.35, abs=0.002), "below half of 0.8 rad for 50 ms"


def test_a_tip_that_is_hardly_pressed_has_no_angle():
    assert events_of(forces(np.full(500, 1.2), force_n=0.49)) == []
    assert len(events_of(forces(np.full(500, 1.2), force_n=0.51))) == 1


def test_a_lift_from_near_the_border_and_noise_near_the_threshold_are_one_report():
    near = forces(np.full(500, 1.2))
    in_air = forces(np.linspace(-3.0, 3.0, 500), force_n=0.03)
    assert [type(event) for event in events_of(np.concatenate([near, in_air, near]))] == [BorderNear]
    # 35 mN at 4 N, as the simulated bridges: the hysteresis is wider.
    found = events_of(forces(np.linspace(0.7, 0.9, 5000), noise_n=0.035))
    assert [type(event) for event in found] == [BorderNear]


def test_a_gap_begins_a_new_mean():
    detector = BorderDetector("border", BorderSettings())
    for seq, n, events in ((0, 19, 0), (25, 19, 0), (44, 1, 1)):
        part = SampleBlock("signals.tip", seq, seq / RATE_HZ, forces(np.full(n, 1.0)), rate_hz=RATE_HZ)
        assert len(detector.push(part)) == events
