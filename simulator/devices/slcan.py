"""An emulated slcan adapter with CAN nodes behind it: ASCII lines on the serial side; no port, no clock.

Source: the Lawicel CAN232 manual. A line ends with CR; `t` and `r` are data and remote frames (three digits of
identifier, one of length, the data); an order is answered by CR, a transmission by `z` CR, anything refused by
BEL alone.
"""

from collections.abc import Callable
from contextlib import suppress
from typing import Any, Final

from drivers.core.can_frame import MAX_DATA_BYTES, MAX_ID, CanFrame

OK: Final = b"\r"
SENT: Final = b"z\r"
REFUSED: Final = b"\a"

MAX_LINE: Final = 30
"""Longest line that is kept, in bytes: a frame with an extended identifier has 27 (manual)."""


class EmulatedSlcan:
    """Answers as an adapter does; every node receives every frame of the host, and the host all of theirs.

    Args:
        nodes: Each an `EmulatedDevice`, with frames in place of bytes.
    """

    def __init__(self, *nodes: Any) -> None:
        self._nodes = nodes
        self._rest = b""
        self._open = False
        self._version = {"V": b"V1013\r", "N": b"NE001\r"}

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host at `t_s`; returns what is answered at once."""
        *lines, rest = (self._rest + data).split(b"\r")
        self._rest = rest[-MAX_LINE:]
        return b"".join(self._obey(line, t_s) for line in lines)

    def step(self, t_s: float) -> bytes:
        """What comes from the bus by `t_s` on its own."""
        frames = [frame for node in self._nodes for frame in node.step(t_s)]
        return b"".join(map(self._line, frames)) if self._open else b""

    def inject(self, kind: str, t_s: float) -> None:
        """Break something at `t_s`: of the nodes, those that can.

        Raises:
            ValueError: no node can break in that way.
        """
        broken = 0
        for node in self._nodes:
            with suppress(ValueError):
                node.inject(kind, t_s)
                broken += 1
        if not broken:
            raise ValueError(f"nothing on this bus has a fault {kind!r}")

    def _obey(self, line: bytes, t_s: float) -> bytes:
        text = line.decode("ascii", errors="replace")
        head, rest = text[:1], text[1:]
        orders: dict[str, Callable[[str], bytes]] = {
            "": lambda _: OK,
            "O": self._switch_on,
            "L": self._switch_on,
            "C": self._switch_off,
            "S": lambda rate: REFUSED if self._open or not rate.isdigit() else OK,
            "s": lambda _: REFUSED if self._open else OK,
            "V": lambda _: self._version["V"],
            "N": lambda _: self._version["N"],
        }
        if head in orders:
            return orders[head](rest)
        frame = _frame(text) if self._open else None
        if frame is None:
            return REFUSED
        answers = [answer for node in self._nodes for answer in node.receive(frame, t_s)]
        return SENT + b"".join(map(self._line, answers))

    def _switch_on(self, _: str) -> bytes:
        if self._open:
            return REFUSED
        self._open = True
        return OK

    def _switch_off(self, _: str) -> bytes:
        self._open = False
        return OK

    def _line(self, frame: CanFrame) -> bytes:
        head = f"{'r' if frame.remote else 't'}{frame.id:03X}{len(frame.data)}"
        return f"{head}{frame.data.hex().upper()}".encode("ascii") + OK


def _frame(text: str) -> CanFrame | None:
    """The frame in a line; None where it holds none."""
    try:
        identifier, length, data = int(text[1:4], 16), int(text[4]), bytes.fromhex(text[5:])
    except (ValueError, IndexError):
        return None
    remote = text[0] == "r"
    if text[0] not in "tr" or identifier > MAX_ID or length > MAX_DATA_BYTES:
        return None
    if len(data) != (0 if remote else length):
        return None
    return CanFrame(identifier, data, remote)
