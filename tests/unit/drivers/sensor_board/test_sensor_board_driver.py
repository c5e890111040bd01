"""The driver on an emulated board in virtual time: every byte real, every millisecond simulated."""

import itertools
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from drivers.core.errors import CommandError, PortError, ProtocolError, SilentError
from drivers.core.messages import (
    Excite,
    Failed,
    Listen,
    Lost,
    MoveAt,
    Refused,
    SampleBlock,
    Sent,
    SetTendon,
    Tare,
)
from drivers.sensor_board.codec import BoardCode, BoardReply, BoardSamples, CommandFrame, decode, encode
from drivers.sensor_board.framing import BoardFrameDecoder, frame
from tests.refusals import refused
from tests.unit.drivers.far_end import spoilt
from tests.unit.drivers.sensor_board.conftest import Bench, Source

FORCE = "board.load_cell"
ACCELERATION = "board.accelerometer"
PERIOD = "board.period"

MakeBench = Callable[..., Bench]


def listen(*streams: str) -> Listen:
    return Listen("board", frozenset(streams))


def of(kind: type, statuses: list[Any]) -> list[Any]:
    return [status for status in statuses if isinstance(status, kind)]


def on(stream: str, blocks: list[SampleBlock]) -> list[SampleBlock]:
    return [block for block in blocks if block.stream == stream]


def orders(bench: Bench) -> list[CommandFrame]:
    decoder = BoardFrameDecoder()
    bodies = decoder.feed(b"\0" + b"".join(bench.host.written))
    return [message for message in map(decode, bodies) if isinstance(message, CommandFrame)]


def answer(bench: Bench, code: BoardCode, status: int) -> None:
    """The next order of a kind is answered so."""

    def answered(data: bytes) -> bytes:
        last = orders(bench)[-1:]
        if not data or not last or last[0].code != code:
            return data
        bench.host.hush = bytes
        return encode(BoardReply(code, last[0].tag, status))

    bench.host.hush = answered


# --- opening and closing -------------------------------------------------------------------------


def test_what_the_board_has_comes_from_its_hello(make_bench: MakeBench) -> None:
    info = make_bench().device.open()
    assert (info.device, info.model, info.serial, info.version, info.mover) == (
        "board",
        "emulated sensor board",
        "E1",
        "1.0",
        False,
    )
    assert set(info.streams) == {FORCE, ACCELERATION, PERIOD}
    assert info.streams[ACCELERATION].channels == ("x", "z")
    assert (info.streams[FORCE].unit, info.streams[FORCE].scale, info.streams[FORCE].rate_hz) == (
        "N",
        1e-5,
        1000.0,
    )
    assert info.streams[PERIOD].rate_hz is None
    assert info.clock == "board microseconds"
    assert info.details == {"port": "/dev/board", "watchdog_s": 1.0}


