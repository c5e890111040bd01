"""The mock arm: the real one's limits and messages, in virtual time, along its axis and beside it, on two benches."""

from typing import Any, ClassVar

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import (
    Command,
    Failed,
    Home,
    Listen,
    Lost,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Refused,
    Stalled,
    Standstill,
    Status,
    Stop,
    Tare,
    Twist,
)
from simulator.devices import barrett_hand, can_gripper, dsa_matrix
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.barrett_hand import MockBarrettHand, MockBarrettHandSettings
from simulator.mocks.can_gripper import MockCanGripper, MockCanGripperSettings
from simulator.mocks.dsa_matrix import MockDsaMatrix, MockDsaMatrixSettings
from simulator.mocks.ur_arm import MockUrArm, MockUrArmSettings
from simulator.physics.finger_part import FingerBenchSettings, finger_bench
from simulator.physics.rigid import rotation
from simulator.physics.tool_motion import ToolTrack
from tests.contracts.crank import Crank

START = (0.4, -0.1, 0.25, 0.0, 3.0, 0.5)
POSE, POSITION, FORCE = "arm.pose", "arm.position", "arm.force"
ASIDE = (0.02, 0.0, 0.0, 0.0, 0.0, 0.0)


class SpringBench:
    """A bench of nothing but a spring to the start pose, which pulls and twists the tool back."""

    STIFFNESS = np.array([100.0, 200.0, 300.0, 2.0, 3.0, 4.0])

    def __init__(self) -> None:
        self.key, self.t_s = (1, 1), 0.0
        self.carrier: ToolTrack | None = None
        self.plans_s: list[float] = []

    def mount(self, carrier: ToolTrack) -> None:
        self.carrier = carrier

    def on_plan(self, t_s: float) -> None:
        self.plans_s.append(t_s)

    def feel(self, on: bool) -> None:
        pass

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        self.t_s = t_s

    def wrench(self, times_s: np.ndarray, direction: Any) -> np.ndarray:
        assert self.carrier is not None
        return -self.STIFFNESS * self.carrier.offsets(times_s)


class Hand(Crank):
    """An arm on a bench of nothing but a spring, and the loop's crank."""

    bench_made: Any = SpringBench
    given: ClassVar[dict[str, Any]] = {"start_pose": START, "force_noise_n": 0.0, "torque_noise_n_m": 0.0}

    def __init__(self, *faults: Fault, **settings: Any) -> None:
        self.bench = self.bench_made()
        clock = VirtualClock()
        values = MockUrArmSettings.model_validate({"host": "mock", **self.given, **settings})
        self.arm = MockUrArm("arm", values, clock, self.bench, FaultSchedule(faults))
        super().__init__(self.arm, clock, opens=False)

    def run(self, seconds: float, turn_s: float = 0.005) -> None:
        begin_s = self.clock.now()
        for number in range(round(seconds / turn_s)):
            self.clock.wait_until(round(begin_s + (number + 1) * turn_s, 9))
            self.blocks += self.arm.read()
            self.statuses += self.arm.poll()

    def do(self, command: Command, seconds: float = 20.0) -> Any:
        """Apply, let time pass, and take the last status."""
        self.arm.apply(command)
        self.run(seconds)
        return self.statuses[-1]

    def only(self, kind: type[Status]) -> Any:
        (found,) = self.of(kind)
        return found


class Finger(Hand):
    """The same on the finger's bench."""

    given: ClassVar[dict[str, Any]] = {
        "start_pose": (0.4, -0.1333, 0.25, 0.0, 3.1416, 0.0),
        "travel_max_m": 0.02,
    }

    @staticmethod
    def bench_made() -> Any:
        return finger_bench(FingerBenchSettings())


