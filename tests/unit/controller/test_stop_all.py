"""Who has a device, and a stop of all that moves."""

import fcntl
import json
import os
from threading import Event, Lock
from time import sleep
from types import SimpleNamespace

import pytest

from controller import stopping
from controller.holding import Holding, folder
from drivers.core.errors import DeviceError
from tests.refusals import refused

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


STAGE = {"stage": {"port": "/dev/ttyUSB7"}}


@pytest.fixture(autouse=True)
def own_folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path))
    folder().mkdir()


@pytest.fixture
def another():
    """Leaves the note of another program; a lock on it says that the program lives."""
    descriptors = []

    def leave(devices, lives=True):
        path = folder() / "4194304-other.json"
        note = {"pid": os.getpid() + 1, "profile": "hardware/other", "doing": "jog", "devices": devices}
        path.write_text(json.dumps(note))
        descriptors.append(os.open(path, os.O_RDWR))
        if lives:
            fcntl.flock(descriptors[-1], fcntl.LOCK_EX)
        return path

    yield leave
    for descriptor in descriptors:
        os.close(descriptor)


def test_a_device_that_another_program_has_is_refused_with_who_has_it(another):
    theirs = another({"carriage": {"port": "/dev/ttyUSB7"}})
    named = ("stage", "jog", "hardware/other", str(os.getpid() + 1), "stop hardware/other")
    with refused(DeviceError, *named), Holding("hardware/mine", "run", STAGE, alone=True):
        pass
    assert list(folder().iterdir()) == [theirs], "the refused program leaves no note"


def test_a_serial_port_is_known_by_each_of_its_names(another, tmp_path):
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB7")
    another({"stage": {"port": str(tmp_path / "ttyUSB7")}})
    mine = {"stage": {"port": str(tmp_path / "by-id")}}
    with refused(DeviceError, "stage", "hardware/other"), Holding("hardware/mine", "run", mine, alone=True):
        pass


def test_the_note_of_a_program_that_was_killed_is_removed(another):
    stale = another(STAGE, lives=False)
    with Holding("hardware/mine", "run", STAGE, alone=True):
        assert not stale.exists()


@pytest.mark.parametrize(
    ("theirs", "mine", "alone"),
    [
        ({"stage": {"port": "/dev/ttyUSB8"}}, STAGE, True),
        ({"operator": {"port": "console"}}, {"operator": {"port": "console"}}, True),
        ({"board": {"port": "mock"}}, {"board": {"port": "mock"}}, True),
        (STAGE, STAGE, False),
    ],
    ids=["another port", "the console", "a mock", "a simulated bench"],
)
def test_what_no_two_programs_share_is_not_refused(another, theirs, mine, alone):
    another(theirs)
    with Holding("hardware/mine", "run", mine, alone=alone):
        assert len(list(folder().iterdir())) == 2
