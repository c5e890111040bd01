"""Run time against error of the finger, beside a strong rival, compiled RK4 with event location.

`python -m benchmarks physics` writes results/physics_strongest.json. The reference is the tests'
(`tests/stability/finger_oracles.py`: eigenvectors to 40 digits, nothing of the plant's). results/physics.md keeps
earlier runs with more rivals: heyoka, a method of order 8, scipy's and MuJoCo (physics.json).
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

import numpy as np

from benchmarks.results import save, side_by_side_s
from drivers.core.compiled import compiled
from drivers.core.messages import Floats
from simulator.physics.finger import FingerPlant, FingerSettings
from tests.stability.finger_oracles import modal

OUTPUT_HZ = 1000.0
"""Rate of the output that every solver has to give: the sensor board's."""

KINDS = ("made", "lost", "comparator_up", "comparator_down", "drive_up", "drive_down")
"""Events: contact made and lost, edges of the comparator and of the drive. The index is the solvers' code for them."""

MADE, LOST, COMPARATOR_UP, COMPARATOR_DOWN, DRIVE_UP, DRIVE_DOWN = range(len(KINDS))

MATCH_S = 2e-3
"""An event further than this from the reference's is another event: a sixteenth of a period of 28 Hz."""

OPEN_LOOP_HZ = 28.0
"""Frequency of the drive without the loop: the free resonance of the paper."""

EXACT, RK4 = "exact pieces", "RK4, events located"

EVENTS_PER_S = 4000
"""Room for events; what needs more has gone astray."""

FINEST = 7
"""The rival's steps are 1 ms / 2^k, up to this k."""

Motion = tuple[tuple[float, float, float, float], ...]
"""The probe's plan: (start in s, position in m, velocity in m/s, acceleration in m/s^2), each until the next begins."""

STAYS: Motion = ((0.0, 0.0, 0.0, 0.0),)
"""The probe stays where it is."""

APPROACH: Motion = ((0.0, 0.0, 0.0, 0.0), (0.43, 0.0, 0.004843, 0.0))
"""After 0.43 s, in which the loop locks, at 4.843 mm/s (Table I, location f): it bounces from the first touch on."""

PRESS: Motion = ((0.0, 0.0, 0.1, 0.0), (0.22, 0.022, 0.0, 0.0))
"""22 mm at 0.1 m/s, then at rest: the finger stays pressed and rings with the pad."""

DURATION_S = 1.99
"""Of a scene. Neither its end nor a corner of the probe's plan is an edge of the open loop's drive."""


@dataclass(frozen=True)
class Scene:
    """One problem: from rest, with the excitation switched on at t = 0, without noise, contact at location f.

    Attributes:
        name: Of the scene.
        gap_m: Distance of the probe from the finger at rest.
        motion: The probe's plan; its corners lie on the output's grid, so that no method stumbles over them.
        duration_s: Of the scene.
        closed: With the phase-locked loop; otherwise the drive runs at `OPEN_LOOP_HZ`.
        changes: Settings of the finger that differ from their defaults.
    """

    name: str
    gap_m: float
    motion: Motion
    duration_s: float
    closed: bool = True
    changes: Mapping[str, float] = field(default_factory=dict)

    @property
    def settings(self) -> FingerSettings:
        """Settings of the plant: no noise, and for the open loop an oscillator that does not listen."""
        # the settings want a range above zero: this one changes no bit of the frequency
        loop = {} if self.closed else {"oscillator_lowest_hz": OPEN_LOOP_HZ, "oscillator_range_hz": 1e-300}
        return FingerSettings.model_validate({"noise_scale": 0.0, **loop, **self.changes})

    @property
    def times_s(self) -> Floats:
        """The output's grid without t = 0, shape (n,)."""
        return np.arange(1, round(self.duration_s * OUTPUT_HZ) + 1) / OUTPUT_HZ


def scenes(*, closed: bool, duration_s: float = DURATION_S) -> tuple[Scene, ...]:
    """The three scenes of the comparison."""
    plans = (("free", 5e-3, STAYS), ("bouncing", 1e-3, APPROACH), ("full contact", 1e-3, PRESS))
    return tuple(Scene(*plan, duration_s, closed) for plan in plans)


