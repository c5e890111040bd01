"""Compiled code, kept for the next run and found again by what it is made of.

numba's own cache looks at the one file that a kernel is in, and a kernel takes in code and constants of others: after
an edit of those it would go on with the old ones. Here a kernel is found by the hash of all that goes into it: the
code, options and constants of itself and of every kernel that it calls, and the types that it is called with. Trees
with equal kernels share what is compiled, wherever they lie, and trees with different ones do not meet.

`kept_in()` names the folder: one for each machine and version of what compiles.
"""

import hashlib
import os
import pickle
import platform
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from contextlib import suppress
from enum import Enum
from functools import cache
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import llvmlite
import numba
import numpy as np
from numba import types
from numba.core import sigutils
from numba.core.caching import _Cache
from numba.core.compiler import CompileResult
from numba.core.dispatcher import Dispatcher
from numba.core.serialize import dumps

from drivers.core import compiled
from drivers.core.compiled import global_names

KEPT_S = 30 * 86400.0
"""Compiled code that was not loaded for so long is removed. Assumption: a later user can wait once."""

DAY_S = 86400.0
"""How often loading writes down that a file is in use."""

REPORTED_S = 1.0
"""Shorter compilations are not reported, seconds."""

_SUM_BYTES = 32
"""A file begins with the SHA-256 of the rest."""

_KNOWN_BY_NAME = frozenset({"builtins", "math", "numpy", "numba"})
"""Packages that the folder's name pins; what comes out of them is known by its name."""


def dispatcher(function: Callable[..., Any], options: Mapping[str, Any]) -> Any:
    """numba's dispatcher of a function, with its compiled code kept; the function itself with NUMBA_DISABLE_JIT."""
    kernel: Any = numba.njit(**options)(function)
    if kernel is not function:
        kernel._cache = _Kept(kernel)
    return kernel


def kept_in() -> Path:
    """Folder of compiled code: `NUMBA_CACHE_DIR`, or touchbench's in the user's cache folder."""
    root = os.environ.get("NUMBA_CACHE_DIR")
    if root:
        return Path(root)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "touchbench" / "compiled"


class _Kept(_Cache):
    """Compiled forms of one kernel: one file for each, put there in one step, for others may look for it meanwhile."""

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel

    @property
    def cache_path(self) -> str:
        return str(kept_in())

    def enable(self) -> None:
        """As numba asks for it; it is never off."""

    def disable(self) -> None:
        """As numba asks for it; it is never off."""

    def flush(self) -> None:
        """As numba asks for it; there is nothing to write out."""

    def load_overload(self, signature: Any, target_context: Any) -> Any:
        """The compiled code for a signature; None where it has to be made."""
        target_context.refresh()
        path = self._path(signature, target_context.codegen())
        kept = b""
        # a file that is missing or damaged is compiled again
        with suppress(OSError):
            kept = path.read_bytes()
            if time.time() - path.stat().st_mtime > DAY_S:
                os.utime(path)
        if hashlib.sha256(kept[_SUM_BYTES:]).digest() != kept[:_SUM_BYTES]:
            _progress.begin(self._kernel)
            return None
        found = CompileResult._rebuild(target_context, *pickle.loads(kept[_SUM_BYTES:]))
        _progress.end(self._kernel)
        return found

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep compiled code, unless it holds addresses of this process."""
        _progress.end(self._kernel)
        if result.library.has_dynamic_globals or any(not lifted.can_cache for lifted in result.lifted):
            return
        path = self._path(signature, result.codegen)
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=path.parent, prefix=".", delete=False) as file:
                made = dumps(result._reduce())
                file.write(hashlib.sha256(made).digest() + made)
            Path(file.name).replace(path)
        except OSError as error:
            reason = f"{path.parent}: {error.strerror}"
            _progress.once(f"{reason}; compiled code is not kept, set NUMBA_CACHE_DIR to a folder")
        else:
            tidy(path.parent)

    def _path(self, signature: Any, codegen: Any) -> Path:
        arguments, returned = sigutils.normalize_signature(signature)
        kinds = [str(returned), *(_typed(kind) for kind in arguments)]
        content = "\n".join([*kinds, *(_own(kernel) for kernel in reached(self._kernel))])
        return kept_in() / _machine(codegen) / f"{_called(self._kernel)}-{_hash(content)}.compiled"


def reached(kernel: Any) -> list[Any]:
    """A kernel and all those that it calls, directly or not, in a fixed order."""
    found = [kernel]
    for known in found:  # which grows meanwhile
        for value in _named(known).values():
            if isinstance(value, Dispatcher) and value not in found:
                found.append(value)
    return found


def tidy(folder: Path) -> None:
    """Remove what has not been loaded for `KEPT_S`, of a folder of compiled code and of other versions beside it.

    Another run may do the same at the same moment.
    """
    for old in folder.parent.glob("*/*"):
        with suppress(OSError):
            if time.time() - old.stat().st_mtime > KEPT_S:
                old.unlink()
                old.parent.rmdir()  # unless there is more in it


def _called(kernel: Any) -> str:
    return f"{kernel.py_func.__module__}.{kernel.py_func.__qualname__}"


def _hash(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()[:32]


@cache
def _machine(codegen: Any) -> str:
    """Name of the folder for this processor and these versions."""
    settings = sorted(
        item for item in os.environ.items() if item[0].startswith("NUMBA_") and item[0] != "NUMBA_CACHE_DIR"
    )
    versions = (numba.__version__, llvmlite.__version__, np.__version__, platform.python_version())
    return f"numba-{numba.__version__}-{_hash(repr((versions, codegen.magic_tuple(), settings)))}"


@cache
def _own(kernel: Any) -> str:
    """All that a kernel itself is made of: its code, its options and what its names stand for."""
    function = kernel.py_func
    values = [function.__defaults__, *_named(kernel).items()]
    return "\n".join(
        [
            _called(kernel),
            *(
                f"{name}: {_described(value, function)}"
                for name, value in sorted(kernel.targetoptions.items())
            ),
            _coded(function.__code__, function.__doc__),
            *(_described(value, function) for value in values),
        ]
    )


@cache
def _named(kernel: Any) -> dict[str, Any]:
    """Globals and enclosing variables that a kernel's code names, and what they stand for, by name."""
    function = kernel.py_func
    known = function.__globals__
    found = {name: known[name] for name in global_names(function.__code__) if name in known}
    enclosing = (cell.cell_contents for cell in function.__closure__ or ())
    found |= dict(zip(function.__code__.co_freevars, enclosing, strict=True))
    return dict(sorted(found.items()))


