"""The sections of a profile, each held against the settings class that it configures."""

import os
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cache
from graphlib import CycleError, TopologicalSorter
from typing import Any, get_args

from pydantic import Field
from pydantic.fields import FieldInfo

from config.hints import did_you_mean, near_or_all
from config.source import UNSET, Bench, KeyPath, ProfileError, Source, Table, bench_of
from config.trials import TrialsSettings
from config.validation import may_be_none, shown, validated
from controller.own_modules import KindError, found, is_own
from controller.registry import FAMILIES, KINDS, PARTS, Meaning, find, row
from drivers.core.settings import Mark, Settings

NO_PLANT = "none"
"""The kind of plant of a real bench."""

SIGNALS = "signals"
"""Section of the signals, and what their streams' names begin with."""


class ProfileTables(Settings):
    """What may stand in a profile, beside `extends`; a driver or kind says what its table may hold."""

    title: str = ""
    description: str = ""
    experiment: str
    """Which of those that `list` shows; a bench alone is there to be extended."""
    devices: dict[str, Table] = Field(min_length=1)
    """A bench has at least one, in `[devices.NAME]`."""
    signals: dict[str, Table] = Field(default_factory=dict)
    detectors: dict[str, Table] = Field(default_factory=dict)
    behavior: Table = Field(default_factory=dict)
    limits: Table = Field(default_factory=dict)
    loop: Table = Field(default_factory=dict)
    plant: Table = Field(default_factory=dict)
    faults: tuple[Table, ...] = ()
    trials: TrialsSettings = Field(default_factory=TrialsSettings)


@dataclass(frozen=True)
class Entry:
    """A device, a detector, a signal or the physics of a simulated bench: what makes it, with which settings.

    Attributes:
        kind: Its name in the table, or `module:Class`.
        made: The class; of a device at "mock" that of its mock.
    """

    kind: str
    made: Any
    settings: Settings
    port: str = ""

    def make(self, of: str, name: str = "") -> Any:
        """A signal or detector of that name, or a plant, fresh.

        Raises:
            KindError: one of the user's own lacks what each must have.
        """
        made, family = self.made(*filter(None, [name]), self.settings), FAMILIES[of]
        place = f"{family.section}.{name}" if name else of
        if lacking := ", ".join(each for each in family.made if not hasattr(made, each)):
            raise KindError(f'[{place}] kind = "{self.kind}": what it makes has no {lacking}')
        return made


