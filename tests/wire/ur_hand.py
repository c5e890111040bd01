"""A hand on an arm: the real driver with its client, on an emulated controller."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.core.messages import Command, Lost, SampleBlock, Status
from drivers.ur_arm.driver import UrArm
from drivers.ur_arm.settings import UrArmSettings
from tests.wire.emulated_ur import EmulatedUr

FORCE, POSITION = "arm.force", "arm.position"


def settings(emulated: EmulatedUr, **changes: Any) -> UrArmSettings:
    given = {
        "host": emulated.host,
        "start_pose": emulated.order()["pose"],
        "travel_min_m": -0.04,
        "travel_max_m": 0.04,
        "open_timeout_s": 15.0,
        "realtime_priority": 0,
        **changes,
    }
    return UrArmSettings.model_validate(given)


class Hand:
    """Drives an arm as the loop does: one thread, no waiting inside the driver."""

    def __init__(self, emulated: EmulatedUr, **changes: Any) -> None:
        self.emulated = emulated
        self.arm = UrArm("arm", settings(emulated, **changes), emulated.clock)
        self.clock = emulated.clock
        self.info = self.arm.open()
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def turn(self) -> None:
        self.blocks += self.arm.read()
        self.statuses += self.arm.poll()
        self.clock.rest(0.002)

    def run(self, duration_s: float) -> None:
        end_s = self.clock.monotonic_s() + duration_s
        while self.clock.monotonic_s() < end_s:
            self.turn()

    def await_(self, kind: type[Status], reason: str = "", timeout_s: float = 10.0) -> Any:
        """The next status of a kind, and of a reason where others may come before it."""
        seen = len(self.statuses)
        end_s = self.clock.monotonic_s() + timeout_s
        while self.clock.monotonic_s() < end_s:
            self.turn()
            for status in self.statuses[seen:]:
                if isinstance(status, kind) and reason in getattr(status, "reason", ""):
                    return status
        pytest.fail(
            f"no {kind.__name__} {reason} in {[status for status in self.statuses if not isinstance(status, Lost)]}"
        )

    def do(self, command: Command, kind: type[Status]) -> Any:
        """Apply, and wait for what comes of it."""
        self.arm.apply(command)
        return self.await_(kind)

    def set_out(self, command: Command, before_m: float = 0.003) -> None:
        """Apply, and wait until the tool is well on its way."""
        start = np.array(self.emulated.order()["pose"][:3])

        def well_on_its_way(state: dict[str, Any]) -> bool:
            self.turn()
            return bool(np.linalg.norm(np.array(state["pose"][:3]) - start) > before_m)

        self.arm.apply(command)
        self.emulated.until(well_on_its_way)
        self.run(0.02)


def child(hand: Hand) -> int:
    """The process that holds the client: the one child of this process that runs its module."""
    found = [
        int(pid)
        for pid in (entry.name for entry in Path("/proc").iterdir())
        if pid.isdigit() and _cmdline(pid)[-2:-1] == ["drivers.arm.process"] and _parent(pid) == os.getpid()
    ]
    assert len(found) == 1
    return found[0]


def _cmdline(pid: str) -> list[str]:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(errors="replace").split("\0")[:-1]
    except OSError:
        return []


def _parent(pid: str) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])
