"""Output that nobody reads, and a disk that hangs; one that is full: tests/swarm."""

import fcntl
import os
import subprocess
import threading
from contextlib import suppress
from pathlib import Path

import pytest

from controller.recording.reader import open_run
from controller.recording.run_folder import RunFolder
from tests.program import program

QUICK = ["--set", "behavior.settle_s=2.0", "--set", "detectors.contact.threshold_sigma=8"]


def run(out, stdout, **extra):
    trials = ["run", "mock/transient", "--only", "16", "--only", "17", "--no-report"]
    return program(*trials, *QUICK, "--out", out, stdout=stdout, stderr=subprocess.PIPE, **extra)


def ended_well(process, out):
    with process:
        errors = process.communicate(timeout=120)[1]
    (folder,) = out.iterdir()
    run = open_run(folder)
    assert (process.returncode, errors) == (0, "")
    assert [row["outcome"] for row in run.trials] == ["contact", "contact"]
    assert run.manifest["exit"]["status"] == "done"


def test_a_reader_that_leaves_after_the_first_line(tmp_path):
    reading, writing = os.pipe()
    process = run(tmp_path, writing)
    os.close(writing)
    assert os.read(reading, 200).startswith(b"time: about")
    os.close(reading)
    ended_well(process, tmp_path)


def test_a_full_disk_under_the_output(tmp_path):
    with Path("/dev/full").open("w") as full:
        ended_well(run(tmp_path, full), tmp_path)


def test_an_input_and_an_output_that_are_closed(tmp_path):
    ended_well(run(tmp_path, None, preexec_fn=lambda: os.closerange(0, 2)), tmp_path)


PATIENCE_S = 60.0
"""How long a whole trial in virtual time may take on a machine that is busy with others."""


class Pipe:
    """In the place of events.jsonl: it is full, and nothing reads it before the test does."""

    def __init__(self):
        self.read = b""
        self._thread = None

    def make(self, path):
        os.mkfifo(path)
        self._far = os.open(path, os.O_RDWR)
        fcntl.fcntl(self._far, fcntl.F_SETPIPE_SZ, 4096)
        os.set_blocking(self._far, False)
        with suppress(BlockingIOError):
            while True:
                os.write(self._far, b"\n")

    def drain(self):
        os.set_blocking(self._far, True)
        self._thread = threading.Thread(target=self._drain, daemon=True)
        self._thread.start()

    def _drain(self):
        while piece := os.read(self._far, 65536):
            self.read += piece


@pytest.fixture
def pipe(monkeypatch):
    pipe = Pipe()
    create = RunFolder.create

    def made(root: Path, *arguments):
        folder = create(root, *arguments)
        pipe.make(folder.events_path)
        return folder

    monkeypatch.setattr(RunFolder, "create", made)
    return pipe


def test_a_trial_goes_to_its_end_while_the_disk_hangs_and_then_all_of_it_is_written(
    run_profile, script, pipe
):
    """The disk hangs from the first event on until the trial has done its last turn: nothing else lets it go."""
    hung = []

    def wrap(rig):
        begin = rig.begin_trial
        known = rig.known

        def began(scene):
            hung.append("hangs")
            begin(scene)

        def ended():
            hung.append("goes on")
            pipe.drain()
            return known()

        object.__setattr__(rig, "begin_trial", began)
        object.__setattr__(rig, "known", ended)  # asked once the loop has come back

    done = []
    thread = threading.Thread(
        target=lambda: done.append(run_profile(trials=(1,), script=script, wrap=wrap)), daemon=True
    )
    thread.start()
    thread.join(PATIENCE_S)
    assert done, f"the loop waits for the disk, in {script.seen[-1:]}"
    assert hung == ["hangs", "goes on"]
    assert done[0].outcome.exit_code == 0
    assert script.rows[0][2] == "contact"
    assert b'"event": "Contact"' in pipe.read
    assert b'"event": "Standstill"' in pipe.read
