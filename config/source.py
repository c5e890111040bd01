"""Profile files, read and written: finding them, joining what they extend, and tracking which file gave each value.

Nothing here knows what the keys mean, and nothing heavy is imported: `run.py list` stays quick.
"""

from __future__ import annotations

import json
import re
import tomllib
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from config.hints import did_you_mean, near_or_all
from controller.registry import FAMILIES
from drivers.core.errors import PROGRAM

PROFILES = Path(__file__).resolve().parent / "profiles"
"""Where the profiles live that go by a name."""

Bench = Literal["mock", "emulated", "hardware"]
Table = dict[str, Any]
KeyPath = tuple[str, ...]

TOO_DEEP = "tables and lists are nested too deep; a profile has four levels"

ABSENT = "none"
"""In place of a device, signal or detector that the extended bench has and this one does not."""

TAKEN_OFF = ("devices", "signals", "detectors")
"""The sections of which each table can be taken off."""

UNSET = "?"
"""What a text begins with that stands in place of a value which only the lab knows; the rest says how to find it."""

_CHOOSING: Mapping[KeyPath, str] = {
    (family.section,) if family.section else (): family.key
    for family in FAMILIES.values()
    if family.key != "experiment"
}
"""The key by which a table of a section (of a plant: of the profile) names its driver or kind."""


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
        origins: For the path of each value, the file (or `--set`) that gave it.
        folders: Where modules that the profile names are looked for: beside it, then beside what it extends.
        asked: For the path of each value that was once asked for: which file asked, and how to find it. Until one is
            given, the value of the extended profile stands in its place, which nothing may be run with.
    """

    name: str
    files: tuple[str, ...]
    data: Table
    origins: Mapping[KeyPath, str]
    folders: tuple[Path, ...] = ()
    asked: Mapping[KeyPath, tuple[str, str]] = field(default_factory=dict)
    absent: Mapping[str, frozenset[str]] = field(default_factory=dict)

    @property
    def unset(self) -> Mapping[KeyPath, str]:
        """The values that nobody has given yet, and how to find each."""
        return {path: hint for path, (label, hint) in self.asked.items() if self.origins.get(path) == label}

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
        data = _join(self.data, top, (), label, origins)
        asked = {path: (label, text[len(UNSET) :].strip()) for path, text in _asking(top)}
        return replace(self, data=data, origins=origins, asked={**self.asked, **asked})

    def with_rows(self, rows: Mapping[str, Mapping[str, Any]]) -> Source:
        """This source with trials from elsewhere, by their places, in place of its own."""
        trials = self.data.get("trials")
        kept = trials if isinstance(trials, dict) else {}
        asked = {key: kept[key] for key in ("order", "repeats", "reconnects") if key in kept}
        data = {**self.data, "trials": {**asked, "list": list(rows.values())}}
        origins = {key: file for key, file in self.origins.items() if key[:2] != ("trials", "grid")}
        origins |= {("trials", "list", str(row)): label for row, label in enumerate(rows)}
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
    try:
        given = nest((dotted, given_value(dotted, text)) for dotted, text in (overrides or {}).items())
    except ProfileError as error:
        raise ProfileError(f"--set: {error}") from None
    source = source.joined(given, "--set")
    _check_absent(source, [*files.values(), given])
    return without_absent(source)


def _check_absent(source: Source, tables: Sequence[Table]) -> None:
    """What is taken off must have been there, but in a file that extends nothing: what `check` prints names it too.

    Args:
        tables: Of the files, and last what `--set` gave.

    Raises:
        ProfileError: one was not; a wrong name would leave on what was meant.
    """
    problems = []
    for section in TAKEN_OFF:
        named = [table for table in tables if isinstance(table.get(section), dict)]
        there = {name for table in named for name, entry in table[section].items() if entry != ABSENT}
        extending = [table for table in named if "extends" in table or table is tables[-1]]
        for name in sorted({name for table in extending for name in table[section]} - there):
            where = f"{source.origin((section, name))}: [{section}] {name}"
            problems.append(f'{where} = "{ABSENT}": nothing has that name; {near_or_all(name, there)}')
    if problems:
        raise ProfileError(problems)


def without_absent(source: Source) -> Source:
    """The source without what is "none": a bench that another one extends leaves it out."""
    sections = {name: source.data[name] for name in TAKEN_OFF if isinstance(source.data.get(name), dict)}
    absent = {
        section: frozenset(name for name, table in tables.items() if table == ABSENT)
        for section, tables in sections.items()
    }
    kept = {
        section: {name: table for name, table in tables.items() if name not in absent[section]}
        for section, tables in sections.items()
    }
    return replace(source, data={**source.data, **kept}, absent=absent)


def _asking(table: Mapping[str, Any], path: KeyPath = ()) -> Iterator[tuple[KeyPath, str]]:
    """Where a text stands in place of a value, and that text."""
    for place, value in _leaves(table, path):
        if len(place) > 1 and isinstance(value, str) and value.startswith(UNSET):
            yield place, value


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
    return ((".".join(map(str, path)), leaf) for path, leaf in _leaves(table, ()))


def _leaves(table: Mapping[str, Any], path: KeyPath) -> Iterator[tuple[KeyPath, Any]]:
    for key, value in table.items():
        if isinstance(value, Mapping):
            yield from _leaves(value, (*path, key))
        else:
            yield (*path, key), value


def nest(pairs: Iterable[tuple[str, Any]]) -> Table:
    """The nested tables that dotted keys mean.

    Raises:
        ProfileError: no key, or one that runs through another one's plain value.
    """
    table: Table = {}
    for dotted, value in pairs:
        *parents, last = dotted.split(".")
        if not all((*parents, last)):
            raise ProfileError(f"'{dotted}' is no key; write for example limits.force_n")
        place = table
        for parent in parents:
            place = place.setdefault(parent, {})
            if not isinstance(place, dict):
                raise ProfileError(f"{dotted}: '{parent}' already has a plain value")
        place[last] = value
    return table


def given_value(dotted: str, text: str) -> Any:
    """A TOML value of a setting, or the text itself where it is none, so that text needs no quotes."""
    try:
        parsed = tomllib.loads(f"value = {text}")
    except RecursionError:
        raise ProfileError(f"{dotted} = {_short(text)}: {TOO_DEEP}") from None
    except ValueError:
        return text
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
        return tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise ProfileError(f"{_shown(path)}: cannot be read: {error.strerror}") from None
    except (ValueError, RecursionError) as error:  # a whole number of thousands of digits too
        reason = TOO_DEEP if isinstance(error, RecursionError) else error
        raise ProfileError(f"{_shown(path)}: no TOML in UTF-8: {reason}") from None


def _join(
    base: Mapping[str, Any], top: Mapping[str, Any], path: KeyPath, label: str, origins: dict[KeyPath, str]
) -> Table:
    joined = dict(base)
    for key, value in top.items():
        here, before = (*path, key), joined.get(key)
        goes_on = (
            isinstance(value, dict) and isinstance(before, dict) and not _starts_afresh(path, before, value)
        )
        for known in [here] if goes_on else [known for known in origins if known[: len(here)] == here]:
            origins.pop(known, None)
        if isinstance(value, dict):
            joined[key] = _join(before if goes_on and before else {}, value, here, label, origins)
        elif key == "port" or not any(_asking({key: value}, path)):
            joined[key] = value
        # else what was there, or the default, stands in until there is a value; a port decides which bench it is
        if not isinstance(value, dict) or not value:  # an empty table counts as written
            origins[here] = label
    return joined


def _starts_afresh(path: KeyPath, before: Table, value: Table) -> bool:
    """Whether a table names another driver or kind: the settings of the old one mean nothing to it."""
    key = _CHOOSING.get(path)
    return key is not None and key in before and value.get(key, before[key]) != before[key]


def _short_name(path: Path) -> str:
    if path.is_relative_to(PROFILES):
        return path.relative_to(PROFILES).with_suffix("").as_posix()
    return _shown(path)


def _shown(path: Path) -> str:
    here = Path.cwd()
    return str(path.relative_to(here)) if path.is_relative_to(here) else str(path)


_BARE = re.compile(r"[A-Za-z0-9_-]+")
_COMMENT_COLUMN = 42
"""Where comments begin, in characters: right of most settings."""


def to_toml(table: Mapping[str, Any], origin: Callable[[KeyPath], str]) -> str:
    """A profile file equivalent to the table.

    Args:
        table: Nested tables, as `Profile.resolved` gives them.
        origin: Gives the source of the value at a path; it becomes the value's comment.
    """
    return "\n".join(_lines(table, (), origin)).strip() + "\n"


def with_setting(text: str, path: KeyPath, value: Any, comment: str) -> str:
    """A profile's text with one setting given; all else stays as it is, comments too.

    Args:
        path: `("detectors", "contact", "threshold")`.

    Raises:
        ProfileError: it stands there in a way that is not changed here, in an inline table for one; the line to write.
    """
    given, *table = f"{toml_value(value)}  # {comment}", *path[:-1]
    lines, here, header = text.rstrip("\n").split("\n"), list[str](), None
    for number, line in enumerate(lines):
        key, equals, _ = line.partition("=")
        if found := re.match(r"\s*\[([^\[\]]+)\]", line):
            here = _parts(found[1])
            header = number if here == table else header
        elif equals and (*here, *_parts(key)) == path:
            lines[number] = f"{key.rstrip()} = {given}"
            break
    else:
        at = len(lines) if header is None else header + 1
        opened = ["", f"[{'.'.join(map(_key, table))}]"] if header is None else []
        lines[at:at] = [*opened, f"{_key(path[-1])} = {given}"]
    changed = "\n".join(lines) + "\n"
    with suppress(tomllib.TOMLDecodeError):
        if tomllib.loads(changed) == with_value(tomllib.loads(text), path, value):
            return changed
    raise ProfileError(
        f"[{'.'.join(table)}] cannot be written to as it stands; write there: {path[-1]} = {given}"
    )


def _parts(dotted: str) -> list[str]:
    return [part.strip().strip("\"'") for part in dotted.split(".")]


def with_value(table: Mapping[str, Any], path: KeyPath, value: Any) -> Any:
    """Nested tables with another value at a path."""
    return {**table, path[0]: with_value(table.get(path[0], {}), path[1:], value)} if path else value


def _lines(table: Mapping[str, Any], path: KeyPath, origin: Callable[[KeyPath], str]) -> Iterator[str]:
    below = {key: value for key, value in table.items() if isinstance(value, Mapping)}
    here = {key: value for key, value in table.items() if key not in below}
    if path and here:
        yield ""
        yield f"[{'.'.join(_key(part) for part in path)}]"
    for key, value in here.items():
        *lines, last = f"{_key(key)} = {_rows(value)}".split("\n")
        yield from lines
        yield f"{last:<{_COMMENT_COLUMN}}  # {origin((*path, key))}"
    for key, value in below.items():
        yield from _lines(value, (*path, key), origin)


def _rows(value: Any) -> str:
    """A value; a list of tables has a line for each."""
    if isinstance(value, list) and value and all(isinstance(row, Mapping) for row in value):
        return "\n".join(["[", *(f"    {toml_value(row)}," for row in value), "]"])
    return toml_value(value)


def toml_value(value: Any) -> str:
    """A value as a profile writes it, on one line."""
    if isinstance(value, Mapping):
        return "{ " + ", ".join(f"{_key(key)} = {toml_value(leaf)}" for key, leaf in value.items()) + " }"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(toml_value(item) for item in value) + "]"
    # A JSON text is a TOML text but for DEL; numbers and truth values are the same in both.
    return json.dumps(value, ensure_ascii=False).replace("\x7f", "\\u007f")


def _key(key: str) -> str:
    return key if _BARE.fullmatch(key) else toml_value(key)
