"""The mock arm: the real one's limits and messages, in virtual time, with the finger's force on its tool."""

from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import (
    Failed,
    Home,
    Listen,
    Lost,
    MoveAt,
    MoveTo,
    Reached,
    Refused,
    Stalled,
    Standstill,
    Status,
    Stop,
    Tare,
)
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.ur_arm import MockUrArm, MockUrArmSettings
from simulator.physics.finger_part import FingerBenchSettings, finger_bench
from simulator.physics.stage_axis import AxisMotion

FORCE, POSITION, POSE = "arm.force", "arm.position", "arm.pose"
START = (0.4, -0.1333, 0.25, 0.0, 3.1416, 0.0)
TURN_S = 0.005


class Hand:
    """Turns the crank, as the loop does."""

    def __init__(self, *faults: Fault, **settings: Any) -> None:
        self.bench = finger_bench(FingerBenchSettings())
        self.clock = VirtualClock()
        given = {"host": "mock", "start_pose": START, "travel_max_m": 0.02, **settings}
        self.arm = MockUrArm(
            "arm", MockUrArmSettings.model_validate(given), self.clock, self.bench, FaultSchedule(faults)
        )
        self.statuses: list[Status] = []
        self.blocks: list[Any] = []

    def run(self, seconds: float, turn_s: float = TURN_S) -> None:
        end_s = self.clock.now() + seconds
        while self.clock.now() < end_s - 1e-9:
            self.clock.wait_until(self.clock.now() + turn_s)
            self.blocks += self.arm.read()
            self.statuses += self.arm.poll()

    def only(self, kind: type[Status]) -> Any:
        (found,) = [status for status in self.statuses if isinstance(status, kind)]
        return found

    def samples(self, stream: str) -> np.ndarray:
        return np.concatenate([block.values for block in self.blocks if block.stream == stream])


def test_a_stop_brakes_at_the_arms_own_rate_and_is_reported_when_nothing_has_moved_for_a_while():
    hand = Hand(stop_m_s2=2.0)
    hand.arm.apply(MoveAt("arm", 0.01, 0.015))
    hand.run(0.5)
    before_m = hand.arm.axis.position(0.5)
    hand.arm.apply(Stop("arm"))
    hand.run(0.1)
    still = hand.only(Standstill)
    assert still.position_m - before_m == pytest.approx(0.01**2 / (2 * 2.0), abs=1e-9)
    assert still.t_s == pytest.approx(0.5 + 0.01 / 2.0 + 0.02)


def test_too_great_a_speed_is_clamped_as_the_real_driver_does():
    hand = Hand(max_speed_m_s=0.005)
    applied = hand.arm.apply(MoveTo("arm", 0.01, 0.2))
    assert applied == MoveTo("arm", 0.01, 0.005)
    hand.run(1.0)
    assert hand.arm.axis.velocity(1.0) == 0.005


def test_the_pose_is_the_position_along_the_approach_axis():
    hand = Hand()
    hand.arm.apply(Listen("arm", frozenset({POSE, POSITION})))
    hand.arm.apply(MoveTo("arm", 0.002, 0.01))
    hand.run(0.5)
    pose, position_m = hand.samples(POSE), hand.samples(POSITION)[:, 0]
    assert len(pose) == 250
    assert pose[:, 2] == pytest.approx(0.25 - position_m)
    assert pose[-1] == pytest.approx([0.4, -0.1333, 0.248, 0.0, 3.1416, 0.0])


def test_it_has_the_rate_and_the_tool_that_the_profile_states():
    hand = Hand(rate_hz=125.0, payload_kg=1.25)
    details = hand.arm.open().details
    assert (details["payload_kg"], details["tcp_offset"]) == (1.25, (0.0,) * 6)
    assert details["not_stated_by_the_profile"] == ("tcp_offset", "payload_cog_m")
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.run(0.4)
    assert len(hand.samples(POSITION)) == 50
    assert np.diff([t_s for block in hand.blocks for t_s in block.times]) == pytest.approx(0.008)


