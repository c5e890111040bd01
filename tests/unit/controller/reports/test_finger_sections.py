"""Sections on the finger's further experiments: what they conclude is what the rows say."""

import pytest

from controller.measures import columns_of
from controller.reports import flexion, locating
from controller.reports.figures import Figures
from controller.reports.report import build_report
from controller.reports.stiffness import arm_of, model_hz
from tests.unit.controller.reports.synthetic_runs import begun, text_of, write_rows

pytestmark = pytest.mark.usefixtures("undrawn")


def write(root, experiment, rows, **plant):
    resolved = {"behavior": {"flexed_m": 0.01}, "plant": plant}
    return write_rows(begun(root, experiment, "mock", resolved), rows, columns_of(experiment))


@pytest.mark.parametrize(
    ("fixed", "following", "said"),
    [
        (
            1,
            0,
            (
                "(88.6 to 100.0): as the paper says, of no use.",
                "(0.0 to 11.4): as the paper expects, of use.",
            ),
        ),
        (
            *(0, 1),
            ("(0.0 to 11.4); the paper says that it is of no use.", "; the paper expects that it is of use."),
        ),
    ],
)
def test_a_threshold_is_said_to_be_of_use_by_the_touches_that_it_was_blind_to(
    tmp_path, fixed, following, said
):
    """None of 30: at most z² / (30 + z²) = 11.4 %."""
    measured = {"flexed_s": 10.0, "free_rise_hz": 3.0, "contact_blind": fixed, "following_blind": following}
    run = write(tmp_path, "flexion", [({"tendon_m_s": 0.01}, "contact", measured)] * 30)
    found = flexion.section([run], Figures(tmp_path)).summary
    assert [result.text.endswith(end) for result, end in zip(found[1:], said, strict=True)] == [True, True]


def recorded(location, pad_n_m=None, *, phase=1.0, lost=False, ring_off_hz=0.0):
    """A trial whose phase and frequencies are those of its contact, by the paper's model."""
    hz = model_hz(pad_n_m or 4220.0, arm_of(location))
    measured = {"phase_rad": 0.5 - 1e-5 * phase * hz**2, "frequency_hz": hz, "ring_hz": hz + ring_off_hz}
    factors = {"location": location, "condition": "full", "plant.pad_n_m": pad_n_m}
    return factors, "recorded", measured | {"frequency_sd_hz": 5.0 if lost else 0.3}


def test_what_a_second_accelerometer_brings_is_said_by_its_numbers(tmp_path):
    usual = [recorded(place) for place in "defgh" for _ in range(2)]
    worse = [recorded("g", 2110.0), recorded("g", 8440.0)]
    text = text_of(build_report([write(tmp_path, "locating", [*usual, *worse], pad_n_m=4220.0)]))
    assert "A contact 0.5 or 2 times as stiff is misplaced by as much as" in text
    assert "the phase tells stiffness and location no better apart than the frequency does." in text
    assert "does not hold its lock" not in text, "it holds everywhere"
    better = [recorded("g", n_m) for n_m in (2110.0, 8440.0)]
    for factors, _, measured in better:
        measured["phase_rad"] = recorded("g")[2]["phase_rad"]
        factors["location"] = "g"
    text = text_of(build_report([write(tmp_path, "locating", [*usual, *better])]))
    assert "A contact of 2,110 or 8,440 N/m is misplaced by as much as 0.0 mm (phase)" in text
    assert "no better apart" not in text


def test_both_numbers_that_locating_opens_with_are_of_the_same_trials(tmp_path):
    """At d the loop does not hold: what the ringing says there stands beside no phase."""
    rows = [recorded(place) for place in "efgh" for _ in range(2)]
    rows += [recorded("d", lost=True, ring_off_hz=20.0)]
    run = write(tmp_path, "locating", rows)
    section = locating.section([run], Figures(tmp_path))
    assert section.content["lost"] == ["d"]
    found, (result, *_) = section.headline, section.summary
    assert f"{found.paper} from the frequency, ringing (worst of {found.of.split()[-1]})" in result.text
    assert "At d the loop does not hold its lock" in text_of(build_report([run]))
