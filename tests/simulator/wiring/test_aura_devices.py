"""Arm, gripper and sound card of the mock bench around one aura: what each does shows in the others."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.messages import (
    Chirp,
    Command,
    Grip,
    Gripped,
    Home,
    Listen,
    MovePose,
    Reached,
    Release,
    Status,
    Tone,
)
from simulator.mocks.audio import MockAudio, MockAudioSettings
from simulator.mocks.can_gripper import MockCanGripper, MockCanGripperSettings
from simulator.mocks.ur_arm import MockUrArm, MockUrArmSettings
from simulator.physics.aura_part import aura_bench
from simulator.physics.gripper_part import AuraBenchSettings

ARM = {
    "host": "mock",
    "start_pose": (0.4, -0.1333, 0.35, 0.0, 3.1416, 0.0),
    "approach_axis": (1.0, 0.0, 0.0),
    "travel_min_m": -0.035,
    "travel_max_m": 0.06,
    "max_speed_m_s": 0.06,
}
STREAMS = {
    "arm": frozenset({"arm.force"}),
    "gripper": frozenset({"gripper.width"}),
    "audio": frozenset({"audio.fingers"}),
}


class Bench:
    """Three devices, turned at a cadence of its own; a command goes out when the one before it is answered."""

    def __init__(self, turn_s: float, **about: Any) -> None:
        settings = AuraBenchSettings(**about)
        self.clock = VirtualClock()
        self.bench = aura_bench(settings)
        self.devices: dict[str, Any] = {
            "arm": MockUrArm("arm", MockUrArmSettings(**ARM), self.clock, self.bench),
            "gripper": MockCanGripper("gripper", MockCanGripperSettings(), self.clock, self.bench),
            "audio": MockAudio("audio", MockAudioSettings(), self.clock, self.bench),
        }
        self.bench.restart()
        self.bench.begin(0.0, 3, 1, {}, settings.model_dump(mode="json"))
        for device in self.devices.values():
            device.restart()
            device.open()
        self.samples: list[np.ndarray] = []
        self.statuses: list[Status] = []
        self._turn_s = turn_s

    def listen(self) -> None:
        """Subscribe to all streams from now on."""
        for name, device in self.devices.items():
            device.apply(Listen(name, STREAMS[name]))

    def until(self, t_s: float, *commands: Command) -> None:
        """Give commands now, and let time pass."""
        for command in commands:
            self.devices[command.device].apply(command)
        while self.clock.now() < t_s:
            self.clock.wait_until(min(t_s, self.clock.now() + self._turn_s))
            for device in self.devices.values():
                self.samples += [b.values for b in device.read() if b.stream == "audio.fingers"]
                self.statuses += device.poll()

    def answers(self, kind: type[Status], device: str) -> Sequence[Any]:
        """Statuses of one kind from one device."""
        return [status for status in self.statuses if type(status) is kind and status.device == device]


def grasp(turn_s: float) -> Bench:
    """Find the ends above the pipe, come down over it, listen, close on it."""
    bench = Bench(turn_s, object_x_m=0.004)
    above, down = (0.0, 0.0, 0.1, 0.0, 0.0, 0.0), (0.0, 0.0, 0.0, 0.0, 0.0, 0.0)
    bench.until(4.0, MovePose("arm", above, 0.05))
    bench.until(12.0, Home("gripper"))
    bench.until(16.0, Release("gripper", 0.05))
    bench.until(20.0, Tone("audio", 40_000.0, 0.5), MovePose("arm", down, 0.05))
    bench.listen()
    bench.until(23.0, Grip("gripper", 0.016, 0.02, 10.0))
    return bench


def test_a_grasp_is_felt_by_both_fingers_one_after_the_other() -> None:
    bench = grasp(0.05)
    assert len(bench.answers(Reached, "arm")) == 2
    gripped = bench.answers(Gripped, "gripper")
    assert [status.object for status in gripped] == [True]
    right, left = bench.bench.finger_contacts
    assert [made for _, made in right] == [made for _, made in left] == [True]
    # the pipe stands 4 mm on the right finger's side of the middle: that finger pushes it there first
    assert right[0][0] < left[0][0]
    assert bench.bench.contacts == [right[0], left[0]]
    z = np.concatenate(bench.samples)
    assert z.shape == (3000, 4)
    before, after = z[:500].mean(axis=0), z[-500:].mean(axis=0)
    for finger in (0, 2):
        assert np.hypot(*(after - before)[finger : finger + 2]) > 0.01


@pytest.mark.parametrize("turn_s", [0.004, 0.0173, 0.5])
def test_the_cadence_of_turns_changes_no_sample(turn_s: float) -> None:
    expected, found = grasp(0.05), grasp(turn_s)
    assert (np.concatenate(found.samples) == np.concatenate(expected.samples)).all()
    assert found.bench.contacts == expected.bench.contacts


def test_the_carrier_comes_as_counts_at_96_khz() -> None:
    bench = Bench(0.02, level="carrier", scene="ahead")
    bench.until(0.5, Tone("audio", 40_000.0, 0.5))
    bench.listen()
    bench.until(0.8)
    counts = np.concatenate(bench.samples)
    assert counts.shape == (28_800, 2)
    assert counts.dtype == np.int32
    # 0.2 of imbalance at half drive, in full scales of 24 bits
    assert np.abs(counts[:, 0]).max() == pytest.approx(0.1 * 2**23, rel=0.05)


def test_a_sweep_comes_back_loudest_at_40_khz_and_is_answered_at_its_end() -> None:
    bench = Bench(0.02, level="carrier", object="none")
    bench.listen()
    bench.until(0.1)
    bench.until(1.5, Chirp("audio", 30_000.0, 46_000.0, 1.0, 0.5))
    (reached,) = bench.answers(Reached, "audio")
    assert reached.t_s == pytest.approx(1.1, abs=0.001)
    counts = np.concatenate(bench.samples).astype(float)
    power = (counts[9600 : 9600 + 96_000] ** 2).reshape(200, 480, 2).mean(axis=1)
    middles_hz = 30_000.0 + 16_000.0 * (np.arange(200) + 0.5) / 200
    assert middles_hz[power.argmax(axis=0)] == pytest.approx([40_000.0, 40_000.0], abs=80.0)
    silence = (counts[-9600:] ** 2).mean(axis=0)
    assert (silence < 1e-4 * power.max(axis=0)).all()
