"""The real driver on the emulated person, in virtual time: refusals, limits and statuses."""

from typing import Any, cast

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import Answered, Ask, Command, Listen, Loaded, LoadWeight, Refused, Sent, Status
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.operator import MockPerson, MockPersonSettings
from tests.contracts.crank import Crank


class Fingertip:
    """What hangs on it; it has no bridge y."""

    key = (1, 0)

    def __init__(self) -> None:
        self.hangs: dict[str, float] = {}

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None: ...

    def load(self, bridge: str, force_n: float) -> None:
        if bridge == "y" and force_n:
            raise RefusedError("bench", "hanging a weight", "there is no bridge y", "take another sensor")
        self.hangs[bridge] = force_n


@pytest.fixture
def opened() -> Any:
    def made(*faults: Fault) -> tuple[Crank, Fingertip]:
        tip = Fingertip()
        settings = MockPersonSettings(weight_error=0.0)
        device = MockPerson("operator", settings, VirtualClock(), cast(Any, tip), FaultSchedule(faults))
        return Crank(device, device._clock), tip

    return made


def statuses_after(person: Crank, command: Command, seconds: float = 1.0) -> list[Status]:
    person.statuses.clear()
    person.device.apply(command)
    person.turn(seconds)
    return list(person.statuses)


def test_a_request_is_sent_and_answered_under_its_number(opened: Any) -> None:
    person, _ = opened()
    sent, answered = statuses_after(person, Ask("operator", "wipe the tip", id=3))
    assert (type(sent), sent.command_id) == (Sent, 3)
    assert (type(answered), answered.command_id) == (Answered, 3)
    assert answered.t_s - sent.t_s == pytest.approx(0.4, abs=0.005)


def test_a_weight_hangs_alone_and_is_reported_and_sampled(opened: Any) -> None:
    person, tip = opened()
    person.device.apply(Listen("operator", frozenset({"operator.load"})))
    for command, hangs in (
        (LoadWeight("operator", "x", 2.0, id=4), {"x": 2.0, "y": 0.0, "t": 0.0}),
        (LoadWeight("operator", "t", 1.5, id=5), {"x": 0.0, "y": 0.0, "t": 1.5}),
    ):
        sent, loaded = statuses_after(person, command)
        assert (type(sent), type(loaded), loaded.command_id) == (Sent, Loaded, command.id)
        assert tip.hangs == hangs
    assert [block.values.tolist() for block in person.blocks] == [[[2.0, 0.0, 0.0]], [[0.0, 0.0, 1.5]]]
    assert np.diff([block.seq for block in person.blocks]).tolist() == [1]


def test_a_newer_request_takes_an_older_one_s_place(opened: Any) -> None:
    person, tip = opened()
    person.device.apply(LoadWeight("operator", "x", 2.0, id=1))
    person.turn(0.2)
    answers = statuses_after(person, Ask("operator", "wait", id=2))
    assert [(type(one), one.command_id) for one in answers][-1] == (Answered, 2)
    assert not [one for one in answers if isinstance(one, Loaded)]
    assert tip.hangs == {}


def test_what_the_tip_does_not_bear_is_refused_with_the_reason(opened: Any) -> None:
    person, _ = opened()
    refused = statuses_after(person, LoadWeight("operator", "y", 1.0, id=7))[-1]
    assert isinstance(refused, Refused)
    assert (refused.command_id, refused.reason) == (7, "there is no bridge y; take another sensor")


@pytest.mark.parametrize(
    ("kind", "kinds"), [("refuse", [Sent, Refused]), ("silent", [Sent]), ("lose", [Sent])]
)
def test_a_person_who_refuses_or_does_not_answer(opened: Any, kind: Any, kinds: list[type[Status]]) -> None:
    person, _ = opened(Fault(device="operator", kind=kind, at_s=0.05))
    person.turn(0.1)
    assert [type(one) for one in statuses_after(person, Ask("operator", "wipe the tip"))] == kinds
