"""An object between two pads: against a solver of other logic, against closed forms, and under stress."""

import math
from functools import partial
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from simulator.physics import held_kernel as kernel
from simulator.physics.held_kernel import GRAVITY_M_S2, PRESSED, RINGS, STATIC, STEPS, TURN_M, Held

HOLD_N_M = 4264.0
ROW_S = 1e-3


def thing(mass_kg=0.2, friction=0.2, lever_m=0.0, gyration_m=0.03, **about):
    """An object; hung on and tapped as `about` says."""
    usual = {"up_m": 0.005, "added": 0.0, "added_s": 0.1, "added_for_s": 0.04}
    usual |= {"tap_n": 0.0, "tap_s": 0.1, "tap_for_s": 0.004}
    return Held(mass_kg, friction, HOLD_N_M, lever_m, gyration_m, **usual | about)


def followed(about, tools_m, forces_n, steps=STEPS):
    """State after each millisecond."""
    x = np.zeros(kernel.NUMBERS)
    rows = []
    for tool_m, force_n in zip(tools_m, forces_n, strict=True):
        kernel.carried(about, x, float(tool_m), float(force_n), ROW_S, steps)
        rows.append(x.copy())
    return np.array(rows)


STANDS_S = 0.02
"""The pads press before the tool moves."""


def lifting(duration_s, height_m=0.02, speed_m_s=0.02):
    times_s = np.arange(1, round((STANDS_S + duration_s) / ROW_S) + 1) * ROW_S
    return np.clip(speed_m_s * (times_s - STANDS_S), 0.0, height_m)


class Reference:
    """The same object without lever under a constant force: event by event, each piece by DOP853."""

    def __init__(self, about, force_n, speed_m_s, top_m):
        self.about, self.speed_m_s, self.top_m = about, speed_m_s, top_m
        self.most_n = 2.0 * about.friction * force_n * PRESSED
        self.y = np.zeros(2)  # height and speed
        self.held_m = np.zeros(RINGS)
        self.slides = np.zeros(RINGS, bool)
        self.direction = np.ones(RINGS)
        self.t_s, self.slid_m, self.onset_s = 0.0, 0.0, math.nan
        self.k_n_m = about.hold_n_m / RINGS

    def tool(self, t_s):
        """Height and speed of the tool."""
        arrives_s = self.top_m / self.speed_m_s
        return (self.speed_m_s * t_s, self.speed_m_s) if t_s < arrives_s else (self.top_m, 0.0)

    def pulls(self, t_s, y):
        """Force of each ring, were none to slide anew."""
        tool_m, tool_m_s = self.tool(t_s)
        elastic = self.k_n_m * (tool_m - y[0] - self.held_m + kernel.RELAX_S * (tool_m_s - y[1]))
        return np.where(self.slides, self.direction * self.most_n, elastic)

    def lags(self, ring, t_s, y):
        """How fast the pads move over the object, the way that a ring slides."""
        return self.direction[ring] * (self.tool(t_s)[1] - y[1])

    def exceeds(self, ring, t_s, y):
        """By how much a ring that sticks is overloaded."""
        return abs(self.pulls(t_s, y)[ring]) - STATIC * self.most_n[ring]

    def rises(self, mass_kg, t_s, y):
        """By how much the pads pull more than it weighs."""
        return self.pulls(t_s, y).sum() - mass_kg * GRAVITY_M_S2

    def run(self, until_s, mass_kg):
        """Go on to a time with this mass."""
        while self.t_s < until_s - 1e-12:
            stands = self.y[0] <= 0.0 and self.pulls(self.t_s, self.y).sum() <= mass_kg * GRAVITY_M_S2

            def rate(t_s, y, stands=stands):
                if stands:
                    return [0.0, 0.0]
                return [y[1], self.pulls(t_s, y).sum() / mass_kg - GRAVITY_M_S2]

            events: list[Any] = []
            for ring in range(RINGS):
                if self.slides[ring]:
                    # it sticks where the pads no longer move over the object that way
                    events.append(partial(self.lags, ring))
                    events[-1].direction = -1.0
                else:
                    events.append(partial(self.exceeds, ring))
                    events[-1].direction = 1.0
            if stands:
                events.append(partial(self.rises, mass_kg))
            for event in events:
                event.terminal = True
            end_s = until_s
            arrives_s = self.top_m / self.speed_m_s
            if self.t_s < arrives_s - 1e-12 < until_s:
                end_s = arrives_s
            found = solve_ivp(
                rate,
                (self.t_s, end_s),
                self.y,
                "DOP853",
                events=events,
                rtol=1e-11,
                atol=1e-14,
                max_step=1e-3,
            )
            moved_m = (self.tool(found.t[-1])[0] - found.y[0, -1]) - (self.tool(self.t_s)[0] - self.y[0])
            if self.slides.all():
                self.slid_m += abs(moved_m)
            self.t_s, self.y = float(found.t[-1]), found.y[:, -1]
            for ring in range(RINGS):
                if self.slides[ring]:
                    stretch_m = self.tool(self.t_s)[0] - self.y[0]
                    self.held_m[ring] = stretch_m - self.direction[ring] * self.most_n[ring] / self.k_n_m
                    rests = self.direction[ring] * (self.tool(self.t_s)[1] - self.y[1]) <= 1e-9
                    self.slides[ring] = not rests  # those of another event of this instant as well
                elif found.t_events is not None and len(found.t_events[ring]):
                    self.direction[ring] = np.sign(self.pulls(self.t_s, self.y)[ring])
                    self.slides[ring] = True
            if self.slides.all() and math.isnan(self.onset_s):
                self.onset_s = self.t_s
            self.t_s += 1e-12


