"""The gripper's own drive: loops at 5 kHz, its finding of objects, its calibration. In hardware there, so here."""

from __future__ import annotations

from enum import Enum, auto

from drivers.can_gripper.units import FORCE_N_PER_MA, MOST_MA, STEADY_MA, TICKS_PER_M
from drivers.can_gripper.words import Finding
from drivers.clock import last_tick
from drivers.mock.physics.jaws import TICK_S, Jaws, JawsSettings

RATE_HZ = 1.0 / TICK_S

SPEED_MA = 0.03
"""Current for each tick/s of error in speed (the firmware's default gain)."""

SPEED_INTEGRAL_MA = 0.0003
"""The same, added up at each tick (the firmware's default gain)."""

POSITION_PER_S = 8.0
"""Speed for each tick of error in position (the firmware's default gain)."""

NEAR_TICKS = 5
"""Less than this from its target the drive is at its position, until the next order (interface page)."""

SLOW_TICKS_S = 500.0
"""An object is felt below this speed … (interface page)"""

OBJECT_SHARE = 0.8
"""… and above this share of the current limit (interface page)."""

CALIBRATION_MA = 500.0
CALIBRATION_TICKS_S = 12_583.0
"""Limit and speed of a calibration (interface page; speed 40 of the firmware)."""

CALIBRATION_HOLD = 3200
"""Ticks at each stop: 0.64 s (interface page)."""

CALIBRATION_NEAR_MA = 90.0
CALIBRATION_SLOW_TICKS_S = 700.0
"""What counts as standing at a stop: so near to the limit, so slow (firmware)."""

CALIBRATION_MOST = 150_000
"""Ticks after which a calibration is given up: 30 s (interface page)."""

HUNT_TICKS = 50
HUNT_SHARE = 0.5
"""Below 150 mA the drive is unstable; the data sheet does not say how. Assumption: it hunts between its limit and
half of it, every 10 ms."""

ENCODER_ZERO = 4321
"""What the encoder reads at the closed stop. Assumption: anything, for it counts from power-up."""


class Mode(Enum):
    """What the drive does."""

    ASLEEP = auto()
    GOING = auto()
    OPENING = auto()
    CLOSING = auto()


