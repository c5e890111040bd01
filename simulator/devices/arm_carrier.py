"""An arm's tool with what the bench has in it: the controller's cycles in, the bench's wrench out."""

import math

import numpy as np

from drivers.arm.axis import Axis
from drivers.core.errors import RefusedError
from drivers.ur_arm.settings import UrArmSettings
from drivers.ur_arm.tool import stated
from simulator.devices.ur_controller.controller import UrController, UrControllerSettings
from simulator.devices.ur_controller.script import STEP_S
from simulator.devices.ur_controller.server import UrServer
from simulator.physics import arm, rigid
from simulator.physics.bench import Bench
from simulator.physics.rigid import Array, rotation, rotation_vector
from simulator.physics.tool_motion import STRAIGHT, Leg, ToolTrack

JOGGED_M = -0.005
"""Where the arm's tool is before it is sent home, on the approach axis (assumption: jogged near the start)."""

BEHIND_S = 0.02
"""How far the bench may be behind the arm before the arm takes it along (assumption: longer than a busy machine
keeps the board waiting, which otherwise takes it along itself and sees its motion)."""

LEGS = 1024
"""Legs remembered, two for each of the controller's cycles in which the tool moves: about a second."""


class ArmCarrier(ToolTrack):
    """Surroundings of an arm, and carrier of what is in its tool.

    The bench's tool follows the arm's one cycle behind, in straight lines from cycle to cycle: where a cycle comes
    late it goes on as it was.

    Args:
        axis: The approach axis in the arm's base frame.
    """

    def __init__(self, axis: Axis, bench: Bench) -> None:
        super().__init__(axis.direction, LEGS)
        self._axis = axis
        self._bench = bench
        start = axis.pose(0.0)
        self._start_m = np.array(start[:3])
        self._start_rad = np.array(start[3:])
        self._upright = rotation(start[3:]).T
        self._placed = False

    def wrench(self, pose: Array, twist: Array, t_s: float) -> tuple[float, ...]:
        """What the bench does to the tool; see `simulator.physics.arm_motion.Surroundings`."""
        offset = np.concatenate((pose[:3] - self._start_m, self._turn(pose[3:])))
        place, velocity = self.split(offset), self.split(twist)
        if self._placed:
            self._follow(place, velocity, t_s)
        else:
            self._placed = True
            self.place(t_s, 0.0)
            self.replace(t_s, [Leg(t_s, place, np.zeros(7), np.zeros(7), STRAIGHT)])
        present = self._bench.wrench(np.array([self._bench.t_s]), self._axis.direction)[0]
        return tuple(present.tolist())

    def _turn(self, rotation_rad: Array) -> Array:
        """How far the tool has turned from the start pose: a rotation vector, base frame, at most pi long."""
        if np.array_equal(rotation_rad, self._start_rad):
            return np.zeros(3)
        return rotation_vector(rotation(rotation_rad) @ self._upright)

    def _follow(self, place: Array, velocity: Array, t_s: float) -> None:
        last = self._legs[-1]
        if not velocity.any() and not last.velocity.any() and np.array_equal(place, last.place):
            return
        # What the bench has lived through already is not changed any more.
        start_s = max(t_s, self._bench.t_s)
        cycles = math.ceil((start_s - t_s) / STEP_S + 0.5)
        end_s = t_s + cycles * STEP_S
        end = place + velocity * ((cycles - 1) * STEP_S)
        here = self.leg(start_s).place
        rest = np.zeros(7)
        way = Leg(start_s, here, (end - here) / (end_s - start_s), rest, STRAIGHT)
        self.replace(start_s, [way, Leg(end_s, end, velocity, rest, STRAIGHT)])
        self._bench.on_plan(max(self._bench.t_s, t_s - BEHIND_S))


def emulated(settings: UrArmSettings, bench: Bench) -> UrServer:
    """The controller and its arm, with the tool that the driver's settings state, and what the bench has in it.

    Raises:
        RefusedError: the arm does not reach there.
    """
    axis, tool = Axis(settings), stated(settings)
    usual = UrControllerSettings.model_validate(tool._asdict())
    offset = rigid.matrix(tool.tcp_offset)
    try:
        joints_rad = arm.solve(rigid.matrix(axis.pose(JOGGED_M)), usual.joints_rad, offset)
    except arm.UnreachableError as error:
        raise RefusedError(
            "arm", "being set up", f"{error} at start_pose", "choose a start_pose that a UR5e reaches"
        ) from error
    carrier = ArmCarrier(axis, bench)
    bench.mount(carrier)
    there = usual.model_copy(update={"joints_rad": tuple(joints_rad.tolist())})
    return UrServer(UrController(there, carrier))