def test_slip_under_a_load_that_is_hung_on_agrees_with_a_solver_of_other_logic():
    hung_s, taken_s, end_s = 0.4, 0.44, 1.0
    up_s = 0.25  # when the tool is at 5 mm
    about = thing(added=0.8, added_s=hung_s - up_s, added_for_s=taken_s - hung_s)
    force_n = 1.3 * 0.2 * GRAVITY_M_S2 / (2 * 0.2)
    reference = Reference(about, force_n, 0.02, 0.02)
    reference.run(hung_s, 0.2)
    assert math.isnan(reference.onset_s)
    reference.run(taken_s, 0.2 * 1.8)
    reference.run(end_s, 0.2)
    tools_m = lifting(end_s)
    rows = followed(about, tools_m, np.full(len(tools_m), force_n))
    hung = np.flatnonzero(rows[:, kernel.AIR_S] > 0.0)[0]
    assert hung == pytest.approx((STANDS_S + up_s) / ROW_S, abs=1)
    began_s = (np.flatnonzero(np.diff(rows[:, kernel.SLID]) > 0.0)[0] + 2) * ROW_S - STANDS_S
    assert began_s == pytest.approx(reference.onset_s, abs=2 * ROW_S), (
        "a row of each: of the load, and of the slip"
    )
    assert reference.slid_m > 1e-3

    assert rows[-1, kernel.SLID] == pytest.approx(reference.slid_m, abs=1e-5)
    assert rows[-1, kernel.HEIGHT] == pytest.approx(reference.y[0], abs=1e-5)


@pytest.mark.parametrize(("lever_m", "mass_kg"), [(0.0, 0.02), (0.0, 0.2), (0.003, 0.2), (0.002, 1.0)])
def test_halving_the_step_changes_slip_by_less_than_two_micrometres(lever_m, mass_kg):
    about = thing(mass_kg=mass_kg, lever_m=lever_m, added=0.6)
    tools_m = lifting(1.0)
    least_n = mass_kg * GRAVITY_M_S2 / (2 * about.friction) * math.hypot(1.0, lever_m / TURN_M)
    forces_n = np.full(len(tools_m), 1.3 * least_n)
    once, twice, fine = (
        followed(about, tools_m, forces_n, steps) for steps in (STEPS, 2 * STEPS, 16 * STEPS)
    )
    slid = [rows[-1, kernel.SLID] for rows in (once, twice, fine)]
    assert slid[2] > 1e-5, "it slips"
    assert abs(slid[0] - slid[2]) < 2e-6 + 0.01 * slid[2]
    assert abs(slid[1] - slid[2]) < 2e-6 + 0.005 * slid[2]
    height = kernel.HEIGHT
    assert np.abs(once[:, height] - fine[:, height]).max() < 5e-6 + 0.01 * slid[2]


