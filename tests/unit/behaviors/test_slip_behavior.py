"""B8's machine: which commands follow from which events."""

from dataclasses import replace

import pytest
from pydantic import ValidationError

from behaviors.events import BaselineRefused, Contact, Resumed, SlipStarted, Tick
from behaviors.machine import UNDECIDED
from behaviors.slip import RollSlip, RollSlipFactors, RollSlipSettings
from drivers.core.messages import Home, MoveAt, Sent, Stop, Tare, Twist
from tests.unit.behaviors.driving import arm, still, tell

RUN = {
    **{"stream": "board.fingertip", "forces_stream": "signals.tip", "tilt_rad": -0.4, "press_m": 0.001},
    **{"touch": "touch", "paper": "paper", "ours": "ours"},
    "steps": (
        {"do": "hold", "duration_s": 0.2},
        {"do": "roll", "duration_s": 2.0, "turn_rad": 0.8},
        {"do": "load", "duration_s": 0.5, "speed_m_s": -0.0005},
        {"do": "slip", "duration_s": 3.0, "speed_m_s": -0.01},
        {"do": "hold", "duration_s": 1.0},
    ),
}


def trial(run=None, **settings):
    made = RollSlipSettings(sensors={"fingertip": {**RUN, **(run or {})}}, **settings)
    return RollSlip(made, RollSlipFactors(sensor="fingertip"), frozenset({"touch", "paper", "ours", "other"}))


def slip(t_s, detector="ours"):
    return SlipStarted(t_s, detector, 12.0, 7.0)


def touch(t_s, detector="touch"):
    return Contact(t_s, detector, 0.4, 0.3)


PATH = [
    ("ZEROING", arm(0.5)),
    ("TILTING", Tick(0.7)),
    ("RESTING", arm(2.7)),
    ("DESCENDING", Tick(3.7)),
    ("STOPPING", touch(5.2)),
    ("PRESSING", still(5.21, 0.0031)),
    ("HOLDING", arm(5.7, 0.0041)),
    ("ROLLING", Tick(5.9)),
    ("LOADING", arm(7.3)),
    ("SLIPPING", arm(7.9)),
    ("HOLDING", arm(10.9)),
    ("LIFTING", Tick(11.9)),
    ("LEVELLING", arm(12.5)),
    ("RETURNING", arm(13.0)),
    ("DONE", arm(14.0)),
]


MOVING_FREELY = ("ZEROING", "TILTING", "LIFTING", "LEVELLING", "RETURNING")


def led_to(state, **settings):
    behavior = trial(**settings)
    behavior.begin(0.0)
    for name, event in PATH:
        if behavior.state is state:
            return behavior
        behavior.handle(event)
        assert behavior.state is name
    return behavior


