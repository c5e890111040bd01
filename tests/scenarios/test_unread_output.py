"""A campaign whose output is not read: the run goes on, and the exit code is the experiment's."""

import os
import subprocess
import sys
import time
from pathlib import Path

from controller.recording.reader import open_run

ROOT = Path(__file__).resolve().parents[2]
QUICK = ["--set", "behavior.settle_s=2.0", "--set", "detectors.contact.threshold_sigma=8"]


def run(out, stdout, **extra):
    command = [
        sys.executable,
        "run.py",
        "run",
        "mock/transient",
        "--only",
        "16",
        "--only",
        "17",
        "--no-report",
    ]
    return subprocess.Popen(
        [*command, *QUICK, "--out", str(out)],
        cwd=ROOT,
        stdout=stdout,
        stderr=subprocess.PIPE,
        text=True,
        **extra,
    )


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


def test_a_reader_that_takes_nothing_before_the_run_is_over(tmp_path):
    """The pipe is full from the beginning, and is read when the last row is on the disk."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    try:
        while True:
            os.write(writing, b"\n")
    except BlockingIOError:
        os.set_blocking(writing, True)
    process = run(tmp_path, writing)
    os.close(writing)
    try:
        wait_for_rows(tmp_path, 2)
        output = b""
        while piece := os.read(reading, 65536):
            output += piece
    finally:
        os.close(reading)
    assert b"[2/2] trial" in output
    ended_well(process, tmp_path)


def wait_for_rows(out, count):
    until_s = time.monotonic() + 100.0
    while time.monotonic() < until_s:
        tables = list(out.glob("*/trials.csv"))
        if tables and len(tables[0].read_text().splitlines()) > count:
            return
        time.sleep(0.05)
    raise AssertionError("the run waits for its reader")
