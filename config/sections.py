"""The sections of a profile, each held against the settings class that it configures."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from graphlib import CycleError, TopologicalSorter
from typing import Any, TypeVar, get_args

from pydantic.fields import FieldInfo

from config.hints import did_you_mean, near_or_all
from config.source import ABSENT, Bench, KeyPath, Source, Table, bench_of, flatten
from config.trials import TrialsSettings, combinations
from config.validation import shown, validated
from controller.own_modules import KindError, found, is_own
from controller.registry import FAMILIES, KINDS, PARTS, Meaning, find, row
from drivers.core.settings import Refers, Settings

S = TypeVar("S", bound=Settings)

KEYS = (
    "title",
    "description",
    "experiment",
    "devices",
    "signals",
    "detectors",
    "behavior",
    "limits",
    "loop",
    "plant",
    "faults",
    "trials",
)
"""What may stand at the top of a profile, beside `extends`."""

NO_PLANT = "none"
"""The kind of plant of a real bench."""


SIGNALS = "signals"
"""Section of the signals, and what their streams' names begin with."""

_NAMED_ABOVE = ("driver", "port", "kind")
"""Keys that choose the settings class, so most classes do not have them as fields."""


@dataclass(frozen=True)
class Entry:
    """A device, a detector, a signal or the physics of a simulated bench: what makes it, with which settings.

    Attributes:
        kind: Its name in the table, or `module:Class`.
        made: The class; of a device at "mock" that of its mock.
        settings: Of that class.
        port: Of a device.
    """

    kind: str
    made: Any
    settings: Settings
    port: str = ""


