"""From a click on the live page to the loop, and the page's cost to the loop, also when the page misbehaves."""

import json
import os
import signal
import socket
import tempfile
from pathlib import Path
from queue import Queue
from threading import Thread
from typing import Any

import numpy as np

from benchmarks.results import save
from config.jobs import Silent
from controller.console import ConsoleOperator
from controller.limits import GuardSettings
from controller.live_view import LiveView
from controller.recording.series import TrialRecording
from controller.watching.feed import Watched
from controller.watching.page import Door, PageProcess
from drivers.core.clock import monotonic_s, rest
from drivers.core.messages import SampleBlock

RATE_HZ = 200.0
"""The loop's, while something moves."""

READY_S = 3.0
"""Time for the page's process to load, s; a run starts it before it opens its bench."""

CLICKS, QUICK_CLICKS = 1000, 50
SECONDS, QUICK_SECONDS = 20.0, 3.0


class Turning(Silent):
    """A loop that turns, records two streams of 1 kHz and polls its operator."""

    def __init__(self, folder: Path, page: PageProcess) -> None:
        self.operator = ConsoleOperator(Path(os.devnull).open())  # noqa: SIM115 - as long as the benchmark
        self._watched = Watched(self, self.operator, page.began)
        self._recording = TrialRecording(1)
        self._limits = GuardSettings(force_n=2.0, travel_m=0.012)
        self._watched.campaign_started("benchmark", 1, folder)
        self._watched.watch(LiveView(self._recording, {}, self._limits, now=lambda: self._t_s))
        self._t_s = 0.0
        self.late_s: list[float] = []
        self.commands: Queue[float] = Queue()
        self.ended = False
        self.thread = Thread(target=self._run)
        self.thread.start()

    def poll(self) -> str | None:
        """The clicks' command."""
        return self.operator.poll()

    def _run(self) -> None:
        begun_s, turn = monotonic_s(), 0
        while not self.ended:
            turn += 1
            rest(max(0.0, begun_s + turn / RATE_HZ - monotonic_s()))
            self._t_s = monotonic_s() - begun_s
            self.late_s.append(self._t_s - turn / RATE_HZ)
            if self._watched.poll() is not None:
                self.commands.put(monotonic_s())
            for stream, unit in (("board.load_cell", "N"), ("stage.position", "m")):
                values = np.full((5, 1), 0.001)
                self._recording.add(SampleBlock(stream, 5 * turn, self._t_s, values, 1000.0, unit=unit))
            turn = max(turn, int(self._t_s * RATE_HZ))
        self._watched.campaign_ended("")


def connected(host: str, token: str) -> socket.socket:
    """Connect to the page's websocket as a browser does (RFC 6455), without a thread that would take Python's lock."""
    name, port = host.split(":")
    wire = socket.create_connection((name, int(port)), 10.0)
    wire.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)  # as browsers do
    asked = {"Host": host, "Origin": f"http://{host}", "Upgrade": "websocket", "Connection": "Upgrade"}
    asked |= {"Sec-WebSocket-Key": "dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version": "13"}
    head = "".join(f"{name}: {value}\r\n" for name, value in asked.items())
    wire.sendall(f"GET /wire?token={token} HTTP/1.1\r\n{head}\r\n".encode())
    assert b"101" in wire.recv(64)
    return wire


def clicks(door: Door, loop: Turning, count: int) -> list[float]:
    """Seconds from the browser's command to the loop turn that receives it."""
    random, found = np.random.default_rng(1), []
    with connected(door.host, door.token) as wire:
        for click in range(count):
            rest(float(random.uniform(0.01, 0.03)))
            command = json.dumps({"do": ("pause", "resume")[click % 2]}).encode()
            sent_s = monotonic_s()
            wire.sendall(bytes([0x81, 0x80 | len(command)]) + bytes(4) + command)  # a text, masked with zeros
            found.append(loop.commands.get(timeout=10.0) - sent_s)
    return found


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    count, seconds = (QUICK_CLICKS, QUICK_SECONDS) if quick else (CLICKS, SECONDS)
    result: dict[str, Any] = {"loop_hz": RATE_HZ, "seconds": seconds}
    with tempfile.TemporaryDirectory() as folder:
        door = Door.open()
        known = Door(door.socket.dup(), door.token)
        page = PageProcess(door)
        loop = Turning(Path(folder), page)

        def lateness(name: str) -> None:
            loop.late_s.clear()
            rest(seconds)
            late_ms = 1e3 * np.array(loop.late_s)
            most = {"p99_ms": float(np.percentile(late_ms, 99)), "max_ms": float(late_ms.max())}
            overruns = int((late_ms > 1e3 / RATE_HZ).sum())
            result[name] = {**most, "overruns": overruns, "turns": len(late_ms)}

        try:
            rest(READY_S)
            lateness("no client")
            ms = 1e3 * np.array(clicks(known, loop, count))
            p50, p99 = np.percentile(ms, [50, 99])
            result["click to loop"] = {"p50_ms": p50, "p99_ms": p99, "max_ms": float(ms.max()), "n": len(ms)}
            deaf = connected(known.host, known.token)
            lateness("a client that does not read")
            os.kill(page.pid, signal.SIGSTOP)
            lateness("page process stopped")
            os.kill(page.pid, signal.SIGKILL)
            lateness("page process killed")
            deaf.close()
        finally:
            loop.ended = True
            loop.thread.join()
            page.close()
    save("live_page", result, quick=quick)
