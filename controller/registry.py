"""What a name in a profile means: one table for what is shipped, one rule for it and for the user's own.

A name is a row of `kinds.toml`, or `module:Class` of the user's own, for which a row is made. The settings class sits
beside the class. Nothing heavy is imported: `run.py list` stays quick.
"""

from __future__ import annotations

import sys
import tomllib
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from inspect import signature
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, get_args, get_type_hints

from controller.own_modules import KindError, found, found_beside, is_own

if TYPE_CHECKING:
    from types import ModuleType

    from drivers.core.settings import Settings


@dataclass(frozen=True)
class PlainKind:
    """A row of the table: of a detector, a signal or a plant.

    Attributes:
        made: `module:Class`, or a function, which makes one from its settings.
        summary: One line for people; "" of the user's own.
    """

    made: str
    summary: str = ""

    @classmethod
    def own(cls, name: str, folders: Sequence[Path]) -> PlainKind:
        """The row of a class of the user's own."""
        return cls(name)

    def at(self, port: str) -> str:
        """What is made of it at a port."""
        return self.made


LINE_FAULTS = ("unplug", "silent", "lose", "corrupt")
"""What the line of any emulated device can show."""

SENSED = ("stuck", "wrong", "drift", "late")
"""What any simulated device can show: between its driver and the loop."""


@dataclass(frozen=True)
class DriverKind(PlainKind):
    """A driver.

    Attributes:
        emulated: Function that makes its emulated twin from the driver's settings and the bench.
        mock_faults: What the mock can show (`simulator.devices.faults.Kind`).
        emulated_faults: Likewise the twin.
        streams: What its device sends, where that is known before it is opened.
        moves: Whether it may move: while it does, the streams of `[limits]` are read.
    """

    mock: str = ""
    emulated: str = ""
    mock_faults: Sequence[str] = ()
    emulated_faults: Sequence[str] = ()
    streams: Sequence[str] = ()
    moves: bool = True

    @classmethod
    def own(cls, name: str, folders: Sequence[Path]) -> DriverKind:
        """Its mock and its twin stand beside it: `MockScale` and `EmulatedScale` beside `Scale`; what the twin can
        show beside its line's faults is its `faults`."""
        module, _, made = name.partition(":")
        mock, twin = f"Mock{made}", f"Emulated{made}"
        own = getattr(getattr(sys.modules.get(module), twin, None), "faults", ())
        shown = (*LINE_FAULTS, *own)
        return cls(
            name,
            mock=f"{module}:{mock}",
            emulated=f"{module}:{twin}",
            mock_faults=shown,
            emulated_faults=shown,
        )

    def at(self, port: str) -> str:
        """The mock driver at "mock", the real one elsewhere."""
        return self.mock if port == "mock" else self.made

    def faults(self, port: str) -> Sequence[str]:
        """What can be shown at a port; a real device breaks by itself."""
        own = {"mock": self.mock_faults, "emulated": self.emulated_faults}.get(port)
        return () if own is None else (*own, *SENSED)


@dataclass(frozen=True)
class ExperimentKind(PlainKind):
    """An experiment; `made` is its behavior, which has factors beside its settings.

    Attributes:
        measures: Module with `COLUMNS` and `measure`.
        report: Module whose `section(runs, figures)` reports it; "" for the standard section of any experiment.
        pooled: Whether that section is given trials in which a setting of the profile was varied together, and
            separates them by itself.
        outcomes: How a trial can end, and whether that is success, beside `guard`, `fault` and `aborted`, which never
            are. None of an experiment of the user's own that does not declare it.
    """

    measures: str = ""
    report: str = ""
    pooled: bool = False
    outcomes: Mapping[str, bool] | None = None

    @classmethod
    def own(cls, name: str, folders: Sequence[Path]) -> ExperimentKind:
        """The behavior's module has `COLUMNS` and `measure`, and may have `OUTCOMES` and `section`."""
        found_beside(name, folders)
        module = name.partition(":")[0]
        own = found_beside(module, folders)
        report = module if hasattr(own, "section") else ""
        return cls(name, measures=module, report=report, outcomes=getattr(own, "OUTCOMES", None))

    @property
    def successes(self) -> Sequence[str] | None:
        """The outcomes that are success; None where none are declared."""
        return None if self.outcomes is None else [word for word, success in self.outcomes.items() if success]


class Family(NamedTuple):
    """What the kinds of a family have in common.

    Attributes:
        section: Of a profile; a table in it for each one, or ("") none.
        key: Which names the kind there.
        members: What a class of the family has; see `controller.detectors.protocol` and its like.
        made: What one that is made of it has besides.
    """

    section: str
    key: str
    members: Sequence[str] = ()
    row: type[PlainKind] = PlainKind
    made: Sequence[str] = ()


FAMILIES: Mapping[str, Family] = {
    "driver": Family("devices", "driver", ("open", "close", "apply", "read", "poll", "account"), DriverKind),
    "signal": Family("signals", "kind", ("push", "reset"), made=("name", "inputs", "info")),
    "detector": Family("detectors", "kind", ("push", "reset"), made=("name", "inputs")),
    "plant": Family("", "kind", made=("advance", "restart", "begin", "check", "mount", "wrench", "account")),
    "experiment": Family("", "experiment", ("begin", "handle", "table", "states"), ExperimentKind),
}