def test_opening_stops_what_an_earlier_host_has_left_on(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.device.open()
    bench.device.apply(listen(FORCE))
    bench.run(0.1)
    info = bench.device.open()
    blocks, statuses = bench.run(0.2)
    assert info.model == "emulated sensor board"
    assert blocks == statuses == []
    assert bench.source.observed == frozenset()


def test_a_board_whose_first_answer_is_lost_is_asked_again(make_bench: MakeBench) -> None:
    bench = make_bench()
    lost = iter([b"\0\x05half", b""])
    bench.host.hush = lambda data: next(lost, data)
    assert bench.device.open().serial == "E1"


def test_a_board_that_restarts_when_its_port_is_opened_is_waited_for(make_bench: MakeBench) -> None:
    assert make_bench(board={"boot_s": 2.1}).device.open().serial == "E1"
    bench = make_bench(board={"boot_s": 2.1}, driver={"boot_s": 0.5})
    with refused(SilentError, "board: ", "no answer in 2 s"):
        bench.device.open()


@pytest.mark.parametrize(
    ("noise", "error", "cause"),
    [
        (b"", SilentError, "no answer in 3 s"),
        (b"@01 0 OK IDLE -- 0\r\n", ProtocolError, "no hello of a sensor board"),
        (b"\0\0\x03ab\0", ProtocolError, "no hello of a sensor board"),
        (b"\0" + frame(b'\x03{"board":"x"}'), ProtocolError, "hello (serial): Field required"),
    ],
)
def test_a_port_without_a_board_is_refused_in_time(
    make_bench: MakeBench, noise: bytes, error: type[Exception], cause: str
) -> None:
    bench = make_bench()
    bench.host.hush = lambda data: noise
    begin_s = bench.host.t_s
    with refused(error, "board: ", cause, "/dev/board"):
        bench.device.open()
    assert bench.host.t_s - begin_s < 3.2
    assert bench.host.closed


def test_a_watchdog_that_one_lost_reply_would_starve_is_no_setting(make_bench: MakeBench) -> None:
    with pytest.raises(ValueError, match="at least twice reply_timeout_s"):
        make_bench(driver={"watchdog_s": 0.4})


def test_a_board_that_will_have_no_watchdog_is_not_opened(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.host.cut = lambda data: b"" if b"\x80\x07" in data else data
    with pytest.raises(ProtocolError, match="no reply to watchdog"):
        bench.device.open()
    assert bench.host.closed


def test_a_board_that_refuses_its_watchdog_is_not_opened(make_bench: MakeBench) -> None:
    bench = make_bench()
    answer(bench, BoardCode.WATCHDOG, 2)
    with refused(ProtocolError, "board: ", "refuses it: watchdog", "firmware fit this version"):
        bench.device.open()
    assert bench.host.closed


def test_a_port_that_goes_while_the_board_is_set_up_is_a_port_error(make_bench: MakeBench) -> None:
    bench = make_bench()

    def taken(data: bytes) -> bytes:
        if orders(bench)[-1:] and orders(bench)[-1].code == BoardCode.WATCHDOG:
            bench.host.fault = "the port was taken away"
            return b""
        return data

    bench.host.hush = taken
    with pytest.raises(PortError, match=r"^board: the port was taken away while setting it up; "):
        bench.device.open()


def test_what_a_board_sent_before_it_was_set_up_is_not_handed_out(make_bench: MakeBench) -> None:
    bench = make_bench()
    bench.device.open()
    bench.device.apply(listen(FORCE))
    bench.run(0.1)
    bench.device._link = None  # the program was killed
    before = len(bench.host.written)
    bench.host.cut = lambda data: b"" if len(bench.host.written) == before + 2 else data  # STOP, after HELLO
    bench.device.open()
    assert bench.device.read() == bench.device.poll() == []
    sent = [order.code for order in orders(bench)[before:]]
    assert sent[:2] == [BoardCode.HELLO, BoardCode.STOP]
    assert BoardCode.STOP in sent[2:], "once more"


@pytest.mark.parametrize(("hushed", "waits_s"), [(False, 0.0), (True, 0.25)])
def test_closing_switches_all_off_and_waits_a_moment_for_the_replies(
    bench: Bench, hushed: bool, waits_s: float
) -> None:
    if hushed:
        bench.host.hush = lambda data: b""
    began_s = bench.host.t_s
    bench.device.close()
    assert bench.host.t_s - began_s == pytest.approx(waits_s, abs=0.005)
    last = [(order.code, order.argument) for order in orders(bench)[-2:]]
    assert last == [(BoardCode.EXCITE, 0), (BoardCode.STOP, None)]


def test_closing_a_board_that_has_failed_still_switches_off(bench: Bench) -> None:
    bench.device.apply(Excite("board", True))
    bench.device.apply(listen(FORCE))
    bench.run(0.1)
    bench.host.hush = lambda data: b""
    assert of(Failed, bench.run(0.7)[1])
    began_s = bench.host.t_s
    bench.device.close()
    assert not bench.source.excited
    assert bench.host.t_s == began_s, "it waits for no reply"


# --- commands ------------------------------------------------------------------------------------


def test_a_command_is_on_the_wire_when_apply_returns_and_sent_says_when(bench: Bench) -> None:
    excite, now_s = Excite("board", True), bench.clock.now()
    bench.device.apply(excite)
    assert bench.source.excited
    _, statuses = bench.run(0.01)
    assert of(Sent, statuses) == [Sent(now_s, "board", excite)]


def test_the_tendon_is_set_to_the_micrometre(bench: Bench) -> None:
    applied = bench.device.apply(SetTendon("board", 0.0012346))
    assert applied == SetTendon("board", pytest.approx(0.001235))
    assert bench.source.tendon_m == pytest.approx(0.001235)


def test_a_tare_makes_the_present_level_zero(bench: Bench) -> None:
    bench.device.apply(listen(ACCELERATION))
    before, _ = bench.run(0.2)
    bench.device.apply(Tare("board", ACCELERATION))
    after, _ = bench.run(0.2)
    assert before[0].values[0].tolist() == [5000, 32767]
    assert np.concatenate([block.values for block in after])[-100:].tolist() == [[0, 0]] * 100


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (MoveAt("board", 0.001, 0.01), "it has no such command"),
        (SetTendon("board", math.nan), "nan m is out of range"),
        (SetTendon("board", 0.021), "choose from 0 to 0.02 m"),
        (Tare("board", "board.sound"), "it has no stream board.sound"),
        (listen(FORCE, "stage.position"), "it has no stream stage.position"),
    ],
)
def test_a_command_that_makes_no_sense_is_not_written(bench: Bench, command: Any, message: str) -> None:
    written = len(bench.host.written)
    with refused(CommandError, "board: ", message):
        bench.device.apply(command)
    assert len(bench.host.written) == written