class Sections:
    """Reads a source section by section.

    A section with mistakes comes back without them; `problems` has grown by a line for each mistake.

    Attributes:
        unverified: Streams of devices that tell theirs once they are open: where each is named, and its name.
        deferred: What is wrong only for trials that use it, by the path of the setting: a value that the lab has not
            given, the name of something that was taken off.

    Raises:
        ProfileError: there are no such sections, or they are no tables, or the trials are none.
    """

    def __init__(self, source: Source) -> None:
        self.problems: list[str] = []
        self.unverified: dict[tuple[str, str], None] = {}
        self._source = source
        self.deferred = {
            path: f"{self._where(path)} is not set: {hint}" for path, hint in source.unset.items()
        }
        self._sound: dict[KeyPath, Settings] = {}
        self.tables = validated(ProfileTables, source.data, self._where)

    def bench(self) -> Bench:
        """What the ports make of the bench.

        Raises:
            ProfileError: they do not go together.
        """
        ports = {name: table.get("port") for name, table in self.tables.devices.items()}
        mocks = [name for name, port in ports.items() if port == "mock"]
        other = next((name for name in ports if name not in mocks and ports[name]), None)
        if mocks and other:
            raise ProfileError(
                f'{self._where(("devices", mocks[0], "port"))} = "mock": virtual time cannot be shared with {other}'
                f' at {shown(ports[other])}; write "emulated", which runs in real time beside a real port, or a real'
                " port"
            )
        return bench_of(self._source.data)

    def devices(self) -> dict[str, Entry]:
        """The devices that are sound."""
        for name, of in ((SIGNALS, "the signals' streams"), ("detector", "what detectors read")):
            if name in self.tables.devices:
                self._complain(("devices", name), f": the name is taken by {of}; choose another")
        entries = self.entries("driver")
        taken: dict[str, str] = {}
        for name, entry in entries.items():
            alone = entry.settings.serial_port and entry.port not in ("mock", "emulated", "console")
            if not alone or entry.port.startswith(UNSET):
                continue
            other = taken.setdefault(os.path.realpath(entry.port), name)
            if other != name:
                self._complain(
                    ("devices", name, "port"),
                    f" = {shown(entry.port)}: {other} is there already; a serial port has one device",
                )
        return entries

    def signals(self) -> dict[str, Entry]:
        """The signals that are sound; one that is made of itself, however far round, is never made."""
        entries = self.entries("signal")
        inputs = {
            name: [
                stream.removeprefix(f"{SIGNALS}.")
                for _, to, stream in references(entry.settings)
                if to == "stream"
            ]
            for name, entry in entries.items()
        }
        try:
            TopologicalSorter(inputs).prepare()
        except CycleError as error:
            circle = error.args[1]
            self._complain((SIGNALS, circle[0]), f": goes in a circle, {' → '.join(circle)}")
        return entries

    def behavior(self) -> Any:
        """Settings of the experiment."""
        experiment = self._found("experiment", (), {"experiment": self.tables.experiment})
        return experiment and self.settings(experiment.settings, self.tables.behavior, ("behavior",))

    def plant(self, bench: Bench) -> Entry | None:
        """The physics; a real bench has its own."""
        table = self.tables.plant
        if (table.get("kind", NO_PLANT) == NO_PLANT) == (bench == "hardware"):
            return None if bench == "hardware" else self._entry("plant", ("plant",), table)
        plants = ", ".join(sorted(KINDS["plant"]))
        remedy = (
            'a real bench has no plant; write "none"' if bench == "hardware" else f"one of {plants} is needed"
        )
        self._complain(
            ("plant", "kind"), f" = {shown(table.get('kind', NO_PLANT))} on the {bench} bench: {remedy}"
        )
        return None

    def faults(self, bench: Bench, devices: Mapping[str, Entry]) -> tuple[Any, ...]:
        """What goes wrong on purpose, on a simulated bench: each of a kind that its device can show."""
        if self.tables.faults and bench == "hardware":
            self._complain(("faults",), ": a real bench breaks by itself; remove them")
            return ()
        faults = []
        for number, table in enumerate(self.tables.faults):
            path = ("faults", str(number))
            fault = self.settings(found(PARTS["faults"]), table, path)
            if fault is None:
                continue
            entry = devices.get(fault.device)
            of_bench = (
                found("simulator.devices.faults:OF_THE_BENCH").get(fault.device, ()) if not entry else ()
            )
            kinds = row("driver", entry.kind).faults(entry.port) if entry else of_bench
            if of_bench and bench != "mock" and fault.device != "disk":
                self._complain(
                    (*path, "device"), f" = {shown(fault.device)}: on the mock bench alone, in virtual time"
                )
            elif not entry and not of_bench:
                self._check_reference((*path, "device"), "device", fault.device, False)
            elif fault.kind not in kinds:
                has = f"it can show {', '.join(sorted(kinds))}" if kinds else "it is no simulated device"
                self._complain(
                    (*path, "kind"), f" = {shown(fault.kind)}: {fault.device} never shows it; {has}"
                )
            faults.append(fault)
        return tuple(faults)

    def check_together(self) -> None:
        """What is sound by itself must go with the rest: each settings class has its own rules for that."""
        for path, settings in self._sound.items():
            for place, key, mistake in settings.mismatches(path, self._sound):
                self._complain((*place, key), mistake)

    # what the sections share

    def entries(self, family: str) -> dict[str, Entry]:
        """Those of a family that are sound, by name."""
        section = FAMILIES[family].section
        tables = getattr(self.tables, section).items()
        entries = {name: self._entry(family, (section, name), table) for name, table in tables}
        return {name: entry for name, entry in entries.items() if entry}

    def _entry(self, family: str, path: KeyPath, table: Table) -> Entry | None:
        port = table.get("port", "") if family == "driver" else ""
        kind = self._found(family, path, table, str(port))
        if kind is None:
            return None
        if family == "driver" and (not isinstance(port, str) or not port):
            given = f" = {shown(port)}" if "port" in table else " is missing"
            hint = 'write "mock", "emulated", a path such as "/dev/ttyUSB0", or an address'
            self._complain((*path, "port"), f"{given}: {hint}")
            return None
        choosing = {"port", FAMILIES[family].key} - kind.settings.model_fields.keys()
        own = {key: value for key, value in table.items() if key not in choosing}
        for key in kind.settings.keys_of("address"):
            if key in own:
                self._complain((*path, key), f' = {shown(own[key])}: goes into port = "…"')
            own[key] = port
        settings = self.settings(kind.settings, own, path)
        return Entry(table[FAMILIES[family].key], kind.made, settings, port) if settings else None

    def _found(self, family: str, path: KeyPath, table: Table, port: str = "") -> Meaning | None:
        """What a table names: one that is shipped, or of the user's own, which is loaded."""
        key, known = FAMILIES[family].key, KINDS[family]
        name, place = table.get(key), (*path, key)
        if isinstance(name, str) and (name in known or is_own(name)):
            try:
                return find(family, name, self._source.folders, port)
            except KindError as error:
                made = name.partition(":")[2]
                twins = {
                    "mock": f"mock is Mock{made}(OverMemory, …)",
                    "emulated": f"twin is Emulated{made}(settings, bench)",
                }
                hint = f"; its {twins[port]} beside it" if port in twins and is_own(name) else ""
                self._complain(place, f" = {shown(name)}: {error}{hint}")
        elif key in table:
            self._complain(place, f" = {shown(name)}: unknown {key}; {near_or_all(str(name), known)}")
        else:  # most often a misspelt table: [detectors.contakt] beside [detectors.contact]
            beside = [other for other in self._source.data[path[0]] if other != path[-1]]
            self._complain(place, f" is missing; {did_you_mean(path[-1], beside) or near_or_all('', known)}")
        return None

    def settings(self, model: type[Settings], table: Table, path: KeyPath) -> Any:
        """Settings from a table at a path; None where they are not sound."""
        try:
            settings = validated(model, table, lambda place: self._where((*path, *(place or [""]))))
        except ProfileError as error:
            self.problems += error.problems
            return None
        self._sound[path] = settings
        for place, to, name in references(settings):
            self._check_reference((*path, *place), to, name, _optional(settings, place))
        return settings

    def _check_reference(self, place: KeyPath, to: str, name: str, optional: bool) -> None:
        """What a setting names must be there."""
        owner, sends = name, to == "stream"
        if sends:
            owner, _, signal = name.partition(".")
            to, owner = ("signal", signal) if owner == SIGNALS else ("device", owner)
        known = getattr(self.tables, f"{to}s")
        if owner in self._source.absent.get(f"{to}s", ()):
            if optional and to == "detector":
                return  # the trial does without
            remedy = 'name another, or write "none"' if optional else "put it back, or name another"
            self.deferred[place] = (
                f"{self._where(place)} = {shown(name)}: {to} '{owner}' is \"none\"; {remedy}"
            )
        elif owner not in known:
            self._complain(place, f" = {shown(name)}: no {to} '{owner}'; {near_or_all(owner, known)}")
        elif sends and to == "device":
            driver = KINDS["driver"].get(str(known[owner].get("driver")))
            sent = [f"{owner}.{each}" for each in (driver.streams if driver else ())]
            if not sent:
                self.unverified[self._where(place), name] = None
            elif name not in sent:
                self._complain(
                    place, f" = {shown(name)}: {owner} has no such stream; {near_or_all(name, sent)}"
                )

    def _complain(self, place: KeyPath, what: str) -> None:
        self.problems.append(f"{self._where(place)}{what}")

    def _where(self, place: KeyPath) -> str:
        """File, section and key of a place; items of a list are counted from 1."""
        names: list[str] = []
        for part in place:
            if part.isdecimal() and names:
                names[-1] += f" #{int(part) + 1}"
            else:
                names.append(part)
        *section, key = names
        words = (f"{self._source.origin(place)}:", f"[{'.'.join(section)}]" if section else "", key)
        return " ".join(word for word in words if word)


