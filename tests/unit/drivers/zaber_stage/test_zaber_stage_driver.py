"""The driver on the emulated stage, in virtual time: what it sends, what it makes of the answers, how it stops."""

import itertools
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import PortError, ProtocolError, RefusedError, SilentError
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Failed,
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
    StreamInfo,
)
from drivers.zaber_stage.codec import LONGEST_S, meaning
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings
from simulator.mocks.base import MemoryLine
from tests.unit.drivers.far_end import Other
from tests.unit.drivers.zaber_stage.stage_bench import EVERYTHING, STEP_M, StageBench, Wire


def driver(line: MemoryLine, **settings: Any) -> ZaberStage:
    return ZaberStage("stage", ZaberStageSettings(port="/dev/stage", **settings), line._clock, line.connect)


class Bench(StageBench):
    """A stage, opened, and its line."""

    def __init__(self, *, homed: bool = True, **settings: Any) -> None:
        wire, clock = Wire(homed=homed), VirtualClock()
        self.line = MemoryLine(wire, clock)
        super().__init__(driver(self.line, **settings), clock, wire)

    def inject(self, kind: str) -> None:
        self.wire.device.inject(kind, self.clock.now())

    @property
    def moves(self) -> int:
        """How often it was sent somewhere."""
        return sum(line.startswith("move abs") for line in self.wire.lines())

    def turn_for_lines(self, count: int) -> None:
        """Turn until so many more lines were sent."""
        target = self.wire.received.count(b"\n") + count
        self.turn_until(lambda: self.wire.received.count(b"\n") >= target)


# opening


def test_opening_identifies_the_stage_sets_its_limits_and_moves_nothing() -> None:
    b = Bench(travel_max_m=0.0124)
    max_speed = round(0.026 / STEP_M * 1.6384)
    details = dict(b.info.details)
    assert details.pop("acceleration_m_s2") == pytest.approx(0.5, rel=1e-2)
    assert details.pop("limits_found_m") == pytest.approx((0.0, 0.0254))
    assert details.pop("limits_set_m") == pytest.approx((0.0, 0.0124), abs=STEP_M)
    stream = StreamInfo("stage.position", ("position",), "m", STEP_M, longest_s=LONGEST_S)
    assert replace(b.info, details=details) == DeviceInfo(
        "stage",
        model="Zaber device 1",
        serial="40001",
        version="7.38",
        streams={"stage.position": stream},
        mover=True,
        details={
            "device_id": "1",
            "pitch_by": "limit.max and travel_m alone: jog 10 mm and measure",
            "serial": "40001",
            "firmware": "7.38",
            "microstep_m": STEP_M,
            "travel_m": 0.0254,
            "max_speed_m_s": 0.025,
            "left_changed_by_another_run": (),
            "flags": (),
            "homed": True,
        },
    )
    asked = ["deviceid", "motion.decelonly", "limit.min", "limit.max"]
    notes = [f"touchbench.{name}" for name in ("comm.checksum", "limit.min", "limit.max", "maxspeed")]
    assert b.wire.lines() == [
        *("00", "get version", "get system.serial"),
        *(f"storage get {note}" for note in notes),
        *("get comm.checksum", f"storage set {notes[0]} 0,1", "set comm.checksum 1", "get comm.checksum"),
        *(f"get {name}" for name in asked),
        *("get limit.min", "get limit.max", f"storage set {notes[2]} 51200,24995", "set limit.max 24995"),
        *("get limit.max", "get maxspeed", f"storage set {notes[3]} {max_speed},82565", "set maxspeed 82565"),
        *("get maxspeed", "warnings clear"),
    ]
    assert b.stage.account() == {"positions": 0, "sent_on": 0, "halted_unseen": 0}


def test_a_stage_without_a_position_reports_it_at_opening() -> None:
    info = Bench(homed=False).info
    assert (info.details["homed"], info.details["flags"]) == (False, ("WR",))


