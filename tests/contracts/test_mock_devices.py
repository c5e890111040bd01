"""The mock drivers keep the devices' promises, in virtual time."""

import pytest

from config.assemble import build_rig
from config.profile import load_profile
from controller.rig import TrialScene
from tests.contracts.device_suite import Bench, DeviceContract


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
