"""What a page shows of a trial's signals, of contact at rest and of the paper's Table I."""

import base64
import json
import math
from itertools import pairwise

import numpy as np
import pytest

from controller.measures.stiffness import phasor, ringing
from controller.recording.series import extremes
from controller.reports.approaches import BOUNDS, TABLE_1
from controller.reports.locating import located
from controller.reports.papers import table
from controller.reports.stiffness import arm_of, model_hz
from controller.reports.trial_signals import _measured, _packed, outliers_first, payload
from tests.unit.controller.reports.synthetic_runs import Given, write_transient


def unpacked(curve):
    low, high = curve["span"][2:]
    codes = np.frombuffer(base64.b64decode(curve["y"]), "<u2").astype(float)
    codes[codes == 65535] = np.nan
    return low + codes / 65534 * (high - low)


def test_of_each_stretch_the_first_least_and_the_first_largest_value_are_kept():
    rng = np.random.default_rng(1)
    values = np.round(rng.normal(size=1003), 1)
    values[rng.random(1003) < 0.5] = np.nan
    values[200:300] = np.nan
    values[[123, 777]] = 40.0, -50.0
    edges = np.linspace(0, 1003, 41).astype(int)
    parts = [(start, values[start:end]) for start, end in pairwise(edges)]
    expected = {0, 1002, 123, 777} | {start for start, part in parts if np.isnan(part).all()}
    for pick in (np.nanargmin, np.nanargmax):
        expected |= {start + int(pick(part)) for start, part in parts if not np.isnan(part).all()}
    assert extremes(values, 80).tolist() == sorted(expected)


def test_a_packed_curve_comes_back_within_a_dot_and_breaks_without_a_subscriber():
    values = np.array([1.0, np.nan, 3.0, 2.0])
    back = unpacked(_packed(np.arange(4.0), values, 1500))
    np.testing.assert_allclose(back, values, atol=2.0 / 65534)
    times_s = np.concatenate([[0.0], 90.0 + 0.01 * np.arange(100), 95.0 + 0.01 * np.arange(100)])
    shown_s, shown = _measured(times_s, times_s.copy())
    assert shown_s[0] == 90.0
    assert np.flatnonzero(np.isnan(shown)).tolist() == [100]


def test_outliers_and_failures_come_first_and_what_does_not_fit_is_left_to_the_recording(tmp_path):
    delays_s = [0.30, 0.31, 0.32, 0.90, 0.33, 0.34, 0.35, 0.29]
    given = [Given(delay_s=delay_s) for delay_s in delays_s]
    run = write_transient(tmp_path, [*given, Given(outcome="false_contact")])
    first = [trial for _, trial in outliers_first([run])]
    assert {4, 5, 8, 9} < set(first[:6]), "the longest delay, the middle one, the shortest, what failed"
    assert sorted(first) == list(range(1, 10))
    run = write_transient(tmp_path, [Given()] * 6)
    whole = json.loads(payload([run], 1_000_000))
    assert set(whole) == {f"r0t{trial}" for trial in range(1, 7)}
    assert {panel["label"] for panel in whole["r0t1"]["panels"]} >= {"board.period, Hz", "board.load_cell, N"}
    assert whole["r0t1"]["thresholds"]
    room = len(payload([run], 1)) * 3
    assert len(json.loads(payload([run], 1))) == 1, "one at least"
    small = payload([run], room)
    assert 1 < len(json.loads(small)) < 6
    assert len(small) < 1.5 * room


TIMES_S = np.arange(0.0, 0.3, 1e-3)


def decaying(hz, a_second, size):
    return size * np.exp(-a_second * TIMES_S) * np.cos(2.0 * np.pi * hz * TIMES_S + 0.3)


def test_of_two_that_decay_the_one_in_the_band_is_read_to_a_thousandth_and_none_where_none_rings():
    noise = 1e-4 * np.random.default_rng(1).standard_normal(len(TIMES_S))
    record = 0.37 + decaying(76.2, 15.0, 0.1) + decaying(14.1, 4.0, 0.2) + noise
    assert ringing(record, 1000.0) == pytest.approx(76.2, rel=1e-3)
    assert ringing(np.exp(-5.0 * TIMES_S), 1000.0) is None


