"""The outcome of a command, from the sequence of the gripper's states. Pure."""

import math

from drivers.core.messages import (
    Command,
    Grip,
    Gripped,
    Home,
    Reached,
    Release,
    Stalled,
    Standstill,
    Status,
    Stop,
)
from drivers.gripper.state import GripFinding, GripperState
from drivers.gripper.units import JawUnits

CALIBRATION_S = 32.0
"""Longest calibration: the gripper itself gives up after 30 s (docs/reference/grippers.md)."""

STILL_S = 0.05
"""A position that does not change for this long stands still, where no finding reports it (assumption)."""

STUCK_COUNTS = 1
"""A position that has changed by no more has not changed: the resolution of what the gripper reports."""

FAULTS = {
    "over_temperature": "it is too hot",
    "watchdog": "its watchdog tripped, for nothing came from the host in time",
    "estop": "its emergency stop is up",
}
"""Faults in a state, and what they mean."""


class GripperOutcome:
    """Follows the last command of one gripper.

    A state counts only where it was requested after the command was sent. The jaws have an object when
    something holds them for `hold_s`; the bits of its direction are not trusted. Jaws that stood free where they had
    been sent, and that a `Grip` does not move, have none: they are stuck. What the jaws do is followed apart from the
    last command: a `Stop` or a `Home` that drives nothing leaves a grip a grip.

    Args:
        hold_s: How long something must hold the jaws.

    Attributes:
        busy: Whether an answer to the last command is still due.
        faulty: Whether the last state had a fault.
    """

    def __init__(self, device: str, units: JawUnits, hold_s: float) -> None:
        self.faulty = False
        self._calibrated = False  # in the last state; a `Home` that drives begins without
        self._device = device
        self._units = units
        self._hold_s = hold_s
        self.forget()

    def forget(self) -> None:
        """Forget all commands."""
        self.busy = False
        self._command: Command | None = None
        self._sent_s = -math.inf
        self._held_s: float | None = None  # since when something holds the jaws
        self._gripped: bool | None = None  # of the last `Gripped`
        self._still_s = math.inf
        self._state: GripperState | None = None
        self._driving: Command | None = None  # the last command that drove the jaws
        self._driven_s = -math.inf
        self._free: int | None = None  # where they stood free before, with nothing between them
        self._under_way = False  # whether the jaws have not yet come to where it ends

    def begin(self, command: Command, sent_s: float, *, drives: bool) -> None:
        """A command has been sent at bench time `sent_s`; older ones are no longer reported on.

        Args:
            drives: Whether it drives the jaws: a `Stop` of jaws at rest and a `Home` of known ends only ask.
        """
        self._command, self._sent_s, self.busy = command, sent_s, True
        self._gripped, self._still_s = None, math.inf
        if drives:
            self._calibrated = self._calibrated and not isinstance(command, Home)
            self._free = self._stands_free()
            self._driving, self._driven_s, self._under_way = command, sent_s, True
            self._held_s = self._state = None

    @property
    def resting(self) -> bool:
        """Whether a `Stop` has nothing to stop: the jaws hold an object or a position, or the drive sleeps.

        The answer to a `Stop` or `Home` may be due still: two stops in a row find the same jaws.
        """
        state = self._state
        moving = state is not None and state.finding is GripFinding.MOVING
        return not self._under_way and not (isinstance(self._driving, Grip) and moving)

    @property
    def only_asks(self) -> Home | None:
        """A `Home` that had nothing to clear, as far as was known, while its answer is due."""
        home = self._command if self.busy and self._driving is not self._command else None
        return home if isinstance(home, Home) else None

    @property
    def _id(self) -> int:
        return 0 if self._command is None else self._command.id

    def settled(self, state: GripperState) -> bool:
        """Whether `push` of this state, without a fault, would change nothing, however often it comes."""
        return not (self.busy or self.faulty or state.object) and state == self._state

    def push(self, asked_s: float, state: GripperState, fault: bool) -> list[Status]:
        """Take a state that was requested at bench time `asked_s`."""
        newly_faulty, self.faulty = fault and not self.faulty, fault
        fresh, stops = asked_s > self._sent_s, isinstance(self._command, Stop)
        driven, lost = asked_s > self._driven_s, False
        if driven:
            lost, self._calibrated = self._calibrated and not state.calibrated, state.calibrated
        statuses = []
        if newly_faulty or lost or (fresh and fault and self.busy and not stops):
            statuses.append(self._broken(asked_s, state, lost))
            if not stops:
                self.forget()
        before, found = self._state, None
        if driven:
            self._state, found = state, self._found(asked_s, state)
            # What holds jaws that look for their ends is an end.
            there = state.calibrated if isinstance(self._driving, Home) else found is not None
            self._under_way = self._under_way and not there
            if fault or lost:
                # Whatever it did, the drive sleeps now.
                self._driving, self._under_way = None, False
        if not fresh:
            return statuses
        match self._command:
            case Stop():
                statuses += self._stopping(asked_s, before, state, found is not None and not fault)
            case Home():
                statuses += self._homing(asked_s, state)
            case Grip():
                statuses += self._gripping(asked_s, state, found)
            case Release():
                statuses += self._releasing(asked_s, state, found)
        return statuses

    def _broken(self, t_s: float, state: GripperState, lost: bool) -> Status:
        if lost:
            lost_ends = (
                "it no longer knows its ends, as after a power failure, and whatever it held may be loose"
            )
            return Stalled(t_s, self._device, f"{lost_ends}; send Home", command_id=self._id)
        if state.trouble:
            return Stalled(t_s, self._device, f"{state.trouble}; send Home", command_id=self._id)
        active = [text for name, text in FAULTS.items() if getattr(state, name)]
        reason = " and ".join(active) or "it reports a fault of its motor or supply"
        return Stalled(
            t_s, self._device, f"{reason}, and whatever it held is loose; send Home", command_id=self._id
        )

    def _homing(self, t_s: float, state: GripperState) -> list[Status]:
        if self.busy and state.calibrated:
            self.busy = False
            width_m = self._units.width_m(state.position)
            return [Reached(t_s, self._device, width_m, command_id=self._id)]
        if self.busy and t_s - self._sent_s > CALIBRATION_S:
            self.busy = self._under_way = False
            reason = "it gave up its calibration; are its jaws free, and is it supplied with 24 V?"
            return [Stalled(t_s, self._device, reason, command_id=self._id)]
        return []

    def _gripping(self, t_s: float, state: GripperState, found: bool | None) -> list[Status]:
        if found is None or found is self._gripped:
            return []
        self._gripped, self.busy = found, False
        if found and self._free is not None and abs(state.position - self._free) <= STUCK_COUNTS:
            reason = f"{self._held_at(state)}, where they stood before; they grip nothing"
            return [Stalled(t_s, self._device, reason, command_id=self._id)]
        width_m, force_n = self._units.width_m(state.position), self._units.force_n(state.current_ma)
        return [Gripped(t_s, self._device, found, width_m, force_n, command_id=self._id)]

    def _releasing(self, t_s: float, state: GripperState, found: bool | None) -> list[Status]:
        if found is None or not self.busy:
            return []
        self.busy = False
        if found:
            return [Stalled(t_s, self._device, self._held_at(state), command_id=self._id)]
        width_m = self._units.width_m(state.position)
        return [Reached(t_s, self._device, width_m, command_id=self._id)]

    def _stopping(
        self, t_s: float, before: GripperState | None, state: GripperState, there: bool
    ) -> list[Status]:
        if math.isinf(self._still_s) or before is None or state.position != before.position:
            self._still_s = t_s
        if not self.busy or not (there or t_s - self._still_s >= STILL_S):
            return []
        self.busy = self._under_way = False
        width_m = self._units.width_m(state.position)
        return [Standstill(t_s, self._device, width_m, command_id=self._id)]

    def _held_at(self, state: GripperState) -> str:
        return f"something holds its jaws at {self._units.width_m(state.position) * 1e3:.1f} mm"

    def _stands_free(self) -> int | None:
        """Where the jaws stand, if nothing holds them where they were sent; None where that is not known. Jaws that
        were stopped stand wherever they were, at an object perhaps."""
        state = self._state
        if state is None or state.finding is not GripFinding.AT_POSITION or isinstance(self._driving, Stop):
            return None
        return state.position

    def _found(self, t_s: float, state: GripperState) -> bool | None:
        """Whether an object stopped the jaws; None while nothing has."""
        if not state.object:
            self._held_s = None
            return False if state.finding is GripFinding.AT_POSITION else None
        self._held_s = t_s if self._held_s is None else self._held_s
        return True if t_s - self._held_s >= self._hold_s else None
