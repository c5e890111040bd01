"""The gripper's driver on an emulated gripper, in virtual time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from drivers.core.can_frame import CanFrame
from drivers.core.errors import PortError, ProtocolError, SilentError
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
from tests.unit.drivers.can_gripper.gripper_bench import Bench

GRIP = Grip("gripper", 0.020, 0.1, 20.0)
WIDTH, FORCE = "gripper.width", "gripper.force"

Make = Callable[..., Bench]


def hold_the_mug(bench: Bench) -> Gripped:
    bench.apply(Release("gripper", 0.1))
    bench.turn(0.6)
    assert len(bench.take(Reached)) == 1
    bench.place("mug")
    bench.apply(GRIP)
    bench.turn(0.5)
    (gripped,) = bench.take(Gripped)
    assert isinstance(gripped, Gripped)
    return gripped


def test_open_identifies_itself_and_moves_nothing(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    before_m = bench.drive.jaws.width_m
    info = bench.open()
    bench.turn(0.5)
    assert (info.serial, info.mover, set(info.streams)) == ("4848", True, {WIDTH, FORCE})
    assert info.details["open_width_m"] == pytest.approx(0.058)
    assert info.details["supply_v"] == pytest.approx(24.0)
    assert info.details["calibrated"] is False
    assert bench.drive.jaws.width_m == before_m
    assert bench.statuses == []


def test_open_leaves_a_grip_as_it_is_and_stops_a_motion(make_bench: Make) -> None:
    bench = make_bench()
    bench.open()
    hold_the_mug(bench)
    bench.driver.close()
    bench.host.advance(30.0)
    bench.open()
    assert bench.drive.jaws.contact_n == pytest.approx(20.0, abs=0.6)
    bench.apply(Release("gripper", 0.01))
    bench.turn(0.5)
    bench.driver._failure = "the program was killed"
    bench.driver.close()
    bench.open()
    bench.turn(0.5)
    assert abs(bench.drive.jaws.rate_m_s) < 1e-4
    assert bench.drive.jaws.width_m < 0.055


def test_homing_calibrates_where_the_ends_are_not_known(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    bench.apply(Home("gripper"))
    bench.turn(1.0)
    assert bench.take(Reached) == []
    bench.turn(2.0)
    (reached,) = bench.take(Reached)
    assert isinstance(reached, Reached)
    assert reached.position_m == pytest.approx(0.010)
    assert bench.drive.calibrated


def test_homing_again_leaves_what_is_held(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.apply(Home("gripper"))
    bench.turn(0.2)
    assert len(bench.take(Reached)) == 1
    assert bench.drive.jaws.contact_n == pytest.approx(20.0, abs=0.6)


def test_a_calibration_that_never_ends_is_a_stall(make_bench: Make, monkeypatch: pytest.MonkeyPatch) -> None:
    bench = make_bench(calibrated=False)
    monkeypatch.setattr(bench.drive, "calibrate", lambda: None)
    bench.open()
    bench.apply(Home("gripper"))
    bench.turn(33.0)
    (stalled,) = bench.take(Stalled)
    assert isinstance(stalled, Stalled)
    assert "gave up its calibration" in stalled.reason


@pytest.mark.parametrize("command", [GRIP, Release("gripper", 0.05)])
def test_nothing_is_gripped_before_homing(make_bench: Make, command: Grip) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    bench.apply(command)
    (refused,) = bench.take(Refused) or bench.driver.poll()
    assert isinstance(refused, Refused)
    assert "send Home first" in refused.reason


def test_an_object_is_gripped_with_the_force_that_was_asked_for(bench: Bench) -> None:
    gripped = hold_the_mug(bench)
    assert gripped.object
    assert gripped.force_n == pytest.approx(20.0, abs=0.05)
    assert gripped.width_m == pytest.approx(0.039, abs=0.2e-3), "40 mm, squeezed by 20 N at 20 kN/m"
    assert bench.drive.jaws.contact_n == pytest.approx(20.0, abs=0.6), "friction is half a newton"


def test_a_grip_is_one_frame_and_on_the_bus_when_apply_returns(bench: Bench) -> None:
    bench.turn(0.1)
    before = len(bench.host.sent)
    bench.apply(replace(GRIP, force_n=30.0))
    (frame,) = bench.host.sent[before:]
    assert frame.id == 0x7A
    assert frame.data[0] == 202  # 20 mm of 10 to 58: 255 x 38 / 48 = 201.9
    assert int.from_bytes(frame.data[2:4], "big") == 649  # 30 N / 0.0462 N/mA
    assert frame.data[4] == 0xC0


def test_a_second_grip_tightens(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.apply(replace(GRIP, force_n=40.0))
    bench.turn(0.3)
    (gripped,) = bench.take(Gripped)
    assert isinstance(gripped, Gripped)
    assert gripped.object
    assert bench.drive.jaws.contact_n == pytest.approx(40.0, abs=0.6)


def test_jaws_that_meet_nothing_say_so(bench: Bench) -> None:
    bench.apply(GRIP)
    bench.turn(1.0)
    (gripped,) = bench.take(Gripped)
    assert isinstance(gripped, Gripped)
    assert not gripped.object
    assert gripped.width_m == pytest.approx(0.020, abs=0.2e-3)


def test_a_lost_object_is_reported(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.place(None)
    bench.turn(0.5)
    (gripped,) = bench.take(Gripped)
    assert isinstance(gripped, Gripped)
    assert not gripped.object


def test_release_opens_fully_and_lets_go(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.apply(Release("gripper", 0.1))
    bench.turn(0.5)
    (reached,) = bench.take(Reached)
    assert isinstance(reached, Reached)
    assert reached.position_m == pytest.approx(0.058)
    assert bench.drive.jaws.contact_n == 0.0


def test_jaws_that_cannot_open_have_stalled(bench: Bench) -> None:
    bench.apply(Release("gripper", 0.02))
    bench.turn(0.2)
    bench.host.gripper.inject("stall", bench.host.now_s)
    bench.turn(0.5)
    (stalled,) = bench.take(Stalled)
    assert isinstance(stalled, Stalled)
    assert "something holds its jaws" in stalled.reason


def test_stop_holds_the_jaws_where_they_are(bench: Bench) -> None:
    bench.apply(Release("gripper", 0.02))
    bench.turn(0.5)
    bench.apply(Stop("gripper"))
    bench.turn(0.5)
    (still,) = bench.take(Standstill)
    assert isinstance(still, Standstill)
    assert still.position_m == pytest.approx(0.020, abs=0.001), "10 mm in half a second from the closed end"
    width_m = bench.drive.jaws.width_m
    bench.turn(0.5)
    assert bench.drive.jaws.width_m == pytest.approx(width_m, abs=1e-5)
    assert bench.take(Reached) == []


def test_stop_keeps_what_is_held(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.apply(Stop("gripper"))
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1
    assert bench.drive.jaws.contact_n == pytest.approx(20.0, abs=0.6)


def test_stops_of_a_held_object_write_no_order_to_the_drive(bench: Bench) -> None:
    hold_the_mug(bench)
    before = len(bench.host.sent)
    for command in (Stop("gripper"), Stop("gripper"), Home("gripper"), Stop("gripper")):
        bench.apply(command)
    assert [frame.data for frame in bench.host.sent[before:]] == [b""] * 4


def test_two_stops_of_a_motion_stop_it_with_its_own_current(bench: Bench) -> None:
    bench.apply(Release("gripper", 0.02))
    bench.turn(0.2)
    before = len(bench.host.sent)
    bench.apply(Stop("gripper"))
    bench.apply(Stop("gripper"))
    for frame in bench.host.sent[before:]:
        assert int.from_bytes(frame.data[2:4], "big") == 324  # 15 N / 0.0462 N/mA
        assert frame.data[4] == 0xC0
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1


def test_stops_after_a_fault_was_cleared_wake_no_drive(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.host.gripper.inject("overheat", bench.host.now_s)
    bench.turn(0.1)
    bench.apply(Stop("gripper"))
    bench.turn(0.2)
    bench.apply(Home("gripper"))
    before = len(bench.host.sent)
    bench.apply(Stop("gripper"))
    bench.apply(Stop("gripper"))
    assert [frame.data for frame in bench.host.sent[before:]] == [b""] * 2
    bench.turn(0.2)
    assert bench.drive.current_ma == 0.0
    assert len(bench.take(Standstill)) == 2


def test_stop_is_answered_before_homing_too(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    bench.apply(Stop("gripper"))
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1


def test_stop_breaks_a_calibration_off(make_bench: Make) -> None:
    bench = make_bench(calibrated=False)
    bench.open()
    bench.apply(Home("gripper"))
    bench.turn(0.3)
    bench.apply(Stop("gripper"))
    bench.turn(0.3)
    assert len(bench.take(Standstill)) == 1
    assert bench.drive.current_ma == 0.0


def test_a_host_that_hangs_loses_the_grip_and_says_so_when_it_wakes(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.host.advance(1.5)
    bench.turn(0.1)
    (stalled,) = bench.take(Stalled)
    assert isinstance(stalled, Stalled)
    assert "watchdog" in stalled.reason
    assert bench.drive.jaws.contact_n < 0.6
    bench.apply(GRIP)
    bench.turn(0.1)
    assert len(bench.take(Refused)) == 1
    bench.apply(Home("gripper"))
    bench.turn(0.1)
    assert len(bench.take(Reached)) == 1
    bench.apply(GRIP)
    bench.turn(0.5)
    assert len(bench.take(Gripped)) == 1


def test_home_clears_a_fault_that_is_not_known_yet(bench: Bench) -> None:
    """Between two trials nothing is read: rows, measures and garbage may take longer than the watchdog waits."""
    hold_the_mug(bench)
    bench.host.advance(1.5)
    bench.apply(Home("gripper"))
    bench.turn(0.1)
    assert bench.take(Stalled) == []
    assert len(bench.take(Reached)) == 1
    bench.apply(GRIP)
    bench.turn(0.5)
    assert len(bench.take(Gripped)) == 1
    bench.host.advance(1.5)
    bench.turn(0.1)
    assert len(bench.take(Stalled)) == 1, "a later one is reported"


@pytest.mark.parametrize(("fault", "message"), [("overheat", "too hot")])
def test_a_fault_opens_the_grip_and_is_a_stall(bench: Bench, fault: str, message: str) -> None:
    hold_the_mug(bench)
    bench.host.gripper.inject(fault, bench.host.now_s)
    bench.turn(0.1)
    (stalled,) = bench.take(Stalled)
    assert isinstance(stalled, Stalled)
    assert message in stalled.reason
    assert bench.drive.jaws.contact_n < 0.6
    assert bench.driver.account()["faults"] == ["over temperature"]


def test_an_emergency_stop_of_another_host_is_a_stall_once(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.host.send(CanFrame(0x000))
    bench.turn(0.3)
    assert len(bench.take(Stalled)) == 1
    assert bench.driver.account()["faults"] == ["emergency stop"]


def test_a_power_failure_is_seen_as_lost_ends(bench: Bench) -> None:
    bench.host.gripper.inject("reboot", bench.host.now_s)
    bench.turn(0.2)
    bench.apply(GRIP)
    bench.turn(0.1)
    (refused,) = bench.take(Refused)
    assert isinstance(refused, Refused)
    assert "does not know its ends" in refused.reason


def test_width_and_force_come_ten_milliseconds_apart_with_the_time_of_the_question(bench: Bench) -> None:
    bench.apply(Listen("gripper", frozenset({WIDTH, FORCE})))
    hold_the_mug(bench)
    bench.turn(0.5)
    widths = [block for block in bench.blocks if block.stream == WIDTH]
    forces = [block for block in bench.blocks if block.stream == FORCE]
    times_s = np.concatenate([block.times for block in widths])
    assert np.diff(times_s).min() > 0.0
    assert np.median(np.diff(times_s)) == pytest.approx(0.010, abs=5e-4)
    assert [block.seq for block in widths] == [block.seq for block in forces]
    assert forces[-1].physical[-1, 0] == pytest.approx(20.0, abs=0.05), "compression is positive"
    assert widths[-1].physical[-1, 0] == pytest.approx(0.039, abs=0.2e-3)


def test_a_lost_answer_is_a_reported_jump_in_the_sequence(bench: Bench) -> None:
    bench.apply(Listen("gripper", frozenset({WIDTH})))
    bench.turn(0.2)
    bench.host.spoil = lambda frame: None
    bench.turn(0.02)
    bench.host.spoil = lambda frame: frame
    bench.turn(0.2)
    lost = bench.take(Lost)
    assert sum(status.samples for status in lost if isinstance(status, Lost)) == 1
    ends = [block.seq + len(block) for block in bench.blocks]
    jumps = [block.seq - end for block, end in zip(bench.blocks[1:], ends, strict=False)]
    assert sorted(jumps)[-2:] == [0, 1]


@pytest.mark.parametrize("late_s", [0.06, 0.08, 0.12, 0.2])
@pytest.mark.parametrize("before_s", [0.0, 0.03, 0.06, 0.1])
def test_an_answer_that_was_given_up_and_comes_after_all_is_not_taken_for_a_later_ones(
    bench: Bench, late_s: float, before_s: float
) -> None:
    bench.apply(Release("gripper", 0.1))
    bench.turn(0.6)
    bench.place("mug")
    bench.apply(Listen("gripper", frozenset({WIDTH})))
    bench.host.late_s = late_s
    bench.turn(before_s)
    bench.apply(GRIP)
    bench.turn(late_s + 0.1)
    bench.host.late_s = 0.0
    bench.turn(0.8)
    (gripped,) = bench.take(Gripped)
    assert isinstance(gripped, Gripped)
    assert gripped.object, "the jaws stood wide open when they were asked, before the command"


def test_nothing_is_sent_without_a_subscriber(bench: Bench) -> None:
    bench.turn(0.3)
    assert bench.blocks == []


def test_at_rest_it_is_asked_ten_times_a_second_only(bench: Bench) -> None:
    bench.turn(0.2)
    before = len(bench.host.sent)
    bench.turn(2.0)
    assert 15 <= len(bench.host.sent) - before <= 22


def test_silence_is_a_failure(bench: Bench) -> None:
    bench.host.gripper.inject("silent", bench.host.now_s)
    bench.turn(2.0)
    (failed,) = bench.take(Failed)
    assert isinstance(failed, Failed)
    assert "no answer" in failed.reason


def test_a_bus_that_is_gone_is_a_failure_once(bench: Bench) -> None:
    bench.host.fault = "the bus was taken away"
    bench.turn(0.2)
    assert len(bench.take(Failed)) == 1
    bench.apply(Stop("gripper"))
    bench.turn(0.1)
    assert len(bench.take(Refused)) == 1


def test_close_keeps_the_grip_and_switches_the_watchdog_off(bench: Bench) -> None:
    hold_the_mug(bench)
    bench.driver.close()
    bench.driver.close()
    assert bench.host.closed
    bench.host.advance(10.0)
    assert bench.drive.jaws.contact_n == pytest.approx(20.0, abs=0.6)


def test_close_stops_a_motion(bench: Bench) -> None:
    bench.apply(Release("gripper", 0.01))
    bench.turn(0.5)
    bench.driver.close()
    bench.host.advance(5.0)
    assert bench.drive.jaws.width_m < 0.02


def test_an_empty_bus_is_silence(make_bench: Make) -> None:
    bench = make_bench()
    bench.host.gripper.inject("silent", bench.host.now_s)
    with pytest.raises(SilentError, match=r"^gripper: no answer in 0.2 s .*powered with 24 V, node 0"):
        bench.open()
    assert bench.host.closed


def test_another_node_on_the_bus_is_no_gripper(make_bench: Make) -> None:
    bench = make_bench()
    bench.host.spoil = lambda frame: replace(frame, id=frame.id | 0x80)
    with pytest.raises(ProtocolError, match="is the gripper node 0"):
        bench.open()


def test_a_bus_that_goes_while_opening_is_a_port_error(make_bench: Make) -> None:
    bench = make_bench()
    bench.host.fault = "the bus was taken away"
    with pytest.raises(PortError, match="taken away"):
        bench.open()


def test_a_sent_command_is_reported(bench: Bench) -> None:
    bench.apply(GRIP)
    bench.turn(0.05)
    (sent,) = bench.take(Sent)
    assert isinstance(sent, Sent)
    assert isinstance(sent.command, Grip)
