"""The arm through the unmodified ur_rtde client, against the emulated controller: every way in which it fails."""

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from drivers.clock import WallClock
from drivers.errors import CommandError, PortError, RefusedError, SilentError
from drivers.messages import (
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
    SampleBlock,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
    Tare,
    Twist,
)
from drivers.ur_arm.driver import UrArm
from drivers.ur_arm.settings import Axis, UrArmSettings
from tests.wire.emulated_ur import ROOT, EmulatedUr, free_host, resting

FORCE, POSITION = "arm.force", "arm.position"


def settings(emulated: EmulatedUr, **changes: Any) -> UrArmSettings:
    given = {
        "host": emulated.host,
        "start_pose": emulated.order()["pose"],
        "travel_min_m": -0.04,
        "travel_max_m": 0.04,
        "open_timeout_s": 15.0,
        **changes,
    }
    return UrArmSettings.model_validate(given)


class Hand:
    """Drives an arm as the loop does: one thread, no waiting inside the driver."""

    def __init__(self, emulated: EmulatedUr, **changes: Any) -> None:
        self.emulated = emulated
        self.arm = UrArm("arm", settings(emulated, **changes), emulated.clock)
        self.clock = emulated.clock
        self.info = self.arm.open()
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def turn(self) -> None:
        self.blocks += self.arm.read()
        self.statuses += self.arm.poll()
        self.clock.rest(0.002)

    def run(self, duration_s: float) -> None:
        end_s = self.clock.monotonic_s() + duration_s
        while self.clock.monotonic_s() < end_s:
            self.turn()

    def await_(self, kind: type[Status], timeout_s: float = 10.0) -> Any:
        """The next status of a kind."""
        seen = len(self.statuses)
        end_s = self.clock.monotonic_s() + timeout_s
        while self.clock.monotonic_s() < end_s:
            self.turn()
            for status in self.statuses[seen:]:
                if isinstance(status, kind):
                    return status
        pytest.fail(
            f"no {kind.__name__} in {[status for status in self.statuses if not isinstance(status, Lost)]}"
        )

    def do(self, command: Command, kind: type[Status]) -> Any:
        """Apply, and wait for what comes of it."""
        self.arm.apply(command)
        return self.await_(kind)

    def set_out(self, command: Command, before_m: float = 0.003) -> None:
        """Apply, and wait until the tool is well on its way."""
        start = np.array(self.emulated.order()["pose"][:3])

        def well_on_its_way(state: dict[str, Any]) -> bool:
            self.turn()
            return bool(np.linalg.norm(np.array(state["pose"][:3]) - start) > before_m)

        self.arm.apply(command)
        self.emulated.until(well_on_its_way)
        self.run(0.02)


@pytest.fixture(scope="module")
def controller() -> Iterator[EmulatedUr]:
    with EmulatedUr() as one:
        yield one


@pytest.fixture
def emulated(controller: EmulatedUr) -> EmulatedUr:
    """A controller that was just switched on."""
    controller.order(restart=True)
    return controller


@pytest.fixture
def hand(emulated: EmulatedUr) -> Iterator[Callable[..., Hand]]:
    hands: list[Hand] = []

    def make(**changes: Any) -> Hand:
        hands.append(Hand(emulated, **changes))
        return hands[-1]

    yield make
    for one in hands:
        one.arm.close()


def child(hand: Hand) -> int:
    """The process that holds the client: the one child of this process that runs its module."""
    found = [
        int(pid)
        for pid in (entry.name for entry in Path("/proc").iterdir())
        if pid.isdigit() and _cmdline(pid)[-2:-1] == ["drivers.ur_arm.child"] and _parent(pid) == os.getpid()
    ]
    assert len(found) == 1
    return found[0]


def _cmdline(pid: str) -> list[str]:
    try:
        return Path(f"/proc/{pid}/cmdline").read_text(errors="replace").split("\0")[:-1]
    except OSError:
        return []


def _parent(pid: str) -> int:
    return int(Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[1])


# --- when nothing fails ----------------------------------------------------------------------------------


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


def test_a_tool_moves_turns_and_comes_back_in_all_directions(hand: Callable[..., Hand]) -> None:
    one = hand()
    axis = Axis(settings(one.emulated))
    offset = (0.01, -0.02, 0.01, 0.05, 0.0, 0.0)
    reached = one.do(MovePose("arm", offset, 0.05), Reached)
    assert reached.position_m == pytest.approx(-0.01, abs=1e-4)
    assert one.emulated.order()["pose"] == pytest.approx(list(axis.displaced(offset)), abs=1e-5)
    begin = np.array(one.emulated.order()["pose"][:3])
    one.do(Twist("arm", (0.02, 0.0, 0.0, 0.0, 0.1, 0.0), 0.5), Reached)
    # 10 mm; a cycle of 8 ms more or less, on a busy machine two.
    assert np.array(one.emulated.order()["pose"][:3]) - begin == pytest.approx([0.01, 0.0, 0.0], abs=4e-4)
    one.set_out(MovePose("arm", (-0.03, 0.0, 0.0, 0.0, 0.0, 0.0), 0.02))
    one.do(Stop("arm"), Standstill)
    one.do(MovePose("arm", (0.0,) * 6, 0.1), Reached)
    assert one.emulated.order()["pose"] == pytest.approx(list(axis.pose(0.0)), abs=1e-5)
    assert one.emulated.order()["log"] == []


