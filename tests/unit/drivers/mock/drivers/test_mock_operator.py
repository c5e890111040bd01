"""The simulated person, in the process and at the far end of a line: both hang the same weights."""

import json

import pytest

from drivers.clock import VirtualClock
from drivers.errors import RefusedError
from drivers.messages import Answered, Ask, Listen, Loaded, LoadWeight, Refused, Sent
from drivers.mock.devices.faults import Fault, FaultSchedule
from drivers.mock.devices.operator import EmulatedPerson, EmulatedPersonSettings
from drivers.mock.drivers.operator import MockPerson, MockPersonSettings


class Bench:
    """Remembers what hangs on it."""

    def __init__(self):
        self.key = (5, 1)
        self.advanced_s = 0.0
        self.loads = {"x": 0.0, "y": 0.0, "t": 0.0}
        self.carries = "fingertip"

    def advance(self, t_s, observe=None):
        self.advanced_s = t_s

    def load(self, bridge, force_n):
        if self.carries != "fingertip":
            raise RefusedError(
                "fingertip", "being loaded", f"the tip carries {self.carries}", "run the fingertip"
            )
        self.loads[bridge] = force_n


def mock(bench, fault=None, **settings):
    clock = VirtualClock()
    faults = FaultSchedule([Fault(device="operator", kind=fault, at_s=0.0)] if fault else [])
    person = MockPerson("operator", MockPersonSettings(weight_error=0.0, **settings), clock, bench, faults)
    person.open()
    person.apply(Listen("operator", frozenset({"operator.load"})))
    return person, clock


def test_the_weight_hangs_when_the_person_has_had_their_time():
    bench = Bench()
    person, clock = mock(bench, answer_s=2.0)
    command = LoadWeight("operator", "y", 3.0)
    person.apply(command)
    clock.wait_until(1.9)
    assert (person.read(), person.poll(), bench.loads["y"]) == ([], [Sent(0.0, "operator", command)], 0.0)
    clock.wait_until(2.0)
    (block,) = person.read()
    assert block.values.tolist() == [[0.0, 3.0, 0.0]]
    assert person.poll() == [Loaded(2.0, "operator", "y", 3.0)]
    assert (bench.loads, bench.advanced_s) == ({"x": 0.0, "y": 3.0, "t": 0.0}, 2.0)


def test_the_next_weight_takes_the_last_one_off():
    bench = Bench()
    person, _ = mock(bench, answer_s=0.0)
    for bridge in ("x", "t"):
        person.apply(LoadWeight("operator", bridge, 1.0))
        person.poll()
    assert bench.loads == {"x": 0.0, "y": 0.0, "t": 1.0}


def test_other_requests_are_answered():
    person, _ = mock(Bench(), answer_s=0.0)
    person.apply(Ask("operator", "shut the door"))
    assert person.poll()[-1] == Answered(0.0, "operator", "shut the door")


def test_a_person_who_says_nothing_or_no_leaves_no_weight_hanging():
    for fault, kinds in (("silent", [Sent]), ("refuse", [Sent, Refused])):
        bench = Bench()
        person, clock = mock(bench, fault, answer_s=0.0)
        person.apply(LoadWeight("operator", "x", 1.0))
        clock.wait_until(60.0)
        assert [type(status) for status in person.poll()] == kinds
        assert bench.loads["x"] == 0.0


def test_a_tip_without_bridges_cannot_be_loaded_and_that_is_said():
    bench = Bench()
    bench.carries = "wrist"
    person, _ = mock(bench, answer_s=0.0)
    person.apply(LoadWeight("operator", "x", 1.0))
    refused = person.poll()[-1]
    assert isinstance(refused, Refused)
    assert refused.reason == "the tip carries wrist; run the fingertip"


def test_a_weight_has_one_error_all_through_a_run_and_another_run_has_other_weights():
    pulls = {}
    for seed, trial in ((5, 1), (5, 2), (6, 1)):
        bench = Bench()
        bench.key = (seed, trial)
        person = MockPerson(
            "operator", MockPersonSettings(answer_s=0.0, weight_error=0.01), VirtualClock(), bench
        )
        person.apply(LoadWeight("operator", "x", 2.0))
        person.poll()
        pulls[seed, trial] = bench.loads["x"]
    assert pulls[5, 1] == pulls[5, 2] != pulls[6, 1]
    assert all(0.0 < abs(pull / 2.0 - 1.0) < 0.05 for pull in pulls.values())


# --- at the far end of a line ------------------------------------------------------------------------


def told(line):
    return [json.loads(each) for each in line.splitlines()]


def test_the_emulated_person_says_hello_hangs_the_weight_and_answers_once():
    bench = Bench()
    person = EmulatedPerson(EmulatedPersonSettings(answer_s=0.5, weight_error=0.0), bench)
    assert told(person.receive(b'{"hello": "touchbench"}\n', 0.0)) == [{"hello": "emulated person"}]
    request = b'{"ask": 9, "says": "hang 1.00 N on bridge Ft", "load": {"bridge": "t", "force_n": 1.0}}\n'
    assert person.receive(request, 1.0) == b""
    assert person.step(1.4) == b""
    assert told(person.step(1.5)) == [{"answer": 9, "done": True}]
    assert bench.loads["t"] == 1.0
    assert person.step(2.0) == b""


def test_the_emulated_person_answers_the_latest_question_alone():
    person = EmulatedPerson(EmulatedPersonSettings(answer_s=0.5), Bench())
    person.receive(b'{"ask": 1, "says": "shut the door"}\nwhat?\n{"ask": 2, "says": "open it"}\n', 0.0)
    assert told(person.step(5.0)) == [{"answer": 2, "done": True}]


def test_the_emulated_person_gives_a_reason_for_no():
    bench = Bench()
    bench.carries = "wrist"
    person = EmulatedPerson(EmulatedPersonSettings(answer_s=0.0), bench)
    load = b'{"ask": 1, "says": "hang it", "load": {"bridge": "x", "force_n": 1.0}}\n'
    person.receive(load, 0.0)
    assert told(person.step(0.0))[0] == {
        "answer": 1,
        "done": False,
        "reason": "the tip carries wrist; run the fingertip",
    }
    bench.carries = "fingertip"
    person.inject("refuse", 0.0)
    person.receive(load, 0.0)
    assert told(person.step(0.0))[0]["done"] is False
    with pytest.raises(ValueError, match="no fault stall"):
        person.inject("stall", 0.0)
