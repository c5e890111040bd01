"""Hints for names that do not exist."""

import pytest

from config.hints import did_you_mean, near_or_all, unknown_key
from controller.scales import si_unit


@pytest.mark.parametrize(
    ("key", "value", "known", "hint"),
    [
        ("speed_mm_s", 4.843, ["speed_m_s", "location"], "SI is meant: speed_m_s = 0.004843"),
        ("settle_min", 1.5, ["settle_s"], "SI is meant: settle_s = 90"),
        ("sample_khz", 1, ["sample_hz"], "SI is meant: sample_hz = 1000"),
        ("force_lbf", 5, ["force_n"], "SI is meant: force_n = 22.2411"),
        ("tilt_deg", 180, ["tilt_rad"], "SI is meant: tilt_rad = 3.14159"),
        ("force_g", 100, ["force_n"], "SI is meant: force_n"),
        ("force_mm", 2, ["force_n"], "SI is meant: force_n"),
        ("speed_mm_s", "fast", ["speed_m_s"], "SI is meant: speed_m_s"),
        ("speed_mm_s", True, ["speed_m_s"], "SI is meant: speed_m_s"),
        ("speed", 4, ["speed_m_s"], "did you mean 'speed_m_s'?"),
        ("averge_samples", 4, ["average_samples", "input"], "did you mean 'average_samples'?"),
        ("colour", 4, ["input", "gamma"], "known: gamma, input"),
        ("colour", 4, [], "known: none"),
    ],
)
def test_an_unknown_key_is_answered_with_what_was_probably_meant(key, value, known, hint):
    assert unknown_key(key, value, known) == hint


def test_nothing_near_gives_no_hint():
    assert did_you_mean("zzz", ["alpha", "beta"]) == ""


def test_many_names_are_not_listed_in_full():
    assert near_or_all("zzz", [f"name{i:02}" for i in range(40)]).endswith("name11, …")


@pytest.mark.parametrize(
    ("key", "unit"),
    [
        ("speed_m_s", "m/s"),
        ("a_m_s2", "m/s²"),
        ("force_n", "N"),
        ("sample_hz", "Hz"),
        ("start_m", "m"),
        ("location", ""),
    ],
)
def test_the_unit_at_the_end_of_a_name_is_known(key, unit):
    assert si_unit(key) == unit
