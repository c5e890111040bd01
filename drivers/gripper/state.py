"""What a gripper says of itself, whatever its make."""

from dataclasses import dataclass
from enum import IntEnum


class GripFinding(IntEnum):
    """What became of a motion."""

    MOVING = 0
    OBJECT_CLOSING = 1
    OBJECT_OPENING = 2
    AT_POSITION = 3


@dataclass(frozen=True, slots=True)
class GripperState:
    """State of the gripper.

    Attributes:
        position: 0 open to 255 closed; means nothing before calibration.
        current_ma: Of the motor: negative closes, positive opens. What a gripper presses with, in counts of its own,
            where it tells no current.
        going: It was told to move.
        calibrated: It knows its ends.
        trouble: Another fault, in words.
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
    trouble: str = ""

    @property
    def object(self) -> bool:
        """Something holds the jaws."""
        return self.finding in (GripFinding.OBJECT_CLOSING, GripFinding.OBJECT_OPENING)
