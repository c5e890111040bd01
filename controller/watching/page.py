"""The live page: a process of its own on loopback, between the browsers and the run that they watch."""

from __future__ import annotations

import asyncio
import hmac
import json
import logging
import re
import secrets
import socket
import subprocess
import sys
from collections.abc import Callable
from contextlib import suppress
from html import unescape
from pathlib import Path
from typing import IO, Any, NamedTuple

from tornado.httpserver import HTTPServer
from tornado.web import Application, RequestHandler
from tornado.websocket import WebSocketClosedError, WebSocketHandler

from controller.live_view import PANELS, label
from controller.recording.run_folder import MANIFEST, RunFolderError
from controller.recording.series import DETECTOR
from controller.watching.feed import SOCKET, at, curve
from drivers.core.clock import monotonic_s

ALIVE_S = 1.0
"""How often the page looks whether its run goes on, and after it whether anyone still looks, s."""

ABSENT_S = 5.0
"""After the run's end it stays so long for one who loads it anew, s (assumption: a reload, a tablet that wakes)."""

PING_S = 20.0
"""How often a browser is asked whether it is still there, s: a tablet that was switched off closes nothing."""

REPORT = "report.html"

SAID = re.compile(r'<meta name="description" content="(.*?)">')
"""Where a report's head has its sentence of verdict."""

POINTS = 1500
"""Points of a signal of a trial that has ended, as in a report."""

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
    """The process that serves the page of a run that begins; the run never waits for it.

    After the run's end it stays until the last browser has closed the page.
    """

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
        """Leave it to those who look; one that never got a run ends."""
        with suppress(OSError):
            assert self._process.stdin is not None
            self._process.stdin.close()
        if self._process.poll() is None:
            self._process.returncode = 0  # nobody waits for it, and it may outlive this program


class _Guarded(RequestHandler):
    """Answers only requests with the link, by the name that is in it: no other site, no other host."""

    def initialize(self, door: Door, place: asyncio.Future[Path | None], looking: set[object]) -> None:
        self.door, self.place, self.looking = door, place, looking

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


class _Report(_Guarded):
    async def get(self) -> None:
        folder = await self.place
        try:
            assert folder is not None
            self.finish((folder / REPORT).read_bytes())
        except (OSError, AssertionError):
            self.set_status(404)
            self.finish("404: the report is not written yet, or the run was told --no-report\n")


class _Trial(_Guarded):
    """The signals of a trial that has ended, read from the recording: the run is not asked."""

    async def get(self) -> None:
        folder = await self.place
        try:
            number = int(self.get_query_argument("number"))
            assert folder is not None
            self.finish(await asyncio.to_thread(trial_signals, folder, number))
        except (ValueError, KeyError, RunFolderError) as error:
            self.set_status(404)
            self.finish(f"404: {error}\n")


class _Wire(_Guarded, WebSocketHandler):
    """A browser's line to the run: what comes from one side goes to the other, as fast as the slower takes it.

    It stays open after the run's end, and says how that was and whether there is a report.
    """

    writer: asyncio.StreamWriter | None = None

    def check_origin(self, origin: str) -> bool:
        """Looked at already."""
        return True

    async def open(self, *_: str, **__: str) -> None:
        self.set_nodelay(True)
        self.looking.add(self)
        folder = await self.place
        if folder is None:
            return
        reader = None
        with suppress(OSError), at(folder / SOCKET) as name:
            reader, self.writer = await asyncio.open_unix_connection(name, limit=LINE_BYTES)
        asyncio.create_task(self._relay(folder, reader))  # noqa: RUF006 - ends with either side

    async def _relay(self, folder: Path, reader: asyncio.StreamReader | None) -> None:
        with suppress(WebSocketClosedError):
            try:
                while reader is not None and (line := await reader.readline()):
                    await self.write_message(line.decode())
            except OSError:
                pass
            finally:
                if self.writer is not None:
                    self.writer.close()
            while not await asyncio.to_thread(alive, folder):  # else it is one too many
                await self.write_message({"after": after(folder)})
                await asyncio.sleep(ALIVE_S)
        self.close()

    def on_message(self, message: str | bytes) -> None:
        if self.writer is not None and isinstance(message, str):
            self.writer.write(message.replace("\n", " ").encode() + b"\n")

    def on_close(self) -> None:
        self.looking.discard(self)
        if self.writer is not None:
            self.writer.close()


def html() -> str:
    """The page: one file, which sends requests to this process alone."""
    from controller.reports.section import environment

    return environment().get_template("watch.html.j2").render()


def after(folder: Path) -> dict[str, Any]:
    """How a run that has ended ended, as its manifest says, whether its report is there, and what that begins with."""
    ended: dict[str, Any] = {}
    report = folder / REPORT
    with suppress(OSError, ValueError):
        ended = json.loads((folder / MANIFEST).read_text("utf-8"))["exit"]
        with report.open(encoding="utf-8") as file:
            said = SAID.search(file.read(2000))
        ended["said"] = unescape(said[1]) if said else ""
    return {**ended, "folder": str(folder), "report": report.is_file()}


def trial_signals(folder: Path, number: int) -> dict[str, Any]:
    """The signals of a trial from its recording, as a run publishes them: detectors' statistics first.

    Raises:
        KeyError: nothing was recorded of it.
        RunFolderError: it is damaged.
    """
    from controller.recording.reader import open_run

    recording = open_run(folder).trial(number)
    names = sorted(recording.streams, key=lambda name: not name.startswith(DETECTOR))[:PANELS]
    signals = {}
    for name in names:
        series = recording.stream(name)
        if len(series):
            found = curve(name, series.times_s, series.values, series.unit, POINTS)
            signals[name] = found | {"label": label(name, found["unit"])}
    return {"trial": number, "signals": signals}


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


def serve(find: Callable[[], Path | None], door: Door, ready: Callable[[], Any] = lambda: None) -> None:
    """Serve the page until the run has ended and nobody looks any more.

    Args:
        find: Waits for the run's folder; None where no run began. The page can be loaded before.
    """
    logging.getLogger("tornado").setLevel(logging.CRITICAL)

    async def run() -> None:
        finding = asyncio.ensure_future(asyncio.to_thread(find))
        looking = set[object]()
        known = {"door": door, "place": finding, "looking": looking}
        places = {"/": _Page, "/wire": _Wire, "/report": _Report, "/trial": _Trial}
        handlers = [(place, handler, known) for place, handler in places.items()]
        server = HTTPServer(Application(handlers, websocket_ping_interval=PING_S))
        door.socket.setblocking(False)
        server.add_sockets([door.socket])
        ready()
        folder = await finding
        looked_s = monotonic_s()
        while folder is not None and monotonic_s() - looked_s < ABSENT_S:
            if bool(looking) or await asyncio.to_thread(alive, folder):
                looked_s = monotonic_s()
            await asyncio.sleep(ALIVE_S)
        server.stop()
        await server.close_all_connections()

    asyncio.run(run())


def _begun() -> Path | None:
    """The folder of the run that began this process, once it has one."""
    line = sys.stdin.readline().strip()
    return Path(line) if line else None


if __name__ == "__main__":
    secret = sys.stdin.readline().strip()
    serve(_begun, Door(socket.socket(fileno=int(sys.argv[1])), secret))
