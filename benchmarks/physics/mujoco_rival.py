"""MuJoCo: two hinges, a tendon between them, C stepping; contact, drive and electronics in one compiled callback.

The mechanics (1), (2) are MuJoCo's own: stiffness and damping of the base in its hinge, those of the joint in a fixed
tendon between the hinges. The contact is not: MuJoCo's soft constraint mixes the free acceleration into the force and
knows no speed of a moving limit, so that it is another law than (4). The force of (4) is applied as a torque in every
evaluation instead. The electronics are five activations of a user-defined actuator. The callback is compiled (numba)
and called from C, without Python in between. Switches act from the end of a step on, as in the compiled fixed-step
rivals: MuJoCo locates no events.
"""

from __future__ import annotations

import ctypes
from functools import cache
from typing import Any

import mujoco
import numpy as np
from llvmlite import ir
from numba import cfunc, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray
from numba.np.unsafe.ndarray import to_fixed_tuple

from benchmarks.physics.dynamics import (
    BY_LAW,
    Constants,
    constants,
    contact_force,
    derivative,
    motion_table,
    probe,
)
from benchmarks.physics.fixed_step import switched, watched
from benchmarks.physics.model import OUTPUT_HZ, Scene, Solver, Trajectory
from benchmarks.physics.rivals import EVENTS_PER_S

METHODS = ("Euler", "RK4")

MODEL = """
<mujoco>
  <option gravity="0 0 0"><flag constraint="disable" contact="disable"/></option>
  <worldbody>
    <body><joint name="finger" type="hinge" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
    <body><joint name="base" type="hinge" axis="0 1 0"/><inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/></body>
  </worldbody>
  <tendon><fixed name="joint"><joint joint="finger" coef="1"/><joint joint="base" coef="-1"/></fixed></tendon>
  <actuator><general name="electronics" joint="finger" dyntype="user" actdim="5" gainprm="0"/></actuator>
</mujoco>
"""

_ROWS = 8
"""Room for the probe's plan."""

LONGEST_S = 10.0
"""Longest scene that there is room for."""

_SIGNATURE = ctypes.CFUNCTYPE(ctypes.c_double, ctypes.c_void_p, ctypes.c_void_p, ctypes.c_int)

_INTEGRATORS = {"Euler": mujoco.mjtIntegrator.mjINT_EULER, "RK4": mujoco.mjtIntegrator.mjINT_RK4}

_CONSTANTS = len(Constants._fields)


@intrinsic
def _at(typing_context: Any, address: Any) -> Any:
    """An address as a pointer to doubles."""

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], ir.DoubleType().as_pointer())

    doubles: Any = types.CPointer
    return doubles(types.float64)(types.int64), code


_pointer: Any = _at
_tuple: Any = to_fixed_tuple
"""Called by compiled code alone, in another way than their types say."""


def _view(array: Any) -> tuple[int, tuple[int, ...]]:
    """What compiled code needs to look at an array's memory."""
    return array.ctypes.data, array.shape