@pytest.mark.parametrize(
    ("status", "reason"),
    [
        (1, "the board does not know this command"),
        (2, "the board refuses it"),
        (3, "the board is busy"),
        (9, "the board replies 9"),
    ],
)
def test_a_refusal_of_the_board_is_reported(bench: Bench, status: int, reason: str) -> None:
    answer(bench, BoardCode.EXCITE, status)
    command = Excite("board", True)
    now_s = bench.clock.now()
    bench.device.apply(command)
    _, statuses = bench.run(0.05)
    (refused,) = of(Refused, statuses)
    assert refused == Refused(pytest.approx(now_s, abs=0.003), "board", command, reason)
    assert of(Failed, statuses) == []
    bench.host.until(bench.host.t_s + 3.0)
    assert of(Failed, bench.run(0.1)[1]) == [], "it counts as off"


def test_a_watchdog_that_the_board_refuses_is_a_failure_unless_it_is_busy(bench: Bench) -> None:
    answer(bench, BoardCode.WATCHDOG, 3)
    assert of(Failed, bench.run(0.6)[1]) == []
    answer(bench, BoardCode.WATCHDOG, 1)
    (failed,) = of(Failed, bench.run(0.3)[1])
    assert failed.reason == "the board does not know this command: watchdog"


def test_a_command_on_a_port_that_is_gone_is_refused_and_the_board_has_failed(bench: Bench) -> None:
    bench.host.fault = "the port was taken away"
    command = Excite("board", True)
    bench.device.apply(command)
    statuses = bench.device.poll()
    assert [failed.reason for failed in of(Failed, statuses)] == ["the port was taken away"]
    assert [(one.command, one.reason) for one in of(Refused, statuses)] == [
        (command, "the port was taken away")
    ]
    assert of(Sent, statuses) == []


def test_a_command_on_a_port_that_was_closed_is_refused(bench: Bench) -> None:
    bench.host.closed = True
    bench.device.apply(Excite("board", True))
    assert [refused.reason for refused in of(Refused, bench.device.poll())] == ["the port is closed"]


def test_a_command_whose_reply_is_lost_is_written_once_more_under_its_tag(bench: Bench) -> None:
    answers = itertools.count()
    bench.host.hush = lambda data: b"" if next(answers) == 0 else data
    bench.device.apply(Excite("board", True))
    _, statuses = bench.run(0.4)
    excites = [order for order in orders(bench) if order.code == BoardCode.EXCITE]
    assert len(excites) == 2
    assert excites[0] == excites[1]
    assert of(Failed, statuses) == []
    assert len(of(Sent, statuses)) == 1


