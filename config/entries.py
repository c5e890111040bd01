"""What a profile is made of, and the lookup that says which class validates which part."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from typing import Protocol

from drivers.settings import Settings


class SettingsTable(Protocol):
    """Which settings class validates what: the side of `config.assemble` that a profile sees.

    The lookups are asked for names that the collections hold, and for no others.
    """

    @property
    def drivers(self) -> Collection[str]:
        """Names of drivers."""

    @property
    def detectors(self) -> Collection[str]:
        """Kinds of detectors."""

    @property
    def signals(self) -> Collection[str]:
        """Kinds of signals."""

    @property
    def experiments(self) -> Collection[str]:
        """Names of experiments."""

    @property
    def plants(self) -> Collection[str]:
        """Kinds of plants."""

    def driver_settings(self, driver: str, port: str) -> type[Settings]:
        """Settings of a device; the port tells mock from wire."""

    def detector_settings(self, kind: str) -> type[Settings]:
        """Settings of a detector."""

    def signal_settings(self, kind: str) -> type[Settings]:
        """Settings of a signal."""

    def behavior_settings(self, experiment: str) -> type[Settings]:
        """Settings of an experiment's behavior."""

    def factor_settings(self, experiment: str) -> type[Settings]:
        """What a trial of an experiment varies."""

    def guard_settings(self) -> type[Settings]:
        """Settings of the guard."""

    def loop_settings(self) -> type[Settings]:
        """Settings of the loop."""

    def plant_settings(self, kind: str) -> type[Settings]:
        """Settings of a plant."""

    def fault_settings(self) -> type[Settings]:
        """A fault of a simulated device."""

    def faults_of(self, driver: str, port: str) -> Collection[str]:
        """Kinds of faults that a driver's simulated device can show; the port tells mock from emulated."""


@dataclass(frozen=True)
class DeviceEntry:
    """One device: which driver, where, with which settings."""

    driver: str
    port: str
    settings: Settings


@dataclass(frozen=True)
class DetectorEntry:
    """One detector: of which kind, with which settings."""

    kind: str
    settings: Settings


@dataclass(frozen=True)
class SignalEntry:
    """One signal: of which kind, with which settings."""

    kind: str
    settings: Settings


@dataclass(frozen=True)
class PlantEntry:
    """The physics of a simulated bench."""

    kind: str
    settings: Settings
