"""The sections of a profile, each held against the settings class that it configures."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from typing import Any, TypeVar, get_args

from pydantic.fields import FieldInfo

from config.entries import DeviceEntry, Entry, SettingsTable
from config.hints import did_you_mean, near_or_all
from config.source import Bench, KeyPath, Source, Table, bench_of, flatten
from config.trials import TrialsSettings, combinations
from config.validation import shown, validated
from controller.named import NamedError, check_role, is_own, mock_of
from drivers.settings import Refers, Settings

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


ADDRESS = "host"
"""Setting of a driver that a profile gives as the device's `port`."""

SIGNALS = "signals"
"""Section of the signals, and what their streams' names begin with."""

DRIVE = "drive_hz"
"""Setting by this name of a behavior, a signal or a detector is the frequency with which the transducers are driven."""

REST = "baseline_s"
"""Setting by this name of a behavior is how long it rests, with its detectors armed, before it moves."""

HOME_SPEED = "home_speed_m_s"
"""Setting by this name of a device is the speed of its `Home`, which no command carries and so no guard can see."""

_NAMED_ABOVE = ("driver", "port", "kind")
"""Keys that choose the settings class, so most classes do not have them as fields."""


class Sections:
    """Reads a source section by section.

    A section with mistakes comes back without them; `problems` has grown by a line for each mistake.

    Args:
        source: The profile's files, joined.
        table: Which settings class validates what.
    """

    def __init__(self, source: Source, table: SettingsTable) -> None:
        self.problems: list[str] = []
        self._source = source
        self._table = table
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
            names = ", ".join(sorted(self._table.names("experiment")))
            self._complain(
                (), "experiment", f" is missing: which of {names}? (a bench alone is there to be extended)"
            )
            return None
        return self._kind((), self._source.data, "experiment", self._table.names("experiment"))

    def bench(self) -> Bench:
        """What the ports make of the bench."""
        ports = {name: table.get("port") for name, table in self._tables("devices") if "port" in table}
        mocks = [name for name, port in ports.items() if port == "mock"]
        if mocks and len(mocks) < len(ports):
            other = next(name for name in ports if name not in mocks)
            self._complain(
                ("devices", mocks[0]),
                "port",
                f' = "mock": virtual time cannot be shared with {other} at {shown(ports[other])};'
                " all ports are mock, or none",
            )
        return bench_of(self._source.data)

    def devices(self) -> dict[str, DeviceEntry]:
        """The devices that are sound."""
        entries = {}
        for name, table in self._tables("devices"):
            path = ("devices", name)
            port = table.get("port")
            driver = self._driver(path, table, port)
            if not isinstance(port, str) or not port:
                hint = 'write "mock", "emulated", a path such as "/dev/ttyUSB0", or an address'
                self._complain(
                    path, "port", f" = {shown(port)}: {hint}" if "port" in table else f" is missing: {hint}"
                )
            elif driver is not None:
                model = self._table.settings("driver", driver, port)
                settings = self._settings(model, self._with_address(model, table, path, port), path)
                if settings:
                    entries[name] = DeviceEntry(driver, port, settings)
        if SIGNALS in self._table_of("devices"):
            self._complain(
                ("devices",), SIGNALS, ": the name is taken by the signals' streams; choose another"
            )
        if not self._table_of("devices"):
            self._complain((), "devices", " is missing: a bench has at least one device")
        return entries

    def _driver(self, path: KeyPath, table: Table, port: object) -> str | None:
        """Name of a device's driver; one of the user's own on the mock bench is its mock."""
        name = table.get("driver")
        if not (isinstance(name, str) and is_own(name)):
            return self._name(path, table, "driver", self._table.names("driver"))
        if port == "emulated":
            self._complain(
                path, "port", f' = "emulated": {name} has no emulated device; write "mock" or a real port'
            )
            return None
        made = mock_of(name) if port == "mock" else name
        return name if self._loaded(path, "driver", "driver", made) else None

    def _with_address(self, model: type[Settings], table: Table, path: KeyPath, port: str) -> Table:
        """A device that is reached over a network has its address for a port."""
        if ADDRESS not in model.model_fields:
            return table
        if ADDRESS in table:
            self._complain(path, ADDRESS, f' = {shown(table[ADDRESS])}: goes into port = "…"')
        return {**table, ADDRESS: port}

    def detectors(self) -> dict[str, Entry]:
        """The detectors that are sound."""
        return dict(self._entries("detector"))

    def _entries(self, part: str) -> Iterator[tuple[str, Entry]]:
        for name, table in self._tables(f"{part}s"):
            path = (f"{part}s", name)
            kind = self._kind(path, table, "kind", self._table.names(part), part)
            settings = kind and self._settings(self._table.settings(part, kind), table, path)
            if kind and settings:
                yield name, Entry(kind, settings)

    def signals(self) -> dict[str, Entry]:
        """The signals that are sound."""
        entries = dict(self._entries("signal"))
        self._check_circles(entries)
        for name, entry in entries.items():
            misfit = getattr(entry.settings, "misfit", lambda: None)()
            if misfit is not None:
                self._complain(("signals", name), *misfit)
        return entries

    def _check_circles(self, entries: Mapping[str, Entry]) -> None:
        """A signal that is made of itself, however far round, is never made."""
        inputs = {name: getattr(entry.settings, "input", "") for name, entry in entries.items()}
        for first in entries:
            name, way = first, [first]
            while (stream := inputs.get(name, "")).startswith(f"{SIGNALS}."):
                name = stream.partition(".")[2]
                if name == first:
                    circle = " → ".join([first, *reversed(way)])
                    self._complain(
                        ("signals", first), "input", f" = {shown(inputs[first])}: goes in a circle, {circle}"
                    )
                if name in way:
                    break
                way.append(name)

    def behavior(self, experiment: str) -> Settings | None:
        """Settings of the experiment."""
        model = self._table.settings("experiment", experiment)
        return self._settings(model, self._table_of("behavior"), ("behavior",))

    def check_drive(
        self,
        behavior: Settings | None,
        signals: Mapping[str, Entry],
        detectors: Mapping[str, Entry],
    ) -> None:
        """A demodulator must have the frequency of the drive: at another one there is no signal."""
        driven_hz = getattr(behavior, DRIVE, None)
        listeners = [(SIGNALS, name, entry.settings) for name, entry in signals.items()]
        listeners += [("detectors", name, entry.settings) for name, entry in detectors.items()]
        for section, name, settings in listeners:
            own_hz = getattr(settings, DRIVE, driven_hz)
            if driven_hz is not None and own_hz != driven_hz:
                mistake = (
                    f" = {shown(own_hz)}: [behavior] has {DRIVE} = {shown(driven_hz)}; write the same in both"
                )
                self._complain((section, name), DRIVE, mistake)
        self._check_rest(behavior, signals, detectors)

    def _check_rest(
        self,
        behavior: Settings | None,
        signals: Mapping[str, Entry],
        detectors: Mapping[str, Entry],
    ) -> None:
        """A detector that learns at rest needs enough samples before its end, also of a signal that begins late."""
        baseline_s = getattr(behavior, REST, None)
        for name, entry in detectors.items():
            _, _, signal = str(getattr(entry.settings, "input", "")).partition(f"{SIGNALS}.")
            learn_s = getattr(entry.settings, "learn_s", None)
            silent_s = getattr(signals[signal].settings, "silent_s", 0.0) if signal in signals else 0.0
            if baseline_s is None or learn_s is None or not silent_s or baseline_s >= silent_s + learn_s:
                continue
            mistake = (
                f" = {shown(baseline_s)}: [signals.{signal}] tracks for {silent_s:.2f} s before it gives anything, and"
                f" [detectors.{name}] learns for {learn_s:g} s; make it"
                f" {math.ceil(100.0 * (silent_s + learn_s)) / 100.0:g} or longer"
            )
            self._complain(("behavior",), REST, mistake)

    def check_home(self, devices: Mapping[str, DeviceEntry], limits: Settings | None) -> None:
        """Limits must be of existing movers; `Home` must not be faster than the guard lets other motions be."""
        movers = getattr(limits, "movers", {})
        for name in movers.keys() - devices.keys():
            self._complain(
                ("limits", "movers"), name, f" is no device of this bench; {near_or_all(name, devices)}"
            )
        for name, entry in devices.items():
            most_m_s = getattr(movers.get(name, limits), "speed_m_s", None)
            home_m_s = getattr(entry.settings, HOME_SPEED, None)
            if most_m_s is not None and home_m_s is not None and home_m_s > most_m_s:
                mistake = f" = {shown(home_m_s)}: faster than [limits] speed_m_s = {shown(most_m_s)}; lower it to that"
                self._complain(("devices", name), HOME_SPEED, mistake)

    def part(self, name: str) -> Settings | None:
        """Settings of the guard (`limits`) or of the `loop`."""
        return self._settings(self._table.settings(name), self._table_of(name), (name,))

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
            plants = ", ".join(sorted(self._table.names("plant")))
            self._complain(
                ("plant",), "kind", f" is missing: which physics does the {bench} bench have ({plants})?"
            )
            return None
        named = self._name(("plant",), table, "kind", self._table.names("plant"))
        settings = named and self._settings(self._table.settings("plant", named), table, ("plant",))
        return Entry(named, settings) if named and settings else None

    def faults(self, bench: Bench, devices: Mapping[str, DeviceEntry]) -> tuple[Any, ...]:
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
            fault = self._settings(self._table.settings("faults"), table, ("faults", str(number)))
            if fault:
                faults.append(fault)
                self._check_shown(fault, devices, ("faults", str(number)))
        return tuple(faults)

    def _check_shown(self, fault: Any, devices: Mapping[str, DeviceEntry], path: KeyPath) -> None:
        entry = devices.get(fault.device)
        if entry is None:
            return
        kinds = self._table.faults_of(entry.driver, entry.port)
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

    def _kind(
        self, path: KeyPath, table: Table, key: str, known: Collection[str], role: str = ""
    ) -> str | None:
        """A name out of a collection, or a class of the user's own beside the profile, which is loaded."""
        name = table.get(key)
        if not (isinstance(name, str) and is_own(name)):
            return self._name(path, table, key, known)
        return name if self._loaded(path, key, role or key, name) else None

    def _loaded(self, path: KeyPath, key: str, role: str, name: str) -> bool:
        try:
            check_role(role, name, self._source.folders)
        except NamedError as error:
            self._complain(path, key, f" = {shown(name)}: {error}")
            return False
        return True

    def _name(self, path: KeyPath, table: Table, key: str, known: Collection[str]) -> str | None:
        """A name out of a collection, such as a driver's."""
        name = table.get(key)
        if isinstance(name, str) and name in known:
            return name
        if key in table:
            what = f"unknown {key}; {near_or_all(name, known)}" if isinstance(name, str) else "must be a text"
            self._complain(path, key, f" = {shown(name)}: {what}")
            return None
        # Most often a misspelt table: [detectors.contakt] beside [detectors.contact].
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
            names = (value,) if isinstance(value, str) else value if isinstance(value, tuple) else ()
            for kind in referred(field):
                for name in names:
                    self._check_name(kind, path, key, name)

    def _check_name(self, kind: str, path: KeyPath, key: str, name: str) -> None:
        device, _, stream = name.partition(".") if kind == "stream" else (name, "", "")
        if kind == "stream" and device == SIGNALS:
            self._check_signal(path, key, name, stream)
            return
        what = "detector" if kind == "detector" else "device"
        known = self._table_of(f"{what}s")
        if device not in known:
            self._complain(path, key, f" = {shown(name)}: no {what} '{device}'; {near_or_all(device, known)}")

    def _check_signal(self, path: KeyPath, key: str, name: str, signal: str) -> None:
        signals = self._table_of(SIGNALS)
        if signal not in signals:
            self._complain(
                path, key, f" = {shown(name)}: no signal '{signal}'; {near_or_all(signal, signals)}"
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


def referred(field: FieldInfo) -> set[str]:
    """Kinds of things that a setting names, wherever in its type that stands."""
    found = {mark.to for mark in field.metadata if isinstance(mark, Refers)}
    waiting: list[Any] = [field.annotation]
    while waiting:
        annotation = waiting.pop()
        found |= {mark.to for mark in getattr(annotation, "__metadata__", ()) if isinstance(mark, Refers)}
        waiting += get_args(annotation)
    return set(found)
