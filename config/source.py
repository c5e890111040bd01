"""Profile files: finding them, joining what they extend, and tracking which file gave each value.

Nothing here knows what the keys mean, and nothing heavy is imported: `run.py list` stays quick.
"""

from __future__ import annotations

import math
import re
import tomllib
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import date, datetime, time
from pathlib import Path
from typing import Any, Literal

from config.hints import did_you_mean
from controller.registry import FAMILIES
from drivers.core.errors import PROGRAM

PROFILES = Path(__file__).resolve().parent / "profiles"
"""Where the profiles live that go by a name."""

Bench = Literal["mock", "emulated", "hardware"]
Table = dict[str, Any]
KeyPath = tuple[str, ...]

TOO_DEEP = "tables and lists are nested too deep; a profile has four levels"

ABSENT = "none"
"""Driver of a device that the extended bench has and this one does not."""

_VARIANTS: Mapping[KeyPath, str] = {
    (family.section,) if family.section else (): family.key
    for family in FAMILIES.values()
    if family.key != "experiment"
}
"""Where a table's settings belong to a driver or kind that a key in it names: those tables start afresh when
a later file names another one, for the settings of the old one would mean nothing to it."""


_BREAKS = re.compile(r"[\x00-\x1f\x7f\x85\u2028\u2029]")
"""Control characters and line breaks, as a quoted TOML key may hold them."""


class ProfileError(ValueError):
    """A profile cannot be used.

    Attributes:
        problems: What is wrong, one line each; the first one decides.
    """

    def __init__(self, problems: str | Sequence[str]) -> None:
        listed = (problems,) if isinstance(problems, str) else problems
        self.problems = tuple(_BREAKS.sub(lambda found: repr(found[0])[1:-1], problem) for problem in listed)
        super().__init__("\n".join(self.problems))


@dataclass(frozen=True)
class Source:
    """The joined content of a profile's files.

    Attributes:
        name: `mock/transient`, or the path that was asked for.
        files: Every file that was joined, parents first, as they are shown to people.
        data: The joined tables.
        origins: For the path of each value, the file (or `--set`) that gave it.
        folders: Where modules that the profile names are looked for: beside it, then beside what it extends.
    """

    name: str
    files: tuple[str, ...]
    data: Table
    origins: Mapping[KeyPath, str]
    folders: tuple[Path, ...] = ()

    def origin(self, path: KeyPath) -> str:
        """The file that gave a value; for a missing one, the last file to give anything around it."""
        while path:
            if path in self.origins:
                return self.origins[path]
            below = [file for key, file in self.origins.items() if key[: len(path)] == path]
            if below:
                return below[-1]
            path = path[:-1]
        return self.files[-1]

    def joined(self, top: Mapping[str, Any], label: str) -> Source:
        """This source with more tables laid over it, which came from `label`."""
        origins = dict(self.origins)
        return replace(self, data=_join(self.data, top, (), label, origins), origins=origins)

    def with_rows(self, rows: Sequence[Mapping[str, Any]], labels: Sequence[str]) -> Source:
        """This source with trials from elsewhere in place of its own; `labels` are their places."""
        trials = self.data.get("trials")
        kept = trials if isinstance(trials, dict) else {}
        asked = {key: kept[key] for key in ("order", "repeats") if key in kept}
        data = {**self.data, "trials": {**asked, "list": list(rows)}}
        origins = {key: file for key, file in self.origins.items() if key[:2] != ("trials", "grid")}
        origins |= {("trials", "list", str(row)): label for row, label in enumerate(labels)}
        return replace(self, data=data, origins=origins)


def profile_names() -> list[str]:
    """Names of the profiles that come with the program."""
    return sorted(path.relative_to(PROFILES).with_suffix("").as_posix() for path in PROFILES.rglob("*.toml"))


def read_source(name_or_path: str | Path, overrides: Mapping[str, str] | None = None) -> Source:
    """Read a profile with all that it extends.

    Each file is applied once, parents before children and in the order in which `extends` names them; tables
    are joined key by key, any other value replaces the one before it.

    Args:
        name_or_path: `mock/transient`, or the path of a TOML file.
        overrides: Values for dotted keys as a command line gives them; applied last.

    Raises:
        ProfileError: no such profile, no TOML, a circle of `extends`, a key that runs through a plain value.
    """
    files: dict[Path, Table] = {}
    _collect(_locate(str(name_or_path), None), (), files)
    source = Source(
        name=_short_name(next(reversed(files))),
        files=tuple(_shown(file) for file in files),
        data={},
        origins={},
        folders=tuple(dict.fromkeys(file.parent for file in reversed(files))),
    )
    for file, table in files.items():
        source = source.joined({key: table[key] for key in table if key != "extends"}, _shown(file))
    return _without_absent(source.joined(_nested(overrides or {}), "--set"))


def _without_absent(source: Source) -> Source:
    """The source without the devices that are "none": a bench that another one extends leaves them out."""
    devices = source.data.get("devices")
    if not isinstance(devices, dict):
        return source
    kept = {name: table for name, table in devices.items() if table != ABSENT}
    return replace(source, data={**source.data, "devices": kept})


def bench_of(data: Mapping[str, Any]) -> Bench:
    """What the ports of a profile's devices make of it."""
    devices = data.get("devices")
    tables = devices.values() if isinstance(devices, dict) else ()
    ports = [table.get("port") for table in tables if isinstance(table, dict)]
    if ports and all(port == "mock" for port in ports):
        return "mock"
    return "emulated" if "emulated" in ports else "hardware"


def flatten(table: Mapping[str, Any]) -> Iterator[tuple[str, Any]]:
    """Dotted keys and values of nested tables, in their order."""
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from ((f"{key}.{below}", leaf) for below, leaf in flatten(value))
        else:
            yield key, value


