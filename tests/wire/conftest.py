"""Emulated devices behind real ptys, and what a failed run did last."""

import json
import queue
import select
import threading
import time
from collections.abc import Callable, Generator, Iterator
from contextlib import suppress
from typing import Any

import pytest

from controller.campaign import Campaign, Outcome
from simulator.devices.far_end import FarEnd
from simulator.devices.faults import FaultSchedule
from simulator.wiring.bench_clock import BenchClock, Pace
from simulator.wiring.emulator import STEP_S
from simulator.wiring.far_ends import Line
from tests.wire.emulated_ur import EmulatedUr
from tests.wire.ur_hand import Hand

LIFE_S = 250.0
"""A bench stops by itself after this long, whatever its test does. Assumption: a busy machine takes ten times as long
as a quiet one."""

HURRY = 5.0


class Serve:
    """Emulated devices, served by one thread on a bench's clock: `serve(device)` gives the path of a pty.

    Time on this clock stands still while this process is held up, and waits for the thread that turns a driver and for
    unread bytes: what a test finds does not depend on how busy its machine is.

    Attributes:
        clock: For drivers, and for tests that wait for them.
    """

    def __init__(self) -> None:
        self._pace = Pace()
        self.clock = BenchClock(self._pace.page)
        self.error: BaseException | None = None
        self._ends: dict[str, FarEnd] = {}
        self._lock = threading.Lock()
        self._pulled = queue.Queue[str]()
        self._running = True
        self._thread = threading.Thread(target=self._serve, name="bench", daemon=True)
        self._thread.start()

    def __call__(self, device: Any) -> str:
        return self.wire(Line(device))

    def wire(self, end: FarEnd, faults: FaultSchedule | None = None) -> str:
        """Serve a far end; faults count from the clock's zero. Gives its port."""
        end.open(faults or FaultSchedule(), self.clock)
        with self._lock:
            self._ends[end.endpoint["port"]] = end
        return end.endpoint["port"]

    def lock(self, port: str) -> threading.Lock:
        """Held while devices are spoken to: take it before touching one from a test."""
        return self._lock

    def unplug(self, port: str) -> None:
        """Hang up, as a pulled plug does; has happened when it comes back."""
        self._pulled.put(port)
        self._pulled.join()

    def close(self) -> None:
        """Hang up everywhere; a device that raised fails its test."""
        self._running = False
        self._thread.join(5.0)
        for end in self._ends.values():
            end.unplug()
        if self.error is not None:
            raise self.error

    def _serve(self) -> None:
        until_s = time.monotonic() + LIFE_S
        due_s = 0.0
        try:
            while self._running and time.monotonic() < until_s:
                with self._lock:
                    self._pull()
                    waited = [one for end in self._ends.values() for one in end.waited()]
                ready = select.select(waited, [], [], self._pace.wait_s(due_s))[0]
                with self._lock:
                    unread = frozenset(port for port, end in self._ends.items() if end.unread())
                    now_s = self._pace.turn(unread)
                    if ready or now_s >= due_s:
                        due_s = now_s + STEP_S
                        for end in self._ends.values():
                            end.exchange(ready, now_s, now_s)
        except BaseException as error:
            self.error = error
            self._pull()

    def _pull(self) -> None:
        """In the thread that waits for the line: no other may close it."""
        with suppress(queue.Empty):
            while True:
                self._ends.pop(self._pulled.get_nowait()).unplug()
                self._pulled.task_done()


class Hurried:
    """An emulated device whose time runs five times as fast: a calibration takes half a second."""

    def __init__(self, device: Any) -> None:
        self._device = device

    def receive(self, data: bytes, t_s: float) -> bytes:
        return self._device.receive(data, HURRY * t_s)

    def step(self, t_s: float) -> bytes:
        return self._device.step(HURRY * t_s)


class Wired:
    """An emulated device at the far end of a port; a driver is to be opened at it."""

    driver: Any

    def __init__(self, serve: Serve, device: Any) -> None:
        self.clock = serve.clock
        self.port = serve(device)
        self.lock = serve.lock(self.port)


@pytest.fixture
def serve() -> Iterator[Serve]:
    served = Serve()
    yield served
    served.close()


@pytest.fixture(scope="module")
def controller() -> Iterator[EmulatedUr]:
    with EmulatedUr() as one:
        yield one


@pytest.fixture
def emulated(controller: EmulatedUr) -> EmulatedUr:
    """A controller that was just switched on."""
    controller.order(restart=True)
    return controller


@pytest.fixture
def hand(emulated: EmulatedUr) -> Iterator[Callable[..., Hand]]:
    hands: list[Hand] = []

    def make(**changes: Any) -> Hand:
        hands.append(Hand(emulated, **changes))
        return hands[-1]

    yield make
    for one in hands:
        one.arm.close()


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
