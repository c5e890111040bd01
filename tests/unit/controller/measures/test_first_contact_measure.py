"""A first touch whose load cell reads the push with the wrong sign is no success, and says which."""

import numpy as np
import pytest

from behaviors.events import Contact
from behaviors.first_contact import FirstContactSettings
from controller.measures.first_contact import measure
from controller.measures.trial import TrialEvidence
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock


@pytest.mark.parametrize(("sign", "outcome"), [(1.0, "contact"), (-1.0, "wrong_sign")])
def test_pressing_reads_positive(sign, outcome):
    force_n = np.zeros((4000, 1))
    force_n[2500:3000] = sign * 0.2
    recording = TrialRecording(1)
    for stream, unit, values in [
        ("board.load_cell", "N", force_n),
        ("stage.position", "m", np.zeros((4000, 1))),
    ]:
        recording.add(SampleBlock(stream, 0, 0.0, values, rate_hz=1000.0, unit=unit))
    entered_s = {"BASELINE": 0.0, "APPROACH": 2.0, "STOPPING": 2.6}
    evidence = TrialEvidence(
        factors={},
        recording=recording,
        events=[Contact(2.51, "contact", 0.2, 0.02)],
        entered_s=entered_s,
        visits=list(entered_s.items()),
        truth=None,
        detectors={},
    )
    found, row = measure(evidence, FirstContactSettings(), "contact")
    assert found == outcome
    assert row["force_peak_n"] == pytest.approx(0.2)
