"""The client's control script, re-implemented: what a controller does with the commands in its registers.

[E]: this follows `rtde_control.script` of ur_rtde 1.6.5 thread by thread, each a generator that is run once
in 2 ms; how a real controller schedules them is not known here. What is not emulated (paths, `servoc`, gravity,
external force sensors) ends the program with an entry in the log, as a runtime exception does.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from simulator.devices.ur_controller.registers import Registers
from simulator.physics import arm, rigid
from simulator.physics.arm_motion import (
    ArmMotion,
    JointMove,
    JointServo,
    JointSpeed,
    ToolMove,
    ToolSpeed,
    Yielding,
)
from simulator.physics.rigid import Array

if TYPE_CHECKING:
    from simulator.devices.ur_controller.controller import UrController

STEP_S = 0.002
"""The controller's cycle: 500 Hz on an e-Series (RTDE guide)."""

READY, DONE = 1, 2
"""Output integer 0: ready for a command, done with it (control script)."""

STREAMING = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands obeyed afresh in every cycle, without an answer (control script)."""

STOP_SCRIPT, CONTACT_FOUND = 255, 254

NOT_EMULATED = {
    12: "servoC: servoJ and servoL are",
    45: "movePath, and moveJ and moveL along a path: one pose after the other is",
    56: "ftRtdeInputEnable: the arm's own force sensor is",
    57: "enableExternalFtSensor: the arm's own force sensor is",
    59: "setGravity: an upright arm is",
}
"""Commands of the client's script that end the program, and what is emulated in their place."""

CONTACT_STOP_M_S2 = 3.0
"""How `stopl` stops after a contact, and `jog` uses 1.2 (control script)."""

JOG_STOP_M_S2 = 1.2
JOG_S = 0.01

RETURN_M_S, RETURN_M_S2 = 0.25, 1.2
"""Speed and acceleration of a `movel` that names none (script manual)."""

FORCE_STOP_M_S2 = 10.0
"""How `stopl` ends force mode (control script)."""

TOWARDS_FRAME, TASK_FRAME, ALONG_MOTION = 1, 2, 3
"""Types of force mode: y axis from the tool to the frame's origin; the frame as it is; x axis along the tool's velocity
in the frame's x-y plane (script manual)."""

NO_LENGTH = 1e-6
"""m, m/s: what is shorter has no direction (assumption)."""

USUAL_GAIN, USUAL_DAMPING = 0.5, 0.025
"""Of force mode, as the script sets them when it starts (control script)."""

LED_M_S, LED_RAD_S = 0.25, 1.0
"""How fast an arm can be led by hand (assumption)."""

_NOWHERE = (0.0,) * 6

Thread = Generator[None, None, None]


class ScriptError(RuntimeError):
    """The program did what the controller does not allow, and stops."""


