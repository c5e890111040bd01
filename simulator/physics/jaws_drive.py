"""The gripper's own drive: loops at 5 kHz, its finding of objects, its calibration. In hardware there, so here."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from drivers.can_gripper.units import MOST_MA, STROKE_M, TICKS_PER_M
from drivers.core.clock import last_tick
from drivers.core.messages import Floats
from drivers.gripper.state import GripFinding
from simulator.physics import jaws_kernel as kernel
from simulator.physics.stage_axis import sane

STIFFEST_N_M = 1e6
"""Stiffest object. With its stiffness k and damping d, k T^2 / m + 2 d T / m is 0.5: the semi-implicit step of T on the
jaws' mass m is unstable from 4 on, and gives a spring 1 / (1 - k T^2 / 4 m) of its energy back."""

OBJECT_N_S_M = 20.0
"""Damping of what the jaws squeeze (assumption: a fifth of critical with the jaws' mass)."""

MASS_KG = 0.1
"""What the motor moves, as seen at the opening. Assumption: rotor of 1e-5 kg m2 on a 6 mm pinion, jaws of 50 g."""

FRICTION_N = 0.5
"""Of racks and pinion, as seen at the opening (assumption: a tenth of the least grip, 5 N)."""

CLEARANCE_M = 0.001
"""By how much an object must clear the open and the closed jaws, to be let in and to be held (assumption)."""


def _number(place: int) -> Any:
    """A property that is kept in the state."""

    def get(self: JawsDrive) -> float:
        return float(self.x[place])

    def put(self: JawsDrive, value: float) -> None:
        self.x[place] = value

    return property(get, put)


RATE_HZ = 1.0 / kernel.TICK_S


