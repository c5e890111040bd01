"""Gripper, hand and matrices on the benches that have them: the real drivers, over ptys, to one emulator's process."""

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from drivers.barrett_hand.driver import BarrettHand, BarrettHandSettings
from drivers.can_gripper.driver import CanGripper, CanGripperSettings
from drivers.core.errors import RefusedError
from drivers.core.messages import Command, Grip, Gripped, Home, Listen, Reached, SampleBlock
from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from simulator.wiring.bench_clock import BenchClock, ClockPage
from simulator.wiring.emulator_process import EmulatorProcess

DEVICES = "simulator.devices"
BENCHES = {
    "finger": (
        "simulator.physics.finger_part:finger_bench",
        "simulator.physics.finger_part:FingerBenchSettings",
    ),
    "slip": (
        "simulator.physics.fingertip_part:slip_bench",
        "simulator.physics.fingertip_settings:SlipBenchSettings",
    ),
    "aura": ("simulator.physics.aura_part:aura_bench", "simulator.physics.gripper_part:AuraBenchSettings"),
}


@pytest.fixture
def emulator() -> Iterator[Callable[..., EmulatorProcess]]:
    running: list[EmulatorProcess] = []

    def start(bench: str, *devices: str) -> EmulatorProcess:
        made, settings = BENCHES[bench]
        plant = {"made": made, "settings_class": settings, "settings": {}}
        wired = {name: {"made": f"{DEVICES}.{name}:emulated", "settings": {}} for name in devices}
        running.append(EmulatorProcess({"plant": plant, "devices": wired, "faults": []}))
        return running[-1]

    yield start
    for one in running:
        one.close()


def clock_of(emulator: EmulatorProcess) -> BenchClock:
    """The bench's own: it waits for a machine that is busy."""
    return BenchClock(ClockPage(emulator.endpoints["clock"]))


def await_(
    device: Any, clock: BenchClock, found: Callable[[list[Any]], bool], timeout_s: float = 15.0
) -> list[Any]:
    """Blocks and statuses until they are as wanted."""
    received: list[Any] = []
    end_s = clock.monotonic_s() + timeout_s
    while clock.monotonic_s() < end_s:
        received += [*device.read(), *device.poll()]
        if found(received):
            return received
        clock.rest(0.005)
    raise AssertionError(f"it never came: {received[-5:]}")


def do(device: Any, clock: BenchClock, command: Command, kind: type) -> Any:
    device.apply(command)
    return await_(device, clock, lambda received: isinstance(received[-1:] and received[-1], kind))[-1]


def test_the_gripper_on_the_bench_s_jaws_finds_its_ends_and_goes_to_a_width(emulator) -> None:
    started = emulator("aura", "can_gripper")
    port = started.endpoints["devices"]["can_gripper"]["port"]
    clock = clock_of(started)
    gripper = CanGripper("gripper", CanGripperSettings(port=port, closed_width_m=0.015), clock)
    gripper.open()
    try:
        do(gripper, clock, Home("gripper"), Reached)
        # 55 mm, wider than the pipe that may stand between the fingers.
        gripped = do(gripper, clock, Grip("gripper", 0.055, 0.05, 10.0), Gripped)
        assert gripped.width_m == pytest.approx(0.055, abs=5e-4)
        assert started.scene()["width_m"] == pytest.approx(gripped.width_m, abs=5e-4)
    finally:
        gripper.close()


def test_hand_and_matrices_on_the_slip_bench_are_sampled(emulator) -> None:
    started = emulator("slip", "barrett_hand", "dsa_matrix")
    devices, clock = started.endpoints["devices"], clock_of(started)
    hand = BarrettHand("hand", BarrettHandSettings(port=devices["barrett_hand"]["port"]), clock)
    matrix = DsaMatrix("matrix", DsaMatrixSettings(port=devices["dsa_matrix"]["port"]), clock)
    for device, stream in ((hand, "hand.strain_11"), (matrix, "matrix.taxels")):
        assert stream in device.open().streams
        try:
            device.apply(Listen(device.name, frozenset({stream})))
            received = await_(
                device, clock, lambda received: sum(isinstance(one, SampleBlock) for one in received) >= 3
            )
            values = np.concatenate([one.physical for one in received if isinstance(one, SampleBlock)])
            assert values.shape[1] == (1 if device is hand else 70)
            # Nothing touches: no more than noise, in N and in V.
            assert np.abs(values - np.median(values, axis=0)).max() < 1.0
        finally:
            device.close()


@pytest.mark.parametrize("device", ["can_gripper", "barrett_hand", "dsa_matrix"])
def test_a_bench_without_the_part_is_refused_in_one_line(emulator, device: str) -> None:
    with pytest.raises(RefusedError, match="this bench does not have") as caught:
        emulator("finger", device)
    assert "\n" not in str(caught.value)
