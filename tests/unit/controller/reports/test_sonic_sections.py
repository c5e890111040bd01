"""Sections on C1 to C5: what they make of rows that leave factors to their defaults."""

from behaviors.centering import CenteringFactors
from controller.reports.centering import _groups


def test_a_trial_that_does_not_vary_a_factor_has_the_behaviors_default():
    """In a list of trials some rows name the method, others do not: their cells are empty."""
    rows = [{"method": "paper", "speed_m_s": 0.03, "object": "mug"}, {"method": None, "speed_m_s": None}]
    default = CenteringFactors()
    assert set(_groups(rows)) == {
        ("mug", "paper", 0.03),
        (default.object, default.method, default.speed_m_s),
    }
