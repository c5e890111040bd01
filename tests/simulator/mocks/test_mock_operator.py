"""The simulated person at the far end of a line, and the real driver on it in one process."""

import json
import math

import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import Answered, Ask, Listen, Loaded, LoadWeight, Sent
from simulator.devices.faults import Fault, FaultSchedule
from simulator.devices.operator import EmulatedPerson, HandSettings
from simulator.mocks.operator import MockPerson, MockPersonSettings


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


def test_the_weight_hangs_when_the_person_has_had_their_time():
    bench = Bench()
    clock = VirtualClock()
    settings = MockPersonSettings(weight_error=0.0, answer_s=2.0)
    person = MockPerson("operator", settings, clock, bench)
    person.open()
    assert person.alone_s == math.inf
    person.apply(Listen("operator", frozenset({"operator.load"})))
    command = LoadWeight("operator", "y", 3.0)
    person.apply(command)
    assert person.alone_s == 2.0
    clock.wait_until(1.9)
    assert (person.read(), person.poll(), bench.loads["y"]) == ([], [Sent(0.0, "operator", command)], 0.0)
    clock.wait_until(2.0)
    (block,) = person.read()
    assert block.values.tolist() == [[0.0, 3.0, 0.0]]
    assert person.poll() == [Loaded(2.0, "operator", "y", 3.0)]
    assert (bench.loads, bench.advanced_s) == ({"x": 0.0, "y": 3.0, "t": 0.0}, 2.0)


def test_what_was_asked_for_in_one_trial_is_not_done_in_the_next():
    bench = Bench()
    clock = VirtualClock()
    refuses = FaultSchedule([Fault(device="operator", kind="refuse", at_s=0.0, trial=1)])
    person = MockPerson("operator", MockPersonSettings(answer_s=1.0), clock, bench, refuses)
    person.open()
    refuses.restart(1)
    person.apply(LoadWeight("operator", "x", 2.0))
    clock.restart()
    person.restart()
    refuses.restart(2)
    clock.wait_until(5.0)
    person.poll()
    assert bench.loads["x"] == 0.0
    person.apply(Ask("operator", "shut the door"))
    clock.wait_until(7.0)
    assert person.poll()[-1] == Answered(7.0, "operator", "shut the door")


def test_a_weight_has_one_error_all_through_a_run_and_another_run_has_other_weights():
    pulls = {}
    for seed, trial in ((5, 1), (5, 2), (6, 1)):
        bench = Bench()
        bench.key = (seed, trial)
        person = MockPerson(
            "operator", MockPersonSettings(answer_s=0.0, weight_error=0.01), VirtualClock(), bench
        )
        person.open()
        person.apply(LoadWeight("operator", "x", 2.0))
        person.poll()
        pulls[seed, trial] = bench.loads["x"]
    assert pulls[5, 1] == pulls[5, 2] != pulls[6, 1]
    assert all(0.0 < abs(pull / 2.0 - 1.0) < 0.05 for pull in pulls.values())


# --- at the far end of a line ------------------------------------------------------------------------


def decoded(line):
    return [json.loads(each) for each in line.splitlines()]


def test_the_emulated_person_greets_hangs_the_weight_and_answers_once():
    bench = Bench()
    person = EmulatedPerson(HandSettings(answer_s=0.5, weight_error=0.0), bench)
    assert decoded(person.receive(b'{"hello": "touchbench"}\n', 0.0)) == [{"hello": "emulated person"}]
    request = b'{"ask": 9, "says": "hang 1.00 N on bridge Ft", "load": {"bridge": "t", "force_n": 1.0}}\n'
    assert person.receive(request, 1.0) == b""
    assert person.step(1.4) == b""
    assert decoded(person.step(1.5)) == [{"answer": 9, "done": True}]
    assert bench.loads["t"] == 1.0
    assert person.step(2.0) == b""


def test_the_emulated_person_answers_the_latest_question_alone():
    person = EmulatedPerson(HandSettings(answer_s=0.5), Bench())
    person.receive(b'{"ask": 1, "says": "shut the door"}\nwhat?\n{"ask": 2, "says": "open it"}\n', 0.0)
    assert decoded(person.step(5.0)) == [{"answer": 2, "done": True}]


def test_the_emulated_person_gives_a_reason_for_no():
    bench = Bench()
    bench.carries = "wrist"
    person = EmulatedPerson(HandSettings(answer_s=0.0), bench)
    load = b'{"ask": 1, "says": "hang it", "load": {"bridge": "x", "force_n": 1.0}}\n'
    person.receive(load, 0.0)
    assert decoded(person.step(0.0))[0] == {
        "answer": 1,
        "done": False,
        "reason": "the tip carries wrist; run the fingertip",
    }
    bench.carries = "fingertip"
    person.inject("refuse", 0.0)
    person.receive(load, 0.0)
    assert decoded(person.step(0.0))[0]["done"] is False
    with pytest.raises(ValueError, match="no fault stall"):
        person.inject("stall", 0.0)
