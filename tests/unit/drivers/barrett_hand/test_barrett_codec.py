"""The hand's frames, and force out of counts."""

import numpy as np
import pytest

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import FingerStrain, FingerStrainSettings
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError
from drivers.core.messages import SampleBlock, Saturated


@pytest.mark.parametrize(("receiver", "group", "identifier"), [(11, False, 0x00B), (5, True, 0x405)])
def test_queries_are_the_bytes_of_the_interface_page(receiver: int, group: bool, identifier: int) -> None:
    frame = CanFrame(identifier, b"\x19")
    assert codec.encode_query(receiver, group=group) == frame
    assert codec.decode_query(frame) == (receiver, group)


@pytest.mark.parametrize(
    ("finger", "counts", "identifier", "data"),
    [(11, 2000, 0x566, "99 00 D0 07"), (12, 4095, 0x586, "99 00 FF 0F"), (13, -12, 0x5A6, "99 00 F4 FF")],
)
def test_readings_are_the_bytes_of_the_interface_page(
    finger: int, counts: int, identifier: int, data: str
) -> None:
    frame = CanFrame(identifier, bytes.fromhex(data))
    assert codec.encode_reading(finger, counts) == frame
    assert codec.decode_reading(frame) == (finger, counts)
    assert codec.reading_id(finger) == frame.id


def test_a_reading_may_have_four_bytes() -> None:
    assert codec.decode_reading(CanFrame(0x566, bytes.fromhex("99 00 D0 07 00 00"))) == (11, 2000)


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x566, b"\x99\x00\xd0"),  # truncated
        CanFrame(0x566, b"\x19\x00\xd0\x07"),  # a query's byte
        CanFrame(0x566, b"\x88\x00\xd0\x07"),  # of another property
        CanFrame(0x166, b"\x99\x00\xd0\x07"),  # to a node
        CanFrame(0x565, b"\x99\x00\xd0\x07"),  # to the hand
        CanFrame(0x566, remote=True),
    ],
)
def test_what_is_no_reading_is_refused(frame: CanFrame) -> None:
    with pytest.raises(CodecError, match="no reading: CanFrame"):
        codec.decode_reading(frame)


@pytest.mark.parametrize(
    "frame",
    [CanFrame(0x00B), CanFrame(0x00B, b"\x30"), CanFrame(0x00B, b"\x99"), CanFrame(0x00B, remote=True)],
)
def test_what_is_no_query_is_refused(frame: CanFrame) -> None:
    with pytest.raises(CodecError, match="no query: CanFrame"):
        codec.decode_query(frame)


def test_a_finger_is_woken_with_the_bytes_of_the_interface_page() -> None:
    assert codec.encode_wake(12) == CanFrame(0x00C, bytes.fromhex("85 00 02 00 00 00"))
    assert codec.encode_query(12, subject=codec.STATUS) == CanFrame(0x00C, b"\x05")
    assert codec.decode_reading(CanFrame(0x586, bytes.fromhex("85 00 02 00")), codec.STATUS) == (12, 2)


@pytest.fixture
def strain() -> FingerStrain:
    return FingerStrain("hand", 11, 1000.0, FingerStrainSettings(newton_per_count=0.01, zero_counts=2000))


def block(strain: FingerStrain, *counts: int, t0_s: float = 1.0) -> SampleBlock:
    return strain.block(7, t0_s, np.array(counts, dtype=np.int64), 2.0)


def test_a_force_is_counts_less_the_zero_times_the_scale(strain: FingerStrain) -> None:
    made = block(strain, 2000, 2100, 1950)
    assert made.stream == strain.info.name == "hand.strain_11"
    assert made.physical[:, 0] == pytest.approx([0.0, 1.0, -0.5])
    assert (made.seq, made.rate_hz, made.unit) == (7, 1000.0, "N")
    assert np.issubdtype(made.values.dtype, np.integer)


def test_a_new_zero_is_the_mean_of_the_latest_readings(strain: FingerStrain) -> None:
    block(strain, *[9] * 60, *[2010, 2012] * 25)
    assert strain.tare()
    assert strain.zero == 2011
    assert block(strain, 2021).physical[0, 0] == pytest.approx(0.1)


def test_a_new_zero_is_the_mean_of_50_ms() -> None:
    for rate_hz, n in ((1000.0, 50), (400.0, 20), (100.0, 10)):
        slow = FingerStrain("hand", 11, rate_hz, FingerStrainSettings())
        block(slow, *[1000] * 100, *[2000] * n)
        assert slow.tare()
        assert slow.zero == 2000
        block(slow, 2000 + n)
        assert slow.tare()
        assert slow.zero == 2001


def test_without_readings_there_is_no_new_zero(strain: FingerStrain) -> None:
    assert not strain.tare()
    block(strain, 2100)
    strain.forget()
    assert not strain.tare()
    assert strain.zero == 2000


@pytest.mark.parametrize(
    ("counts", "saturated"), [(667, 0), (666, 1), (3460, 0), (3461, 1), (0, 1), (4095, 1)]
)
def test_the_range_is_that_of_the_interface_page(strain: FingerStrain, counts: int, saturated: int) -> None:
    assert len(strain.saturation(block(strain, 2000, counts))) == saturated


def test_each_excursion_is_reported_once_with_its_time_and_force(strain: FingerStrain) -> None:
    assert strain.saturation(block(strain, 2000, 3500, 3600)) == [
        Saturated(pytest.approx(1.001), "hand", "hand.strain_11", pytest.approx(15.0))
    ]
    assert strain.saturation(block(strain, 3700, 3800)) == []
    assert strain.saturation(block(strain, 3700, 2000, 600, 2000, 500)) == [
        Saturated(pytest.approx(1.002), "hand", "hand.strain_11", pytest.approx(-14.0)),
        Saturated(pytest.approx(1.004), "hand", "hand.strain_11", pytest.approx(-15.0)),
    ]


def test_a_new_zero_does_not_move_the_range(strain: FingerStrain) -> None:
    block(strain, 3000)
    strain.tare()
    assert strain.saturation(block(strain, 3400)) == []
    assert len(strain.saturation(block(strain, 3500))) == 1
