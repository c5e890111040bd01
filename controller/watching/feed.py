"""A run that others may watch: it publishes its state and receives their commands, on a thread of its own."""

import asyncio
import json
import math
import os
import socket
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np

from controller.console import PAUSED, Console, ConsoleOperator
from controller.live_view import LiveView, label
from controller.outcomes import is_success
from controller.recording.series import DETECTOR, extremes
from controller.scales import displayed, scale_of
from controller.watching.between import Between
from drivers.core.clock import rest
from drivers.core.messages import Floats

SOCKET = "watch.sock"
"""In the run folder, as long as the run goes on: a user who may write there may watch."""

PUBLISH_S = 0.2
"""How often it publishes, s: it takes a core about 1 ms each time, for every client."""

GIVE_WAY_S = 5e-4
"""How long it leaves Python's lock to the loop before each signal, s: only a sleep does; else the loop waits 5 ms."""

BLOCKS = 100
"""After so many blocks it gives way as well: a minute of a board for a late client has 6,000; 100 take 1 ms."""

CLIENTS = 4
"""How many may watch at once (assumption: a bench and a desk, twice)."""

LATE_S = 60.0
"""How much of the trial a late client gets, s of bench time."""

POINTS_HZ = 25.0
"""Points of one signal that are published, a second of bench time: as many as a screen shows of a minute."""

EVENTS = 200
"""Events that a late client gets."""

SILENCE, SHORTEST_GAP_S = 5.0, 0.02
"""A step in time so many times the usual one, and at least so long, s, is a gap (assumption)."""

COMMAND_BYTES = 4096
"""Longest line that is received (assumption: ten times any there is)."""

REFUSAL_CHARACTERS = 200
"""Longest reason for a refusal that goes back to its client."""

COMMANDS = ("pause", "resume", "stop")
"""What a client may press."""

BY_HAND = ("hold", "home", "tare")
"""What is done between two trials."""


@dataclass
class _Client:
    """What a client has been sent so far."""

    trial: LiveView | None = None
    greeted: bool = False
    rows: int = 0
    events: int = 0
    blocks: dict[str, int] = field(default_factory=dict)