class JawsDrive:
    """Motor, encoder and loops of a gripper on its jaws. Time is the caller's; results do not depend on its steps.

    Args:
        settings: Of jaws and scene.

    Attributes:
        jaws: What it moves.
        mode: What it does; the last two are the calibration.
        finding: What became of the last order.
        current_ma: Of the motor; positive opens.
        calibrated: It knows its ends.
    """

    def __init__(self, settings: JawsSettings) -> None:
        self.jaws = Jaws(settings)
        self._tick: int | None = None
        self.power_up()

    def power_up(self) -> None:
        """Sleep, and know nothing of ends; the jaws stay where they are."""
        self.mode = Mode.ASLEEP
        self.finding = Finding.MOVING
        self.current_ma = 0.0
        self.calibrated = False
        self._integral_ma = 0.0
        self._limit_ma = 0.0
        self._speed_ticks_s = 0.0
        self._target = 0
        self._there = False
        self._ends = (0, 0)  # encoder at the open and at the closed stop
        self._held = 0
        self._calibrating = 0
        self._resting = False

    def restart(self) -> None:
        """Time begins anew; all else stays as it is."""
        self._tick = None

    @property
    def ticks(self) -> int:
        """What the encoder reads; it grows as the jaws open."""
        return round((self.jaws.width_m - self.jaws.settings.closed_width_m) * TICKS_PER_M) + ENCODER_ZERO

    @property
    def ticks_s(self) -> float:
        """How fast the encoder turns."""
        return self.jaws.rate_m_s * TICKS_PER_M

    @property
    def closed_share(self) -> float:
        """Where the jaws are, by the ends that it knows: 0 open to 1 closed; 0 where it knows none."""
        opened, closed = self._ends
        if opened == closed:
            return 0.0
        return min(max((opened - self.ticks) / (opened - closed), 0.0), 1.0)

    def go(self, closed_share: float, speed_ticks_s: float, current_ma: float) -> None:
        """Go to a position, at a speed, within a current; without a calibration it stands."""
        opened, closed = self._ends
        self._target = round(opened + (closed - opened) * closed_share)
        self._speed_ticks_s = speed_ticks_s
        self._limit_ma = min(max(current_ma, 0.0), MOST_MA)
        self._there = False
        if self.calibrated:
            self._switch(Mode.GOING)
        else:
            self.sleep()

    def calibrate(self) -> None:
        """Open, then close; the ends that it knew before hold until then."""
        self._held = self._calibrating = 0
        self._integral_ma = 0.0
        self.jaws.jammed = False
        self._limit_ma = CALIBRATION_MA
        self._switch(Mode.OPENING)

    def sleep(self) -> None:
        """Let go: no current."""
        self._integral_ma = self.current_ma = 0.0
        self.finding = Finding.MOVING
        self._switch(Mode.ASLEEP)

    def jam(self) -> None:
        """Hold the jaws fast, whatever drives them, until the next calibration."""
        self.jaws.jammed = True
        self._resting = False

    def disturb(self) -> None:
        """Something in the scene has changed: an object came, went or let go."""
        self._resting = False

    def advance(self, t_s: float) -> None:
        """Let time pass until `t_s`; it begins where it is first called."""
        last = last_tick(t_s, RATE_HZ)
        if self._tick is None:
            self._tick = last
        while self._tick < last:
            if self._resting:
                self._tick = last
                break
            self._tick += 1
            self._step(self._tick)

    def _switch(self, mode: Mode) -> None:
        self.mode = mode
        self._resting = False

    def _step(self, tick: int) -> None:
        before = self._snapshot()
        if self.mode is Mode.GOING:
            self._find()
            self._drive(self._wanted_ticks_s(), self._limit(tick))
        elif self.mode is not Mode.ASLEEP:
            self._calibrate()
        self.jaws.tick(self.current_ma * FORCE_N_PER_MA)
        steady = self.mode is Mode.ASLEEP or (self.mode is Mode.GOING and self._limit_ma >= STEADY_MA)
        self._resting = steady and before == self._snapshot()

    def _snapshot(self) -> tuple[object, ...]:
        jaws = self.jaws
        return jaws.width_m, jaws.rate_m_s, self._integral_ma, self.current_ma, self.finding, self.mode

    def _limit(self, tick: int) -> float:
        hunts = self._limit_ma < STEADY_MA and tick // HUNT_TICKS % 2
        return self._limit_ma * (HUNT_SHARE if hunts else 1.0)

    def _find(self) -> None:
        """Tell an object from a target from a motion."""
        self._there = self._there or abs(self._target - self.ticks) < NEAR_TICKS
        if self._there:
            self.finding = Finding.AT_POSITION
        elif abs(self.ticks_s) > SLOW_TICKS_S or abs(self.current_ma) <= OBJECT_SHARE * self._limit_ma:
            self.finding = Finding.MOVING
        else:
            self.finding = Finding.OBJECT_OPENING if self.current_ma > 0.0 else Finding.OBJECT_CLOSING

    def _wanted_ticks_s(self) -> float:
        error = self._target - self.ticks
        if self._there:
            return POSITION_PER_S * error
        return self._speed_ticks_s if error > 0 else -self._speed_ticks_s

    def _drive(self, wanted_ticks_s: float, limit_ma: float) -> None:
        """Speed loop, its integral and its output within the limit."""
        error = wanted_ticks_s - self.ticks_s
        self._integral_ma = _within(self._integral_ma + SPEED_INTEGRAL_MA * error, limit_ma)
        self.current_ma = _within(self._integral_ma + SPEED_MA * error, limit_ma)

    def _calibrate(self) -> None:
        opening = self.mode is Mode.OPENING
        self._drive(CALIBRATION_TICKS_S if opening else -CALIBRATION_TICKS_S, CALIBRATION_MA)
        near = abs(abs(self.current_ma) - CALIBRATION_MA) < CALIBRATION_NEAR_MA
        self._held = self._held + 1 if near and abs(self.ticks_s) < CALIBRATION_SLOW_TICKS_S else 0
        self._calibrating += 1
        if self._held >= CALIBRATION_HOLD:
            self._held = 0
            if opening:
                self._ends = (self.ticks, self._ends[1])
                self.mode = Mode.CLOSING
            else:
                self._ends = (self._ends[0], self.ticks)
                self.calibrated = True
                self.sleep()
        elif self._calibrating >= CALIBRATION_MOST:
            self.calibrated = False
            self.sleep()


def _within(value: float, limit: float) -> float:
    return min(max(value, -limit), limit)
