"""The arm's process with both of its ends, in virtual time: no client, no controller."""

import math
import os
import socket
from collections.abc import Callable
from typing import Any

import pytest

from drivers.arm.link import ArmRow, LinkError, Seen
from drivers.arm.pipe import Pipe, Start
from drivers.arm.process import ArmProcess
from drivers.arm.settings import ArmSettings
from drivers.core.clock import VirtualClock
from drivers.core.errors import SilentError

START = (0.3, 0.0, 0.3, 0.0, 3.14, 0.0)
REST = (0.0,) * 6
SETTINGS = ArmSettings(host="127.0.0.1", rate_hz=500.0, start_pose=START, recover_s=4.0)
BEGIN_S = 100.0


class EndError(BaseException):
    """What `os._exit` does here."""


GONE = LinkError(SilentError, "the link is gone", "is the cable in?")


class Link:
    """A controller whose arm stands: its latest row, and its time."""

    package = "pytest"

    def __init__(self, clock):
        self.clock, self.device_s, self.client, self.gone = clock, 7.0, None, False
        self._read_s = math.nan

    def read(self):
        if self.device_s == self._read_s:
            return None
        self._read_s = self.device_s
        return self.row()

    def row(self):
        return ArmRow(self.clock.monotonic_s(), self.device_s, START, REST, REST)

    def check(self):
        if self.gone:
            raise GONE


class Deaf:
    """A client whose arm goes on whatever it is sent."""

    def __init__(self):
        self.calls = []

    def __getattr__(self, name):
        def asked(*details):
            self.calls.append(name)
            return True

        return asked


class Clock(VirtualClock):
    """Notes how far time may go, and that it may go on alone; lets the test act at each rest."""

    def __init__(self):
        super().__init__()
        self.held_s, self.left = [], 0
        self.each: Callable[[], object] = lambda: None
        self.rest(BEGIN_S)

    def hold(self, t_s):
        self.held_s.append(t_s)

    def leave(self):
        self.left += 1

    def rest(self, seconds):
        super().rest(seconds)
        getattr(self, "each", lambda: None)()


class Arm:
    """The process, and both of its ends."""

    def __init__(self, monkeypatch):
        self.clock = Clock()
        self.link: Any = Link(self.clock)
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        self.ends, self.pipe = (ours, theirs), Pipe(ours)
        self.turns = os.eventfd(0, os.EFD_NONBLOCK)
        start: Any = Start("arm", SETTINGS, lambda *_: self.link, False, self.turns, self.clock)
        self.process = ArmProcess(Pipe(theirs), start)
        self.process._seen = Seen(self.link.row(), BEGIN_S)
        monkeypatch.setattr("drivers.arm.process.rest", self.clock.rest)
        monkeypatch.setattr("drivers.arm.process.os._exit", self.exit)

    def sees(self, **changes):
        """The next row, which differs so."""
        self.process._seen = self.process._seen.then(self.process._seen.row._replace(**changes))

    def exit(self, code):
        raise EndError(code)

    def messages(self):
        found = []
        while (message := self.pipe.receive()) is not None:
            found.append(message)
        return found

    def listens(self, each):
        """Listen until something ends the process; `each` acts at each rest. The messages."""
        messages = []
        self.clock.each = lambda: (each(), messages.extend(self.messages()))
        with pytest.raises(EndError, match="1"):
            self.process._listen()
        return messages + self.messages()

    def close(self):
        for end in self.ends:
            end.close()
        os.close(self.turns)
