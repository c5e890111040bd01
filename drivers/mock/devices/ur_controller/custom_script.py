"""A client's own program: a few lines that are obeyed one after the other.

Of the language there are calls with numbers, poses, lists, words and truth values; names and defaults are the script
manual's. A program with anything else (variables, branches, threads) is refused whole, as a controller refuses what it
cannot compile.
"""

from __future__ import annotations

import ast
import inspect
import operator
from collections.abc import Callable, Generator, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from drivers.mock.physics import arm, rigid
from drivers.mock.physics.arm_motion import JointMove, JointSpeed, Motion, ToolMove, ToolSpeed
from drivers.mock.physics.rigid import Array

if TYPE_CHECKING:
    from drivers.mock.devices.ur_controller.controller import UrController

LINES, LINE_CHARACTERS = 1000, 1000
"""Longest program and longest line (assumption)."""

INT32 = range(-(2**31), 2**31)
"""What an integer register holds."""

Run = Generator[None, None, None]

_OPERATORS: dict[type, Callable[..., float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.USub: operator.neg,
    ast.UAdd: operator.pos,
}


class UnknownError(ValueError):
    """A line that is not emulated."""


class Pose(NamedTuple):
    """p[x, y, z, rx, ry, rz]: metres and a rotation vector."""

    transform: Array


class CustomScript:
    """One run of a program.

    Args:
        controller: Whose registers and arm it uses.
        lines: The program, from `def name():` to `end`.
        step_s: The controller's cycle.

    Raises:
        UnknownError: it has a line that is not emulated.
    """

    def __init__(self, controller: UrController, lines: Sequence[str], step_s: float) -> None:
        self._controller = controller
        self._step_s = step_s
        self._name = lines[0][:60]
        if len(lines) > LINES:
            raise UnknownError(f"{self._name}: {len(lines)} lines")
        self._calls = [self._call(line.strip()) for line in lines[1:-1] if line.split("#")[0].strip()]
        self._run = self._all()

    def step(self) -> bool:
        """Go on until the next cycle; False when the program has ended.

        Raises:
            ValueError: it asks for what cannot be.
        """
        try:
            next(self._run)
        except StopIteration:
            return False
        return True

    def _all(self) -> Run:
        for call in self._calls:
            rest = call()
            if rest is not None:
                yield from rest

    # --- the language ------------------------------------------------------------------------------------

    def _call(self, line: str) -> Callable[[], Run | None]:
        if len(line) > LINE_CHARACTERS:
            raise UnknownError(f"{self._name}: a line of {len(line)} characters")
        try:
            match ast.parse(line, mode="eval").body:
                case ast.Call(ast.Name(name), args, keywords) if hasattr(self, f"_do_{name}"):
                    do = getattr(self, f"_do_{name}")
                    given = [_value(one) for one in args]
                    named = {str(one.arg): _value(one.value) for one in keywords}
                    inspect.signature(do).bind(*given, **named)
                    return lambda: do(*given, **named)
        except (ValueError, TypeError, SyntaxError, ArithmeticError, RecursionError, MemoryError):
            pass
        raise UnknownError(f"{self._name}: not emulated: {line[:60]!r}")

    # --- what it can call --------------------------------------------------------------------------------

    def _do_textmsg(self, *words: object) -> None:
        self._controller.log.append("".join(str(word) for word in words)[:200])

    def _do_sync(self) -> Run:
        yield

    def _do_sleep(self, t: float) -> Run:
        for _ in range(round(t / self._step_s)):
            yield

    def _do_write_output_integer_register(self, number: int, value: int) -> None:
        if value not in INT32:
            raise ValueError(f"{value} does not fit an integer register")
        self._controller.outputs[_known(self._controller, f"output_int_register_{number}")] = value

    def _do_write_output_float_register(self, number: int, value: float) -> None:
        self._controller.outputs[_known(self._controller, f"output_double_register_{number}")] = float(value)

    def _do_set_standard_digital_out(self, n: int, b: bool) -> None:
        if n not in range(8):
            raise ValueError(f"there is no standard digital output {n}")
        self._controller.panel.write(
            {"standard_digital_output_mask": 1 << n, "standard_digital_output": b << n}
        )

    def _do_movej(self, q: Pose | list[float], a: float = 1.4, v: float = 1.05) -> Run:
        state = self._controller.arm
        joints = arm.solve(q.transform, state.joints_rad, state.tool) if isinstance(q, Pose) else _joints(q)
        return self._drive(JointMove(joints, v, a))

    def _do_movel(self, pose: Pose | list[float], a: float = 1.2, v: float = 0.25) -> Run:
        tool = self._controller.arm.tool
        target = pose.transform if isinstance(pose, Pose) else arm.forward(_joints(pose), tool)
        return self._drive(ToolMove(target, v, a))

    def _do_stopj(self, a: float) -> Run:
        return self._drive(JointSpeed(np.zeros(6), a))

    def _do_stopl(self, a: float) -> Run:
        return self._drive(ToolSpeed(np.zeros(6), a))

    def _do_zero_ftsensor(self) -> None:
        self._controller.zero_force()

    def _do_set_tcp(self, pose: Pose) -> None:
        self._controller.arm.mount(pose.transform)

    def _drive(self, motion: Motion) -> Run:
        self._controller.arm.motion = motion
        while not motion.done:
            yield


def _known(controller: UrController, name: str) -> str:
    if name not in controller.outputs:
        raise ValueError(f"there is no {name}")
    return name


def _joints(angles_rad: list[float]) -> Array:
    joints = np.array(angles_rad, dtype=np.float64)
    if joints.shape != (arm.JOINTS,):
        raise ValueError(f"{angles_rad} are no angles of {arm.JOINTS} joints")
    return joints


def _number(node: ast.expr) -> float:
    value = _value(node)
    if not isinstance(value, int | float):
        raise ValueError("no number")
    return value


def _value(node: ast.expr) -> Any:
    """A constant expression's value."""
    match node:
        case ast.Constant(bool() | int() | float() | str() as value):
            return value
        case ast.List(parts):
            return [_value(part) for part in parts]
        case ast.Subscript(ast.Name("p"), ast.Tuple(parts)) if len(parts) == 6:
            return Pose(rigid.matrix([float(_number(part)) for part in parts]))
        case ast.UnaryOp(sign, part) if type(sign) in _OPERATORS:
            return _OPERATORS[type(sign)](_number(part))
        case ast.BinOp(left, sign, right) if type(sign) in _OPERATORS:
            return _OPERATORS[type(sign)](_number(left), _number(right))
    raise ValueError("no constant")