# --- the rival: equations (1) to (10) of docs/explanation/finger_physics.md, as written without knowing that they are
# linear; compiled, in registers

State = tuple[float, float, float, float, float, float, float, float, float]
"""theta, omega, b, beta, a, g1, g2, v, phi."""

Switches = tuple[int, int, int]
"""Mode, comparator, drive."""

Probe = tuple[float, float, float]
"""Position, velocity and acceleration of the probe."""

FREE, TOUCHING, CLIPPED = range(3)
"""Modes."""

REORDERED = {"contract", "reassoc", "nsz", "arcp"}
"""Freedom that the compiler gets with the rival's arithmetic: a third faster, and rounding is not what limits it."""

CONTACT, PRESSURE, COMPARATOR, PHASE, GUARDS = range(5)
"""What can switch: the end of the mode, renewed pressure in the clipped mode, the comparator, the half cycle."""

SETTLED_S = 1e-16
"""A located event has converged when Newton moves it by no more: half the spacing of doubles at 1 s."""

NEWTON = 60
"""Most steps of Newton for an event; three or four are the rule."""


class Constants(NamedTuple):
    """Every number of equations (1) to (10), SI units, with reciprocals: the compiled rival does not divide."""

    per_inertia: float
    joint: float
    joint_damping: float
    per_base_inertia: float
    base: float
    base_damping: float
    drive: float
    arm: float
    gap: float
    contact: float
    contact_damping: float
    accelerometer_arm: float
    accelerometer_rad_s: float
    high_pass_rad_s: float
    per_quality: float
    hysteresis: float
    control_rad_s: float
    lowest_hz: float
    range_hz: float


def constants(scene: Scene) -> Constants:
    """What the compiled code wants."""
    s, turn_rad = scene.settings, 2.0 * math.pi
    distal = (1.0 / s.inertia_kg_m2, s.joint_n_m_rad, s.joint_n_m_s_rad)
    base = (1.0 / s.base_inertia_kg_m2, s.base_n_m_rad, s.base_n_m_s_rad)
    contact = (s.drive_n_m, s.arm_f_m, scene.gap_m, s.pad_n_m, s.contact_n_s_m)
    sensor = (s.accelerometer_arm_m, turn_rad * s.accelerometer_hz, turn_rad * s.high_pass_hz)
    comparator = (1.0 / s.high_pass_quality, s.hysteresis_m_s2)
    oscillator = (turn_rad * s.loop_hz, s.oscillator_lowest_hz, s.oscillator_range_hz)
    return Constants(*distal, *base, *contact, *sensor, *comparator, *oscillator)


@compiled(inline="always")
def probe(motion: Floats, row: int, t: float) -> Probe:
    """The probe in the piece `row` of its plan, shape (pieces + 1, 4), of which the last starts at infinity."""
    ago = t - motion[row, 0]
    velocity, acceleration = motion[row, 2], motion[row, 3]
    position = motion[row, 1] + ago * (velocity + 0.5 * acceleration * ago)
    return position, velocity + acceleration * ago, acceleration


@compiled(inline="always")
def derivative(c: Constants, q: Switches, s: float, s_rate: float, x: State) -> State:
    """d x / d t."""
    theta, omega, b, beta, a, g1, g2, v, _ = x
    mode, comparator, oscillator = q
    delta, rate = s - c.gap - c.arm * theta, s_rate - c.arm * omega
    force = c.contact * delta + c.contact_damping * rate if mode == TOUCHING else 0.0
    joint = c.joint * (theta - b) + c.joint_damping * (omega - beta)
    u = c.drive if oscillator else -c.drive
    beta_rate = (joint - c.base * b - c.base_damping * beta) * c.per_base_inertia
    y = a - g1 * c.per_quality - g2
    return (
        omega,
        (u + c.arm * force - joint) * c.per_inertia,
        beta,
        beta_rate,
        -c.accelerometer_rad_s * (c.accelerometer_arm * beta_rate + a),
        c.high_pass_rad_s * y,
        c.high_pass_rad_s * g1,
        c.control_rad_s * ((comparator ^ oscillator) - v),
        c.lowest_hz + c.range_hz * v,
    )


