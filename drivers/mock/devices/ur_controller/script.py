"""The client's control script, re-implemented: what a controller does with the commands in its registers.

[E]: this follows `rtde_control.script` of ur_rtde 1.6.5 thread by thread, each a generator that is run once
in 2 ms; how a real controller schedules them is not known here. What is not needed (servo, force mode, paths,
freedrive) ends the program with a word in the log.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING

import numpy as np

from drivers.mock.plants import arm, rigid
from drivers.mock.plants.arm_motion import JointMove, JointSpeed, Motion, ToolMove, ToolSpeed
from drivers.mock.plants.rigid import Array

if TYPE_CHECKING:
    from drivers.mock.devices.ur_controller.controller import UrController

STEP_S = 0.002
"""The controller's cycle: 500 Hz on an e-Series (RTDE guide)."""

READY, DONE = 1, 2
"""Output integer 0: ready for a command, done with it (control script)."""

STREAMING = frozenset({6, 9, 10, 11, 24, 25, 26, 27, 38, 58, 66, 67, 68, 69, 70, 71})
"""Commands obeyed afresh in every cycle, without an answer (control script)."""

STOP_SCRIPT, CONTACT_FOUND = 255, 254

CONTACT_STOP_M_S2 = 3.0
"""How `stopl` stops after a contact, and `jog` uses 1.2 (control script)."""

JOG_STOP_M_S2 = 1.2
JOG_S = 0.01

RETURN_M_S, RETURN_M_S2 = 0.25, 1.2
"""Speed and acceleration of a `movel` that names none (script manual)."""

Thread = Generator[None, None, None]


class ScriptError(RuntimeError):
    """The program did what the controller does not allow, and stops."""


