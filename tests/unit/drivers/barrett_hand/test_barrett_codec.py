"""Frames of the BarrettHand against bytes written by hand from docs/reference/sensors.md."""

import pytest

from drivers.barrett_hand import codec
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError


@pytest.mark.parametrize(("receiver", "group", "identifier"), [(11, False, 0x00B), (5, True, 0x405)])
def test_queries_are_the_bytes_of_the_interface_page(receiver: int, group: bool, identifier: int) -> None:
    frame = CanFrame(identifier, b"\x19")
    assert codec.encode_query(receiver, group=group) == frame
    assert codec.decode_query(frame) == (receiver, group)


@pytest.mark.parametrize(
    ("finger", "counts", "identifier", "data"),
    [(11, 2000, 0x566, "99 00 D0 07"), (12, 4095, 0x586, "99 00 FF 0F"), (13, 0, 0x5A6, "99 00 00 00")],
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
