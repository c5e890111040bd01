"""The shipped profiles of the fingertip (weights, pointer) and of the sonic fingers."""

import pytest

from config.source import ProfileError
from controller.reports.papers import table
from tests.refusals import refused
from tests.unit.config.conftest import loaded


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_weights_go_to_the_papers_largest_load_through_the_middle(bench):
    behavior = loaded(f"{bench}/weights").behavior
    for paper in table("fernandez_bridges"):
        weights_n = behavior.weights_n(paper["bridge"])
        assert weights_n[-1] == paper["top_n"]
        assert paper["top_n"] / 2.0 in weights_n


@pytest.mark.parametrize("bench", ["mock", "emulated", "hardware"])
def test_the_pointer_covers_the_range_of_figure_11_in_both_directions_and_its_fingertip_is_watched(bench):
    profile = loaded(f"{bench}/pointer")
    turns = list(profile.behavior.turns_rad)
    assert (profile.behavior.angles_rad[0], profile.behavior.angles_rad[-1]) == (-1.5, 1.5)
    assert turns == turns[::-1]
    assert set(profile.devices) == {"arm", "board"}
    assert profile.limits.range_streams == ("signals.tip",)
    assert profile.limits.reach_rad >= 1.5 - -1.5


def test_the_pointer_touches_with_several_forces_below_the_sensors_limit():
    forces = [trial.factors["detectors.touch.threshold"] for trial in loaded("mock/pointer").trials(0)]
    assert len(set(forces)) >= 3
    assert max(forces) < 10.0


@pytest.mark.parametrize("listener", ["signals.left", "detectors.right_ours"])
def test_a_listener_for_another_frequency_than_the_drives_is_refused(listener):
    with pytest.raises(ProfileError) as refusal:
        loaded("mock/centering", {f"{listener}.drive_hz": "41000.0"})
    assert f"[{listener}] drive_hz = 41000.0: [behavior] has drive_hz = 40000.0" in str(refusal.value)


def test_a_drive_that_the_chain_cannot_do_is_refused_with_the_profile():
    with refused(ProfileError, '[signals.left] output_hz = 100: variant = "cic" needs 375'):
        loaded("mock/centering", {"signals.left.variant": "cic", "signals.left.output_hz": "100.0"})


def test_who_tracks_the_clocks_needs_a_rest_in_which_detectors_can_learn():
    tracked = {"signals.left.clocks": "tracked"}
    with pytest.raises(ProfileError) as refusal:
        loaded("mock/centering", tracked)
    (line,) = str(refusal.value).splitlines()
    assert line.endswith(
        "[behavior] baseline_s = 1.0: [signals.left] tracks for 1.01 s before it gives anything, and"
        " [detectors.left_contact] learns for 0.3 s; make it 1.31 or longer"
    )
    assert loaded("mock/centering", tracked | {"behavior.baseline_s": "1.31"}).behavior.baseline_s == 1.31


def test_a_bench_that_is_driven_at_another_frequency_throughout_is_taken():
    wanted = {"behavior.drive_hz": "41000.0"}
    listeners = [f"detectors.{side}_{what}" for side in ("left", "right") for what in ("ours", "contact")]
    listeners += ["signals.left", "signals.right"]
    profile = loaded("mock/centering", wanted | {f"{listener}.drive_hz": "41000.0" for listener in listeners})
    assert profile.behavior.drive_hz == 41_000.0


@pytest.mark.parametrize("experiment", ["pretouch", "touch"])
def test_a_real_bench_is_run_a_side_at_a_time_as_the_gripper_is_not_turned_between_trials(experiment):
    sides = {trial.factors["side"] for trial in loaded(f"hardware/{experiment}").trials(0)}
    assert sides == {"normal"}
    assert len({trial.factors["side"] for trial in loaded(f"mock/{experiment}").trials(0)}) == 5