def _optional(settings: Settings, place: KeyPath) -> bool:
    """Whether "none" may stand at a place in settings."""
    for key in place[:-1]:
        settings = settings[key] if isinstance(settings, Mapping) else getattr(settings, key)
    return may_be_none(type(settings), place[-1])


def references(settings: Settings) -> Iterator[tuple[KeyPath, str, str]]:
    """What settings refer to by their types, settings in them included: place, kind of thing and name of each."""
    for key, named in _referring(type(settings)).items():
        value = getattr(settings, key)
        for name, inner in value.items() if isinstance(value, dict) else ():
            if isinstance(inner, Settings):
                yield from (((key, str(name), *place), to, its) for place, to, its in references(inner))
        names = (value,) if isinstance(value, str) else value if isinstance(value, tuple | dict) else ()
        yield from (((key,), to, name) for to in named for name in names)


@cache
def _referring(model: type[Settings]) -> Mapping[str, set[str]]:
    """Of each setting, the kinds of things that it names."""
    return {key: referred(field) for key, field in model.model_fields.items()}


def referred(field: FieldInfo) -> set[str]:
    """Kinds of things that a setting names, wherever in its type that stands."""
    found: set[str] = {mark.what for mark in field.metadata if isinstance(mark, Mark)}
    waiting: list[Any] = [field.annotation]
    while waiting:
        annotation = waiting.pop()
        found |= {mark.what for mark in getattr(annotation, "__metadata__", ()) if isinstance(mark, Mark)}
        waiting += get_args(annotation)
    return found & {"device", "stream", "detector"}
