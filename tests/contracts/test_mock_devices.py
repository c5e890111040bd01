"""The mock drivers keep the devices' promises, in virtual time."""

import pytest

from config.assemble import Table, build_rig
from config.profile import load_profile
from controller.rig import TrialScene
from tests.contracts.device_suite import Bench, DeviceContract


@pytest.fixture
def bench():
    profile = load_profile("mock/transient", {}, table=Table())
    rig = build_rig(profile)
    rig.begin_trial(TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json")))
    opened = Bench(rig)
    yield opened
    opened.close()


class TestMockDevices(DeviceContract):
    pass
