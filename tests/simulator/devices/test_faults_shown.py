"""The table of what each device can show is true: its mock asks for just these faults, its emulated twin takes them."""

import json
from contextlib import suppress
from typing import Any, get_args

import pytest

from config import assemble
from config.profile import load_profile
from config.source import ProfileError
from controller.own_modules import found
from controller.registry import KINDS, find
from controller.rig import TrialScene
from drivers.core.messages import Ask, Home, Listen, MoveTo, Release, Tone
from simulator.devices.faults import INJECTED, OF_THE_BENCH, FaultSchedule, Kind
from simulator.mocks.base import OverMemory

BENCH = {
    "zaber_stage": "mock/transient",
    "sensor_board": "mock/transient",
    "serial_lines": "tests/data/serial_lines.toml",
    "udp_force": "tests/data/udp_force.toml",
    "ur_arm": "mock/slip",
    "barrett_hand": "mock/slip",
    "dsa_matrix": "mock/slip",
    "audio": "mock/centering",
    "can_gripper": "mock/centering",
    "ni_daq": "tests/data/ni_daq.toml",
    "robotiq": "tests/data/robotiq.toml",
    "operator": "mock/weights",
}
SENSOR = {"barrett_hand": "barrett_finger", "dsa_matrix": "dsa"}


class Asked(FaultSchedule):
    """Nothing goes wrong; it keeps in mind which kinds are asked for."""

    kinds: set[str]

    def active(self, t_s: float, *kinds: Kind) -> bool:
        self.kinds |= set(kinds)
        return False

    def on(self, t_s: float, *kinds: Kind) -> None:
        self.kinds |= set(kinds)

    def begun(self, t_s: float, kind: Kind) -> None:
        self.kinds.add(kind)


@pytest.mark.parametrize("driver", [name for name, row in KINDS["driver"].items() if row.mock])
def test_a_mock_shows_the_faults_that_the_table_gives_it_and_no_others(driver: str) -> None:
    profile: Any = load_profile(BENCH[driver], {})
    rig = assemble.build_rig(profile)
    factors = {"sensor": SENSOR.get(driver, "fingertip")}
    rig.begin_trial(TrialScene(1, 1, factors, profile.plant.settings.model_dump(mode="json")))
    (name,) = [name for name, entry in profile.devices.items() if entry.kind == driver]
    device: Any = rig.devices[name]
    device._faults = Asked()
    device._faults.kinds = set()
    device.apply(Listen(name, frozenset(device.open().streams)))
    orders = (
        Home(name),
        MoveTo(name, 0.001, 0.001),
        Release(name, 0.01),
        Tone(name, 4e4, 0.1),
        Ask(name, "go"),
    )
    for order in orders:
        with suppress(Exception):
            device.apply(order)
        rig.clock.wait_until(rig.clock.now() + 2.0)
        device.read()
        device.poll()
    # a line asks for all of these, whatever is at its end
    either = {*INJECTED} if isinstance(device, OverMemory) else set()
    assert device._faults.kinds - either == set(KINDS["driver"][driver].mock_faults) - either - {"nan"}


TWINS = [name for name in BENCH if KINDS["driver"][name].emulated]


@pytest.mark.parametrize("driver", TWINS)
def test_an_emulated_twin_takes_the_faults_of_its_own_that_the_table_gives_it_and_no_others(
    driver: str,
) -> None:
    profile: Any = load_profile(BENCH[driver], {})
    (mock,) = [one.settings for one in profile.devices.values() if one.kind == driver]
    real = find("driver", driver).settings
    address = dict.fromkeys({"port", "host"} & real.model_fields.keys(), "emulated")
    shared = mock.model_dump(mode="json", include=set(real.model_fields))
    settings = real.model_validate_json(json.dumps({**shared, **address}))
    made = found(KINDS["driver"][driver].emulated)
    device = made(settings, profile.plant.made(profile.plant.settings))
    own = set()
    for kind in INJECTED:
        with suppress(ValueError):
            device.inject(kind, 0.0)
            own.add(kind)
    assert own == set(KINDS["driver"][driver].emulated_faults) & {*INJECTED}


def test_every_kind_can_be_shown_and_no_other_is_in_the_table() -> None:
    rows = KINDS["driver"].values()
    shown = {kind for row in rows for kind in (*row.faults("mock"), *row.faults("emulated"))}
    assert shown | {kind for kinds in OF_THE_BENCH.values() for kind in kinds} == set(get_args(Kind))


@pytest.mark.parametrize(("device", "kind", "there"), [("disk", "slow", True), ("loop", "hang", False)])
def test_of_what_is_no_device_only_the_disk_is_wrong_beside_an_emulated_bench(
    device: str, kind: str, there: bool
) -> None:
    faults = {"faults": f'[{{ device = "{device}", kind = "{kind}" }}]'}
    if there:
        (fault,) = load_profile("emulated/static", faults).faults
        assert (fault.device, fault.kind) == (device, kind)
    else:
        with pytest.raises(ProfileError, match="on the mock bench alone"):
            load_profile("emulated/static", faults)
