"""The hand's driver on a link made of lists: what is asked, and what becomes of the answers."""

from typing import Any

import pytest

from drivers.barrett_hand import codec
from drivers.barrett_hand.driver import BarrettHand, BarrettHandSettings
from drivers.core.can_frame import CanFrame
from drivers.core.can_link import PeriodicQuestion, ReceivedFrame
from drivers.core.clock import VirtualClock
from drivers.core.errors import CommandError, ProtocolError, RefusedError
from drivers.core.messages import Failed, Listen, Lost, Refused, Saturated, Sent, Stop, Tare
from tests.refusals import check_refusal, refused

F1, F2 = "hand.strain_11", "hand.strain_12"

DUE_S = 5000.0


def answer(finger: int, counts: int, cycle: int | None) -> ReceivedFrame:
    frame = codec.encode_reading(finger, counts)
    due_s = None if cycle is None else DUE_S + cycle * 1e-3
    return ReceivedFrame(frame, DUE_S + (cycle or 0) * 1e-3 + 4e-4, cycle, due_s)


class Link:
    """Answers single questions at once; answers of cycles are put in by the test."""

    def __init__(self) -> None:
        self.fault: str | None = None
        self.malformed = 0
        self.question: PeriodicQuestion | None = None
        self.waiting: list[ReceivedFrame] = []
        self.closed = False
        self.status = dict.fromkeys(codec.FINGERS, codec.READY)
        self.woken: list[int] = []
        self.wakes_to = codec.READY

    def open(self, *_: object) -> Any:
        return self

    def send(self, frame: CanFrame) -> float:
        for finger in codec.FINGERS:
            if frame == codec.encode_wake(finger):
                self.woken.append(finger)
                self.status[finger] = self.wakes_to
            elif frame == codec.encode_query(finger, subject=codec.STATUS):
                reply = codec.encode_reading(finger, self.status[finger], codec.STATUS)
                self.waiting.append(ReceivedFrame(reply, DUE_S))
            elif frame == codec.encode_query(finger):
                self.waiting.append(answer(finger, 2000, None))
        return DUE_S

    def receive(self) -> list[ReceivedFrame]:
        waiting, self.waiting = self.waiting, []
        return waiting

    def ask(self, question: PeriodicQuestion | None) -> None:
        self.question = question

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def link() -> Link:
    return Link()


@pytest.fixture
def clock() -> VirtualClock:
    made = VirtualClock()
    made.rest(DUE_S)
    return made


@pytest.fixture
def hand(clock: VirtualClock, link: Link) -> BarrettHand:
    made = BarrettHand("hand", BarrettHandSettings(port="can0"), clock, link.open)
    made.open()
    return made


def listen(hand: BarrettHand, *streams: str) -> None:
    hand.apply(Listen("hand", frozenset(streams)))


def test_fingers_that_sleep_are_woken_and_left_in_peace_meanwhile(link: Link) -> None:
    clock = VirtualClock()
    link.status[12] = link.status[13] = 0
    info = BarrettHand("hand", BarrettHandSettings(port="can0"), clock, link.open).open()
    assert link.woken == [12, 13]
    assert info.details["woken"] == (12, 13)
    assert clock.monotonic_s() >= 0.3


@pytest.mark.parametrize("late_s", [0.005, 0.022, 0.05])
def test_a_finger_that_was_asked_twice_before_it_was_woken_and_answers_late_is_ready(late_s: float) -> None:
    clock = VirtualClock()

    class Late(Link):
        """An adapter behind a busy host."""

        def send(self, frame: CanFrame) -> float:
            before, self.waiting = self.waiting, []
            super().send(frame)
            due_s = clock.monotonic_s() + late_s
            self.waiting = before + [each._replace(arrival_s=due_s) for each in self.waiting]
            return due_s

        def receive(self) -> list[ReceivedFrame]:
            now_s = clock.monotonic_s()
            come = [each for each in self.waiting if each.arrival_s <= now_s]
            self.waiting = [each for each in self.waiting if each.arrival_s > now_s]
            return come

    late = Late()
    late.status = dict.fromkeys(codec.FINGERS, 0)
    hand = BarrettHand("hand", BarrettHandSettings(port="can0", fingers=(12,)), clock, late.open)
    assert hand.open().details["woken"] == (12,)