@compiled(inline="always")
def moved(x: State, h: float, d: State) -> State:
    """x + h d."""
    return (
        x[0] + h * d[0],
        x[1] + h * d[1],
        x[2] + h * d[2],
        x[3] + h * d[3],
        x[4] + h * d[4],
        x[5] + h * d[5],
        x[6] + h * d[6],
        x[7] + h * d[7],
        x[8] + h * d[8],
    )


@compiled(inline="always")
def _step(
    c: Constants, q: Switches, motion: Floats, row: int, t: float, h: float, x: State, d1: State
) -> tuple[State, Probe, State]:
    """One classical Runge-Kutta step: state, probe and derivative at its end; `d1` is the derivative at its start."""
    middle, middle_rate, _ = probe(motion, row, t + 0.5 * h)
    s = probe(motion, row, t + h)
    d2 = derivative(c, q, middle, middle_rate, moved(x, 0.5 * h, d1))
    d3 = derivative(c, q, middle, middle_rate, moved(x, 0.5 * h, d2))
    d4 = derivative(c, q, s[0], s[1], moved(x, h, d3))
    w = h / 6.0
    end = (
        x[0] + w * (d1[0] + 2.0 * (d2[0] + d3[0]) + d4[0]),
        x[1] + w * (d1[1] + 2.0 * (d2[1] + d3[1]) + d4[1]),
        x[2] + w * (d1[2] + 2.0 * (d2[2] + d3[2]) + d4[2]),
        x[3] + w * (d1[3] + 2.0 * (d2[3] + d3[3]) + d4[3]),
        x[4] + w * (d1[4] + 2.0 * (d2[4] + d3[4]) + d4[4]),
        x[5] + w * (d1[5] + 2.0 * (d2[5] + d3[5]) + d4[5]),
        x[6] + w * (d1[6] + 2.0 * (d2[6] + d3[6]) + d4[6]),
        x[7] + w * (d1[7] + 2.0 * (d2[7] + d3[7]) + d4[7]),
        x[8] + w * (d1[8] + 2.0 * (d2[8] + d3[8]) + d4[8]),
    )
    return end, s, derivative(c, q, s[0], s[1], end)


@compiled(inline="always")
def guard_of(c: Constants, which: int, q: Switches, s: Probe, x: State, d: State) -> tuple[float, float]:
    """A quantity that switches when it rises through zero, and its slope."""
    mode, comparator, _ = q
    if which == PHASE:
        return x[8] - 0.5, d[8]
    if which == COMPARATOR:
        sign = -1.0 if comparator else 1.0
        slope = sign * (d[4] - d[5] * c.per_quality - d[6])
        return sign * (x[4] - x[5] * c.per_quality - x[6]) - c.hysteresis, slope
    delta, rate = s[0] - c.gap - c.arm * x[0], s[1] - c.arm * x[1]
    if which == CONTACT and mode == FREE:
        return delta, rate
    if which == CONTACT and mode == CLIPPED:
        return -delta, -rate
    if which == PRESSURE and mode != CLIPPED:
        return -1.0, 0.0
    sign = -1.0 if mode == TOUCHING else 1.0
    push = c.contact * delta + c.contact_damping * rate
    return sign * push, sign * (c.contact * rate + c.contact_damping * (s[2] - c.arm * d[1]))


@compiled(inline="always")
def _flat(c: Constants, which: int, q: Switches, begin: tuple[Probe, State, State], end: Any) -> bool:
    """Whether a guard stays below zero in a step: it is at both ends, and has no maximum inside."""
    g0, slope0 = guard_of(c, which, q, begin[0], begin[1], begin[2])
    g1, slope1 = guard_of(c, which, q, end[0], end[1], end[2])
    return g0 <= 0.0 and g1 <= 0.0 and not (slope0 > 0.0 and slope1 < 0.0)


