"""A2's measure on made-up evidence."""

import numpy as np

from behaviors.events import Contact
from behaviors.transient import TransientSettings
from controller.measures.transient import measure
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.messages import SampleBlock


def test_an_event_from_just_before_the_approach_that_stops_it_is_a_false_contact():
    recording = TrialRecording(1)
    for stream, unit in (("board.load_cell", "N"), ("board.period", "s"), ("stage.position", "m")):
        recording.add(SampleBlock(stream, 0, 0.0, np.zeros((4000, 1)), rate_hz=1000.0, unit=unit))
    entered_s = {"BASELINE": 0.0, "APPROACH": 2.0, "STOPPING": 2.01, "RETRACTING": 3.0}
    evidence = TrialEvidence(
        factors={},
        recording=recording,
        events=[Contact(1.99, "contact", 29.0, 28.5)],
        entered_s=entered_s,
        visits=list(entered_s.items()),
    )
    outcome, row = measure(evidence, TransientSettings(), "contact")
    assert (outcome, row["false_contacts"], row["detect_s"]) == ("false_contact", 1, 1.99)
