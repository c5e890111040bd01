"""The hand's driver on a link made of lists: what is asked, and what becomes of the answers."""

from __future__ import annotations

from typing import Any

import pytest

from drivers.barrett_hand import codec
from drivers.barrett_hand.driver import BarrettHand, BarrettHandSettings
from drivers.can_frame import CanFrame
from drivers.can_link import HeardFrame, PeriodicQuestion
from drivers.clock import WallClock
from drivers.errors import PortError
from drivers.messages import Failed, Listen, Lost

F1, F2 = "hand.strain_11", "hand.strain_12"

DUE_S = 5000.0


def answer(finger: int, counts: int, beat: int | None) -> HeardFrame:
    frame = codec.encode_reply(codec.HandReply(finger, codec.Property.STRAIN, counts))
    due_s = None if beat is None else DUE_S + beat * 1e-3
    return HeardFrame(frame, DUE_S + (beat or 0) * 1e-3 + 4e-4, beat, due_s)


class Link:
    """Answers single questions at once; what comes at beats is put in by the test."""

    def __init__(self) -> None:
        self.fault: str | None = None
        self.malformed = 0
        self.beat: PeriodicQuestion | None = None
        self.waiting: list[HeardFrame] = []
        self.closed = False

    def open(self, *_: object) -> Any:
        return self

    def send(self, frame: CanFrame) -> float:
        request = codec.decode_request(frame)
        self.waiting.append(answer(request.receiver, 2000, None))
        return DUE_S

    def receive(self) -> list[HeardFrame]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def ask(self, beat: PeriodicQuestion | None) -> None:
        self.beat = beat

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def link() -> Link:
    return Link()


@pytest.fixture
def hand(link: Link) -> BarrettHand:
    made = BarrettHand("hand", BarrettHandSettings(port="can0"), WallClock(), link.open)
    made.open()
    return made


def listen(hand: BarrettHand, *streams: str) -> None:
    hand.apply(Listen("hand", frozenset(streams)))


def test_one_finger_is_asked_by_itself(hand: BarrettHand, link: Link) -> None:
    listen(hand, F2)
    assert link.beat is not None
    assert link.beat.frame == CanFrame(0x00C, b"\x19")
    assert link.beat.answers == {0x586}
    assert link.beat.period_s == 1e-3


def test_several_fingers_are_asked_with_one_question(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1, F2)
    assert link.beat is not None
    assert link.beat.frame == CanFrame(0x405, b"\x19")
    assert link.beat.answers == {0x566, 0x586}


def test_nothing_is_asked_when_nobody_listens(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    listen(hand)
    assert link.beat is None


def test_answers_are_dated_at_their_beats(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [answer(11, 2000 + beat, beat) for beat in range(4)]
    (block,) = hand.read()
    assert (block.stream, block.seq, block.rate_hz) == (F1, 0, 1000.0)
    assert block.values[:, 0].tolist() == [0, 1, 2, 3]
    assert block.t0_s == pytest.approx(hand._clock.from_monotonic(DUE_S))
    assert block.arrival_s == pytest.approx(block.last_s + 4e-4)


def test_a_beat_without_an_answer_is_a_gap_and_told(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [answer(11, 2000, beat) for beat in (0, 1, 4, 5)]
    first, second = hand.read()
    assert (len(first), second.seq, len(second)) == (2, 4, 2)
    (lost,) = hand.poll()
    assert isinstance(lost, Lost)
    assert (lost.stream, lost.samples) == (F1, 2)
    assert hand.account()["lost"] == 2


def test_answers_to_no_beat_and_of_other_fingers_are_passed_over(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [
        answer(11, 2000, 0),
        answer(11, 3000, None),
        answer(12, 3000, 0),
        HeardFrame(CanFrame(0x566, b"\x88\0\0\0"), DUE_S, 1, DUE_S),
        answer(11, 2001, 1),
    ]
    (block,) = hand.read()
    assert block.values[:, 0].tolist() == [0, 1]
    assert hand.poll() == []


def test_a_bus_that_is_gone_is_a_failure_once(hand: BarrettHand, link: Link) -> None:
    link.fault = "the bus was taken away"
    (failed,) = hand.poll()
    assert isinstance(failed, Failed)
    assert hand.poll() == []


def test_a_bus_that_goes_while_opening_is_a_port_error(link: Link) -> None:
    link.fault = "the bus was taken away"
    with pytest.raises(PortError, match="asking finger 11 at can0"):
        BarrettHand("hand", BarrettHandSettings(port="can0"), WallClock(), link.open).open()
    assert link.closed
