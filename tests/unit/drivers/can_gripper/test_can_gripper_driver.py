"""The gripper's driver on an emulated gripper, in virtual time: what it promises, and what it writes."""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from drivers.can_gripper.codec import POLL, DriveOrder, GripperCode, GripperMessage, Order
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import ReceivedFrame
from drivers.core.errors import DeviceError, ProtocolError, SilentError
from drivers.core.messages import (
    Failed,
    Grip,
    Gripped,
    Home,
    Listen,
    Lost,
    Reached,
    Refused,
    Release,
    Sent,
    Stalled,
    Standstill,
    Stop,
)
from simulator.physics.jaws_drive import JawsDrive
from tests.contracts.gripper_suite import (
    CLOSED_M,
    GRIP,
    FreshGripperContract,
    GripperContract,
    calibrated_jaws,
)
from tests.unit.drivers.can_gripper.gripper_bench import DELAY_S, FRAME_S, Bench

OPEN_SLOWLY = Release("gripper", 0.02)
HOME, STOP = Home("gripper"), Stop("gripper")
WIDTH, FORCE = "gripper.width", "gripper.force"
IDLE = DriveOrder(0, 0, 0, activate=False, go=False)
CLEAR, CALIBRATE, SLEEP, ERRORS = (
    GripperMessage(code)
    for code in (GripperCode.CLEAR_ERROR, GripperCode.CALIBRATE, GripperCode.IDLE, GripperCode.ERRORS)
)
STEADY_MA = 324
"""15 N at 0.0462 N/mA, rounded down."""

Make = Callable[..., Bench]


class TestCanGripper(GripperContract):
    @pytest.fixture
    def bench(self) -> Bench:
        made = Bench(calibrated_jaws())
        made.info = made.device.open()
        return made


class TestFreshCanGripper(FreshGripperContract):
    @pytest.fixture
    def fresh(self) -> Bench:
        made = Bench(JawsDrive(CLOSED_M))
        made.info = made.device.open()
        return made


def watchdog(period_ms: int) -> Order:
    return GripperMessage(GripperCode.WATCHDOG, (period_ms, 0))


def hold_the_mug(bench: Bench) -> None:
    bench.device.apply(Release("gripper", 0.1))
    bench.turn(0.6)
    bench.place("mug")
    bench.device.apply(GRIP)
    bench.turn(0.5)
    assert bench.take(Gripped)[0].object
    bench.statuses.clear()


def position(bench: Bench) -> int:
    assert bench.device._state is not None
    return int(bench.device._state.position)


# --- opening and closing -------------------------------------------------------------------------


def test_open_identifies_it_sets_the_watchdog_and_moves_nothing(make_bench: Make) -> None:
    bench = make_bench(calibrated=False, watchdog_s=2.5)
    before_m = bench.drive.width_m
    *asked, last = bench.orders(lambda: setattr(bench, "info", bench.device.open()))
    assert asked == [*(GripperMessage(GripperCode(code)) for code in (25, 26, 23, 24)), POLL]
    assert last == watchdog(2500)
    info = bench.info
    assert (info.serial, info.mover, set(info.streams)) == ("4848", True, {WIDTH, FORCE})
    assert info.details["supply_v"] == pytest.approx(24.0)
    assert info.details["calibrated"] is False
    bench.turn(0.5)
    assert bench.drive.width_m == before_m
    assert bench.statuses == []


def test_open_stops_what_moves_where_it_is_with_little_force(bench: Bench) -> None:
    bench.device.apply(OPEN_SLOWLY)
    bench.turn(0.3)
    bench.device._link = None  # the program was killed
    period, hold = bench.orders(bench.device.open)[-2:]
    assert period == watchdog(1000)
    assert hold == DriveOrder(position(bench), 0, STEADY_MA)
    bench.turn(1.0)
    assert abs(bench.drive.rate_m_s) < 1e-4


