"""The course of one trial of the finger: its scene, where it stands, and what it has left behind."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from drivers.core.messages import Floats
from simulator.physics import finger_kernel as kernel
from simulator.physics import finger_scene as scene
from simulator.physics.piecewise import DEGREE

if TYPE_CHECKING:
    from simulator.physics.finger_lock import Lock


SWITCHES = ("made", "lost", "comparator_up", "comparator_down", "drive_up", "drive_down")
"""Names of the switches, in the kernel's order: contact, comparator, oscillator."""

MOST_PIECES = 20_000_000
"""In one second of a run, shorter ones included: some 8 s of computing, or 18 hours of bench. More are needed where
contact is far too stiff or damped, which settings are not."""

_PLACES = 1024
"""For switches: taken out as they fill."""

_RECORDS = 512
"""Places for recorded pieces at first; more are made when a span needs them."""


class FingerCourse:
    """Runs the kernel, and takes out of its books what it wrote.

    Attributes:
        finger: The scene's constants; may be replaced where the course is settled.
        moment: The start of the piece under way.
        locked: A scene, and the lock that `finger_lock` has found for it.
    """

    def set_out(self, finger: scene.FingerConstants, t_s: float) -> None:
        """Begin at rest at a trial's start, with nothing behind it."""
        self.finger = finger
        self.locked: tuple[scene.FingerConstants, Lock | None] | None = None
        self.motion = scene.motion_of(np.array([[t_s, 0.0, 0.0, 0.0]]))
        self.moment = scene.at_rest()
        self.moment.put(t_s)
        # records of the present span and of the one before
        self._books = scene.books_of(_PLACES, _RECORDS, DEGREE)
        self._books_before = scene.books_of(_PLACES, _RECORDS, DEGREE)
        self._last_edge: tuple[int, float] | None = None
        self._edges: list[float] = []
        self._periods: list[float] = []
        self._contacts: list[tuple[float, bool]] = []
        self._switches: list[tuple[float, str]] = []

    def follow(self, table: Floats) -> None:
        """Give the probe another plan, shape (n, 4), where the course is settled."""
        self.motion = scene.motion_of(table)
        self.moment.flags[scene.PIECE] = 0
        self.moment.depth[0] = math.nan

    def rest_against_probe(self) -> None:
        """Let the finger rest where a probe that reaches into it holds it, base and joint deflected; else nothing.

        For the start of a trial: the finger was touched before, and all has come to rest since.
        """
        finger, x = self.finger, self.moment.x
        overlap_m = float(self.motion.position[0]) - finger.gap
        if overlap_m <= 0.0:
            return
        # The contact's torque bends base and joint according to their stiffness, and gives way by that.
        arm_m = finger.arm or finger.base_arm
        give_rad_n_m = 1.0 / finger.base + (1.0 / finger.joint if finger.arm else 0.0)
        force_n = finger.contact * overlap_m / (1.0 + finger.contact * arm_m**2 * give_rad_n_m)
        x[scene.BASE] = arm_m * force_n / finger.base
        x[scene.THETA] = arm_m * force_n * give_rad_n_m
        self.moment.flags[scene.MODE] = scene.TOUCHING
        self.moment.depth[0] = math.nan
        self._contacts.append((self.moment.t_s, True))

    def begin_span(self) -> None:
        """What was recorded becomes the span before; what was recorded before that is forgotten."""
        self._books, self._books_before = self._books_before, self._books
        self._books.filled[:] = 0

    def run(
        self,
        until_s: float,
        *,
        settle: bool = False,
        channels: int = 0,
        periods: bool = False,
        switches: bool = False,
    ) -> None:
        """Go on until a time.

        Args:
            settle: Cut the piece under way there, for something is about to change.
            channels: Sum of the kernel's bits of what is to be recorded.

        Raises:
            RuntimeError: more pieces than can be meant.
            FloatingPointError: the motion is no longer finite.
        """
        whole = math.floor(until_s)
        most = MOST_PIECES * max(1, math.ceil(until_s - self.moment.t_s))
        wanted = channels | (kernel.ALL_SWITCHES if switches else 0)
        while True:
            status = kernel.run(
                self.finger,
                self.motion,
                self.moment,
                whole,
                until_s - whole,
                settle,
                wanted,
                most,
                self._books,
            )
            self._note(periods, switches)
            if status == kernel.DONE:
                return
            if status == kernel.RECORDS_FULL:
                self._books = self._books.enlarged()
            elif status == kernel.ENDLESS:
                raise RuntimeError(
                    f"finger: {most} pieces between {self.moment.t_s} s and {until_s} s are not enough; "
                    "is the contact too stiff, or too damped?"
                )
            elif status == kernel.NOT_FINITE:
                raise FloatingPointError(f"finger: the motion is not finite at {self.moment.t_s} s")

    def _note(self, periods: bool, switches: bool) -> None:
        books = self._books
        count = books.filled[0]
        if not count:
            return
        books.filled[0] = 0
        columns = (books.switch_whole, books.switch_fraction, books.switch)
        for whole, fraction, kind in zip(*(column[:count].tolist() for column in columns), strict=True):
            if kind == scene.DRIVE_UP:
                if periods and self._last_edge is not None:
                    self._edges.append(whole + fraction)
                    self._periods.append((whole - self._last_edge[0]) + (fraction - self._last_edge[1]))
                self._last_edge = whole, fraction
            elif kind <= scene.LOST:
                self._contacts.append((whole + fraction, kind == scene.MADE))
            if switches:
                self._switches.append((whole + fraction, SWITCHES[kind]))

    def present(self, now_s: float) -> scene.Moment:
        """State, switches and time now; the course itself stays at the start of its piece."""
        under_way, self.moment = self.moment, self.moment.copy()
        self.run(now_s, settle=True, periods=True)
        settled, self.moment = self.moment, under_way
        return settled

    def leave_out(self, seconds: float) -> None:
        """Put the clock forward and keep the state: the next edge ends no period."""
        self.moment.put(self.moment.t_s + seconds)
        self._last_edge = None

    def enter(self, x: tuple[float, ...], comparator: int, t_s: float) -> None:
        """Go on from another state, free and excited, at a rising edge of the oscillator."""
        self.moment.x[:] = x
        self.moment.flags[:] = (scene.FREE, comparator, 1, 1, self.moment.flags[scene.PIECE], 0)
        self.moment.put(t_s)
        self._last_edge = None

    def read(self, which: int, times_s: Floats, out: Floats, *, before: bool) -> None:
        """Sample what was recorded in the present span, or in the one before.

        Args:
            which: 0 the accelerometer, 1 the force, 2 the second accelerometer.
            times_s: Ascending, shape (n,).
            out: Written, shape (n,).
        """
        kernel.read(self._books_before if before else self._books, which, times_s, out)

    def force_at(self, now_s: float) -> float:
        """Force between probe and finger, N."""
        moment, finger = self.present(now_s), self.finger
        if moment.flags[scene.MODE] != scene.TOUCHING:
            return 0.0
        _, velocity, _ = kernel.probe_at(
            self.motion, moment.flags[scene.PIECE], moment.whole[0], moment.fraction[0], moment.fraction[1]
        )
        speed = velocity - finger.arm * moment.x[scene.OMEGA] - finger.base_arm * moment.x[scene.BASE_RATE]
        return float(finger.contact * moment.depth[0] + finger.contact_damping * speed)

    def probe_rests(self, from_s: float, until_s: float) -> float | None:
        """Where the probe rests between two times, or None where it moves; of several places the farthest."""
        motion = self.motion
        starts = motion.whole + motion.fraction
        first = max(0, int(np.searchsorted(starts, from_s, side="right")) - 1)
        span = slice(first, max(first + 1, int(np.searchsorted(starts, until_s))))
        if motion.velocity[span].any() or motion.acceleration[span].any():
            return None
        return float(motion.position[span].max())

    def periods(self) -> tuple[Floats, Floats]:
        """What the board's period counter counted in observed spans since the last call.

        Returns:
            Rising edges of the drive in s, shape (n,), and the period that each of them ended in s, shape (n,).
        """
        edges, periods = np.array(self._edges), np.array(self._periods)
        self._edges, self._periods = [], []
        return edges, periods

    def contacts(self) -> list[tuple[float, bool]]:
        """The truth: (time in s, whether force began or ended) since the last call. For scoring alone."""
        taken, self._contacts = self._contacts, []
        return taken

    def switches(self) -> list[tuple[float, str]]:
        """All switches in spans that observed `switches`, since the last call.

        Returns:
            (time in s, one of `made`, `lost`, `comparator_up`, `comparator_down`, `drive_up`, `drive_down`).
        """
        taken, self._switches = self._switches, []
        return taken
