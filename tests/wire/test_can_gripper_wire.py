"""The real gripper driver with real python-can: slcan on a pty, an emulated gripper at its far end."""

import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import pytest

from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import CanPort, open_can
from drivers.core.clock import WallClock
from drivers.core.messages import Grip, Gripped, Stalled
from simulator.devices.can_gripper import EmulatedCanGripper, EmulatedCanGripperSettings
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import (
    GRIP,
    SCENE,
    FreshGripperContract,
    GripperBench,
    GripperContract,
    calibrated_jaws,
)
from tests.wire.conftest import Serve, Wired

PATIENT = {"reply_timeout_s": 0.2, "silence_timeout_s": 3.0, "watchdog_s": 5.0}
"""The machine may be busy with other tests."""


class Wire(Wired):
    """A gripper behind an adapter on a pty, and its driver."""

    def __init__(self, serve: Serve, drive: JawsDrive, hurry: bool = False, **settings: Any) -> None:
        self.drive = drive
        super().__init__(serve, EmulatedSlcan(EmulatedCanGripper(EmulatedCanGripperSettings(), drive)), hurry)
        values = {"port": self.port, "closed_width_m": SCENE.closed_width_m, **PATIENT, **settings}
        self.driver = CanGripper("gripper", CanGripperSettings(**values), self.clock)

    def change(self, scene: Callable[[JawsDrive], object]) -> None:
        with self.lock:
            scene(self.drive)

    def open(self) -> GripperBench:
        return GripperBench(self.driver, self.clock, self.change)


@pytest.fixture
def wire(serve: Any) -> Iterator[Wire]:
    made = Wire(serve, calibrated_jaws())
    yield made
    made.driver.close()


@pytest.fixture
def bench(wire: Wire) -> GripperBench:
    return wire.open()


@pytest.fixture
def fresh(serve: Any) -> Iterator[GripperBench]:
    made = Wire(serve, JawsDrive(SCENE), hurry=True)
    yield made.open()
    made.driver.close()


class TestWireGripper(GripperContract):
    pass


class TestFreshWireGripper(FreshGripperContract):
    pass


def test_a_host_that_hangs_loses_the_grip(serve: Any) -> None:
    wire = Wire(serve, calibrated_jaws(), watchdog_s=0.7)
    bench = wire.open()
    try:
        bench.place("mug")
        bench.device.apply(GRIP)
        bench.until(Gripped)
        serve.clock.rest(1.2)
        assert bench.force_n() < 1.0
        assert "watchdog" in bench.until(Stalled).reason
    finally:
        wire.driver.close()


def test_the_virtual_bus_carries_a_grip_in_one_process() -> None:
    clock = WallClock()
    drive = calibrated_jaws()
    node = EmulatedCanGripper(EmulatedCanGripperSettings(), drive)
    port = CanPort(port="bench of one gripper", interface="virtual")
    far = open_can("far end", port, clock)
    running = threading.Event()
    running.set()

    def serve_node() -> None:
        while running.is_set():
            now_s = clock.monotonic_s()
            frames: list[CanFrame] = [*node.step(now_s)]
            for received in far.receive():
                frames += node.receive(received.frame, now_s)
            for frame in frames:
                far.send(frame)
            time.sleep(0.001)

    thread = threading.Thread(target=serve_node, daemon=True)
    thread.start()
    settings = CanGripperSettings(port=port.port, interface="virtual", closed_width_m=0.020, **PATIENT)
    driver = CanGripper("gripper", settings, clock)
    bench = GripperBench(driver, clock, lambda scene: scene(drive))
    try:
        bench.device.apply(Grip("gripper", 0.060, 0.1, 20.0))
        assert not bench.until(Gripped).object
    finally:
        driver.close()
        running.clear()
        thread.join(5.0)
        far.close()
