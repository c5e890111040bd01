"""The client's control script, re-implemented: what a controller does with the commands in its registers.

[E]: this follows `rtde_control.script` of ur_rtde 1.6.5 thread by thread, each a generator that is run once
in 2 ms; how a real controller schedules them is not known here. It obeys the commands that the driver sends; any
other ends the program with an entry in the log, as a runtime exception does.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from typing import TYPE_CHECKING

from simulator.devices.ur_controller.registers import COMMAND, Registers
from simulator.physics import rigid
from simulator.physics.arm_motion import ArmMotion, ToolMove, ToolSpeed, Yielding

if TYPE_CHECKING:
    from simulator.devices.ur_controller.controller import UrController

STEP_S = 0.002
"""The controller's cycle: 500 Hz on an e-Series (RTDE guide)."""

SPEED_L, STOP_SCRIPT = 10, 255
"""Commands (control script)."""

READY, DONE = 1, 2
"""Output integer 0: ready for a command, done with it (control script)."""

END_LEAD_M_S2 = 10.0
"""How `stopl` ends leading by hand (control script)."""

_NOWHERE = (0.0,) * 6

Thread = Generator[None, None, None]


class ControlScript:
    """One run of the script."""

    def __init__(self, controller: UrController) -> None:
        self._controller = controller
        self._r = Registers(controller.inputs, controller.outputs)
        self._threads: dict[str, Thread] = {"main": self._main()}
        self._mover: str | None = None
        self._kept: dict[str, tuple[Callable[[], ArmMotion], float]] = {}
        self._handlers: dict[int, Callable[[], Thread | None]] = {
            3: self._move,  # moveL
            8: controller.zero_force,  # zeroFtSensor
            SPEED_L: self._speed,
            15: lambda: self._end("speed", self._r.f(0)),  # speedStop
            17: self._set_payload,
            18: lambda: self._keep("lead", lambda: Yielding(lambda: controller.felt)),  # teachMode
            19: lambda: self._end("lead", END_LEAD_M_S2),  # endTeachMode
            29: lambda: controller.arm.mount(rigid.matrix(self._r.vector())),  # setTcp
            33: self._stop_move,  # stopL
            35: lambda: controller.set_watchdog(COMMAND, self._r.f(0)),
            40: lambda: self._r.report(rigid.pose(controller.arm.tool)),  # getTCPOffset
            65: self._set_payload,
        }

    def step(self) -> bool:
        """Run every thread to its next `sync`; False when the script has ended.

        Raises:
            ValueError, ArithmeticError, LookupError, TypeError, RuntimeError: it is at fault, and ends.
        """
        ran: set[str] = set()
        while pending := [name for name in self._threads if name not in ran]:
            ran.add(pending[0])
            try:
                next(self._threads[pending[0]])
            except StopIteration:
                self._threads.pop(pending[0], None)
        return "main" in self._threads

    def _main(self) -> Thread:
        self._r.progress(-1)
        self._r.output(0, READY)
        executing = False
        while True:
            command = self._r.i(0)
            if command == STOP_SCRIPT:
                return
            if command == SPEED_L:  # obeyed afresh in every cycle, without an answer (control script)
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

    def _obey(self, command: int) -> Thread:
        if command not in self._handlers:
            raise RuntimeError(f"command {command} is not emulated")
        rest = self._handlers[command]()
        if rest is not None:
            yield from rest

    def _drive(self, thread: str, motion: ArmMotion, duration_s: float | None = None) -> Thread:
        """Move until the motion is done, or for a time; one thread alone may do so."""
        if self._mover not in (None, thread):
            raise RuntimeError("another thread is already controlling the robot")
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

    def _move(self) -> Thread:
        motion = ToolMove(rigid.matrix(self._r.vector()), self._r.f(6), self._r.f(7))
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

    def _end(self, thread: str, deceleration_m_s2: float) -> Thread:
        self._kill(thread)
        yield from self._drive("main", ToolSpeed(_NOWHERE, deceleration_m_s2))

    def _speed(self) -> None:
        # Without a time, speedl comes back when the speed is reached; one cycle stands for that [E].
        target, acceleration = self._r.vector(), self._r.f(6)
        self._keep("speed", lambda: ToolSpeed(target, acceleration), self._r.f(7))

    def _stop_move(self) -> None:
        if self._kill("stop"):
            self._r.progress(-1)
        else:
            self._stop_async_move()
        if self._r.i(1) != 1:
            raise RuntimeError("`stopL` without `async`, which stops joints, is not emulated")
        self._threads["stop"] = self._in_background("stop", ToolSpeed(_NOWHERE, self._r.f(0)))

    def _set_payload(self) -> None:
        self._controller.payload = (self._r.f(0), self._r.f(1), self._r.f(2), self._r.f(3))
