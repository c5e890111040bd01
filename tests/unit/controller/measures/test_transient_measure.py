"""A2's and A3's measure on made-up evidence."""

import numpy as np
import pytest

from behaviors.events import Contact
from behaviors.flexion import FlexionSettings
from behaviors.transient import TransientSettings
from controller.measures import flexion
from controller.measures.transient import measure
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock

STREAMS = (("board.load_cell", "N"), ("board.period", "s"), ("stage.position", "m"), ("board.tendon", "m"))


class Silent:
    inputs = ()


def evidence(t_s, truth=None):
    """One contact event; baseline to 2 s, approach and hold to 3 s, no force: every stream hardly changes."""
    values = np.linspace(0.030, 0.031, 4000)[:, None]
    recording = TrialRecording(1)
    for stream, unit in STREAMS:
        recording.add(SampleBlock(stream, 0, 0.0, values, rate_hz=1000.0, unit=unit))
    entered_s = {"BASELINE": 0.0, "FLEXING": 1.0, "APPROACH": 2.0, "STOPPING": 2.9, "RETRACTING": 3.0}
    return TrialEvidence(
        factors={},
        recording=recording,
        events=[Contact(t_s, "contact", 29.0, 28.5)],
        entered_s=entered_s,
        visits=list(entered_s.items()),
        truth=truth,
        detectors={"contact": Silent()},
    )


def test_an_event_from_just_before_the_approach_that_stops_it_is_a_false_contact():
    outcome, row = measure(evidence(1.99), TransientSettings(), "contact")
    assert (outcome, row["false_contacts"], row["detect_s"]) == ("false_contact", 1, 1.99)


BY_TIME = pytest.mark.parametrize(("t_s", "false"), [(2.7, 0), (2.5, 0), (2.4991, 0), (2.4989, 1), (2.45, 1)])
TOUCH = [(2.5, True), (3.1, False)]


@BY_TIME
def test_a_contact_more_than_a_step_before_the_touch_is_false(t_s, false):
    outcome, row = measure(evidence(t_s, TOUCH), TransientSettings(), "contact")
    assert (outcome, row["false_contacts"]) == ("false_contact" if false else "contact", false)


@BY_TIME
def test_flexion_counts_a_contact_more_than_a_step_before_the_touch_as_false(t_s, false):
    _, row = flexion.measure(evidence(t_s, TOUCH), FlexionSettings(), "contact")
    assert (row["contact_false"], row["contact_blind"]) == (false, false)
    assert row["contact_event_s"] == (None if false else pytest.approx(max(0.0, t_s - 2.5)))


@pytest.mark.parametrize(("noise_n", "told"), [(0.0002, True), (0.003, False)])
def test_a_real_load_cell_whose_noise_reaches_the_onset_shows_none(noise_n, told):
    found = evidence(2.7)
    force_n = np.random.default_rng(1).normal(0.0, noise_n, 4000)
    force_n[2500:] += 0.2
    found.recording = TrialRecording(1)
    for stream, unit in STREAMS:
        values = force_n if stream == "board.load_cell" else np.linspace(0.030, 0.031, 4000)
        found.recording.add(SampleBlock(stream, 0, 0.0, values[:, None], rate_hz=1000.0, unit=unit))
    outcome, row = measure(found, TransientSettings(), "contact")
    assert outcome == "contact"
    assert row["delay_s"] == (pytest.approx(0.2, abs=0.002) if told else None)
    assert row["false_contacts"] == (0 if told else None)


@pytest.mark.parametrize(
    ("push_n", "judged"), [(0.2, ("contact", 0)), (-0.2, ("wrong_sign", None)), (0.0, ("false_contact", 1))]
)
def test_a_real_load_cell_that_reads_a_push_as_negative_has_the_wrong_sign(push_n, judged):
    found = evidence(2.7)
    force_n = np.random.default_rng(1).normal(0.0, 2e-4, 4000)
    force_n[2500:] += push_n
    found.recording = TrialRecording(1)
    for stream, unit in STREAMS:
        values = force_n if stream == "board.load_cell" else np.linspace(0.030, 0.031, 4000)
        found.recording.add(SampleBlock(stream, 0, 0.0, values[:, None], rate_hz=1000.0, unit=unit))
    outcome, row = measure(found, TransientSettings(), "contact")
    assert (outcome, row["false_contacts"]) == judged
