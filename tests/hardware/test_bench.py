"""The real bench, by invitation: TOUCHBENCH_PROFILE=hardware/transient .venv/bin/python -m pytest tests/hardware."""

import os

import pytest

from config.assemble import build_rig
from config.profile import load_profile
from controller.doctor import examine
from controller.rig import TrialScene


@pytest.mark.hardware
def test_every_device_of_the_bench_answers_and_every_sensor_sends():
    rig = build_rig(load_profile(os.environ["TOUCHBENCH_PROFILE"], {}))
    try:
        findings = list(examine(rig, TrialScene(0, 0, {})))
    finally:
        rig.close()
    assert all(finding.verdict != "fail" for finding in findings), "\n".join(
        finding.line for finding in findings
    )
