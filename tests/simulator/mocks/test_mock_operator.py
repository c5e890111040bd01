"""The simulated person at the far end of a line, and the real driver on it in one process."""

import json
import math
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import Answered, Ask, Listen, Loaded, LoadWeight, Refused, Sent, Status
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.operator import EmulatedPerson, HandSettings
from simulator.mocks.operator import MockPerson, MockPersonSettings
from tests.contracts.crank import Crank


class Fingertip:
    """What hangs on it; it has no bridge y."""

    def __init__(self, key: tuple[int, int] = (1, 0)) -> None:
        self.key = key
        self.hangs: dict[str, float] = {}
        self.advanced_s = 0.0

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        self.advanced_s = t_s

    def load(self, bridge: str, force_n: float) -> None:
        if bridge == "y" and force_n:
            raise RefusedError("bench", "hanging a weight", "there is no bridge y", "take another sensor")
        self.hangs[bridge] = force_n


def opened(*faults: Fault, tip: Fingertip | None = None, **settings: Any) -> tuple[Crank, Fingertip]:
    bench: Any = tip or Fingertip()
    values = MockPersonSettings(**{"weight_error": 0.0, **settings})
    device = MockPerson("operator", values, VirtualClock(), bench, FaultSchedule(faults))
    return Crank(device), bench


def test_a_request_is_sent_and_answered_under_its_number() -> None:
    person, _ = opened()
    sent, answered = person.answers(Ask("operator", "wipe the tip", id=3))
    assert (type(sent), sent.command_id) == (Sent, 3)
    assert (type(answered), answered.command_id) == (Answered, 3)
    assert answered.t_s - sent.t_s == pytest.approx(0.4, abs=0.005)


def test_the_weight_hangs_when_the_person_has_had_their_time() -> None:
    person, tip = opened(answer_s=2.0)
    assert person.device.alone_s == math.inf
    command = LoadWeight("operator", "t", 1.5)
    person.device.apply(command)
    assert person.device.alone_s == 2.0
    person.clock.wait_until(1.9)
    assert (person.device.poll(), tip.hangs) == ([Sent(0.0, "operator", command)], {})
    person.clock.wait_until(2.0)
    assert person.device.poll() == [Loaded(2.0, "operator", "t", 1.5)]
    assert (tip.hangs["t"], tip.advanced_s) == (1.5, 2.0)


def test_a_weight_hangs_alone_and_is_reported_and_sampled() -> None:
    person, tip = opened()
    person.device.apply(Listen("operator", frozenset({"operator.load"})))
    for command, hangs in (
        (LoadWeight("operator", "x", 2.0, id=4), {"x": 2.0, "y": 0.0, "t": 0.0}),
        (LoadWeight("operator", "t", 1.5, id=5), {"x": 0.0, "y": 0.0, "t": 1.5}),
    ):
        sent, loaded = person.answers(command)
        assert (type(sent), type(loaded), loaded.command_id) == (Sent, Loaded, command.id)
        assert tip.hangs == hangs
    assert [block.values.tolist() for block in person.blocks] == [[[2.0, 0.0, 0.0]], [[0.0, 0.0, 1.5]]]
    assert np.diff([block.seq for block in person.blocks]).tolist() == [1]


def test_a_newer_request_takes_an_older_one_s_place() -> None:
    person, tip = opened()
    person.device.apply(LoadWeight("operator", "x", 2.0, id=1))
    person.turn(0.2)
    answers = person.answers(Ask("operator", "wait", id=2))
    assert [(type(one), one.command_id) for one in answers][-1] == (Answered, 2)
    assert not [one for one in answers if isinstance(one, Loaded)]
    assert tip.hangs == {}


def test_what_the_tip_does_not_bear_is_refused_with_the_reason() -> None:
    person, _ = opened()
    refused = person.answers(LoadWeight("operator", "y", 1.0, id=7))[-1]
    assert isinstance(refused, Refused)
    assert (refused.command_id, refused.reason) == (7, "there is no bridge y; take another sensor")


@pytest.mark.parametrize(
    ("kind", "kinds"), [("refuse", [Sent, Refused]), ("silent", [Sent]), ("lose", [Sent])]
)
def test_a_person_who_refuses_or_does_not_answer(kind: Any, kinds: list[type[Status]]) -> None:
    person, _ = opened(Fault(device="operator", kind=kind, at_s=0.05))
    person.turn(0.1)
    assert [type(one) for one in person.answers(Ask("operator", "wipe the tip"))] == kinds


def test_what_was_asked_for_in_one_trial_is_not_done_in_the_next() -> None:
    person, tip = opened(Fault(device="operator", kind="refuse", at_s=0.0, trial=1), answer_s=1.0)
    faults = person.device._faults
    faults.restart(1)
    person.device.apply(LoadWeight("operator", "x", 2.0))
    person.clock.restart()
    person.device.restart()
    faults.restart(2)
    person.clock.wait_until(5.0)
    person.device.poll()
    assert tip.hangs == {}
    person.device.apply(Ask("operator", "shut the door"))
    person.clock.wait_until(7.0)
    assert person.device.poll()[-1] == Answered(7.0, "operator", "shut the door")


def test_a_weight_has_one_error_all_through_a_run_and_another_run_has_other_weights() -> None:
    pulls = {}
    for key in ((5, 1), (5, 2), (6, 1)):
        person, tip = opened(tip=Fingertip(key), answer_s=0.0, weight_error=0.01)
        person.device.apply(LoadWeight("operator", "x", 2.0))
        person.device.poll()
        pulls[key] = tip.hangs["x"]
    assert pulls[5, 1] == pulls[5, 2] != pulls[6, 1]
    assert all(0.0 < abs(pull / 2.0 - 1.0) < 0.05 for pull in pulls.values())


# --- at the far end of a line ------------------------------------------------------------------------


def test_the_emulated_person_greets_hangs_the_weight_and_answers_once() -> None:
    tip: Any = Fingertip()
    person = EmulatedPerson(HandSettings(answer_s=0.5, weight_error=0.0), tip)
    assert json.loads(person.receive(b'{"hello": "touchbench"}\n', 0.0)) == {"hello": "emulated person"}
    request = b'{"ask": 9, "says": "hang 1.00 N on bridge Ft", "load": {"bridge": "t", "force_n": 1.0}}\n'
    assert person.receive(b"what?\n" + request, 1.0) == b""
    assert person.step(1.4) == b""
    assert json.loads(person.step(1.5)) == {"answer": 9, "done": True}
    assert tip.hangs["t"] == 1.0
    assert person.step(2.0) == b""
    with pytest.raises(ValueError, match="no fault 'stall'"):
        person.inject("stall", 0.0)