class Watched:
    """A campaign's console, published to those who watch.

    Nothing here waits. The loop's thread notes what is new in the console; the publishing thread makes messages of it
    and of what was recorded. A client that does not read gets nothing more: no message is made before the last one is
    out.

    Args:
        began: Called with the run's folder once it can be watched.
    """

    def __init__(
        self,
        console: Console,
        operator: ConsoleOperator,
        began: Callable[[Path], object] | None = None,
    ) -> None:
        self._console, self._operator, self._began = console, operator, began
        self._feed: _Feed | None = None
        self.between = Between(operator, console.poll, console.state)
        console.feed = self

    def begin(self, folder: Path) -> None:
        """From now on the run can be watched."""
        with suppress(OSError):  # a file system without sockets; the run is none the worse for it
            self._feed = _Feed(folder / SOCKET, self)
        if self._began is not None:
            self._began(folder)

    def end(self) -> None:
        """Publishes the end to all clients, and nothing more."""
        feed, self._feed = self._feed, None
        if feed is not None:
            feed.end()

    # on the publishing thread

    def receive(self, line: bytes) -> str:
        """A client's command: `{"do": "stop"}`, `pause`, `resume`, `hold` before the next trial, no longer with
        `"on": false`, there `home` and `tare` with a `target`, or `answer` with `number` and `done`.

        Returns:
            Why it was refused; "" where it was not.
        """
        try:
            message = json.loads(line)
            if message["do"] == "answer":
                self._operator.reply(int(message["number"]), bool(message["done"]))
            elif message["do"] in COMMANDS:
                self._operator.press(message["do"], "a click on the live page")
            elif message["do"] in BY_HAND:
                target, on = str(message.get("target", "")), bool(message.get("on", True))
                return self.between.ask(message["do"], target, on)
            else:
                return f"do must be answer, {', '.join((*COMMANDS, *BY_HAND))}"
        except Exception as error:  # whatever a line holds, an endless number too: the next may be a stop
            return f"no command: {type(error).__name__}: {error}"[:REFUSAL_CHARACTERS]
        return ""

    def news(self, client: _Client) -> bytes:
        """What is new since a client's last message, as a line."""
        console, question = self._console, self._operator.question
        trial, _, state, since_s = console.present
        stopped, counts = self._operator.stopped, dict(console.counts)
        news: dict[str, Any] = {
            "trial": trial,
            "factors": ", ".join(console.said),
            "state": state,
            "since_s": since_s,
            "ended": console.ended,
            "by": f"stopped by {self._operator.pressed_by}" if stopped else "",
            "stopped": stopped,
            "paused": state == PAUSED,
            "between": self.between.news(),
            "pressed_by": self._operator.pressed_by,
            "counts": [[name, n, is_success(name, console.successes)] for name, n in counts.items()],
            "left_s": console.left_s,
            "question": question and {"number": question.number, "text": question.text},
        }
        if not client.greeted:
            client.greeted = True
            news["run"] = {"title": console.title, "trials": console.count, "folder": console.folder.name}
        total, rows = sum(counts.values()), [*console.rows]
        news["rows"] = [self._row(*row) for row in rows[max(0, len(rows) - total + client.rows) :]]
        client.rows = total
        view = console.view
        if view is not None:
            if client.trial is not view:
                client.trial, client.events, client.blocks = view, 0, {}
                news["diagram"] = view.diagram()
            news["t_s"] = view.now()
            news["margins"] = list(view.margins())
            news["thresholds"] = list(view.thresholds())
            news["resumes_in"] = view.after_resume() if news["paused"] else ""
            news["detected"] = view.detected() if news["paused"] else ""
            news["streams"] = view.ages()
            events = view.events(client.events)
            client.events += len(events)
            news["events"] = events[-EVENTS:]
            news["signals"] = {stream: self._signal(view, stream, client) for stream in view.panels()}
        return json.dumps(news, default=str, separators=(",", ":")).encode() + b"\n"

    def _row(
        self, trial: int, factors: Mapping[str, Any], outcome: str, row: Mapping[str, Any]
    ) -> Sequence[Any]:
        """A trial that has ended: number, outcome, cells by heading, and whether that is success."""
        values = {scale_of(name): value for name, value in {**factors, **row}.items()}
        cells = {scale.heading: scale.cell(value) for scale, value in values.items()}
        return trial, outcome, cells, is_success(outcome, self._console.successes)

    @staticmethod
    def _signal(view: LiveView, stream: str, client: _Client) -> dict[str, Any]:
        """What is new of a stream: of each stretch its least and largest value, and the last threshold."""
        rest(GIVE_WAY_S)
        seen = client.blocks.get(stream, 0)
        blocks = view.recording.blocks(stream, seen)
        since_s = -math.inf if stream in client.blocks else view.now() - LATE_S
        client.blocks[stream] = seen + len(blocks)
        fresh = [block for block in blocks if len(block) and block.last_s >= since_s]
        if not fresh:
            return {"t": [], "y": []}
        times, parts = [], []
        for number, block in enumerate(fresh):
            if number % BLOCKS == BLOCKS - 1:
                rest(GIVE_WAY_S)
            times.append(block.times)
            values = block.physical
            parts.append(values if stream.startswith(DETECTOR) else values[:, [view.channel(stream)]])
        times_s, values = np.concatenate(times), np.concatenate(parts)
        span_s = min(LATE_S, float(times_s[-1] - times_s[0]))
        news = curve(stream, times_s, values, fresh[0].unit, max(4, round(POINTS_HZ * span_s)))
        return news | {"label": label(stream, news["unit"]), "title": view.title(stream)}


def curve(stream: str, times_s: Floats, values: Floats, unit: str, points: int) -> dict[str, Any]:
    """A signal's first channel to be drawn: of each stretch its least and largest value, and the last threshold; None
    where samples are missing or nothing subscribed, so that nothing is drawn there."""
    shown, unit = displayed(stream, values, unit)
    shown, thresholds = shown[:, 0], shown[:, 1:]
    steps_s = np.diff(times_s)
    usual_s = max(float(np.median(steps_s)) if len(steps_s) else 0.0, SHORTEST_GAP_S / SILENCE)
    breaks = np.flatnonzero(steps_s > SILENCE * usual_s)
    keep = np.union1d(extremes(shown, points), np.concatenate([breaks, breaks + 1]))
    keep = keep[np.isfinite(shown[keep])]
    places = np.searchsorted(keep, breaks, side="right")
    drawn: list[float | None] = shown[keep].tolist()
    at_s = times_s[keep].round(4).tolist()
    for place in places[::-1]:
        at_s.insert(place, at_s[min(place, len(at_s) - 1)])
        drawn.insert(place, None)
    news: dict[str, Any] = {"t": at_s, "y": drawn, "unit": unit, "gap_s": SILENCE * usual_s}
    if stream.startswith(DETECTOR) and np.isfinite(thresholds[-1, 0]):
        news["threshold"] = float(thresholds[-1, 0])
    return news


