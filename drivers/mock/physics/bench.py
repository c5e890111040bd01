"""What a bench and its devices know of each other: the arm that carries its tool, and parts that some benches have."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from drivers.errors import RefusedError
from drivers.mock.physics.stage_axis import Piece

Floats = NDArray[np.float64]


class StreamSpec(NamedTuple):
    """What the sensor board of a bench has of one stream."""

    name: str
    channels: tuple[str, ...]
    unit: str
    scale: float
    rate_hz: float | None


class Carrier(Protocol):
    """What carries a bench's tool: its motion along the approach axis."""

    def place(self, t_s: float, position_m: float) -> None:
        """Stand still on the axis from `t_s` on, and forget what was before."""

    def position(self, t_s: float) -> float:
        """Position on the approach axis in metres."""

    def velocity(self, t_s: float) -> float:
        """Velocity along the approach axis in m/s."""

    def pieces(self, t_s: float) -> Sequence[Piece]:
        """The motion along the axis from `t_s` on: the first piece starts at `t_s`, the last holds for ever."""


class ToolCarrier(Carrier, Protocol):
    """What carries a tool in all directions."""

    def offsets(self, times_s: Floats) -> Floats:
        """Displacement from the start pose along base axes, m, and integrated angular velocity, rad, (n, 6)."""


class ProbeBench(Protocol):
    """A bench whose tool a stage may carry."""

    def mount(self, carrier: Carrier) -> None:
        """Fix the tool to what carries it.

        Raises:
            RefusedError: something carries it already.
        """

    def on_plan(self, t_s: float) -> None:
        """The tool's motion changes at `t_s`, or changed there already where time has passed it."""


class ToolBench(Protocol):
    """A bench whose tool an arm may carry.

    It hears of a change of motion at `t_s`, or later where it has lived through that time already; until then it
    goes on under the motion that was.
    """

    key: tuple[int, int]
    """Seed of the run and number of the trial, which key every noise."""

    t_s: float
    """How far time has passed here."""

    def mount(self, carrier: ToolCarrier) -> None:
        """Fix the tool to what carries it.

        Raises:
            RefusedError: something carries it already.
        """

    def on_plan(self, t_s: float) -> None:
        """The tool's motion changes at `t_s`, or changed there already where time has passed it."""

    def feel(self, on: bool) -> None:
        """Whether the arm's own force sensor is listened to."""

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        """Let time pass until `t_s`."""

    def wrench(self, times_s: Floats, direction: Sequence[float]) -> Floats:
        """What the bench does to the tool at instants of the last advance, base axes, N and N m, shape (n, 6).

        Args:
            times_s: Shape (n,).
            direction: The approach direction, unit vector in the base frame.
        """


def mountable(present: object, carrier: object, what: str, one_axis: str = "") -> None:
    """See that a carrier may take a bench's tool.

    Args:
        present: What carries it already, or None.
        carrier: Who is to carry it.
        what: The tool, in words.
        one_axis: Why a mover along one axis alone will not do, in words; "" where it does.

    Raises:
        RefusedError: it may not.
    """
    if present is not None:
        advice = 'leave one mover on this bench: devices.NAME = "none" takes another away'
        raise RefusedError(what, "being mounted", "another mover carries it already", advice)
    if one_axis and not hasattr(carrier, "offsets"):
        advice = 'take an arm: driver = "ur_arm"'
        raise RefusedError(what, "being mounted", one_axis, advice)


PARTS = {
    "jaws": ("the jaws of a gripper", "aura"),
    "fingers": ("the fingers of a hand", "slip"),
    "taxels": ("tactile matrices", "slip"),
    "carrier": ("fingers that sound", "aura"),
}
"""What a device may look for on a bench, and a kind of plant that has it."""


def part(bench: object, name: Literal["jaws", "fingers", "taxels", "carrier"], device: str) -> Any:
    """What a device is wired to.

    Args:
        bench: As the profile's plant makes it.
        name: Of the part.
        device: Who looks for it.

    Raises:
        RefusedError: this bench has none.
    """
    if hasattr(bench, name):
        return getattr(bench, name)
    what, kind = PARTS[name]
    advice = f'choose a plant that has them (kind = "{kind}"), or devices.NAME = "none" takes it away'
    raise RefusedError(device, "being wired to the bench", f"this bench does not have {what}", advice)