def test_a_twist_is_reached_when_nothing_has_moved_for_a_while_after_its_ramp():
    hand = Hand()
    reached = hand.do(Twist("arm", ASIDE, 1.0), 2.0)
    assert isinstance(reached, Reached)
    assert reached.t_s == pytest.approx(1.0 + 0.02 / 0.5 + 0.02)
    assert hand.arm.axis.offsets(np.array([2.0]))[0] == pytest.approx(np.array(ASIDE), abs=1e-15)


def test_the_arm_states_how_long_it_may_go_unread_until_it_reports_its_end():
    hand = Hand()
    assert hand.arm.alone_s == np.inf
    hand.arm.apply(Twist("arm", ASIDE, 1.0))
    hand.run(0.5)
    ends_s = hand.clock.now() + hand.arm.alone_s
    hand.run(1.0)
    assert hand.statuses[-1] == Reached(pytest.approx(ends_s), "arm", 0.0)
    assert hand.arm.alone_s == np.inf


def test_a_renewed_twist_is_reached_once():
    hand = Hand()
    for _ in range(4):
        hand.arm.apply(Twist("arm", ASIDE, 0.5))
        hand.run(0.3)
    hand.run(1.0)
    assert [type(status).__name__ for status in hand.statuses] == ["Sent"] * 4 + ["Reached"]


def test_the_pose_is_the_start_pose_moved_and_turned_in_the_base_frame():
    hand = Hand()
    hand.arm.apply(Listen("arm", frozenset({POSE})))
    offset = (0.01, -0.02, 0.03, 0.0, 0.3, 0.0)
    assert isinstance(hand.do(MovePose("arm", offset, 0.05)), Reached)
    pose = hand.values(POSE)[-1]
    assert pose[:3] == pytest.approx(np.array(START[:3]) + offset[:3], abs=1e-15)
    assert rotation(pose[3:]) == pytest.approx(rotation(offset[3:]) @ rotation(START[3:]), abs=1e-12)


def test_a_move_that_only_turns_goes_at_its_speed_in_rad_s_within_the_limit_of_turns():
    hand = Hand(max_turn_rad_s=0.25, max_speed_m_s=0.05)
    reached = hand.do(MovePose("arm", (0.0, 0.0, 0.0, 0.0, 0.5, 0.0), 1.0))
    # 0.5 rad at 0.25 rad/s, one ramp at 0.5 rad/s2 more, and the pause.
    assert reached.t_s == pytest.approx(2.0 + 0.5 + 0.02)


def test_a_move_to_the_axis_comes_back_to_it_and_to_the_start_s_orientation():
    hand = Hand()
    hand.arm.apply(Listen("arm", frozenset({POSE, POSITION})))
    hand.do(MovePose("arm", (0.02, 0.0, 0.0, 0.0, 0.2, 0.0), 0.05))
    reached = hand.do(MoveTo("arm", 0.01, 0.05))
    assert isinstance(reached, Reached)
    assert reached.position_m == 0.01
    assert hand.values(POSE)[-1] == pytest.approx([0.4, -0.1, 0.24, 0.0, 3.0, 0.5], abs=1e-12)
    assert hand.values(POSITION)[-1] == pytest.approx([0.01], abs=1e-12)


@pytest.mark.parametrize(
    "command", [Twist("arm", ASIDE, 5.0), MovePose("arm", (0.1, 0.0, 0.0, 0.0, 0.3, 0.0), 0.05)]
)
def test_a_stop_ends_a_free_motion_with_standstill_alone(command):
    hand = Hand()
    hand.arm.apply(command)
    hand.run(1.0)
    hand.arm.apply(Stop("arm"))
    hand.run(1.0)
    assert [type(status).__name__ for status in hand.statuses] == ["Sent", "Sent", "Standstill"]
    assert isinstance(hand.statuses[-1], Standstill)
    assert not hand.arm.axis.moving(hand.clock.now())


