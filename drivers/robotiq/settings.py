"""Which Robotiq gripper, and where."""

from typing import Annotated, Self

from pydantic import Field, Strict, model_validator

from drivers.core.links import SerialPort
from drivers.robotiq import codec
from drivers.robotiq.codec import MODELS, ModelName, RobotiqUnits


class RobotiqSettings(SerialPort):
    """A Robotiq gripper; `port` is `socket://HOST:63352`, with the address of the arm's controller."""

    model: ModelName = "2f-85"
    """Which: `2f-85`, `2f-140` or `hand-e`."""
    closed_width_m: float = Field(default=0.0, ge=0.0, le=0.2)
    """Opening between the fingers where the jaws are closed (0: bare fingertips that touch)."""
    open_width_m: float | None = Field(default=None, gt=0.0, le=0.4)
    """The same where they are open; None is the model's stroke more than closed (data sheet)."""
    counts: Annotated[tuple[int, int], Strict(False)] | None = None
    """Positions that it tells where the jaws are open and closed; None is the model's (assumption: measure yours)."""
    max_speed_m_s: float = Field(default=0.1, gt=0.0, le=0.3)
    """Greatest rate of the opening (assumption: two thirds of what a 2F-85 can do)."""
    max_force_n: float | None = Field(default=None, gt=0.0, le=300.0)
    """Greatest force that may be asked for; None is the model's."""
    poll_interval_s: float = Field(default=0.02, ge=0.002, le=0.1)
    """Time between two states while it moves, holds or is subscribed (assumption)."""
    idle_interval_s: float = Field(default=0.2, ge=0.002, le=5.0)
    """The same otherwise (assumption)."""
    reply_timeout_s: float = Field(default=1.0, gt=0.0, le=10.0)
    """Silence after which it has failed: TCP loses nothing (assumption)."""
    object_hold_s: float = Field(default=0.03, ge=0.0, le=1.0)
    """How long something must hold the jaws to be an object (assumption: as of the SSG-48)."""

    @model_validator(mode="after")
    def _it_opens(self) -> Self:
        units = self.units()
        if units.open_width_m <= units.closed_width_m:
            raise ValueError(f"open_width_m = {units.open_width_m:g} is not above closed_width_m")
        if self.counts is not None and not 0 <= self.counts[0] < self.counts[1] <= codec.COUNTS:
            raise ValueError(
                f"counts = {list(self.counts)}: write the open one first, from 0 to {codec.COUNTS}"
            )
        return self

    @property
    def forces_n(self) -> tuple[float, float]:
        """Least and greatest force that may be asked for."""
        least_n, most_n = MODELS[self.model].force_n
        return least_n, min(most_n, self.max_force_n or most_n)

    def units(self) -> RobotiqUnits:
        """Counts of this gripper with these fingers."""
        model = MODELS[self.model]
        open_m = self.closed_width_m + model.stroke_m if self.open_width_m is None else self.open_width_m
        return RobotiqUnits(model, self.closed_width_m, open_m, self.counts or model.counts)
