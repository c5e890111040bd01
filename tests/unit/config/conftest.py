"""Small profiles, and those that are shipped."""

import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from config.profile import load_profile
from controller import registry
from tests.unit.config import touch_bench

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
def write(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str, str], str]:
    """Writes a file into the present folder, which holds `bench.toml` and the sound profile `touch.toml`."""
    for family, rows in touch_bench.KINDS.items():
        monkeypatch.setitem(registry.KINDS, family, rows)
    for part, settings in touch_bench.PARTS.items():
        monkeypatch.setitem(registry.PARTS, part, settings)
    monkeypatch.chdir(tmp_path)

    def write_file(name: str, text: str) -> str:
        (tmp_path / name).write_text(text, encoding="utf-8")
        return name

    write_file("bench.toml", BENCH)
    write_file("touch.toml", TOUCH)
    return write_file


def loaded(name: str, overrides: Mapping[str, str] | None = None) -> Any:
    """A profile whose sections have the types that it gives them."""
    return load_profile(name, overrides)


COMPARED = {"microstep_m", "travel_m", "tcp_offset", "payload_kg", "payload_cog_m"}
"""Settings of stage and arm that the real device is held against at opening."""


def on_the_mock_bench(devices: Mapping[str, Mapping[str, Any]]) -> dict[str, dict[str, Any]]:
    """The devices with the mock bench's ports, and without what a real device is held against."""
    own = {name: {key: device[key] for key in device.keys() - COMPARED} for name, device in devices.items()}
    return {name: {**device, "port": "mock"} for name, device in own.items()}


PLAIN = {
    "port": "/dev/nowhere",
    "tcp_offset": [0.0, 0.0, 0.1, 0.0, 0.0, 0.0],
    "payload_kg": 1.0,
    "payload_cog_m": [0.0, 0.0, 0.05],
    "microstep_m": 0.49609375e-6,
    "travel_m": 0.0254,
}
"""Values of a lab for what the simulation has none of."""


def lab_values(name: str) -> dict[str, str]:
    """Values for all that a hardware profile leaves to the lab, as `--set` takes them; its ports lead nowhere."""
    profile = load_profile(name)
    found = {}
    for path in profile.source.unset:
        place: Any = profile.resolved
        for key in path:
            place = place[key]
        value = PLAIN.get(path[-1], place)
        found[".".join(path)] = json.dumps(f"{value}/{path[1]}" if path[-1] == "port" else value)
    return found
