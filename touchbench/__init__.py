"""What scripts and classes of your own import: runs, settings, messages, detectors, behaviors, drivers.

`from touchbench import run_trials, open_run, Detector, Behavior`. The names are those in `__init__.pyi`; modules
beneath may move, these stay. It is a package because a checker looks for `py.typed` in packages alone (PEP 561).
"""

from typing import Any

from touchbench.lookup import PLACES, found

__all__ = [*PLACES]  # noqa: PLE0604


def __getattr__(name: str) -> Any:
    return found(name)


def __dir__() -> list[str]:
    return sorted(PLACES)
