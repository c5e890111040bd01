"""A small table of settings classes: the profile code is tested without the program's own."""

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import pytest
from pydantic import Field

from drivers.settings import DeviceName, Settings, StreamName
from tests.unit.config.touch_factors import TouchFactors


class StageSettings(Settings):
    travel_m: float = Field(default=0.02, gt=0.0, le=1.0)


class WireSettings(Settings):
    baud: int = Field(default=115200, ge=1200)


class NetworkSettings(Settings):
    host: str = Field(min_length=1)
    patience_s: float = 1.0


class ResonanceSettings(Settings):
    input: StreamName = "stage.position"
    average_samples: int = Field(default=10, ge=1)
    threshold_sigma: float = Field(default=3.0, gt=0.0, le=100.0)
    sample_hz: float = Field(default=15.0, gt=0.0, le=1000.0)


class LevelSettings(Settings):
    input: StreamName = "stage.position"
    gamma: float = 3.0


class TouchSettings(Settings):
    mover: DeviceName = "stage"
    measures: tuple[StreamName, ...] = ("stage.position",)
    settle_s: float = Field(default=90.0, ge=0.0)
    direction: Literal["forward", "backward"] = "forward"
    ready: bool = True


class GuardSettings(Settings):
    force_n: float = Field(default=2.0, gt=0.0, le=10.0)


class LoopSettings(Settings):
    rate_hz: float | None = 200.0


class FingerSettings(Settings):
    noise_scale: float = Field(default=1.0, ge=0.0)


class FaultSettings(Settings):
    device: DeviceName
    kind: Literal["unplug", "stall"]
    at_s: float = Field(ge=0.0)


@dataclass(frozen=True)
class FakeTable:
    drivers: tuple[str, ...] = ("zaber_stage", "sensor_board", "ur_arm")
    detectors: tuple[str, ...] = ("resonance", "resonance.paper", "level")
    signals: tuple[str, ...] = ("scaled",)
    experiments: tuple[str, ...] = ("touch",)
    plants: tuple[str, ...] = ("finger",)

    def driver_settings(self, driver: str, port: str) -> type[Settings]:
        if driver == "ur_arm":
            return NetworkSettings
        return StageSettings if port == "mock" else WireSettings

    def detector_settings(self, kind: str) -> type[Settings]:
        return LevelSettings if kind == "level" else ResonanceSettings

    def signal_settings(self, kind: str) -> type[Settings]:
        return LevelSettings

    def behavior_settings(self, experiment: str) -> type[Settings]:
        return TouchSettings

    def factor_settings(self, experiment: str) -> type[Settings]:
        return TouchFactors

    def guard_settings(self) -> type[Settings]:
        return GuardSettings

    def loop_settings(self) -> type[Settings]:
        return LoopSettings

    def plant_settings(self, kind: str) -> type[Settings]:
        return FingerSettings

    def fault_settings(self) -> type[Settings]:
        return FaultSettings

    def faults_of(self, driver: str, port: str) -> tuple[str, ...]:
        return ("unplug", "stall") if port == "mock" and driver == "zaber_stage" else ("unplug",)


BENCH = """
[devices.stage]
driver = "zaber_stage"
port = "mock"

[limits]
force_n = 2.0

[plant]
kind = "finger"
"""

TOUCH = """
extends = "bench"
experiment = "touch"
title = "A touch"

[detectors.contact]
kind = "resonance.paper"
threshold_sigma = 3.0

[trials]
list = [{ speed_m_s = 0.004 }]
"""


@pytest.fixture
def table() -> FakeTable:
    return FakeTable()


@pytest.fixture
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], str]:
    """Writes a file into the present folder, which holds `bench.toml` and the sound profile `touch.toml`."""
    monkeypatch.chdir(tmp_path)

    def write_file(name: str, text: str) -> str:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return name

    write_file("bench.toml", BENCH)
    write_file("touch.toml", TOUCH)
    return write_file
