"""The run's side of an emulator: starts the process, joins one that runs, begins trials in it."""

import contextlib
import json
import select
import socket
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from drivers.core.errors import PROGRAM, PortError, RefusedError, SilentError

START_TIMEOUT_S = 90.0
"""Longest start: the first one after an installation compiles the plant."""

REPLY_TIMEOUT_S = 30.0
"""Longest answer on the control port: a new plant may have to be fitted to its settings."""

ROOT = Path(__file__).resolve().parents[2]


class EmulatorControl:
    """The control port of a running emulator.

    Raises:
        PortError: nothing answers.
    """

    def __init__(self, endpoints: Mapping[str, Any]) -> None:
        self.endpoints = endpoints
        address = endpoints["control"]
        try:
            self._socket = socket.create_connection(
                (address["host"], address["port"]), timeout=REPLY_TIMEOUT_S
            )
        except OSError as error:
            raise PortError(
                "emulator",
                f"joining {address['host']}:{address['port']}",
                f"nothing answers ({error.strerror or error})",
                f"is `{PROGRAM} emulate` still running?",
            ) from error
        self._lines = self._socket.makefile("rb")
        self._account: Mapping[str, Any] = {}

    def begin_trial(
        self, trial: int, seed: int, factors: Mapping[str, Any], plant: Mapping[str, Any]
    ) -> None:
        """Put the plant into a trial's scene."""
        self._ask({"trial": trial, "seed": seed, "factors": dict(factors), "plant": dict(plant)})

    def inject(self, device: str, kind: str, after_s: float = 0.0, for_s: float | None = None) -> None:
        """Let a fault begin, now or after so many seconds of the bench, and last so long or to the end of the trial."""
        self._ask({"fault": {"device": device, "kind": kind, "at_s": after_s, "for_s": for_s}})

    def mark(self, device: str, what: str) -> None:
        """What a device's faults count from has come now: see `FaultSchedule.mark`."""
        self._ask({"mark": [device, what]})

    def account(self) -> Mapping[str, Any]:
        """What the plant did so far; the last answer where the emulator is gone."""
        with contextlib.suppress(OSError, ValueError):
            self._account = self._ask({})["account"]
        return self._account

    def scene(self) -> Mapping[str, float]:
        """Where things stand on the bench, as seen from outside."""
        scene: Mapping[str, float] = self._ask({})["scene"]
        return scene

    def _ask(self, request: Mapping[str, Any]) -> Mapping[str, Any]:
        self._socket.sendall(json.dumps(request).encode() + b"\n")
        line = self._lines.readline()
        if not line:
            raise SilentError("emulator", "handling a request", "is gone", "start it again")
        answer: Mapping[str, Any] = json.loads(line)
        if "refused" in answer:
            raise RefusedError(
                "emulator", "handling a request", answer["refused"], "see the profile's plant and factors"
            )
        return answer

    def close(self) -> None:
        """Close the connection."""
        self._lines.close()
        self._socket.close()


class EmulatorProcess(EmulatorControl):
    """An emulator in a child process; it ends with this object, and by itself when this program dies.

    Args:
        scene: As `simulator.wiring.emulator.Emulator` takes it.

    Raises:
        SilentError: it does not come up.
        RefusedError: it cannot make this bench.
    """

    def __init__(self, scene: Mapping[str, Any]) -> None:
        # The child reads nothing after the scene: its input stays open for as long as this process lives.
        self._child = subprocess.Popen(
            [sys.executable, "-m", "simulator.wiring.emulator"],
            cwd=ROOT,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            start_new_session=True,
        )
        assert self._child.stdin is not None
        assert self._child.stdout is not None
        self._child.stdin.write(json.dumps(scene).encode() + b"\n")
        self._child.stdin.flush()
        ready, _, _ = select.select([self._child.stdout], [], [], START_TIMEOUT_S)
        line = self._child.stdout.readline() if ready else b""
        if not line:
            self.close()
            raise SilentError(
                "emulator",
                "starting",
                f"did not come up within {START_TIMEOUT_S:g} s" if not ready else "ended at once",
                f"start it by itself to see why: {PROGRAM} emulate PROFILE",
            )
        endpoints = json.loads(line)
        if "refused" in endpoints:
            self.close()
            raise RefusedError(**endpoints["refused"])
        super().__init__(endpoints)

    def close(self) -> None:
        """End the child; never raises."""
        with contextlib.suppress(AttributeError, OSError):
            super().close()
        with contextlib.suppress(OSError):
            if self._child.stdin is not None:
                self._child.stdin.close()
        try:
            self._child.wait(timeout=5.0)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.wait()
        if self._child.stdout is not None:
            self._child.stdout.close()
