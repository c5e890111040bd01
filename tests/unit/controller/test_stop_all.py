"""Which movers are stopped at once, and which one after the other."""

from threading import Event, Lock
from time import sleep
from types import SimpleNamespace

import pytest

from controller import stopping
from drivers.core.errors import DeviceError

PATIENCE_S = 30.0
"""Longest wait of one mover for another, where both are stopped at once. Generous: a thread starts in a millisecond."""


class Sessions:
    """Sessions of movers that count how many are open on one line."""

    def __init__(self, **lines):
        self.lines, self.stopped = lines, {name: Event() for name in lines}
        self.busy = {line: Lock() for line in lines.values()}
        self.waits_for = {}

    def open_one(self, name):
        if name in self.waits_for:
            assert self.stopped[self.waits_for[name]].wait(PATIENCE_S), (
                "the other was to be stopped meanwhile"
            )
            raise DeviceError(name, "opening", "it is silent", "look at its cable")
        return self.Session(self, name)

    class Session:
        def __init__(self, bench, name):
            self.movers, self.limits, self._bench, self._name = {name}, None, bench, name

        def __enter__(self):
            assert self._bench.busy[self._bench.lines[self._name]].acquire(blocking=False), "its line is busy"
            return self

        def __exit__(self, *_):
            self._bench.busy[self._bench.lines[self._name]].release()

        def run(self, *_, **__):
            self._bench.stopped[self._name].set()
            sleep(0.01)  # long enough for another to come across it
            return SimpleNamespace(outcome="done")


@pytest.fixture
def stop(monkeypatch):
    """Stops the movers of a bench; whether all stand, and what was said."""
    monkeypatch.setattr(stopping, "unwatched", lambda limits: limits)
    monkeypatch.setattr(stopping, "holders", lambda profile, where: [])

    def stop(bench):
        said = []
        where = {name: {"port": line} for name, line in bench.lines.items()}
        entries = {name: SimpleNamespace(made=None) for name in bench.lines}
        return stopping.Stopping("hardware/mine", where, entries, said.append, bench.open_one).run(), said

    return stop


def test_a_silent_mover_keeps_no_other_from_being_stopped(stop):
    bench = Sessions(gripper="/dev/ttyACM0", arm="10.0.0.2")
    bench.waits_for["gripper"] = "arm"
    still, said = stop(bench)
    assert not still
    assert said[0].startswith("gripper: NOT seen standing still"), "in the profile's order"
    assert said[1] == "arm: stopped, and stands still"


def test_movers_on_one_line_are_stopped_one_after_the_other(stop):
    bench = Sessions(**{f"axis{number}": "/dev/ttyUSB0" for number in range(8)})
    assert stop(bench)[0]
