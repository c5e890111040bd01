"""A small table of settings classes: the profile code is tested without the program's own."""

from collections.abc import Callable
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


NAMES = {
    "driver": ("zaber_stage", "sensor_board", "ur_arm"),
    "detector": ("resonance", "resonance.paper", "level"),
    "signal": ("scaled",),
    "experiment": ("touch",),
    "plant": ("finger",),
}
MODELS: dict[str, type[Settings]] = {
    "signal": LevelSettings,
    "experiment": TouchSettings,
    "factors": TouchFactors,
    "limits": GuardSettings,
    "loop": LoopSettings,
    "plant": FingerSettings,
    "faults": FaultSettings,
}


class FakeTable:
    def names(self, part: str) -> tuple[str, ...]:
        return NAMES[part]

    def settings(self, part: str, name: str = "", port: str = "") -> type[Settings]:
        if part == "driver" and name == "ur_arm":
            return NetworkSettings
        if part == "driver":
            return StageSettings if port == "mock" else WireSettings
        if part == "detector":
            return LevelSettings if name == "level" else ResonanceSettings
        return MODELS[part]

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