class ControlScript:
    """One run of the script.

    Args:
        controller: Whose registers and arm it uses.
        offset: Number of its first register: 0 or 24.
    """

    def __init__(self, controller: UrController, offset: int) -> None:
        self._controller = controller
        self._offset = offset
        self._threads: dict[str, Thread] = {"main": self._main()}
        self._mover: str | None = None
        self._speed_motion: Callable[[], Motion] = lambda: ToolSpeed(np.zeros(6), 1.2)
        self._speed_s = 0.0
        self._speeds_joints = False
        self._stop_with_line = False
        self._internal = 0
        self._contact_steps = 0
        self._writes = self._operation = 0
        self._handlers: dict[int, Callable[[], Thread | None]] = {
            1: lambda: self._move(JointMove(self._vector(), self._f(6), self._f(7))),
            2: lambda: self._move(JointMove(self._joints_for(), self._f(6), self._f(7))),
            3: lambda: self._move(ToolMove(rigid.matrix(self._vector()), self._f(6), self._f(7))),
            4: lambda: self._move(ToolMove(self._pose_of(self._vector()), self._f(6), self._f(7))),
            8: controller.zero_force,
            9: lambda: self._speed(JointSpeed, joints=True),
            10: lambda: self._speed(ToolSpeed, joints=False),
            15: self._speed_stop,
            17: self._set_payload,
            25: lambda: self._answer(controller.contact_steps(self._vector())),
            26: lambda: self._report([STEP_S]),
            27: lambda: self._report(controller.joints_before(self._i(1))),
            29: lambda: controller.arm.mount(rigid.matrix(self._vector())),
            30: lambda: self._report(arm.solve(rigid.matrix(self._vector()), self._vector(6), self._tool)),
            31: lambda: controller.protective_stop("asked for by the program"),
            33: self._stop_move,
            34: self._stop_move,
            35: lambda: controller.set_watchdog(f"input_int_register_{offset}", self._f(0)),
            36: lambda: self._answer(self._reachable()),
            37: lambda: self._answer(float(np.abs(self._vector()).max()) <= arm.JOINT_LIMIT_RAD),
            38: lambda: self._report([0.0] * 6),
            39: lambda: self._report(
                rigid.pose(rigid.matrix(self._vector()) @ rigid.matrix(self._vector(6)))
            ),
            40: lambda: self._report(rigid.pose(self._tool)),
            41: self._jog_start,
            42: self._jog_stop,
            43: lambda: self._report(controller.arm.pose),
            44: lambda: self._report(
                rigid.pose(self._pose_of(self._vector(), rigid.matrix(self._vector(6))))
            ),
            46: lambda: self._report(self._joints_for()),
            47: lambda: self._answer(controller.arm.resting),
            51: self._move_until_contact,
            58: lambda: self._report(rigid.pose(arm.forward(controller.arm.joints_rad))),
            60: lambda: self._answer(self._reachable()),
            61: lambda: self._answer(self._reachable()),
            62: self._contact_start,
            63: self._contact_stop,
            64: lambda: self._answer(self._contact_steps),
            65: self._set_payload,
            CONTACT_FOUND: self._contact_found,
        }

    def step(self) -> bool:
        """Run every thread to its next `sync`; False when the script has ended.

        Raises:
            ScriptError: the program is at fault.
        """
        ran: set[str] = set()
        while pending := [name for name in self._threads if name not in ran]:
            ran.add(pending[0])
            try:
                next(self._threads[pending[0]])
            except StopIteration:
                self._threads.pop(pending[0], None)
            except (arm.UnreachableError, ZeroDivisionError, ValueError) as error:
                raise ScriptError(str(error)) from error
        return "main" in self._threads

    # --- the main loop -------------------------------------------------------------------------------

    def _main(self) -> Thread:
        self._progress(-1)
        self._output(0, READY)
        executing = False
        while True:
            command = self._command()
            if command == STOP_SCRIPT:
                return
            if command in STREAMING:
                yield from self._obey(command)
                self._output(0, READY)
            elif command == 0:
                executing = False
                self._output(0, READY)
            elif not executing:
                yield from self._obey(command)
                self._output(0, DONE)
                executing = True
            yield

    def _command(self) -> int:
        command = self._i(0)
        if command == 0:
            command, self._internal = self._internal, 0
        return command

    def _obey(self, command: int) -> Thread:
        if command not in self._handlers:
            raise ScriptError(f"command {command} is not emulated")
        self._controller.obeyed[command] += 1
        rest = self._handlers[command]()
        if rest is not None:
            yield from rest

    # --- motion ----------------------------------------------------------------------------------------

    def _drive(self, thread: str, motion: Motion, duration_s: float | None = None) -> Thread:
        """Move until the motion is done, or for a time; one thread alone may do so."""
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

    def _move(self, motion: Motion) -> Thread:
        self._stop_async_move()
        if self._i(1) == 1:
            self._threads["move"] = self._in_background("move", motion)
        else:
            yield from self._drive("main", motion)

    def _in_background(self, thread: str, motion: Motion) -> Thread:
        self._progress(0)
        yield from self._drive(thread, motion)
        self._progress(-1)

    def _stop_async_move(self) -> None:
        if self._kill("move"):
            self._progress(-1)

    def _speed(self, kind: type[ToolSpeed] | type[JointSpeed], joints: bool) -> None:
        target, acceleration = self._vector(), self._f(6)
        self._speed_motion = lambda: kind(target, acceleration)
        self._speed_s = self._f(7)
        self._speeds_joints = joints
        if "speed" not in self._threads:
            self._threads["speed"] = self._speed_thread()

    def _speed_thread(self) -> Thread:
        while True:
            # Without a time, speedl comes back when the speed is reached; one cycle stands for that [E].
            yield from self._drive("speed", self._speed_motion(), max(self._speed_s, STEP_S))

    def _speed_stop(self) -> Thread:
        self._kill("speed")
        yield from self._drive("main", self._standstill(self._f(0), joints=self._speeds_joints))

    def _stop_move(self) -> Thread:
        stopping = self._kill("stop")
        if stopping:
            self._progress(-1)
        else:
            self._stop_async_move()
        deceleration = self._f(0)
        if self._i(1) == 1:
            self._stop_with_line = True
            motion = self._standstill(deceleration, joints=False)
            self._threads["stop"] = self._in_background("stop", motion)
        else:
            # The script stops joints, not the line, until an asynchronous stop has come: as written there.
            yield from self._drive("main", self._standstill(deceleration, joints=not self._stop_with_line))

    def _standstill(self, deceleration: float, joints: bool) -> Motion:
        return JointSpeed(np.zeros(6), deceleration) if joints else ToolSpeed(np.zeros(6), deceleration)

    def _jog_start(self) -> None:
        frame = {0: rigid.IDENTITY, 1: self._controller.arm.transform}.get(
            round(self._f(6)), rigid.matrix(self._vector(8))
        )
        speeds, acceleration = self._vector(), self._f(7)
        twist = np.concatenate((frame[:3, :3] @ speeds[:3], frame[:3, :3] @ speeds[3:]))
        if "jog" not in self._threads:
            self._threads["jog"] = self._jog_thread(twist, acceleration)

    def _jog_thread(self, twist: Array, acceleration: float) -> Thread:
        while True:
            yield from self._drive("jog", ToolSpeed(twist, acceleration), JOG_S)

    def _jog_stop(self) -> Thread:
        self._kill("jog")
        yield from self._drive("main", ToolSpeed(np.zeros(6), JOG_STOP_M_S2))

    # --- contact ---------------------------------------------------------------------------------------

    def _move_until_contact(self) -> Thread:
        twist, direction, acceleration = self._vector(), self._vector(6), self._f(12)
        while not (steps := self._controller.contact_steps(direction)):
            yield from self._drive("main", ToolSpeed(twist, acceleration), STEP_S)
        yield from self._return_to_contact(steps)

    def _return_to_contact(self, steps: int) -> Thread:
        first = self._controller.joints_before(steps)
        yield from self._drive("main", ToolSpeed(np.zeros(6), CONTACT_STOP_M_S2))
        yield from self._drive("main", ToolMove(self._pose_of(first), RETURN_M_S, RETURN_M_S2))

    def _contact_start(self) -> None:
        self._kill("contact")
        self._contact_steps = 0
        self._threads["contact"] = self._contact_thread(self._vector())

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
        self._answer(self._contact_steps)

    # --- registers -------------------------------------------------------------------------------------

    @property
    def _tool(self) -> Array:
        return self._controller.arm.tool

    def _i(self, number: int) -> int:
        value = self._controller.inputs[f"input_int_register_{self._offset + number}"]
        assert isinstance(value, int)
        return value

    def _f(self, number: int) -> float:
        value = self._controller.inputs[f"input_double_register_{self._offset + number}"]
        assert isinstance(value, float)
        return value

    def _vector(self, first: int = 0) -> Array:
        return np.array([self._f(first + index) for index in range(6)])

    def _output(self, number: int, value: int) -> None:
        self._controller.outputs[f"output_int_register_{self._offset + number}"] = value

    def _answer(self, value: int) -> None:
        self._output(1, int(value))

    def _report(self, values: Sequence[float] | Array) -> None:
        for index, value in enumerate(values):
            self._controller.outputs[f"output_double_register_{self._offset + index}"] = float(value)

    def _progress(self, value: int) -> None:
        """The asynchronous status: bits 0-14 progress, 15 running, 16-22 writes, 24-30 operation."""
        self._writes = (self._writes + 1) % 128
        if value == 0:
            self._operation = (self._operation + 1) % 128
        running = 0 if value < 0 else 0x8000 + min(value, 0x7FFF)
        self._output(2, self._writes << 16 | self._operation << 24 | running)

    def _set_payload(self) -> None:
        self._controller.payload = (self._f(0), self._f(1), self._f(2), self._f(3))

    def _pose_of(self, joints_rad: Array, tool: Array | None = None) -> Array:
        return arm.forward(joints_rad, self._tool if tool is None else tool)

    def _joints_for(self) -> Array:
        return arm.solve(rigid.matrix(self._vector()), self._controller.arm.joints_rad, self._tool)

    def _reachable(self) -> bool:
        return next(arm.solutions(rigid.matrix(self._vector()), self._tool), None) is not None
