"""What the slip study counts: false alarms, slips, and the first seconds after a reset."""

import numpy as np
import pytest

from benchmarks.slip import scenes
from benchmarks.slip.scoring import Quiet, first_maxima, score

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
    heard = Quiet.empty()
    for number in range(4):
        heard.hear(Excited(), np.zeros((60_000, 1)), RATE_HZ, number)
    fresh = heard.fresh(5.0, 3600.0)
    # 119 pieces of five seconds fit between 2.5 s and the end; every other recording checks
    assert fresh.resets == 2 * 119
    assert fresh.alarms == (0, 2 * 119, 0, 0)
    # they ask for another threshold than a detector that has settled
    assert fresh.calibration.threshold > 5.0


def test_a_settled_detector_is_not_charged_with_its_first_seconds():
    heard = Quiet.empty()
    for number in range(4):
        heard.hear(Excited(), np.zeros((60_000, 1)), RATE_HZ, number)
    alarms, hours = heard.check(5.0)
    assert alarms == 2
    assert hours == pytest.approx(2 * 595.0 / 3600.0)


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


def test_all_slips_are_scored_whatever_moved_the_tip_before():
    values = np.zeros((400, 1))
    values[310] = 10.0
    trials = [
        scenes.Slip(values, start=280, onset=300, moved_before=False),
        scenes.Slip(values, start=280, onset=305, moved_before=True),
        scenes.Slip(np.zeros((400, 1)), start=280, onset=300, moved_before=True),
        scenes.Slip(values, start=300, onset=320, moved_before=True),
        scenes.Slip(values, start=280, onset=None, moved_before=True),
    ]
    found = score(Level(), trials, RATE_HZ, 5.0, 0.75)
    assert found.delays_s.tolist() == [pytest.approx(0.1), pytest.approx(0.05), np.inf]
    assert found.moved_before.tolist() == [False, True, True]
    assert (found.early, found.missed_moved_before) == (1, 1)