class _Feed:
    """The socket of a run, and the thread that serves it.

    Raises:
        OSError: there can be no socket.
    """

    def __init__(self, path: Path, watched: Watched) -> None:
        self._path = path
        self._watched = watched
        self._loop = asyncio.new_event_loop()
        self._ending: asyncio.Future[None] = self._loop.create_future()
        self._clients: set[asyncio.Task[Any]] = set()
        door = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        path.unlink(missing_ok=True)  # of a run that was killed; this one holds the folder
        os.fchmod(door.fileno(), 0o600)  # before there is a name: no other user ever gets in
        with at(path) as name:
            door.bind(name)
        door.listen(CLIENTS)
        self._thread = Thread(target=self._run, args=(door,), name="feed", daemon=True)
        self._thread.start()

    def end(self) -> None:
        """Publish for the last time; a client that takes nothing is not waited for."""
        with suppress(RuntimeError):  # the thread has ended before
            self._loop.call_soon_threadsafe(self._ending.set_result, None)
        self._thread.join(2 * PUBLISH_S)

    def _run(self, door: socket.socket) -> None:
        with closing(self._loop):
            self._loop.run_until_complete(self._serve(door))

    async def _serve(self, door: socket.socket) -> None:
        door.setblocking(False)
        self._loop.add_reader(door, self._let_in, door)
        await self._ending
        self._loop.remove_reader(door)
        door.close()
        self._path.unlink(missing_ok=True)
        while others := asyncio.all_tasks() - {asyncio.current_task()}:
            _, deaf = await asyncio.wait(others, timeout=PUBLISH_S)
            for client in deaf:
                client.cancel()

    def _let_in(self, door: socket.socket) -> None:
        """Take a client. The library's own server loses one that comes in the turn in which it is closed."""
        try:
            peer, _ = door.accept()
        except OSError:  # it has left
            return
        if len(self._clients) >= CLIENTS:
            peer.close()
            return
        task = self._loop.create_task(self._attend(peer))
        self._clients.add(task)
        task.add_done_callback(self._clients.discard)

    async def _attend(self, peer: socket.socket) -> None:
        """Serve a client until it leaves, cannot be shown something, or the run ends."""
        reader, writer = await asyncio.open_connection(sock=peer, limit=COMMAND_BYTES)
        writer.transport.set_write_buffer_limits(0)  # nothing more is made before the last message is out
        listening = asyncio.create_task(self._listen(reader, writer))
        try:
            await self._publish(listening, writer)
        except (Exception, asyncio.CancelledError):
            return  # it left, or is deaf; or a detector of the user's own: it ends neither run nor thread
        finally:
            listening.cancel()
            writer.transport.abort()  # what is to arrive has left; a deaf client's rest would keep the socket open

    async def _publish(self, listening: asyncio.Task[None], writer: asyncio.StreamWriter) -> None:
        client = _Client()
        ended = False
        while not ended:
            # The first message comes late as well: who has just come may only have looked whether a run is there.
            first = asyncio.FIRST_COMPLETED
            await asyncio.wait({listening, self._ending}, timeout=PUBLISH_S, return_when=first)
            if listening.done():
                return
            ended = self._ending.done()
            writer.write(self._watched.news(client))
            await writer.drain()

    async def _listen(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        with suppress(ValueError, OSError):  # a line that is too long
            while line := await reader.readline():
                refusal = self._watched.receive(line)
                # a client that does not read gets no more of them
                if refusal and writer.transport.get_write_buffer_size() < COMMAND_BYTES:
                    writer.write(json.dumps({"refused": refusal}).encode() + b"\n")


@contextmanager
def at(path: Path) -> Iterator[str]:
    """A socket's name, however long its folder's: sockets know 107 characters (unix(7))."""
    folder = os.open(path.parent, os.O_PATH | os.O_DIRECTORY)
    try:
        yield f"/proc/self/fd/{folder}/{path.name}"
    finally:
        os.close(folder)
