"""A gripper's loops on its jaws, tick by tick: speed loop, finding of objects, calibration, dry friction. Compiled."""

from drivers.can_gripper.units import FORCE_N_PER_MA, STEADY_MA, TICKS_PER_M
from drivers.core.compiled import compiled
from drivers.core.messages import Floats, Ints

TICK_S = 2e-4
"""Step of the integration: the period of the gripper's own loops (5 kHz: docs/reference/grippers.md)."""

SPEED_MA = 0.03
"""Current for each tick/s of error in speed (the firmware's default gain)."""

SPEED_INTEGRAL_MA = 0.0003
"""The same, added up at each tick (the firmware's default gain)."""

POSITION_PER_S = 8.0
"""Speed for each tick of error in position (the firmware's default gain)."""

NEAR_TICKS = 5
"""Less than this from its target the drive is at its position, until the next order (docs/reference/grippers.md)."""

SLOW_TICKS_S = 500.0
"""An object is felt below this speed … (docs/reference/grippers.md)"""

OBJECT_SHARE = 0.8
"""… and above this share of the current limit (docs/reference/grippers.md)."""

CALIBRATION_MA = 500.0
CALIBRATION_TICKS_S = 12_583.0
"""Limit and speed of a calibration (docs/reference/grippers.md; speed 40 of the firmware)."""

CALIBRATION_HOLD = 3200
"""Ticks at each stop: 0.64 s (docs/reference/grippers.md)."""

CALIBRATION_NEAR_MA = 90.0
CALIBRATION_SLOW_TICKS_S = 700.0
"""What counts as standing at a stop: so near to the limit, so slow (firmware)."""

CALIBRATION_MOST = 150_000
"""Ticks after which a calibration is aborted: 30 s (docs/reference/grippers.md)."""

HUNT_TICKS = 50
HUNT_SHARE = 0.5
"""Below 150 mA the drive is unstable; the data sheet does not state how. Assumption: it hunts between its limit and
half of it, every 10 ms."""

ENCODER_ZERO = 4321
"""What the encoder reads at the closed stop. Assumption: anything, for it counts from power-up."""

NUMBERS = 13
WIDTH, RATE, INTEGRAL, CURRENT, LIMIT, SPEED, CLOSED_M, OPEN_M, MASS, FRICTION, THING, STIFFNESS, DAMPING = (
    range(NUMBERS)
)
"""Places in the state: opening (m) and its rate (m/s), integral of the speed loop and current (mA), limit (mA) and
speed (ticks/s) of the order, ends (m), mass (kg) and dry friction (N) of the jaws; width (m), stiffness (N/m) and
damping (N s/m) of the object."""

FLAGS = 12
MODE, FINDING, TARGET, THERE, HELD, CALIBRATING, OPENED, CLOSED, CALIBRATED, RESTING, JAMMED, PRESENT = range(
    FLAGS
)
"""Places in the flags: mode, finding, target of the order (ticks), whether it was reached; ticks at a stop and of the
calibration, what the encoder reads at both ends, whether they are known; nothing changes any more; nothing moves the
jaws; the object is between them."""

ASLEEP, GOING, OPENING, CLOSING = range(4)
"""Modes; the last two are the calibration."""

SEEN = 6
"""Numbers in a state of the drive."""

MOVING, OBJECT_CLOSING, OBJECT_OPENING, AT_POSITION = range(4)
"""Findings (`drivers.gripper.state.GripFinding`)."""


@compiled()
def contact_n(x: Floats, flags: Ints) -> float:
    """How hard the jaws press on what is between them, N."""
    if not flags[PRESENT] or x[WIDTH] >= x[THING]:
        return 0.0
    squeezed_n: float = x[STIFFNESS] * (x[THING] - x[WIDTH]) - x[DAMPING] * x[RATE]
    return max(0.0, squeezed_n)


@compiled()
def move(x: Floats, flags: Ints, drive_n: float) -> None:
    """Let a tick pass under a force of the drive; positive opens.

    Semi-implicit Euler; dry friction takes speed away and never turns it round, so that the jaws come to rest to the
    last bit. The end stops are rigid and swallow every impact.
    """
    if flags[JAMMED]:
        x[RATE] = 0.0
        return
    gain = TICK_S / x[MASS]
    rate_m_s = x[RATE] + gain * (drive_n + contact_n(x, flags))
    held_m_s = gain * x[FRICTION]
    if abs(rate_m_s) <= held_m_s:
        rate_m_s = 0.0
    else:
        rate_m_s -= held_m_s * (1.0 if rate_m_s > 0.0 else -1.0)
    width_m = x[WIDTH] + TICK_S * rate_m_s
    if not x[CLOSED_M] <= width_m <= x[OPEN_M]:
        width_m, rate_m_s = min(max(width_m, x[CLOSED_M]), x[OPEN_M]), 0.0
    x[WIDTH], x[RATE] = width_m, rate_m_s