class JawsDrive:
    """Motor, encoder and loops of a gripper, and its jaws: two in sync, as one mass at their opening (`jaws_kernel`).
    Time is the caller's; results do not depend on its steps.

    Args:
        closed_width_m: Opening of the closed jaws, set by the brackets.
        follow: Lets the bench pass time, and this drive with it, where it matters to what the jaws hold; else it has a
            time of its own.

    Attributes:
        x: State, as the kernel has it.
        flags: The same of what is counted.
        width_m: Opening: at first all that there is.
        rate_m_s: Its rate; positive opens.
        states: Its polled states, in order: parts of shape (m, 6), see `jaws_kernel.look`.
    """

    width_m: float = _number(kernel.WIDTH)
    rate_m_s: float = _number(kernel.RATE)

    def __init__(self, closed_width_m: float, follow: Callable[[float], None] | None = None) -> None:
        self.closed_width_m = closed_width_m
        self.x = np.zeros(kernel.NUMBERS)
        self.flags = np.zeros(kernel.FLAGS, dtype=np.int64)
        self.x[[kernel.CLOSED_M, kernel.OPEN_M]] = closed_width_m, closed_width_m + STROKE_M
        self.x[[kernel.MASS, kernel.FRICTION]] = MASS_KG, FRICTION_N
        self.width_m = closed_width_m + STROKE_M
        self._follow = follow
        self._tick: int | None = None
        self.poll_at(0.0)
        self.power_up()

    @property
    def contact_n(self) -> float:
        """How hard the jaws press on what is between them; compression is positive."""
        return float(kernel.contact_n(self.x, self.flags))

    def fits(self, width_m: float) -> bool:
        """Whether the jaws on these brackets close on an object of this width at all."""
        clear_m = width_m - self.closed_width_m
        return CLEARANCE_M <= clear_m <= STROKE_M - CLEARANCE_M

    def clear(self) -> None:
        """Take away what is between them."""
        self.flags[kernel.PRESENT] = False

    def show(self, width_m: float, stiffness_n_m: float, damping_n_s_m: float = OBJECT_N_S_M) -> None:
        """Let this object be the one that the jaws may meet."""
        self.x[[kernel.THING, kernel.STIFFNESS, kernel.DAMPING]] = width_m, stiffness_n_m, damping_n_s_m

    def power_up(self) -> None:
        """Sleep, uncalibrated; the jaws stay where they are."""
        flags, present, jammed = self.flags, self.flags[kernel.PRESENT], self.flags[kernel.JAMMED]
        flags[:] = 0
        flags[kernel.PRESENT], flags[kernel.JAMMED] = present, jammed
        self.x[[kernel.INTEGRAL, kernel.CURRENT, kernel.LIMIT, kernel.SPEED]] = 0.0

    def renew(self) -> None:
        """Be as on the first day: open, without power, at time zero."""
        self.clear()
        self.width_m, self.rate_m_s = self.closed_width_m + STROKE_M, 0.0
        self.flags[:] = 0
        self.power_up()

    def restart(self) -> None:
        """Time begins anew; all else stays as it is."""
        self._tick = None

    @property
    def finding(self) -> GripFinding:
        """What became of the last order."""
        return GripFinding(int(self.flags[kernel.FINDING]))

    @property
    def current_ma(self) -> float:
        """Of the motor; positive opens."""
        return float(self.x[kernel.CURRENT])

    @property
    def calibrated(self) -> bool:
        """Whether it knows its ends."""
        return bool(self.flags[kernel.CALIBRATED])

    @property
    def ticks(self) -> int:
        """What the encoder reads; it grows as the jaws open."""
        return int(kernel.encoder(self.x))

    @property
    def ticks_s(self) -> float:
        """How fast the encoder turns."""
        return self.rate_m_s * TICKS_PER_M

    @property
    def closed_share(self) -> float:
        """Where the jaws are, by the ends that it knows: 0 open to 1 closed; 0 where it knows none."""
        opened, closed = self.flags[[kernel.OPENED, kernel.CLOSED]].tolist()
        if opened == closed:
            return 0.0
        return float(min(max((opened - self.ticks) / (opened - closed), 0.0), 1.0))

    def go(self, closed_share: float, speed_ticks_s: float, current_ma: float) -> None:
        """Go to a position, at a speed, within a current; without a calibration it stands."""
        flags = self.flags
        (
            sane("closed_share", closed_share),
            sane("speed_ticks_s", speed_ticks_s),
            sane("current_ma", current_ma),
        )
        opened, closed = flags[[kernel.OPENED, kernel.CLOSED]].tolist()
        flags[kernel.TARGET] = round(opened + (closed - opened) * closed_share)
        self.x[[kernel.SPEED, kernel.LIMIT]] = speed_ticks_s, min(max(current_ma, 0.0), MOST_MA)
        flags[kernel.THERE] = False
        if not self.calibrated:
            self.sleep()
            return
        flags[kernel.MODE], flags[kernel.RESTING] = kernel.GOING, False

    def calibrate(self) -> None:
        """Open, then close; the ends that it knew before hold until then."""
        flags = self.flags
        flags[[kernel.HELD, kernel.CALIBRATING, kernel.JAMMED, kernel.RESTING]] = 0
        self.x[[kernel.INTEGRAL, kernel.LIMIT]] = 0.0, kernel.CALIBRATION_MA
        flags[kernel.MODE] = kernel.OPENING

    def sleep(self) -> None:
        """Release: no current."""
        kernel.sleep(self.x, self.flags)
        self.disturb()

    def jam(self) -> None:
        """Hold the jaws fast, whatever drives them, until the next calibration."""
        self.flags[kernel.JAMMED] = True
        self.disturb()

    def disturb(self) -> None:
        """Something in the scene has changed: an object came, went or was released."""
        self.flags[kernel.RESTING] = False

    def poll_at(self, rate_hz: float) -> None:
        """Poll the drive's state at this rate, from time zero on, whatever the steps of time; 0 is never."""
        self._poll_hz, self._polled = rate_hz, 0
        self.states: list[Floats] = []

    def polls_until(self, t_s: float) -> Floats:
        """Times of the polls due until `t_s`; they count as made."""
        first, hz = self._polled, self._poll_hz
        self._polled = max(first, last_tick(t_s, hz)) if hz else first
        return np.arange(first + 1, self._polled + 1) / (hz or 1.0)

    def take(self) -> tuple[int, Floats]:
        """Number of the first state not taken yet, and all of those, shape (m, 6)."""
        states = np.concatenate([np.empty((0, kernel.SEEN)), *self.states])
        self.states.clear()
        return self._polled - len(states) + 1, states

    def advance(self, t_s: float) -> None:
        """Let time pass until `t_s`; it begins where it is first called."""
        if self._follow is not None:
            self._follow(t_s)
            return
        for poll_s in self.polls_until(t_s).tolist():
            self._pass(poll_s)
            self.states.append(np.empty((1, kernel.SEEN)))
            kernel.look(self.x, self.flags, self.states[-1][0])
        self._pass(t_s)

    def _pass(self, t_s: float) -> None:
        last = last_tick(t_s, RATE_HZ)
        if self._tick is not None and self._tick < last:
            kernel.advance(self.x, self.flags, self._tick, last)
        self._tick = last if self._tick is None else max(self._tick, last)
