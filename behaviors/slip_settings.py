"""What B8's trials are made of: steps of the pressed tip, sensors with their detectors, and how a trial is run."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal, Self

from pydantic import Field, Strict, model_validator

from behaviors.tip import TipTrialSettings
from drivers.core.settings import DetectorName, Settings, StreamName

SensorName = Literal["fingertip", "flexible_finger", "barrett_finger", "wrist", "dsa"]


class StepSettings(Settings):
    """One thing that the pressed tip does."""

    do: Literal["hold", "load", "roll", "slip"]
    """Hold still, drag without slipping, roll on the table, or slide along it."""

    duration_s: float = Field(gt=0.0, le=60.0)
    """How long."""

    turn_rad: float = Field(default=0.0, ge=-3.0, le=3.0)
    """Angle to roll by, for `roll`."""

    speed_m_s: float = Field(default=0.0, ge=-0.25, le=0.25)
    """Speed along the table, either way, for `load` and `slip`."""

    @model_validator(mode="after")
    def _complete(self) -> Self:
        turns, goes = self.do == "roll", self.do in ("load", "slip")
        if turns != (self.turn_rad != 0.0) or goes != (self.speed_m_s != 0.0):
            raise ValueError("a roll needs turn_rad, a load and a slip speed_m_s: each its own, and not 0")
        return self


class SensorRunSettings(Settings):
    """What one sensor is put through, and its detectors."""

    stream: StreamName
    """What it sends."""

    channel: int | None = Field(default=None, ge=0, le=4095)
    """Channel in which slip is looked for; None takes the one that decides in each block."""

    forces_stream: StreamName | None = None
    """Its calibrated forces, where there are such; recorded, and watched for overload in every motion."""

    touch: DetectorName
    """Detector that sees the table: it ends the descent."""

    paper: DetectorName
    """The paper's slip detector on this sensor."""

    ours: DetectorName
    """Ours."""

    listen: Literal["rest", "motion"] = "rest"
    """From when the slip detectors are armed: from rest in the air, or from the first step in which the pressed tip
    moves. A detector that learns the noise learns it there."""

    tilt_rad: float = Field(default=0.0, ge=-1.5, le=1.5)
    """Angle of the tip at touch, about base y."""

    press_m: float = Field(gt=0.0, le=0.01)
    """How far to press on after the touch."""

    steps: Annotated[tuple[StepSettings, ...], Strict(False), Field(min_length=1)]
    """What follows, in order; never the same twice in a row."""

    @model_validator(mode="after")
    def _in_turn(self) -> Self:
        if any(step.do == after.do for step, after in pairwise(self.steps)):
            raise ValueError("steps: two of a kind follow each other; make one of them, or hold in between")
        return self


class RollSlipSettings(TipTrialSettings):
    """How a trial is run."""

    position_stream: StreamName = "arm.position"
    """Where it is on the approach axis (m)."""

    force_stream: StreamName = "arm.force"
    """What acts on its tool (N)."""

    measures: Annotated[tuple[StreamName, ...], Strict(False)] = ()
    """Streams that are recorded in every trial, beside those of its sensor."""

    sensors: dict[SensorName, SensorRunSettings] = Field(min_length=1)
    """What is done with which sensor."""

    radius_m: float = Field(default=0.012, gt=0.0, le=0.2)
    """Radius of the tip's cylinder, about whose axis the arm turns the tool: rolling moves it by radius x angle."""

    stop_on_slip: bool = False
    """Whether the arm stops at once when the `reflex` detector reports slip; the paper's never does."""

    reflex: Literal["paper", "ours"] = "ours"
    """Whose detector that is."""

    zero_s: float = Field(default=0.2, gt=0.0, le=10.0)
    """Time for the arm's force sensor to be zeroed in (assumption)."""

    rest_s: float = Field(default=0.93, gt=0.0, le=600.0)
    """Wait before the descent; with a 3 mm gap at 2 mm/s the contact is at the paper's 2.43 s (Fig. 8)."""

    tilt_rad_s: float = Field(default=0.2, gt=0.0, le=3.0)
    """Speed of tilting the tip in the air."""

    stopped_s: float = Field(default=0.5, gt=0.0, le=60.0)
    """How long is recorded after a stop on slip."""

    missed_after_s: float = Field(default=0.75, gt=0.0, le=60.0)
    """A slip that is not detected by then is missed: the shortest that the paper shows lasts so long (Fig. 15)."""


class RollSlipFactors(Settings):
    """What a trial varies."""

    sensor: SensorName
    """Which sensor the tip carries. On a real bench it is changed by hand, between runs: no run asks for it."""