@compiled()
def encoder(x: Floats) -> int:
    """What the encoder reads; it grows as the jaws open."""
    ticks: int = round((x[WIDTH] - x[CLOSED_M]) * TICKS_PER_M)
    return ticks + ENCODER_ZERO


@compiled()
def sleep(x: Floats, flags: Ints) -> None:
    """Let go: no current."""
    x[INTEGRAL] = x[CURRENT] = 0.0
    flags[FINDING], flags[MODE] = MOVING, ASLEEP


@compiled()
def drive(x: Floats, wanted_ticks_s: float, limit_ma: float) -> None:
    """Speed loop, its integral and its output within the limit."""
    error = wanted_ticks_s - x[RATE] * TICKS_PER_M
    x[INTEGRAL] = min(max(x[INTEGRAL] + SPEED_INTEGRAL_MA * error, -limit_ma), limit_ma)
    x[CURRENT] = min(max(x[INTEGRAL] + SPEED_MA * error, -limit_ma), limit_ma)


@compiled()
def go(x: Floats, flags: Ints, tick: int) -> None:
    """Distinguish object, target and motion, and drive towards the target."""
    error = flags[TARGET] - encoder(x)
    if flags[THERE] or abs(error) < NEAR_TICKS:
        flags[THERE], flags[FINDING] = 1, AT_POSITION
    elif abs(x[RATE] * TICKS_PER_M) > SLOW_TICKS_S or abs(x[CURRENT]) <= OBJECT_SHARE * x[LIMIT]:
        flags[FINDING] = MOVING
    else:
        flags[FINDING] = OBJECT_OPENING if x[CURRENT] > 0.0 else OBJECT_CLOSING
    cruise_ticks_s = x[SPEED] if error > 0 else -x[SPEED]
    wanted_ticks_s = POSITION_PER_S * error if flags[THERE] else cruise_ticks_s
    hunts = x[LIMIT] < STEADY_MA and tick // HUNT_TICKS % 2
    drive(x, wanted_ticks_s, x[LIMIT] * (HUNT_SHARE if hunts else 1.0))


@compiled()
def calibrate(x: Floats, flags: Ints) -> None:
    """Open until something holds, then close until something does."""
    opening = flags[MODE] == OPENING
    drive(x, CALIBRATION_TICKS_S if opening else -CALIBRATION_TICKS_S, CALIBRATION_MA)
    near = abs(abs(x[CURRENT]) - CALIBRATION_MA) < CALIBRATION_NEAR_MA
    still = near and abs(x[RATE] * TICKS_PER_M) < CALIBRATION_SLOW_TICKS_S
    flags[HELD] = flags[HELD] + 1 if still else 0
    flags[CALIBRATING] += 1
    if flags[HELD] >= CALIBRATION_HOLD:
        flags[HELD] = 0
        if opening:
            flags[OPENED], flags[MODE] = encoder(x), CLOSING
        else:
            flags[CLOSED], flags[CALIBRATED] = encoder(x), 1
            sleep(x, flags)
            flags[RESTING] = 0
    elif flags[CALIBRATING] >= CALIBRATION_MOST:
        flags[CALIBRATED] = 0
        sleep(x, flags)
        flags[RESTING] = 0


@compiled()
def look(x: Floats, flags: Ints, seen: Floats) -> None:
    """Write the drive's state to `seen`: encoder, current (mA), finding, both ends, whether known."""
    seen[0], seen[1], seen[2] = encoder(x), x[CURRENT], flags[FINDING]
    seen[3], seen[4], seen[5] = flags[OPENED], flags[CLOSED], flags[CALIBRATED]


@compiled("void(f8[::1], i8[::1], i8, i8)")
def advance(x: Floats, flags: Ints, tick: int, last: int) -> None:
    """Let ticks pass, from the one after `tick` to `last`; nothing is computed where nothing changes any more."""
    while tick < last and not flags[RESTING]:
        tick += 1
        before = (x[WIDTH], x[RATE], x[INTEGRAL], x[CURRENT], flags[FINDING], flags[MODE])
        if flags[MODE] == GOING:
            go(x, flags, tick)
        elif flags[MODE] != ASLEEP:
            calibrate(x, flags)
        move(x, flags, x[CURRENT] * FORCE_N_PER_MA)
        steady = flags[MODE] == ASLEEP or (flags[MODE] == GOING and x[LIMIT] >= STEADY_MA)
        after = (x[WIDTH], x[RATE], x[INTEGRAL], x[CURRENT], flags[FINDING], flags[MODE])
        flags[RESTING] = steady and before == after
