"""Where an arm starts, and how far and fast it may go."""

import math
from collections.abc import Sequence
from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from drivers.core.axis import AxisLimits
from drivers.core.settings import Address, HomeSpeed

Vector = Annotated[tuple[float, float, float], Strict(False)]
Pose = Annotated[tuple[float, float, float, float, float, float], Strict(False)]

UNIT_TOLERANCE = 1e-3
"""How far the length of a direction may be from 1 (assumption: three digits in a profile)."""

FAR_M, TURNED_RAD = 3.0, 2.0 * math.pi + 0.01
"""No arm's tool is farther off, and no rotation vector longer (assumption): millimetres or degrees are meant."""


def in_metres(key: str, pose: Sequence[float] | None) -> None:
    """Refuse a place, or a pose, that was written in millimetres or degrees."""
    if pose is not None and (math.hypot(*pose[:3]) > FAR_M or math.hypot(*pose[3:]) > TURNED_RAD):
        raise ValueError(f"{key} = {list(pose)} is farther than any arm reaches: write m and rad")


class ArmSettings(AxisLimits):
    """An arm on its controller; a make adds its own settings, and narrows `rate_hz` to what its controller sends.

    Poses are those of the tool's point in the base frame: x, y, z in metres and a rotation vector in radians.
    Positions are on the approach axis, which grows towards the object: its zero is `start_pose`, its direction
    `approach_axis`.
    """

    host: Address = Field(min_length=1)
    """Address of the controller."""
    start_pose: Pose
    """Where an approach begins, and where `Home` goes; moves on the axis keep its orientation."""
    approach_axis: Vector = (0.0, 0.0, -1.0)
    """Unit vector in the base frame towards the object (assumption: a table under the arm)."""
    rate_hz: float = Field(gt=0.0)
    """Rows a second."""
    travel_min_m: float = Field(-0.05, ge=-1.0, le=1.0)
    """Least position in metres, kept in the arm's process."""
    travel_max_m: float = Field(0.05, ge=-1.0, le=1.0)
    """Greatest position in metres, kept in the arm's process."""
    leash_m: float = Field(0.2, gt=0.0, le=1.0)
    """How far from `start_pose` a `Twist` may carry the tool, and from how far `Home` sets out (assumption)."""
    max_speed_m_s: float = Field(0.05, gt=0.0, le=0.25)
    """Greatest speed of the tool; above 0.25 m/s a collaborative arm asks for a risk assessment (ISO 10218-1)."""
    max_turn_rad_s: float = Field(0.5, gt=0.0, le=3.0)
    """Greatest angular speed of the tool (assumption)."""
    home_speed_m_s: HomeSpeed = Field(0.02, gt=0.0, le=0.25)
    """Speed of `Home` (assumption)."""
    acceleration_m_s2: float = Field(0.5, gt=0.0, le=5.0)
    """Acceleration of every motion; rad/s^2 for rotation (assumption: under half of a UR controller's 1.2)."""
    stop_m_s2: float = Field(3.0, gt=0.0, le=20.0)
    """Deceleration of a `Stop` (ur_rtde's own script stops at 3 m/s^2 after a contact)."""
    link_timeout_s: float = Field(0.1, ge=0.05, le=1.0)
    """How long the controller's time may stand still before the link counts as lost (measured: 50-100 ms)."""
    loop_timeout_s: float = Field(0.5, ge=0.05, le=5.0)
    """How long the program may not look at an arm that moves before the arm's process stops it. Assumption: more than
    the guard's bound on a late loop (`limits.late_s`, at most 0.3 s in the profiles), so that the guard acts first."""
    open_timeout_s: float = Field(12.0, ge=1.0, le=60.0)
    """Longest connection; ur_rtde itself waits 5 s for its script to run."""
    reconnect_s: float = Field(6.0, ge=0.0, le=60.0)
    """How long a lost link is tried again before the device has failed; 0 does not try (assumption)."""
    recover_s: float = Field(10.0, ge=1.0, le=60.0)
    """Longest recovery at `Home`; a UR's protective stop stays locked for 5 s (dashboard manual)."""
    realtime_priority: int = Field(10, ge=0, le=90)
    """SCHED_FIFO priority of the arm's process where the system allows it; 0 does not ask."""

    @model_validator(mode="after")
    def _in_its_units(self) -> Self:
        if abs(math.hypot(*self.approach_axis) - 1.0) > UNIT_TOLERANCE:
            raise ValueError(f"approach_axis has length {math.hypot(*self.approach_axis):.4g}, not 1")
        in_metres("start_pose", self.start_pose)
        return self