class Sections:
    """Reads a source section by section.

    A section with mistakes comes back without them; `problems` has grown by a line for each mistake.

    Args:
        source: The profile's files, joined.

    Attributes:
        problems: What is wrong, a line each.
        unverified: Streams of devices that tell theirs once they are open: where each is named, and its name.
    """

    def __init__(self, source: Source) -> None:
        self.problems: list[str] = []
        self.unverified: dict[tuple[str, str], None] = {}
        self._source = source
        self._sound: dict[KeyPath, Settings] = {}
        for key in [key for key in source.data if key not in KEYS]:
            self._complain((), key, f" = {shown(source.data[key])}: unknown key; {near_or_all(key, KEYS)}")

    def text(self, key: str) -> str:
        """A line or paragraph for people."""
        value = self._source.data.get(key, "")
        if not isinstance(value, str):
            self._complain((), key, f" = {shown(value)}: must be a text")
        return str(value)

    def experiment(self) -> str | None:
        """Name of the behavior."""
        if "experiment" not in self._source.data:
            names = ", ".join(sorted(KINDS["experiment"]))
            self._complain(
                (), "experiment", f" is missing: which of {names}? (a bench alone is there to be extended)"
            )
            return None
        table = self._source.data
        return table["experiment"] if self._found("experiment", (), table) else None

    def bench(self) -> Bench:
        """What the ports make of the bench; where they do not go together, what its plant is meant for."""
        ports = {name: table.get("port") for name, table in self._tables("devices") if "port" in table}
        mocks = [name for name, port in ports.items() if port == "mock"]
        if mocks and len(mocks) < len(ports):
            other = next(name for name in ports if name not in mocks)
            self._complain(
                ("devices", mocks[0]),
                "port",
                f' = "mock": virtual time cannot be shared with {other} at {shown(ports[other])};'
                ' write "emulated", which runs in real time beside a real port, or a real port',
            )
            return "hardware" if self._table_of("plant").get("kind", NO_PLANT) == NO_PLANT else "emulated"
        return bench_of(self._source.data)

    def devices(self) -> dict[str, Entry]:
        """The devices that are sound."""
        entries = {}
        for name, table in self._tables("devices"):
            path = ("devices", name)
            port = table.get("port")
            kind = self._driver(path, table, port)
            if not isinstance(port, str) or not port:
                hint = 'write "mock", "emulated", a path such as "/dev/ttyUSB0", or an address'
                self._complain(
                    path, "port", f" = {shown(port)}: {hint}" if "port" in table else f" is missing: {hint}"
                )
            elif kind is not None:
                settings = self._settings(kind.settings, self._with_address(kind.settings, table, path), path)
                if settings:
                    entries[name] = Entry(table["driver"], kind.made, settings, port)
        if SIGNALS in self._table_of("devices"):
            self._complain(
                ("devices",), SIGNALS, ": the name is taken by the signals' streams; choose another"
            )
        if not self._table_of("devices"):
            self._complain((), "devices", " is missing: a bench has at least one device")
        return entries

    def _driver(self, path: KeyPath, table: Table, port: object) -> Meaning | None:
        """A device's driver; on the mock bench its mock."""
        name = table.get("driver")
        if name == ABSENT:
            self._complain(
                path, "driver", f' = "{ABSENT}": to leave it out, write {path[-1]} = "{ABSENT}" in [devices]'
            )
            return None
        if isinstance(name, str) and is_own(name) and port == "emulated":
            self._complain(
                path, "port", f' = "emulated": {name} has no emulated device; write "mock" or a real port'
            )
            return None
        return self._found("driver", path, table, str(port))

    def _with_address(self, model: type[Settings], table: Table, path: KeyPath) -> Table:
        """A device that is reached over a network has its address for a port."""
        for key in model.keys_of("address"):
            if key in table:
                self._complain(path, key, f' = {shown(table[key])}: goes into port = "…"')
            table = {**table, key: table["port"]}
        return table

    def detectors(self) -> dict[str, Entry]:
        """The detectors that are sound."""
        return dict(self._entries("detector"))

    def signals(self) -> dict[str, Entry]:
        """The signals that are sound; one that is made of itself, however far round, is never made."""
        entries = dict(self._entries("signal"))
        inputs = {name: _streams_in(entry.settings) for name, entry in entries.items()}
        try:
            TopologicalSorter(
                {
                    name: [stream.removeprefix(f"{SIGNALS}.") for stream in streams]
                    for name, streams in inputs.items()
                }
            ).prepare()
        except CycleError as error:
            first, circle = error.args[1][0], " → ".join(error.args[1])
            self._complain((SIGNALS,), first, f": goes in a circle, {circle}")
        return entries

    def _entries(self, family: str) -> Iterator[tuple[str, Entry]]:
        for name, table in self._tables(FAMILIES[family].section):
            entry = self._entry(family, (FAMILIES[family].section, name), table)
            if entry:
                yield name, entry

    def _entry(self, family: str, path: KeyPath, table: Table) -> Entry | None:
        kind = self._found(family, path, table)
        settings = kind and self._settings(kind.settings, table, path)
        return Entry(table["kind"], kind.made, settings) if kind and settings else None

    def behavior(self, experiment: str) -> Settings | None:
        """Settings of the experiment."""
        model = find("experiment", experiment, self._source.folders).settings
        return self._settings(model, self._table_of("behavior"), ("behavior",))

    def check_together(self, devices: Mapping[str, Entry]) -> None:
        """What is sound by itself must go with the rest: each settings class has its own rules for that."""
        profile: dict[KeyPath, Settings] = {
            ("devices", name): entry.settings for name, entry in devices.items()
        } | self._sound
        for path, settings in profile.items():
            for place, key, mistake in settings.mismatches(path, profile):
                self._complain(place, key, mistake)

    def part(self, name: str) -> Settings | None:
        """Settings of the guard (`limits`) or of the `loop`."""
        return self._settings(found(PARTS[name]), self._table_of(name), (name,))

    def plant(self, bench: Bench) -> Entry | None:
        """The physics; a real bench has its own."""
        table = self._table_of("plant")
        kind = table.get("kind", NO_PLANT)
        if bench == "hardware":
            if kind != NO_PLANT:
                self._complain(
                    ("plant",), "kind", f' = {shown(kind)}: a real bench has no plant; write kind = "none"'
                )
            return None
        if kind == NO_PLANT:
            plants = ", ".join(sorted(KINDS["plant"]))
            self._complain(
                ("plant",), "kind", f" is missing: which physics does the {bench} bench have ({plants})?"
            )
            return None
        return self._entry("plant", ("plant",), table)

    def faults(self, bench: Bench, devices: Mapping[str, Entry]) -> tuple[Any, ...]:
        """What goes wrong on purpose, on a simulated bench: each of a kind that its device can show."""
        listed = self._source.data.get("faults", [])
        if not isinstance(listed, list) or not all(isinstance(fault, dict) for fault in listed):
            self._complain((), "faults", f" = {shown(listed)}: must be tables, each under [[faults]]")
            return ()
        if listed and bench == "hardware":
            self._complain((), "faults", ": a real bench breaks by itself; remove them")
            return ()
        faults = []
        for number, table in enumerate(listed):
            fault = self._settings(found(PARTS["faults"]), table, ("faults", str(number)))
            if fault:
                faults.append(fault)
                self._check_shown(fault, devices, ("faults", str(number)))
        return tuple(faults)

    def _check_shown(self, fault: Any, devices: Mapping[str, Entry], path: KeyPath) -> None:
        entry = devices.get(fault.device)
        if entry is None:
            return
        kinds = row("driver", entry.kind).faults(entry.port)
        if fault.kind not in kinds:
            has = f"it can show {', '.join(sorted(kinds))}" if kinds else "it is no simulated device"
            self._complain(path, "kind", f" = {shown(fault.kind)}: {fault.device} never shows it; {has}")

    def trials(self) -> TrialsSettings | None:
        """Which trials; the experiment defines their factors."""
        table = dict(self._table_of("trials"))
        listed, grid = table.get("list"), table.get("grid")
        if isinstance(listed, list):
            table["list"] = [dict(flatten(row)) if isinstance(row, dict) else row for row in listed]
        if isinstance(grid, dict):
            table["grid"] = dict(flatten(grid))
        trials = self._validated(TrialsSettings, table, ("trials",))
        twice = {name for row in trials.list for name in row if name in trials.grid} if trials else set()
        if trials and not combinations(trials):
            self._complain(
                ("trials",), "list" if not trials.list else "grid", " is empty: there is nothing to run"
            )
        for name in sorted(twice):
            self._complain(
                ("trials", "grid"), name, ": is in the list too; a factor is either listed or crossed"
            )
        return trials

    # what the sections share

    def _table_of(self, section: str) -> Table:
        table = self._source.data.get(section, {})
        if isinstance(table, dict):
            return table
        self._complain((), section, f" = {shown(table)}: must be a table, under [{section}]")
        return {}

    def _tables(self, section: str) -> Iterator[tuple[str, Table]]:
        for name, table in self._table_of(section).items():
            if isinstance(table, dict):
                yield name, table
            else:
                self._complain(
                    (section,), name, f" = {shown(table)}: must be a table, under [{section}.{name}]"
                )

    def _found(self, family: str, path: KeyPath, table: Table, port: str = "") -> Meaning | None:
        """What a table names: one that is shipped, or of the user's own, which is loaded."""
        key, known = FAMILIES[family].key, KINDS[family]
        name = table.get(key)
        if isinstance(name, str) and (name in known or is_own(name)):
            try:
                return find(family, name, self._source.folders, port)
            except KindError as error:
                mock = (
                    f"; the mock bench takes Mock{name.partition(':')[2]}(OverMemory, …)"
                    if port == "mock"
                    else ""
                )
                self._complain(path, key, f" = {shown(name)}: {error}{mock}")
        elif key in table:
            what = f"unknown {key}; {near_or_all(name, known)}" if isinstance(name, str) else "must be a text"
            self._complain(path, key, f" = {shown(name)}: {what}")
        else:  # most often a misspelt table: [detectors.contakt] beside [detectors.contact]
            beside = [other for other in self._table_of(path[0]) if other != path[-1]]
            hint = did_you_mean(path[-1], beside) or near_or_all("", known)
            self._complain(path, key, f" is missing; {hint}")
        return None

    def _settings(self, model: type[Settings], table: Table, path: KeyPath) -> Settings | None:
        """Settings of a class that may be the user's own: it need not have the keys that chose it."""
        own = {
            key: value for key, value in table.items() if key not in _NAMED_ABOVE or key in model.model_fields
        }
        settings = self._validated(model, own, path)
        if settings is not None:
            self._sound[path] = settings
            self._check_names(settings, path)
        return settings

    def _validated(self, model: type[S], table: Table, path: KeyPath) -> S | None:
        return validated(model, table, path, self._where, self.problems)

    def _check_names(self, settings: Settings, path: KeyPath) -> None:
        """What a setting refers to by its type must be there."""
        for key, field in type(settings).model_fields.items():
            value = getattr(settings, key)
            if isinstance(value, dict):
                for name, inner in value.items():
                    if isinstance(inner, Settings):
                        self._check_names(inner, (*path, key, str(name)))
            names = (value,) if isinstance(value, str) else value if isinstance(value, tuple | dict) else ()
            for kind in referred(field):
                for name in names:
                    self._check_name(kind, path, key, name)

    def _check_name(self, kind: str, path: KeyPath, key: str, name: str) -> None:
        owner, _, stream = name.partition(".") if kind == "stream" else (name, "", "")
        what = "detector" if kind == "detector" else "device"
        if kind == "stream" and owner == SIGNALS:
            what, owner, stream = "signal", stream, ""
        known = self._table_of(f"{what}s")
        if owner not in known:
            self._complain(path, key, f" = {shown(name)}: no {what} '{owner}'; {near_or_all(owner, known)}")
        elif kind == "stream" and what == "device":
            table = known[owner] if isinstance(known[owner], dict) else {}
            driver = KINDS["driver"].get(str(table.get("driver")))
            sent = [f"{owner}.{each}" for each in (driver.streams if driver else ())]
            if not sent:
                self.unverified[self._where(path, (key,)), name] = None
            elif name not in sent:
                self._complain(
                    path, key, f" = {shown(name)}: {owner} has no such stream; {near_or_all(name, sent)}"
                )

    def _complain(self, path: KeyPath, key: str, what: str) -> None:
        self.problems.append(f"{self._where(path, (key,))}{what}")

    def _where(self, path: KeyPath, location: KeyPath) -> str:
        names: list[str] = []
        for part in (*path, *location):
            if part.isdecimal() and names:
                names[-1] += f" #{int(part) + 1}"
            else:
                names.append(part)
        key = names.pop() if location else ""
        section = f"[{'.'.join(names)}]" if names else ""
        file = self._source.origin((*path, *location))
        return " ".join(part for part in (f"{file}:", section, key) if part)


def _streams_in(settings: Settings) -> list[str]:
    """The streams that settings name."""
    values = [
        getattr(settings, key)
        for key, field in type(settings).model_fields.items()
        if "stream" in referred(field)
    ]
    return [name for value in values for name in ((value,) if isinstance(value, str) else value or ())]


def referred(field: FieldInfo) -> set[str]:
    """Kinds of things that a setting names, wherever in its type that stands."""
    found = {mark.to for mark in field.metadata if isinstance(mark, Refers)}
    waiting: list[Any] = [field.annotation]
    while waiting:
        annotation = waiting.pop()
        found |= {mark.to for mark in getattr(annotation, "__metadata__", ()) if isinstance(mark, Refers)}
        waiting += get_args(annotation)
    return set(found)
