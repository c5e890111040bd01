"""Robotiq: lines of the URCap's socket ⇄ values, and SI ⇄ the counts of each model. No I/O.

Source: docs/reference/grippers.md. A question is `GET NAME`, its answer `NAME value`, without an end; an order is
`SET NAME value …`, its answer `ack`.
"""

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Final, Literal, NamedTuple

from drivers.core.messages import Grip, Release
from drivers.gripper.units import JawUnits

PORT: Final = 63352
"""Where the URCap listens on the arm's controller."""

COUNTS: Final = 255
"""Speeds and forces run from 0, the least, to this; positions from open to closed."""

LONGEST_S: Final = 0.5
"""Longest time between two states while all is well, s (assumption: five questions of 20 ms, five times)."""

ACK: Final = "ack"

RESET, ACTIVE = 0, 3
"""Values of `STA`: without power on its drive, and after its activation; 1 is on the way."""

OPENING_OBJECT, CLOSING_OBJECT = 1, 2
"""Values of `OBJ`: something stopped the jaws; 0 is moving, 3 at the position."""

TROUBLE: Final[Mapping[int, str]] = {
    8: "it is too hot",
    9: "it heard nothing for a second",
    10: "its supply is too low",
    11: "it opens by its automatic release",
    12: "its processor has a fault",
    13: "its activation failed",
    14: "its current was too great",
    15: "it opened by its automatic release",
}
"""Values of `FLT` that end a grip, and what they mean; 5 and 7 ask for an activation (instruction manual)."""

_ANSWER = re.compile(rb"\s*(?:(ack)|([A-Z]{3}) (\d+))\s*")


class RobotiqModel(NamedTuple):
    """What a model can do (data sheets).

    Attributes:
        stroke_m: Opening of the open jaws.
        counts: Positions of the open and the closed jaws. Assumption: what public clients' calibrations find.
        speed_m_s: Least and greatest rate of the opening.
    """

    stroke_m: float
    counts: tuple[int, int]
    force_n: tuple[float, float]
    speed_m_s: tuple[float, float]


ModelName = Literal["2f-85", "2f-140", "hand-e"]

MODELS: Final[Mapping[ModelName, RobotiqModel]] = {
    "2f-85": RobotiqModel(0.085, (3, 230), (20.0, 235.0), (0.02, 0.15)),
    "2f-140": RobotiqModel(0.14, (3, 230), (10.0, 125.0), (0.03, 0.25)),
    "hand-e": RobotiqModel(0.05, (0, 255), (20.0, 185.0), (0.02, 0.15)),
}


class RobotiqOrder(NamedTuple):
    """Where to go, how fast, how hard: counts."""

    position: int
    speed: int
    force: int


class RobotiqUnits(JawUnits):
    """Turns widths, speeds and forces into counts and back; forces and speeds are linear in them (data sheet).

    Args:
        closed_width_m: Opening between the fingers where the jaws are closed.
        open_width_m: The same where they are open.
        counts: Positions there: open, closed.
    """

    def __init__(
        self, model: RobotiqModel, closed_width_m: float, open_width_m: float, counts: tuple[int, int]
    ) -> None:
        self.closed_width_m, self.open_width_m = closed_width_m, open_width_m
        self.force_min_n = model.force_n[0]
        self._model = model
        self._open, self._closed = counts

    def closed_share(self, position: int) -> float:
        """Where a position is: 0 open to 1 closed; beyond these where the jaws go farther."""
        return (position - self._open) / (self._closed - self._open)

    def position_at(self, closed_share: float) -> int:
        """The position nearest to a share of the way."""
        return round(min(max(self._open + closed_share * (self._closed - self._open), 0.0), COUNTS))

    def width_m(self, position: int) -> float:
        """See `JawUnits.width_m`."""
        return self.open_width_m - self.closed_share(position) * (self.open_width_m - self.closed_width_m)

    def force_n(self, current_ma: int) -> float:
        """See `JawUnits.force_n`: of a count; 0 where nothing is held."""
        return 0.0 if current_ma < 0 else _value(current_ma, self._model.force_n)

    def speed_m_s(self, count: int) -> float:
        """How fast the opening changes at a speed."""
        return _value(count, self._model.speed_m_s)

    def order(self, command: Grip | Release) -> RobotiqOrder:
        """The order that carries out a command."""
        speed = _count(command.speed_m_s, self._model.speed_m_s)
        if isinstance(command, Release):
            return RobotiqOrder(self._open, speed, 0)
        share = (self.open_width_m - command.width_m) / (self.open_width_m - self.closed_width_m)
        return RobotiqOrder(self.position_at(share), speed, _count(command.force_n, self._model.force_n))

    def rounded(self, command: Grip | Release) -> Grip | Release:
        """See `JawUnits.rounded`; a speed below the least becomes that one."""
        order = self.order(command)
        speed_m_s = self.speed_m_s(order.speed)
        if isinstance(command, Release):
            return replace(command, speed_m_s=speed_m_s)
        width_m = self.width_m(order.position)
        return replace(command, width_m=width_m, speed_m_s=speed_m_s, force_n=self.force_n(order.force))


def encode_get(name: str) -> bytes:
    """A question for a variable."""
    return f"GET {name}\n".encode()


def encode_set(**values: int) -> bytes:
    """An order that sets variables together, in this order."""
    return ("SET " + " ".join(f"{name} {value}" for name, value in values.items()) + "\n").encode()


def encode_drive(order: RobotiqOrder) -> bytes:
    """An order that drives the jaws."""
    return encode_set(POS=order.position, SPE=order.speed, FOR=order.force, GTO=1)


def take_answer(data: bytes) -> tuple[tuple[str, int] | None, bytes]:
    """The first answer, as its name (`ack` has the value 0), and the bytes behind it; None where there is none yet."""
    found = _ANSWER.match(data)
    if found is None:
        return None, data
    ack, name, value = found.groups()
    return ((ACK, 0) if ack else (name.decode(), int(value))), data[found.end() :]


def _count(value: float, ends: tuple[float, float]) -> int:
    """The greatest count that is not above a value; 0 where there is none."""
    lowest, highest = ends
    return min(max(math.floor((value - lowest) / (highest - lowest) * COUNTS + 1e-9), 0), COUNTS)


def _value(count: int, ends: tuple[float, float]) -> float:
    lowest, highest = ends
    return lowest + (highest - lowest) * count / COUNTS
