"""Finds what `touchbench` has, each module when a name of it is first used; `import touchbench` loads none."""

from __future__ import annotations

import ast
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path
from typing import Any

_FOLDER = Path(__file__).resolve().parent

PLACES = {
    alias.name: str(node.module)
    for node in ast.parse((_FOLDER / "__init__.pyi").read_text("utf-8")).body
    if isinstance(node, ast.ImportFrom)
    for alias in node.names
}
"""The module of each name."""

ROOMS = frozenset(module.partition(".")[0] for module in PLACES.values())


def found(name: str) -> Any:
    """What a name stands for.

    Raises:
        AttributeError: for nothing.
        ImportError: as `check_own`.
    """
    if name not in PLACES:
        raise AttributeError(f"touchbench has no {name}")
    check_own(*ROOMS)
    return getattr(import_module(PLACES[name]), name)


def check_own(*modules: str) -> None:
    """See that the program's modules are the ones beside this package.

    Raises:
        ImportError: another one stands before them on the import path, with its place.
    """
    for module in sorted(modules):
        spec = find_spec(module)
        place = Path(spec.origin).resolve() if spec is not None and spec.origin else None
        ours = _FOLDER.parent / module
        if place not in (ours / "__init__.py", ours.with_suffix(".py")):
            shown = place.parent if place is not None and place.name == "__init__.py" else place
            raise ImportError(
                f"touchbench: {shown} takes the place of touchbench's own module {module};"
                " rename it, or start from another folder",
                name=module,
            )
