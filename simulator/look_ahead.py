"""Many turns at once where nothing is commanded meanwhile: what is kept to go back, and how far to look."""

import math
import sys
from collections import defaultdict, deque
from collections.abc import Callable, Iterable, Sequence
from dataclasses import is_dataclass
from enum import Enum
from operator import is_
from types import BuiltinFunctionType, FunctionType, MappingProxyType, MethodType, ModuleType
from typing import Any

import numpy as np

from drivers.core.clock import Clock
from drivers.core.settings import Settings
from simulator.devices.faults import FaultSchedule

LONGEST_S = 2.0
"""Longest span in any case. Simulated benches remember four seconds of what devices may still ask for."""

GROWTH = 32
"""How many times longer the next look is when nothing happened and detectors listen. Chosen among 8, 16, 32 and 64 by
the looks of eight campaigns and the time that they see in vain: a look costs as much as the samples of many turns."""

Copier = Callable[[Any, dict[int, Any]], Any]


class LookAhead:
    """Lets many turns of a bench in virtual time pass as one where nothing happens in them.

    A device that acts or answers at the turn that looks at it says in `alone_s` how long it need not be looked at: then
    a person does what they were asked for, a mover has arrived. One that halts on its way where it is not polled says
    in `blind_s` how far apart turns may be, and is told in `watched_until_s` until when those that are taken as one
    come often enough.

    Args:
        faults: What goes wrong. A fault acts on single turns: while one is on, or begins, none are taken as one.
    """

    def __init__(
        self, clock: Clock, bench: object, devices: Sequence[Any], faults: Sequence[FaultSchedule] = ()
    ) -> None:
        self._clock, self._devices, self._faults = clock, devices, faults
        self.roots = [clock, bench, *devices, *faults]
        self._acting = [device for device in devices if hasattr(device, "alone_s")]
        self._leashed = [device for device in devices if hasattr(device, "blind_s")]
        self.restart()

    def restart(self) -> None:
        """Begin a trial."""
        _FIXED.clear()
        self._turns = 1  # of the next look
        self._known = False  # whether something happens in the turn after these
        self._apart = False  # whether the latest turn was taken by itself
        self._decisions = 0

    def skip(
        self,
        first: int,
        stride: int,
        rate_hz: float,
        until_s: float,
        changed: Sequence[object],
        look: Callable[[], float | None],
        armed: bool,
        decisions: int,
    ) -> int:
        """Let the next turns pass as one where nothing follows from them; where something does, all is put back.

        Args:
            first: Number of the next turn; turn k is due at k / rate_hz.
            stride: From a turn's number to the next one's.
            rate_hz: Of the turns' numbers.
            until_s: Before it nothing happens by itself.
            changed: What a look changes beside the bench.
            look: Sees what has come by now; when the first thing that anything follows from happened, else None.
            armed: Whether detectors listen.
            decisions: How many there were in the trial so far: after one, looks begin short again.

        Returns:
            How many turns have passed; 0 where the next one is to be taken by itself.
        """
        decided = decisions > self._decisions
        if decided:
            self._turns, self._known = 1, False
        if decided or self._apart:
            self._quiet(armed)
        self._decisions, self._apart = decisions, True
        blind_s = min((each.blind_s for each in self._leashed), default=math.inf)
        now_s = self._clock.now()
        quiet_s = min((schedule.quiet_until_s(now_s) for schedule in self._faults), default=math.inf)
        if blind_s <= stride / rate_hz or quiet_s <= now_s:
            return 0
        alone_s = min((each.alone_s for each in self._acting), default=math.inf)
        due_s = min(until_s, quiet_s, now_s + min(alone_s, LONGEST_S))
        while (turns := min(self._turns, turns_before(due_s, first, stride, rate_hz))) > 1:
            try:
                before = Snapshot([*self.roots, *changed])
            except TypeError:
                break
            last_s = (first + (turns - 1) * stride) / rate_hz
            for each in self._leashed:
                each.watched_until_s = last_s
            self._clock.wait_until(last_s)
            happened_s = look()
            if happened_s is None:
                self._apart = False
                self._quiet(armed)
                return turns
            before.restore()
            self._happened(turns, turns_before(happened_s, first, stride, rate_hz))
        return 0

    def _quiet(self, armed: bool) -> None:
        """Nothing happened in as many turns. Where no detector is armed, little can happen in many."""
        self._turns = 1 if self._known else GROWTH * self._turns if armed else sys.maxsize
        self._known = False

    def _happened(self, turns: int, before: int) -> None:
        """Something happened in so many turns, and nothing in those `before` it; all but one where that is unknown."""
        self._known = before < turns - 1
        self._turns = max(1, before if self._known else turns // 2)


def turns_before(t_s: float, first: int, stride: int, rate_hz: float) -> int:
    """How many turns from `first` on, one each `stride` periods, are before a time."""
    if not math.isfinite(t_s):
        return sys.maxsize if t_s > 0.0 else 0
    return max(0, (math.ceil(t_s * rate_hz - 1e-6) - 1 - first) // stride + 1)


class Snapshot:
    """The state of some objects, down to the last array, to be restored in place. An array stays itself and gets its
    values back, as do its views, whoever has them.

    Settings, functions without a closure and the program's frozen dataclasses (blocks, commands) are values, which
    never change; nor does a read-only array. A class names in `lasting` what need not be put back: a ring of the
    latest samples, twice as long as a look; what it holds of later ones is written anew. One with a method
    `copy_kept` is copied by it.

    Args:
        roots: The objects. What they share is copied once.

    Raises:
        TypeError: one of them holds something that cannot be copied (a generator, a closure, a file).
    """

    def __init__(self, roots: Iterable[object]) -> None:
        kept = list(roots)
        memo: dict[int, Any] = {id(root): root for root in kept}
        self._arrays: list[tuple[Any, Any]] = []
        memo[_ARRAYS] = self._arrays
        self._kept = [(root, _copy(root.__dict__, memo)) for root in kept]

    def restore(self) -> None:
        """Put everything back; once."""
        for root, state in self._kept:
            root.__dict__.clear()
            root.__dict__.update(state)
        for array, values in self._arrays:
            array.flags.writeable = True  # a block that was made of it meanwhile is not to be written to
            array[...] = values


def _copy(thing: Any, memo: dict[int, Any]) -> Any:
    kind = type(thing)
    copier = _COPIERS.get(kind)
    if copier is None:
        copier = _COPIERS[kind] = _copier(kind)
        if copier is _same:
            _PLAIN.add(kind)
    known = memo.get(id(thing))
    return copier(thing, memo) if known is None else known


def _copier(kind: type) -> Copier:
    """How things of this type are copied. Of typing is the alias that an instance of a generic class was made by."""
    if issubclass(kind, (*_VALUES, Settings)) or kind.__module__.partition(".")[0] in ("numba", "typing"):
        return _same
    if is_dataclass(kind) and kind.__dataclass_params__.frozen:  # type: ignore[attr-defined]
        # one of the user's own may hold an array that is written to
        return _same if kind.__module__.partition(".")[0] in _OURS else _of_objects(kind)
    if hasattr(kind, "copy_kept"):
        return lambda thing, _: thing.copy_kept()
    if issubclass(kind, tuple) and hasattr(kind, "_make"):
        return lambda thing, memo: _tuple(thing, memo, kind._make)
    if all(base is object or base.__flags__ & _OF_PYTHON for base in kind.__mro__):
        return _of_objects(kind)
    raise TypeError(f"{kind.__module__}.{kind.__qualname__}")


def _each(things: Iterable[Any], memo: dict[int, Any]) -> list[Any]:
    """Copies, in order. What is plain or fixed, most of a bench, is not asked about again: this is where the time
    goes."""
    return [each if type(each) in _PLAIN or id(each) in _FIXED else _copy(each, memo) for each in things]


def _tuple(thing: Any, memo: dict[int, Any], made: Callable[[list[Any]], Any] = tuple) -> Any:
    """A tuple of copies, or the tuple itself where there was nothing to copy."""
    parts = _each(thing, memo)
    if not all(map(is_, thing, parts)):
        return made(parts)
    if all(map(_is_fixed, thing)):
        _FIXED[id(thing)] = thing
    return thing


def _is_fixed(thing: Any) -> bool:
    if isinstance(thing, np.ndarray):
        return not thing.flags.writeable
    return type(thing) in _PLAIN or id(thing) in _FIXED


def _same(thing: Any, _: dict[int, Any]) -> Any:
    return thing


def _of_objects(kind: type) -> Copier:
    """How objects of a class are copied; what the class says of them is looked up once."""
    lasting = getattr(kind, "lasting", ())
    slots = [name for base in kind.__mro__ for name in base.__dict__.get("__slots__", ())]

    def copied(thing: Any, memo: dict[int, Any]) -> Any:
        made: Any = object.__new__(kind)
        memo[id(thing)] = made
        for name in lasting:
            memo[id(getattr(thing, name))] = getattr(thing, name)
        if kind.__dictoffset__:
            made.__dict__.update(zip(thing.__dict__, _each(thing.__dict__.values(), memo), strict=True))
        for name in slots:
            if hasattr(thing, name):
                object.__setattr__(made, name, _copy(getattr(thing, name), memo))
        return made

    return copied


def _function(thing: Any, _: dict[int, Any]) -> Any:
    kept = getattr(thing, "__closure__", None) or getattr(thing, "__self__", None)
    if kept is not None and not isinstance(kept, ModuleType):
        raise TypeError(f"{thing.__qualname__}, which may keep something")
    return thing


def _array(thing: Any, memo: dict[int, Any]) -> Any:
    if thing.dtype.hasobject:
        raise TypeError("an array of objects")
    memo[id(thing)] = thing
    if thing.flags.writeable:
        memo[_ARRAYS].append((thing, thing.copy("K")))
    return thing


def _dict(thing: Any, memo: dict[int, Any]) -> Any:
    made = memo[id(thing)] = {}
    made.update(zip(_each(thing, memo), _each(thing.values(), memo), strict=True))
    return made


def _defaultdict(thing: Any, memo: dict[int, Any]) -> Any:
    made = memo[id(thing)] = defaultdict(thing.default_factory, _dict(thing, memo))
    return made


def _list(thing: Any, memo: dict[int, Any]) -> Any:
    made: list[Any] = []
    memo[id(thing)] = made
    made += _each(thing, memo)
    return made


def _deque(thing: Any, memo: dict[int, Any]) -> Any:
    made: deque[Any] = deque(maxlen=thing.maxlen)
    memo[id(thing)] = made
    made += _each(thing, memo)
    return made


_VALUES: tuple[type, ...] = (
    *(type(None), bool, int, float, complex, str, bytes, range, slice, frozenset, Enum, type),
    *(np.generic, np.dtype, np.ufunc, ModuleType, MappingProxyType),
)

_OURS = ("behaviors", "config", "controller", "drivers", "simulator")

_PLAIN: set[type] = set(_VALUES)
"""Types whose things are values; those that are met are added."""

_FIXED: dict[int, Any] = {}
"""Tuples of the trial with nothing in them that can change, by their id: legs of a motion, a scene's constants."""

_ARRAYS = 0
"""Where a snapshot's copies note arrays and their values; nothing has this id."""

_OF_PYTHON = 1 << 9
"""Flag of a class that is made by a class statement (CPython: Py_TPFLAGS_HEAPTYPE)."""

_COPIERS: dict[type, Copier] = {
    tuple: _tuple,
    set: lambda thing, memo: set(_each(thing, memo)),
    FunctionType: _function,
    BuiltinFunctionType: _function,
    MethodType: lambda thing, memo: MethodType(thing.__func__, _copy(thing.__self__, memo)),
    np.ndarray: _array,
    dict: _dict,
    defaultdict: _defaultdict,
    list: _list,
    deque: _deque,
}
"""By type; those that are met are added."""
