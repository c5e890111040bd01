"""The real driver, with real pyserial, against the emulated stage on a pty."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from typing import Any, Protocol, TypeVar

import pytest

from drivers.bench_clock import BenchClock
from drivers.clock import WallClock
from drivers.errors import PortError, ProtocolError, RefusedError, SilentError
from drivers.messages import (
    Command,
    Failed,
    Home,
    Listen,
    Lost,
    MoveAt,
    MoveTo,
    Reached,
    Refused,
    SampleBlock,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
)
from drivers.mock.devices.zaber_stage import EmulatedZaberStage, EmulatedZaberStageSettings, Fault
from drivers.mock.physics.stage_axis import StageAxis
from drivers.zaber_stage.driver import ZaberStage
from drivers.zaber_stage.mounting import ZaberStageSettings

S = TypeVar("S", bound=Status)
STEP_M = 0.49609375e-6
EVERYTHING = frozenset({"stage.position"})


class Serve(Protocol):
    """The fixture `serve` of conftest.py."""

    clock: BenchClock

    def __call__(self, device: Any) -> str: ...

    def lock(self, port: str) -> Any: ...

    def unplug(self, port: str) -> None: ...


class Wire:
    """The emulated stage with an ear on its line."""

    def __init__(self, **settings: Any) -> None:
        self.axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026)
        self.device = EmulatedZaberStage(EmulatedZaberStageSettings(**settings), self.axis)
        self.heard = b""
        self.deaf_to = b"\0"

    def receive(self, data: bytes, t_s: float) -> bytes:
        self.heard += data
        return b"" if self.deaf_to in data else self.device.receive(data, t_s)

    def step(self, t_s: float) -> bytes:
        return self.device.step(t_s)

    def lines(self) -> list[str]:
        """What was said to it, without device, axis, id and checksum."""
        return [line.partition(b":")[0].decode().split(" ", 3)[-1] for line in self.heard.splitlines()]


class Bench:
    """A stage, opened, and its wire."""

    def __init__(self, serve: Serve, *, homed: bool = True, **settings: Any) -> None:
        self.wire = Wire(homed=homed)
        self.serve = serve
        self.clock = serve.clock
        self.port = serve(self.wire)
        # Patient, for a machine with other work: a reply that is late by half a second is no loss here.
        patient = {"retry_s": 0.5, "reply_timeout_s": 5.0}
        self.stage = ZaberStage(
            "stage", ZaberStageSettings(port=self.port, **patient | settings), serve.clock
        )
        self.info = self.stage.open()
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def inject(self, kind: Fault) -> None:
        with self.serve.lock(self.port):
            self.wire.device.inject(kind, self.clock.monotonic_s())

    def turn_until(self, condition: Callable[[], bool]) -> None:
        until_s = self.clock.monotonic_s() + 8.0
        while not condition():
            assert self.clock.monotonic_s() < until_s, f"not within 8 s; statuses: {self.statuses}"
            self.blocks += self.stage.read()
            self.statuses += self.stage.poll()
            self.clock.rest(0.001)

    def expect(self, kind: type[S]) -> S:
        """The next status of a kind; those before it are forgotten."""
        self.turn_until(lambda: any(isinstance(status, kind) for status in self.statuses))
        while True:
            status = self.statuses.pop(0)
            if isinstance(status, kind):
                return status

    def turn_for_lines(self, count: int) -> None:
        """Turn until so many more lines were said."""
        target = self.wire.heard.count(b"\n") + count
        self.turn_until(lambda: self.wire.heard.count(b"\n") >= target)

    def begin(self, command: Command) -> Sent:
        """Apply a motion and wait until it is on the wire."""
        self.stage.apply(command)
        return self.expect(Sent)


@pytest.fixture
def bench(serve: Serve) -> Iterator[Callable[..., Bench]]:
    opened: list[Bench] = []

    def make(**settings: Any) -> Bench:
        opened.append(Bench(serve, **settings))
        return opened[-1]

    yield make
    for each in opened:
        each.stage.close()


# opening


def test_opening_identifies_the_stage_sets_its_limits_and_moves_nothing(bench: Callable[..., Bench]) -> None:
    b = bench(travel_max_m=0.0124)
    assert (b.info.model, b.info.serial, b.info.version) == ("Zaber device 50081", "40001", "7.38")
    assert b.info.details["homed"] is True
    assert b.info.details["checksums"] is True
    assert b.info.details["limits_found_m"] == pytest.approx((0.0, 0.0254))
    assert b.info.details["limits_set_m"] == pytest.approx((0.0, 0.0124), abs=STEP_M)
    assert not [line for line in b.wire.lines() if line.startswith(("move", "home"))]
    assert b.wire.axis.position(b.clock.monotonic_s()) == 0.0


def test_a_stage_that_a_dead_host_left_moving_is_stopped_at_opening(serve: Serve) -> None:
    wire = Wire(homed=True)
    wire.receive(b"/1 1 01 move max 8389\n", serve.clock.monotonic_s())
    stage = ZaberStage("stage", ZaberStageSettings(port=serve(wire)), serve.clock)
    stage.open()
    stage.close()
    assert wire.axis.target_m < 0.0254


def test_silence_is_told_with_what_to_check(serve: Serve) -> None:
    wire = Wire()
    wire.device.inject("silent", 0.0)
    settings = ZaberStageSettings(port=serve(wire), reply_timeout_s=0.2)
    with pytest.raises(SilentError, match=r"^stage: no reply in 0.20 s .*powered.*device 1 on its line\?$"):
        ZaberStage("stage", settings, serve.clock).open()


def test_another_address_is_silence(serve: Serve) -> None:
    settings = ZaberStageSettings(port=serve(Wire()), address=2, reply_timeout_s=0.2)
    with pytest.raises(SilentError, match="device 2 on its line"):
        ZaberStage("stage", settings, serve.clock).open()


class Board:
    """Something else on the port: frames of another protocol, unasked."""

    def receive(self, data: bytes, t_s: float) -> bytes:
        return b""

    def step(self, t_s: float) -> bytes:
        return bytes.fromhex("02010602014042 0f0104c0ffff01010401 3c7600")


class Echo:
    """A line that is looped back."""

    def receive(self, data: bytes, t_s: float) -> bytes:
        return data

    def step(self, t_s: float) -> bytes:
        return b""


@pytest.mark.parametrize("other", [Board(), Echo()], ids=["board", "echo"])
def test_another_protocol_is_told_from_silence(serve: Serve, other: object) -> None:
    settings = ZaberStageSettings(port=serve(other), reply_timeout_s=0.2)
    with pytest.raises(
        ProtocolError, match=r"which is no Zaber ASCII while opening; is another device there"
    ):
        ZaberStage("stage", settings, serve.clock).open()


def test_a_stage_that_is_shorter_than_the_profile_says_is_refused_at_opening(
    bench: Callable[..., Bench],
) -> None:
    with pytest.raises(RefusedError, match=r"'set limit.max \d+' with BADDATA.*profile"):
        bench(travel_max_m=0.05)


def test_after_a_failed_opening_the_port_is_free_again(serve: Serve) -> None:
    wire = Wire()
    wire.device.inject("silent", 0.0)
    port = serve(wire)
    stage = ZaberStage("stage", ZaberStageSettings(port=port, reply_timeout_s=0.2), serve.clock)
    with pytest.raises(SilentError):
        stage.open()
    with serve.lock(port):
        wire.device.mend()
    assert stage.open().mover
    stage.close()
    stage.close()


def test_an_absent_port_is_a_port_error() -> None:
    with pytest.raises(PortError, match="does not exist"):
        ZaberStage("stage", ZaberStageSettings(port="/dev/ttyNONE"), WallClock()).open()


# moving


def test_a_move_before_homing_is_refused_and_says_what_to_do(bench: Callable[..., Bench]) -> None:
    b = bench(homed=False)
    b.stage.apply(MoveTo("stage", 0.001, 0.01))
    assert b.expect(Refused).reason == "it does not know where it is; send Home first"
    b.begin(Home("stage"))
    assert b.expect(Reached).position_m == 0.0
    b.begin(MoveTo("stage", 0.001, 0.01))
    assert b.expect(Reached).position_m == pytest.approx(0.001, abs=STEP_M)


def test_an_approach_ends_at_its_limit_which_the_device_holds_itself(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveAt("stage", 0.01, 0.002))
    reached = b.expect(Reached)
    said = b.wire.lines()
    begun = said.index("warnings clear", said.index("set limit.max 4031") - 1)
    assert said[begun : begun + 5] == [
        "warnings clear",
        "set limit.max 4031",
        "get limit.max",
        "get pos",
        "move abs 4031 33026",
    ]
    assert 0.002 - STEP_M < reached.position_m <= 0.002


def test_a_host_that_dies_leaves_a_stage_that_halts_within_its_blind_travel(
    bench: Callable[..., Bench],
) -> None:
    b = bench()
    b.begin(MoveAt("stage", 0.01, 0.003))
    b.clock.rest(0.1)
    plan = b.wire.axis.pieces(b.clock.monotonic_s())  # nobody says anything from here on
    assert plan[-1].position_m == pytest.approx(0.002, abs=STEP_M)
    assert plan[-1].velocity_m_s == plan[-1].acceleration_m_s2 == 0.0


def test_a_stop_is_on_the_wire_without_waiting_for_an_answer(bench: Callable[..., Bench]) -> None:
    b = bench(retry_s=5.0, reply_timeout_s=10.0)
    b.stage.apply(Listen("stage", EVERYTHING))
    b.begin(MoveAt("stage", 0.01, 0.02))
    b.wire.deaf_to = b"get pos"  # from here on each question for the position hangs
    b.turn_for_lines(1)
    asked = b.wire.heard.count(b"get pos")
    b.stage.apply(Stop("stage"))
    b.turn_until(lambda: "stop" in b.wire.lines())
    assert b.wire.heard.count(b"get pos") == asked
    b.wire.deaf_to = b"\0"
    assert b.wire.axis.target_m < 0.02


def test_a_stop_ends_in_a_standstill_where_the_stage_is(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveAt("stage", 0.01, 0.02))
    b.clock.rest(0.1)
    sent = b.begin(Stop("stage"))
    still = b.expect(Standstill)
    assert still.t_s > sent.t_s
    assert still.position_m == pytest.approx(b.wire.axis.target_m, abs=STEP_M)


def test_a_stop_while_the_limits_are_being_set_lets_no_move_follow(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.stage.apply(MoveAt("stage", 0.01, 0.002))
    b.turn_until(lambda: "set limit.max 4031" in b.wire.lines())
    b.stage.apply(Stop("stage"))
    b.expect(Standstill)
    b.turn_for_lines(3)
    assert not [line for line in b.wire.lines() if line.startswith("move")]


def test_a_stop_whose_answer_is_lost_is_said_again(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveAt("stage", 0.005, 0.02))
    # Else the answer to another question is the one that is lost.
    b.turn_until(lambda: not b.stage._dialogue._open)
    b.inject("lose")
    b.stage.apply(Stop("stage"))
    b.expect(Standstill)
    assert b.wire.lines().count("stop") >= 2


def test_a_stop_of_a_stage_that_stands_is_a_standstill(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.stage.apply(Stop("stage"))
    assert b.expect(Standstill).position_m == 0.0


def test_a_newer_motion_replaces_an_older_one(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveTo("stage", 0.01, 0.01))
    b.stage.apply(MoveTo("stage", 0.001, 0.02))
    assert b.expect(Reached).position_m == pytest.approx(0.001, abs=STEP_M)
    assert not [status for status in b.statuses if isinstance(status, Reached)]


def test_a_stage_mounted_backwards_is_held_by_its_lower_limit(bench: Callable[..., Bench]) -> None:
    b = bench(forward=-1, origin_m=0.0254)
    b.begin(MoveTo("stage", 0.0240, 0.025))
    b.expect(Reached)
    b.begin(MoveAt("stage", 0.01, 0.0250))
    assert "set limit.min 807" in b.wire.lines()  # 25.4 mm - 25.0 mm = 806.3 microsteps
    assert b.expect(Reached).position_m == pytest.approx(0.0250, abs=STEP_M)


# the position


def test_positions_come_in_order_each_with_its_own_time(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.stage.apply(Listen("stage", EVERYTHING))
    b.begin(MoveAt("stage", 0.02, 0.004))
    b.expect(Reached)
    b.blocks += b.stage.read()
    times_s = [t_s for block in b.blocks for t_s in block.times]
    positions_m = [x for block in b.blocks for x in block.physical[:, 0]]
    assert [block.seq for block in b.blocks] == [0, *itertools.accumulate(map(len, b.blocks))][:-1]
    assert all(a < later for a, later in itertools.pairwise(times_s))
    assert all(a <= later for a, later in itertools.pairwise(positions_m))
    assert positions_m[-1] == pytest.approx(0.004, abs=STEP_M)
    assert b.blocks[0].unit == "m"


def test_an_unanswered_question_is_a_jump_in_the_sequence_and_said(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.stage.apply(Listen("stage", EVERYTHING))
    b.turn_until(lambda: len(b.blocks) > 2)
    b.inject("lose")
    lost = b.expect(Lost)
    b.turn_for_lines(3)
    b.blocks += b.stage.read()
    jumps = [later.seq - a.seq - len(a) for a, later in itertools.pairwise(b.blocks)]
    assert (lost.stream, lost.samples) == ("stage.position", 1)
    assert sorted(jumps)[-2:] == [0, 1]


@pytest.mark.parametrize("kind", ["bad_lrc", "corrupt", "late"])
def test_a_spoilt_or_late_reply_is_passed_over_like_a_lost_one(
    bench: Callable[..., Bench], kind: Fault
) -> None:
    b = bench(retry_s=0.05)
    b.stage.apply(Listen("stage", EVERYTHING))
    b.turn_until(lambda: len(b.blocks) > 2)
    b.inject(kind)
    assert b.expect(Lost).samples >= 1
    b.turn_for_lines(20)
    assert not [status for status in b.statuses if isinstance(status, Failed)]
    assert all(block.values.max() == 0 for block in b.blocks)


def test_nothing_is_sent_up_when_nobody_listens(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveTo("stage", 0.002, 0.02))
    b.expect(Reached)
    assert b.blocks == []


# what goes wrong


def test_a_stall_is_told(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveAt("stage", 0.005, 0.02))
    b.inject("stall")
    assert b.expect(Stalled).reason == "it stalled (FS)"
    b.begin(MoveTo("stage", 0.0, 0.02))
    b.expect(Reached)


def test_a_movement_that_a_hand_ended_did_not_reach_its_target(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveTo("stage", 0.02, 0.005))
    b.inject("interrupt")
    assert "on the way to 0.0" in b.expect(Stalled).reason


def test_a_rejected_movement_is_refused_with_the_devices_reason(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.inject("refuse")
    b.stage.apply(MoveTo("stage", 0.002, 0.005))
    refused = b.expect(Refused)
    assert "STATUSBUSY" in refused.reason
    assert refused.command == MoveTo("stage", 0.002, 0.005)


def test_a_driver_that_is_switched_off_is_told(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveTo("stage", 0.02, 0.005))
    b.inject("disable")
    assert b.expect(Stalled).reason == "its driver is disabled (FD)"
    b.stage.apply(MoveTo("stage", 0.0, 0.005))
    assert "DRIVERDISABLED" in b.expect(Refused).reason


def test_silence_is_a_failure_that_names_what_went_on_and_the_port(bench: Callable[..., Bench]) -> None:
    b = bench(reply_timeout_s=0.3)
    b.begin(MoveAt("stage", 0.002, 0.02))
    b.turn_until(lambda: b.stage._motion is not None)
    b.inject("silent")
    reason = b.expect(Failed).reason
    assert reason == f"no reply in 0.30 s while moving to 0.02 m; is the cable in {b.port}?"
    b.stage.apply(MoveTo("stage", 0.0, 0.01))
    assert b.expect(Refused).reason == reason


def test_a_stage_that_stands_and_falls_silent_is_noticed_without_a_command(
    bench: Callable[..., Bench],
) -> None:
    b = bench(reply_timeout_s=0.2, idle_interval_s=0.05)
    b.inject("silent")
    assert "while standing" in b.expect(Failed).reason


def test_a_pulled_plug_is_a_failure_and_a_stop_after_it_says_so_again(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.serve.unplug(b.port)
    assert "taken away" in b.expect(Failed).reason
    b.stage.apply(Stop("stage"))
    b.expect(Failed)
    b.stage.close()


def test_closing_stops_a_stage_that_moves(bench: Callable[..., Bench]) -> None:
    b = bench()
    b.begin(MoveAt("stage", 0.002, 0.02))
    b.stage.close()
    b.clock.rest(0.1)  # the far end reads it in its own turn
    assert b.wire.lines()[-1] == "stop"
