"""The five sensors of Fernandez et al. as settings of the plant, by name; each number's source is in the table."""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from pathlib import Path

from simulator.physics.slip import SlipPlantSettings

SENSORS: Mapping[str, SlipPlantSettings] = {
    name: SlipPlantSettings.model_validate(row, strict=False)
    for name, row in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items()
}