def test_the_tool_feels_the_finger_against_the_approach_and_can_be_tared():
    hand = Hand(force_noise_n=0.0, torque_noise_n_m=0.0)
    hand.arm.apply(Listen("arm", frozenset({FORCE})))
    hand.run(0.1)
    hand.arm.apply(MoveTo("arm", 0.008, 0.02))
    hand.run(2.0)
    wrench, force_n = hand.samples(FORCE), hand.bench.force_n
    assert np.abs(wrench[:50]).max() < 0.02, "3 mm before the finger: the load cell's noise alone"
    assert force_n > 0.1
    assert wrench[-1] == pytest.approx([0.0, 0.0, force_n, 0.0, 0.0, 0.0], abs=0.02)
    hand.arm.apply(Tare("arm", FORCE))
    hand.blocks.clear()
    hand.run(0.1)
    assert hand.samples(FORCE)[-1, 2] == pytest.approx(0.0, abs=0.02)


def test_the_noise_has_its_setting_and_follows_the_sample_not_the_block():
    whole, cut = Hand(), Hand()
    for hand, turn_s in ((whole, 0.1), (cut, 0.002)):
        hand.arm.apply(Listen("arm", frozenset({FORCE})))
        hand.run(2.0, turn_s)
    assert (whole.samples(FORCE) == cut.samples(FORCE)).all()
    # 1000 samples: a standard deviation is known to 2.2 %.
    assert whole.samples(FORCE).std(axis=0) == pytest.approx([0.5] * 3 + [0.02] * 3, rel=0.1)


def test_a_stall_is_a_protective_stop_that_home_ends():
    hand = Hand(Fault(device="arm", kind="stall", at_s=0.3))
    hand.arm.apply(MoveAt("arm", 0.01, 0.015))
    hand.run(0.5)
    assert "protective stop" in hand.only(Stalled).reason
    assert hand.arm.axis.velocity(0.5) == 0.0
    hand.arm.apply(MoveTo("arm", 0.001, 0.01))
    hand.run(0.1)
    assert "Home" in hand.only(Refused).reason
    hand.arm.apply(Home("arm"))
    hand.run(1.0)
    assert hand.only(Reached).position_m == 0.0
    hand.arm.apply(MoveTo("arm", 0.001, 0.01))
    hand.run(0.5)
    assert [status.position_m for status in hand.statuses if isinstance(status, Reached)][-1] == 0.001


def test_a_pulled_plug_is_a_failure_and_the_arm_stops_by_itself():
    hand = Hand(Fault(device="arm", kind="unplug", at_s=0.3))
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.arm.apply(MoveAt("arm", 0.01, 0.015))
    hand.run(0.35)
    assert "the link is gone" in hand.only(Failed).reason
    assert not hand.arm.axis.moving(0.35)
    assert 147 <= len(hand.samples(POSITION)) <= 150, "up to the last turn before it"


def test_a_silent_arm_sends_and_receives_nothing():
    hand = Hand(Fault(device="arm", kind="silent", at_s=0.0, for_s=0.2))
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.arm.apply(MoveTo("arm", 0.001, 0.01))
    hand.run(0.195)
    assert hand.blocks == []
    assert hand.statuses == []
    assert hand.arm.axis.position(0.195) == 0.0
    hand.run(0.1)
    assert hand.blocks[0].seq > 90, "what was not subscribed is a jump in the sequence"


def test_refused_motion_and_lost_rows_are_reported():
    hand = Hand(
        Fault(device="arm", kind="refuse", at_s=0.0), Fault(device="arm", kind="lose", at_s=0.0, for_s=0.1)
    )
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.arm.apply(MoveTo("arm", 0.001, 0.01))
    hand.run(0.2)
    assert "injected" in hand.only(Refused).reason
    assert hand.arm.axis.position(0.2) == 0.0
    lost = sum(status.samples for status in hand.statuses if isinstance(status, Lost))
    assert 47 <= lost <= 50
    assert hand.blocks[0].seq == lost
    assert lost + len(hand.samples(POSITION)) == 100


def test_a_probe_has_one_mover():
    hand = Hand()
    with pytest.raises(RefusedError, match="another mover carries it already"):
        hand.bench.mount(AxisMotion())
