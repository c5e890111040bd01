"""Every shipped mock keeps the promises that `run.py check` tries of a user's own device."""

from contextlib import closing
from typing import Any

import pytest

from config.assemble import build_rig
from config.profile import load_profile
from controller.contracts import tried
from controller.registry import KINDS
from controller.rig import TrialScene
from tests.simulator.devices.test_faults_shown import BENCH, SENSOR


@pytest.mark.parametrize("driver", [name for name, row in KINDS["driver"].items() if row.mock])
def test_a_shipped_mock_keeps_the_contract(driver: str) -> None:
    profile: Any = load_profile(BENCH[driver], {})
    (name,) = [name for name, entry in profile.devices.items() if entry.kind == driver]
    factors = {"sensor": SENSOR.get(driver, "fingertip")}
    scene = TrialScene(1, 1, factors, profile.plant.settings.model_dump(mode="json"))
    with closing(build_rig(profile)) as rig:
        findings = list(tried(rig, scene, [name], {}, {}, {}, {}))
    assert [finding.line for finding in findings if finding.verdict != "ok"] == []
    assert f"devices.{name}: keeps the contract" in findings[-1].line
