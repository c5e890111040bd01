"""The arm's link through the unmodified ur_rtde client: every way in which it, or either end, is lost."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

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
    Stop,
)
from tests.wire.emulated_ur import ROOT, EmulatedUr, resting
from tests.wire.ur_hand import POSITION, Hand, child, settings


@pytest.mark.parametrize("which", ["receive", "control"])
def test_a_link_that_is_dropped_stalls_the_arm_and_is_made_again(
    hand: Callable[..., Hand], which: str
) -> None:
    one = hand()
    one.arm.apply(Listen("arm", frozenset({POSITION})))
    one.set_out(MoveTo("arm", 0.04, 0.02))
    one.emulated.order(drop=which)
    # The other link may report first that the program has stopped.
    one.await_(Stalled, "connecting again")
    one.do(Stop("arm"), Standstill)
    state = one.emulated.order()
    assert resting(state)
    one.do(Home("arm"), Reached)
    # Rows that did not arrive meanwhile are loss.
    assert max(status.samples for status in one.statuses if isinstance(status, Lost)) > 10


def test_silence_stalls_the_arm_and_the_arm_has_stopped_by_itself(hand: Callable[..., Hand]) -> None:
    one = hand(link_timeout_s=0.1)
    one.set_out(MoveAt("arm", 0.02, 0.04))
    one.emulated.order(silence_s=1.0)
    stalled = one.await_(Stalled)
    # The client keeps the host's time: on a machine that stands still it gives up by itself after 2.5 s (measured).
    assert "stood still" in stalled.reason or "the receive link is gone" in stalled.reason
    one.emulated.until(resting)
    one.do(Stop("arm"), Standstill)
    one.do(MoveTo("arm", 0.0, 0.05), Reached)


def test_a_controller_that_is_gone_is_a_failure() -> None:
    with EmulatedUr() as emulated:
        one = Hand(emulated, reconnect_s=1.0)
        one.set_out(MoveTo("arm", 0.04, 0.02))
        emulated.order(gone=True)
        one.await_(Stalled, "connecting again")
        one.arm.apply(MoveTo("arm", 0.0, 0.01))
        one.await_(Refused)
        failed = one.await_(Failed)
        # What the last attempt to connect found, where it came to an end in time.
        assert f"is {emulated.host} up, and the cable in?" in failed.reason
        one.arm.apply(Stop("arm"))
        one.arm.close()


def test_a_client_that_crashes_is_replaced_and_the_watchdog_has_stopped_the_arm(
    hand: Callable[..., Hand],
) -> None:
    one = hand()
    one.set_out(MoveAt("arm", 0.02, 0.04))
    os.kill(child(one), signal.SIGSEGV)
    assert "SIGSEGV" in one.await_(Stalled).reason
    one.do(Stop("arm"), Standstill)
    assert resting(one.emulated.order())
    one.do(Home("arm"), Reached)


def test_a_client_that_hangs_is_killed_and_replaced(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.set_out(MoveAt("arm", 0.02, 0.04))
    os.kill(child(one), signal.SIGSTOP)
    assert "hangs" in one.await_(Stalled).reason
    one.emulated.until(resting)
    one.do(MoveTo("arm", 0.0, 0.02), Refused)
    one.do(Stop("arm"), Standstill)
    one.do(Home("arm"), Reached)


HOST = """
import sys
from simulator.wiring.bench_clock import BenchClock, ClockPage
from drivers.core.messages import MoveAt
from drivers.ur_arm.driver import UrArm
from drivers.ur_arm.settings import UrArmSettings
clock = BenchClock(ClockPage(sys.argv[2]))
arm = UrArm("arm", UrArmSettings.model_validate_json(sys.argv[1]), clock)
arm.open()
arm.apply(MoveAt("arm", 0.02, 0.04))
print("moving", flush=True)
while True:
    arm.read(), arm.poll()
    clock.rest(0.005)
"""


def test_a_program_whose_loop_hangs_leaves_an_arm_that_stops_and_learns_why(
    hand: Callable[..., Hand],
) -> None:
    one = hand(loop_timeout_s=0.4)
    for command, again in ((MoveAt("arm", 0.01, 0.04), 0.0), (MoveTo("arm", 0.04, 0.01), 0.01)):
        one.set_out(command)
        before = np.array(one.emulated.order()["pose"][:3])
        # The reader thread takes every row meanwhile: only the loop stands still.
        state = one.emulated.until(resting, timeout_s=2.0)
        # 10 mm/s for the bound and for what a busy machine may be late; 1 ms of way for every 0.1 s.
        way_m = float(np.linalg.norm(np.array(state["pose"][:3]) - before))
        assert 0.003 < way_m < 0.01 * (0.4 + 0.2)
        assert state["runtime"] == "PLAYING", "it was braked, not halted"
        assert "has not looked at it" in one.await_(Stalled).reason
        assert one.do(MoveTo("arm", again, 0.05), Reached).position_m == pytest.approx(again, abs=1e-4)


@pytest.mark.parametrize("blow", [signal.SIGKILL, signal.SIGSTOP])
def test_a_host_that_dies_or_hangs_leaves_an_arm_that_stops(
    emulated: EmulatedUr, blow: signal.Signals
) -> None:
    given = settings(emulated)
    start_m = given.start_pose[2]
    host = subprocess.Popen(
        [sys.executable, "-c", HOST, given.model_dump_json(), emulated.page.path],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        process_group=0,  # it is stopped and continued by no other process
    )
    assert host.stdout is not None
    try:
        assert host.stdout.readline() == b"moving\n"
        emulated.until(lambda state: start_m - state["pose"][2] > 0.003)
        os.kill(host.pid, blow)
        state = emulated.until(resting)
        # 3 mm, and 20 mm/s for half a second at most.
        assert start_m - state["pose"][2] <= 0.02
    finally:
        host.kill()
        host.wait()
        host.stdout.close()
    emulated.until(lambda state: state["runtime"] == "STOPPED")
