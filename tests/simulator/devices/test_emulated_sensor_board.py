"""The emulated board by itself: its clock, converters, mask, watchdog and faults."""

from typing import Any

import numpy as np
import pytest

from drivers.sensor_board.codec import (
    BoardCode,
    BoardHello,
    BoardReply,
    BoardSamples,
    CommandFrame,
    Message,
    ReplyStatus,
    decode,
    encode,
)
from drivers.sensor_board.framing import BoardFrameDecoder, frame
from simulator.devices.sensor_board import EmulatedSensorBoard
from tests.unit.drivers.sensor_board.conftest import PERIOD_S, Source

ACCELERATION, FORCE, PERIOD = 0, 1, 2


class Line:
    """A client of a board; begins at host time 0."""

    def __init__(self, **settings: Any) -> None:
        self.source = Source()
        self.board = EmulatedSensorBoard(self.source, **settings)
        self.decoder = BoardFrameDecoder()
        self.decoder.feed(b"\0")
        self.t_s = 0.0
        self.board.step(0.0)
        self._tag = 0

    def ask(self, code: int, argument: int | None = None) -> list[Message]:
        self._tag += 1
        data = b"\0" + encode(CommandFrame(code, self._tag, argument))
        return self._decoded(self.board.receive(data, self.t_s))

    def status(self, code: int, argument: int | None = None) -> int:
        replies = [message for message in self.ask(code, argument) if isinstance(message, BoardReply)]
        assert [reply.tag for reply in replies] == [self._tag]
        return replies[0].status

    def run(self, seconds: float, step_s: float = 0.001) -> list[Any]:
        messages: list[Message] = []
        steps = round(seconds / step_s)
        begin_s = self.t_s
        for step in range(1, steps + 1):
            self.t_s = begin_s + step * step_s
            messages += self._decoded(self.board.step(self.t_s))
        return messages

    def _decoded(self, data: bytes) -> list[Message]:
        return [decode(body) for body in self.decoder.feed(data)]


def samples(messages: list[Any], stream: int) -> np.ndarray:
    return np.concatenate([m.values for m in messages if isinstance(m, BoardSamples) and m.stream == stream])


def test_a_client_that_has_just_connected_receives_the_first_hello() -> None:
    line = Line()
    line.decoder = BoardFrameDecoder()
    hello, reply = line.ask(BoardCode.HELLO)
    assert isinstance(hello, BoardHello)
    assert [(s.id, s.name, s.channels, s.rate_hz) for s in hello.streams] == [
        (0, "accelerometer", ("x", "z"), 1000.0),
        (1, "load_cell", ("force",), 1000.0),
        (2, "period", ("period",), None),
    ]
    assert reply == BoardReply(BoardCode.HELLO, 1, ReplyStatus.OK)


def test_samples_lie_on_the_grid_of_a_clock_that_drifts() -> None:
    line = Line(drift_ppm=100.0, start_us=5)
    line.status(BoardCode.START, 1 << FORCE)
    messages = line.run(10.0, step_s=0.01)
    frames = [message for message in messages if isinstance(message, BoardSamples)]
    assert [frame.t_us for frame in frames[:3]] == [1_005, 11_005, 21_005]
    assert samples(frames, FORCE).size == 10_000  # of 10,001 ticks of a fast clock, ten by ten
    # The force is its own true time: sample k was taken at k ms of a clock that runs 100 ppm fast.
    assert samples(frames, FORCE)[9_999] * 1e-5 == pytest.approx(10.0 / 1.0001, abs=1e-5)


def test_the_clock_and_the_counter_wrap() -> None:
    line = Line(start_us=2**32 - 40_000_000, drift_ppm=0.0, block_samples=50)
    line.status(BoardCode.START, 1 << FORCE)
    frames = [m for m in line.run(70.0, step_s=0.25) if isinstance(m, BoardSamples)]
    assert [frame.seq for frame in frames] == [50 * at % 65_536 for at in range(len(frames))]
    assert frames[-1].t_us == (frames[0].t_us + 50_000 * (len(frames) - 1)) % 2**32
    assert max(frame.seq for frame in frames) > 65_000 > frames[-1].seq


