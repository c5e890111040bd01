"""The real drivers keep the devices' promises, over ptys to emulated devices in another process."""

import pytest

from config.assemble import Table, build_rig
from config.profile import load_profile
from controller.rig import TrialScene
from tests.contracts.device_suite import Bench, DeviceContract


@pytest.fixture
def bench():
    profile = load_profile("emulated/transient", {}, table=Table())
    rig = build_rig(profile)
    try:
        rig.clock.restart()
        rig.begin_trial(TrialScene(1, 1, {}, profile.plant.settings.model_dump(mode="json")))
        opened = Bench(rig)
    except BaseException:
        rig.close()
        raise
    yield opened
    opened.close()


class TestWireDevices(DeviceContract):
    pass
