"""SSG-48: CAN frames ⇄ messages, no I/O.

Source: docs/reference/can_gripper.md, and the firmware's behaviour. An identifier is
`node << 7 | command << 1 | fault`; numbers are big-endian.

The two object bits: the maker's page numbers bits from the left and the firmware writes the low bit of the verdict
first, so that bit 5 of the byte is the low one; the vendor's own client takes it for the high one. Do
not distinguish 1 from 2 by these bits: `GripperState.object` is true for both, and the command gives the direction.
"""

from __future__ import annotations

import struct
from typing import Final

from drivers.can_gripper.messages import (
    ASKED,
    PLAIN,
    Answer,
    AskState,
    DriveOrder,
    Encoder,
    GripFinding,
    GripperCode,
    GripperErrors,
    GripperInfo,
    GripperState,
    Heartbeat,
    HeartbeatPeriod,
    Number,
    Order,
    Plain,
    Poll,
    Watchdog,
)
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError

NODES: Final = 16
"""Node numbers are 0 to 15 (docs/reference/can_gripper.md)."""

ERROR_BITS: Final = (
    "over temperature",
    "encoder",
    "supply voltage",
    "motor driver",
    "overspeed",
    "overcurrent",
    "emergency stop",
)
"""Bits 6 to 0 of the first byte of `GripperErrors`; bit 7 is any of them (docs/reference/can_gripper.md)."""

WATCHDOG_BIT: Final = 0x20
MOTOR_BIT: Final = 0x80
"""In the second byte of `GripperErrors` (docs/reference/can_gripper.md)."""


def encode_order(node: int, order: Order) -> CanFrame:
    """An order as the frame on the wire.

    Raises:
        struct.error: a number does not fit its field.
    """
    match order:
        case Plain(code=code):
            return CanFrame(_id(node, code))
        case AskState(code=code):
            return CanFrame(_id(node, code), remote=True)
        case Poll():
            return CanFrame(_id(node, GripperCode.DRIVE))
        case DriveOrder():
            flags = order.activate << 7 | order.go << 6 | order.estop << 5
            data = struct.pack(">BBhB", order.position, order.speed, order.current_ma, flags)
            return CanFrame(_id(node, GripperCode.DRIVE), data)
        case Watchdog():
            return CanFrame(
                _id(node, GripperCode.WATCHDOG), struct.pack(">IB", order.period_ms, order.action)
            )
        case HeartbeatPeriod():
            return CanFrame(_id(node, GripperCode.HEARTBEAT_PERIOD), struct.pack(">I", order.period_ms))


def decode_order(frame: CanFrame) -> tuple[int, Order]:
    """Node and order, as the gripper reads them.

    Raises:
        CodecError: no order of this protocol, or of another length.
    """
    node, code, _ = _parts(frame)
    if frame.remote:
        if code in ASKED:
            return node, AskState(code)
    elif code in PLAIN and not frame.data:
        return node, Plain(code)
    elif code is GripperCode.DRIVE and not frame.data:
        return node, Poll()
    elif code is GripperCode.DRIVE and len(frame.data) == 5:
        position, speed, current_ma, flags = struct.unpack(">BBhB", frame.data)
        return node, DriveOrder(position, speed, current_ma, _bit(flags, 7), _bit(flags, 6), _bit(flags, 5))
    elif code is GripperCode.WATCHDOG and len(frame.data) == 5:
        return node, Watchdog(*struct.unpack(">IB", frame.data))
    elif code is GripperCode.HEARTBEAT_PERIOD and len(frame.data) == 4:
        return node, HeartbeatPeriod(*struct.unpack(">I", frame.data))
    raise CodecError(f"no order: {frame}")


