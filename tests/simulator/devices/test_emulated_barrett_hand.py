"""The emulated hand, in the bytes of docs/reference/sensors.md."""

import numpy as np
import pytest

from drivers.barrett_hand.strain import FingerStrainSettings
from drivers.core.can_frame import CanFrame
from simulator.devices.barrett_hand import EmulatedBarrettHand, counts
from tests.steady import SteadyForces

SETTINGS = FingerStrainSettings(newton_per_count=0.01, zero_counts=2000)


@pytest.fixture
def hand() -> EmulatedBarrettHand:
    return EmulatedBarrettHand(SETTINGS, SteadyForces({11: 1.0, 12: -0.5, 13: 30.0}), asleep=False)


def test_one_finger_answers_for_itself(hand: EmulatedBarrettHand) -> None:
    answer = hand.receive(CanFrame(0x00B, b"\x19"), 0.0)
    assert answer == [CanFrame(0x566, bytes.fromhex("99 00 34 08"))]  # 2100


def test_all_fingers_answer_one_question_and_the_spread_has_no_gauge(hand: EmulatedBarrettHand) -> None:
    answers = hand.receive(CanFrame(0x405, b"\x19"), 0.0)
    assert [(frame.id, int.from_bytes(frame.data[2:], "little")) for frame in answers] == [
        (0x566, 2100),
        (0x586, 1950),
        (0x5A6, 4095),
    ]


def test_a_finger_that_was_switched_on_answers_for_its_status_alone_until_it_was_woken() -> None:
    hand = EmulatedBarrettHand(SETTINGS, SteadyForces({11: 1.0, 12: 0.0, 13: 0.0}))
    status, strain = CanFrame(0x00B, b"\x05"), CanFrame(0x00B, b"\x19")
    assert hand.receive(strain, 0.0) == []
    assert hand.receive(status, 0.0) == [CanFrame(0x566, bytes.fromhex("85 00 00 00"))]
    assert hand.receive(CanFrame(0x00B, bytes.fromhex("85 00 02 00 00 00")), 1.0) == []
    assert hand.receive(status, 1.1) == hand.receive(strain, 1.1) == [], "it wakes"
    assert hand.receive(status, 1.4) == [CanFrame(0x566, bytes.fromhex("85 00 02 00"))]
    assert hand.receive(strain, 1.4) == [CanFrame(0x566, bytes.fromhex("99 00 34 08"))]
    assert hand.receive(CanFrame(0x00C, b"\x19"), 1.4) == [], "the others sleep on"


def test_frames_that_are_not_for_it_are_passed_over(hand: EmulatedBarrettHand) -> None:
    for frame in (
        CanFrame(0x00A, b"\x19"),
        CanFrame(0x404, b"\x19"),
        CanFrame(0x00B),
        CanFrame(0x00B, b"\x07"),
        CanFrame(0x00B, bytes.fromhex("AA 00 D0 01 01 00")),
    ):
        assert hand.receive(frame, 0.0) == []


def test_gauges_saturate_at_their_converters_ends() -> None:
    forces_n = np.array([-100.0, 0.0, 0.014, 100.0, np.nan])
    assert counts(forces_n, SETTINGS).tolist() == [0, 2000, 2001, 4095, 0]


def test_faults_it_does_not_know_are_refused(hand: EmulatedBarrettHand) -> None:
    with pytest.raises(ValueError, match="a hand knows no fault 'stall'"):
        hand.inject("stall", 0.0)
    hand.inject("saturate", 0.0)
    assert hand.receive(CanFrame(0x00B, b"\x19"), 0.0)[0].data[2:] == b"\0\0"
    hand.inject("silent", 0.0)
    assert hand.receive(CanFrame(0x00B, b"\x19"), 0.0) == []