def test_a_board_that_never_replies_has_failed_and_refuses_what_follows(bench: Bench) -> None:
    bench.host.cut = lambda data: b""
    bench.device.apply(Excite("board", True))
    _, statuses = bench.run(0.7)
    (failed,) = of(Failed, statuses)
    assert "no reply to excite, asked twice in 0.5 s" in failed.reason
    command = SetTendon("board", 0.001)
    bench.device.apply(command)
    _, later = bench.run(1.0)
    assert [refused.command for refused in of(Refused, later)] == [command]
    assert of(Failed, later) == []


def test_an_order_is_not_repeated_over_a_newer_one_on_the_same_thing(bench: Bench) -> None:
    answers = itertools.count()
    bench.host.hush = lambda data: b"" if next(answers) == 0 else data
    bench.device.apply(Excite("board", True))
    bench.device.apply(Excite("board", False))
    _, statuses = bench.run(1.0)
    assert [order.argument for order in orders(bench) if order.code == BoardCode.EXCITE] == [1, 0]
    assert not bench.source.excited
    assert of(Failed, statuses) == []


# --- samples -------------------------------------------------------------------------------------


def test_only_what_is_listened_to_is_sent(bench: Bench) -> None:
    bench.device.apply(listen(FORCE, PERIOD))
    first, _ = bench.run(0.3)
    bench.device.apply(listen())
    rest, _ = bench.run(0.05)
    silence, statuses = bench.run(1.0)
    assert {block.stream for block in first + rest} == {FORCE, PERIOD}
    assert silence == []
    assert of(Failed, statuses) == []


@pytest.mark.parametrize("drift_ppm", [-80.0, 37.0])
def test_samples_are_dated_through_clocks_that_drift(make_bench: MakeBench, drift_ppm: float) -> None:
    """The force is its own true time in bench seconds: a sample and its date must agree."""
    bench = make_bench(board={"drift_ppm": drift_ppm})
    bench.device.open()
    bench.device.apply(listen(FORCE))
    blocks, statuses = bench.run(5.0)
    late_s = np.concatenate([block.times - block.physical[:, 0] for block in blocks])
    assert of(Lost, statuses) == []
    assert late_s.size > 4_900
    # The line is looked at every 0.7 ms: a first arrival may be 1.2 ms late, the quickest of many is not.
    assert np.abs(late_s).max() < 1.3e-3
    assert np.abs(late_s[2000:]).max() < 2e-4
    assert bench.device.account()["drift_ppm"] == pytest.approx(drift_ppm, abs=10.0)


@settings(max_examples=15, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.tuples(st.sampled_from(["drop", "flip", "truncate"]), st.integers(1, 3)), max_size=6))
def test_loss_is_counted_to_the_sample(make_bench: MakeBench, faults: list[tuple[Any, int]]) -> None:
    bench = make_bench()
    bench.device.open()
    bench.device.apply(listen(FORCE, ACCELERATION))
    blocks, statuses = bench.run(0.1)
    for kind, frames in faults:
        bench.host.hush = spoilt(kind, frames)
        more = bench.run(0.1)
        blocks += more[0]
        statuses += more[1]
    for stream in (FORCE, ACCELERATION):
        mine = on(stream, blocks)
        lost = sum(status.samples for status in of(Lost, statuses) if status.stream == stream)
        spanned = mine[-1].seq + len(mine[-1]) - mine[0].seq
        assert mine[0].seq == 0
        assert sum(map(len, mine)) + lost == spanned
        # What the source was asked for since, but for the block under way and the tail after it.
        assert 0 <= bench.source.sampled[stream.partition(".")[2]] - spanned < 60
        for before, after in itertools.pairwise(mine):
            jump = after.seq - before.seq - len(before)
            gap_s = after.t0_s - before.t0_s - len(before) * 1e-3
            assert jump * 1e-3 == pytest.approx(gap_s, abs=5e-4)
    assert of(Failed, statuses) == []


