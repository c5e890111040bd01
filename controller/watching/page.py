"""The live page: a process of its own on loopback, between the browsers and the run that they watch."""

from __future__ import annotations

import asyncio
import hmac
import logging
import secrets
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import IO, Any, NamedTuple

from tornado.httpserver import HTTPServer
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from controller.watching.feed import SOCKET, at

ALIVE_S = 1.0
"""How often the page looks whether its run goes on, s."""

LINE_BYTES = 1 << 24
"""Longest line of a run: far more than a late client gets."""


class Door(NamedTuple):
    """Where the page is: a socket that listens on loopback, and the secret that its link bears."""

    socket: socket.socket
    token: str

    @classmethod
    def open(cls) -> Door:
        """On a port that is free."""
        return cls(socket.create_server(("127.0.0.1", 0)), secrets.token_urlsafe(24))

    @property
    def host(self) -> str:
        """As a browser calls it."""
        return f"127.0.0.1:{self.socket.getsockname()[1]}"

    @property
    def link(self) -> str:
        """What the person opens; anyone who has it can stop the run."""
        return f"http://{self.host}/?token={self.token}"


class PageProcess:
    """The process that serves the page of a run that begins; it ends with the run, and the run never waits for it."""

    def __init__(self, door: Door) -> None:
        self._process = subprocess.Popen(
            [sys.executable, "-m", "controller.watching.page", str(door.socket.fileno())],
            cwd=Path(__file__).resolve().parents[2],
            stdin=subprocess.PIPE,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            pass_fds=[door.socket.fileno()],
            start_new_session=True,  # Ctrl+C at the terminal is the run's alone
        )
        self._write(door.token)  # not among the arguments, which everyone on the machine may read
        door.socket.close()

    @property
    def pid(self) -> int:
        """Of the process."""
        return self._process.pid

    def began(self, folder: Path) -> None:
        """The run's socket is there."""
        self._write(str(folder.resolve()))

    def _write(self, line: str) -> None:
        stream: IO[bytes] | None = self._process.stdin
        with suppress(OSError):  # it may have died
            assert stream is not None
            stream.write(line.encode() + b"\n")
            stream.flush()

    def close(self) -> None:
        """Let it end, unless it does so by itself."""
        with suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        try:
            self._process.wait(2 * ALIVE_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()


class _Guarded(RequestHandler):
    """Answers only requests with the link, by the name that is in it: no other site, no other host."""

    def initialize(self, door: Door, folder: Path) -> None:
        self.door, self.folder = door, folder

    def prepare(self) -> None:
        given = self.get_query_argument("token", "")
        known = hmac.compare_digest(given.encode(), self.door.token.encode())
        origin = self.request.headers.get("Origin")
        own = origin == f"http://{self.door.host}"
        fits = own if isinstance(self, WebSocketHandler) else origin is None or own
        if not (known and fits and self.request.host == self.door.host):
            self.set_status(403)
            self.finish("403: open the link that the run printed\n")

    def data_received(self, chunk: bytes) -> None:
        """Nothing is taken but commands."""


class _Page(_Guarded):
    def get(self) -> None:
        self.set_header("Cache-Control", "no-store")
        self.set_header("Referrer-Policy", "no-referrer")
        self.set_header("X-Frame-Options", "DENY")
        self.finish(html())


class _Wire(_Guarded, WebSocketHandler):
    """A browser's line to the run: what comes from one side goes to the other, as fast as the slower takes it."""

    writer: asyncio.StreamWriter | None = None

    def check_origin(self, origin: str) -> bool:
        """Looked at already."""
        return True

    async def open(self, *_: str, **__: str) -> None:
        self.set_nodelay(True)
        try:
            with at(self.folder / SOCKET) as name:
                reader, self.writer = await asyncio.open_unix_connection(name, limit=LINE_BYTES)
        except OSError:
            self.close(reason="the run has ended")
            return
        asyncio.create_task(self._relay(reader))  # noqa: RUF006 - ends with either side

    async def _relay(self, reader: asyncio.StreamReader) -> None:
        with suppress(WebSocketClosedError, OSError):
            while line := await reader.readline():
                await self.write_message(line.decode())
        self.close()

    def on_message(self, message: str | bytes) -> None:
        if self.writer is not None and isinstance(message, str):
            self.writer.write(message.replace("\n", " ").encode() + b"\n")

    def on_close(self) -> None:
        if self.writer is not None:
            self.writer.close()


def html() -> str:
    """The page: one file, which sends requests to this process alone."""
    from controller.reports.section import environment, library

    return environment().get_template("watch.html.j2").render(library=library())


def alive(folder: Path) -> bool:
    """Whether a run goes on there."""
    try:
        with socket.socket(socket.AF_UNIX) as asked, at(folder / SOCKET) as name:
            asked.setblocking(False)
            asked.connect(name)
    except BlockingIOError:  # more wait at its door than it lets in at once
        return True
    except OSError:
        return False
    return True


def serve(folder: Path, door: Door, ready: Callable[[], Any] = lambda: None) -> None:
    """Serve the page until the run has ended."""
    logging.getLogger("tornado").setLevel(logging.CRITICAL)

    async def run() -> None:
        known = {"door": door, "folder": folder}
        server = HTTPServer(Application([("/", _Page, known), ("/wire", _Wire, known)]))
        door.socket.setblocking(False)
        server.add_sockets([door.socket])
        ready()
        while await asyncio.to_thread(alive, folder):
            await asyncio.sleep(ALIVE_S)
        server.stop()
        await server.close_all_connections()

    asyncio.run(run())


if __name__ == "__main__":
    secret, place = sys.stdin.readline().strip(), sys.stdin.readline().strip()
    if place:
        serve(Path(place), Door(socket.socket(fileno=int(sys.argv[1])), secret))
