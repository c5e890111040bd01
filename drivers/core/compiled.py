"""Functions that are compiled when they are first needed: until then, nothing of what compiles is loaded."""

from __future__ import annotations

import dis
from collections.abc import Callable, Iterator
from importlib import import_module
from threading import RLock
from types import CodeType
from typing import Any, TypeVar

_lock = RLock()
_signed: list[Kernel] = []

Returned = TypeVar("Returned")

interrupted: Callable[[], bool] = bool
"""Whether the person has ended the program: then nothing more is compiled. What compiles takes seconds."""


def compiled(
    signature: str | None = None, **options: Any
) -> Callable[[Callable[..., Returned]], Callable[..., Returned]]:
    """`numba.njit` for a kernel whose compiled code is kept.

    Args:
        signature: The one that it is compiled for; without, it is compiled for what it is first called with.
    """

    def decorate(function: Callable[..., Returned]) -> Callable[..., Returned]:
        return Kernel(function, signature, options)

    return decorate


def make_signed() -> None:
    """Compile all kernels that have a signature: on a bench in wall time, before anything moves."""
    for kernel in _signed:
        _ = kernel.made


class Kernel:
    """A function that is compiled when it is called, or when a kernel that calls it is.

    Args:
        signature: The only one that it takes, or None.
    """

    def __init__(self, function: Callable[..., Any], signature: str | None, options: dict[str, Any]) -> None:
        self.__name__, self.__doc__, self.__module__ = (
            function.__name__,
            function.__doc__,
            function.__module__,
        )
        self._function = function
        self._signature = signature
        self._options = options
        self._made: Any = None
        if signature is not None:
            _signed.append(self)

    def __call__(self, *arguments: Any) -> Any:
        """Call it, compiled."""
        return (self._made or self.made)(*arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.made, name)

    @property
    def made(self) -> Any:
        """numba's dispatcher of it. In the function's own module, and where its code names others, these take the
        place of kernels, as numba wants it; nor is a call delayed there any more."""
        with _lock:
            if self._made is None:
                self._made = import_module("drivers.core.compiling").dispatcher(self._function, self._options)
                names = self._function.__globals__
                for name in (*global_names(self._function.__code__), self._function.__name__):
                    if isinstance(names.get(name), Kernel):
                        names[name] = names[name].made
                for cell in self._function.__closure__ or ():
                    if isinstance(cell.cell_contents, Kernel):
                        cell.cell_contents = cell.cell_contents.made
                if self._signature is not None and self._made is not self._function:
                    self._made.compile(self._signature)
                    self._made.disable_compile()
            return self._made


def global_names(code: CodeType) -> Iterator[str]:
    """Global names that code loads, and all that is defined in it."""
    for step in dis.get_instructions(code):
        if step.opname == "LOAD_GLOBAL":
            yield step.argval
    for inner in code.co_consts:
        if isinstance(inner, CodeType):
            yield from global_names(inner)
