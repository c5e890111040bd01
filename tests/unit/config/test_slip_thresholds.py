"""The thresholds that mock/slip carries, and where they are from."""

import json
import tomllib
from pathlib import Path

import numpy as np
import pytest

from benchmarks.results import FOLDER
from benchmarks.slip_thresholds import CARRIED, PAPER_THRESHOLDS, figures

PROFILE = Path(__file__).resolve().parents[3] / "config" / "profiles" / "mock" / "slip.toml"


def carried():
    detectors = tomllib.loads(PROFILE.read_text(encoding="utf-8"))["detectors"]
    return {name: each for name, each in detectors.items() if each["kind"].startswith("slip")}


def test_every_slip_threshold_of_the_profile_is_printed_by_the_paper_or_found_here():
    names = {"fingertip_paper": "fingertip", "flexible_paper": "flexible_finger"}
    printed = {name: PAPER_THRESHOLDS[sensor] for name, sensor in names.items()}
    assert set(carried()) == set(CARRIED) | set(printed)
    assert {name: carried()[name]["threshold"] for name in printed} == printed
    assert all(carried()[name]["kind"] == kind for name, (_, _, kind) in CARRIED.items())


@pytest.mark.parametrize("name", CARRIED)
def test_a_threshold_of_the_profile_is_within_the_interval_that_was_found(name):
    study = json.loads((FOLDER / "slip_thresholds.json").read_text(encoding="utf-8"))
    keys = ("sensor", "bumps_hz", "detector")
    (row,) = [row for row in study["thresholds"] if tuple(row[key] for key in keys) == CARRIED[name]]
    assert not row["extrapolated"]
    assert row["threshold_low"] <= carried()[name]["threshold"] <= row["threshold_high"]


def test_a_threshold_leaves_one_alarm_an_hour():
    # six hours in which every hour one second reaches 10, 11, ... 15
    settled = np.ones(6 * 3600)
    settled[::3600] = 10.0 + np.arange(6)
    (row,) = figures("barrett_finger", 1.0, [{"slip": settled}])
    # just above the sixth largest, which leaves five of the six
    assert row["threshold"] == 10.0
    assert row["carried_by"] == ["barrett_ours"]
