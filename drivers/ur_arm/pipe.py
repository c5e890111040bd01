"""What goes through the pipe between the program and the arm's process.

Downwards go `drivers.messages` commands; upwards go `Opened`, `Row`, `Broken` and `drivers.messages` statuses. All
times in the pipe are the host's monotonic seconds, which both processes share.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal, NamedTuple

from drivers.ur_arm.settings import Pose

Kind = Literal["port", "silent", "refused", "protocol"]


class Row(NamedTuple):
    """One cycle of the controller.

    Attributes:
        arrival_s: When it was read.
        device_s: The controller's time.
        pose: Of the tool: m and rotation vector.
        twist: Of the tool: m/s and rad/s.
        force: On the tool, base frame: N and N m.
        safety_bits: `safety_status_bits`.
        runtime: `runtime_state`.
    """

    arrival_s: float
    device_s: float
    pose: Pose
    twist: Pose
    force: Pose
    safety_bits: int
    runtime: int


@dataclass(frozen=True, slots=True)
class Opened:
    """The arm is connected, its program runs and its watchdog is set.

    Attributes:
        model: As the dashboard says it.
        serial: Likewise.
        version: Of PolyScope.
        pose: Where the tool is.
        details: For the manifest.
    """

    model: str
    serial: str
    version: str
    pose: Pose
    details: Mapping[str, object]


@dataclass(frozen=True, slots=True)
class Broken:
    """The arm's process can do no more, and ends.

    Attributes:
        kind: Which error it is, should it come while opening.
        reason: What happened.
        advice: What to do about it.
    """

    kind: Kind
    reason: str
    advice: str


class BrokenError(Exception):
    """Carries a `Broken` out of the depth of the arm's process."""

    def __init__(self, kind: Kind, reason: str, advice: str) -> None:
        self.broken = Broken(kind, reason, advice)
        super().__init__(reason)