def test_counts_are_rounded_and_saturate_at_the_converters_width() -> None:
    line = Line(adc_bits={"accelerometer": 14})
    line.status(BoardCode.START, 1 << ACCELERATION)
    values = samples(line.run(0.1), ACCELERATION).reshape(-1, 2)
    assert set(values[:, 0].tolist()) == {5000}
    assert set(values[:, 1].tolist()) == {2**13 - 1}


def test_a_reading_that_is_no_number_is_the_lower_rail(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line(adc_bits={"load_cell": 24})
    monkeypatch.setattr(line.source, "sample", lambda stream, times_s: np.full(len(times_s), np.nan))
    line.status(BoardCode.START, 1 << FORCE)
    assert set(samples(line.run(0.05), FORCE).tolist()) == {-(2**23)}


def test_events_are_sent_at_once_each_with_its_own_time() -> None:
    line = Line(drift_ppm=0.0, start_us=0)
    line.run(0.5)
    line.status(BoardCode.START, 1 << PERIOD)
    messages = line.run(0.5)
    assert [message.seq for message in messages] == list(range(len(messages)))
    expected_us = [number * PERIOD_S * 1e6 for number in range(15, 29) if number * PERIOD_S <= line.t_s]
    assert [int(message.times_us[0]) for message in messages] == pytest.approx(expected_us, abs=1)
    assert {int(message.values[0]) for message in messages} == {357_143}


def test_no_frame_waits_longer_than_half_of_what_makes_a_stream_stale() -> None:
    line = Line(drift_ppm=0.0, block_samples=100)  # as ten of a stream at 100 Hz
    line.status(BoardCode.START, 1 << FORCE)
    assert samples(line.run(0.06), FORCE).size == 50


def test_the_last_shorter_block_is_sent_when_a_stream_stops() -> None:
    line = Line(drift_ppm=0.0)
    line.status(BoardCode.START, 1 << FORCE)
    messages = line.run(0.025) + line.ask(BoardCode.STOP)
    assert samples(messages, FORCE).size == line.source.sampled["load_cell"] == 25
    assert line.run(0.1) == []


def test_a_stream_that_stays_in_the_mask_is_not_disturbed() -> None:
    line = Line(drift_ppm=0.0)
    line.status(BoardCode.START, 1 << FORCE)
    messages = line.run(0.055)
    line.status(BoardCode.START, 1 << FORCE | 1 << PERIOD)
    messages += line.run(0.055)
    frames = [m for m in messages if isinstance(m, BoardSamples) and m.stream == FORCE]
    assert [frame.seq for frame in frames] == list(range(0, 110, 10))
    assert np.diff([frame.t_us for frame in frames]).tolist() == [10_000] * 10


def test_a_tare_takes_the_mean_of_the_latest_samples_as_zero(monkeypatch: pytest.MonkeyPatch) -> None:
    line = Line()
    monkeypatch.setattr(line.source, "sample", lambda stream, times_s: np.where(times_s < 0.2, 1.0, 3.0))
    assert line.status(BoardCode.TARE, FORCE) == ReplyStatus.REFUSED
    line.status(BoardCode.START, 1 << FORCE)
    line.run(0.15)
    assert line.status(BoardCode.TARE, FORCE) == ReplyStatus.OK
    values = samples(line.run(0.1), FORCE)
    assert set(values[10:40].tolist()) == {0}
    assert set(values[-20:].tolist()) == {200_000}
    assert line.status(BoardCode.TARE, 9) == ReplyStatus.REFUSED


def test_a_tare_takes_no_samples_from_before_a_stream_was_off() -> None:
    line = Line()
    line.status(BoardCode.START, 1 << FORCE)
    line.run(0.2)
    line.status(BoardCode.STOP)
    line.status(BoardCode.START, 1 << FORCE)
    assert line.status(BoardCode.TARE, FORCE) == ReplyStatus.REFUSED


def test_a_watchdog_that_has_tripped_is_armed_again_by_the_next_command() -> None:
    line = Line()
    line.status(BoardCode.WATCHDOG, 200)
    line.run(0.5)
    line.status(BoardCode.EXCITE, 1)
    line.run(0.1)
    assert line.source.excited
    line.run(0.2)
    assert not line.source.excited


def test_a_watchdog_of_zero_is_off() -> None:
    line = Line()
    line.status(BoardCode.EXCITE, 1)
    line.status(BoardCode.WATCHDOG, 0)
    line.run(5.0, step_s=0.1)
    assert line.source.excited


def test_the_watchdog_bites_at_its_time_even_when_steps_are_long() -> None:
    line = Line()
    line.status(BoardCode.WATCHDOG, 300)
    line.status(BoardCode.EXCITE, 1)
    line.status(BoardCode.START, 1 << FORCE)
    assert samples(line.run(2.0, step_s=2.0), FORCE).size == pytest.approx(300, abs=10)
    assert line.source.observed == frozenset()
    assert line.source.switched[-1] == (pytest.approx(0.3), False)


@pytest.mark.parametrize(
    ("code", "argument", "status"),
    [
        (BoardCode.EXCITE, 2, ReplyStatus.REFUSED),
        (BoardCode.START, 8, ReplyStatus.REFUSED),
        (BoardCode.TENDON, 30_001, ReplyStatus.REFUSED),
        (BoardCode.TENDON, 30_000, ReplyStatus.OK),
        (BoardCode.TENDON, -5_001, ReplyStatus.REFUSED),
    ],
)
def test_what_cannot_be_is_refused(code: int, argument: int, status: int) -> None:
    assert Line().status(code, argument) == status


def test_an_unknown_command_is_answered_as_unknown() -> None:
    line = Line()
    answer = line.board.receive(b"\0" + frame(b"\x80\x09\x05"), line.t_s)
    (body,) = line.decoder.feed(answer)
    assert decode(body) == BoardReply(9, 5, ReplyStatus.UNKNOWN)


def test_garbage_is_not_answered_and_does_not_feed_the_watchdog() -> None:
    line = Line()
    line.status(BoardCode.WATCHDOG, 200)
    line.status(BoardCode.EXCITE, 1)
    line.run(0.15)
    assert line.board.receive(b"\0hello?\r\n\0\x05\x01\0", line.t_s) == b""
    line.run(0.1)
    assert not line.source.excited


@pytest.mark.parametrize(("kind", "status"), [("refuse", ReplyStatus.REFUSED), ("busy", ReplyStatus.BUSY)])
def test_an_injected_answer_comes_once_and_the_command_has_no_effect(kind: Any, status: int) -> None:
    line = Line()
    line.board.inject(kind, 0.0)
    assert line.status(BoardCode.EXCITE, 1) == status
    assert not line.source.excited
    assert line.status(BoardCode.EXCITE, 1) == ReplyStatus.OK


def test_after_a_reboot_nothing_is_on() -> None:
    line = Line()
    line.status(BoardCode.EXCITE, 1)
    line.status(BoardCode.START, 1 << FORCE)
    line.run(0.1)
    line.board.inject("reboot", line.t_s)
    assert line.run(0.2) == []
    assert not line.source.excited


def test_a_restart_under_way_sets_clock_and_counter_to_zero() -> None:
    line = Line(start_us=77_000_000, drift_ppm=0.0)
    line.status(BoardCode.START, 1 << FORCE)
    line.run(0.1)
    line.board.inject("restart", line.t_s)
    first = line.run(0.02)[0]
    assert (first.seq, first.t_us) == (0, 1000)


def test_steps_of_any_length_say_the_same() -> None:
    def sent(step_s: float) -> list[tuple[int, int, int, list[int]]]:
        line = Line()
        line.status(BoardCode.START, 1 << ACCELERATION | 1 << FORCE)
        messages = line.run(0.3, step_s)
        return sorted((m.stream, m.seq, m.t_us, m.values.tolist()) for m in messages)

    assert sent(0.001) == sent(0.0075) == sent(0.3)