def test_a_stream_that_is_subscribed_again_begins_a_segment_and_has_lost_nothing(bench: Bench) -> None:
    bench.device.apply(listen(FORCE))
    first, before = bench.run(0.2)
    bench.device.apply(listen())
    bench.device.apply(listen(FORCE))
    tail, between = bench.run(0.2)
    bench.device.apply(listen())
    rest, _ = bench.run(0.5)
    bench.device.apply(listen(FORCE))
    last, after = bench.run(0.2)
    assert of(Lost, before + between + after) == []
    earlier = first + tail + rest
    assert last[0].seq > earlier[-1].seq + len(earlier[-1])
    assert last[0].t0_s > earlier[-1].times[-1] + 0.4


def test_a_board_that_restarts_under_way_is_reported_and_begins_a_segment(bench: Bench) -> None:
    bench.device.apply(listen(FORCE, PERIOD))
    before, _ = bench.run(0.5)
    bench.board.inject("restart", bench.host.t_s)
    after, statuses = bench.run(0.5)
    lost = of(Lost, statuses)
    assert {(status.stream, status.samples) for status in lost} == {(FORCE, 0), (PERIOD, 0)}
    assert len(lost) == 2
    for stream in (FORCE, PERIOD):
        last, first = on(stream, before)[-1], on(stream, after)[0]
        (noticed_s,) = (status.t_s for status in lost if status.stream == stream)
        assert last.times[-1] < noticed_s < on(stream, after)[-1].times[-1]
        assert first.seq > last.seq + len(last)
        assert first.times[0] >= last.times[-1]
    assert of(Failed, statuses) == []


def test_bench_time_may_begin_anew_while_streams_run(bench: Bench) -> None:
    bench.device.apply(listen(FORCE))
    bench.run(3.0)
    bench.clock.restart()
    blocks, statuses = bench.run(0.5)
    assert blocks[-1].times[-1] == pytest.approx(0.5, abs=0.02)
    assert statuses == []


# --- what goes wrong -----------------------------------------------------------------------------


def test_a_regular_stream_that_falls_silent_has_failed_once(bench: Bench) -> None:
    bench.device.apply(listen(FORCE))
    bench.run(0.2)
    begin_s = bench.clock.now()
    bench.host.hush = lambda data: b""
    _, statuses = bench.run(2.0)
    (failed,) = of(Failed, statuses)
    assert "nothing of board.load_cell in 0.5 s" in failed.reason
    assert 0.4 < failed.t_s - begin_s < 0.6


def test_an_irregular_stream_may_be_silent(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Source, "events", lambda self, stream: (np.empty(0), np.empty(0)))
    bench.device.apply(listen(PERIOD))
    assert of(Failed, bench.run(3.0)[1]) == []


def test_a_board_that_is_silent_without_a_subscriber_is_noticed_by_its_watchdog_replies(bench: Bench) -> None:
    bench.host.hush = lambda data: b""
    (failed,) = of(Failed, bench.run(2.0)[1])
    assert "no reply to watchdog" in failed.reason


def test_a_link_that_is_gone_has_failed_once(bench: Bench) -> None:
    bench.device.apply(listen(FORCE))
    bench.run(0.1)
    bench.host.fault = "the port was taken away"
    _, statuses = bench.run(1.0)
    assert [failed.reason for failed in of(Failed, statuses)] == ["the port was taken away"]
    bench.device.close()


def test_the_watchdog_is_fed_four_times_in_its_period(make_bench: MakeBench) -> None:
    bench = make_bench(driver={"watchdog_s": 2.0})
    bench.device.open()
    bench.run(10.0)
    fed = [order.argument for order in orders(bench) if order.code == BoardCode.WATCHDOG]
    assert fed == [2000] * len(fed)
    assert len(fed) == pytest.approx(1 + 10.0 / 0.5, abs=1)


def test_a_host_that_dies_loses_the_excitation(bench: Bench) -> None:
    bench.device.apply(Excite("board", True))
    bench.device.apply(listen(FORCE))
    bench.run(0.5)
    died_s = bench.host.t_s
    bench.host.until(died_s + 3.0)
    off_s, excited = bench.source.switched[-1]
    assert not excited
    assert 0.7 < off_s - died_s <= 1.0


