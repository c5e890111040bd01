"""The emulator's control port: a line of JSON a request, checked before anything is done, and a line each answer.

An invalid request is answered with the reason; a client that breaks the connection is dropped. The others are served.
"""

from __future__ import annotations

import json
import socket
import sys
import traceback
from collections.abc import Callable, Collection, Mapping
from typing import Any, Self

from pydantic import Field, ValidationError, model_validator

from drivers.core.settings import Settings
from simulator.devices.faults import Fault
from simulator.devices.tcp_clients import TcpClients

LINE_BYTES = 1 << 20
"""Longest request (assumption: a hundred times the longest profile)."""

CLIENTS = 16
"""Connections at a time (assumption: a run has one, and `select` bears a thousand)."""

Answer = Mapping[str, Any]


class Request(Settings):
    """What a client can request; an empty one requests the account alone."""

    trial: int | None = Field(default=None, ge=0)
    """Number of the trial that begins; `seed`, `factors` and `plant` come with it."""
    seed: int | None = Field(default=None, ge=0)
    """Seed of the run."""
    factors: dict[str, Any] | None = None
    """Of the trial."""
    plant: dict[str, Any] | None = None
    """The profile's plant section for this trial."""
    fault: Fault | None = None
    """What breaks from now on."""
    account: bool = True
    """What the plant did: every answer has it."""

    @model_validator(mode="after")
    def _whole(self) -> Self:
        parts = {"trial": self.trial, "seed": self.seed, "factors": self.factors, "plant": self.plant}
        missing = [name for name, part in parts.items() if part is None]
        if missing and len(missing) < len(parts):
            raise ValueError(f"a trial needs {', '.join(missing)} as well")
        return self


class ControlPort:
    """A port on loopback. A client that does not read its answers is dropped.

    Args:
        answer: Handles a request, returns the answer. What it raises is sent to the client.

    Attributes:
        close: Drops all clients and closes the port.
    """

    def __init__(self, answer: Callable[[Request], Answer]) -> None:
        self._answer = answer
        self._pending: dict[socket.socket, bytearray] = {}
        self._clients = TcpClients(CLIENTS, 0, lambda client, reason: self._pending.pop(client))
        self._listener = self._clients.listen()
        host, port = self._listener.getsockname()
        self.endpoint: dict[str, Any] = {"host": host, "port": port}
        self.close = self._clients.close

    @property
    def sockets(self) -> list[socket.socket]:
        """What to select on."""
        return self._clients.sockets

    def attend(self, readable: Collection[Any]) -> None:
        """Answer what has come.

        Args:
            readable: What of `sockets` can be read.
        """
        if self._listener in readable and (client := self._clients.accept(self._listener)) is not None:
            self._pending[client] = bytearray()
        for client in [client for client in self._pending if client in readable]:
            self._receive(client)

    def _receive(self, client: socket.socket) -> None:
        pending = self._pending[client]
        *requests, rest = self._clients.receive(client).split(b"\n")
        for request in requests:
            self._send(client, self._answered(bytes(pending + request)))
            pending.clear()
        pending += rest
        if len(pending) > LINE_BYTES:
            self._send(client, {"refused": f"a request has at most {LINE_BYTES} bytes"})
            self._clients.drop(client)

    def _answered(self, line: bytes) -> Answer:
        try:
            return self._answer(Request.model_validate_json(line))
        except ValidationError as error:
            first = error.errors(include_url=False)[0]
            where = ".".join(str(part) for part in first["loc"])
            return {"refused": f"{where}: {first['msg']}" if where else first["msg"]}
        except ValueError as error:
            return {"refused": str(error)}
        except Exception as error:  # a defect, and this client's alone: the bench goes on
            traceback.print_exc(file=sys.stderr)
            return {"refused": f"{type(error).__name__}: {error}"}

    def _send(self, client: socket.socket, answer: Answer) -> None:
        self._clients.send(client, json.dumps(answer).encode() + b"\n")
