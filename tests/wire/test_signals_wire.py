"""Signals to a run whose stage moves, on an emulated bench that outlives it: the stage stands still first."""

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from config.assemble import start_emulator
from config.profile import load_profile
from controller.recording.reader import open_run
from tests.program import PATIENCE_S, program
from tests.wire.wire_campaign import QUICK

SETTINGS = [option for key, value in QUICK.items() for option in ("--set", f"{key}={value}")]


class Started:
    """A run as a process of its own, at a terminal, on an emulator that lives on."""

    def __init__(self, folder: Path) -> None:
        profile = load_profile("emulated/transient", QUICK)
        self.emulator = start_emulator(profile)
        self.out = folder / "runs"
        (folder / "bench.json").write_text(json.dumps(self.emulator.endpoints))
        (folder / "trials.csv").write_text("location,speed_m_s\nf,0.001\n")  # some seconds on its way
        self.hand, keyboard = os.openpty()
        files = ["--endpoints", folder / "bench.json", "--trials", folder / "trials.csv", "--out", self.out]
        options = ["--no-report", *SETTINGS, *map(str, files)]
        self.process = program(
            *("run", "emulated/transient", *options),
            stdin=keyboard,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            process_group=0,  # it is suspended and continued by no other process
        )
        os.close(keyboard)

    def close(self) -> None:
        """End everything."""
        if self.process.poll() is None:
            self.process.kill()
        self.process.communicate()
        os.close(self.hand)
        self.emulator.close()

    def moves(self) -> bool:
        """Whether the stage moves."""
        return self.emulator.scene()["probe_m_s"] != 0.0

    def suspended(self) -> bool:
        """Whether the process does nothing at all."""
        stat = Path(f"/proc/{self.process.pid}/stat").read_text()
        return stat.rpartition(") ")[2][0] == "T"

    def approaches(self) -> bool:
        """Whether the trial has come as far as its approach."""
        return any(event["next"] == "APPROACH" for event in self.events()) and self.moves()

    def events(self) -> list[Any]:
        """What is in the record by now."""
        files = list(self.out.glob("*/events.jsonl"))
        lines = files[0].read_text().splitlines(keepends=True) if files else []
        return [json.loads(line) for line in lines if line.endswith("\n")]

    def until(self, condition: Callable[[], bool]) -> None:
        """Wait for something that must come."""
        end_s = time.monotonic() + PATIENCE_S
        while not condition():
            if self.process.poll() is not None:
                raise AssertionError(self.process.communicate()[1])
            assert time.monotonic() < end_s, [event["event"] for event in self.events()][-5:]
            time.sleep(0.01)

    def ended(self) -> tuple[int, str]:
        """Exit code and what it complained of."""
        errors = self.process.communicate(timeout=PATIENCE_S)[1]
        return self.process.returncode, errors


@pytest.fixture
def run(tmp_path: Path) -> Iterator[Started]:
    started = Started(tmp_path)
    yield started
    started.close()


def test_ctrl_z_suspends_the_program_once_the_stage_stands_and_it_is_paused_afterwards(run: Started) -> None:
    run.until(run.approaches)
    # What a terminal sends into the background suspends nothing.
    for number in (signal.SIGTTIN, signal.SIGTTOU):
        run.process.send_signal(number)
    run.process.send_signal(signal.SIGTSTP)
    run.until(run.suspended)
    assert not run.moves()
    time.sleep(0.5)  # whatever was still on its way
    assert not run.moves()
    run.process.send_signal(signal.SIGCONT)
    run.until(lambda: not run.suspended())
    time.sleep(0.5)
    assert not run.moves(), "it waits for Enter"
    os.write(run.hand, b"\n")
    assert run.ended() == (0, "")
    names = [event["event"] for event in run.events()]
    paused = names.index("Paused")
    assert "Standstill" in names[paused:]
    assert names.index("Resumed") > names.index("Standstill", paused)
    assert "BaselineReady" in names[names.index("Resumed") :], "a new baseline"
    (folder,) = run.out.iterdir()
    assert [row["outcome"] for row in open_run(folder).trials] == ["contact"]


def test_ctrl_backslash_stops_the_stage_and_then_ends_the_run(run: Started) -> None:
    run.until(run.approaches)
    run.process.send_signal(signal.SIGQUIT)
    assert run.ended() == (130, "interrupted: the bench is still\n")
    assert not run.moves()
    (folder,) = run.out.iterdir()
    recorded = open_run(folder)
    assert recorded.manifest["exit"]["status"] == "aborted"
    assert [row["outcome"] for row in recorded.trials] == ["aborted"]
    assert recorded.events[-1]["event"] == "Standstill"
