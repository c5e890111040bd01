"""What a Universal Robots arm has beside what any arm has: its controller's cycle, its tool, its watchdog."""

from typing import Literal, Self

from pydantic import Field, model_validator

from drivers.arm.settings import ArmSettings, Pose, Vector, in_metres

CYCLES_HZ = 500.0
"""An e-Series controller's cycles a second (RTDE guide)."""


class UrArmSettings(ArmSettings):
    """A UR arm on its controller; poses as the pendant shows them."""

    rate_hz: float = Field(CYCLES_HZ, ge=25.0, le=CYCLES_HZ)
    """Rows a second: the controller's cycle (e-Series 500 Hz, RTDE guide), or every second, third … of them."""
    model: str = ""
    """What its dashboard answers to `get robot model`, as "UR3", "UR5" or "UR10" (an e-Series too): another arm is
    refused before anything moves; "" compares nothing."""
    tcp_offset: Pose | None = None
    """The tool's point in the flange's frame: metres and rotation vector, as the pendant's TCP page shows it. An arm
    whose controller has another one is refused, or given this one (`tool`); None records the controller's, and
    compares nothing."""
    payload_kg: float | None = Field(None, ge=0.0, le=50.0)
    """Mass that the arm carries, likewise: a wrong one shifts the stream of forces."""
    payload_cog_m: Vector | None = None
    """Its centre of gravity in the flange's frame, likewise."""
    tool: Literal["compare", "set"] = "compare"
    """"set" gives a controller with another tool the profile's, and its own back at closing."""
    watchdog_hz: float = Field(10.0, ge=5.0, le=50.0)
    """The controller stops the program when commands come more rarely (client: 10 Hz)."""

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        if CYCLES_HZ % self.rate_hz:
            raise ValueError(
                f"rate_hz = {self.rate_hz:g} is no whole part of {CYCLES_HZ:g}: take 500, 250 or 125"
            )
        in_metres("tcp_offset", self.tcp_offset)
        in_metres("payload_cog_m", self.payload_cog_m)
        if self.tool == "set" and (self.tcp_offset, self.payload_kg, self.payload_cog_m) == (
            None,
            None,
            None,
        ):
            raise ValueError('tool = "set" needs tcp_offset, payload_kg or payload_cog_m')
        return self
