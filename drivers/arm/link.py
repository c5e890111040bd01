"""What a make of arm gives to the arm's process: a link to its controller, whose rows and calls any arm's have."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, ClassVar, NamedTuple, Protocol

from drivers.arm.settings import Pose
from drivers.core.clock import Clock
from drivers.core.errors import DeviceError

STILL_M_S, STILL_RAD_S = 1e-3, 5e-3
"""Speeds below which nothing moves (assumption: noise of the joints' speeds at the tool)."""

CALLS_S = 0.04
"""How long the calls of one cycle may take: more than the longest (`zeroFtSensor` of ur_rtde 20 ms, measured), less
than half of a watchdog's usual 0.1 s."""

LOOK_S = 0.0004
"""Time between two looks for a new row that is due: a fifth of a UR controller's cycle."""


class ArmRow(NamedTuple):
    """One cycle of the controller.

    Attributes:
        device_s: The controller's time.
        pose: Of the tool: m and rotation vector.
        twist: Of the tool: m/s and rad/s.
        force: On the tool, base frame: N and N m.
        fault: Why the arm will not move, or "".
        running: Whether the controller carries commands out; one that does not brakes by itself.
    """

    arrival_s: float
    device_s: float
    pose: Pose
    twist: Pose
    force: Pose
    fault: str = ""
    running: bool = True


class Seen(NamedTuple):
    """What is known of the arm: its latest row, and since when it has stood still (infinity where it moves)."""

    row: ArmRow
    still_since_s: float

    def then(self, row: ArmRow) -> Seen:
        """With the next row; a tool stands from the first row on that shows it."""
        if math.hypot(*row.twist[:3]) >= STILL_M_S or math.hypot(*row.twist[3:]) >= STILL_RAD_S:
            return Seen(row, math.inf)
        return Seen(row, min(self.still_since_s, row.arrival_s))


@dataclass(frozen=True, slots=True)
class Opened:
    """The arm is connected, takes commands, and its watchdog is set."""

    model: str
    serial: str
    version: str
    row: ArmRow
    details: Mapping[str, object]


class LinkError(Exception):
    """The arm's process can do no more, and ends; sent to the program.

    Args:
        kind: Which error it is, should it come while opening.
    """

    def __init__(self, kind: type[DeviceError], reason: str, advice: str) -> None:
        super().__init__(kind, reason, advice)
        self.kind, self.reason, self.advice = kind, reason, advice


class Client(Protocol):
    """Commands to the controller, from one thread: each comes back within a few cycles, False where it was refused."""

    def speed(self, twist: Pose, acceleration_m_s2: float) -> bool:
        """Bring the tool to a twist, and keep it until the next one; feeds the watchdog, too."""

    def end_speed(self) -> bool:
        """End tool speeds; the tool stands."""

    def move(self, pose: Pose, speed_m_s: float, acceleration_m_s2: float) -> bool:
        """Begin a straight move."""

    def end_move(self, deceleration_m_s2: float) -> bool:
        """Begin to stop a straight move."""

    def busy(self) -> bool:
        """Whether a move, or its stop, is under way."""

    def feed_watchdog(self) -> bool:
        """Feed the controller's watchdog while no tool speeds are sent."""

    def tare(self) -> bool:
        """Take the present force for zero."""

    def lead(self, on: bool) -> bool:
        """Let a person lead the tool by hand, or end that; the tool then stands."""

    def halt(self) -> None:
        """Stop the arm past this client: whatever else feeds the watchdog."""

    def recover(self) -> str:
        """Unlock the arm and have it obey again, within `recover_s`; why not, or ""."""

    def leave(self) -> None:
        """End what runs on the controller; the arm stands."""


class ArmLink(Protocol):
    """One arm's link, made in the arm's process with its settings and the bench's clock.

    Attributes:
        package: The distribution that it needs; "" for none.
        extra: Of touchbench, which brings it; "" for none.
    """

    package: ClassVar[str]
    extra: ClassVar[str]

    def __init__(self, settings: Any, clock: Clock) -> None: ...

    @property
    def client(self) -> Client:
        """For commands, once it is open."""

    def open(self, again: bool) -> Opened:
        """Connect, check what must be right before anything moves, set the watchdog; moves nothing.

        Args:
            again: Whether this replaces a process that died: what still runs on the controller is then our own.

        Raises:
            LinkError: something is beyond repair.
            ImportError: the distribution is not installed.
        """

    def read(self) -> ArmRow | None:
        """The latest row where it is a new one, from another thread than the client's; never waits."""

    def check(self) -> None:
        """From the same thread as `read`.

        Raises:
            LinkError: the link is gone.
        """
