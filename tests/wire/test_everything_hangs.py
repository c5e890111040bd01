"""Disk, CAN adapter, serial port, the arm's pipe and the output all hang while a trial runs: the loop makes its turns.

They hang for the whole trial and not for a while: a loop that waited for one of them would never come to its end,
whatever the machine's speed. Bench time is virtual, and only time that the loop's thread computes is measured.
"""

import gc
import os
import pty
import socket
import termios
import threading
import time
import tty
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from rich.console import Console as Terminal

from behaviors.machine import Behavior, StatePlan, on
from config.verbs import say_at_once
from controller import live
from controller.console import PlainConsole
from controller.guard import Guard, GuardSettings
from controller.live import LiveConsole
from controller.loop import Loop, LoopSettings
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder
from controller.rig import Rig
from drivers.arm.pipe import Pipe
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import CanPort, open_can
from drivers.core.clock import VirtualClock
from drivers.core.links import SerialPort, open_serial
from drivers.core.messages import DeviceInfo, Home, SampleBlock, Sent, Standstill, Stop, StreamInfo
from drivers.core.protocols import Question

HANG_S = 5.0
"""How long the trial lasts, in bench time: 1000 turns."""

TURN_S = 0.02
"""What the worst of these turns may take of the processor: the guard's own limit for a late loop is five times that."""


def fill(descriptor: int) -> None:
    """Until it takes nothing more."""
    os.set_blocking(descriptor, False)
    with suppress(BlockingIOError):
        while True:
            os.write(descriptor, b"\n" * 512)
    os.set_blocking(descriptor, True)


class Line:
    """A pty whose other end is not read."""

    def __init__(self) -> None:
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        self.path = os.ttyname(self._slave)

    def close(self) -> None:
        os.close(self.master)
        os.close(self._slave)


class Hung:
    """A mover whose every turn sends something into what takes nothing."""

    def __init__(self, name: str, clock: VirtualClock, send: Any) -> None:
        self.name, self._clock, self._send = name, clock, send
        self._statuses: list[Any] = []
        self._turns = 0
        self.stopped_s: float | None = None

    def apply(self, command: Any) -> None:
        self._send()
        if isinstance(command, Stop):
            self.stopped_s = self._clock.now()
            self._statuses.append(Standstill(self._clock.now(), self.name, 0.0, command_id=command.id))

    def read(self) -> list[SampleBlock]:
        self._send()
        self._turns += 1
        values = np.zeros((1, 1))
        return [SampleBlock(f"{self.name}.position", self._turns, self._clock.now(), values, 200.0, unit="m")]

    def poll(self) -> list[Any]:
        """An event a turn, for the record."""
        statuses, self._statuses = self._statuses, []
        return [*statuses, Sent(self._clock.now(), self.name, Home(self.name))]


class Stay(Behavior):
    """Keeps every mover on its way for five seconds."""

    table = (on("deadline", "MOVING", "DONE"),)

    def __init__(self, names: list[str]) -> None:
        streams = frozenset(f"{name}.position" for name in names)
        super().__init__({"MOVING": StatePlan(HANG_S, measures=streams)})
        self._names = names

    def enter_MOVING(self) -> None:
        for name in self._names:
            self.command(Home(name))

    def enter_DONE(self) -> None:
        self.conclude("contact")


class Bench:
    """All that hangs, and what lets it go again."""

    def __init__(self, root: Path) -> None:
        self.clock = VirtualClock()
        self.lines = [Line(), Line()]
        self.can = open_can("gripper", CanPort(port=self.lines[0].path), self.clock)
        self.serial = open_serial("stage", SerialPort(port=self.lines[1].path), self.clock)
        near, self._far = socket.socketpair(type=socket.SOCK_SEQPACKET)
        self.pipe = Pipe(near)
        self.refused = 0
        self.devices = {
            "gripper": Hung("gripper", self.clock, lambda: self.can.send(CanFrame(0x10, bytes(8)))),
            "stage": Hung("stage", self.clock, lambda: self.serial.send(b"/1 1 move abs 1000\n" * 10)),
            "arm": Hung("arm", self.clock, self._order),
        }
        self._make_recorder(root)
        self._make_console()

    def _order(self) -> None:
        self.refused += not self.pipe.send(Home("arm"))

    def _make_recorder(self, root: Path) -> None:
        folder = RunFolder.create(root, "mock/hanging", datetime.now(UTC))
        os.mkfifo(folder.events_path)
        self.disk = os.open(folder.events_path, os.O_RDWR)
        fill(self.disk)
        self.streams = {name: StreamInfo(f"{name}.position", ("position",), "m") for name in self.devices}
        self.recorder = Recorder(
            folder, datetime.now(UTC), streams=self.streams, factors=(), measures=(), patient=True
        )
        self.recorder.begin_trial(1, {}, 0.0)

    def _make_console(self) -> None:
        self.screen, writing = os.pipe()
        fill(writing)
        self.output = os.fdopen(writing, "w")
        self._asked = 0
        self.console = PlainConsole(self._operator(), say_at_once)

    def _operator(self) -> Any:
        bench = self

        class Asked:
            """Has the console print a line at every turn."""

            @property
            def question(self) -> Question:
                bench._asked += 1
                return Question(bench._asked, "hang 0.50 N on bridge Fx, then press Enter")

            def poll(self) -> None:
                return None

        return Asked()

    def infos(self) -> dict[str, DeviceInfo]:
        return {
            name: DeviceInfo(name, "hangs", mover=True, streams={stream.name: stream})
            for name, stream in self.streams.items()
        }

    def let_go(self) -> None:
        """Read what was written, to its end."""
        for descriptor in (self.disk, self.screen):
            threading.Thread(target=self._drain, args=(descriptor,), daemon=True).start()
        self.console.campaign_ended("")
        self.recorder.close()
        self.output.close()
        self.can.close()
        self.serial.close()
        for line in self.lines:
            line.close()
        self.pipe.close()
        self._far.close()

    @staticmethod
    def _drain(descriptor: int) -> None:
        with suppress(OSError):
            while os.read(descriptor, 65536):
                pass


