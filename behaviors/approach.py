"""Approach at constant speed until a detector reports contact, stop, stand still: a part of a trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from behaviors.events import Contact
from behaviors.machine import Behavior, Row, StatePlan, from_mover, on
from drivers.core.messages import MoveAt, Stop


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