class ControlScript:
    """One run of the script.

    Args:
        offset: Number of its first register: 0 or 24.
    """

    def __init__(self, controller: UrController, offset: int) -> None:
        self._controller = controller
        self._r = Registers(controller.inputs, controller.outputs, offset)
        self._threads: dict[str, Thread] = {"main": self._main()}
        self._mover: str | None = None
        self._kept: dict[str, tuple[Callable[[], ArmMotion], float]] = {}
        self._speeds_joints = False
        self._jog_frame = rigid.IDENTITY
        self._gain, self._damping = USUAL_GAIN, USUAL_DAMPING
        self._stop_with_line = False
        self._internal = 0
        self._contact_steps = 0
        self._handlers: dict[int, Callable[[], Thread | None]] = {
            1: lambda: self._move(JointMove(self._r.vector(), self._r.f(6), self._r.f(7))),
            2: lambda: self._move(JointMove(self._joints_for(), self._r.f(6), self._r.f(7))),
            3: lambda: self._move(ToolMove(rigid.matrix(self._r.vector()), self._r.f(6), self._r.f(7))),
            4: lambda: self._move(ToolMove(self._pose_of(self._r.vector()), self._r.f(6), self._r.f(7))),
            6: self._force,
            7: lambda: self._end("force", ToolSpeed(_NOWHERE, FORCE_STOP_M_S2)),
            8: controller.zero_force,
            9: lambda: self._speed(JointSpeed, joints=True),
            10: lambda: self._speed(ToolSpeed, joints=False),
            11: lambda: self._servo(self._r.vector()),
            15: lambda: self._end("speed", self._standstill(self._r.f(0), self._speeds_joints)),
            16: lambda: self._end("servo", self._standstill(self._r.f(0), joints=False)),
            17: self._set_payload,
            18: lambda: self._lead(rigid.IDENTITY, [True] * 6),
            19: lambda: self._end("freedrive", ToolSpeed(_NOWHERE, FORCE_STOP_M_S2)),
            20: lambda: self._stiffen(self._gain, self._r.f(0)),
            21: lambda: self._stiffen(self._r.f(0), self._damping),
            24: lambda: self._servo(self._joints_for()),
            25: lambda: self._r.answer(controller.contact_steps(self._r.vector())),
            26: lambda: self._r.report([STEP_S]),
            27: lambda: self._r.report(controller.joints_before(self._r.i(1))),
            28: lambda: self._r.report(controller.arm.joints_rad),
            29: lambda: controller.arm.mount(rigid.matrix(self._r.vector())),
            30: lambda: self._r.report(
                arm.solve(rigid.matrix(self._r.vector()), self._r.vector(6), self._tool)
            ),
            31: self._protective_stop,
            33: self._stop_move,
            34: self._stop_move,
            35: lambda: controller.set_watchdog(self._r.command, self._r.f(0)),
            36: lambda: self._r.answer(self._reachable()),
            37: lambda: self._r.answer(float(np.abs(self._r.vector()).max()) <= arm.JOINT_LIMIT_RAD),
            38: lambda: self._r.report([0.0] * 6),
            39: lambda: self._r.report(
                rigid.pose(rigid.matrix(self._r.vector()) @ rigid.matrix(self._r.vector(6)))
            ),
            40: lambda: self._r.report(rigid.pose(self._tool)),
            41: self._jog_start,
            42: lambda: self._end("jog", ToolSpeed(_NOWHERE, JOG_STOP_M_S2)),
            43: lambda: self._r.report(controller.arm.pose),
            44: lambda: self._r.report(
                rigid.pose(self._pose_of(self._r.vector(), rigid.matrix(self._r.vector(6))))
            ),
            46: lambda: self._r.report(self._joints_for()),
            47: lambda: self._r.answer(controller.arm.resting),
            51: self._move_until_contact,
            52: self._freedrive,
            53: lambda: self._end("freedrive", ToolSpeed(_NOWHERE, FORCE_STOP_M_S2)),
            54: lambda: self._r.answer(0),
            58: lambda: self._r.report(rigid.pose(arm.forward(controller.arm.joints_rad))),
            60: lambda: self._r.answer(self._reachable()),
            61: lambda: self._r.answer(self._reachable()),
            62: self._contact_start,
            63: self._contact_stop,
            64: lambda: self._r.answer(self._contact_steps),
            65: self._set_payload,
            **dict.fromkeys(range(66, 72), lambda: None),  # from version 5.23 on
            CONTACT_FOUND: self._contact_found,
        }

    def step(self) -> bool:
        """Run every thread to its next `sync`; False when the script has ended.

        Raises:
            ValueError, ArithmeticError, LookupError, TypeError, ScriptError: it is at fault, and ends.
        """
        ran: set[str] = set()
        while pending := [name for name in self._threads if name not in ran]:
            ran.add(pending[0])
            try:
                next(self._threads[pending[0]])
            except StopIteration:
                self._threads.pop(pending[0], None)
        return "main" in self._threads

    # --- the main loop -------------------------------------------------------------------------------

    def _main(self) -> Thread:
        self._r.progress(-1)
        self._r.output(0, READY)
        executing = False
        while True:
            command = self._command()
            if command == STOP_SCRIPT:
                return
            if command in STREAMING:
                yield from self._obey(command)
                self._r.output(0, READY)
            elif command == 0:
                executing = False
                self._r.output(0, READY)
            elif not executing:
                yield from self._obey(command)
                self._r.output(0, DONE)
                executing = True
            yield

    def _command(self) -> int:
        command = self._r.i(0)
        if command == 0:
            command, self._internal = self._internal, 0
        return command

    def _obey(self, command: int) -> Thread:
        if command not in self._handlers:
            name = NOT_EMULATED.get(command, "unknown to the client's script")
            raise ScriptError(f"command {command} is not emulated ({name})")
        self._controller.obeyed[command] += 1
        rest = self._handlers[command]()
        if rest is not None:
            yield from rest

    # --- motion ----------------------------------------------------------------------------------------

    def _drive(self, thread: str, motion: ArmMotion, duration_s: float | None = None) -> Thread:
        """Move until the motion is done, or for a time; one thread alone may do so."""
        if self._mover == "force" != thread:
            raise ScriptError("a motion in force mode is not emulated")
        if self._mover not in (None, thread):
            raise ScriptError("another thread is already controlling the robot")
        self._mover = thread
        self._controller.arm.motion = motion
        steps = 0
        while not motion.done and (duration_s is None or steps * STEP_S < duration_s):
            yield
            steps += 1
        self._mover = None

    def _kill(self, thread: str) -> bool:
        """End a thread; what it moved goes on until something else moves the arm [E]."""
        if self._mover == thread:
            self._mover = None
        return self._threads.pop(thread, None) is not None

    def _move(self, motion: ArmMotion) -> Thread:
        self._stop_async_move()
        if self._r.i(1) == 1:
            self._threads["move"] = self._in_background("move", motion)
        else:
            yield from self._drive("main", motion)

    def _in_background(self, thread: str, motion: ArmMotion) -> Thread:
        self._r.progress(0)
        yield from self._drive(thread, motion)
        self._r.progress(-1)

    def _stop_async_move(self) -> None:
        if self._kill("move"):
            self._r.progress(-1)

    def _keep(self, thread: str, motion: Callable[[], ArmMotion], duration_s: float = STEP_S) -> None:
        """Let a thread make this motion again and again, for so long each time."""
        self._kept[thread] = (motion, max(duration_s, STEP_S))
        if thread not in self._threads:
            self._threads[thread] = self._keeping(thread)

    def _keeping(self, thread: str) -> Thread:
        while True:
            motion, duration_s = self._kept[thread]
            yield from self._drive(thread, motion(), duration_s)

    def _end(self, thread: str, standstill: ArmMotion) -> Thread:
        self._kill(thread)
        yield from self._drive("main", standstill)

    def _speed(self, kind: type[ToolSpeed] | type[JointSpeed], joints: bool) -> None:
        # Without a time, speedl comes back when the speed is reached; one cycle stands for that [E].
        target, acceleration = self._r.vector(), self._r.f(6)
        self._speeds_joints = joints
        self._keep("speed", lambda: kind(target, acceleration), self._r.f(7))

    def _servo(self, target_rad: Array) -> None:
        lookahead_s = self._r.f(9)
        self._keep("servo", lambda: JointServo(target_rad, lookahead_s), self._r.f(8))

    def _protective_stop(self) -> None:
        self._controller.protective_stop("requested by the program")
        raise ScriptError("protective stop")  # no thread of it runs any further

    def _stop_move(self) -> Thread:
        stopping = self._kill("stop")
        if stopping:
            self._r.progress(-1)
        else:
            self._stop_async_move()
        deceleration = self._r.f(0)
        if self._r.i(1) == 1:
            self._stop_with_line = True
            motion = self._standstill(deceleration, joints=False)
            self._threads["stop"] = self._in_background("stop", motion)
        else:
            # The script stops joints, not the line, until an asynchronous stop has come: as written there.
            yield from self._drive("main", self._standstill(deceleration, joints=not self._stop_with_line))

    def _standstill(self, deceleration: float, joints: bool) -> ArmMotion:
        return JointSpeed(_NOWHERE, deceleration) if joints else ToolSpeed(_NOWHERE, deceleration)

    def _jog_start(self) -> None:
        if "jog" not in self._threads:
            given = {0: rigid.IDENTITY, 1: self._controller.arm.transform}
            frame = given.get(round(self._r.f(6)))
            self._jog_frame = rigid.matrix(self._r.vector(8)) if frame is None else frame
        speeds, acceleration, turn = self._r.vector(), self._r.f(7), self._jog_frame[:3, :3]
        twist = np.concatenate((turn @ speeds[:3], turn @ speeds[3:]))
        self._keep("jog", lambda: ToolSpeed(twist, acceleration), JOG_S)

    # --- force -------------------------------------------------------------------------------------------

    def _force(self) -> None:
        kind, free = self._r.i(1), [self._r.i(2 + axis) != 0 for axis in range(6)]
        if kind not in (TOWARDS_FRAME, TASK_FRAME, ALONG_MOTION):
            raise ScriptError(f"force mode has no type {kind}")
        frame, wrench, fastest = self._force_frame(kind), self._r.vector(6), self._r.vector(12)
        gain = self._gain / USUAL_GAIN * (1.0 - self._damping) / (1.0 - USUAL_DAMPING)
        self._keep("force", lambda: Yielding(frame, free, wrench, fastest, self._felt, gain))

    def _force_frame(self, kind: int) -> Array:
        """Axes of the force frame, as columns; turned by its type, where that says whither."""
        given, tool = self._r.vector(), self._controller.arm
        frame = rigid.rotation(given[3:])
        if kind == TOWARDS_FRAME:
            axis = given[:3] - tool.pose[:3]
        else:
            axis = frame[:, :2] @ frame[:, :2].T @ np.asarray(tool.twist[:3])
        length = float(np.linalg.norm(axis))
        if kind == TASK_FRAME or length < NO_LENGTH:
            return frame
        axis = axis / length
        if kind == ALONG_MOTION:
            return np.column_stack((axis, np.cross(frame[:, 2], axis), frame[:, 2]))
        across = np.cross(axis, frame[:, 2])
        if (breadth := float(np.linalg.norm(across))) < NO_LENGTH:
            return frame
        return np.column_stack((across / breadth, axis, np.cross(across / breadth, axis)))

    def _stiffen(self, gain: float, damping: float) -> None:
        if not (0.0 <= gain <= 2.0 and 0.0 <= damping <= 1.0):
            raise ScriptError(f"a gain of {gain} with a damping of {damping}: at most 2 and 1, at least 0")
        self._gain, self._damping = gain, damping

    def _freedrive(self) -> None:
        self._lead(rigid.matrix(self._r.vector()), [self._r.i(1 + axis) != 0 for axis in range(6)])

    def _lead(self, frame: Array, free: Sequence[bool]) -> None:
        fastest = np.repeat([LED_M_S, LED_RAD_S], 3)
        self._keep("freedrive", lambda: Yielding(frame[:3, :3], free, _NOWHERE, fastest, self._felt))

    def _felt(self) -> Array:
        return self._controller.felt

    # --- contact ---------------------------------------------------------------------------------------

    def _move_until_contact(self) -> Thread:
        twist, direction, acceleration = self._r.vector(), self._r.vector(6), self._r.f(12)
        while not (steps := self._controller.contact_steps(direction)):
            yield from self._drive("main", ToolSpeed(twist, acceleration), STEP_S)
        yield from self._return_to_contact(steps)

    def _return_to_contact(self, steps: int) -> Thread:
        first = self._controller.joints_before(steps)
        yield from self._drive("main", ToolSpeed(_NOWHERE, CONTACT_STOP_M_S2))
        yield from self._drive("main", ToolMove(self._pose_of(first), RETURN_M_S, RETURN_M_S2))

    def _contact_start(self) -> None:
        self._kill("contact")
        self._contact_steps = 0
        self._threads["contact"] = self._contact_thread(self._r.vector())

    def _contact_thread(self, direction: Array) -> Thread:
        # A contact that is there already must end before one counts (control script).
        while self._controller.contact_steps(direction):
            yield
        while not (steps := self._controller.contact_steps(direction)):
            yield
        self._contact_steps, self._internal = steps, CONTACT_FOUND

    def _contact_found(self) -> Thread:
        self._stop_async_move()
        yield from self._return_to_contact(self._contact_steps)

    def _contact_stop(self) -> None:
        self._kill("contact")
        self._r.answer(self._contact_steps)

    # --- arguments of the commands ------------------------------------------------------------------------

    @property
    def _tool(self) -> Array:
        return self._controller.arm.tool

    def _set_payload(self) -> None:
        self._controller.payload = (self._r.f(0), self._r.f(1), self._r.f(2), self._r.f(3))

    def _pose_of(self, joints_rad: Array, tool: Array | None = None) -> Array:
        return arm.forward(joints_rad, self._tool if tool is None else tool)

    def _joints_for(self) -> Array:
        return arm.solve(rigid.matrix(self._r.vector()), self._controller.arm.joints_rad, self._tool)

    def _reachable(self) -> bool:
        return next(arm.solutions(rigid.matrix(self._r.vector()), self._tool), None) is not None
