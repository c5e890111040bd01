import math

import pytest
from pydantic import ValidationError

from behaviors.events import Resumed, Tick
from behaviors.weights import Weights, WeightsFactors, WeightsSettings
from drivers.core.messages import Answered, Ask, Loaded, LoadWeight
from tests.unit.behaviors.driving import lead, tell


def weights(bridge="x", **settings):
    given = {"weights_x_n": (1.0, 2.0), "cycles": 1, "preloads": 0, "swing_s": 1.0, "record_s": 0.5}
    return Weights(WeightsSettings(**given | settings), WeightsFactors(bridge=bridge), frozenset())


def answered(t_s):
    return Answered(t_s, "operator", "set up")


def run(behavior):
    """Answers whatever is asked; returns every load that was recorded, in order. At the end all is taken off."""
    recorded, t_s, force_n = [], 0.0, math.nan
    commands = behavior.begin(t_s)
    while not behavior.done:
        t_s += 1.0
        match commands:
            case [Ask()]:
                commands = behavior.handle(answered(t_s))
            case [LoadWeight(device=device, bridge=bridge, force_n=force_n)]:
                behavior.handle(Loaded(t_s, device, bridge, force_n))
                if behavior.state == "SWINGING":
                    behavior.handle(Tick(t_s + 1.0))
                    assert behavior.state == "RECORDING"
                    recorded.append(force_n)
                    t_s += 2.0
                    commands = behavior.handle(Tick(t_s))
            case _:
                raise AssertionError(commands)
    assert force_n == 0.0
    return recorded


def test_it_asks_for_the_setup_first_once_more_after_a_pause_and_then_for_nothing_on_it():
    behavior = weights()
    (asked,) = behavior.begin(0.0)
    assert asked == Ask("operator", "set the fingertip up for weights on bridge Fx, with nothing on it")
    assert behavior.handle(Resumed(5.0)) == [asked]
    assert behavior.state == "SETTING_UP"
    assert behavior.handle(answered(9.0)) == [LoadWeight("operator", "x", 0.0)]


def test_a_cycle_goes_up_through_all_weights_and_down_again_or_as_they_are_listed():
    behavior = weights(weights_x_n=(1.0, 2.0, 3.0), cycles=2, preloads=1)
    cycle = [1.0, 2.0, 3.0, 2.0, 1.0, 0.0]
    assert run(behavior) == [0.0, 3.0, 0.0, *cycle, *cycle]
    assert behavior.outcome == "calibrated"
    assert run(weights(weights_x_n=(2.0, 0.5, 1.0), order="listed")) == [0.0, 2.0, 0.5, 1.0, 0.0]


def test_the_wrong_weight_is_waited_out():
    behavior = weights()
    behavior.begin(0.0)
    behavior.handle(answered(1.0))
    for wrong in (("operator", "x", 1.0), ("operator", "y", 0.0), ("board", "x", 0.0)):
        assert behavior.handle(Loaded(2.0, *wrong)) == []
        assert behavior.state == "HANGING"
    behavior.handle(Loaded(3.0, "operator", "x", 0.0))
    assert behavior.state == "SWINGING"


def test_a_person_who_does_not_answer_ends_the_trial_with_the_request_in_its_reason():
    behavior = weights(answer_timeout_s=60.0)
    behavior.begin(0.0)
    tell(behavior, answered(1.0), Tick(60.9))
    assert not behavior.done
    behavior.handle(Tick(61.0))
    assert behavior.done
    assert behavior.outcome == "aborted"
    assert behavior.reason == "operator did not answer within 60 s when asked for 0 N on bridge x"


HUNG = {"HANGING": [answered(1.0)], "SWINGING": [Loaded(2.0, "operator", "x", 0.0)], "RECORDING": [Tick(3.0)]}


@pytest.mark.parametrize("state", HUNG)
def test_after_a_pause_the_same_weight_is_asked_for_again(state):
    behavior, _ = lead(weights(), HUNG, state)
    assert behavior.handle(Resumed(3.2)) == [LoadWeight("operator", "x", 0.0)]
    assert behavior.state == "HANGING"


def test_while_it_waits_for_the_person_only_their_answer_is_subscribed_and_only_still_weights_are_recorded():
    plans = weights().plans
    assert plans["HANGING"].measures == {"operator.load"}
    assert plans["SWINGING"].measures == frozenset()
    assert plans["RECORDING"].measures == {"board.fingertip"}


def test_weights_that_do_not_ascend_or_are_but_one_are_refused_and_the_defaults_end_where_the_paper_tested():
    for given in ({"weights_y_n": (2.0, 1.0)}, {"weights_t_n": (1.0,)}, {"weights_x_n": (0.0, 1.0)}):
        with pytest.raises(ValidationError):
            WeightsSettings(**given)
    for bridge, top_n in (("x", 7.0), ("y", 7.0), ("t", 1.0)):
        weights_n = WeightsSettings().weights_n(bridge)
        assert weights_n[-1] == top_n
        assert top_n / 2.0 in weights_n
