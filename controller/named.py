"""What `module:attribute` names: a part of the program, or the user's own, found beside a profile."""

from __future__ import annotations

import hashlib
import importlib
import sys
import traceback
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, get_type_hints

if TYPE_CHECKING:
    from drivers.settings import Settings


_PARTS = {
    "detector": ("push", "reset"),
    "signal": ("push", "reset"),
    "driver": ("open", "close", "apply", "read", "poll", "account"),
    "experiment": ("begin", "handle", "table", "states"),
}
"""What a class of each role has; see `controller.detectors.protocol` and its like."""

_folders: dict[str, Path] = {}
"""Top-level modules of the user's own that are loaded, what they import of their folder included, and that folder."""


class NamedError(ValueError):
    """What a name means is not there, or is something else: one line."""


def found(name: str) -> Any:
    """What `module:attribute` names; the user's own must have been loaded by `found_beside`."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)


def is_own(name: str) -> bool:
    """Whether a name in a profile is the user's own: `my_lab.edge:Edge`."""
    return ":" in name


def mock_of(driver: str) -> str:
    """The mock of a driver of the user's own: `MockScale` beside `Scale`."""
    module, _, made = driver.partition(":")
    return f"{module}:Mock{made}"


def found_beside(name: str, folders: Sequence[Path]) -> Any:
    """What `module:attribute`, or `module`, names in the first of `folders` that has the module, or installed.

    The folder is on the import path for this import alone.

    Raises:
        NamedError: no such module, it cannot be imported, or it has no such attribute.
    """
    module_name, colon, attribute = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), attribute if colon else "_")):
        raise NamedError("must be MODULE:CLASS, as in my_lab.edge:Edge")
    module = _imported(module_name, folders)
    if attribute and not hasattr(module, attribute):
        raise NamedError(f"{module.__file__} has no {attribute}")
    return getattr(module, attribute) if attribute else module


def check_role(role: str, name: str, folders: Sequence[Path]) -> None:
    """Load a class of the user's own and see that it is what it is used as.

    Args:
        role: "detector", "signal", "driver" or "experiment".
        name: `module:Class`.
        folders: As `found_beside`.

    Raises:
        NamedError: as `found_beside`, or it is something else.
    """
    made = found_beside(name, folders)
    lacking = [part for part in _PARTS[role] if not hasattr(made, part)]
    if not isinstance(made, type) or lacking:
        raise NamedError(f"is no {role}" + (f": it has no {', '.join(lacking)}" if lacking else ""))
    settings_of(made)
    if role == "experiment":
        settings_of(made, "factors")
        module = found_beside(name.partition(":")[0], folders)
        for part in ("COLUMNS", "measure"):
            if not hasattr(module, part):
                raise NamedError(f"{module.__file__} has no {part}, which says what is measured")


def settings_of(made: Any, parameter: str = "settings") -> type[Settings]:
    """The settings class of a class, from the annotation of its constructor's parameter.

    Raises:
        NamedError: there is none.
    """
    from drivers.settings import Settings  # `list` names classes, and loads none

    try:
        model = get_type_hints(made.__init__).get(parameter)
    except NameError as error:
        raise NamedError(f"{made.__name__}: {error}; import it outside of TYPE_CHECKING") from None
    if not (isinstance(model, type) and issubclass(model, Settings)):
        raise NamedError(
            f"{made.__name__}(…, {parameter}, …): the type of {parameter} must be a class of Settings"
        )
    return model


def own_files(names: Sequence[str]) -> Mapping[str, Mapping[str, str]]:
    """For each loaded module of the user's own its folder and the SHA-256 of its files, for the manifest.

    What stands beside those that are named and was imported by own modules counts as theirs.
    """
    named = {name.partition(":")[0].partition(".")[0] for name in names if is_own(name)}
    folders = {_folders[top] for top in named if top in _folders}  # the others are installed
    account = {}
    for top, folder in sorted(_folders.items()):
        if folder not in folders:
            continue
        paths = [folder / f"{top}.py", *sorted((folder / top).rglob("*.py"))]
        data = b"".join(path.read_bytes() for path in paths if path.is_file())
        account[top] = {"folder": str(folder), "sha256": hashlib.sha256(data).hexdigest()}
    return account


def forget_own() -> None:
    """Unload the user's own modules: what is found next is what their files hold then."""
    for top in _folders:
        _unload(top)
    _folders.clear()


def own_place(error: BaseException) -> str:
    """File and line of the user's own in which an error arose; "" where it is none of theirs."""
    files = {folder / top for top, folder in _folders.items()}
    places = [
        f"{frame.filename}, line {frame.lineno}"
        for frame in traceback.extract_tb(error.__traceback__)
        if files & {path := Path(frame.filename).with_suffix(""), *path.parents}
    ]
    return places[-1] if places else ""


def own_folders(manifest: Mapping[str, Any]) -> Sequence[Path]:
    """Where a run found the user's own modules."""
    own = (manifest.get("profile") or {}).get("own") or {}
    return [Path(entry["folder"]) for entry in own.values()]


def _imported(name: str, folders: Sequence[Path]) -> ModuleType:
    top = name.partition(".")[0]
    there = [folder for folder in folders if _has(folder, top)]
    if there:
        for known in [known for known in _folders if known != top and _has(there[0], known)]:
            _make_way(known, there[0])  # a helper of another profile's
        _make_way(top, there[0])
        _folders[top] = there[0]
    path = [str(folder) for folder in there[:1]]
    sys.path[:0] = path
    before, kept, sys.dont_write_bytecode = (
        set(sys.modules),
        sys.dont_write_bytecode,
        True,
    )  # it has no version
    try:
        importlib.invalidate_caches()
        module = import_module(name)
        for helper in {new.partition(".")[0] for new in set(sys.modules) - before} if there else ():
            if _lies_in(sys.modules.get(helper), there[0]):
                _folders[helper] = there[0]
    except (Exception, SystemExit) as error:  # a script that was written to be run ends the program
        if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
            where = ", ".join(str(folder) for folder in folders) or "the program"
            raise NamedError(f"no module {error.name} in {where}") from None
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = " ".join(str(error).split())
        line = getattr(error, "lineno", None) or place.lineno
        file = getattr(error, "filename", None) or place.filename
        raise NamedError(
            f"{name} cannot be imported: {type(error).__name__}: {reason} ({file}, line {line})"
        ) from None
    finally:
        sys.dont_write_bytecode = kept
        for entry in path:
            sys.path.remove(entry)
    return module


def _has(folder: Path, top: str) -> bool:
    return (folder / f"{top}.py").is_file() or (folder / top).is_dir()


def _lies_in(module: ModuleType | None, folder: Path) -> bool:
    """Whether it is a file of the folder, or a package in it."""
    file = Path(getattr(module, "__file__", None) or "/")
    return folder in (file.parent, file.parent.parent if file.name == "__init__.py" else file.parent)


def _make_way(top: str, folder: Path) -> None:
    """Unload a module of the same name that another profile's folder has.

    Raises:
        NamedError: the name is one of the program's or of a library.
    """
    if top not in sys.modules or _folders.get(top) == folder:
        return
    if top not in _folders:
        raise NamedError(f"the name {top} is taken by a module of the program; rename {folder / top}")
    _unload(top)


def _unload(top: str) -> None:
    for name in [name for name in sys.modules if name == top or name.startswith(f"{top}.")]:
        del sys.modules[name]