def test_what_the_last_session_left_is_forgotten_at_open(bench: Bench) -> None:
    bench.listen(WIDTH)
    hold_the_mug(bench)
    assert bench.orders(bench.device.close) == [watchdog(0)], "what is held stays held"
    bench.device.open()
    assert bench.applied(STOP) == [POLL]
    bench.turn(0.3)
    bench.blocks.clear()
    asked = bench.orders(lambda: bench.turn(1.0))
    assert 8 <= len(asked) <= 11, "asked ten times a second: nothing is under way"
    assert bench.blocks == []


def test_closing_in_motion_holds_the_jaws_where_they_were_last_seen(bench: Bench) -> None:
    (opening,) = bench.applied(OPEN_SLOWLY)
    bench.turn(0.3)
    assert isinstance(opening, DriveOrder)
    hold = replace(opening, position=position(bench), current_ma=STEADY_MA)
    assert bench.orders(bench.device.close) == [hold, watchdog(0)]


@pytest.mark.parametrize("how", ["stopped", "closed"])
def test_jaws_that_move_on_as_their_gripper_fails_are_stopped_by_the_sleep_of_their_drive(
    bench: Bench, how: str
) -> None:
    """Where they are is not known any more, and what hears the bus may still not be heard."""
    bench.device.apply(OPEN_SLOWLY)
    bench.turn(0.3)
    bench.device.apply(Grip("gripper", CLOSED_M, 0.01, 60.0))
    bench.bus.hush = lambda frame: None
    bench.until(Failed, 1.0)
    assert bench.applied(GRIP, OPEN_SLOWLY, HOME) == [], "what has failed is not told to move"
    bench.statuses.clear()
    if how == "stopped":
        assert bench.applied(STOP, STOP) == [SLEEP] * 2
        assert [status.command for status in bench.device.poll() if isinstance(status, Sent)] == [STOP] * 2
    else:
        assert bench.orders(bench.device.close) == [SLEEP]
        assert bench.bus.closed
    stood_m = bench.drive.width_m
    bench.bus.wait(0.3)
    assert bench.drive.current_ma == 0.0
    assert bench.drive.width_m == pytest.approx(stood_m, abs=0.5e-3), "2 mm less, were it not stopped"


