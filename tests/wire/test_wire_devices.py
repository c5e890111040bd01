"""The real drivers keep the devices' promises, over ptys and loopback to emulated devices in another process."""

import pytest

from config.assemble import build_rig, start_emulator
from config.profile import load_profile
from controller.rig import TrialScene
from tests.contracts.device_suite import Bench, DeviceContract


class _WireBench:
    profile = "emulated/transient"

    @pytest.fixture(scope="class")
    @classmethod
    def emulator(cls):
        """One for all tests, as a real bench is: each finds the devices as the one before it closed them."""
        emulator = start_emulator(load_profile(cls.profile))
        yield emulator
        emulator.close()

    @pytest.fixture
    def bench(self, emulator):
        profile = load_profile(self.profile)
        rig = build_rig(profile, emulator.endpoints)
        try:
            rig.clock.restart()
            rig.begin_trial(TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json")))
            opened = Bench(rig)
        except BaseException:
            rig.close()
            raise
        yield opened
        opened.close()


class TestWireDevices(_WireBench, DeviceContract):
    pass


class TestWireArm(_WireBench, DeviceContract):
    profile = "emulated/transient_arm"
    mover = "arm"
    reach_m = 1e-4  # `MoveAt` is content 50 um before its limit
