import base64
import json
from itertools import pairwise

import numpy as np

from controller.recording.series import extremes
from controller.reports.trial_signals import _measured, _packed, outliers_first, payload
from tests.unit.controller.reports.synthetic_runs import Given, write_transient


def unpacked(curve):
    low, high = curve["span"][2:]
    codes = np.frombuffer(base64.b64decode(curve["y"]), "<u2").astype(float)
    codes[codes == 65535] = np.nan
    return low + codes / 65534 * (high - low)


def test_a_reduced_curve_keeps_every_peak():
    values = np.random.default_rng(0).normal(size=100_000)
    values[[123, 77_777]] = 40.0, -50.0
    keep = extremes(values, 1500)
    assert len(keep) <= 1502
    assert {123, 77_777, 0, 99_999} <= set(keep.tolist())
    assert np.all(np.diff(keep) > 0)


def test_of_each_stretch_the_first_least_and_the_first_largest_value_are_kept():
    rng = np.random.default_rng(1)
    values = np.round(rng.normal(size=1003), 1)
    values[rng.random(1003) < 0.5] = np.nan
    values[200:300] = np.nan
    edges = np.linspace(0, 1003, 41).astype(int)
    parts = [(start, values[start:end]) for start, end in pairwise(edges)]
    expected = {0, 1002} | {start for start, part in parts if np.isnan(part).all()}
    for pick in (np.nanargmin, np.nanargmax):
        expected |= {start + int(pick(part)) for start, part in parts if not np.isnan(part).all()}
    assert extremes(values, 80).tolist() == sorted(expected)


def test_a_packed_curve_comes_back_within_a_dot():
    values = np.array([1.0, np.nan, 3.0, 2.0])
    back = unpacked(_packed(np.arange(4.0), values, 1500))
    np.testing.assert_allclose(back, values, atol=2.0 / 65534)


def test_a_curve_breaks_without_a_subscriber_and_begins_with_one():
    times_s = np.concatenate([[0.0], 90.0 + 0.01 * np.arange(100), 95.0 + 0.01 * np.arange(100)])
    shown_s, shown = _measured(times_s, times_s.copy())
    assert shown_s[0] == 90.0
    assert np.flatnonzero(np.isnan(shown)).tolist() == [100]


def test_what_does_not_fit_is_left_to_the_recording(tmp_path):
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


def test_the_signals_of_outliers_and_failures_come_before_others(tmp_path):
    delays_s = [0.30, 0.31, 0.32, 0.90, 0.33, 0.34, 0.35, 0.29]
    given = [Given(delay_s=delay_s) for delay_s in delays_s]
    run = write_transient(tmp_path, [*given, Given(outcome="false_contact")])
    first = [trial for _, trial in outliers_first([run])]
    assert {4, 5, 8, 9} < set(first[:6]), "the longest delay, the middle one, the shortest, what failed"
    assert sorted(first) == list(range(1, 10))
