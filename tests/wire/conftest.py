"""Emulated devices behind real ptys, for tests that run on the wall clock."""

from __future__ import annotations

import json
import os
import select
import threading
import time
import tty
from collections.abc import Generator, Iterator
from contextlib import suppress
from typing import Any, Protocol

import pytest

from controller.campaign import Campaign, Outcome

TURN_S = 0.001
"""Pause between two calls of `step`."""

LIFE_S = 60.0
"""A server stops by itself after this long, whatever its test does."""


class EmulatedDevice(Protocol):
    def receive(self, data: bytes, t_s: float) -> bytes: ...

    def step(self, t_s: float) -> bytes: ...


class PtyServer:
    """One thread that carries bytes between a pty and an emulated device, on the monotonic clock."""

    def __init__(self, device: EmulatedDevice) -> None:
        self.device = device
        self.lock = threading.Lock()
        self.error: BaseException | None = None
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.port = os.ttyname(self._slave)
        self._running = True
        self._thread = threading.Thread(target=self._serve, name=f"pty {self.port}", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """Hang up, as a pulled plug does. May be called twice."""
        if self._running:
            self._running = False
            self._thread.join(5.0)
            os.close(self._master)
            os.close(self._slave)

    def _serve(self) -> None:
        until_s = time.monotonic() + LIFE_S
        try:
            while self._running and time.monotonic() < until_s:
                ready, _, _ = select.select([self._master], [], [], TURN_S)
                data = os.read(self._master, 4096) if ready else b""
                with self.lock:
                    now_s = time.monotonic()
                    answer = self.device.receive(data, now_s) if data else b""
                    answer += self.device.step(now_s)
                with suppress(BlockingIOError):  # nobody reads: bytes are lost, as on a real line
                    while answer:
                        answer = answer[os.write(self._master, answer) :]
        except BaseException as error:
            self.error = error


class Serve:
    """`serve(device)` answers on a new pty and gives its path; `serve.unplug(path)` hangs up."""

    def __init__(self) -> None:
        self._servers: dict[str, PtyServer] = {}

    def __call__(self, device: EmulatedDevice) -> str:
        server = PtyServer(device)
        self._servers[server.port] = server
        return server.port

    def lock(self, port: str) -> threading.Lock:
        """Held while the device is spoken to: take it before touching the device from a test."""
        return self._servers[port].lock

    def unplug(self, port: str) -> None:
        """Hang up."""
        self._servers[port].stop()

    def close(self) -> None:
        """Hang up everywhere; a device that raised fails its test."""
        for server in self._servers.values():
            server.stop()
        for server in self._servers.values():
            if server.error is not None:
                raise server.error


@pytest.fixture
def serve() -> Iterator[Serve]:
    served = Serve()
    yield served
    served.close()


EVENTS = 12
"""How many of a run's last events are shown where its test fails."""


@pytest.fixture(autouse=True)
def runs(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """Note how each campaign of a test ended."""
    request.node.outcomes = ended = list[Outcome]()
    run = Campaign.run

    def noted(campaign: Campaign) -> Outcome:
        outcome = run(campaign)
        ended.append(outcome)
        return outcome

    monkeypatch.setattr(Campaign, "run", noted)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, Any, Any]:
    """A test that fails shows how its runs ended, and what happened in them last."""
    report = yield
    if report.failed:
        for outcome in getattr(item, "outcomes", ()):
            report.sections.append(("how its run ended", "\n".join([outcome.line, *last_events(outcome)])))
    return report


def last_events(outcome: Outcome) -> list[str]:
    """The last events of a run, a line each; what moves all the time left out."""
    file = outcome.folder / "events.jsonl"
    lines = file.read_text(encoding="utf-8").splitlines() if file.exists() else []
    return [line for line in lines if json.loads(line).get("event") != "Lost"][-EVENTS:]
