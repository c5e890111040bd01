"""One bench, one program: who has a device open is told from who had it."""

import fcntl
import json
import os

import pytest

from controller.holding import Holding, folder
from drivers.core.errors import DeviceError
from tests.refusals import refused

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
