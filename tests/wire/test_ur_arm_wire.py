"""The arm through the unmodified ur_rtde client, on the emulated controller: motions, and what it refuses."""

import sys
from collections.abc import Callable

import numpy as np
import pytest

from drivers.core.messages import (
    Home,
    Listen,
    Lost,
    MoveAt,
    MoveTo,
    Reached,
    Refused,
    Sent,
    Stalled,
    Standstill,
    Stop,
    Tare,
    Twist,
)
from tests.wire.emulated_ur import EmulatedUr, resting
from tests.wire.ur_hand import FORCE, POSITION, Hand, settings


def test_an_approach_a_stop_a_move_a_twist_and_home(hand: Callable[..., Hand]) -> None:
    one = hand()
    assert one.info.model == "UR5"
    assert one.info.mover
    reached = one.do(MoveAt("arm", 0.05, 0.02), Reached)
    assert 0.0195 <= reached.position_m <= 0.02
    assert one.do(MoveTo("arm", -0.01, 0.05), Reached).position_m == pytest.approx(-0.01, abs=1e-4)
    one.set_out(MoveAt("arm", 0.02, 0.03))
    standstill = one.do(Stop("arm"), Standstill)
    assert -0.01 < standstill.position_m < 0.03
    one.do(Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.1), 0.2), Reached)
    one.do(Tare("arm", FORCE), Sent)
    assert one.do(Home("arm"), Reached).position_m == pytest.approx(0.0, abs=1e-4)
    state = one.emulated.order()
    assert state["pose"] == pytest.approx(list(settings(one.emulated).start_pose), abs=1e-5)
    assert state["log"] == []
    assert not {"rtde_control", "rtde_receive"} & sys.modules.keys()


@pytest.mark.parametrize("rate_hz", [500.0, 125.0])
def test_streams_come_with_the_controller_s_time_and_their_loss_is_counted(
    hand: Callable[..., Hand], rate_hz: float
) -> None:
    one = hand(rate_hz=rate_hz)
    one.arm.apply(Listen("arm", frozenset({FORCE, POSITION})))
    one.set_out(MoveAt("arm", 0.02, 0.04))
    one.run(1.0)
    for stream in (FORCE, POSITION):
        blocks = [block for block in one.blocks if block.stream == stream]
        cycles = 1 + round((blocks[-1].device_t0_s - blocks[0].device_t0_s) * rate_hz) + len(blocks[-1]) - 1
        lost = sum(
            status.samples for status in one.statuses if isinstance(status, Lost) and status.stream == stream
        )
        assert sum(map(len, blocks)) + lost == cycles
        assert blocks[-1].seq + len(blocks[-1]) - blocks[0].seq == cycles
        times = np.concatenate([block.times for block in blocks])
        assert (np.diff(times) > 0.0).all()
    positions = np.concatenate([block.values for block in one.blocks if block.stream == POSITION])
    assert (np.diff(positions[:, 0]) > -1e-12).all()


def test_the_force_of_a_touch_comes_through_and_can_be_tared() -> None:
    with EmulatedUr(plane_m=0.175) as emulated:
        one = Hand(emulated)
        try:
            one.arm.apply(Listen("arm", frozenset({FORCE})))
            one.do(MoveTo("arm", 0.006, 0.01), Reached)
            one.run(0.05)
            # 10,000 N/m, and the depth that is left of 6 mm from the start's height.
            depth_m = 0.175 - emulated.order()["pose"][2]
            assert one.blocks[-1].values[-1, 2] == pytest.approx(1e4 * depth_m, abs=1e-3)
            one.do(Tare("arm", FORCE), Sent)
            one.run(0.05)
            assert one.blocks[-1].values[-1] == pytest.approx(np.zeros(6), abs=1e-9)
        finally:
            one.arm.close()


def test_closing_stops_the_arm_before_the_process_ends(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.set_out(MoveAt("arm", 0.02, 0.04))
    one.arm.close()
    state = one.emulated.until(lambda state: state["runtime"] == "STOPPED")
    assert resting(state)
    assert all("watchdog" not in line for line in state["log"])
    one.arm.close()


def test_a_protective_stop_is_a_stall_and_home_recovers(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.set_out(MoveAt("arm", 0.02, 0.04))
    one.emulated.order(protective_stop=True)
    assert "protective stop" in one.await_(Stalled).reason
    one.do(MoveTo("arm", 0.0, 0.02), Refused)
    one.do(Stop("arm"), Standstill)
    one.do(Home("arm"), Reached)
    assert one.emulated.order()["runtime"] == "PLAYING"


def test_an_emergency_stop_is_a_stall_that_home_does_not_undo(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.emulated.order(emergency_stop=True)
    one.await_(Stalled)
    assert "emergency stop" in one.do(Home("arm"), Refused).reason


def test_remote_control_that_was_switched_off_keeps_home_from_recovering(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.emulated.order(remote=False, stop_program=True)
    one.await_(Stalled)
    assert "remote control" in one.do(Home("arm"), Refused).reason


def test_a_script_that_is_refused_later_keeps_home_from_recovering(hand: Callable[..., Hand]) -> None:
    one = hand(recover_s=1.0)
    one.emulated.order(accepts_scripts=False, stop_program=True)
    one.await_(Stalled)
    one.do(Home("arm"), Refused)
    one.emulated.order(accepts_scripts=True)
    one.do(Home("arm"), Reached)
