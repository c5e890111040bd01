"""What a profile is made of, and the lookup of the class that validates each part."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

from drivers.settings import Settings


class SettingsTable(Protocol):
    """Which settings class validates what: the side of `config.assemble` that a profile sees."""

    def names(self, part: str) -> Collection[str]:
        """What there is of a `driver`, `detector`, `signal`, `experiment` or `plant`."""

    def settings(self, part: str, name: str = "", port: str = "") -> type[Settings]:
        """Settings of one of these, of a trial's `factors` in an experiment, or of `limits`, `loop` or `faults`.

        Args:
            part: Which.
            name: One that `names` holds, or a class of the user's own.
            port: Of a driver: distinguishes mock from wire.
        """

    def faults_of(self, driver: str, port: str) -> Collection[str]:
        """Kinds of faults that a driver's simulated device can show; the port distinguishes mock from emulated."""


@dataclass(frozen=True)
class DeviceEntry:
    """One device: which driver, where, with which settings."""

    driver: str
    port: str
    settings: Settings


@dataclass(frozen=True)
class Entry:
    """A detector, a signal or the physics of a simulated bench: of which kind, with which settings."""

    kind: str
    settings: Settings
