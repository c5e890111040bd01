"""Whether a grasp held its object: by what share of its weight was carried."""

import numpy as np
import pytest

from behaviors.grasp import GraspSettings
from controller.measures.grasp import measure
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock, Standstill
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
