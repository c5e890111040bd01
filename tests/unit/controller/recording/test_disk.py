"""The recorder's thread: posting never waits, and nothing is dropped without a report."""

import threading
from pathlib import Path

import pytest

from controller.recording import disk
from controller.recording.disk import DiskThread

PATIENCE_S = 100.0
"""How long a thread that has all it needs may take on a machine that is busy with others."""


class Page:
    """A file in memory, which the test may hold up as a disk does."""

    def __init__(self, name="recording.mcap"):
        self.path = Path(name)
        self.lines = []
        self.committed = []
        self.state = "open"
        self.busy = threading.Event()
        self.free = threading.Event()
        self.free.set()

    def write(self, line):
        self.busy.set()
        assert self.free.wait(PATIENCE_S)
        self.lines.append(line)

    def break_down(self):
        raise OSError(28, "No space left on device")

    def commit(self, sync):
        self.committed = list(self.lines)

    def finish(self):
        self.state = "finished"

    def abandon(self):
        self.state = "abandoned" if self.state == "open" else self.state


def hung(page, thread):
    """Holds the page up until the test sets `free`."""
    page.free.clear()
    thread.post(page, page.write, "held up")
    thread._wake.set()
    assert page.busy.wait(PATIENCE_S)


def test_what_is_posted_is_written_in_order_and_committed_by_a_flush():
    page = Page()
    thread = DiskThread([page])
    for line in "abc":
        thread.post(page, page.write, line)
    thread.flush()
    assert page.committed == ["a", "b", "c"]
    thread.post(page, page.write, "d")
    thread.close()
    assert page.committed == ["a", "b", "c", "d"]
    assert page.state == "finished"
    assert thread.failure is None


def test_a_post_comes_back_while_the_disk_hangs():
    page = Page()
    thread = DiskThread([page])
    hung(page, thread)
    for number in range(1000):
        assert thread.room()
        thread.post(page, page.write, number)
    assert page.lines == [], "it hangs still, and the thousand are posted"
    page.free.set()
    thread.close()
    assert page.lines == ["held up", *range(1000)]


def test_a_file_that_fails_is_abandoned_and_the_others_go_on():
    page, other = Page(), Page("trials.csv")
    thread = DiskThread([page, other])
    thread.post(page, page.write, "a")
    thread.post(page, page.break_down)
    thread.post(page, page.write, "b")
    thread.post(other, other.write, "row")
    thread.close()
    assert (page.lines, page.state) == (["a"], "abandoned")
    assert (other.lines, other.state) == (["row"], "finished")
    assert "No space left on device while writing recording.mcap" in str(thread.failure)


def test_a_disk_that_cannot_keep_up_is_a_failure_with_nothing_dropped_and_waited_for_in_virtual_time(
    monkeypatch,
):
    monkeypatch.setattr(disk, "BACKLOG", 10)
    page = Page()
    thread = DiskThread([page])
    hung(page, thread)
    posted = 0
    while thread.room():
        thread.post(page, page.write, posted)
        posted += 1
    assert posted == 10
    assert "the disk cannot keep up, 10 posts wait for it" in str(thread.failure)
    assert "\n" not in str(thread.failure)
    page.free.set()
    thread.close()
    monkeypatch.setattr(disk, "BACKLOG", 10)
    page = Page()
    thread = DiskThread([page], patient=True)
    for number in range(1000):
        assert thread.room()
        thread.post(page, page.write, number)
    thread.close()
    assert page.lines == list(range(1000))
    assert thread.failure is None


@pytest.mark.parametrize("ending", ["flush", "close"])
def test_a_disk_that_takes_nothing_is_waited_for_once_and_reported(monkeypatch, ending):
    monkeypatch.setattr(disk, "GONE_S", 0.05)
    page = Page()
    thread = DiskThread([page])
    hung(page, thread)
    getattr(thread, ending)()
    assert "the disk took nothing for 0.05 s while writing recording.mcap" in str(thread.failure)
    monkeypatch.setattr(disk, "GONE_S", 1e6)
    thread.close()
    page.free.set()