def encode_answer(node: int, fault: bool, answer: Answer) -> CanFrame:
    """An answer as the frame on the wire; `fault` where any fault is active."""
    match answer:
        case GripperState():
            code, data = GripperCode.STATE, _state_bytes(answer)
        case Heartbeat(code=code):
            data = b""
        case Number(code=code):
            data = struct.pack(">h", answer.value)
        case GripperInfo():
            code = GripperCode.INFO
            data = struct.pack(">BBBI", answer.hardware, answer.batch, answer.software, answer.serial)
        case GripperErrors():
            code, data = GripperCode.ERRORS, _error_bytes(answer, fault)
        case Encoder():
            code, data = GripperCode.ENCODER, struct.pack(">ii", answer.position, answer.speed)
    return CanFrame(_id(node, code, fault), data)


def decode_answer(frame: CanFrame) -> tuple[int, bool, Answer]:
    """Node, fault and answer, as the host reads them.

    Raises:
        CodecError: no answer of this protocol, or of another length.
    """
    node, code, fault = _parts(frame)
    data = frame.data
    answer: Answer | None = None
    if frame.remote:
        pass
    elif code is GripperCode.STATE and len(data) == 4:
        answer = _state(data)
    elif code in (GripperCode.PING, GripperCode.HEARTBEAT) and not data:
        answer = Heartbeat(code)
    elif code in (GripperCode.TEMPERATURE, GripperCode.VOLTAGE, GripperCode.CURRENT) and len(data) == 2:
        answer = Number(code, *struct.unpack(">h", data))
    elif code is GripperCode.INFO and len(data) == 7:
        answer = GripperInfo(*struct.unpack(">BBBI", data))
    elif code is GripperCode.ERRORS and len(data) == 2:
        answer = _errors(data)
    elif code is GripperCode.ENCODER and len(data) == 8:
        answer = Encoder(*struct.unpack(">ii", data))
    if answer is None:
        raise CodecError(f"no answer: {frame}")
    return node, fault, answer


def _id(node: int, code: GripperCode, fault: bool = False) -> int:
    if not 0 <= node < NODES:
        raise CodecError(f"no node {node}")
    return node << 7 | code << 1 | fault


def _parts(frame: CanFrame) -> tuple[int, GripperCode, bool]:
    try:
        return frame.id >> 7, GripperCode(frame.id >> 1 & 0x3F), _bit(frame.id, 0)
    except ValueError as error:
        raise CodecError(f"unknown command: {frame}") from error


def _bit(bits: int, place: int) -> bool:
    return bool(bits >> place & 1)


def _exchanged(two_bits: int) -> int:
    return (two_bits & 1) << 1 | two_bits >> 1


def _state_bytes(state: GripperState) -> bytes:
    flags = (
        state.activated << 7
        | state.going << 6
        | _exchanged(state.finding) << 4
        | state.over_temperature << 3
        | state.watchdog << 2
        | state.estop << 1
        | state.calibrated
    )
    return struct.pack(">BhB", state.position, state.current_ma, flags)


def _state(data: bytes) -> GripperState:
    position, current_ma, flags = struct.unpack(">BhB", data)
    finding = GripFinding(_exchanged(flags >> 4 & 0b11))
    activated, going, hot, late, stopped, calibrated = (_bit(flags, place) for place in (7, 6, 3, 2, 1, 0))
    return GripperState(position, current_ma, finding, activated, going, hot, late, stopped, calibrated)


def _error_bytes(errors: GripperErrors, fault: bool) -> bytes:
    first = sum(1 << (6 - place) for place, name in enumerate(ERROR_BITS) if name in errors.active)
    second = MOTOR_BIT * errors.motor_calibrated | WATCHDOG_BIT * ("watchdog" in errors.active)
    return bytes([first | fault << 7, second])


def _errors(data: bytes) -> GripperErrors:
    active = {name for place, name in enumerate(ERROR_BITS) if _bit(data[0], 6 - place)}
    if data[1] & WATCHDOG_BIT:
        active.add("watchdog")
    return GripperErrors(frozenset(active), bool(data[1] & MOTOR_BIT))
