"""The person at the far end of a line: the real driver with real pyserial on a pty, on the wall clock."""

import pytest

from drivers.core.messages import Ask, Failed, Listen, Loaded, LoadWeight, Sent
from drivers.operator.driver import Person, PersonSettings
from simulator.devices.operator import EmulatedPerson, HandSettings


class Bench:
    """Remembers what hangs on it."""

    def __init__(self):
        self.key = (1, 1)
        self.loads = {"x": 0.0, "y": 0.0, "t": 0.0}

    def advance(self, t_s, observe=None):
        pass

    def load(self, bridge, force_n):
        self.loads[bridge] = force_n


def until(person, kind, clock, seconds=5.0):
    """The next status of a kind, and everything that came before it."""
    end_s = clock.monotonic_s() + seconds
    seen, blocks = [], []
    while clock.monotonic_s() < end_s:
        blocks += person.read()
        for status in person.poll():
            seen.append(status)
            if isinstance(status, kind):
                return status, seen, blocks
        clock.rest(0.002)
    raise AssertionError(f"no {kind.__name__} in {seconds} s, but {seen}")


@pytest.fixture
def line(serve):
    bench = Bench()
    device = EmulatedPerson(HandSettings(answer_s=0.05, weight_error=0.0), bench)
    port = serve(device)
    clock = serve.clock
    person = Person("operator", PersonSettings(port=port), clock)
    info = person.open()
    yield person, bench, device, serve, port, info, clock
    person.close()


def test_the_client_that_answers_the_hello_is_named(line):
    assert line[5].model == "emulated person"
    assert list(line[5].streams) == ["operator.load"]


def test_a_weight_hangs_before_it_is_called_loaded(line):
    person, bench, *_, clock = line
    person.apply(Listen("operator", frozenset({"operator.load"})))
    asked_s = clock.now()
    person.apply(LoadWeight("operator", "t", 0.5))
    loaded, seen, blocks = until(person, Loaded, clock)
    assert isinstance(seen[0], Sent)
    assert bench.loads["t"] == 0.5
    assert (loaded.bridge, loaded.force_n) == ("t", 0.5)
    assert asked_s + 0.05 <= loaded.t_s <= clock.now()
    (block,) = blocks
    assert block.values.tolist() == [[0.0, 0.0, 0.5]]
    assert block.times[0] == loaded.t_s


def test_the_console_is_not_bothered_by_a_person_on_a_line(line):
    person = line[0]
    person.apply(Ask("operator", "shut the door"))
    assert person.question is None


def test_a_line_that_is_pulled_is_a_failure_reported_once(line):
    person, _, _, serve, port, _, clock = line
    person.apply(LoadWeight("operator", "x", 1.0))
    serve.unplug(port)
    failed, *_ = until(person, Failed, clock)
    assert "taken away" in failed.reason
    person.apply(LoadWeight("operator", "x", 1.0))
    clock.rest(0.05)
    assert not [status for status in person.poll() if isinstance(status, Failed)]
