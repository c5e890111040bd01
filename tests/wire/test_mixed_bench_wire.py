"""A real port beside emulated devices: its samples have their true times, whatever the bench waits for."""

import select
import shutil
import threading
import time
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from config.assemble import build_rig
from config.profile import Profile, load_profile
from config.verbs import real_time
from drivers.core.clock import WallClock
from drivers.core.errors import RefusedError
from drivers.core.messages import Listen
from simulator.devices.faults import FaultSchedule
from simulator.wiring.far_ends import Line
from tests.contracts.test_a_new_sensor import Weighed
from tests.data.force_sensor.device import EmulatedForceSensor

PROFILE = """
extends = "emulated/transient"

[devices.scale]
driver = "my_lab.device:ForceSensor"
port = "PORT"
"""

HELD_S = 0.4
"""How long a thread that takes part in the bench's time is late: less than the bench would wait for it."""


@pytest.fixture
def port() -> Iterator[str]:
    """A sensor on a pty, on the wall clock as a real one is."""
    line, clock, ended = Line(EmulatedForceSensor(None, Weighed())), WallClock(), threading.Event()
    line.open(FaultSchedule(), clock)

    def serve() -> None:
        while not ended.is_set():
            ready = select.select(line.waited(), [], [], 0.002)[0]
            line.exchange(ready, clock.now(), clock.now())
        line.unplug()

    thread = threading.Thread(target=serve)
    thread.start()
    yield line.endpoint["port"]
    ended.set()
    thread.join()


def mixed(port: str, folder: Path) -> Profile:
    shutil.copytree("tests/data/force_sensor", folder / "my_lab")
    (folder / "mixed.toml").write_text(PROFILE.replace("PORT", port))
    return load_profile(str(folder / "mixed.toml"), {})


def test_beside_a_real_port_time_waits_for_nobody_and_dates_its_samples_right(
    port: str, tmp_path: Path
) -> None:
    profile = mixed(port, tmp_path)
    assert f"scale at {port}" in real_time(profile)
    with closing(build_rig(profile)) as rig:
        assert rig.time == "wall"
        scale, blocks = rig.devices["scale"], []
        scale.open()
        scale.apply(Listen("scale", frozenset({"scale.force"})))
        rig.account()  # it serves
        ahead_s = []
        for _ in range(4):
            until_s = time.monotonic() + 0.4
            while time.monotonic() < until_s:
                rig.clock.rest(0.005)
                blocks = [*blocks, *scale.read()]
            rig.clock.hold(rig.clock.monotonic_s())
            time.sleep(HELD_S)
            before_s, bench_s, after_s = time.monotonic(), rig.clock.monotonic_s(), time.monotonic()
            ahead_s.append((bench_s - after_s, bench_s - before_s))
        blocks += scale.read()
        scale.close()
    least_s, most_s = zip(*ahead_s, strict=True)
    assert max(least_s) <= min(most_s) + 1e-6, "bench time passes as the wall's"
    # In the first second the clocks' difference is still being learnt.
    dated = [(block.device_t0_s, block.t0_s) for block in blocks if block.device_t0_s is not None]
    begin_s = dated[0][0] + 1.0
    settled_s = [t0_s - device_s for device_s, t0_s in dated if device_s > begin_s]
    assert dated[-1][0] - dated[0][0] > 4 * HELD_S
    assert max(settled_s) - min(settled_s) < 0.05


def test_an_emulator_that_runs_and_may_pause_is_not_joined_beside_a_real_port(tmp_path: Path) -> None:
    endpoints = {"control": {"host": "127.0.0.1", "port": 1}, "devices": {}, "clock": "", "realtime": False}
    with pytest.raises(RefusedError, match=r"^emulator: .* scale, at a real port, .*emulate .* --realtime$"):
        build_rig(mixed("/dev/ttyUSB9", tmp_path), endpoints)
