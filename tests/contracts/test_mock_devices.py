"""The mock drivers keep the devices' promises, in virtual time; the devices of the slip bench together."""

from contextlib import closing
from typing import Any

import numpy as np
import pytest

from config.assemble import build_rig
from config.profile import load_profile
from controller.contracts import tried
from controller.registry import KINDS
from controller.rig import TrialScene
from drivers.core.messages import Home, Listen, MoveAt, Reached, Tare, Twist
from tests.contracts.device_suite import Bench, DeviceContract
from tests.simulator.devices.test_faults_shown import BENCH, SENSOR


class _MockBench:
    profile = "mock/transient"

    @pytest.fixture
    def bench(self):
        profile = load_profile(self.profile, {})
        rig = build_rig(profile)
        rig.begin_trial(TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json")))
        opened = Bench(rig)
        yield opened
        opened.close()


class TestMockDevices(_MockBench, DeviceContract):
    pass


class TestMockArm(_MockBench, DeviceContract):
    profile = "mock/transient_arm"
    mover = "arm"


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


STREAMS = ("board.fingertip", "board.flexible", "hand.strain_11", "matrix.taxels", "arm.force")


def listening(sensor, streams=STREAMS):
    profile = load_profile("mock/slip", {})
    rig = build_rig(profile)
    plant = profile.plant.settings.model_dump(mode="json")
    rig.begin_trial(TrialScene(1, 1, {"sensor": sensor}, plant))
    bench = Bench(rig)
    bench.apply(Home("arm"))
    bench.until(Reached, "arm")
    for device in ("board", "hand", "matrix", "arm"):
        bench.apply(Listen(device, frozenset(s for s in streams if s.startswith(f"{device}."))))
    return bench


@pytest.mark.parametrize("sensor", ["fingertip", "flexible_finger", "barrett_finger", "wrist", "dsa"])
def test_pressed_and_dragged_the_sensor_at_the_tip_and_the_arm_feel_it(sensor):
    bench = listening(sensor)
    bench.apply(MoveAt("arm", 0.005, 0.004))
    bench.until(Reached, "arm")
    bench.apply(Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0))
    bench.until(Reached, "arm")
    dragged = {stream: bench.values(stream)[-20:] for stream in STREAMS}
    normal_n = 50.0 if sensor == "wrist" else 5.0
    assert dragged["arm.force"][:, 2].mean() == pytest.approx(normal_n, rel=0.1)
    # friction 0.2 while it slides; at rest again a stiff tip may have sprung back
    sliding = bench.values("arm.force")[-300:-60, 0]
    assert sliding.mean() == pytest.approx(-0.2 * normal_n, rel=0.15)
    felt = {
        "fingertip": dragged["board.fingertip"][:, 2].mean() / 1.0291,
        "flexible_finger": dragged["board.flexible"].mean() / 0.32,
        "barrett_finger": dragged["hand.strain_11"].mean(),
        "dsa": dragged["matrix.taxels"][:, 2::5].max() / 2.2,
    }
    for name, force_n in felt.items():
        assert force_n == pytest.approx(1.0 if name == sensor else 0.0, abs=0.35), name
    bench.close()


def test_a_tared_board_stream_reads_zero_on_every_channel():
    bench = listening("fingertip")
    bench.apply(MoveAt("arm", 0.005, 0.004))
    bench.until(Reached, "arm")
    bench.turn(0.2)
    assert bench.values("board.fingertip")[-50:, 1].mean() > 0.1
    bench.apply(Tare("board", "board.fingertip"))
    bench.turn(0.2)
    assert np.abs(bench.values("board.fingertip")[-50:].mean(axis=0)).max() < 0.01
    bench.close()
