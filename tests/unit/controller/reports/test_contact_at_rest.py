"""A6 and A4b on numbers that follow from the paper's equation."""

import math

import numpy as np
import pytest

from controller.measures.stiffness import phasor, ringing
from controller.reports.locating import located
from controller.reports.papers import table
from controller.reports.stiffness import arm_of, model_hz

TIMES_S = np.arange(0.0, 0.3, 1e-3)


def decaying(hz, a_second, size):
    return size * np.exp(-a_second * TIMES_S) * np.cos(2.0 * np.pi * hz * TIMES_S + 0.3)


def test_of_two_that_decay_the_one_in_the_band_is_read_to_a_thousandth():
    noise = 1e-4 * np.random.default_rng(1).standard_normal(len(TIMES_S))
    record = 0.37 + decaying(76.2, 15.0, 0.1) + decaying(14.1, 4.0, 0.2) + noise
    assert ringing(record, 1000.0) == pytest.approx(76.2, rel=1e-3)


def test_what_does_not_ring_has_no_frequency():
    assert ringing(np.exp(-5.0 * TIMES_S), 1000.0) is None


def test_a_phasor_is_the_amplitude_and_phase_of_a_cosine():
    times_s = np.arange(0.0, 1.0, 1e-3)
    found = phasor(times_s, 2.0 + 0.5 * np.cos(2.0 * np.pi * 41.3 * times_s + 0.7), 41.3)
    assert found == pytest.approx(0.5 * complex(math.cos(0.7), math.sin(0.7)), abs=1e-3)


def test_the_model_has_the_papers_frequencies():
    for row in table("backus_model"):
        assert model_hz(row["stiffness_n_m"]) == pytest.approx(row["frequency_hz"], abs=0.5)


def row_at(location, contact_n_m=4220.0, **more):
    return {
        "location": location,
        "ring_hz": model_hz(contact_n_m, arm_of(location)),
        "frequency_sd_hz": 0.3,
        **more,
    }


def test_a_location_held_out_of_the_models_line_is_found_on_it():
    found = list(located([row_at(location) for location in "defgh"], "ring_hz"))
    assert [each.found_m for each in found] == pytest.approx(
        [0.0, 6.35e-3, 12.7e-3, 19.05e-3, 25.4e-3], abs=1e-9
    )


def test_a_stiffer_contact_is_sought_farther_from_the_joint():
    odd = row_at("g", 1.25 * 4220.0, **{"plant.pad_n_m": 1.25 * 4220.0})
    *_, found = located([*(row_at(location) for location in "defgh"), odd], "ring_hz")
    farther_m = arm_of("g") * (math.sqrt(1.25) - 1.0)
    assert found.true_m - found.found_m == pytest.approx(farther_m, rel=1e-6)


def test_a_loop_without_lock_locates_nothing():
    rows = [row_at(location, frequency_hz=40.0 + i) for i, location in enumerate("defgh")]
    rows[0]["frequency_sd_hz"] = 2.5
    assert [each.location for each in located(rows, "frequency_hz")] == ["e", "f", "g", "h"]
