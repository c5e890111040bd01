"""What a Franka arm has beside what any arm has."""

from typing import Self

from pydantic import Field, model_validator

from drivers.arm.settings import ArmSettings

CYCLES_HZ = 1000.0
"""The controller's cycles a second (libfranka's documentation)."""


class FrankaArmSettings(ArmSettings):
    """A Franka arm behind its control interface (FCI), which Desk must have activated."""

    rate_hz: float = Field(CYCLES_HZ, ge=100.0, le=CYCLES_HZ)
    """Rows a second: every cycle of the controller, or every second, fourth … of them."""
    contact_force_n: float = Field(20.0, gt=0.0, le=100.0)
    """Force on the tool from which the controller itself stops with a reflex (assumption;
    the guard's `force_n` acts before)."""
    contact_torque_n_m: float = Field(20.0, gt=0.0, le=100.0)
    """Torque on a joint from which it does (franky's default)."""
    enforce_realtime: bool = True
    """Whether a host without a real-time kernel is refused, as the maker asks. False: its control loop may miss
    cycles, which the robot answers with a stop."""

    @model_validator(mode="after")
    def _whole_cycles(self) -> Self:
        if CYCLES_HZ % self.rate_hz:
            raise ValueError(
                f"rate_hz = {self.rate_hz:g} is no whole part of {CYCLES_HZ:g}: take 1000, 500, 250 or 200"
            )
        return self
