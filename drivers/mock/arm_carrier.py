"""An arm's tool with the bench's probe in it: the controller's cycles in, the finger's force out."""

from __future__ import annotations

import math

from drivers.mock.devices.ur_controller.script import STEP_S
from drivers.mock.finger_bench import FingerBench
from drivers.mock.plants.rigid import Array
from drivers.mock.plants.stage_axis import AxisMotion, Piece
from drivers.ur_arm.settings import Axis

BEHIND_S = 0.02
"""How far the bench may be behind the arm before the arm takes it along (assumption: longer than a busy machine
keeps the board waiting, which does so otherwise and hears what it does)."""


class ArmCarrier(AxisMotion):
    """Surroundings of an arm, and carrier of the probe in its tool.

    The probe follows the tool's place on the approach axis one cycle behind, in straight lines from cycle to cycle:
    where a cycle comes late it goes on as it was. What the tool does beside the axis moves no probe.

    Args:
        axis: The approach axis in the arm's base frame.
        bench: Where the finger is.
    """

    def __init__(self, axis: Axis, bench: FingerBench) -> None:
        super().__init__()
        self._axis = axis
        self._bench = bench
        self._placed = False

    def wrench(self, pose: Array, twist: Array, t_s: float) -> tuple[float, ...]:
        """The finger's force on the tool; see `drivers.mock.plants.arm_motion.Surroundings`."""
        x, y, z, rx, ry, rz = pose.tolist()
        position_m = self._axis.position_m((x, y, z, rx, ry, rz))
        velocity_m_s = sum(float(twist[i]) * self._axis.direction[i] for i in range(3))
        if self._placed:
            self._follow(position_m, velocity_m_s, t_s)
        else:
            self._placed = True
            self.place(t_s, position_m)
        force_n = self._bench.force_n
        return (*(-force_n * part for part in self._axis.direction), 0.0, 0.0, 0.0)

    def _follow(self, position_m: float, velocity_m_s: float, t_s: float) -> None:
        if velocity_m_s == 0.0 and self.target_m == position_m and self.velocity(self.arrival_s) == 0.0:
            return
        # What the finger has lived through already is not changed any more.
        start_s = max(t_s, self._bench.t_s)
        cycles = math.ceil((start_s - t_s) / STEP_S + 0.5)
        end_s = t_s + cycles * STEP_S
        end_m = position_m + velocity_m_s * (cycles - 1) * STEP_S
        here_m = self.position(start_s)
        way = Piece(start_s, here_m, (end_m - here_m) / (end_s - start_s), 0.0)
        self.replace(start_s, [way, Piece(end_s, end_m, velocity_m_s, 0.0)])
        self._bench.on_plan(max(self._bench.t_s, t_s - BEHIND_S))
