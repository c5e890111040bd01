"""What a command's fields may hold: finite numbers, of known types, as many as declared. Pure."""

import math
from dataclasses import fields, replace
from functools import cache
from typing import Any, get_args, get_origin, get_type_hints

import numpy as np

from controller.limits import GuardRefusal
from drivers.core.messages import Command


def normalised(command: Command) -> Command:
    """The command with each number of it as a float, and each row of numbers as a tuple.

    An int and a real number of NumPy's are numbers; a bool is none. A tuple, a list and an array are rows.

    Raises:
        GuardRefusal: a field is of another type than it is declared to be, is not finite, or has another length.
    """
    what = f"{type(command).__name__}({command.device})"
    changed: dict[str, Any] = {}
    for name, declared in _declared(type(command)).items():  # type: ignore[arg-type]  # mypy takes no class for hashable
        given = getattr(command, name)
        taken = _taken(f"{what}: {name}", declared, given)
        if taken is not given:
            changed[name] = taken
    return replace(command, **changed) if changed else command


@cache
def _declared(kind: type[Command]) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {field.name: hints[field.name] for field in fields(kind)}


def _taken(where: str, declared: Any, given: Any) -> Any:
    if declared is float:
        return _number(where, given)
    if get_origin(declared) is tuple and set(get_args(declared)) == {float}:
        return _row(where, len(get_args(declared)), given)
    if isinstance(declared, type) and not isinstance(given, declared):
        raise GuardRefusal(f"{where} is {given!r}; give a {declared.__name__}")
    return given


def _number(where: str, given: Any) -> float:
    if isinstance(given, bool) or not isinstance(given, int | float | np.integer | np.floating):
        raise GuardRefusal(f"{where} is {given!r}, a {type(given).__name__}; give a number")
    try:
        number = float(given)
    except OverflowError:
        number = math.inf
    if not math.isfinite(number):
        raise GuardRefusal(f"{where} is {number}; give a finite number")
    return given if type(given) is float else number


def _row(where: str, length: int, given: Any) -> tuple[float, ...]:
    rows = isinstance(given, tuple | list) or (isinstance(given, np.ndarray) and given.ndim == 1)
    if not rows or len(given) != length:
        raise GuardRefusal(f"{where} is {given!r}; give {length} numbers")
    row = tuple(_number(where, each) for each in given)
    same = type(given) is tuple and all(old is new for old, new in zip(given, row, strict=True))
    return given if same else row
