"""The load that a finger carries: steps of it, and what it rests at."""

import numpy as np
import pytest

from controller.detectors.load import LoadDetector, LoadSettings
from drivers.core.messages import SampleBlock


def told(force_n, **settings):
    """Times and loads that are told of a force at 1 kHz, after half a second without one."""
    force_n = np.concatenate([np.zeros(500), force_n])
    detector = LoadDetector("load", LoadSettings(channel=0, **settings))
    events = detector.push(SampleBlock("signals.pad", 0, 0.0, force_n[:, None], rate_hz=1000.0))
    return [(event.t_s - 0.5, event.value) for event in events[1:]]


def test_a_load_that_rests_is_told_more_exactly_than_one_that_changes():
    grown = np.concatenate([np.linspace(0.0, 2.0, 400), np.full(600, 2.0)])
    fallen = np.concatenate([grown, np.linspace(2.0, 1.92, 50), np.full(500, 1.92)])
    (_, rested), *_ = reversed(told(grown))
    assert rested == pytest.approx(2.0, abs=0.2 * 0.05 * 2.0 + 1e-9)
    t_s, fell_n = told(fallen)[-1]
    assert fell_n == pytest.approx(1.92, abs=0.2 * 0.05 * 2.0), "4 %, less than a step"
    assert t_s < 1.05 + 0.15


def test_a_load_that_swings_is_told_at_its_mean_and_a_ramp_at_its_last_milliseconds():
    swings = 2.0 + 0.06 * np.sin(2.0 * np.pi * 50.0 * np.arange(1000) / 1000.0)
    assert told(swings)[-1][1] == pytest.approx(2.0, abs=0.02)
    ramp_n = 4.3 * np.arange(700) / 1000.0
    for t_s, load_n in told(ramp_n):
        assert load_n == pytest.approx(4.3 * (t_s - 0.0015), abs=1e-6), "not of a tenth of a second"
