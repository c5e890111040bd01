"""Whose turn it is: a test marked `alone` has the machine to itself, whatever the other workers are at."""

from __future__ import annotations

import fcntl
import os
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, settings

# An example takes as long as the machine lets it, and the examples are the same on every machine: what is searched at
# random belongs to a search, not to a verdict.
settings.register_profile(
    "touchbench", deadline=None, derandomize=True, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("touchbench")

LOCKS = Path(tempfile.gettempdir()) / f"touchbench-tests-{os.getuid()}"
"""Shared by all workers and runs of this user, for it is the same machine that they share."""


LONG = {"scenarios", "stability", "wire"}
"""Folders whose modules take long."""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Long modules begin first, so that no worker is left with one when the others have ended."""
    items.sort(key=lambda item: LONG.isdisjoint(item.path.parts))


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[None]:
    """All tests share the room, but for one that is alone in it, fixtures and all.

    A stand-alone controller of an arm takes more than one core together with its client, which spins: of two cores
    nothing is left for the program under test where another worker wants one.
    """
    LOCKS.mkdir(exist_ok=True)
    with (LOCKS / "door").open("w") as door, (LOCKS / "room").open("w") as room:
        # who waits for an empty room holds the door, or those in it would take turns for ever
        fcntl.flock(door, fcntl.LOCK_EX)
        fcntl.flock(room, fcntl.LOCK_EX if item.get_closest_marker("alone") else fcntl.LOCK_SH)
        fcntl.flock(door, fcntl.LOCK_UN)
        return (yield)
