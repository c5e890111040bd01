"""Envelope and carrier of the aura tell the same, through the program's own chain."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from benchmarks.aura.scenes import EDGE_S, Passage, begun, chained, demodulated
from drivers.mock.physics.aura import LEFT, RIGHT

QUIET = {"noise_fs_rthz": 0.0, "motion_fs": 0.0}


@pytest.mark.parametrize(
    ("speed_m_s", "most_db"),
    [(0.01, -104.0), (0.03, -90.0), (0.3, -49.0)],
    ids=["slow", "fast", "far beyond"],
)
def test_the_levels_differ_by_no_more_than_prototypes_did(speed_m_s: float, most_db: float) -> None:
    passage = Passage(0.5, speed_m_s, 0.053)
    bench = begun(passage, **QUIET)
    bench.advance(passage.end_s + 0.1)
    last = int((passage.end_s - EDGE_S) * 1000.0)
    first = max(round((0.5 + EDGE_S) * 1000.0), last - 500)
    instants_s = np.arange(first, last) / 1000.0
    ideal = bench.baseband(instants_s)[:, RIGHT]
    times_s, found = chained(bench, first, last - first, RIGHT)
    error = found - CubicSpline(instants_s, ideal)(times_s)
    assert 20.0 * np.log10(np.abs(error).max() / np.std(ideal)) < most_db


def test_the_long_filter_and_the_chain_agree_on_both_fingers_at_rest() -> None:
    bench = begun(Passage(1e6, 0.01, 0.01), drift_fs=0.0, **QUIET)
    bench.advance(1.0)
    long = demodulated(bench, 500, 10)
    for finger in (RIGHT, LEFT):
        _, found = chained(bench, 500, 20, finger)
        assert np.abs(found - long[:1, finger]).max() < 1e-7
