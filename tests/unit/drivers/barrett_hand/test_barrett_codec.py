"""Frames of the BarrettHand against bytes written by hand from docs/reference/sensors.md."""

from __future__ import annotations

import pytest

from drivers.barrett_hand.codec import (
    HandReply,
    HandRequest,
    Property,
    decode_reply,
    decode_request,
    encode_reply,
    encode_request,
    reply_id,
)
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError

REQUESTS = [
    (HandRequest(11, Property.STRAIN), "00B", "19"),
    (HandRequest(5, Property.STRAIN, group=True), "405", "19"),
    (HandRequest(14, Property.POSITION), "00E", "30"),
    (HandRequest(11, Property.MODE, 5), "00B", "88 00 05 00 00 00"),
    (HandRequest(5, Property.COMMAND, -2, group=True), "405", "9D 00 FE FF FF FF"),
    (HandRequest(13, Property.TARGET, 66_000), "00D", "AA 00 D0 01 01 00"),
]

REPLIES = [
    (HandReply(11, Property.STRAIN, 2000), "566", "99 00 D0 07"),
    (HandReply(12, Property.STRAIN, 4095), "586", "99 00 FF 0F"),
    (HandReply(13, Property.MODE, 0), "5A6", "88 00 00 00"),
    (HandReply(14, Property.POSITION, -3), "5C6", "B0 00 FD FF"),
    (HandReply(11, Property.POSITION, 66_000), "566", "B0 00 D0 01 01 00"),
    (HandReply(11, Property.POSITION, 32_767), "566", "B0 00 FF 7F"),
    (HandReply(11, Property.POSITION, 32_768), "566", "B0 00 00 80 00 00"),
    (HandReply(11, Property.POSITION, -32_768), "566", "B0 00 00 80"),
    (HandReply(11, Property.POSITION, -32_769), "566", "B0 00 FF 7F FF FF"),
]


@pytest.mark.parametrize(("request_", "identifier", "data"), REQUESTS)
def test_requests_are_the_bytes_of_the_interface_page(
    request_: HandRequest, identifier: str, data: str
) -> None:
    frame = CanFrame(int(identifier, 16), bytes.fromhex(data))
    assert encode_request(request_) == frame
    assert decode_request(frame) == request_


@pytest.mark.parametrize(("reply", "identifier", "data"), REPLIES)
def test_replies_are_the_bytes_of_the_interface_page(reply: HandReply, identifier: str, data: str) -> None:
    frame = CanFrame(int(identifier, 16), bytes.fromhex(data))
    assert encode_reply(reply) == frame
    assert decode_reply(frame) == reply
    assert reply_id(reply.sender) == frame.id


def test_a_reply_of_four_bytes_may_stand_for_a_small_value() -> None:
    assert decode_reply(CanFrame(0x566, bytes.fromhex("99 00 D0 07 00 00"))).value == 2000


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x566, b"\x99\x00\xd0"),  # truncated
        CanFrame(0x566, b"\x19\x00\xd0\x07"),  # a question's byte
        CanFrame(0x166, b"\x99\x00\xd0\x07"),  # to a node
        CanFrame(0x565, b"\x99\x00\xd0\x07"),  # to the hand
        CanFrame(0x566, remote=True),
    ],
)
def test_what_is_no_reply_is_refused(frame: CanFrame) -> None:
    with pytest.raises(CodecError, match="no reply: CanFrame"):
        decode_reply(frame)


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x00B),
        CanFrame(0x00B, b"\x88\x00\x05"),
        CanFrame(0x00B, b"\x99"),
        CanFrame(0x00B, b"\x08\x00\x05\x00\x00\x00"),  # a question with a value
        CanFrame(0x00B, remote=True),
    ],
)
def test_what_is_no_request_is_refused(frame: CanFrame) -> None:
    with pytest.raises(CodecError, match="no request: CanFrame"):
        decode_request(frame)
