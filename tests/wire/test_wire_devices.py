"""The real drivers keep the devices' promises, over ptys and loopback to emulated devices in another process."""

import pytest

from config.assemble import build_rig, start_emulator
from config.profile import load_profile
from controller.rig import TrialScene
from drivers.core.messages import Excite, Listen, Standstill, Stop
from tests.contracts.device_suite import Bench, DeviceContract


class _WireBench(DeviceContract):
    profile = "emulated/transient"

    @pytest.fixture(scope="class")
    @classmethod
    def opened(cls):
        """Open for all tests of a class, of which the last one closes it; how it begins a trial."""
        profile = load_profile(cls.profile)
        emulator = start_emulator(profile)
        rig = build_rig(profile, emulator.endpoints)
        scene = TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json"))
        rig.begin_trial(scene)
        try:
            bench = Bench(rig)
            yield bench, scene
            bench.close()
        finally:
            rig.close()
            emulator.close()

    @pytest.fixture
    def bench(self, opened):
        """At the beginning of a trial, with nothing subscribed and nothing moving."""
        bench, scene = opened
        for command in (*(Listen(name, frozenset()) for name in bench.infos), Stop(self.mover)):
            bench.apply(command)
        bench.apply(Excite("board", False))
        bench.until(Standstill, self.mover)
        bench.turn(0.1)
        bench.blocks.clear()
        bench.statuses.clear()
        bench.rig.clock.restart()
        bench.rig.begin_trial(scene)
        return bench


class TestWireDevices(_WireBench):
    pass


class TestWireArm(_WireBench):
    profile = "emulated/transient_arm"
    mover = "arm"
    reach_m = 1e-4  # `MoveAt` is content 50 um before its limit
