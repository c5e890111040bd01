"""Whether a grasp held its object, by what share of its weight was carried; how far its middle was off."""

import numpy as np
import pytest

from behaviors.grasp import GraspSettings
from behaviors.search import SearchSettings
from controller.measures import centering
from controller.measures.grasp import measure
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import Reached, SampleBlock, Standstill
from simulator.physics.aura_scene import Lift

VISITS = [("RESTING", 0.0), ("CLOSING", 1.0), ("LOADING", 2.0), ("HOLDING", 3.0), ("LOWERING", 4.0)]


def judged(share, *, simulated):
    """The outcome of a grasp in which the tool went up by 20 mm, and this share of 2 N was carried."""
    times_s = np.arange(500) / 100.0
    lifted, recording = times_s >= 3.0, TrialRecording(1)
    upward = (("arm.pose", "m", 0.02 * lifted), ("arm.force", "N", -2.0 * share * lifted))
    for stream, unit, upwards in upward:
        values = np.zeros((500, 6))
        values[:, 2] = upwards
        recording.add(SampleBlock(stream, 0, 0.0, values, rate_hz=100.0, unit=unit))
    evidence = TrialEvidence({}, recording, [Standstill(4.9, "arm", 0.0)], dict(VISITS), VISITS)
    if simulated:
        evidence.lifts = [Lift(3.5, 0.02, share, 5.0, 4.0, 2.0, 0.0, 0.0, 0.0, False)]
    return measure(evidence, GraspSettings(weight_n=2.0), "held")[0]


@pytest.mark.parametrize("simulated, failed", [(True, "dropped"), (False, "not_lifted")])
def test_an_object_is_held_where_nine_tenths_of_its_weight_are_carried(simulated, failed):
    assert judged(0.91, simulated=simulated) == "held"
    assert judged(0.89, simulated=simulated) == failed


@pytest.mark.parametrize(
    ("factors", "truth", "error_m"), [({}, None, None), ({"object_x_m": 0.001}, None, 0.002), ({}, [], 0.003)]
)
def test_a_middle_has_an_error_only_where_somebody_knows_where_the_object_is(factors, truth, error_m):
    visits = [("SEEKING_FORWARD", 1.0), ("CENTERING", 2.0), ("LEAVING", 3.0)]
    events = [Reached(2.5, "arm", 0.003)]
    evidence = TrialEvidence(factors, TrialRecording(1), events, dict(visits), visits, truth=truth)
    outcome, row = centering.measure(evidence, SearchSettings(), "centered")
    assert outcome == "centered"
    assert (row["middle_m"], row["error_m"]) == (
        0.003,
        error_m if error_m is None else pytest.approx(error_m),
    )