def test_a_stage_that_a_dead_host_left_moving_is_stopped_at_opening() -> None:
    wire = Wire(homed=True)
    wire.receive(b"/1 1 01 move max 8389\n", 0.0)
    driver(MemoryLine(wire, VirtualClock())).open()
    assert wire.lines()[:3] == ["move max 8389", "00", "stop"]
    assert wire.axis.target_m < 0.0254


def test_silence_is_reported_with_what_to_check() -> None:
    wire = Wire()
    wire.silent = True
    with pytest.raises(SilentError, match=r"^stage: no reply in 2.00 s .*powered.*device 1 on its line\?$"):
        driver(MemoryLine(wire, VirtualClock()), reply_timeout_s=0.2).open()


@pytest.mark.parametrize(
    "other",
    [Other(bytes.fromhex("02010602014042 0f0104c0ffff01010401 3c7600")), Other(None)],
    ids=["board", "echo"],
)
def test_another_protocol_is_distinguished_from_silence(other: object) -> None:
    with pytest.raises(
        ProtocolError, match=r"which is no Zaber ASCII while opening; is another device there"
    ):
        driver(MemoryLine(other, VirtualClock()), reply_timeout_s=0.2).open()


@pytest.mark.parametrize(
    "stage",
    [{"microstep_m": 3.175e-6, "travel_m": 0.5}, {"microstep_m": 0.047625e-6}, {"firmware": "6.28"}],
    ids=["belt", "fine screw", "old firmware"],
)
def test_a_stage_that_is_not_the_profiles_is_refused_at_opening_and_left_as_it_was(
    stage: dict[str, Any],
) -> None:
    wire = Wire(homed=True, **stage)
    before = dict(wire.device._values)
    with pytest.raises(RefusedError, match=r"^stage: its (limit.max of|firmware 6.28) .* while opening; "):
        driver(MemoryLine(wire, VirtualClock())).open()
    assert wire.device._values == before
    assert not [line for line in wire.lines() if line.startswith(("move", "home"))]


def test_closing_leaves_the_stage_as_it_was_found() -> None:
    wire, clock = Wire(homed=True), VirtualClock()
    before = dict(wire.device._values)
    b = StageBench(driver(MemoryLine(wire, clock), travel_max_m=0.0124), clock, wire)
    opened = [line for line in wire.lines() if "set" in line.split()[:2]]
    for position_m in (0.002, 0.004, 0.003):
        b.begin(MoveTo("stage", position_m, 0.01))
        b.expect(Reached)
    assert [line for line in wire.lines() if "set" in line.split()[:2]] == opened, (
        "no motion writes a setting"
    )
    assert wire.device._values != before
    b.stage.close()
    assert (wire.device._values, wire.device._storage) == (before, {})


@pytest.mark.parametrize("travel_max_m", [0.0124, 0.0254, 0.006])
def test_what_a_program_that_died_left_changed_is_put_back_by_the_next(travel_max_m: float) -> None:
    """Also by one with another profile, whose travel the leftover limit would not fit."""
    wire, clock = Wire(homed=True), VirtualClock()
    before = dict(wire.device._values)
    StageBench(driver(MemoryLine(wire, clock), travel_max_m=0.0124), clock, wire)  # never closed
    b = StageBench(driver(MemoryLine(wire, clock), travel_max_m=travel_max_m), clock, wire)
    assert b.info.details["left_changed_by_another_run"] == ("comm.checksum", "limit.max", "maxspeed")
    assert b.info.details["limits_found_m"] == pytest.approx((0.0, 0.0254))
    b.stage.close()
    assert (wire.device._values, wire.device._storage) == (before, {})


