"""The arm's link through the unmodified ur_rtde client: every way in which it, or its far end, is lost.

A host that hangs, is killed, or frozen with its client: tests/wire/test_certificates_wire.py.
"""

import os
import signal
from collections.abc import Callable

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
from tests.wire.emulated_ur import EmulatedUr, resting
from tests.wire.ur_hand import POSITION, Hand, child


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