def test_a_twist_ends_inside_the_leash_and_inside_the_travel_and_may_come_back():
    hand = Hand(leash_m=0.03, travel_max_m=0.02)
    stalled = hand.do(Twist("arm", (0.02, 0.01, 0.0, 0.0, 0.0, 0.0), 10.0))
    assert isinstance(stalled, Stalled)
    assert "leash" in stalled.reason
    away_m = np.linalg.norm(hand.arm.axis.offsets(np.array([hand.clock.now()]))[0, :3])
    assert 0.0295 < away_m <= 0.03
    assert isinstance(hand.do(Twist("arm", (-0.02, 0.0, 0.0, 0.0, 0.0, 0.0), 1.0)), Reached)
    stalled = hand.do(Twist("arm", (0.0, 0.0, -0.02, 0.0, 0.0, 0.0), 10.0))
    assert "travel" in stalled.reason
    assert 0.0195 < hand.arm.axis.position(hand.clock.now()) <= 0.02


def test_home_comes_from_everywhere_within_the_leash():
    hand = Hand()
    hand.do(Twist("arm", (0.02, 0.01, 0.0, 0.0, 0.0, 0.1), 1.0))
    assert isinstance(hand.do(Home("arm")), Reached)
    home = hand.arm.axis.offsets(np.array([hand.clock.now()]))[0]
    assert home == pytest.approx(np.zeros(6), abs=1e-15)


def test_home_is_refused_from_beyond_the_leash():
    hand = Hand(leash_m=0.01)
    hand.do(MoveTo("arm", 0.03, 0.05))
    refused = hand.do(Home("arm"))
    assert isinstance(refused, Refused)
    assert "leash of" in refused.reason or "its leash is" in refused.reason
    assert hand.arm.axis.position(hand.clock.now()) == 0.03


def test_the_tool_feels_all_six_components_of_the_bench_and_can_be_tared():
    hand = Hand()
    hand.arm.apply(Listen("arm", frozenset({FORCE})))
    offset = (0.01, 0.02, 0.0, 0.1, 0.0, 0.2)
    hand.do(MovePose("arm", offset, 0.05))
    assert hand.values(FORCE)[-1] == pytest.approx(-SpringBench.STIFFNESS * offset, abs=1e-9)
    hand.do(Tare("arm", FORCE), 0.1)
    assert hand.values(FORCE)[-1] == pytest.approx(np.zeros(6), abs=1e-12)


def test_poses_and_forces_are_the_same_bytes_however_often_they_are_read():
    hands = [Hand(force_noise_n=0.5), Hand(force_noise_n=0.5)]
    for hand, turn_s in zip(hands, (0.1, 0.002), strict=True):
        hand.arm.apply(Listen("arm", frozenset({FORCE, POSE})))
        hand.arm.apply(Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.2, 0.0), 0.7))
        hand.run(1.0, turn_s)
        hand.arm.apply(MovePose("arm", (0.0, 0.01, 0.0, 0.1, 0.0, 0.0), 0.05))
        hand.run(1.0, turn_s)
    for stream in (FORCE, POSE):
        assert hands[0].values(stream).tobytes() == hands[1].values(stream).tobytes()


def test_the_bench_is_notified_of_every_new_plan_when_it_begins():
    hand = Hand()
    for command in (Twist("arm", ASIDE, 5.0), MovePose("arm", ASIDE, 0.01), Stop("arm")):
        hand.arm.apply(command)
        hand.run(0.5)
    assert hand.bench.plans_s == pytest.approx([0.0, 0.5, 1.0])


MOCKS = [
    (MockCanGripper, MockCanGripperSettings, "jaws"),
    (MockBarrettHand, MockBarrettHandSettings, "fingers"),
    (MockDsaMatrix, MockDsaMatrixSettings, "matrices"),
]


@pytest.mark.parametrize(("driver", "settings", "message"), MOCKS)
def test_a_device_whose_part_the_bench_does_not_have_is_refused_in_one_line(driver, settings, message):
    bench = finger_bench(FingerBenchSettings())
    with pytest.raises(RefusedError, match=f"does not have .*{message}") as caught:
        driver("device", settings(), VirtualClock(), bench)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("wire", [can_gripper.emulated, barrett_hand.emulated, dsa_matrix.emulated])