_TABLE = tomllib.loads(Path(__file__).with_name("kinds.toml").read_text("utf-8"))

KINDS: Mapping[str, dict[str, Any]] = {
    name: {kind: family.row(**row) for kind, row in _TABLE[name].items()} for name, family in FAMILIES.items()
}
"""The rows of what is shipped, by family and name."""

EXPERIMENTS: Mapping[str, ExperimentKind] = KINDS["experiment"]

PARTS = {
    "limits": "controller.guard:GuardSettings",
    "loop": "controller.loop:LoopSettings",
    "faults": "simulator.devices.faults:Fault",
}
"""The settings classes of the sections in which there is nothing to choose."""


class Meaning(NamedTuple):
    """What a name means: the class, its settings class, and its row."""

    made: Any
    settings: type[Settings]
    row: Any


def find(family: str, name: str, folders: Sequence[Path] = (), port: str = "") -> Meaning:
    """What a name of a family means.

    Args:
        family: Of `FAMILIES`.
        name: In the table, or `module:Class` of the user's own.
        folders: Where a module of the user's own is looked for.
        port: Of a driver: at "mock" it is its mock.

    Raises:
        KindError: it is not there, or is something else.
    """
    kind = row(family, name, folders)
    if port == "emulated" and not kind.emulated:
        raise KindError('has no emulated device; write port = "mock" or a real port')
    if port == "emulated" and is_own(name):
        found_beside(kind.emulated, folders)
    made = found_beside(kind.at(port), folders) if is_own(name) else found(kind.at(port))
    lacking = [member for member in FAMILIES[family].members if not hasattr(made, member)]
    if not callable(made) or lacking:
        raise KindError(f"is no {family}" + (f": it has no {', '.join(lacking)}" if lacking else ""))
    if family == "experiment" and is_own(name):
        factors = settings_of(made, "factors")
        module = found_beside(kind.measures, folders)
        for part in ("COLUMNS", "measure"):
            if not hasattr(module, part):
                raise KindError(f"{module.__file__} has no {part}, which says what is measured")
        for line in _mistakes(module, factors.model_fields):
            raise KindError(f"{module.__file__}: {line}")
    return Meaning(made, settings_of(made), kind)


def _mistakes(module: ModuleType, factors: Collection[str]) -> Iterator[str]:
    """What is wrong with what the module of an experiment of the user's own declares."""
    columns, outcomes = module.COLUMNS, getattr(module, "OUTCOMES", {})
    if isinstance(columns, str) or not all(isinstance(each, str) for each in columns):
        yield f'COLUMNS = {columns!r}: names of columns, as ("force_n",)'
        return
    taken = Counter([*columns, *factors, "trial", "outcome"])
    if twice := ", ".join(name for name, count in taken.items() if count > 1):
        yield f"two columns are called {twice}; COLUMNS, factors, trial and outcome need different names"
    words = outcomes.items() if isinstance(outcomes, Mapping) else [(None, None)]
    if not all(isinstance(word, str) and isinstance(success, bool) for word, success in words):
        yield f'OUTCOMES = {outcomes!r}: words, and whether each is success, as {{"contact": True}}'
    try:
        signature(module.measure).bind("evidence", "settings", "outcome")
    except (TypeError, ValueError) as error:
        yield f"measure(evidence, settings, outcome) is how it is called; {error}"


def row(family: str, name: str, folders: Sequence[Path] = ()) -> Any:
    """The row of a name; one that is not in the table has an empty one.

    Raises:
        KindError: a module of the user's own that cannot be imported.
    """
    rows = FAMILIES[family].row
    return rows.own(name, folders) if is_own(name) else KINDS[family].get(name) or rows("")


def experiment_of(name: str, folders: Sequence[Path] = ()) -> ExperimentKind:
    """The row of an experiment: as `row`."""
    found_row: ExperimentKind = row("experiment", name, folders)
    return found_row


def settings_of(made: Any, what: str = "settings") -> type[Settings]:
    """The class of the settings (or factors) from which something is made.

    It is `XSettings` in the module of the class `X`, the type of that parameter of its constructor, or that of a
    generic base, as in `OnStream[XSettings]`; or one of these of a class from which X derives, the nearest first.

    Raises:
        KindError: there is none.
    """
    from drivers.core.settings import Settings  # `list` names classes, and loads none

    for known in getattr(made, "__mro__", (made,)):
        named = getattr(sys.modules[known.__module__], f"{known.__name__}{what.capitalize()}", None)
        of_bases = [part for base in vars(known).get("__orig_bases__", ()) for part in get_args(base)]
        for model in (named, _hint(known, what), *of_bases):
            if isinstance(model, type) and issubclass(model, Settings):
                return model
    wanted = f"no {made.__name__}{what.capitalize()}, a class of Settings, beside the class {made.__name__}"
    raise KindError(f"{wanted}, and none is the type of its constructor's {what}")


@cache
def _hint(made: Any, parameter: str) -> Any:
    """The type of a parameter of a class's own constructor, or of a function."""
    maker = vars(made).get("__init__") if isinstance(made, type) else made
    if parameter not in getattr(maker, "__annotations__", ()):
        return None
    try:
        return get_type_hints(maker)[parameter]
    except NameError as error:
        raise KindError(f"{made.__name__}: {error}; import it outside of TYPE_CHECKING") from None