@compiled()
def _hermite(
    g0: float, slope0: float, g1: float, slope1: float, h: float, tau: float
) -> tuple[float, float, float]:
    """The cubic through values and slopes at 0 and `h`: value, slope and curvature at `tau`."""
    rise = (g1 - g0) / h
    quadratic = (3.0 * rise - 2.0 * slope0 - slope1) / h
    cubic = (slope0 + slope1 - 2.0 * rise) / (h * h)
    return (
        g0 + tau * (slope0 + tau * (quadratic + tau * cubic)),
        slope0 + tau * (2.0 * quadratic + 3.0 * tau * cubic),
        2.0 * quadratic + 6.0 * tau * cubic,
    )


@compiled()
def _cubic_root(
    ends: tuple[float, float, float, float], h: float, low: float, high: float, sign: float, extremum: bool
) -> float:
    """Where `sign` times the cubic (or its slope) rises through zero in a bracket: Newton, kept inside."""
    tau = 0.5 * (low + high)
    for _ in range(60):
        value, slope, bend = _hermite(ends[0], ends[1], ends[2], ends[3], h, tau)
        g, steepness = (sign * slope, sign * bend) if extremum else (sign * value, sign * slope)
        if g > 0.0:
            high = tau
        else:
            low = tau
        following = tau - g / steepness if steepness != 0.0 else low
        if not low < following < high:
            following = 0.5 * (low + high)
        if abs(following - tau) <= 1e-3 * SETTLED_S + 1e-6 * abs(tau):
            return following
        tau = following
    return tau


@compiled()
def _crossing(g0: float, slope0: float, g1: float, slope1: float, h: float) -> float:
    """Where a guard rises through zero within a step, by its cubic; infinity where it does not."""
    if g0 > 0.0 and slope0 >= 0.0:
        return 0.0
    low, high, ends = 0.0, h, (g0, slope0, g1, slope1)
    if g1 > 0.0:
        if slope0 < 0.0 and slope1 > 0.0:
            low = _cubic_root(ends, h, 0.0, h, 1.0, True)
    elif slope0 > 0.0 and slope1 < 0.0:
        high = _cubic_root(ends, h, 0.0, h, -1.0, True)
        if _hermite(g0, slope0, g1, slope1, h, high)[0] <= 0.0:
            return np.inf
    else:
        return np.inf
    return _cubic_root(ends, h, low, high, 1.0, False)


@compiled()
def _mode_by_law(c: Constants, mode: int, s: Probe, x: State) -> int:
    """(4) at a corner of the probe's plan, where P jumps with the probe's velocity."""
    delta = s[0] - c.gap - c.arm * x[0]
    push = c.contact * delta + c.contact_damping * (s[1] - c.arm * x[1])
    if mode == TOUCHING and push <= 0.0:
        return CLIPPED if delta > 0.0 else FREE
    return TOUCHING if mode == CLIPPED and push > 0.0 else mode


@compiled()
def _switched(c: Constants, which: int, q: Switches) -> tuple[Switches, int]:
    """The switches after an event, and the event's kind, or -1 where it is none that is counted."""
    mode, comparator, oscillator = q
    if which == PHASE:
        return (mode, comparator, 1 - oscillator), DRIVE_DOWN if oscillator else DRIVE_UP
    if which == COMPARATOR:
        return (mode, 1 - comparator, oscillator), COMPARATOR_DOWN if comparator else COMPARATOR_UP
    if mode == FREE or which == PRESSURE:
        return (TOUCHING, comparator, oscillator), MADE
    if mode == TOUCHING:
        return (CLIPPED if c.contact_damping > 0.0 else FREE, comparator, oscillator), LOST
    return (FREE, comparator, oscillator), -1


@compiled()
def _overtaken(c: Constants, which: int, q: Switches, s: Probe, x: State, d: State) -> int:
    """Another guard that is already above zero and rising where `which` has just reached it, or `which`."""
    for guard in range(GUARDS):
        g, slope = guard_of(c, guard, q, s, x, d)
        if guard != which and g > 0.0 and slope > 0.0 and g > SETTLED_S * slope:
            return guard
    return which


@compiled()
def _first(
    c: Constants, q: Switches, h: float, begin: tuple[Probe, State, State], end: tuple[Probe, State, State]
) -> tuple[int, float]:
    """What switches first within a step, by the cubics, and when; -1 where nothing does."""
    which, tau = -1, np.inf
    for guard in range(GUARDS):
        g0, slope0 = guard_of(c, guard, q, begin[0], begin[1], begin[2])
        g1, slope1 = guard_of(c, guard, q, end[0], end[1], end[2])
        estimate = _crossing(g0, slope0, g1, slope1, h)
        if estimate < tau:
            which, tau = guard, estimate
    return which, tau