def _coded(code: CodeType, doc: str | None) -> str:
    """Code without its place in the file and without its docstring."""
    constants = [
        _coded(constant, None)
        if isinstance(constant, CodeType)
        else ""
        if constant is doc
        else repr(constant)
        for constant in code.co_consts
    ]
    return f"{code.co_code.hex()} {constants} {code.co_names} {code.co_varnames}"


def _described(value: Any, function: Any) -> str:  # noqa: PLR0911
    """A value that a kernel is compiled with, as a text that no other value has."""
    if value is None or isinstance(value, bool | int | float | complex | str | bytes):
        return f"{type(value).__name__} {value!r}"
    if isinstance(value, np.generic | np.ndarray):
        return f"{value.dtype.descr} {value.shape} {value.strides} {value.tobytes().hex()}"
    if isinstance(value, tuple):
        return f"{_described(type(value), function)}({[_described(member, function) for member in value]})"
    if isinstance(value, set | frozenset):
        return str(sorted(_described(member, function) for member in value))
    if isinstance(value, Dispatcher):
        return f"kernel {_called(value)}"
    if isinstance(value, type) and hasattr(value, "_fields"):
        return f"{value.__module__}.{value.__qualname__}{value._fields}"
    if isinstance(value, type) and issubclass(value, Enum):
        return f"{value.__module__}.{value.__qualname__}{[(member.name, member.value) for member in value]}"
    module = value.__name__ if isinstance(value, ModuleType) else getattr(value, "__module__", None)
    if isinstance(value, np.ufunc):
        module = "numpy"
    if module is not None and module.partition(".")[0] in _KNOWN_BY_NAME:
        return f"{module}.{getattr(value, '__qualname__', getattr(value, '__name__', repr(value)))}"
    raise TypeError(
        f"{function.__module__}.{function.__qualname__} is compiled with {value!r}, whose content is not known: "
        "name a constant, a compiled function, or something of numpy, math or numba"
    )


def _typed(kind: Any) -> str:
    """A numba type with the names of its fields, which its own text leaves out."""
    if isinstance(kind, types.Callable):
        raise TypeError(f"{kind}: a kernel is not handed to another one, for its content would not be known")
    if hasattr(kind, "instance_class"):
        fields = [f"{name}: {_typed(member)}" for name, member in zip(kind.fields, kind.types, strict=True)]
        return f"{kind.instance_class.__module__}.{kind.instance_class.__qualname__}{fields}"
    return str([_typed(member) for member in kind.types] if hasattr(kind, "types") else kind)


class _Progress:
    """Reports what compiles, so that a person knows why nothing happens: that it begins, and what took long."""

    def __init__(self) -> None:
        self._outermost: Any = None
        self._since_s = 0.0
        self._said: set[str] = set()

    def begin(self, kernel: Any) -> None:
        """A kernel is not there yet and will now be compiled.

        Raises:
            KeyboardInterrupt: the person has ended the program; a bench that moves compiles nothing.
        """
        if compiled.interrupted():
            raise KeyboardInterrupt
        if self._outermost is None:
            self._outermost, self._since_s = kernel, time.perf_counter()
            self.once(f"compiling what this machine has not compiled before, once (kept in {kept_in()})")

    def end(self, kernel: Any) -> None:
        """It is compiled, or was kept."""
        if kernel is self._outermost:
            self._outermost = None
            taken_s = time.perf_counter() - self._since_s
            if taken_s > REPORTED_S:
                self.once(f"  {_called(kernel)}: {taken_s:.1f} s")

    def once(self, line: str) -> None:
        """Write a line to standard error, the first time that it is said."""
        if line not in self._said:
            self._said.add(line)
            # a program whose standard error is closed or full still compiles
            with suppress(OSError, ValueError):
                sys.stderr.write(f"{line}\n")
                sys.stderr.flush()


_progress = _Progress()
