"""Delays and false alarms of a statistic whose law is known."""

import math

import numpy as np
import pytest

from benchmarks.curves import Heard, around, curve
from benchmarks.onset import AMPLITUDES, SIMULATED, akaike, beyond, ours, simulated

RATE_HZ = 10.0


def exponential(seed, seconds=20_000):
    """A statistic that is exponential, ten times a second, and 100 events of known delay in it."""
    rng = np.random.default_rng(seed)
    events = []
    for delay_s in np.repeat([0.1, 0.2, 0.3, 0.9], 25):
        s = np.zeros(100)
        s[50 + round(RATE_HZ * delay_s) :] = 1e3
        events.append(around(s, RATE_HZ, 50))
    return Heard(rng.exponential(size=round(seconds * RATE_HZ)), RATE_HZ, events)


def test_alarms_are_as_many_as_asked_and_delays_are_those_put_in():
    rows = {row["an_hour"]: row for row in curve({"a": [exponential(1)], "b": [exponential(2)]})}
    assert not rows[100.0]["extrapolated"]
    assert rows[100.0]["alarms_an_hour"][0] == pytest.approx(100.0, rel=0.25)
    # seconds of ten values alarm once in 36 s where exp(-x) is 1/360, once an hour at 1/36,000
    for an_hour, row in rows.items():
        assert row["threshold"] == pytest.approx(math.log(36_000.0 / an_hour), abs=1.0)
        assert (row["events"], row["told"], row["early"]) == (200, 200, 0)
        assert row["median_s"][0] == pytest.approx(0.2)
        assert row["p90_s"][0] == pytest.approx(0.9)


def test_what_is_above_before_the_event_is_missed_and_counts_last():
    early = np.full(100, 1e3)
    groups = {name: [exponential(seed), Heard(np.empty(0), RATE_HZ, [around(early, RATE_HZ, 50.5)] * 300)]
              for seed, name in enumerate("ab")}  # fmt: skip
    row = next(curve(groups))
    assert (row["events"], row["told"], row["early"]) == (800, 200, 600)
    assert row["median_s"][0] == math.inf


@pytest.mark.parametrize("kind", SIMULATED)
def test_pickers_find_a_strong_knock_where_it_was_put(kind):
    (knock,) = simulated(kind, AMPLITUDES[-1], 1)
    rise_s = SIMULATED[kind][2]
    began_s, sigma_s = ours(knock)
    for picked_s in (began_s, beyond(knock, 5.0), akaike(knock)):
        assert picked_s == pytest.approx(knock.truth_s, abs=rise_s + 3.0 / knock.rate_hz)
    assert 0.0 < sigma_s < rise_s + 3.0 / knock.rate_hz