class _Bench:
    """Model, data, and the memory that the callback shares with Python.

    One for the process, for the callback is compiled for their addresses.
    """

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_string(MODEL)
        self.data = mujoco.MjData(self.model)
        events = int(EVENTS_PER_S * LONGEST_S)
        self.values = np.zeros(len(Constants._fields))
        self.motion = np.zeros((_ROWS, 4))
        self.times, self.codes = np.zeros(events), np.zeros(events)
        self.theta = np.zeros(int(OUTPUT_HZ * LONGEST_S) + 1)
        # stage, stages a step, step, substeps, row of the plan; comparator, oscillator, events; step's length; what was
        # watched at its start
        self.notes = np.zeros(12)
        self.callback = self._compiled()
        self.handle = _SIGNATURE(self.callback.address)

    def _compiled(self) -> Any:
        d = self.data
        qpos, qvel, act, act_dot, torque = (
            _view(a) for a in (d.qpos, d.qvel, d.act, d.act_dot, d.qfrc_applied)
        )
        values, motion, theta = _view(self.values), _view(self.motion), _view(self.theta)
        times, codes, notes = _view(self.times), _view(self.codes), _view(self.notes)

        @cfunc("float64(voidptr, voidptr, int32)")
        def callback(model: Any, data: Any, actuator: int) -> float:
            q, w = carray(_pointer(qpos[0]), qpos[1]), carray(_pointer(qvel[0]), qvel[1])
            electronics, rates = carray(_pointer(act[0]), act[1]), carray(_pointer(act_dot[0]), act_dot[1])
            applied = carray(_pointer(torque[0]), torque[1])
            c = Constants(*_tuple(carray(_pointer(values[0]), values[1]), _CONSTANTS))
            plan = carray(_pointer(motion[0]), motion[1])
            note = carray(_pointer(notes[0]), notes[1])
            stage, step, h = int(note[0]), int(note[2]), note[8]
            a, g1, g2, v, phase = _tuple(electronics, 5)
            x = (q[0], w[0], q[1], w[1], a, g1, g2, v, phase)
            t = step * h
            if stage == 0:
                s, s_rate, _ = probe(plan, int(note[4]), t)
                after = watched(c, s, s_rate, x)
                if step > 0:
                    switches, electronics[4] = switched(
                        c,
                        t - h,
                        h,
                        (note[9], note[10], note[11]),
                        after,
                        x,
                        (int(note[5]), int(note[6]), int(note[7])),
                        carray(_pointer(times[0]), times[1]),
                        carray(_pointer(codes[0]), codes[1]),
                    )
                    note[5], note[6], note[7] = switches
                note[9], note[10], note[11] = after
                substeps = int(note[3])
                if step % substeps == 0:
                    carray(_pointer(theta[0]), theta[1])[step // substeps] = q[0]
                if t >= plan[int(note[4]) + 1, 0] - 0.5 * h:
                    note[4] += 1.0
                note[2] += 1.0
            else:
                # RK4's later stages belong to the step that its first has begun
                t = (step - 1) * h + (h if stage == 3 else 0.5 * h)
            note[0] = float((stage + 1) % int(note[1]))
            s, s_rate, _ = probe(plan, int(note[4]), t)
            comparator, oscillator = int(note[5]), int(note[6])
            d = derivative(c, BY_LAW, comparator, oscillator, s, s_rate, x)
            rates[0], rates[1], rates[2], rates[3], rates[4] = d[4:]
            force = contact_force(c, BY_LAW, s - c.gap - c.arm * q[0], s_rate - c.arm * w[0])
            applied[0] = (c.drive if oscillator else -c.drive) + c.arm * force
            return 0.0

        return callback

    def prepare(self, scene: Scene, method: str, substeps: int) -> None:
        """Set everything to a scene's start."""
        p, m = scene.parameters, self.model
        m.opt.timestep = 1.0 / (OUTPUT_HZ * substeps)
        m.opt.integrator = _INTEGRATORS[method]
        m.body_inertia[1], m.body_inertia[2] = p.inertia, p.base_inertia
        m.jnt_stiffness[1], m.dof_damping[1] = p.base, p.base_damping
        m.tendon_stiffness[0], m.tendon_damping[0] = p.joint, p.joint_damping
        mujoco.mj_setConst(m, self.data)
        mujoco.mj_resetData(m, self.data)
        self.data.act[3] = 0.5
        self.values[:] = constants(p)
        self.motion[: len(scene.motion) + 1] = motion_table(scene.motion)
        self.notes[:] = 0.0
        self.notes[1] = 4 if method == "RK4" else 1
        self.notes[3], self.notes[8] = substeps, m.opt.timestep


@cache
def _bench() -> _Bench:
    return _Bench()


def prepared(scene: Scene, method: str, substeps: int) -> Solver:
    """MuJoCo with steps of 1 ms / `substeps`.

    Args:
        scene: At most `LONGEST_S` long.
        method: One of `METHODS`: MuJoCo's semi-implicit Euler or its RK4.
        substeps: Steps in a millisecond.
    """
    bench, outputs = _bench(), scene.times_s.size

    def run() -> None:
        bench.prepare(scene, method, substeps)
        mujoco.set_mjcb_act_dyn(bench.handle)
        try:
            # what a step did is looked at when the next begins
            mujoco.mj_step(bench.model, bench.data, nstep=outputs * substeps + 1)
        finally:
            mujoco.set_mjcb_act_dyn(None)

    def result() -> Trajectory:
        count = int(bench.notes[7])
        codes = bench.codes[:count].astype(np.int64)
        return Trajectory.from_codes(bench.theta[1 : outputs + 1].copy(), bench.times[:count].copy(), codes)

    return Solver(run, result)
