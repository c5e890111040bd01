"""SSG-48: the messages between host and gripper, as values."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Final


class GripperCode(IntEnum):
    """Command numbers, 6 bits (docs/reference/can_gripper.md)."""

    ESTOP = 0
    CLEAR_ERROR = 1
    HEARTBEAT = 9
    PING = 10
    IDLE = 12
    WATCHDOG = 15
    TEMPERATURE = 23
    VOLTAGE = 24
    INFO = 25
    ERRORS = 26
    CURRENT = 27
    ENCODER = 28
    HEARTBEAT_PERIOD = 30
    STATE = 60
    DRIVE = 61
    CALIBRATE = 62


ASKED: Final = frozenset(
    {
        GripperCode.PING,
        GripperCode.TEMPERATURE,
        GripperCode.VOLTAGE,
        GripperCode.INFO,
        GripperCode.ERRORS,
        GripperCode.CURRENT,
        GripperCode.ENCODER,
    }
)
"""What a remote frame can ask for; the answer has the same number."""

PLAIN: Final = frozenset(
    {GripperCode.ESTOP, GripperCode.CLEAR_ERROR, GripperCode.IDLE, GripperCode.CALIBRATE}
)
"""Orders without data and without an answer."""


# --- host to gripper ------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class Plain:
    """An order without data: one of `PLAIN`."""

    code: GripperCode


@dataclass(frozen=True, slots=True)
class AskState:
    """A remote frame: one of `ASKED`."""

    code: GripperCode


@dataclass(frozen=True, slots=True)
class Poll:
    """Asks for `GripperState` and feeds the watchdog."""


@dataclass(frozen=True, slots=True)
class DriveOrder:
    """Go to a position; answered by `GripperState`.

    Attributes:
        position: 0 open to 255 closed.
        speed: 0 to 255.
        current_ma: Limit.
        activate: Wake the drive.
        go: Move; else it sleeps.
        estop: Raise the emergency stop; it stays up until an order without it, and a `CLEAR_ERROR`.
    """

    position: int
    speed: int
    current_ma: int
    activate: bool = True
    go: bool = True
    estop: bool = False


@dataclass(frozen=True, slots=True)
class Watchdog:
    """Fault where nothing arrives for this long; 0 is never. The action is stored and never used (firmware)."""

    period_ms: int
    action: int = 0


@dataclass(frozen=True, slots=True)
class HeartbeatPeriod:
    """Period of its heartbeat while it sends nothing else; 0 is never."""

    period_ms: int


Order = Plain | AskState | Poll | DriveOrder | Watchdog | HeartbeatPeriod


# --- gripper to host ------------------------------------------------------------------------------


class GripFinding(IntEnum):
    """The firmware's finding on a motion; on the wire with its bits exchanged."""

    MOVING = 0
    OBJECT_CLOSING = 1
    OBJECT_OPENING = 2
    AT_POSITION = 3


@dataclass(frozen=True, slots=True)
class GripperState:
    """State of the gripper.

    Attributes:
        position: 0 open to 255 closed; means nothing before calibration.
        current_ma: Measured; negative closes, positive opens (firmware).
        finding: What became of the motion.
        activated: As the last `DriveOrder` had it.
        going: As the last `DriveOrder` had it.
        over_temperature: Fault.
        watchdog: Fault.
        estop: Fault raised by a `DriveOrder`; that of an `ESTOP` order shows in `GripperErrors` alone.
        calibrated: It knows its ends.
    """

    position: int
    current_ma: int
    finding: GripFinding
    activated: bool
    going: bool
    over_temperature: bool
    watchdog: bool
    estop: bool
    calibrated: bool

    @property
    def object(self) -> bool:
        """Something holds the jaws."""
        return self.finding in (GripFinding.OBJECT_CLOSING, GripFinding.OBJECT_OPENING)


@dataclass(frozen=True, slots=True)
class Heartbeat:
    """A heartbeat, or the answer to a ping."""

    code: GripperCode


@dataclass(frozen=True, slots=True)
class Number:
    """A temperature in degrees Celsius, a voltage in mV or a current in mA."""

    code: GripperCode
    value: int


@dataclass(frozen=True, slots=True)
class GripperInfo:
    """Its identity."""

    hardware: int
    batch: int
    software: int
    serial: int


@dataclass(frozen=True, slots=True)
class GripperErrors:
    """Active faults by name, and whether the motor is calibrated (by the maker; not the jaws)."""

    active: frozenset[str]
    motor_calibrated: bool = True


@dataclass(frozen=True, slots=True)
class Encoder:
    """Motor position in ticks and speed in ticks per second; positive opens."""

    position: int
    speed: int


Answer = GripperState | Heartbeat | Number | GripperInfo | GripperErrors | Encoder
