"""The dashboard server: a line in, a line out.

Source of commands and answers: Universal Robots, "Dashboard Server e-Series, port 29999".
"""

from __future__ import annotations

from collections.abc import Callable

from simulator.devices.ur_controller.controller import Runtime, Safety, UrController
from simulator.devices.ur_controller.rtde import PackageError

GREETING = b"Connected: Universal Robots Dashboard Server\n"

LINE_BYTES = 1024
"""Longest line that it reads (assumption: a command and a path)."""

TOO_EARLY = "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop"


def _stop(controller: UrController) -> str:
    controller.stop_program("dashboard")
    return "Stopped"


def _unlock(controller: UrController) -> str:
    free = controller.safety is Safety.NORMAL or controller.unlock()
    return "Protective stop releasing" if free else TOO_EARLY


def _playing(controller: UrController) -> bool:
    return controller.runtime is Runtime.PLAYING


_ANSWERS: dict[str, Callable[[UrController], str]] = {
    "polyscopeversion": lambda c: f"URSoftware {c.settings.version} (Sep 30 2021)",
    "get serial number": lambda c: c.settings.serial,
    "get robot model": lambda c: "UR5",
    "is in remote control": lambda c: str(c.remote).lower(),
    "robotmode": lambda c: "Robotmode: RUNNING",
    "safetystatus": lambda c: f"Safetystatus: {c.safety.name}",
    "running": lambda c: f"Program running: {str(_playing(c)).lower()}",
    "programstate": lambda c: f"{'PLAYING' if _playing(c) else 'STOPPED'} <unnamed>",
    "stop": _stop,
    "unlock protective stop": _unlock,
    "close safety popup": lambda c: "closing safety popup",
    "close popup": lambda c: "closing popup",
    "play": lambda c: "Failed to execute: play",
    "pause": lambda c: "Failed to execute: pause",
    "quit": lambda c: "Disconnected",
}


class DashboardSession:
    """One client's connection to the dashboard."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._buffer = b""

    def feed(self, data: bytes) -> bytes:
        """Take bytes, answer each whole line with a line.

        Raises:
            PackageError: longer than a line may be.
        """
        *lines, rest = (self._buffer + data).split(b"\n")
        if max(map(len, [*lines, rest])) > LINE_BYTES:
            raise PackageError(f"a line of more than {LINE_BYTES} bytes")
        self._buffer = rest
        return b"".join(
            self._answer(line.decode("utf-8", "replace").strip()).encode() + b"\n" for line in lines
        )

    def close(self) -> None:
        """Nothing to give back."""

    def _answer(self, line: str) -> str:
        answer = _ANSWERS.get(line.lower())
        return f'could not understand: "{line}"' if answer is None else answer(self._controller)
