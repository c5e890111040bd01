"""What the slip study counts: false alarms in the first seconds after a reset, and slips of tips that had moved."""

import numpy as np
import pytest

from benchmarks.slip import scenes
from benchmarks.slip.scoring import first_maxima, fresh

RATE_HZ = 100.0


class Excited:
    """Says 10 in the third second after each reset, and once it has run for 300 s; else nothing."""

    inputs = ("board.tangential",)

    def statistic(self, values, rate_hz):
        second = np.arange(len(values)) // round(rate_hz)
        return np.where((second == 2) | (second == 300), 10.0, 1.0)


class Level:
    """Shows the value itself."""

    inputs = ("board.tangential",)

    def statistic(self, values, rate_hz):
        return values[:, 0]


def test_alarms_after_a_reset_are_counted_in_their_second():
    found = fresh(first_maxima(Excited(), np.zeros((60_000, 1)), RATE_HZ), 5.0, 3600.0)
    # 119 pieces of five seconds fit between 2.5 s and the end
    assert found.resets == 119
    assert found.alarms == (0, 119, 0, 0)
    # they ask for another threshold than a detector that has settled
    assert found.calibration.threshold > 5.0


def test_each_piece_is_heard_by_a_detector_that_knows_nothing_of_the_last():
    values = np.arange(1500, dtype=float)[:, None]
    found = first_maxima(Level(), values, RATE_HZ)
    # begun at 2.5 and 7.5 s; the first second of each is left out
    assert found.tolist() == [[449, 549, 649, 749], [949, 1049, 1149, 1249]]


@pytest.mark.parametrize("sensor", ["fingertip", "flexible_finger", "barrett_finger"])
def test_tips_that_a_load_step_moved_slip_as_well(sensor):
    trials = list(scenes.slips(scenes.sensor(sensor, "loads"), 20, 5))
    assert all(trial.onset is not None and trial.onset >= trial.start for trial in trials)
    assert 0 < sum(trial.moved_before for trial in trials) < 20
