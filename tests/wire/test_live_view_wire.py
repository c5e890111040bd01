"""The live view on a terminal that takes nothing: the loop, and with it the guard, goes on."""

import os
import pty
import termios
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import pytest
from rich.console import Console as Terminal

from controller import live
from controller.live import LiveConsole


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