def nest(pairs: Iterable[tuple[str, Any]]) -> Table:
    """The nested tables that dotted keys mean.

    Raises:
        ProfileError: a key runs through another one's plain value.
    """
    table: Table = {}
    for dotted, value in pairs:
        *parents, last = dotted.split(".")
        place = table
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise ProfileError(f"{dotted}: '{parent}' already has a plain value")
        place[last] = value
    return table


def _nested(overrides: Mapping[str, str]) -> Table:
    for dotted in overrides:
        if not all(dotted.split(".")):
            raise ProfileError(f"--set: '{dotted}' is no key; write for example --set limits.force_n=1.5")
    try:
        return nest((dotted, given_value(dotted, text)) for dotted, text in overrides.items())
    except ProfileError as error:
        raise ProfileError(f"--set: {error}") from None


def given_value(dotted: str, text: str) -> Any:
    """`toml_value` of a setting, which an error names."""
    try:
        return toml_value(text)
    except ProfileError as error:
        raise ProfileError(f"{dotted} = {error}") from None


def toml_value(text: str) -> Any:
    """A TOML value, or the text itself where it is none, so that text needs no quotes."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except RecursionError:
        raise ProfileError(f"{_short(text)}: {TOO_DEEP}") from None
    except ValueError:
        return text
    for _, _, reason in _unusable(parsed):
        raise ProfileError(f"{_short(text)}: {reason}")
    return parsed["value"] if set(parsed) == {"value"} else text


def _short(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:37]}..."


def _collect(path: Path, below: tuple[Path, ...], files: dict[Path, Table]) -> None:
    if path in below:
        circle = " -> ".join(_short_name(file) for file in (*below[below.index(path) :], path))
        raise ProfileError(f"{_shown(below[-1])}: extends goes in a circle: {circle}")
    if path in files:
        return
    table = _read(path)
    parents = table.get("extends", [])
    parents = [parents] if isinstance(parents, str) else parents
    if not (isinstance(parents, list) and all(isinstance(parent, str) for parent in parents)):
        raise ProfileError(
            f'{_shown(path)}: extends = {parents!r} is no profile name; write extends = "mock/transient"'
        )
    for parent in parents:
        _collect(_locate(parent, path), (*below, path), files)
    files[path] = table


def _locate(name: str, extending: Path | None) -> Path:
    """The file that a name means: under config/profiles, else beside the extending file or here."""
    folder = extending.parent if extending else Path()
    for path in (PROFILES / f"{name}.toml", folder / name, folder / f"{name}.toml"):
        with suppress(OSError):  # a name that no file system holds
            if name and path.is_file():
                return path.resolve()
    where = f"{_shown(extending)}: extends = {name!r}: " if extending else ""
    advice = did_you_mean(name, profile_names()) or f"see: {PROGRAM} list"
    raise ProfileError(f"{where}no profile '{_short(name)}'; {advice}")


def _read(path: Path) -> Table:
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except RecursionError:
        raise ProfileError(f"{_shown(path)}: {TOO_DEEP}") from None
    except UnicodeDecodeError as error:
        raise ProfileError(f"{_shown(path)}: byte {error.start}: no UTF-8, so no TOML") from None
    except ValueError as error:  # no TOML, or a whole number of thousands of digits
        reason, _, place = str(error).rpartition(" (at ")
        place = place.rstrip(")") or "end of document"
        raise ProfileError(f"{_shown(path)}: {place}: no TOML: {reason or error}") from None
    except OSError as error:
        raise ProfileError(f"{_shown(path)}: cannot be read: {error.strerror}") from None
    unusable = [
        f"{_shown(path)}: {_as_written(dotted)} = {value}: {reason}"
        for dotted, value, reason in _unusable(table)
    ]
    if unusable:
        raise ProfileError(unusable)
    return table


def _unusable(value: Any, dotted: str = "") -> Iterator[tuple[str, Any, str]]:
    """Values that TOML knows and no setting takes."""
    if isinstance(value, dict):
        for key, below in value.items():
            yield from _unusable(below, f"{dotted}.{key}" if dotted else key)
    elif isinstance(value, list):
        for below in value:
            yield from _unusable(below, dotted)
    elif isinstance(value, float) and not math.isfinite(value):
        yield dotted, value, "must be finite"
    elif isinstance(value, date | datetime | time):
        yield dotted, value, "is a date or a time of day; no setting takes one"


def _as_written(dotted: str) -> str:
    section, _, key = dotted.rpartition(".")
    return f"[{section}] {key}" if section else key


def _join(
    base: Mapping[str, Any], top: Mapping[str, Any], path: KeyPath, label: str, origins: dict[KeyPath, str]
) -> Table:
    joined = dict(base)
    for key, value in top.items():
        here = (*path, key)
        before = joined.get(key)
        origins.pop(here, None)
        if not isinstance(value, dict):
            _forget(origins, here)
            joined[key], origins[here] = value, label
            continue
        if not isinstance(before, dict) or _names_another(path, before, value):
            _forget(origins, here)
            before = {}
        joined[key] = _join(before, value, here, label, origins)
        if not value:  # an empty table counts as written
            origins[here] = label
    return joined


def _names_another(path: KeyPath, before: Table, value: Table) -> bool:
    variant = _VARIANTS.get(path)
    return (
        variant is not None and variant in before and value.get(variant, before[variant]) != before[variant]
    )


def _forget(origins: dict[KeyPath, str], path: KeyPath) -> None:
    for known in [known for known in origins if known[: len(path)] == path]:
        del origins[known]


def _short_name(path: Path) -> str:
    if path.is_relative_to(PROFILES):
        return path.relative_to(PROFILES).with_suffix("").as_posix()
    return _shown(path)


def _shown(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)
