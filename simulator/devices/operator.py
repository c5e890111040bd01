"""An emulated person at the far end of a line: reads requests, takes a while, hangs weights, confirms."""

from __future__ import annotations

import math
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

from drivers.core.errors import CodecError, RefusedError
from drivers.core.links import LineBuffer
from drivers.operator.codec import LINE_MAX, decode, encode
from simulator.physics.bench import Bench, part
from simulator.physics.weight_set import Hands, HandSettings


class EmulatedPerson:
    """Does what the latest request states.

    Args:
        settings: Of the person.
        bench: Where the fingertip is.

    Attributes:
        ready_s: When its request will be done.
    """

    def __init__(self, settings: HandSettings, bench: Bench) -> None:
        self._settings = settings
        self._hands = Hands(settings, bench)
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
                self._hands.hang(t_s, **request["load"])
            except RefusedError as error:
                return encode({**no, "reason": f"{error.reason}; {error.advice}"})
        return encode({"answer": request["ask"], "done": True})

    def inject(self, kind: str, t_s: float) -> None:
        """From now on it declines ("refuse").

        Raises:
            ValueError: a person does not stall.
        """
        if kind != "refuse":
            raise ValueError(f"a person has no fault {kind}")
        self._unwilling = True


def emulated(settings: Mapping[str, Any], bench: Bench) -> EmulatedPerson:
    """A person who hangs weights on the bench's fingertip.

    Raises:
        RefusedError: the bench has none.
    """
    part(bench, "load", "operator")
    return EmulatedPerson(HandSettings(), bench)