def test_what_somebody_changed_after_a_program_died_stays_as_it_is() -> None:
    wire, clock = Wire(homed=True), VirtualClock()
    StageBench(driver(MemoryLine(wire, clock), travel_max_m=0.0124), clock, wire)  # never closed
    wire.device.receive(b"/1 1 set maxspeed 70000\n", 0.0)
    wire.device._storage["touchbench.limit.max"] = "nonsense,24995"
    b = StageBench(driver(MemoryLine(wire, clock), travel_max_m=0.0124), clock, wire)
    assert b.info.details["left_changed_by_another_run"] == ("comm.checksum",)
    b.stage.close()
    assert (wire.device._values["maxspeed"], wire.device._storage) == (70000, {})


def test_a_stage_without_storage_is_left_as_it_was_found_too() -> None:
    wire, clock = Wire(homed=True, firmware="7.25"), VirtualClock()
    before = dict(wire.device._values)
    b = StageBench(driver(MemoryLine(wire, clock), travel_max_m=0.0124), clock, wire)
    b.stage.close()
    assert wire.device._values == before


def test_closing_does_not_wait_long_for_a_stage_that_is_silent() -> None:
    b = Bench(reply_timeout_s=0.2)
    b.wire.silent = True
    before_s = b.clock.now()
    b.stage.close()
    assert b.clock.now() - before_s < 0.25


# moving


def test_an_approach_ends_at_its_limit_beyond_which_the_device_is_never_sent() -> None:
    b = Bench()
    b.begin(MoveAt("stage", 0.01, 0.002))
    reached = b.expect(Reached)
    assert [line for line in b.wire.lines() if line.startswith("move")] == ["move abs 4031 33026"]
    assert 0.002 - STEP_M < reached.position_m <= 0.002


def test_a_stop_is_on_the_wire_without_waiting_for_an_answer() -> None:
    b = Bench(retry_s=5.0, reply_timeout_s=10.0)
    b.stage.apply(Listen("stage", EVERYTHING))
    b.begin(MoveAt("stage", 0.01, 0.02))
    b.wire.deaf_to = b"get pos"  # from here on each question for the position hangs
    b.turn_for_lines(1)
    asked = b.wire.received.count(b"get pos")
    b.stage.apply(Stop("stage"))
    b.turn_until(lambda: "stop" in b.wire.lines())
    assert b.wire.received.count(b"get pos") == asked
    b.wire.deaf_to = b"\0"
    assert b.wire.axis.target_m < 0.02


def test_a_stop_is_reported_when_it_is_written_and_when_the_stage_stands_under_its_number() -> None:
    b = Bench()
    b.begin(MoveAt("stage", 0.01, 0.02, id=8))
    b.clock.rest(0.1)
    stop, now_s = Stop("stage", id=9), b.clock.now()
    assert b.stage.apply(stop) == stop
    assert list(b.stage.poll()) == [Sent(now_s, "stage", stop)]
    still = b.expect(Standstill)
    place_m = pytest.approx(b.wire.axis.position(b.clock.now()), abs=STEP_M)
    assert still == Standstill(b.clock.now() - 0.001, "stage", place_m, command_id=9)
    assert not b.wire.axis.moving(still.t_s)
    assert still.t_s < now_s + 0.01 / 0.5 + 0.013, "it is asked every 10 ms whether it stands"
    b.turn_for_lines(5)
    assert b.statuses == []
    assert b.wire.lines().count("stop") == 1


def test_a_newer_stop_takes_the_place_of_one_that_is_not_answered() -> None:
    b = Bench(retry_s=0.1)
    b.wire.deaf_to = b"stop"
    b.stage.apply(Stop("stage", id=1))
    b.stage.apply(Stop("stage", id=2))
    b.turn_until(lambda: b.clock.now() > 0.35)
    assert b.wire.lines().count("stop") == 2 + 3, "the second alone is repeated"
    b.wire.deaf_to = b"\0"
    assert b.expect(Standstill).command_id == 2


def test_a_place_from_before_a_stop_is_no_standstill() -> None:
    b = Bench(retry_s=1.0)
    b.stage.apply(Listen("stage", EVERYTHING))
    b.wire.spoils = "late"
    b.turn_for_lines(1)
    b.stage.apply(Stop("stage"))
    assert b.expect(Standstill).t_s >= 0.15, "the place asked for before came 0.15 s late"


