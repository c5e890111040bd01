"""Approach at constant speed until a detector reports contact, stop, stand still; and the trials of an arm's tip."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from pydantic import Field

from behaviors.events import Contact
from behaviors.machine import Behavior, Row, StatePlan, from_mover, on
from drivers.core.messages import Home, MoveAt, Stop, Twist
from drivers.core.settings import DeviceName, Settings, StreamName


class Approaching(Behavior):
    """What `approaching` asks and commands; the subclass calls `approach` once, where it makes its plans."""

    def approach(
        self, detector: str, velocity_m_s: float, limit_m: float, length_m: float, plan: StatePlan
    ) -> StatePlan:
        """Says how the approach is made; returns what its state needs.

        Args:
            detector: Its contact ends it.
            velocity_m_s: On the mover's axis, with its direction.
            limit_m: Where the device ends an approach without contact, on the mover's axis.
            length_m: From where it begins.
            plan: Of the state; its deadline is for a device that reports nothing, and counts from the limit.
        """
        self._touch, self._velocity_m_s, self._limit_m = detector, velocity_m_s, limit_m
        return replace(plan, deadline_s=length_m / abs(velocity_m_s) + plan.deadline_s)

    def touched(self) -> bool:
        """Whether the contact is the acting detector's."""
        return isinstance(self.event, Contact) and self.came_from(self._touch)

    def conclude_no_contact(self) -> None:
        """The approach ended at its limit."""
        self.conclude("no_contact", f"no contact up to {self._limit_m:.6g} m")

    def go_until_contact(self) -> None:
        """Towards what is to be touched, bounded by the device; for the approach's `enter_…`."""
        self.command(MoveAt(self._mover, self._velocity_m_s, self._limit_m))

    def enter_STOPPING(self) -> None:
        """Stop at once."""
        self.conclude("contact")
        self.command(Stop(self._mover))


def approaching(approach: str, *, stopped: str, missed: str) -> Sequence[Row]:
    """Rows: `approach` until contact, `STOPPING`, then `stopped`; `missed` where the approach ends at its limit."""
    return (
        on("contact", approach, "STOPPING", Approaching.touched),
        on("reached", approach, missed, from_mover, do=Approaching.conclude_no_contact),
        on("standstill", "STOPPING", stopped, from_mover),
    )


def see_that_it_leads_on(start_m: float, approach_limit_m: float) -> None:
    """The guard foresees and bounds the force of what goes farther along an axis, and lets go back what was stopped.

    Raises:
        ValueError: an approach would go back.
    """
    if approach_limit_m <= start_m:
        raise ValueError(
            f"approach_limit_m = {approach_limit_m:g} is not beyond start_m = {start_m:g}: positions grow towards the"
            " object; turn the stage round, or an arm's approach_axis"
        )


class TipTrialSettings(Settings):
    """The arm, and how it goes down and up."""

    mover: DeviceName = "arm"
    """Device that carries and turns the tip."""

    pose_stream: StreamName = "arm.pose"
    """Where its tool is (m, rotation vector in rad)."""

    descend_m_s: float = Field(default=0.002, gt=0.0, le=0.05)
    """Speed of descent, and of pressing on. Assumption: the paper prints none."""

    descend_limit_m: float = Field(default=0.006, gt=0.0, le=1.0)
    """Where a descent without contact ends, on the approach axis."""

    lift_m_s: float = Field(default=0.01, gt=0.0, le=0.25)
    """Speed of lifting off."""

    motion_timeout_s: float = Field(default=30.0, gt=0.0, le=600.0)
    """Longest stay in any state that waits for the mover, beyond what its motion takes."""

    home_timeout_s: float = Field(default=150.0, gt=0.0, le=600.0)
    """Longest homing. An arm turns home as slowly as it moves home: 1.5 rad at 0.02 rad/s take 75 s."""


class TipTrial(Approaching):
    """What such a trial needs and commands."""

    settings: TipTrialSettings

    def descent(self, detector: str, plan: StatePlan) -> StatePlan:
        """What the descent needs, until the contact of a detector; as `approach`."""
        limit_m = self.settings.descend_limit_m
        return self.approach(detector, self.settings.descend_m_s, limit_m, limit_m, plan)

    def enter_DESCENDING(self) -> None:
        """Towards the table, bounded by the device."""
        self.go_until_contact()

    def ending(self) -> Mapping[str, StatePlan]:
        """What the end needs: off the table, turned as it is, and to where the next trial begins."""
        settings = self.settings
        off = MoveAt(settings.mover, -settings.lift_m_s, 0.0)
        return {
            "LIFTING": StatePlan(settings.motion_timeout_s, commands=[off]),
            "RETURNING": StatePlan(settings.home_timeout_s, commands=[Home(settings.mover)]),
        }

    def turn(self, turn_rad: float, speed_rad_s: float) -> None:
        """About the tip's own axis. From rest a tool goes as far as its twist times the duration: the ramp down comes
        after it."""
        rate_rad_s = math.copysign(speed_rad_s, turn_rad)
        self.command(Twist(self.settings.mover, (0.0, 0.0, 0.0, 0.0, rate_rad_s, 0.0), turn_rad / rate_rad_s))