@compiled(fastmath=REORDERED)
def _trial(
    c: Constants, q: Switches, motion: Floats, row: int, t: float, h: float, x: State, d: State
) -> tuple[State, Probe, State]:
    """`_step` as a call: inlined everywhere, it would double the time to compile."""
    return _step(c, q, motion, row, t, h, x, d)


@compiled(fastmath=REORDERED)
def _until(
    c: Constants,
    which: int,
    q: Switches,
    motion: Floats,
    row: int,
    t: float,
    h: float,
    tau: float,
    x: State,
    d: State,
) -> tuple[State, Probe, float, int]:
    """A step that ends where `which` switches, or what the cubics overlooked before it: Newton on the step's length.

    Returns:
        State and probe at its end, its length, and what switches there.
    """
    end, s, end_d = _trial(c, q, motion, row, t, tau, x, d)
    for _ in range(NEWTON):
        g, slope = guard_of(c, which, q, s, end, end_d)
        change = -g / slope if slope > 0.0 else 0.0
        if abs(change) <= SETTLED_S:
            earlier = _overtaken(c, which, q, s, end, end_d)
            if earlier == which:
                break
            which = earlier
            continue
        tau = min(max(tau + change, 0.0), h)
        end, s, end_d = _trial(c, q, motion, row, t, tau, x, d)
    return end, s, tau, which


