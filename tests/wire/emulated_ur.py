"""An emulated UR controller in a process of its own, on a loopback address and a clock of its own."""

import itertools
import json
import os
import select
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from simulator.wiring.bench_clock import BenchClock, ClockPage

ROOT = Path(__file__).resolve().parents[2]

START_S = 100.0
"""Longest start on a busy machine."""

_numbers = itertools.count(1)


def free_host() -> str:
    """An address of 127/8 that no other test process uses: its three ports are fixed."""
    pid = os.getpid()
    return f"127.{1 + (pid >> 8) % 200}.{pid % 256}.{next(_numbers) % 250 + 1}"


class EmulatedUr:
    """Starts the controller, gives it orders, ends it.

    Its clock stands still while the machine holds up the controller or a client of the clock.

    Args:
        plane_m: Height of a stiff plane above the base.
        settings: Of the controller.
    """

    def __init__(self, plane_m: float | None = None, **settings: Any) -> None:
        self.host = free_host()
        quiet = {"force_noise_n": 0.0, "torque_noise_n_m": 0.0, "unlock_s": 0.2}
        given = json.dumps({**quiet, **settings, "host": self.host})
        command = [sys.executable, "-m", "tests.wire.ur_controller_process", "--settings", given]
        if plane_m is not None:
            command += ["--plane-m", str(plane_m)]
        self.process = subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        endpoints = json.loads(self._line())
        assert endpoints["arm"]["host"] == self.host
        self.page = ClockPage(endpoints["clock"])
        self.clock = BenchClock(self.page)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.kill()

    def order(self, **orders: Any) -> dict[str, Any]:
        """Give an order; the controller's state afterwards."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps(orders).encode() + b"\n")
        self.process.stdin.flush()
        state: dict[str, Any] = json.loads(self._line())
        return state

    def until(self, found: Callable[[dict[str, Any]], bool], timeout_s: float = 5.0) -> dict[str, Any]:
        """The state once it is as wanted."""
        end_s = self.clock.monotonic_s() + timeout_s
        while self.clock.monotonic_s() < end_s:
            state = self.order()
            if found(state):
                return state
            self.clock.rest(0.01)
        raise AssertionError(f"the controller never came to it: {self.order()}")

    def kill(self) -> None:
        """End the controller at once, as a power cut does."""
        self.process.kill()
        self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()

    def _line(self) -> bytes:
        assert self.process.stdout is not None
        ready, _, _ = select.select([self.process.stdout], [], [], START_S)
        line = self.process.stdout.readline() if ready else b""
        assert line, "the emulated controller does not answer"
        return line


def resting(state: dict[str, Any]) -> bool:
    """Whether the arm stands."""
    return not any(state["twist"])