def test_streams_come_at_500_hz_with_the_controller_s_time_and_their_loss_is_counted(
    hand: Callable[..., Hand],
) -> None:
    one = hand()
    one.arm.apply(Listen("arm", frozenset({FORCE, POSITION})))
    one.set_out(MoveAt("arm", 0.02, 0.04))
    one.run(1.0)
    for stream in (FORCE, POSITION):
        blocks = [block for block in one.blocks if block.stream == stream]
        cycles = 1 + round((blocks[-1].device_t0_s - blocks[0].device_t0_s) * 500.0) + len(blocks[-1]) - 1
        said = sum(
            status.samples for status in one.statuses if isinstance(status, Lost) and status.stream == stream
        )
        assert sum(map(len, blocks)) + said == cycles
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


def test_an_arm_can_be_opened_again_after_it_was_closed(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.arm.close()
    one.arm.open()
    one.do(MoveTo("arm", 0.005, 0.05), Reached)


# --- opening --------------------------------------------------------------------------------------------


def refused(emulated: EmulatedUr, kind: type[Exception], words: str, **changes: Any) -> None:
    arm = UrArm("arm", settings(emulated, **changes), emulated.clock)
    with pytest.raises(kind, match=words) as caught:
        arm.open()
    assert "\n" not in str(caught.value)
    arm.close()


def test_nobody_listens_is_a_port_error() -> None:
    given = UrArmSettings(host=free_host(), start_pose=(0.4, 0.0, 0.2, 0.0, 3.14, 0.0))
    with pytest.raises(PortError, match="nobody answers"):
        UrArm("arm", given, WallClock()).open()


def test_a_handshake_without_a_reply_is_given_up(emulated: EmulatedUr) -> None:
    emulated.order(deaf=True)
    refused(emulated, SilentError, "says nothing", open_timeout_s=2.0)


def test_a_stream_that_never_starts_is_given_up(emulated: EmulatedUr) -> None:
    emulated.order(streams=False)
    refused(emulated, SilentError, "no data come", open_timeout_s=8.0)


def test_a_controller_that_runs_no_script_is_a_refusal(emulated: EmulatedUr) -> None:
    emulated.order(accepts_scripts=False)
    refused(emulated, RefusedError, "Failed to start control script")


def test_remote_control_that_is_off_is_a_refusal(emulated: EmulatedUr) -> None:
    emulated.order(remote=False)
    refused(emulated, RefusedError, "remote control is off")


def test_a_protective_stop_at_the_start_is_a_refusal_and_stays(emulated: EmulatedUr) -> None:
    emulated.order(protective_stop=True)
    refused(emulated, RefusedError, "protective stop")
    assert emulated.order()["safety"] == "PROTECTIVE_STOP"


OTHER_CLIENT = """
import sys, time, rtde_control
control = rtde_control.RTDEControlInterface(sys.argv[1])
if sys.argv[2] == "idle":
    control.stopScript()
print("ready", flush=True)
time.sleep(60)
"""


@pytest.mark.parametrize(("doing", "words"), [("busy", "another program runs"), ("idle", "already in use")])
def test_a_second_control_interface_is_a_refusal(emulated: EmulatedUr, doing: str, words: str) -> None:
    other = subprocess.Popen(
        [sys.executable, "-c", OTHER_CLIENT, emulated.host, doing],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )
    assert other.stdout is not None
    try:
        assert other.stdout.readline() == b"ready\n"
        refused(emulated, RefusedError, words)
    finally:
        other.kill()
        other.wait()
        other.stdout.close()


# --- the link -------------------------------------------------------------------------------------------


@pytest.mark.parametrize("which", ["receive", "control"])
def test_a_link_that_is_dropped_stalls_the_arm_and_is_made_again(
    hand: Callable[..., Hand], which: str
) -> None:
    one = hand()
    one.arm.apply(Listen("arm", frozenset({POSITION})))
    one.set_out(MoveTo("arm", 0.04, 0.02))
    one.emulated.order(drop=which)
    one.await_(Stalled)
    one.do(Stop("arm"), Standstill)
    state = one.emulated.order()
    assert resting(state)
    one.do(Home("arm"), Reached)
    # What was not heard meanwhile is loss.
    assert max(status.samples for status in one.statuses if isinstance(status, Lost)) > 10


def test_silence_stalls_the_arm_and_the_arm_has_stopped_by_itself(hand: Callable[..., Hand]) -> None:
    one = hand(link_timeout_s=0.1)
    one.set_out(MoveAt("arm", 0.02, 0.04))
    one.emulated.order(silence_s=1.0)
    stalled = one.await_(Stalled)
    assert "stood still" in stalled.reason
    one.emulated.until(resting)
    one.do(Stop("arm"), Standstill)
    one.do(MoveTo("arm", 0.0, 0.05), Reached)


@pytest.mark.parametrize("moving", [False, True])
def test_a_controller_that_is_gone_is_a_failure(moving: bool) -> None:
    with EmulatedUr() as emulated:
        one = Hand(emulated, reconnect_s=1.0)
        if moving:
            one.set_out(MoveTo("arm", 0.04, 0.02))
        emulated.order(gone=True)
        one.await_(Stalled)
        one.arm.apply(MoveTo("arm", 0.0, 0.01))
        failed = one.await_(Failed)
        assert "nobody answers" in failed.reason
        assert isinstance(one.statuses[-2], Refused)
        one.arm.apply(Stop("arm"))
        one.arm.close()


@pytest.mark.parametrize("blow", [signal.SIGSEGV, signal.SIGKILL, signal.SIGABRT])
def test_a_client_that_crashes_is_replaced_and_the_watchdog_has_stopped_the_arm(
    hand: Callable[..., Hand], blow: signal.Signals
) -> None:
    one = hand()
    one.set_out(MoveAt("arm", 0.02, 0.04))
    os.kill(child(one), blow)
    stalled = one.await_(Stalled)
    assert blow.name in stalled.reason
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


def test_without_a_second_try_a_lost_client_is_a_failure_and_the_arm_stops_all_the_same(
    hand: Callable[..., Hand],
) -> None:
    one = hand(reconnect_s=0.0)
    one.set_out(MoveAt("arm", 0.02, 0.04))
    os.kill(child(one), signal.SIGKILL)
    one.await_(Failed)
    state = one.emulated.until(resting)
    assert any("watchdog" in line for line in state["log"])
    # 20 mm/s for the watchdog's 0.1 s, and the way to rest.
    assert state["runtime"] == "STOPPED"


HOST = """
import sys
from drivers.bench_clock import BenchClock, ClockPage
from drivers.messages import MoveAt
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


def test_a_program_whose_loop_hangs_leaves_an_arm_that_stops_and_hears_why(hand: Callable[..., Hand]) -> None:
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
        [sys.executable, "-c", HOST, given.model_dump_json(), emulated.clock.path],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        process_group=0,  # it is stopped and continued by nobody else
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


# --- the controller -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "command",
    [
        MoveTo("arm", 0.04, 0.02),
        MoveAt("arm", 0.02, 0.04),
        Twist("arm", (0.0, 0.0, -0.02, 0.0, 0.0, 0.0), 5.0),
    ],
)
def test_a_protective_stop_is_a_stall_and_home_recovers(hand: Callable[..., Hand], command: Command) -> None:
    one = hand()
    one.set_out(command)
    one.emulated.order(protective_stop=True)
    assert "protective stop" in one.await_(Stalled).reason
    one.do(MoveTo("arm", 0.0, 0.02), Refused)
    one.do(Stop("arm"), Standstill)
    one.do(Home("arm"), Reached)
    assert one.emulated.order()["runtime"] == "PLAYING"


def test_a_program_that_was_stopped_is_a_stall_and_home_recovers(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.set_out(MoveTo("arm", 0.04, 0.02))
    one.emulated.order(stop_program=True)
    assert "program has stopped" in one.await_(Stalled).reason
    one.do(Home("arm"), Reached)


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


def test_motions_of_all_kinds_one_upon_the_other_leave_the_program_running(hand: Callable[..., Hand]) -> None:
    one = hand()
    for command in (
        MoveAt("arm", 0.02, 0.04),
        MoveTo("arm", -0.02, 0.05),
        Twist("arm", (0.01, 0.0, 0.0, 0.0, 0.0, 0.0), 2.0),
        Home("arm"),
        MoveAt("arm", -0.02, -0.04),
        Stop("arm"),
        MoveTo("arm", 0.01, 0.05),
    ):
        one.arm.apply(command)
        one.run(0.15)
    while one.await_(Reached).position_m != pytest.approx(0.01, abs=1e-4):
        pass
    assert one.emulated.order()["log"] == []


def test_a_stop_takes_effect_in_the_middle_of_a_move(hand: Callable[..., Hand]) -> None:
    one = hand()
    one.set_out(MoveTo("arm", 0.04, 0.01))
    standstill = one.do(Stop("arm"), Standstill)
    assert standstill.position_m < 0.03
    assert resting(one.emulated.order())
    assert one.emulated.order()["log"] == []


@pytest.mark.parametrize(
    "command",
    [
        Twist("arm", (0.01, 0.0, 0.0), 1.0),  # type: ignore[arg-type]
        Twist("arm", (float("nan"), 0.0, 0.0, 0.0, 0.0, 0.0), 1.0),
        MoveAt("arm", float("nan"), 0.01),
    ],
)
def test_a_vector_that_would_hang_the_client_never_reaches_it(
    hand: Callable[..., Hand], command: Command
) -> None:
    one = hand()
    with pytest.raises(CommandError):
        one.arm.apply(command)
    one.do(MoveTo("arm", 0.002, 0.05), Reached)
    assert one.emulated.order()["log"] == []