@compiled(fastmath=REORDERED)
def located(
    c: Constants, motion: Floats, outputs: int, substeps: int, theta: Floats, times: Floats, codes: Any
) -> int:
    """RK4 in steps of 1 / (1 kHz x substeps), cut at every event.

    A step's guards are looked at through their cubics (values and slopes at both ends), so that a touch that begins and
    ends within one step is seen. The instant is then polished by Newton, with steps of trial length up to it.

    Args:
        c: The scene's numbers.
        motion: The probe's plan, as of `probe`.
        outputs: Milliseconds of output.
        substeps: Steps to a millisecond.
        theta: Written: angle of the distal link at each millisecond, rad, shape (outputs,).
        times: Written: instants of events, s; its length is the room for them.
        codes: Written: their kinds, places in `KINDS`.

    Returns:
        How many events there were; -1 where there was no room for them: the solver went astray.
    """
    x = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.5, 0.0)
    q, row, count, t = (FREE, 0, 0), 0, 0, 0.0
    s = probe(motion, 0, t)
    d = derivative(c, q, s[0], s[1], x)
    for step in range(outputs * substeps):
        goal = (step + 1) / (OUTPUT_HZ * substeps)
        if t >= motion[row + 1, 0] - 1e-12:
            row += 1
            s = probe(motion, row, t)
            was, q = q[0], (_mode_by_law(c, q[0], s, x), q[1], q[2])
            if was != q[0]:
                times[count], codes[count] = t, MADE if q[0] == TOUCHING else LOST
                count += 1
            d = derivative(c, q, s[0], s[1], x)
        while t < goal:
            if count + 2 > times.size:
                return -1
            h = goal - t
            end, end_s, end_d = _step(c, q, motion, row, t, h, x, d)
            which, tau, before, after = -1, h, (s, x, d), (end_s, end, end_d)
            # the cheap question before the exact one
            if (
                q[0] == CLIPPED
                or end[8] >= 0.5
                or not (_flat(c, COMPARATOR, q, before, after) and _flat(c, CONTACT, q, before, after))
            ):
                which, tau = _first(c, q, h, before, after)
            if which < 0:
                x, s, d, t = end, end_s, end_d, goal
                continue
            x, s, tau, which = _until(c, which, q, motion, row, t, h, tau, x, d)
            t += tau
            if which == PHASE:
                x = (x[0], x[1], x[2], x[3], x[4], x[5], x[6], x[7], 0.0)
            q, code = _switched(c, which, q)
            if code >= 0:
                times[count], codes[count] = t, code
                count += 1
            d = derivative(c, q, s[0], s[1], x)
        if (step + 1) % substeps == 0:
            theta[(step + 1) // substeps - 1] = x[0]
    return count


# --- solvers and their errors --------------------------------------------------------------------


class Trajectory(NamedTuple):
    """What a solver made of a scene: theta, rad, on its grid, shape (n,), and the times, s, of each kind of event."""

    theta_rad: Floats
    events: Mapping[str, Floats]


class Solver(NamedTuple):
    """A scene, ready to be solved: what is timed, what it makes of it, and what is done before without being timed."""

    run: Callable[[], object]
    result: Callable[[], Trajectory]
    begin: Callable[[], object] = lambda: None


class Difference(NamedTuple):
    """How far a trajectory is from a reference: largest differences on the grid and of an event that both have, and how
    many events it has not, or has and the reference has not."""

    theta_rad: float
    event_s: float
    missed: int
    invented: int


def matched(reference: Floats, found: Floats) -> tuple[Floats, int, int]:
    """Differences of events that belong together, and how many of either side have no partner.

    Equal numbers are compared in order, as long as no pair is further apart than `MATCH_S`. Otherwise two events
    belong together when each is the other's nearest and they are no further apart than that.
    """
    if reference.size == found.size and np.all(np.abs(reference - found) <= MATCH_S):
        return np.abs(found - reference), 0, 0
    if reference.size == 0 or found.size == 0:
        return np.empty(0), reference.size, found.size
    distance = np.abs(reference[:, None] - found[None, :])
    nearest, back = distance.argmin(axis=1), distance.argmin(axis=0)
    own = np.arange(reference.size)
    pairs = (back[nearest] == own) & (distance[own, nearest] <= MATCH_S)
    return distance[own, nearest][pairs], int(np.sum(~pairs)), found.size - int(np.sum(pairs))


def difference(reference: Trajectory, found: Trajectory) -> Difference:
    """Compare a trajectory with a reference."""
    theta_rad = float(np.max(np.abs(reference.theta_rad - found.theta_rad)))
    event_s, missed, invented = 0.0, 0, 0
    for kind, times_s in found.events.items():
        errors, without, beyond = matched(reference.events[kind], times_s)
        event_s = max(event_s, float(errors.max(initial=0.0)))
        missed += without
        invented += beyond
    return Difference(theta_rad if math.isfinite(theta_rad) else math.inf, event_s, missed, invented)


def reference(scene: Scene) -> Trajectory:
    """theta on the grid and all events, to 40 digits."""
    asked = {"gap_m": scene.gap_m, "until_s": scene.duration_s, "samples_s": scene.times_s.tolist()}
    switches, theta_rad = modal(scene.settings, pieces=scene.motion, **asked)
    return _trajectory(theta_rad, switches)


def _trajectory(theta_rad: Sequence[float], switches: Sequence[tuple[float, str]]) -> Trajectory:
    events = {kind: np.array([t for t, name in switches if name == kind]) for kind in KINDS}
    return Trajectory(np.array(theta_rad), events)


def exact(scene: Scene) -> Solver:
    """The plant through the bench's seam, timed with 1 kHz output, periods and contacts; events and theta come from
    a run that asks for them."""
    plant, times_s = FingerPlant(scene.settings), scene.times_s

    def begin() -> None:
        plant.begin(key=(0, 0), gap_m=scene.gap_m)
        plant.excite(True)
        plant.move_probe(scene.motion)

    def run() -> None:
        plant.advance(scene.duration_s, frozenset({"accelerometer", "period"}))
        plant.periods()
        plant.contacts()
        plant.sample("accelerometer", times_s)

    def result() -> Trajectory:
        begin()
        theta_rad = []
        for t in times_s:
            plant.advance(float(t), frozenset({"switches"}))
            theta_rad.append(plant.theta_rad)
        return _trajectory(theta_rad, plant.switches())

    return Solver(run, result, begin)


def compiled_rk4(scene: Scene, substeps: int) -> Solver:
    """The compiled rival, with steps of 1 ms / `substeps`.

    Raises:
        ArithmeticError: when its result is asked for and it went astray: more events than can be.
    """
    c, motion, outputs = (
        constants(scene),
        np.array([*scene.motion, (np.inf, 0.0, 0.0, 0.0)]),
        scene.times_s.size,
    )
    room = int(EVENTS_PER_S * scene.duration_s) + 64
    theta, times, codes = np.empty(outputs), np.empty(room), np.empty(room, dtype=np.int64)
    counted = 0

    def run() -> None:
        nonlocal counted
        counted = located(c, motion, outputs, substeps, theta, times, codes)

    def result() -> Trajectory:
        if counted < 0:
            raise ArithmeticError(f"RK4 at {1e-3 / substeps:g} s: more events than can be")
        found, kinds = times[:counted], codes[:counted]
        return Trajectory(theta.copy(), {kind: found[kinds == code] for code, kind in enumerate(KINDS)})

    return Solver(run, result)


class Point(NamedTuple):
    """One solver at one setting on one scene; `us_per_s` is CPU time per simulated second."""

    scene: str
    closed: bool
    solver: str
    setting: str
    us_per_s: float
    off: Difference

    @property
    def whole(self) -> bool:
        """Whether it has every event of the reference and no other."""
        return self.off.missed == 0 and self.off.invented == 0

    @property
    def error(self) -> float:
        """What is compared: the larger of the error of events in s and of theta in rad."""
        return max(self.off.event_s, self.off.theta_rad)


def compare(*, quick: bool = False) -> Iterator[Point]:
    """Solve and time everything; quick: closed loop alone, 1.2 s."""
    for closed in (True,) if quick else (True, False):
        for scene in scenes(closed=closed, duration_s=1.2 if quick else DURATION_S):
            truth, steps = reference(scene), [2**k for k in range(FINEST + 1)]
            rivals = [(RK4, f"{1e3 / n:g} us", compiled_rk4(scene, n)) for n in steps]
            every = [(EXACT, "", exact(scene)), *rivals]
            taken_s = side_by_side_s([(solver.begin, solver.run) for _, _, solver in every])
            for (name, setting, solver), run_s in zip(every, np.median(taken_s, axis=0), strict=True):
                off = difference(truth, solver.result())
                yield Point(scene.name, closed, name, setting, float(run_s) / scene.duration_s * 1e6, off)


def cost_at(points: Sequence[Point], error: float) -> float:
    """What a solver costs at an error, us of CPU time per simulated second; infinity where no setting is good enough
    with every event found. Between settings it is on the straight line in logarithms.

    Args:
        points: Of one solver on one scene.
        error: In s for events and in rad for theta, whichever is larger.
    """
    good = sorted((p.error, p.us_per_s) for p in points if p.whole and 0.0 < p.error < math.inf)
    if not good or error < good[0][0]:
        return math.inf
    errors, costs = np.log(good).T
    return float(np.exp(np.interp(math.log(error), errors, costs)))


def ratios(points: Sequence[Point]) -> list[dict[str, Any]]:
    """How many times longer than the exact pieces the rival takes at equal error, a row a scene."""
    rows = []
    for scene, closed in dict.fromkeys((p.scene, p.closed) for p in points):
        here = [p for p in points if (p.scene, p.closed) == (scene, closed)]
        (ours,) = [p for p in here if p.solver == EXACT]
        row = {"scene": scene, "closed": closed, "exact_us_per_s": ours.us_per_s, "error": ours.error}
        rival = [p for p in here if p.solver == RK4]
        times = {f"{RK4} at {error:g}": cost_at(rival, error) / ours.us_per_s for error in (1e-9, 1e-12)}
        rows.append(row | times)
    return rows


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    points = []
    for p in compare(quick=quick):
        points.append(p)
        lost = "" if p.whole else f"{p.off.missed} missed, {p.off.invented} invented"
        about = f"{p.scene:13} {p.solver:20} {p.setting:>10} {p.us_per_s:12,.0f} us/s"
        print(f"{about}  {p.error:.0e} {lost}", flush=True)
    rows = [{**p._asdict(), "off": p.off._asdict()} for p in points]
    save("physics_strongest", {"ratios": ratios(points), "points": rows}, quick=quick)