def test_a_trial_touches_presses_rolls_slides_and_goes_home():
    behavior = trial()
    commands = [list(behavior.begin(0.0))]
    for state, event in PATH:
        commands.append(list(behavior.handle(event)))
        assert behavior.state is state
    assert commands == [
        [Home("arm")],
        [Tare("arm", "arm.force")],
        [Twist("arm", (0.0, 0.0, 0.0, 0.0, -0.2, 0.0), pytest.approx(2.0))],
        [],
        [MoveAt("arm", 0.002, 0.006)],
        [Stop("arm")],
        [MoveAt("arm", 0.002, pytest.approx(0.0041))],
        [],
        # rolling: 0.4 rad/s, and 12 mm along for each radian
        [Twist("arm", (pytest.approx(0.0048), 0.0, 0.0, 0.0, 0.4, 0.0), 2.0)],
        [Twist("arm", (-0.0005, 0.0, 0.0, 0.0, 0.0, 0.0), 0.5)],
        [Twist("arm", (-0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 3.0)],
        [],
        [MoveAt("arm", -0.01, 0.0)],
        # tilted by -0.4, rolled by 0.8: 0.4 rad to turn back
        [Twist("arm", (0.0, 0.0, 0.0, 0.0, -0.2, 0.0), pytest.approx(2.0))],
        [Home("arm")],
        [],
    ]
    assert behavior.outcome == "contact"


def test_only_the_sensors_own_detectors_listen_from_rest_until_it_lifts_and_its_forces_are_watched():
    for state, _ in PATH[:-1]:
        plan = led_to(state).plan
        listening = state not in MOVING_FREELY
        assert plan.detectors == (frozenset({"touch", "paper", "ours"}) if listening else frozenset()), state
        assert ("signals.tip" in plan.measures) is listening
    assert trial().range_streams == {"signals.tip"}
    assert trial({"forces_stream": None}).range_streams == frozenset()


def test_slip_detectors_may_listen_from_the_first_motion_on_and_learn_there():
    behavior = trial({"listen": "motion"})
    behavior.begin(0.0)
    for state, event in PATH:
        behavior.handle(event)
        after_motion = state in ("ROLLING", "LOADING", "SLIPPING") or event.t_s > 10.0
        if state not in (*MOVING_FREELY, "DONE"):
            expected = {"touch", "paper", "ours"} if after_motion else {"touch"}
            assert behavior.plan.detectors == expected, state


def test_without_a_tilt_it_rests_at_once_and_without_stop_on_slip_nothing_follows_from_slip():
    behavior = trial({"tilt_rad": 0.0})
    behavior.begin(0.0)
    tell(behavior, arm(0.5), Tick(0.7))
    assert behavior.state == "RESTING"
    behavior = led_to("SLIPPING")
    assert behavior.handle(slip(8.0)) == []
    assert behavior.state == "SLIPPING"


@pytest.mark.parametrize("reflex", ["ours", "paper"])
def test_stop_on_slip_stops_at_once_for_the_reflex_detector_alone(reflex):
    behavior = led_to("SLIPPING", stop_on_slip=True, reflex=reflex)
    other = {"ours": "paper", "paper": "ours"}[reflex]
    assert behavior.handle(slip(8.0, other)) == []
    assert behavior.handle(slip(8.1, reflex)) == [Stop("arm")]
    assert behavior.handle(Sent(8.1, "arm", Stop("arm"))) == []
    assert behavior.handle(still(8.2, 0.004)) == []
    assert behavior.state == "STOPPED"
    assert behavior.handle(Tick(8.7)) == [MoveAt("arm", -0.01, 0.0)]


def test_a_roll_that_is_cut_short_is_turned_back_by_what_it_turned():
    behavior = led_to("ROLLING", stop_on_slip=True)
    tell(behavior, slip(5.9 + 0.5), still(6.5, 0.004), Tick(7.1))
    # a quarter of 0.8 rad from -0.4 rad: 0.2 rad are left
    assert behavior.handle(arm(7.6)) == [Twist("arm", (0.0, 0.0, 0.0, 0.0, 0.2, 0.0), pytest.approx(1.0))]


def test_the_touch_of_another_detector_is_not_its_own_and_without_a_table_there_is_no_contact():
    behavior = led_to("DESCENDING")
    assert behavior.handle(touch(5.0, "other")) == []
    assert behavior.state == "DESCENDING"
    assert behavior.handle(arm(6.7, 0.006)) == [MoveAt("arm", -0.01, 0.0)]
    assert behavior.outcome == "no_contact"
    assert "0.006 m" in behavior.reason


LIFT = MoveAt("arm", -0.01, 0.0)

MAY_TOUCH = RollSlip.states[RollSlip.states.index("DESCENDING") : RollSlip.states.index("RETURNING") + 1]
"""From the descent on the tip may stand on the table, wherever the pause has stopped it."""


def paused_in(state):
    """Led there; a stop on slip leads to the last two."""
    if state not in ("HALTING", "STOPPED"):
        return led_to(state)
    behavior = led_to("SLIPPING", stop_on_slip=True)
    behavior.handle(slip(8.1))
    if state == "STOPPED":
        behavior.handle(still(8.2, 0.004))
    return behavior


@pytest.mark.parametrize("state", [state for state in RollSlip.states if state not in RollSlip.final])
def test_a_pause_is_followed_by_a_lift_before_anything_else_wherever_the_tip_may_touch(state):
    behavior = paused_in(state)
    assert behavior.state is state
    assert behavior.handle(Resumed(60.0)) == [LIFT if state in MAY_TOUCH else Home("arm")]


@pytest.mark.parametrize("state", ["HOMING", "ZEROING", "TILTING", "RESTING"])
def test_a_pause_in_the_air_begins_anew(state):
    behavior = paused_in(state)
    tell(behavior, Resumed(60.0), arm(70.0))
    assert behavior.state == "ZEROING"
    assert behavior.handle(Tick(71.0)) == [
        Twist("arm", (0.0, 0.0, 0.0, 0.0, -0.2, 0.0), pytest.approx(2.0))
    ], "tilted from the start pose once more"


def test_a_pause_in_the_descent_lifts_and_then_begins_anew():
    behavior = led_to("DESCENDING")
    behavior.handle(Resumed(60.0))
    assert behavior.handle(Resumed(61.0)) == [LIFT], "paused once more"
    assert behavior.handle(arm(62.0)) == [Home("arm")]
    behavior.handle(arm(63.0))
    assert behavior.state == "ZEROING"
    for state, event in PATH[1:]:
        behavior.handle(replace(event, t_s=event.t_s + 63.0))
        assert behavior.state is state, "the second time it goes home from the lift by way of levelling"
    assert behavior.outcome == "contact"


@pytest.mark.parametrize("state", MAY_TOUCH[1:-3])
def test_a_pause_in_contact_lifts_and_gives_up(state):
    behavior = paused_in(state)
    behavior.handle(Resumed(60.0))
    assert behavior.outcome == "aborted"
    assert state in behavior.reason


@pytest.mark.parametrize("state", ["ROLLING", "LEVELLING"])
def test_a_turn_that_a_pause_broke_off_is_left_to_home(state):
    """It is unknown how far it went: turned back by the whole of it, the tip would end up beyond its range."""
    behavior = led_to(state)
    behavior.handle(Resumed(60.0))
    assert behavior.handle(arm(61.0)) == [Home("arm")]
    assert behavior.state == "RETURNING"


@pytest.mark.parametrize(("stops", "outcome"), [(True, "fault"), (False, UNDECIDED)])
def test_a_refused_baseline_of_a_slip_detector_is_a_fault_only_where_it_stops_the_arm(stops, outcome):
    behavior = led_to("DESCENDING", stop_on_slip=stops, reflex="ours")
    for detector in ("paper", "ours"):
        assert not behavior.done
        behavior.handle(BaselineRefused(5.0, detector, 0.1, 0.02, "it vibrates"))
    assert behavior.outcome == outcome


def test_a_motion_that_never_ends_is_a_fault_with_its_state():
    behavior = led_to("ROLLING")
    assert behavior.handle(Tick(5.9 + 2.0 + 29.9)) == []
    assert behavior.handle(Tick(5.9 + 2.0 + 30.0)) == [Stop("arm")]
    assert "ROLLING" in behavior.reason


def test_a_step_without_its_number_or_with_anothers_is_refused_and_two_of_a_kind_in_a_row():
    for step in ({"do": "roll"}, {"do": "slip", "turn_rad": 1.0}, {"do": "hold", "speed_m_s": 0.01}):
        with pytest.raises(ValidationError, match="each its own"):
            trial({"steps": ({"duration_s": 1.0, **step},)})
    twice = {"do": "slip", "duration_s": 1.0, "speed_m_s": 0.01}
    with pytest.raises(ValidationError, match="two of a kind"):
        trial({"steps": (twice, {**twice, "speed_m_s": -0.01})})
