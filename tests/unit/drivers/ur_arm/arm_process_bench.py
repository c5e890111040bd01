"""The arm's process with both of its ends, in virtual time: no client, no controller."""

from __future__ import annotations

import os
import socket
from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import pytest

from drivers.clock import VirtualClock
from drivers.ur_arm.child import ArmProcess
from drivers.ur_arm.controller import PLAYING
from drivers.ur_arm.pipe import Pipe
from drivers.ur_arm.settings import UrArmSettings

START = (0.3, 0.0, 0.3, 0.0, 3.14, 0.0)
REST = (0.0,) * 6
SETTINGS = UrArmSettings(host="127.0.0.1", start_pose=START, recover_s=4.0)
BEGIN_S = 100.0


class EndError(BaseException):
    """What `os._exit` does here."""


class Receive:
    """The client's receive interface: the controller's latest row, and its time."""

    def __init__(self):
        self.device_s, self.twist, self.connected, self.torn = 7.0, REST, True, False
        self.safety, self.runtime = 5, PLAYING

    def getTimestamp(self):  # noqa: N802
        return self.device_s

    def getActualTCPPose(self):  # noqa: N802
        return list(START)

    def getActualTCPSpeed(self):  # noqa: N802
        return list(self.twist)

    def getActualTCPForce(self):  # noqa: N802
        if self.torn:
            self.device_s += 0.002
        return [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]

    def getSafetyStatusBits(self):  # noqa: N802
        return self.safety

    def getRuntimeState(self):  # noqa: N802
        return self.runtime

    def isConnected(self):  # noqa: N802
        return self.connected


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
        self.clock, self.receive = Clock(), Receive()
        ours, theirs = socket.socketpair(type=socket.SOCK_SEQPACKET)
        self.ends, self.pipe = (ours, theirs), Pipe(ours)
        self.turns = os.eventfd(0, os.EFD_NONBLOCK)
        self.link = self.control = True
        self.process = ArmProcess(Pipe(theirs), self.turns, "arm", SETTINGS, self.clock)
        self.process._receive = self.receive
        links: Any = SimpleNamespace(stands=lambda: self.link)
        self.process._link = links
        self.client: Any = SimpleNamespace(connected=lambda: self.control)
        monkeypatch.setattr("drivers.ur_arm.child.rest", self.clock.rest)
        monkeypatch.setattr("drivers.ur_arm.child.os._exit", self.exit)

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
            self.process._listen(self.client)
        return messages + self.messages()

    def close(self):
        for end in self.ends:
            end.close()
        os.close(self.turns)
