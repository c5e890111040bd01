"""Slip near the border of a fingertip turns the tip back to its middle (Fernandez et al., section 4.3, proposed)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import Self

from pydantic import Field, model_validator

from behaviors.events import BorderLeft, BorderNear, SlipStarted
from behaviors.machine import StatePlan, from_mover, on
from behaviors.slip import RollSlip, RollSlipFactors, RollSlipSettings, StepSettings
from drivers.core.messages import Twist
from drivers.core.settings import DetectorName, Settings

MOVING = ("ROLLING", "HOLDING", "SLIPPING", "TURNING_BACK")
"""States in which the pressed tip moves, or is between two motions."""


class BorderTrialSettings(RollSlipSettings):
    """How a trial is run; of `sensors` the fingertip, without its steps."""

    border: DetectorName = "border"
    """Detector that tells where on the tip the contact is."""

    border_rad: float = Field(default=1.2, gt=0.0, le=1.57)
    """Angle beyond which the contact counts as lost. Assumption: a quarter turn, less half a patch."""

    roll_rad: float = Field(default=0.45, gt=0.0, le=1.5)
    """How far the tip rolls before it slips: slip detectors learn rolling in it."""

    roll_s: float = Field(default=1.5, gt=0.0, le=60.0)
    """How long."""

    slide_s: float = Field(default=3.0, gt=0.0, le=60.0)
    """How long what is held moves on the tip."""

    back_rad_s: float = Field(default=0.4, gt=0.0, le=3.0)
    """Speed of turning back."""


class BorderFactors(Settings):
    """What a trial varies: how the thing that is held moves. Here the arm moves the tip on a table instead."""

    begins_rad: float = Field(ge=-1.5, le=1.5)
    """Angle of the contact when it begins to slide."""

    turn_rad_s: float = Field(default=0.0, ge=-1.0, le=1.0)
    """How fast it moves towards a border meanwhile."""

    slide_m_s: float = Field(default=0.008, ge=0.0, le=0.1)
    """How fast it slides; 0 rolls without slipping."""

    keep: bool = True
    """Whether slip near a border turns the tip back."""

    @model_validator(mode="after")
    def _moves(self) -> Self:
        if self.turn_rad_s == 0.0 and self.slide_m_s == 0.0:
            raise ValueError("nothing moves: give turn_rad_s or slide_m_s")
        return self


class KeepOnTip(RollSlip):
    """Touch, press, roll; what is held slides on the tip; where slip is detected near a border, turn the tip back.

    Neither slip in the middle nor rolling near a border does it: both must be reported.
    """

    settings: BorderTrialSettings

    def __init__(
        self, settings: BorderTrialSettings, factors: BorderFactors, detectors: frozenset[str]
    ) -> None:
        self._factors, self._border = factors, settings.border if settings.border in detectors else ""
        sensor = settings.sensors["fingertip"]
        acting = {settings.border, sensor.ours or "ours"} if factors.keep else set()
        if missing := ", ".join(sorted(acting - detectors)):
            raise ValueError(f"keep = true waits for {missing}, which is not there; or write keep = false")
        turn_rad = math.copysign(settings.roll_rad, factors.begins_rad or factors.turn_rad_s)
        steps = (
            StepSettings(do="roll", duration_s=settings.roll_s, turn_rad=turn_rad),
            StepSettings(do="hold", duration_s=0.1),
            StepSettings(do="slip", duration_s=settings.slide_s, speed_m_s=factors.slide_m_s or 1e-9),
            StepSettings(do="hold", duration_s=0.5),
        )
        own = sensor.model_copy(update={"steps": steps, "tilt_rad": factors.begins_rad - turn_rad})
        self._near_rad, self._slipping = 0.0, False
        given = settings.model_copy(update={"sensors": {"fingertip": own}})
        super().__init__(given, RollSlipFactors(sensor="fingertip"), detectors)
        self.acts_on |= acting

    def _planned(self) -> Mapping[str, StatePlan]:
        planned = super()._planned()
        back_s = math.pi / self.settings.back_rad_s + self.settings.motion_timeout_s
        return {**planned, "TURNING_BACK": replace(planned["SLIPPING"], deadline_s=back_s)}

    def _armed(self, step: int) -> frozenset[str]:
        return super()._armed(step) | ({self._border} - {""} if step >= 0 else frozenset())

    def of_ours(self) -> bool:
        """Whether the event is of our slip detector."""
        return self.came_from(self.run.ours or "")

    def of_border(self) -> bool:
        """Whether it is of the border's."""
        return self.came_from(self._border)

    def slips_near(self) -> bool:
        """Whether slip begins near a border, and is to be answered."""
        return self._factors.keep and self.of_ours() and self._near_rad != 0.0

    def nears_slipping(self) -> bool:
        """Whether what slips comes near a border, and is to be answered."""
        return self._factors.keep and self.of_border() and self._slipping

    def note(self) -> None:
        """Where the contact is, or whether it slips."""
        if isinstance(self.event, BorderNear):
            self._near_rad = self.event.angle_rad
        elif isinstance(self.event, BorderLeft):
            self._near_rad = 0.0
        else:
            self._slipping = isinstance(self.event, SlipStarted)

    def cut_slide(self) -> None:
        """The rest of the slide does not turn the tip any more."""
        left_s = max(0.0, self.settings.slide_s - (self.event.t_s - self._entered_s))
        self._turned_rad -= self._factors.turn_rad_s * left_s

    def enter_SLIPPING(self) -> None:
        """Along the table while the contact wanders over the tip."""
        along_m_s = self._factors.slide_m_s + self.settings.radius_m * self._factors.turn_rad_s
        self._twist(along_m_s, self._factors.turn_rad_s, self.settings.slide_s)

    def enter_TURNING_BACK(self) -> None:
        """By the angle that was reported; what is held slides on meanwhile."""
        turn_rad_s = -math.copysign(self.settings.back_rad_s, self._near_rad)
        along_m_s = self._factors.slide_m_s + self.settings.radius_m * turn_rad_s
        self._twist(along_m_s, turn_rad_s, abs(self._near_rad) / self.settings.back_rad_s)

    def _twist(self, along_m_s: float, turn_rad_s: float, duration_s: float) -> None:
        self._turned_rad += turn_rad_s * duration_s
        self.command(Twist(self.settings.mover, (along_m_s, 0.0, 0.0, 0.0, turn_rad_s, 0.0), duration_s))

    table = (
        *RollSlip.table,
        on(
            "slip_started",
            "SLIPPING",
            "TURNING_BACK",
            slips_near,
            do=(note, cut_slide),
            label="near a border",
        ),
        on("border_near", "SLIPPING", "TURNING_BACK", nears_slipping, do=(note, cut_slide), label="slipping"),
        on("border_near", MOVING, None, of_border, do=note),
        on("border_left", MOVING, None, of_border, do=note),
        on("slip_started", MOVING, None, of_ours, do=note),
        on("slip_ended", MOVING, None, of_ours, do=note),
        on("reached", "TURNING_BACK", "STOPPED", from_mover),
        on("resumed", "TURNING_BACK", "LIFTING", do=RollSlip.conclude_interrupted),
    )