@pytest.mark.parametrize("seen", [True, False], ids=["seen before", "seen by the stop"])
def test_a_stop_whose_end_cannot_be_seen_is_a_failure(seen: bool) -> None:
    b = Bench()
    reason = b.line.fault = "the port was taken away"
    if seen:
        reason = b.expect(Failed).reason
    stop, move, now_s = Stop("stage"), MoveTo("stage", 0.001, 0.01), b.clock.now()
    b.stage.apply(stop)
    answer = Refused(now_s, "stage", stop, reason) if seen else Failed(now_s, "stage", reason)
    assert list(b.stage.poll()) == [answer]
    b.stage.apply(move)
    assert list(b.stage.poll()) == [Refused(now_s, "stage", move, reason)]


def test_a_stop_before_the_stage_is_open_says_that_it_is_not() -> None:
    stage = driver(MemoryLine(Wire(), VirtualClock()))
    stage.apply(Stop("stage"))
    assert list(stage.poll()) == [Refused(0.0, "stage", Stop("stage"), "it is not open")]


def test_nothing_of_an_older_session_is_left_after_it_is_opened_again() -> None:
    b = Bench()
    b.stage.apply(Listen("stage", EVERYTHING))
    b.begin(MoveAt("stage", 0.01, 0.02))
    b.stage.close()
    b.clock.rest(1.0)
    b.stage.open()
    b.turn_until(lambda: b.clock.now() > 3.0)
    assert (b.blocks, b.statuses) == ([], [])
    b.begin(MoveTo("stage", 0.0, 0.01, id=3))
    assert b.expect(Reached).command_id == 3


def test_a_stop_before_an_approach_has_set_out_lets_no_move_follow() -> None:
    b = Bench()
    asked = b.wire.lines().count("warnings clear")
    b.stage.apply(MoveAt("stage", 0.01, 0.002))
    b.turn_until(lambda: b.wire.lines().count("warnings clear") > asked)
    b.stage.apply(Stop("stage"))
    b.expect(Standstill)
    b.turn_for_lines(3)
    assert not [line for line in b.wire.lines() if line.startswith("move")]


def test_a_stop_whose_answer_is_lost_is_sent_again() -> None:
    b = Bench()
    b.begin(MoveAt("stage", 0.005, 0.02))
    # Else the answer to another question is the one that is lost.
    b.turn_until(lambda: not b.stage._dialogue._open)
    b.wire.spoils = "lose"
    b.stage.apply(Stop("stage"))
    b.expect(Standstill)
    assert b.wire.lines().count("stop") >= 2


def test_a_newer_motion_replaces_an_older_one() -> None:
    b = Bench()
    b.begin(MoveTo("stage", 0.01, 0.01))
    b.stage.apply(MoveTo("stage", 0.001, 0.02))
    assert b.expect(Reached).position_m == pytest.approx(0.001, abs=STEP_M)
    assert not [status for status in b.statuses if isinstance(status, Reached)]


# the position


def test_an_unanswered_question_is_a_reported_jump_in_the_sequence() -> None:
    b = Bench()
    b.stage.apply(Listen("stage", EVERYTHING))
    b.turn_until(lambda: len(b.blocks) > 2)
    b.wire.spoils = "lose"
    lost = b.expect(Lost)
    b.turn_for_lines(3)
    b.blocks += b.stage.read()
    jumps = [later.seq - a.seq - len(a) for a, later in itertools.pairwise(b.blocks)]
    assert (lost.stream, lost.samples) == ("stage.position", 1)
    assert sorted(jumps)[-2:] == [0, 1]