@pytest.mark.parametrize("commands", [(), (SetTendon("board", 0.001),)], ids=["left alone", "commanded"])
def test_a_host_that_was_away_too_long_fails_rather_than_go_on_unexcited(
    bench: Bench, commands: tuple[Any, ...]
) -> None:
    bench.device.apply(Excite("board", True))
    bench.run(0.5)
    bench.host.until(bench.host.t_s + 3.0)
    for command in commands:
        bench.device.apply(command)
    (failed,) = of(Failed, bench.run(0.5)[1])
    assert failed.reason == "the host was away for 3.25 s, so the board's watchdog switched it off"


def test_a_stream_s_silence_counts_on_when_another_is_subscribed(bench: Bench) -> None:
    bench.device.apply(listen(FORCE))
    bench.run(0.2)
    began_s, step = bench.clock.now(), bench.board.step
    bench.board.step = lambda t_s: step(t_s)[:0]  # type: ignore[method-assign]
    bench.run(0.3)
    bench.device.apply(listen(FORCE, PERIOD))
    (failed,) = of(Failed, bench.run(1.0)[1])
    assert failed.reason == "nothing of board.load_cell in 0.5 s; is the board powered?"
    assert failed.t_s - began_s == pytest.approx(0.5, abs=0.02)


def test_a_host_that_was_away_after_the_excitation_went_off_goes_on(bench: Bench) -> None:
    bench.device.apply(Excite("board", True))
    bench.device.apply(Excite("board", False))
    bench.run(0.1)
    bench.host.until(bench.host.t_s + 3.0)
    assert of(Failed, bench.run(0.5)[1]) == []


@pytest.mark.parametrize("command", [Excite("board", True), listen(FORCE)])
def test_what_is_switched_on_after_the_host_was_away_is_not_taken_for_starved(
    bench: Bench, command: Any
) -> None:
    bench.run(0.1)
    bench.host.until(bench.host.t_s + 30.0)
    bench.device.apply(command)
    assert of(Failed, bench.run(0.5)[1]) == []


def test_a_late_turn_does_not_blame_the_board(make_bench: MakeBench) -> None:
    bench = make_bench(driver={"silence_timeout_s": 0.1, "reply_timeout_s": 0.1})
    bench.device.open()
    bench.device.apply(listen(FORCE))
    bench.run(0.2)
    bench.device.apply(SetTendon("board", 0.001))
    kept, bench.host.arrived = bench.host.arrived, []
    bench.host.hush = lambda data: kept.append((bench.host.t_s, data)) or b""  # type: ignore[func-returns-value]
    bench.host.until(bench.host.t_s + 0.5)
    assert of(Failed, [*bench.device.poll()]) == []
    bench.host.hush = bytes
    bench.host.arrived = kept
    blocks, statuses = bench.run(0.2)
    assert of(Failed, statuses) == of(Lost, statuses) == []
    assert sum(map(len, blocks)) == pytest.approx(700, abs=30)


def test_frames_that_fit_no_stream_are_counted_and_those_beside_them_taken(make_bench: MakeBench) -> None:
    bench = make_bench()
    assert bench.device.account() == {}
    bench.device.open()
    bench.device.apply(listen(FORCE))
    bench.run(0.1)
    for _ in range(2):
        bench.host.arrived.append((bench.host.t_s, encode(BoardSamples(31, 0, 0, np.zeros(4, np.int32)))))
    blocks, statuses = bench.run(0.1)
    assert bench.device.account()["malformed"] == 2
    assert len(blocks) == pytest.approx(10, abs=1)
    assert of(Lost, statuses) == []
    bench.host.hush = spoilt("flip")
    bench.run(0.1)
    account = bench.device.account()
    assert account["malformed"] == 2
    assert account["bad_crc"] + account["bad_cobs"] >= 1
    assert account["overlong"] == 0
    assert account["good"] == pytest.approx(30, abs=8)
    assert "drift_ppm" in account


def test_a_reply_that_nothing_awaits_changes_nothing(bench: Bench) -> None:
    bench.device.apply(listen(FORCE))
    bench.run(0.1)
    reply = encode(BoardReply(BoardCode.EXCITE, 77, 1))
    bench.host.hush = lambda data: data + reply if data else data
    blocks, statuses = bench.run(0.1)
    assert sum(len(block) for block in on(FORCE, blocks)) == pytest.approx(100, abs=5)
    assert statuses == []
