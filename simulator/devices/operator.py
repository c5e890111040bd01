"""An emulated person at the far end of a line: reads requests, takes a while, hangs weights, confirms."""

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from typing import Any

import numpy as np
from pydantic import Field

from drivers.core.errors import CodecError, RefusedError
from drivers.core.links import LineBuffer
from drivers.core.settings import Settings
from drivers.operator.codec import LINE_MAX, decode, encode
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import Bench, part
from simulator.physics.noise import gaussian_at

STREAM_WEIGHTS = 64
"""Number of the weights' errors among the bench's counter-based streams; plant, arm and idle sensors are below."""


class HandSettings(Settings):
    """A simulated person and their weights."""

    answer_s: float = Field(default=0.4, ge=0.0, le=3600.0)
    """How long they take for a request. Assumption: far less than a person's, which is not measured here."""

    weight_error: float = Field(default=0.001, ge=0.0, le=0.1)
    """Relative standard deviation of what a weight really pulls with. Assumption: a laboratory's slotted weights, local
    gravity included."""


class EmulatedPerson(EmulatedDevice):
    """Does what the latest request states; hangs one load at a time.

    A weight of a given size is the same piece in all trials of a run, with the same error.
    """

    called = "a person"

    def __init__(self, settings: HandSettings, bench: Bench) -> None:
        super().__init__()
        self._settings = settings
        self._bench = bench
        self._lines = LineBuffer(LINE_MAX)
        self._request: dict[str, Any] | None = None
        self.ready_s = math.inf
        self._unwilling = False

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host; a hello is answered at once."""
        out = b""
        for line in self._lines.feed(data):
            with suppress(CodecError):
                message = decode(line)
                if "hello" in message:
                    self._request, self.ready_s = None, math.inf
                    out += encode({"hello": "emulated person"})
                elif "ask" in message:
                    self._request, self.ready_s = message, t_s + self._settings.answer_s
        return out

    def step(self, t_s: float) -> bytes:
        """The answer, once its time has come."""
        if self._request is None or t_s < self.ready_s:
            return b""
        request, self._request, self.ready_s = self._request, None, math.inf
        no = {"answer": request["ask"], "done": False}
        if self._unwilling:
            return encode({**no, "reason": "that cannot be done"})
        if "load" in request:
            try:
                self._hang(t_s, **request["load"])
            except RefusedError as error:
                return encode({**no, "reason": f"{error.reason}; {error.advice}"})
        return encode({"answer": request["ask"], "done": True})

    def _hang(self, t_s: float, bridge: str, force_n: float) -> None:
        """Let this force hang, and nothing else, from `t_s` on; raises `RefusedError`."""
        load = part(self._bench, "load", "operator")
        self._bench.advance(t_s)
        for name in ("x", "y", "t"):
            load(name, self._true_n(force_n) if name == bridge else 0.0)

    def _true_n(self, force_n: float) -> float:
        """What pulls when this is written on the weight, N."""
        if force_n == 0.0:
            return 0.0
        number = np.array([round(force_n * 1e6)])
        deviate = float(gaussian_at((self._bench.key[0], 0), STREAM_WEIGHTS, number)[0])
        return force_n * (1.0 + self._settings.weight_error * deviate)

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """From now on they decline ("refuse")."""
        return {"refuse": self._decline}

    def _decline(self) -> None:
        self._unwilling = True


def emulated(settings: object, bench: Bench) -> EmulatedPerson:
    """A person at the bench, who hangs weights where it has a fingertip."""
    return EmulatedPerson(HandSettings(), bench)
