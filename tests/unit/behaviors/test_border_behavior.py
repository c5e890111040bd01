"""Slip and border together turn the tip back; either alone does not."""

import pytest
from pydantic import ValidationError

from behaviors.border import BorderFactors, BorderTrialSettings, KeepOnTip
from behaviors.events import BaselineRefused, BorderLeft, BorderNear, Contact, SlipEnded, SlipStarted, Tick
from drivers.core.messages import Reached, Standstill, Twist
from tests.refusals import refused

SETTINGS = BorderTrialSettings.model_validate(
    {
        "sensors": {
            "fingertip": {
                "stream": "board.fingertip", "forces_stream": "signals.tip", "touch": "touch", "paper": None,
                "ours": "ours", "listen": "motion", "press_m": 0.001, "steps": [{"do": "hold", "duration_s": 1.0}],
            }
        }
    }
)  # fmt: skip


def near(t_s, angle_rad=0.8):
    return BorderNear(t_s, "border", abs(angle_rad), 0.8, angle_rad)


def slip(t_s, detector="ours"):
    return SlipStarted(t_s, detector, 20.0, 17.5)


def sliding(*before, **factors):
    """A trial while what is held slides; `before` comes in the roll."""
    made = BorderFactors(**{"begins_rad": 0.3, **factors})
    behavior = KeepOnTip(SETTINGS, made, frozenset({"touch", "ours", "border"}))
    behavior.begin(0.0)
    for event in (
        Reached(1.0, "arm", 0.0), Tick(1.3), Reached(2.0, "arm", 0.0), Tick(3.5), Contact(4.0, "touch", 0.4, 0.3),
        Standstill(4.1, "arm", 0.003), Reached(4.5, "arm", 0.004), *before, Reached(6.5, "arm", 0.004), Tick(6.65),
    ):  # fmt: skip
        behavior.handle(event)
    assert behavior.state == "SLIPPING"
    return behavior


@pytest.mark.parametrize(
    "events",
    [
        [slip(7.0)],
        [near(7.0)],
        [slip(7.0), SlipEnded(7.1, "ours", 1.0, 17.5), near(7.2)],
        [near(7.0), BorderLeft(7.1, "border", 0.4, 0.8), slip(7.2)],
        [slip(7.0, "paper"), near(7.2)],
        [near(7.0), slip(7.2, "paper")],
    ],
    ids=["slip", "border", "slip over", "border left", "another's slip", "another's later"],
)
def test_one_of_the_two_alone_turns_nothing_back(events):
    behavior = sliding()
    assert [behavior.handle(event) for event in events] == [[]] * len(events)
    assert behavior.state == "SLIPPING"


@pytest.mark.parametrize("events", [[slip(7.0), near(7.2, -0.9)], [near(7.0, -0.9), slip(7.2)]])
def test_slip_near_a_border_turns_the_tip_back_by_the_reported_angle_while_the_slide_goes_on(events):
    behavior = sliding(begins_rad=-0.3, turn_rad_s=-0.4)
    (turn,) = [command for event in events for command in behavior.handle(event)]
    assert turn == Twist("arm", (0.008 + 0.012 * 0.4, 0.0, 0.0, 0.0, 0.4, 0.0), pytest.approx(0.9 / 0.4))
    behavior.handle(Reached(10.0, "arm", 0.004))
    assert behavior.state == "STOPPED"


def test_slip_near_a_border_in_the_roll_is_answered_as_the_slide_begins_and_not_without_keep():
    behavior = sliding(near(6.0, 0.85), begins_rad=1.0)
    (turn,) = behavior.handle(slip(7.0))
    assert turn.twist[4] * turn.duration_s == pytest.approx(-0.85)
    behavior = sliding(keep=False)
    assert [behavior.handle(event) for event in (slip(7.0), near(7.2))] == [[], []]


def test_the_tip_is_levelled_by_what_it_turned_though_the_slide_was_cut():
    """-0.15 rad before, 0.45 rolled, 0.4 rad/s for 0.5 of 3 s, 0.8 back: -0.3 rad are left."""
    behavior = sliding(turn_rad_s=0.4)
    behavior.handle(slip(6.9))
    behavior.handle(near(6.65 + 0.5))
    behavior.handle(Reached(10.0, "arm", 0.004))
    behavior.handle(Tick(10.6))
    (level,) = behavior.handle(Reached(11.0, "arm", 0.0))
    assert level.twist[4] * level.duration_s == pytest.approx(0.3)


def test_a_trial_that_waits_for_a_detector_that_is_not_there_is_refused():
    with refused(ValueError, "keep = true waits for border", "write keep = false"):
        KeepOnTip(SETTINGS, BorderFactors(begins_rad=0.3), frozenset({"touch", "ours"}))
    with pytest.raises(ValidationError, match="nothing moves"):
        BorderFactors(begins_rad=0.3, slide_m_s=0.0)


@pytest.mark.parametrize("detector", ["ours", "border"])
def test_what_is_to_keep_the_contact_on_the_tip_must_be_there_and_have_learned(detector):
    with refused(ValueError, f"keep = true waits for {detector}", "keep = false"):
        KeepOnTip(
            SETTINGS, BorderFactors(begins_rad=0.3), frozenset({"touch", "ours", "border"} - {detector})
        )
    refusal = BaselineRefused(7.0, detector, 1.0, 2.0, "no variance")
    for keep, outcome in ((True, "fault"), (False, "contact")):
        behavior = sliding(keep=keep)
        behavior.handle(refusal)
        assert behavior.outcome == outcome
