"""A bench of the small table of classes, and a profile on it."""

from collections.abc import Callable
from pathlib import Path

import pytest

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
