"""Where the stage is, how far and fast it may go, which commands it takes; approach axis ⇄ device counts. Pure.

For driver and mock alike."""

import math
from typing import Self

from pydantic import Field, model_validator

from drivers.core.axis import AxisLimits
from drivers.core.errors import CommandError
from drivers.core.links import SerialPort
from drivers.core.messages import Command, Home, Listen, MoveAt, MoveTo, Stop
from drivers.zaber_stage import codec

RENEWAL_S = 0.05
"""How long a stage at speed must be able to go on before it is sent on: five looks at its position (assumption)."""

NOT_HOMED = "it does not know where it is; send Home first"
"""Why a stage that has lost its reference refuses every motion but `Home`."""

ROUNDING = 1e-6
"""Microsteps that a length may be off by arithmetic alone and still count as whole."""


class StageLimits(AxisLimits):
    """How a stage is mounted, how far and how fast it may go: the same for a real one and a simulated one.

    Positions are on the approach axis, which grows away from the home end, towards the object: `origin_m` from that
    end is its zero. The other way round `Home`, which takes load away, would press the object.
    """

    microstep_m: float = Field(default=codec.MICROSTEP_M, gt=0.0, le=1e-4)
    """Metres per microstep (data sheet; `codec.MICROSTEP_M`)."""
    travel_m: float = Field(default=0.0254, gt=0.0, le=3.0)
    """Length of the rail in metres (data sheet: a stage of one inch). A real stage whose own limit disagrees is
    refused, for its microstep is another one."""
    origin_m: float = Field(default=0.0, ge=0.0, le=3.0)
    """Distance in metres from the home end to zero on the approach axis; rounded to a whole microstep."""
    travel_min_m: float = Field(default=0.0, ge=-3.0, le=3.0)
    """Least position in metres; set in the device as well."""
    travel_max_m: float = Field(default=0.0254, ge=-3.0, le=3.0)
    """Greatest position in metres; set in the device as well."""
    max_speed_m_s: float = Field(default=0.025, gt=0.0, le=2.0)
    """Greatest speed in m/s; set in the device as well (assumption: twice the paper's fastest approach)."""

    @model_validator(mode="after")
    def _on_the_rail(self) -> Self:
        first_m, last_m = self.origin_m + self.travel_min_m, self.origin_m + self.travel_max_m
        if first_m < -ROUNDING * self.microstep_m:
            raise ValueError(
                f"travel_min_m = {self.travel_min_m:g} is {-first_m:g} m beyond the home end; change it, or check"
                " origin_m"
            )
        if last_m > self.travel_m + ROUNDING * self.microstep_m:
            raise ValueError(
                f"travel_max_m = {self.travel_max_m:g} is {last_m:g} m from the home end, but travel_m is"
                f" {self.travel_m:g}; change it, or check origin_m and the data sheet"
            )
        return self

    def valid(self, device: str, command: Command) -> Command:
        """The command as it will be sent: too great a speed is clamped.

        Raises:
            CommandError: not for a stage, not finite or out of range.
        """
        match command:
            case Home() | Stop() | Listen():
                return command
            case MoveAt() | MoveTo():
                return self.checked(device, command)
        raise CommandError(device, f"applying {command}", "a stage only moves", "send it to another device")


class ZaberStageSettings(SerialPort, StageLimits):
    """A stage on a serial port, at its factory's line speed by default."""

    address: int = Field(default=1, ge=1, le=99)
    """Device number on the line (assumption: the factory default)."""
    position_interval_s: float = Field(default=0.01, ge=0.001, le=1.0)
    """Time in seconds between two polls of the position while it moves or is subscribed."""
    idle_interval_s: float = Field(default=0.2, ge=0.001, le=10.0)
    """The same while it stands without a subscriber: how soon a dead link is noticed (assumption)."""
    retry_s: float = Field(default=0.05, gt=0.0, le=5.0)
    """When a question is asked again, in seconds (assumption: ten times an exchange at 115,200 baud)."""
    reply_timeout_s: float = Field(default=0.5, gt=0.0, le=30.0)
    """Silence in seconds after which the device has failed (assumption: ten questions)."""


class Mounting:
    """Turns positions on the approach axis into what the device counts, and back.

    `counts` are whole microsteps on the approach axis, from its zero.
    """

    def __init__(self, settings: StageLimits) -> None:
        self._microstep_m = settings.microstep_m
        self._origin = round(settings.origin_m / settings.microstep_m)
        self.lowest = self.at_least(settings.travel_min_m)
        self.highest = self.at_most(settings.travel_max_m)

    def at_most(self, position_m: float) -> int:
        """The greatest count that does not lie beyond a position."""
        return math.floor(position_m / self._microstep_m + ROUNDING)

    def at_least(self, position_m: float) -> int:
        """The least count that does not lie below a position."""
        return math.ceil(position_m / self._microstep_m - ROUNDING)

    def nearest(self, position_m: float) -> int:
        """The count nearest to a position, inside the travel."""
        return min(max(round(position_m / self._microstep_m), self.lowest), self.highest)

    def target(self, command: MoveAt | MoveTo) -> int:
        """The count where a motion ends."""
        if isinstance(command, MoveTo):
            return self.nearest(command.position_m)
        forward = command.velocity_m_s > 0.0
        return self.at_most(command.limit_m) if forward else self.at_least(command.limit_m)

    def ahead(self, here: int, target: int, blind_travel_m: float) -> int:
        """The count, on the way from `here` to a target, to which the device may be sent unsupervised."""
        reach = max(1, self.at_most(blind_travel_m))
        return min(target, here + reach) if target >= here else max(target, here - reach)

    def position_m(self, counts: int) -> float:
        """Metres on the approach axis."""
        return counts * self._microstep_m

    def device(self, counts: int) -> int:
        """The device position of a count."""
        return self._origin + counts

    def counts(self, device: int) -> int:
        """The count of a device position."""
        return device - self._origin

    def limits(self) -> dict[str, int]:
        """The device's limit settings for the travel."""
        return {"limit.min": self.device(self.lowest), "limit.max": self.device(self.highest)}

    def refusal(self, command: MoveAt | MoveTo, here: int, acceleration_m_s2: float) -> str:
        """Why a stage that knows where it is refuses a valid motion, or "".

        Args:
            here: Where it is, in counts.
            acceleration_m_s2: At which it brakes.
        """
        target = self.target(command)
        speed_m_s = abs(command.velocity_m_s) if isinstance(command, MoveAt) else command.speed_m_s
        forward = isinstance(command, MoveTo) or command.velocity_m_s > 0.0
        if isinstance(command, MoveAt) and (here > target if forward else here < target):
            return f"it is beyond the limit already, at {self.position_m(here):.6f} m"
        needed_m = speed_m_s**2 / (2.0 * acceleration_m_s2) + speed_m_s * RENEWAL_S
        if self.ahead(here, target, command.blind_travel_m) != target and needed_m > command.blind_travel_m:
            return (
                f"a stage at {speed_m_s:g} m/s needs {needed_m:.2g} m to brake and be sent on in time, but"
                f" limits.blind_travel_m is {command.blind_travel_m:g}; give it more, or go slower"
            )
        return ""
