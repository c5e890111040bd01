"""Who has a device, and a stop of all that moves."""

import fcntl
import json
import os
from contextlib import nullcontext
from threading import Event, Lock
from time import sleep
from types import SimpleNamespace
from typing import ClassVar

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
            assert self.stopped[self.waits_for[name]].wait(PATIENCE_S), "the other is to be stopped meanwhile"
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


def test_a_silent_mover_keeps_no_other_from_being_stopped_and_movers_on_one_line_are_stopped_in_turn(stop):
    bench = Sessions(gripper="/dev/ttyACM0", arm="10.0.0.2")
    bench.waits_for["gripper"] = "arm"
    still, said = stop(bench)
    assert not still
    assert said[0].startswith("gripper: NOT seen standing still"), "in the profile's order"
    assert said[1] == "arm: stopped, and stands still"
    bench = Sessions(**{f"axis{number}": "/dev/ttyUSB0" for number in range(8)})
    assert stop(bench)[0]


class Program:
    """Another program that has the stage: whether it ends once it is asked, and which movers it left moving."""

    pid = 4194304
    devices: ClassVar[dict[str, dict[str, str]]] = {"stage": {"port": "/dev/ttyUSB7"}}

    def __init__(self, ends, not_at_rest=None):
        self._ends, self._asked, self.not_at_rest = ends, False, not_at_rest

    def __str__(self):
        return "the other program"

    def ask(self):
        self._asked = True

    def ended(self, patience_s):
        return self._asked and self._ends


def opens(outcome="done", movers=("stage",)):
    """A session with the stage, in which a stop comes out so."""
    result = SimpleNamespace(outcome=outcome, reason="no answer")
    return lambda name: nullcontext(SimpleNamespace(movers=movers, limits=None, run=lambda *_, **__: result))


def silent(name):
    raise DeviceError(name, "opening", "it is silent", "look at its cable")


ENDS, HANGS = (True,), (False,)


@pytest.mark.parametrize(
    ("program", "open_one", "beside", "still", "words"),
    [
        (None, opens(), None, True, "stopped, and stands still"),
        (None, opens("fault"), None, False, "no answer"),
        (None, opens(movers=()), None, True, "does not move by itself"),
        (None, silent, None, False, "nothing else reaches it: press the emergency stop if it moves"),
        (None, silent, "", True, "its controller was told to stop, and it stands still"),
        (None, silent, "it is off", False, "it is off: press the emergency stop if it moves"),
        (None, None, None, True, "no program has this bench"),
        (ENDS, opens(), None, True, "stopped, and stands still"),
        (ENDS, None, None, False, "ended without a word"),
        ((True, {"stage"}), None, None, False, "look at the bench"),
        ((True, {"another"}), None, None, True, "saw its movers stand still"),
        (HANGS, opens(), None, False, "/dev/ttyUSB7 is held by the other program"),
        (HANGS, opens(), "", True, "the other program does not end: kill -9 4194304"),
        (HANGS, opens(), "it is off", False, "it is off; press the emergency stop"),
    ],
)
def test_of_each_mover_it_is_said_whether_it_stands_and_how_that_is_known(
    monkeypatch, program, open_one, beside, still, words
):
    programs, asked = [Program(*program)] if program else [], []
    monkeypatch.setattr(stopping, "unwatched", lambda limits: limits)
    monkeypatch.setattr(stopping, "holders", lambda profile, where: programs)
    stops = {} if beside is None else {"stop_beside": lambda where: asked.append(where) or beside}
    made = SimpleNamespace(**stops)
    settings = SimpleNamespace(model_copy=lambda update: update)
    said = []
    entries = {"stage": SimpleNamespace(made=made, settings=settings)}
    assert stopping.Stopping("", Program.devices, entries, said.append, open_one).run() is still
    line = said[-1]
    assert line.startswith("stage: " if still else "stage: NOT seen standing still: ")
    assert words in line
    assert said[:-1] == ["the other program is asked to stop"] * len(programs)
    if asked and programs:
        assert asked == [Program.devices["stage"]], "at the address where the program has it"


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


def test_the_note_of_a_program_that_was_killed_is_removed_and_a_port_is_known_by_each_of_its_names(
    another, tmp_path
):
    stale = another(STAGE, lives=False)
    with Holding("hardware/mine", "run", STAGE, alone=True):
        assert not stale.exists()
    (tmp_path / "by-id").symlink_to(tmp_path / "ttyUSB7")
    another({"stage": {"port": str(tmp_path / "ttyUSB7")}})
    mine = {"stage": {"port": str(tmp_path / "by-id")}}
    with refused(DeviceError, "stage", "hardware/other"), Holding("hardware/mine", "run", mine, alone=True):
        pass


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