def test_a_phasor_is_the_amplitude_and_phase_of_a_cosine_and_the_model_has_the_papers_frequencies():
    times_s = np.arange(0.0, 1.0, 1e-3)
    found = phasor(times_s, 2.0 + 0.5 * np.cos(2.0 * np.pi * 41.3 * times_s + 0.7), 41.3)
    assert found == pytest.approx(0.5 * complex(math.cos(0.7), math.sin(0.7)), abs=1e-3)
    for row in table("backus_model"):
        assert model_hz(row["stiffness_n_m"]) == pytest.approx(row["frequency_hz"], abs=0.5)


def row_at(location, contact_n_m=4220.0, **more):
    ring_hz = model_hz(contact_n_m, arm_of(location))
    return {"location": location, "ring_hz": ring_hz, "frequency_sd_hz": 0.3, **more}


def test_a_location_held_out_of_the_models_line_is_found_on_it_and_without_lock_nothing_is_located():
    found = list(located([row_at(location) for location in "defgh"], "ring_hz"))
    expected_m = [0.0, 6.35e-3, 12.7e-3, 19.05e-3, 25.4e-3]
    assert [each.found_m for each in found] == pytest.approx(expected_m, abs=1e-9)
    rows = [row_at(location, frequency_hz=40.0 + i) for i, location in enumerate("defgh")]
    rows[0]["frequency_sd_hz"] = 2.5
    assert [each.location for each in located(rows, "frequency_hz")] == ["e", "f", "g", "h"]


def test_a_stiffer_contact_is_sought_farther_from_the_joint():
    odd = row_at("g", 1.25 * 4220.0, **{"plant.pad_n_m": 1.25 * 4220.0})
    *_, found = located([*(row_at(location) for location in "defgh"), odd], "ring_hz")
    farther_m = arm_of("g") * (math.sqrt(1.25) - 1.0)
    assert found.true_m - found.found_m == pytest.approx(farther_m, rel=1e-6)


PRINTED = """
a 19.05 3.785 0.33 1.372 0.111 | 0.159 0.15 0.599 0.017
b 12.7 3.691 0.23 0.864 0.073 | 0.360 0.06 0.309 0.004
c 0 4.919 0.20 1.067 0.057 | 0.103 0.00 0.051 0.006
d 0 4.487 0.37 1.643 0.031 | 0.117 0.06 0.280 0.007
e 6.35 4.885 0.43 2.252 0.050 | 0.082 0.06 0.338 0.006
f 12.7 4.843 0.17 0.830 0.050 | 0.163 0.12 0.645 0.006
g 19.05 4.555 0.37 1.710 0.075 | 0.374 0.15 0.776 0.014
h 25.4 3.260 0.59 1.964 0.048 | 0.389 0.09 0.192 0.015
f 12.7 2.540 0.20 0.576 0.038 | 0.305 0.00 0.059 0.005
f 12.7 4.513 0.40 1.761 0.036 | 0.184 0.10 0.407 0.007
f 12.7 6.435 0.23 1.524 0.032 | 0.249 0.06 0.440 0.007
f 12.7 8.060 0.23 2.066 0.054 | 1.042 0.12 1.042 0.005
f 12.7 10.685 0.17 1.880 0.072 | 0.089 0.06 0.616 0.027
f 12.7 11.997 0.23 3.200 0.099 | 2.351 0.06 0.748 0.031
"""
"""Table I as the paper sets it, means and then sigmas, typed from the paper on its own."""


def test_table_1_is_what_the_paper_prints():
    columns = ("speed_m_s", "delay_s", "extent_m", "force_n")
    for row, line in zip(TABLE_1, PRINTED.strip().splitlines(), strict=True):
        location, position, *means = line.split("|")[0].split()
        assert (row["location"], row["micrometer_m"]) == (location, pytest.approx(float(position) / 1000))
        for column, mean, sigma in zip(columns, means, line.split("|")[1].split(), strict=True):
            scale = 1e-3 if "_m" in column else 1.0
            printed = (float(mean) * scale, float(sigma) * scale)
            assert (row[column], row[f"{column}.sd"]) == pytest.approx(printed)


def test_the_papers_own_rows_keep_the_papers_own_bounds_and_extent_is_about_speed_times_time():
    bound = {each["column"]: each["bound"] for each in BOUNDS}
    assert max(row["force_n"] for row in TABLE_1) <= bound["force_n"]
    assert max(row["extent_m"] for row in TABLE_1) <= bound["extent_m"]
    assert sum(row["delay_s"] for row in TABLE_1) / 14 == pytest.approx(bound["delay_s"], abs=0.02)
    for row in TABLE_1:
        assert row["extent_m"] == pytest.approx(row["speed_m_s"] * row["delay_s"], rel=0.35)
