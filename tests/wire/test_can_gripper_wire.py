"""The real gripper driver with real python-can: slcan on a pty, an emulated gripper at its far end."""

import threading
import time
from collections.abc import Callable

from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import CanPort, open_can
from drivers.core.clock import WallClock
from drivers.core.messages import Grip, Gripped, Stalled
from simulator.devices.can_gripper import EmulatedCanGripper, EmulatedCanGripperSettings
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import GRIP, SCENE, GripperBench, calibrated_jaws
from tests.wire.conftest import Serve, Wired

PATIENT = {"reply_timeout_s": 0.2, "silence_timeout_s": 3.0, "watchdog_s": 5.0}
"""The machine may be busy with other tests."""


def test_a_host_that_hangs_loses_the_grip(serve: Serve) -> None:
    drive = calibrated_jaws()
    wired = Wired(serve, EmulatedSlcan(EmulatedCanGripper(EmulatedCanGripperSettings(), drive)))
    settings = CanGripperSettings(port=wired.port, closed_width_m=SCENE.closed_width_m, **PATIENT)
    driver = CanGripper("gripper", settings.model_copy(update={"watchdog_s": 0.7}), wired.clock)

    def change(scene: Callable[[JawsDrive], object]) -> None:
        with wired.lock:
            scene(drive)

    bench = GripperBench(driver, wired.clock, change)
    try:
        bench.place("mug")
        bench.device.apply(GRIP)
        assert bench.until(Gripped).object
        serve.clock.rest(1.2)
        assert bench.force_n() < 1.0
        assert "watchdog" in bench.until(Stalled).reason
    finally:
        driver.close()


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
