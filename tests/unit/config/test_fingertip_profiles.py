"""The profiles of B6 and B7 on all three benches."""

import pytest

from config.profile import load_profile
from controller.reports.papers import table


def loaded(name):
    return load_profile(name, {})


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_weights_go_to_the_papers_largest_load_through_the_middle(bench):
    behavior = loaded(f"{bench}/weights").behavior
    for paper in table("fernandez_bridges"):
        weights_n = behavior.weights_n(paper["bridge"])
        assert weights_n[-1] == paper["top_n"]
        assert paper["top_n"] / 2.0 in weights_n


def test_the_calibration_needs_neither_arm_nor_hand():
    assert set(loaded("mock/weights").devices) == {"board", "operator"}
    assert loaded("hardware/weights").devices["operator"].port == "console"


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_pointer_covers_the_range_of_figure_11_in_both_directions(bench):
    behavior = loaded(f"{bench}/pointer").behavior
    assert (behavior.angles_rad[0], behavior.angles_rad[-1]) == (-1.5, 1.5)
    turns = behavior.turns_rad
    assert list(turns) == list(reversed(turns))
    assert set(loaded(f"{bench}/pointer").devices) == {"arm", "board"}


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_pointers_fingertip_is_watched_in_every_motion(bench):
    profile = loaded(f"{bench}/pointer")
    assert profile.limits.range_streams == ("signals.tip",)
    ends_rad = profile.behavior.angles_rad[0], profile.behavior.angles_rad[-1]
    assert profile.limits.reach_rad >= ends_rad[1] - ends_rad[0]


def test_the_pointer_touches_with_several_forces_below_the_sensors_limit():
    forces = [trial.factors["detectors.touch.threshold"] for trial in loaded("mock/pointer").trials(0)]
    assert len(set(forces)) >= 3
    assert max(forces) < 10.0
