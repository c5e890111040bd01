"""What `module:attribute` names: a part of the program, or the user's own, found beside a profile."""

import hashlib
import importlib
import sys
import traceback
from collections.abc import Callable, Iterable, Mapping, Sequence
from importlib import import_module
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

_folders: dict[str, Path] = {}
"""Top-level modules of the user's own that are loaded, what they import of their folder included, and that folder."""


class KindError(ValueError):
    """What a name means is not there, or is something else: one line."""


def found(name: str) -> Any:
    """What `module:attribute` names; the user's own must have been loaded by `found_beside`."""
    module, _, attribute = name.partition(":")
    return getattr(import_module(module), attribute)


def is_own(name: str) -> bool:
    """Whether a name in a profile is the user's own: `my_lab.edge:Edge`."""
    return ":" in name


def is_shipped(thing: object) -> bool:
    """Whether a signal or detector is one of the program's."""
    return type(thing).__module__.startswith("controller.")


def pushed(thing: Any, name: str, block: Any, right: Callable[[Any], bool], what: str) -> list[Any]:
    """What a signal or detector makes of a block; one of the user's own may return anything.

    Args:
        name: Of it, for the error message; "" where its own message says it.
        right: Whether what it returns is made of these: `what`, in words.

    Raises:
        ValueError: it cannot use its stream, or returns no list of what is right.
    """
    try:
        given = thing.push(block if is_shipped(thing) else block.read_only())
        made = list(given) if isinstance(given, Iterable) else [None]
    except ValueError as error:
        raise ValueError(": ".join(filter(None, (own_place(error), name, str(error))))) from error
    if not all(map(right, made)):
        raise ValueError(" ".join(f"{name}: push returns no list of {what}, but {given!r}".split())[:200])
    return made


def found_beside(name: str, folders: Sequence[Path]) -> Any:
    """What `module:attribute`, or `module`, names in the first of `folders` that has the module, or installed.

    The folder is on the import path for this import alone.

    Raises:
        KindError: no such module, it cannot be imported, or it has no such attribute.
    """
    module_name, colon, attribute = name.partition(":")
    if not all(part.isidentifier() for part in (*module_name.split("."), attribute if colon else "_")):
        raise KindError("must be MODULE:CLASS, as in my_lab.edge:Edge")
    module = _imported(module_name, folders)
    if attribute and not hasattr(module, attribute):
        raise KindError(f"{module.__file__} has no {attribute}")
    return getattr(module, attribute) if attribute else module


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


def as_error(ended: Exception | SystemExit) -> Exception:
    """An error; a class of the user's own that ends the program (`sys.exit`) makes one as any other."""
    if isinstance(ended, Exception):
        return ended
    return RuntimeError(f"ends the program, by sys.exit({ended.code!r})").with_traceback(ended.__traceback__)


class _Beside(MetaPathFinder):
    """Finds what the user's own imports later, inside a function, beside their modules that are loaded."""

    def find_spec(self, name: str, path: Any = None, target: Any = None) -> ModuleSpec | None:
        """See `MetaPathFinder`; asked last."""
        for folder in dict.fromkeys(_folders.values()) if path is None else ():
            if _has(folder, name):
                _folders[name] = folder
                return PathFinder.find_spec(name, [str(folder)])
        return None


sys.meta_path.append(_Beside())


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
    if not there and (loaded := sys.modules.get(name)) is not None:
        return loaded
    if there:
        for known in [known for known in _folders if known != top and _has(there[0], known)]:
            _make_way(known, there[0])  # a helper of another profile's
        _make_way(top, there[0])
        _folders[top] = there[0]
    path = [str(folder) for folder in there[:1]]
    sys.path[:0] = path
    before, kept = set(sys.modules), sys.dont_write_bytecode
    sys.dont_write_bytecode = True  # it has no version
    try:
        importlib.invalidate_caches()
        module = import_module(name)
        for helper in {new.partition(".")[0] for new in set(sys.modules) - before} if there else ():
            if _lies_in(sys.modules.get(helper), there[0]):
                _folders[helper] = there[0]
    except (Exception, SystemExit) as error:  # a script that was written to be run ends the program
        if isinstance(error, ModuleNotFoundError) and error.name and f"{name}.".startswith(f"{error.name}."):
            where = ", ".join(str(folder) for folder in folders) or "the program"
            raise KindError(f"no module {error.name} in {where}") from None
        helper = str(error.name).partition(".")[0] if isinstance(error, ImportError) else ""
        if there and helper in sys.modules and helper not in _folders and _has(there[0], helper):
            raise _taken(helper, there[0]) from None
        place = traceback.extract_tb(error.__traceback__)[-1]
        reason = " ".join(str(error).split())
        line = getattr(error, "lineno", None) or place.lineno
        file = getattr(error, "filename", None) or place.filename
        raise KindError(
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
        KindError: the name is one of the program's or of a library.
    """
    if top not in sys.modules or _folders.get(top) == folder:
        return
    if top not in _folders:
        raise _taken(top, folder)
    _unload(top)


def _taken(top: str, folder: Path) -> KindError:
    return KindError(f"the name {top} is taken by a module of the program; rename {folder / top}")


def _unload(top: str) -> None:
    for name in [name for name in sys.modules if name == top or name.startswith(f"{top}.")]:
        del sys.modules[name]
