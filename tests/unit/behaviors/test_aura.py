import pytest

from behaviors.aura import Aura, AuraFactors, AuraSettings
from behaviors.chirp import ChirpSettings, ChirpSweep
from behaviors.events import Resumed, Tick
from drivers.core.messages import Chirp, Excite, Home, MovePose, Reached, Release, Stop, Tone
from drivers.core.settings import Settings
from tests.unit.behaviors.driving import arm, held, jaws, lead, lost, seen, still, tell, touch

PATHS = {"x": {"start_m": (0.0, 0.0, 0.0), "end_m": (0.051, 0.0, 0.0)}}
DETECTORS = frozenset({"pretouch_ours", "contact_ours", "contact_paper"})


def aura(**settings):
    return Aura(AuraSettings(paths=PATHS, contact="contact_ours", **settings), AuraFactors(), DETECTORS)


PATH = {
    "CLEARING": [],
    "CALIBRATING": [arm(1.0)],
    "OPENING": [jaws(2.0)],
    "ENTERING": [jaws(3.0)],
    "BASELINE": [arm(4.0)],
    "APPROACHING": [Tick(6.0)],
    "HOLDING": [arm(11.1)],
    "RETRACTING": [Tick(13.2)],
    "LEAVING": [arm(18.3)],
}


def to(state, **settings):
    return lead(aura(**settings), PATH, state)


def go(x_m, z_m, speed_m_s):
    return MovePose("arm", (x_m, 0.0, z_m, 0.0, 0.0, 0.0), speed_m_s)


def test_it_goes_along_the_path_and_back():
    assert to("CLEARING")[1] == [go(0.0, 0.1, 0.05)]
    assert to("CALIBRATING")[1] == [Home("gripper")]
    assert to("OPENING")[1] == [Release("gripper", 0.02)]
    assert to("ENTERING")[1] == [Tone("audio", 40_000.0, 0.5), go(0.0, 0.0, 0.05)]
    assert to("APPROACHING")[1] == [go(0.051, 0.0, 0.01)]
    assert to("RETRACTING")[1] == [go(0.0, 0.0, 0.01)]
    behavior, commands = to("LEAVING")
    assert commands == [go(0.0, 0.1, 0.05)]
    assert behavior.handle(arm(20.0)) == [Excite("audio", False)]
    assert behavior.outcome == "approached"


def test_events_stop_nothing_in_an_approach_that_does_not_touch_and_the_acting_detectors_one_that_does():
    behavior, _ = to("APPROACHING")
    assert behavior.handle(seen(7.0, "pretouch_ours")) == []
    assert behavior.handle(touch(8.0, "contact_ours")) == []
    assert behavior.state == "APPROACHING"
    behavior, _ = to("APPROACHING", touch=True)
    assert behavior.handle(touch(8.0, "contact_paper")) == []
    assert behavior.handle(touch(8.1, "contact_ours")) == [Stop("arm")]
    behavior.handle(still(8.2, 0.02))
    assert behavior.state == "HOLDING"
    assert behavior.outcome == "contact"


def test_it_approaches_along_a_path_as_often_as_it_is_asked_to():
    behavior, _ = to("RETRACTING", cycles=2)
    behavior.handle(arm(18.3))
    assert behavior.state == "BASELINE"
    tell(behavior, Tick(21.0), arm(26.0), Tick(28.5), arm(33.0))
    assert behavior.state == "LEAVING"
    with pytest.raises(ValueError, match=r"axis = z: no such path in behavior\.paths; there are x"):
        Aura(AuraSettings(paths=PATHS), AuraFactors(axis="z"), DETECTORS)


def test_a_sweep_is_silence_chirp_silence():
    sweep = ChirpSweep(ChirpSettings(), Settings(), frozenset())
    assert sweep.begin(0.0) == [Excite("audio", False)]
    assert sweep.handle(Tick(0.2)) == [Chirp("audio", 20_000.0, 46_000.0, 4.0, 0.5)]
    assert sweep.handle(Reached(2.0, "arm", 0.0)) == [], "another device's answer"
    sweep.handle(Reached(4.2, "audio", 0.0))
    sweep.handle(Tick(4.4))
    assert (sweep.done, sweep.outcome) == (True, "swept")


def test_an_approach_that_a_pause_broke_off_is_made_again():
    behavior, _ = to("APPROACHING")
    behavior.handle(Resumed(9.0))
    assert behavior.state == "RETRACTING"
    assert behavior.handle(arm(12.0)) == [Tone("audio", 40_000.0, 0.5), go(0.0, 0.0, 0.05)]
    behavior.handle(arm(12.1))
    assert behavior.state == "BASELINE"
    assert behavior.handle(Tick(14.2)) == [go(0.051, 0.0, 0.01)]
    tell(behavior, arm(19.3), Resumed(20.0))
    assert behavior.state == "RETRACTING", "paused at its end"
    behavior.handle(arm(25.1))
    assert behavior.state == "LEAVING"


LEFT_ALONE = [touch(4.5, "contact_ours")]
HELD = [*LEFT_ALONE, held(5.0, "contact_ours")]
ENDED = [*HELD, lost(5.5, "contact_ours")]
AGAIN = [*ENDED, touch(5.6, "contact_ours")]


@pytest.mark.parametrize("reported", [LEFT_ALONE, HELD, AGAIN])
@pytest.mark.parametrize("event", [Tick(6.0), Resumed(5.9)])
def test_a_touch_that_stands_before_the_approach_lets_none_begin(reported, event):
    behavior, _ = to("BASELINE", touch=True)
    tell(behavior, *reported)
    assert behavior.handle(event) == [go(0.0, 0.1, 0.05)], "up and away from what it touches"
    behavior.handle(arm(8.0))
    assert (behavior.done, behavior.outcome) == (True, "touched")
    assert "contact_ours reported a touch at rest and not its end" in behavior.reason


@pytest.mark.parametrize(
    ("touches", "reported"), [(True, ENDED), (True, [touch(4.5, "contact_paper")]), (False, LEFT_ALONE)]
)
def test_a_touch_that_has_ended_or_of_who_does_not_act_hinders_no_approach(touches, reported):
    behavior, _ = to("BASELINE", touch=touches)
    tell(behavior, *reported)
    assert behavior.handle(Tick(6.0)) == [go(0.051, 0.0, 0.01)]


def test_a_touch_whose_end_was_not_felt_ends_a_trial_of_many_approaches():
    behavior, _ = to("APPROACHING", touch=True, cycles=3)
    behavior.handle(touch(8.1, "contact_ours"))
    tell(behavior, still(8.2, 0.02), Tick(10.3), arm(12.0))
    assert behavior.state == "BASELINE"
    assert behavior.handle(Tick(14.1)) == [go(0.0, 0.1, 0.05)]
    assert "not its end" in behavior.reason


@pytest.mark.parametrize("state", ["HOLDING", "RETRACTING"])
def test_after_a_pause_no_detector_carries_its_events_into_the_next_approach(state):
    behavior, _ = to(state, cycles=2)
    assert behavior.handle(Resumed(20.0)) == [go(0.0, 0.0, 0.01)]
    assert behavior.plan.detectors == DETECTORS, "the end of the contact is measured all the same"
    behavior.handle(arm(25.0))
    assert behavior.plan.detectors == frozenset()
    behavior.handle(arm(25.1))
    assert behavior.state == "BASELINE"
    assert behavior.plan.detectors == DETECTORS