def test_a_finger_that_does_not_wake_is_refused(link: Link) -> None:
    link.status[13] = link.wakes_to = 0
    with refused(RefusedError, "hand", "finger 13", "not ready", "off and on"):
        BarrettHand("hand", BarrettHandSettings(port="can0"), VirtualClock(), link.open).open()


@pytest.mark.parametrize(
    ("streams", "frame", "answers"),
    [((F2,), CanFrame(0x00C, b"\x19"), {0x586}), ((F1, F2), CanFrame(0x405, b"\x19"), {0x566, 0x586})],
    ids=["one by itself", "several together"],
)
def test_fingers_are_asked_with_one_question_a_cycle(
    hand: BarrettHand, link: Link, streams: tuple[str, ...], frame: CanFrame, answers: set[int]
) -> None:
    listen(hand, *streams)
    assert link.question is not None
    assert (link.question.frame, link.question.answers) == (frame, answers)
    assert (link.question.period_s, link.question.answer_s) == (1e-3, 0.02)


def test_nothing_is_asked_without_a_subscriber(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    listen(hand)
    assert link.question is None


def test_answers_are_dated_at_their_cycles(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [answer(11, 2000 + cycle, cycle) for cycle in range(4)]
    (block,) = hand.read()
    assert (block.stream, block.seq, block.rate_hz) == (F1, 0, 1000.0)
    assert block.values[:, 0].tolist() == [0, 1, 2, 3]
    assert block.t0_s == pytest.approx(hand._clock.from_monotonic(DUE_S))
    assert block.arrival_s == pytest.approx(block.last_s + 4e-4)


def test_a_cycle_without_an_answer_is_a_reported_gap(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [answer(11, 2000, cycle) for cycle in (0, 1, 4, 5)]
    first, second = hand.read()
    assert (len(first), second.seq, len(second)) == (2, 4, 2)
    (lost,) = hand.poll()
    assert isinstance(lost, Lost)
    assert (lost.stream, lost.samples) == (F1, 2)
    assert lost.t_s == hand._clock.now()
    link.malformed = 3
    assert (hand.account()["lost"], hand.account()["malformed"]) == (2, 3)


def test_answers_to_no_cycle_and_of_other_fingers_are_passed_over(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [
        answer(11, 2000, 0),
        answer(11, 3000, None),
        answer(12, 3000, 0),
        ReceivedFrame(CanFrame(0x566, b"\x88\0\0\0"), DUE_S, 1, DUE_S),
        answer(11, 2001, 1),
    ]
    (block,) = hand.read()
    assert block.values[:, 0].tolist() == [0, 1]
    assert hand.poll() == []


def test_a_bus_that_is_gone_is_a_failure_once(hand: BarrettHand, link: Link) -> None:
    link.fault = "the bus was taken away"
    (failed,) = hand.poll()
    assert isinstance(failed, Failed) and failed.reason == "the bus was taken away"
    assert hand.poll() == []


@pytest.mark.parametrize("fault", [None, "the bus was taken away"])
def test_closing_ends_the_questions_and_lets_go_of_the_bus(
    hand: BarrettHand, link: Link, fault: str | None
) -> None:
    listen(hand, F1)
    link.fault = fault
    hand.poll()
    hand.close()
    assert link.question is None
    assert link.closed


def test_listening_to_the_same_fingers_again_changes_nothing(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    before = link.question
    listen(hand, F1)
    assert link.question is before


def test_what_moves_a_hand_is_refused(hand: BarrettHand) -> None:
    with refused(CommandError, "hand: ", "Stop", "can Listen and Tare"):
        hand.apply(Stop("hand"))


def test_a_tare_needs_a_reading(hand: BarrettHand, link: Link) -> None:
    tare = Tare("hand", F1)
    listen(hand, F1)
    hand.apply(tare)
    (refused,) = hand.poll()
    assert isinstance(refused, Refused)
    assert (refused.command, refused.reason) == (tare, "no samples of it yet; listen to it first")
    link.waiting = [answer(11, 2100 + cycle, cycle) for cycle in range(3)]
    hand.read()
    hand.apply(tare)
    (sent,) = hand.poll()
    assert isinstance(sent, Sent) and sent.command == tare
    assert hand.account()["zero_counts"] == {F1: 2101, F2: 2000, "hand.strain_13": 2000}
    assert hand.zero_setting(F1) == "", "the other fingers have another zero"


def test_what_was_read_before_is_no_zero_of_what_is_listened_to_now(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [answer(11, 2100, 0)]
    hand.read()
    listen(hand, F2)
    listen(hand, F1)
    hand.apply(Tare("hand", F1))
    assert [type(status) for status in hand.poll()] == [Refused]


def test_silence_is_a_failure_with_a_subscriber(hand: BarrettHand, link: Link, clock: VirtualClock) -> None:
    clock.rest(10.0)
    assert hand.poll() == []
    listen(hand, F1, F2)
    clock.rest(0.5)
    assert hand.poll() == []
    link.waiting = [answer(12, 2000, 1)]
    clock.rest(0.01)
    assert hand.poll() == []
    clock.rest(0.5)
    assert hand.poll() == []
    clock.rest(0.01)
    reason = "no answer in 0.5 s; is the hand powered?"
    assert hand.poll() == [Failed(clock.now(), "hand", reason)]
    tare = Tare("hand", F1)
    hand.apply(tare)
    assert hand.poll() == [Refused(clock.now(), "hand", tare, reason)]


def test_listening_after_a_pause_is_no_silence(hand: BarrettHand, clock: VirtualClock) -> None:
    listen(hand, F1)
    listen(hand)
    clock.rest(10.0)
    listen(hand, F1)
    clock.rest(0.4)
    assert hand.poll() == []


def test_a_finger_beyond_what_is_safe_is_reported_beside_its_block(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [
        answer(11, counts, cycle) for cycle, counts in enumerate((2000, codec.SAFE_COUNTS[1] + 1))
    ]
    hand.read()
    (saturated,) = hand.poll()
    assert isinstance(saturated, Saturated)
    assert saturated.stream == F1


def test_numbers_go_on_through_a_pause_as_if_it_had_been_asked(hand: BarrettHand, link: Link) -> None:
    listen(hand, F1)
    link.waiting = [answer(11, 2000, cycle) for cycle in range(4)]
    listen(hand)
    listen(hand, F1)
    link.waiting = [answer(11, 2000, 0)._replace(due_s=DUE_S + 0.5, arrival_s=DUE_S + 0.5004)]
    first, second = hand.read()
    assert (first.seq, len(first), second.seq) == (0, 4, 500)
    assert hand.poll() == []


def test_frames_of_others_are_passed_over_while_the_hand_is_asked(link: Link) -> None:
    link.waiting = [ReceivedFrame(CanFrame(0x123, b"\1"), DUE_S, None, None)] * 2
    made = BarrettHand("hand", BarrettHandSettings(port="can0"), VirtualClock(), link.open)
    assert F1 in made.open().streams
    assert link.waiting == []


def test_a_bus_of_others_alone_is_refused_with_what_came(link: Link) -> None:
    link.malformed, foreign = 3, []

    def send(frame: CanFrame) -> float:
        foreign.append(ReceivedFrame(CanFrame(0x123, b"\1"), DUE_S))
        link.waiting = foreign[-1:]
        return DUE_S

    link.send = send  # type: ignore[method-assign]
    made = BarrettHand("hand", BarrettHandSettings(port="can0"), VirtualClock(), link.open)
    with pytest.raises(ProtocolError) as caught:
        made.open()
    came = f"{len(foreign)} frames of others and 3 malformed"
    check_refusal(str(caught.value), "hand", "finger 11 at can0", came, "is a BarrettHand on this bus")