@pytest.mark.parametrize("kind", ["bad_lrc", "corrupt", "late"])
def test_a_spoilt_or_late_reply_is_passed_over_like_a_lost_one(kind: str) -> None:
    b = Bench(retry_s=0.05)
    b.stage.apply(Listen("stage", EVERYTHING))
    b.turn_until(lambda: len(b.blocks) > 2)
    b.wire.spoils = kind
    assert b.expect(Lost).samples >= 1
    b.turn_for_lines(20)
    assert not [status for status in b.statuses if isinstance(status, Failed)]
    assert all(block.values.max() == 0 for block in b.blocks)


def test_a_position_has_the_time_at_which_it_was_asked_for_and_is_counted() -> None:
    b = Bench(position_interval_s=0.02)
    listen = Listen("stage", EVERYTHING)
    assert b.stage.apply(listen) == listen
    b.begin(MoveTo("stage", 0.004, 0.01))
    b.turn_until(lambda: b.clock.now() > 0.2)
    b.clock.rest(5.0)  # it halts within its blind travel, and is sent on
    b.expect(Reached)
    b.blocks += b.stage.read()
    for block in b.blocks:
        (t_s,) = block.times
        assert (block.stream, block.rate_hz, block.arrival_s, block.t0_s) == (
            "stage.position",
            None,
            t_s,
            t_s,
        )
        assert block.values.shape == (1, 1) and block.values.dtype == np.int64
    account = b.stage.account()
    assert account == {"positions": len(b.blocks), "sent_on": b.moves - 1, "halted_unseen": 1}
    b.stage.apply(Listen("stage", frozenset()))
    before = len(b.blocks)
    b.turn_for_lines(5)
    assert len(b.blocks) == before


@pytest.mark.parametrize(
    ("commands", "least", "most"),
    [
        ((), 4, 6),
        ((Listen("stage", EVERYTHING),), 80, 101),
        ((MoveAt("stage", 0.005, 0.02),), 80, 101),
        ((Listen("stage", EVERYTHING), Listen("stage", frozenset())), 4, 6),
    ],
    ids=["at rest", "listened to", "moving", "listened to no more"],
)
def test_a_stage_is_asked_often_where_it_moves_or_is_listened_to(
    commands: tuple[Command, ...], least: int, most: int
) -> None:
    b = Bench()
    for command in commands:
        b.stage.apply(command)
    before, until_s = b.wire.lines().count("get pos"), b.clock.now() + 1.0
    b.turn_until(lambda: b.clock.now() > until_s)
    assert least <= b.wire.lines().count("get pos") - before <= most


def test_a_place_on_the_other_side_of_the_home_end_is_negative() -> None:
    b = Bench()
    b.wire.axis.place(b.clock.now(), -10 * STEP_M)
    b.stage.apply(Listen("stage", EVERYTHING))
    b.turn_until(lambda: len(b.blocks) > 0)
    assert b.blocks[0].values.tolist() == [[-10]]


# what goes wrong


def test_a_stall_is_reported() -> None:
    b = Bench()
    b.begin(MoveAt("stage", 0.005, 0.02))
    b.inject("stall")
    assert b.expect(Stalled).reason == "it stalled (FS)"
    b.begin(MoveTo("stage", 0.0, 0.02))
    b.expect(Reached)


def test_a_movement_that_a_hand_ended_did_not_reach_its_target() -> None:
    b = Bench()
    b.begin(MoveTo("stage", 0.02, 0.005))
    b.inject("interrupt")
    assert "on the way to 0.0" in b.expect(Stalled).reason


def test_a_rejected_movement_is_refused_with_the_devices_reason() -> None:
    b = Bench()
    b.inject("refuse")
    b.stage.apply(MoveTo("stage", 0.002, 0.005))
    refused = b.expect(Refused)
    assert "STATUSBUSY" in refused.reason
    assert refused.command == MoveTo("stage", 0.002, 0.005)


