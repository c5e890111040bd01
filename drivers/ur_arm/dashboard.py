"""The controller's dashboard: a line out, a line in, each with a deadline."""

import re
import socket

from drivers.arm.link import LinkError
from drivers.core.errors import PortError, ProtocolError, SilentError

PORT = 29999
"""Port of the dashboard server (manual)."""

REPLY_S = 2.0
"""Longest wait for a line; the client waits 2.5 s (its source)."""

_VERSION = re.compile(r"\d+\.\d+\.\d+(\.\d+)?")


class Dashboard:
    """A connection to the dashboard of our own: it works while the client is blocked.

    Raises:
        LinkError: nothing listens there, or what answers is no dashboard.
    """

    def __init__(self, host: str) -> None:
        self._host = host
        try:
            self._socket = socket.create_connection((host, PORT), REPLY_S)
        except OSError as error:
            raise LinkError(
                PortError,
                f"nothing answers at {host}:{PORT} ({error.strerror or error})",
                "is the controller on, and is the address right?",
            ) from error
        self._lines = self._socket.makefile("r", encoding="utf-8", newline="\n")
        greeting = self._line()
        if "Universal Robots" not in greeting:
            raise LinkError(
                ProtocolError,
                f"{host}:{PORT} greets with {greeting!r}",
                "is this a Universal Robots controller?",
            )

    def ask(self, line: str) -> str:
        """Send a line; the line that comes back.

        Raises:
            LinkError: nothing comes back.
        """
        try:
            self._socket.sendall(line.encode() + b"\n")
        except OSError as error:
            raise self._silent(error) from error
        return self._line()

    def version(self) -> str:
        """PolyScope's version, or "" where the answer has none."""
        found = _VERSION.search(self.ask("PolyscopeVersion"))
        return found[0] if found else ""

    def _line(self) -> str:
        try:
            line = self._lines.readline()
        except (OSError, ValueError) as error:
            raise self._silent(error) from error
        if not line:
            raise self._silent(None)
        return line.strip()

    def _silent(self, error: Exception | None) -> LinkError:
        why = f" ({error})" if error is not None else ""
        return LinkError(
            SilentError,
            f"the dashboard at {self._host}:{PORT} does not answer{why}",
            "is the controller up, and nothing between it and us?",
        )
