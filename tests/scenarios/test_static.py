"""A1 on the mock bench: the paper's three static facts, from the profile that ships."""

import pytest

PAPER = {"none": (28.0, 1.0), "light": (30.0, 2.0), "full": (50.0, 3.0)}
"""Dominant frequency and how far from it the bench may be, Hz (Backus and Dollar, IV.A)."""


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    from config.script import run_trials

    _, run = run_trials(
        "mock/static",
        [{"condition": condition} for condition in PAPER],
        settings={"behavior.settle_s": "3.0"},
        out=tmp_path_factory.mktemp("runs"),
        say=lambda line: None,
    )
    return {row["condition"]: row for row in run.trials}


@pytest.mark.parametrize("condition", PAPER)
def test_the_dominant_frequency_is_the_papers(rows, condition):
    frequency_hz, tolerance_hz = PAPER[condition]
    assert rows[condition]["frequency_hz"] == pytest.approx(frequency_hz, abs=tolerance_hz)


def test_light_contact_is_erratic_and_the_others_are_not(rows):
    """Periods bounce between 28.5 and 36 Hz or more: a spread of hertz, against tenths at rest and in full contact."""
    assert rows["light"]["frequency_sd_hz"] > 1.0
    assert rows["none"]["frequency_sd_hz"] < 0.3
    assert rows["full"]["frequency_sd_hz"] < 0.6


def test_the_amplitude_falls_from_none_to_light_to_full_contact(rows):
    amplitudes = [rows[condition]["amplitude_m"] for condition in ("none", "light", "full")]
    assert amplitudes == sorted(amplitudes, reverse=True)
    assert amplitudes[2] < 0.2 * amplitudes[0]


def test_force_grows_from_none_to_light_to_full_contact(rows):
    forces_n = [rows[condition]["force_n"] for condition in ("none", "light", "full")]
    assert abs(forces_n[0]) < 0.001
    assert 0.01 < forces_n[1] < 0.2, "of the order of 0.1 N"
    assert forces_n[2] > forces_n[1]
