"""What every detector refuses of its input, and when a comparator changes its state."""

import numpy as np
import pytest

from controller.detectors.protocol import Hysteresis
from controller.registry import KINDS, find
from drivers.core.messages import SampleBlock
from tests.refusals import refused


@pytest.mark.parametrize("kind", sorted(KINDS["detector"].keys() - {"resonance.paper"}))
def test_samples_at_irregular_times_are_refused(kind):
    made, settings, _ = find("detector", kind)
    detector = made("name", settings())
    times_s = np.array([0.0, 0.1, 0.3])
    irregular = SampleBlock(detector.inputs[0], 0, 0.0, np.zeros((3, 2)), times_s=times_s, unit="m")
    with pytest.raises(ValueError, match=rf"^{detector.inputs[0]}: samples at irregular times.*; .*give it"):
        detector.push(irregular)


@pytest.mark.parametrize(
    ("kind", "chosen"),
    [("slip", {"channel": 3}), ("slip.paper", {"channel": 3}), ("force.threshold", {"channels": [3]})],
)
def test_a_channel_that_is_not_there_is_refused_in_one_line(kind, chosen):
    made, settings, _ = find("detector", kind)
    detector = made("name", settings(**chosen))
    block = SampleBlock(detector.inputs[0], 0, 0.0, np.zeros((10, 1)), rate_hz=1000.0)
    with refused(ValueError, f"{detector.inputs[0]}: no channel 3 while ", ": it has 1; count from 0"):
        detector.push(block)


@pytest.mark.parametrize(
    ("on", "release_ratio", "expected"),
    [
        (False, 1.0, [(1, True), (3, False), (5, True), (6, False)]),
        (False, 0.5, [(1, True), (6, False)]),
        (True, 1.0, [(0, False), (1, True), (3, False), (5, True), (6, False)]),
        (True, 0.5, [(6, False)]),
    ],
)
def test_a_comparator_is_on_above_its_threshold_and_off_at_the_release(on, release_ratio, expected):
    statistic = np.array([1.0, 1.5, np.nan, 0.9, 1.0, 1.1, 0.5])
    comparator, unknowing = Hysteresis(), Hysteresis()
    comparator.on = unknowing.on = on
    assert list(comparator.changes(statistic, 1.0, release_ratio)) == expected
    assert not list(unknowing.changes(np.full(3, np.nan), 1.0, release_ratio))