def test_so_does_its_far_end(wire):
    with pytest.raises(RefusedError, match="does not have"):
        wire({}, finger_bench(FingerBenchSettings()))


def test_a_stop_brakes_at_the_arms_own_rate_and_is_reported_when_nothing_has_moved_for_a_while():
    hand = Finger(stop_m_s2=2.0)
    hand.arm.apply(MoveAt("arm", 0.01, 0.015))
    hand.run(0.5)
    before_m = hand.arm.axis.position(0.5)
    hand.arm.apply(Stop("arm"))
    hand.run(0.1)
    still = hand.only(Standstill)
    assert still.position_m - before_m == pytest.approx(0.01**2 / (2 * 2.0), abs=1e-9)
    assert still.t_s == pytest.approx(0.5 + 0.01 / 2.0 + 0.02)


def test_it_has_the_rate_and_the_tool_that_the_profile_states():
    hand = Finger(rate_hz=125.0, payload_kg=1.25)
    details = hand.arm.open().details
    assert (details["payload_kg"], details["tcp_offset"]) == (1.25, (0.0,) * 6)
    assert details["not_stated_by_the_profile"] == ("tcp_offset", "payload_cog_m")
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.run(0.4)
    assert len(hand.values(POSITION)) == 50
    assert np.diff([t_s for block in hand.blocks for t_s in block.times]) == pytest.approx(0.008)


def test_the_noise_has_its_setting():
    hand = Finger()
    hand.arm.apply(Listen("arm", frozenset({FORCE})))
    hand.run(2.0, 0.1)
    # 1000 samples: a standard deviation is known to 2.2 %.
    assert hand.values(FORCE).std(axis=0) == pytest.approx([0.5] * 3 + [0.02] * 3, rel=0.1)


def test_a_stall_is_a_protective_stop_that_home_ends():
    hand = Finger(Fault(device="arm", kind="stall", at_s=0.3))
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
    hand = Finger(Fault(device="arm", kind="unplug", at_s=0.3))
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.arm.apply(MoveAt("arm", 0.01, 0.015))
    hand.run(0.35)
    assert "the link is gone" in hand.only(Failed).reason
    assert not hand.arm.axis.moving(0.35)
    assert 147 <= len(hand.values(POSITION)) <= 150, "up to the last turn before it"


def test_a_silent_arm_sends_and_receives_nothing():
    hand = Finger(Fault(device="arm", kind="silent", at_s=0.0, for_s=0.2))
    hand.arm.apply(Listen("arm", frozenset({POSITION})))
    hand.arm.apply(MoveTo("arm", 0.001, 0.01))
    hand.run(0.195)
    assert hand.blocks == []
    assert hand.statuses == []
    assert hand.arm.axis.position(0.195) == 0.0
    hand.run(0.1)
    assert hand.blocks[0].seq > 90, "what was not subscribed is a jump in the sequence"


def test_an_arm_whose_line_falls_silent_is_stopped_by_its_watchdog_and_says_so_when_it_is_heard_again():
    hand = Finger(Fault(device="arm", kind="silent", at_s=0.3, for_s=0.5))
    hand.arm.apply(MoveAt("arm", 0.01, 0.015))
    hand.run(0.79)
    assert hand.arm.axis.position(0.79) == hand.arm.axis.position(0.5)
    assert hand.arm.axis.position(0.79) <= 0.01 * (0.3 + 1.0 / hand.arm._settings.watchdog_hz + 0.01)
    assert hand.of(Stalled) == []
    hand.run(0.1)
    assert "watchdog" in hand.only(Stalled).reason
    hand.arm.apply(MoveTo("arm", 0.001, 0.01))
    hand.run(0.1)
    assert "send it Home" in hand.only(Refused).reason


def test_refused_motion_and_lost_rows_are_reported():
    hand = Finger(
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
    assert lost + len(hand.values(POSITION)) == 100