@pytest.fixture
def bench(tmp_path: Path) -> Iterator[Bench]:
    made = Bench(tmp_path)
    yield made
    made.let_go()


def test_the_loop_makes_every_turn_and_every_stop_while_all_that_it_writes_to_hangs(
    bench: Bench, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.stdout", bench.output)
    guard = Guard(GuardSettings(travel_m=0.01, position_stream=None, force_stream=None))
    settings = LoopSettings(rate_hz=200.0)
    loop = Loop(
        Rig("mock", bench.devices, bench.clock),  # type: ignore[arg-type]
        bench.infos(),
        guard,
        bench.recorder,
        bench.console,
        settings,
    )
    turns: list[float] = []
    turn = loop._turn

    def timed(t_s: float, late_s: float) -> None:
        begun_s = time.thread_time()
        turn(t_s, late_s)
        turns.append(time.thread_time() - begun_s)

    loop._turn = timed  # type: ignore[method-assign]
    gc.collect()
    gc.freeze()  # as a campaign does: what other tests left in memory is not this loop's
    try:
        loop.run(Stay(list(bench.devices)), {})
    finally:
        gc.unfreeze()
    assert len(turns) == 1000
    assert max(turns) < TURN_S
    assert loop.account.not_at_rest == []
    stops_s = [device.stopped_s for device in bench.devices.values()]
    assert stops_s == [pytest.approx(HANG_S)] * 3
    # each of them hung indeed
    assert "takes no frame" in str(bench.can.fault)
    assert "takes no more bytes" in str(bench.serial.fault)
    assert bench.refused > 100
    assert len(bench.recorder._disk._queue) > 1000
    assert bench.console._printer._lines.qsize() > 900
    assert bench.recorder.failure is None


class Unread:
    """A terminal whose other end is not read."""

    def __init__(self):
        self.far, near = pty.openpty()
        self.file = os.fdopen(near, "w")

    def read(self):
        """Reads it after all, to its end."""
        data = b""
        with suppress(OSError):  # both ends are closed
            while piece := os.read(self.far, 65536):
                data += piece
        return data.decode()


@pytest.mark.parametrize("how", ["full", "stopped"])
def test_a_terminal_that_takes_nothing_holds_neither_the_loop_nor_the_end_up(monkeypatch, how):
    monkeypatch.setattr(live, "REFRESH_S", -1.0)
    terminal = Unread()
    operator = SimpleNamespace(poll=lambda: None, pressed_yet=lambda: "", question=None)
    console = LiveConsole(operator, Terminal(file=terminal.file, force_terminal=True, width=72, height=24))
    if how == "stopped":
        termios.tcflow(terminal.file.fileno(), termios.TCOOFF)  # what Ctrl+S does
    console.campaign_started("mock/transient", 42, Path("runs/x"))
    thread, pictures = console._drawer._thread, console._drawer._pictures
    console.trial_started(1, {})
    hung = turns = 0
    while hung < 60:  # turns in one drawing of its thread's
        console.state("MOVING", 0.005 * turns)  # what has not changed is not drawn
        console.poll()
        time.sleep(0.005)
        turns += 1
        assert turns < 4000, "the terminal takes all there is"
        hung = hung + 1 if pictures.full() else 0
    # read only after all turns and the end's message: a wait for the terminal would last for ever
    console.campaign_ended("")
    if how == "stopped":
        termios.tcflow(terminal.file.fileno(), termios.TCOON)
    with ThreadPoolExecutor(1) as reader:
        reading = reader.submit(terminal.read)
        thread.join(10.0)
        assert not thread.is_alive()
        terminal.file.close()
        assert "mock/transient" in reading.result(10.0)
    os.close(terminal.far)