def test_a_stage_that_is_not_sent_on_any_more_stalls() -> None:
    b = Bench()
    b.begin(MoveAt("stage", 0.005, 0.02, id=6))
    b.turn_until(lambda: b.stage._motion is not None)
    b.inject("refuse")
    stalled = b.expect(Stalled)
    assert stalled.command_id == 6
    assert re.fullmatch(r"it rejects 'move abs \d+ 16513' with STATUSBUSY", stalled.reason)
    b.turn_for_lines(5)
    assert b.statuses == []


def test_a_stage_that_is_homed_and_still_does_not_know_where_it_is_stalls() -> None:
    b = Bench(homed=False)
    b.wire.axis.place(b.clock.now(), 0.005)
    b.begin(Home("stage", id=6))
    b.wire.device._homing = False
    stalled = b.expect(Stalled)
    assert (stalled.command_id, stalled.reason) == (
        6,
        f"it came to rest on its way home: {meaning('WR')} (WR)",
    )


@pytest.mark.parametrize("homed", [True, False], ids=["homed before", "not homed before"])
@pytest.mark.parametrize("by", ["a knob", "another master"])
def test_a_way_home_that_something_interrupted_did_not_reach_home(homed: bool, by: str) -> None:
    """NI: a movement was requested while another one was going on, which did not complete (Zaber ASCII)."""
    b = Bench(homed=homed)
    b.wire.axis.place(b.clock.now(), 0.01)
    b.begin(Home("stage", id=6))
    b.turn_until(lambda: b.stage._motion is not None)
    if by == "a knob":
        b.inject("interrupt")
    else:
        b.wire.receive(b"/1 1 move vel 8389\n" if homed else b"/1 1 stop\n", b.clock.now())
    stalled = b.expect(Stalled)
    flag = "NI" if homed else "WR"
    assert (stalled.command_id, stalled.reason) == (
        6,
        f"it came to rest on its way home: {meaning(flag)} ({flag})",
    )
    b.begin(Home("stage", id=7))
    assert b.expect(Reached).command_id == 7, "it is asked anew, and what was before does not count"


@pytest.mark.parametrize("graver", ["WV", "WT"])
def test_a_graver_warning_hides_no_interrupted_way_home_and_is_none_itself(graver: str) -> None:
    b = Bench()
    b.wire.device._flags.add(graver)
    b.wire.axis.place(b.clock.now(), 0.01)
    b.begin(Home("stage", id=6))
    b.turn_until(lambda: b.stage._motion is not None)
    b.inject("interrupt")
    assert b.expect(Stalled).reason == f"it came to rest on its way home: {meaning('NI')} (NI)"
    b.begin(Home("stage", id=7))
    assert b.expect(Reached).command_id == 7


@pytest.mark.parametrize("flag", ["WS", "WL"])
def test_a_stage_that_stalled_and_went_on_or_met_a_switch_has_stalled(flag: str) -> None:
    b = Bench()
    b.begin(MoveTo("stage", 0.01, 0.01))
    b.wire.device._flags.add(flag)
    assert b.expect(Stalled).reason == f"{meaning(flag)} ({flag})"


def test_a_home_whose_reply_is_lost_interrupts_itself_and_reaches_home() -> None:
    """It is written again while the stage is on its way: the device flags what the first one began (NI)."""
    b = Bench()
    b.wire.axis.place(b.clock.now(), 0.01)
    b.wire.loses = b" home"
    b.begin(Home("stage", id=6))
    reached = b.expect(Reached)
    assert (reached.command_id, reached.position_m) == (6, 0.0)
    assert b.wire.lines().count("home") == 2
    assert b.statuses == []


def test_a_stop_on_the_way_home_is_answered_and_what_became_of_the_way_is_not_asked() -> None:
    b = Bench()
    b.begin(Home("stage", id=6))
    b.turn_until(lambda: b.stage._rest is not None)
    b.stage.apply(Stop("stage", id=7))
    assert b.expect(Standstill).command_id == 7
    assert b.statuses == []