@pytest.mark.parametrize("lever_m", [0.0, 0.002, 0.004])
def test_the_least_force_is_where_slip_begins(lever_m):
    about = thing(lever_m=lever_m)
    least_n = 0.2 * GRAVITY_M_S2 / (2 * about.friction) * math.hypot(1.0, lever_m / TURN_M)
    tools_m = lifting(4.0, speed_m_s=0.005)
    for share, slides in ((0.93, True), (1.0, False)):
        rows = followed(about, tools_m, np.full(len(tools_m), 2.5 * least_n))
        x = rows[-1].copy()
        for k in range(4000):  # let go slowly: nothing swings
            force_n = least_n * (2.5 - (2.5 - share) * min(k / 3000, 1.0))
            kernel.carried(about, x, float(tools_m[-1]), force_n, ROW_S, STEPS)
        assert slides or x[kernel.LEAST] == pytest.approx(least_n, rel=1e-9)
        assert (x[kernel.SLID] - rows[-1, kernel.SLID] > 1e-4) == slides


def test_what_is_let_go_falls_as_a_body_does_and_lies_on_the_table():
    about = thing()
    tools_m = lifting(1.7)
    forces_n = np.where(np.arange(len(tools_m)) < 1500, 20.0, 0.0)
    rows = followed(about, tools_m, forces_n)
    height_m = rows[1499, kernel.HEIGHT]
    fell_s = np.arange(1, 21) * ROW_S - 0.0005  # the force is gone halfway through the millisecond
    expected_m = height_m - 0.5 * GRAVITY_M_S2 * fell_s**2
    assert rows[1500:1520, kernel.HEIGHT] == pytest.approx(expected_m, abs=1.5e-4)
    assert rows[-1, kernel.HEIGHT] == rows[-1, kernel.SPEED] == rows[-1, kernel.LOAD] == 0.0


def test_a_tap_moves_what_is_held_and_slides_nothing():
    about = thing(tap_n=1.0)
    tools_m = lifting(2.0)
    rows = followed(about, tools_m, np.full(len(tools_m), 1.6 * 0.2 * GRAVITY_M_S2 / (2 * about.friction)))
    quiet = followed(about._replace(tap_n=0.0), tools_m, np.full(len(tools_m), 7.85))
    assert np.abs(rows[:, kernel.HEIGHT] - quiet[:, kernel.HEIGHT]).max() > 2e-5
    assert rows[-1, kernel.SLID] == quiet[-1, kernel.SLID]


def test_partial_slip_comes_before_gross_slip():
    about = thing(mass_kg=2.0)
    tools_m = lifting(1.0, speed_m_s=0.002)
    rows = followed(about, tools_m, np.full(len(tools_m), 8.0))
    first = [np.flatnonzero(rows[:, kernel.SLIDES + ring] > 0.0)[0] for ring in range(RINGS)]
    loads_n = rows[first, kernel.LOAD]
    assert sorted(first) == first
    assert loads_n[0] == pytest.approx(0.8 * STATIC * 2 * about.friction * 8.0, rel=0.03)
    assert rows[first[-1] - 1, kernel.SLID] == pytest.approx(0.0, abs=1e-12)


def test_no_force_no_motion_and_no_object_makes_it_leave_its_bounds():
    random = np.random.default_rng(5)
    for _ in range(60):
        about = thing(
            mass_kg=float(10 ** random.uniform(-1.7, 0.3)),
            friction=float(random.uniform(0.05, 1.5)),
            lever_m=float(random.uniform(-0.02, 0.02)),
            gyration_m=float(10 ** random.uniform(-2.5, -0.5)),
            added=float(random.uniform(0.0, 3.0)),
            tap_n=float(random.uniform(0.0, 50.0)),
        )
        tools_m = np.cumsum(random.normal(0.0, 3e-5, 3000) + 1e-5)
        forces_n = np.where(random.random(3000) < 0.01, 0.0, 60.0 * random.random(3000) ** 3)
        rows = followed(about, tools_m, forces_n)
        assert np.isfinite(rows).all()
        assert (rows[:, kernel.HEIGHT] >= 0.0).all()
        most_n = STATIC * 2.0 * about.friction * forces_n
        assert (np.abs(rows[:, kernel.LOAD]) <= most_n * (1 + 1e-9) + 1e-12).all()
        assert (np.diff(rows[:, kernel.SLID]) >= 0.0).all()
