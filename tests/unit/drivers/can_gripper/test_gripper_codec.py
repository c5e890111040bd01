"""Frames of the SSG-48 against bytes written by hand from docs/reference/grippers.md."""

from dataclasses import replace

import pytest

from drivers.can_gripper.codec import (
    POLL,
    Answer,
    DriveOrder,
    GripperCode,
    GripperErrors,
    GripperMessage,
    Order,
    decode_answer,
    decode_order,
    encode_answer,
    encode_order,
)
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError
from drivers.gripper.state import GripFinding, GripperState

ORDERS = [
    (0, DriveOrder(100, 20, 500), "07A", "64 14 01 F4 C0"),
    (0, DriveOrder(255, 255, -1, activate=False, go=False, estop=True), "07A", "FF FF FF FF 20"),
    (3, POLL, "1FA", ""),
    (0, GripperMessage(GripperCode.CALIBRATE), "07C", ""),
    (0, GripperMessage(GripperCode.CLEAR_ERROR), "002", ""),
    (0, GripperMessage(GripperCode.ESTOP), "000", ""),
    (15, GripperMessage(GripperCode.IDLE), "798", ""),
    (0, GripperMessage(GripperCode.WATCHDOG, (1000, 0)), "01E", "00 00 03 E8 00"),
    (0, GripperMessage(GripperCode.HEARTBEAT_PERIOD, (500,)), "03C", "00 00 01 F4"),
    (0, DriveOrder(1, 2, 3, activate=True, go=False), "07A", "01 02 00 03 80"),
    (0, GripperMessage(GripperCode.WATCHDOG, (2**32 - 1, 200)), "01E", "FF FF FF FF C8"),
    (0, GripperMessage(GripperCode.HEARTBEAT_PERIOD, (2**32 - 1,)), "03C", "FF FF FF FF"),
]


def state(finding: GripFinding, position: int = 128, current_ma: int = -300, **faults: bool) -> GripperState:
    flags = {"over_temperature": False, "watchdog": False, "estop": False, **faults}
    return GripperState(position, current_ma, finding, activated=True, going=True, calibrated=True, **flags)


ANSWERS = [
    (0, False, state(GripFinding.OBJECT_CLOSING), "078", "80 FE D4 E1"),
    (0, False, state(GripFinding.OBJECT_OPENING, 7, 300), "078", "07 01 2C D1"),
    (0, False, state(GripFinding.AT_POSITION), "078", "80 FE D4 F1"),
    (0, True, state(GripFinding.MOVING, watchdog=True), "079", "80 FE D4 C5"),
    (0, True, state(GripFinding.MOVING, over_temperature=True, estop=True), "079", "80 FE D4 CB"),
    (2, False, GripperMessage(GripperCode.HEARTBEAT), "112", ""),
    (0, False, GripperMessage(GripperCode.PING), "014", ""),
    (0, False, GripperMessage(GripperCode.TEMPERATURE, (31,)), "02E", "00 1F"),
    (0, False, GripperMessage(GripperCode.VOLTAGE, (24_000,)), "030", "5D C0"),
    (0, False, GripperMessage(GripperCode.CURRENT, (-2,)), "036", "FF FE"),
    (0, False, GripperMessage(GripperCode.INFO, (2, 25, 1, 4848)), "032", "02 19 01 00 00 12 F0"),
    (0, True, GripperErrors(frozenset({"emergency stop", "watchdog"})), "035", "81 A0"),
    (0, False, GripperErrors(frozenset()), "034", "00 80"),
    (0, False, replace(state(GripFinding.AT_POSITION), going=False), "078", "80 FE D4 B1"),
    (0, False, GripperMessage(GripperCode.INFO, (200, 201, 202, 2**32 - 1)), "032", "C8 C9 CA FF FF FF FF"),
    (0, True, GripperErrors(frozenset({"encoder"}), motor_calibrated=False), "035", "A0 00"),
    (0, False, GripperMessage(GripperCode.ENCODER, (4321, -200)), "038", "00 00 10 E1 FF FF FF 38"),
]


@pytest.mark.parametrize(("node", "order", "identifier", "data"), ORDERS)
def test_orders_are_the_bytes_of_the_interface_page(
    node: int, order: Order, identifier: str, data: str
) -> None:
    frame = CanFrame(int(identifier, 16), bytes.fromhex(data))
    assert encode_order(node, order) == frame
    assert decode_order(frame) == (node, order)


@pytest.mark.parametrize(
    ("code", "identifier"),
    [
        ("PING", 0x14),
        ("TEMPERATURE", 0x2E),
        ("VOLTAGE", 0x30),
        ("INFO", 0x32),
        ("ERRORS", 0x34),
        ("CURRENT", 0x36),
        ("ENCODER", 0x38),
    ],
)
def test_queries_are_remote_frames(code: str, identifier: int) -> None:
    frame, query = CanFrame(identifier, remote=True), GripperMessage(GripperCode[code])
    assert encode_order(0, query) == frame
    assert decode_order(frame) == (0, query)


@pytest.mark.parametrize(("node", "fault", "answer", "identifier", "data"), ANSWERS)
def test_answers_are_the_bytes_of_the_interface_page(
    node: int, fault: bool, answer: Answer, identifier: str, data: str
) -> None:
    frame = CanFrame(int(identifier, 16), bytes.fromhex(data))
    assert encode_answer(node, fault, answer) == frame
    assert decode_answer(frame) == (node, fault, answer)


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x78, b"\x80\xfe\xd4"),  # truncated
        CanFrame(0x78, remote=True),
        CanFrame(0x7A, bytes(5)),  # an order
        CanFrame(0x2E, b"\x00"),
        CanFrame(0x20, b""),  # no such command
        CanFrame(0x78, b""),  # the length of another answer
        CanFrame(0x34, bytes(7)),
        CanFrame(0x38, bytes(2)),
        CanFrame(0x34, bytes(8)),
    ],
)
def test_what_is_no_answer_is_refused(frame: CanFrame) -> None:
    with pytest.raises(CodecError, match=r"no answer: CanFrame|unknown command: CanFrame"):
        decode_answer(frame)


@pytest.mark.parametrize(
    "frame",
    [
        CanFrame(0x7A, bytes(4)),
        CanFrame(0x7C, b"\x00"),
        CanFrame(0x7A, remote=True),
        CanFrame(0x78, bytes(4)),
        CanFrame(0x3C, bytes(5)),
    ],
)
def test_what_is_no_order_is_refused(frame: CanFrame) -> None:
    with pytest.raises(CodecError, match=r"no order: CanFrame|unknown command: CanFrame"):
        decode_order(frame)


def test_a_node_beyond_fifteen_is_refused() -> None:
    with pytest.raises(CodecError, match="no node 16"):
        encode_order(16, POLL)
