"""The real gripper driver with real python-can: slcan on a pty, an emulated gripper at its far end."""

from collections.abc import Callable

from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.messages import Gripped, Stalled
from simulator.devices.can_gripper import EmulatedCanGripper
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import CLOSED_M, GRIP, GripperBench, calibrated_jaws
from tests.wire.conftest import Serve, Wired

PATIENT = {"reply_timeout_s": 0.2, "silence_timeout_s": 3.0, "watchdog_s": 5.0}
"""The machine may be busy with other tests."""


def test_a_host_that_hangs_loses_the_grip(serve: Serve) -> None:
    drive = calibrated_jaws()
    wired = Wired(serve, EmulatedSlcan(EmulatedCanGripper(drive)))
    settings = CanGripperSettings(port=wired.port, closed_width_m=CLOSED_M, **PATIENT)
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