def test_a_stage_that_is_sent_home_from_a_motion_of_ours_reaches_home() -> None:
    """The way home interrupts that motion, and the device flags it (NI)."""
    b = Bench()
    b.begin(MoveAt("stage", 0.005, 0.02))
    b.turn_until(lambda: b.wire.axis.position(b.clock.now()) > 0.001)
    b.begin(Home("stage", id=6))
    reached = b.expect(Reached)
    assert (reached.command_id, reached.position_m) == (6, 0.0)
    assert b.statuses == []


def test_a_stage_that_is_home_before_it_is_asked_what_it_interrupted_reached_home() -> None:
    """The host was late: the way home that interrupted a motion of ours is over, and the device still flags it."""
    b = Bench()
    b.wire.axis.place(b.clock.now(), 0.002)
    b.begin(MoveTo("stage", 0.0, 0.02))
    b.turn_until(lambda: b.wire.axis.position(b.clock.now()) < 0.0006)
    b.wire.loses = b" warnings:"
    b.begin(Home("stage", id=6))
    reached = b.expect(Reached)
    assert b.wire.lines().count("warnings") == 3, "one was lost, one came late, one is asked at rest"
    assert (reached.command_id, reached.position_m) == (6, 0.0)
    assert b.statuses == []


def test_a_place_that_is_no_number_is_a_failure() -> None:
    b = Bench()
    b.wire.device._readings["pos"] = lambda t_s: "NA"
    assert b.expect(Failed).reason == "it answers 'get pos' with 'NA'; is this a linear stage?"


def test_a_stage_at_rest_stalls_for_no_command() -> None:
    b = Bench()
    b.inject("disable")
    stalled = b.expect(Stalled)
    assert (stalled.command_id, stalled.reason) == (0, "its driver is disabled (FD)")


def test_silence_is_a_failure_that_names_what_went_on_and_the_port() -> None:
    b = Bench(reply_timeout_s=0.3)
    b.begin(MoveAt("stage", 0.002, 0.02))
    b.turn_until(lambda: b.stage._motion is not None)
    b.wire.silent = True
    reason = b.expect(Failed).reason
    assert reason == "no reply in 0.30 s while moving to 0.02 m; is the cable in /dev/stage?"
    b.stage.apply(MoveTo("stage", 0.0, 0.01))
    assert b.expect(Refused).reason == reason
    for stop in (Stop("stage", id=3), Stop("stage", id=4)):  # it may hear what is not heard of it
        b.stage.apply(stop)
        assert b.expect(Sent).command_id == stop.id
    assert b.wire.lines().count("stop") == 2
    assert not b.wire.axis.moving(b.clock.now() + 0.1)


@pytest.mark.parametrize(("command", "doing"), [(None, "standing"), (Home("stage"), "homing")])
def test_a_stage_that_falls_silent_is_noticed_with_and_without_a_command(
    command: Command | None, doing: str
) -> None:
    b = Bench(reply_timeout_s=0.2, idle_interval_s=0.05)
    b.wire.axis.place(b.clock.now(), 0.005)
    if command is not None:
        b.begin(command)
    b.wire.silent = True
    assert f"while {doing}" in b.expect(Failed).reason


def test_closing_stops_a_stage_that_moves() -> None:
    b = Bench()
    b.begin(MoveAt("stage", 0.002, 0.02))
    b.stage.close()
    assert "stop" in b.wire.lines()
    assert not b.wire.axis.moving(b.clock.monotonic_s() + 0.1)


def test_a_line_that_goes_while_the_stage_is_asked_is_a_port_error() -> None:
    wire, clock = Wire(), VirtualClock()
    line = MemoryLine(wire, clock)

    def pulled(data: bytes, t_s: float) -> bytes:
        line.fault = "the port was taken away"
        return b""

    wire.receive = pulled  # type: ignore[method-assign]
    with pytest.raises(PortError, match="/dev/stage: the port was taken away"):
        driver(line).open()