def test_what_a_gripper_holds_as_it_fails_stays_with_its_watchdog(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.bus.hush = lambda frame: None
    bench.until(Failed, 1.0)
    assert bench.applied(STOP, STOP) == [], "no frame drops it, and none feeds the watchdog"
    assert bench.orders(bench.device.close) == []
    assert bench.drive.current_ma != 0.0
    bench.bus.wait(1.0)
    assert bench.drive.current_ma == 0.0


@pytest.mark.parametrize(
    ("fault", "error", "line"),
    [
        ("silent", SilentError, "no answer in 2 s .*powered with 24 V, node 0"),
        ("another node", ProtocolError, "frames of others .*is the gripper node 0"),
        ("no gripper", ProtocolError, "3 malformed ones came, .*is the gripper node 0"),
    ],
)
def test_a_bus_without_the_gripper_is_refused(
    make_bench: Make, fault: str, error: type[DeviceError], line: str
) -> None:
    bench = make_bench()
    if fault == "silent":
        bench.bus.hush = lambda frame: None
    elif fault == "another node":
        bench.bus.hush = lambda frame: replace(frame, id=frame.id | 0x80)
    else:
        bench.bus.hush, bench.bus.malformed = lambda frame: None, 3
    with pytest.raises(error, match=line):
        bench.device.open()
    assert bench.bus.closed


def test_frames_of_others_are_passed_over(make_bench: Make) -> None:
    bench = make_bench()
    bench.bus.arrived = [ReceivedFrame(CanFrame(0x123, b"\1"), 0.0)]
    assert bench.device.open().serial == "4848"


# --- commands ------------------------------------------------------------------------------------


def test_a_grip_is_one_frame_and_on_the_bus_when_apply_returns(bench: Bench) -> None:
    bench.turn(0.1)
    before = len(bench.bus.written)
    bench.device.apply(replace(GRIP, force_n=30.0))
    (frame,) = bench.bus.written[before:]
    assert frame.id == 0x7A
    assert frame.data[0] == 202  # 30 mm of 20 to 68: 255 x 38 / 48 = 201.9
    assert int.from_bytes(frame.data[2:4], "big") == 649  # 30 N / 0.0462 N/mA
    assert frame.data[4] == 0xC0


def test_apply_says_what_was_sent_and_when(bench: Bench) -> None:
    quick = bench.device.apply(Release("gripper", 9.0))
    assert isinstance(quick, Release) and quick.speed_m_s == pytest.approx(0.1, rel=0.02)
    assert bench.device.poll() == [Sent(bench.clock.now(), "gripper", quick)]
    listen = Listen("gripper", frozenset({WIDTH, "board.force"}))
    assert bench.device.apply(listen) == listen


def test_home_writes_what_is_missing_and_no_more(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.device.open()
    assert bench.applied(HOME) == [IDLE, CLEAR, watchdog(1000), CALIBRATE]
    bench.turn(3.0)
    assert bench.applied(HOME) == [POLL]
    bench.inject("overheat")
    assert bench.orders(lambda: bench.turn(0.2)).count(ERRORS) == 1
    assert bench.applied(HOME) == [IDLE, CLEAR]
    bench.turn(0.2)
    assert bench.applied(HOME) == [POLL]


@pytest.mark.parametrize("command", [GRIP, OPEN_SLOWLY])
def test_what_cannot_be_done_is_refused_unwritten_with_what_to_do(make_bench: Make, command: Grip) -> None:
    bench = make_bench(calibrated=False)
    bench.device.open()

    def refusal() -> object:
        now_s = bench.clock.now()
        assert bench.applied(command) == []
        (status,) = bench.device.poll()
        assert isinstance(status, Refused)
        assert (status.t_s, status.device) == (now_s, "gripper")
        return status.reason

    assert refusal() == "it does not know its ends; send Home first, with empty jaws"
    bench.device.apply(HOME)
    bench.turn(3.0)
    bench.inject("overheat")
    bench.turn(0.2)
    bench.device.poll()
    assert refusal() == "it has a fault; send Home, which clears it"


# --- stops ---------------------------------------------------------------------------------------


def test_stops_of_a_motion_hold_it_with_its_own_current_and_keep_the_jaws_asked_often(bench: Bench) -> None:
    bench.device.apply(OPEN_SLOWLY)
    bench.turn(0.3)
    seen = position(bench)
    for hold in bench.applied(STOP, STOP):
        assert isinstance(hold, DriveOrder)
        assert (hold.position, hold.current_ma, hold.go) == (seen, STEADY_MA, True)
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1
    assert 45 <= len(bench.orders(lambda: bench.turn(0.5))) <= 52, "they hold: a hundred times a second"


@pytest.mark.parametrize("away_s", [0.16, 0.5])
def test_a_stop_after_the_program_was_away_holds_the_jaws_where_they_are_and_sends_them_not_back(
    bench: Bench, away_s: float
) -> None:
    """At 20 mm/s the latest state is some 3 or 10 mm old."""
    bench.device.apply(OPEN_SLOWLY)
    bench.turn(0.3)
    bench.clock.rest(away_s)
    stopped = bench.drive.closed_share
    bench.device.apply(STOP)
    bench.device.apply(STOP)  # as loop and guard both do
    bench.turn(0.5)
    assert len(bench.take(Standstill)) == 1
    assert bench.drive.closed_share == pytest.approx(stopped, abs=0.01), "half a millimetre"


def test_a_stop_after_an_absence_leads_no_farther_than_the_order_did(bench: Bench) -> None:
    (order,) = bench.applied(Grip("gripper", 0.030, 0.02, 15.0))  # 10 mm: half a second
    bench.turn(0.1)
    bench.clock.rest(0.9)
    assert bench.applied(STOP, STOP) == [order, order]


def test_stops_of_a_held_object_write_no_order_to_the_drive(bench: Bench) -> None:
    hold_the_mug(bench)
    assert bench.applied(STOP, STOP, HOME, STOP) == [POLL] * 4


def test_stops_after_a_fault_was_cleared_wake_no_drive(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.inject("overheat")
    bench.turn(0.1)
    bench.device.apply(STOP)
    bench.turn(0.2)
    bench.device.apply(HOME)
    assert bench.applied(STOP, STOP) == [POLL] * 2
    bench.turn(0.2)
    assert bench.drive.current_ma == 0.0
    assert len(bench.take(Standstill)) == 2


def test_stop_is_answered_before_homing_too(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.device.open()
    bench.device.apply(STOP)
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1


@pytest.mark.parametrize("closes", [False, True])
def test_a_calibration_is_stopped_by_putting_the_drive_to_sleep(make_bench: Make, closes: bool) -> None:
    bench = make_bench(calibrated=False)
    bench.device.open()
    bench.device.apply(HOME)
    bench.turn(0.3)
    if closes:
        assert bench.orders(bench.device.close) == [SLEEP, watchdog(0)]
        return
    assert bench.applied(STOP) == [SLEEP]
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1
    assert bench.drive.current_ma == 0.0


# --- faults --------------------------------------------------------------------------------------


def test_a_host_that_hangs_loses_the_grip_and_says_so_when_it_wakes(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.bus.wait(1.5)
    bench.turn(0.1)
    (stalled,) = bench.take(Stalled)
    assert "watchdog" in stalled.reason
    assert bench.drive.contact_n < 0.6
    bench.device.apply(GRIP)
    bench.turn(0.1)
    assert len(bench.take(Refused)) == 1
    for command, answer in ((HOME, Reached), (GRIP, Gripped)):
        bench.device.apply(command)
        bench.turn(0.5)
        assert len(bench.take(answer)) == 1


def test_home_clears_a_fault_that_is_not_known_yet(bench: Bench) -> None:
    """Between two trials nothing is read: rows, measures and garbage may take longer than the watchdog waits."""
    hold_the_mug(bench)
    bench.bus.wait(1.5)
    bench.device.apply(HOME)
    bench.turn(0.1)
    assert bench.take(Stalled) == []
    assert len(bench.take(Reached)) == 1
    bench.device.apply(GRIP)
    bench.turn(0.5)
    assert len(bench.take(Gripped)) == 1
    bench.bus.wait(1.5)
    bench.turn(0.1)
    assert len(bench.take(Stalled)) == 1, "a later one is reported"


@pytest.mark.parametrize(
    ("fault", "message"), [("over temperature", "too hot"), ("emergency stop", "a fault of its motor")]
)
def test_a_fault_opens_the_grip_and_is_a_stall_once(bench: Bench, fault: str, message: str) -> None:
    hold_the_mug(bench)
    if fault == "over temperature":
        bench.inject("overheat")
    else:
        bench.bus.send(CanFrame(0x000))  # of another host
    bench.turn(0.3)
    (stalled,) = bench.take(Stalled)
    assert message in stalled.reason
    assert bench.drive.contact_n < 0.6
    assert bench.device.account()["faults"] == [fault]


def test_a_power_failure_lets_go_and_is_a_stall_and_home_sets_the_watchdog_again(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.inject("reboot")
    bench.turn(0.2)
    (stalled,) = bench.take(Stalled)
    assert "no longer knows its ends" in stalled.reason
    assert bench.drive.contact_n < 0.6
    bench.device.apply(GRIP)
    bench.turn(0.1)
    assert "does not know its ends" in bench.take(Refused)[0].reason
    bench.place(None)
    bench.device.apply(HOME)
    bench.turn(5.0)
    assert len(bench.take(Reached)) == 1
    hold_the_mug(bench)
    bench.bus.wait(1.5)  # the host hangs
    assert bench.drive.contact_n < 0.6


def test_a_bus_that_is_gone_is_a_failure_once_and_what_it_did_not_take_was_not_sent(bench: Bench) -> None:
    bench.bus.fault = "the bus was taken away"
    bench.device.apply(STOP)
    assert bench.device.poll() == [Failed(bench.clock.now(), "gripper", "the bus was taken away")]
    bench.device.apply(STOP)
    bench.turn(0.1)
    assert [type(status) for status in bench.statuses] == [Refused]


def test_ten_questions_in_a_row_without_an_answer_are_a_failure(bench: Bench) -> None:
    bench.listen(WIDTH, FORCE)
    bench.turn(0.2)
    bench.statuses.clear()
    begin_s = bench.clock.now()
    bench.bus.hush = lambda frame: None
    failed = bench.until(Failed, 2.0)
    assert failed.reason == "no answer to 10 polls in a row; is it powered, and the bus whole?"
    assert failed.t_s - begin_s == pytest.approx(0.55, abs=0.06)
    lost = bench.take(Lost)
    assert [(status.stream, status.samples) for status in lost] == [(FORCE, 1), (WIDTH, 1)] * 10
    assert lost[0].t_s == pytest.approx(begin_s, abs=0.011)
    assert lost[-1].t_s - lost[0].t_s == pytest.approx(0.5, abs=0.06), "each was given up after 50 ms"
    assert bench.device.account()["lost"] == 10


def test_nine_lost_answers_and_one_that_comes_are_no_failure(bench: Bench) -> None:
    for _ in range(6):
        bench.bus.hush = lambda frame: None
        bench.turn(0.4)
        bench.bus.hush = lambda frame: frame
        bench.turn(0.15)
    assert bench.take(Failed) == []


# --- samples -------------------------------------------------------------------------------------


def test_width_and_force_come_ten_milliseconds_apart_with_the_time_of_the_question(bench: Bench) -> None:
    bench.listen(WIDTH, FORCE)
    hold_the_mug(bench)
    bench.turn(0.5)
    widths, forces = bench.blocks_of(WIDTH), bench.blocks_of(FORCE)
    times_s = bench.times(WIDTH)
    assert np.diff(times_s).min() > 0.0
    assert np.median(np.diff(times_s)) == pytest.approx(0.010, abs=5e-4)
    assert [block.seq for block in widths] == [block.seq for block in forces]
    assert forces[-1].physical[-1, 0] == pytest.approx(20.0, abs=0.05), "compression is positive"
    assert widths[-1].physical[-1, 0] == pytest.approx(0.039, abs=0.2e-3)
    # Midway between the question and its answer.
    assert widths[-1].arrival_s - widths[-1].times[-1] == pytest.approx(0.5 * DELAY_S, abs=1e-9)  # type: ignore[operator]
    assert FRAME_S < DELAY_S


def test_a_lost_answer_is_a_reported_jump_and_nothing_is_asked_while_it_may_come(bench: Bench) -> None:
    bench.listen(WIDTH)
    bench.turn(0.2)
    bench.bus.hush = lambda frame: None
    assert 1 <= len(bench.orders(lambda: bench.turn(0.02))) <= 2
    bench.bus.hush = lambda frame: frame
    bench.turn(0.2)
    assert sum(status.samples for status in bench.take(Lost)) == 1
    jumps = [after.seq - before.seq - len(before) for before, after in pairwise(bench.blocks)]
    assert sorted(jumps)[-2:] == [0, 1]


@pytest.mark.parametrize("late_s", [0.06, 0.08, 0.12, 0.2])
@pytest.mark.parametrize("before_s", [0.0, 0.03, 0.06, 0.1])
def test_an_answer_that_was_given_up_and_comes_after_all_is_not_taken_for_a_later_ones(
    bench: Bench, late_s: float, before_s: float
) -> None:
    bench.device.apply(Release("gripper", 0.1))
    bench.turn(0.6)
    bench.place("mug")
    bench.listen(WIDTH)
    bench.bus.late_s = late_s
    bench.turn(before_s)
    bench.device.apply(GRIP)
    bench.turn(late_s + 0.1)
    bench.bus.late_s = 0.0
    bench.turn(0.8)
    (gripped,) = bench.take(Gripped)
    assert gripped.object, "the jaws stood wide open when they were asked, before the command"
