"""SSG-48: CAN frames ⇄ messages, no I/O.

Source: docs/reference/grippers.md, and the firmware's behaviour. An identifier is
`node << 7 | command << 1 | fault`; numbers are big-endian.

The two object bits: the maker's page numbers bits from the left and the firmware writes the low bit of the verdict
first, so that bit 5 of the byte is the low one; the vendor's own client takes it for the high one. Do
not distinguish 1 from 2 by these bits: `GripperState.object` is true for both, and the command gives the direction.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from enum import IntEnum
from struct import Struct
from typing import Final, NamedTuple

from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError
from drivers.gripper.state import GripFinding, GripperState

NODES: Final = 16
"""Node numbers are 0 to 15 (docs/reference/grippers.md)."""

ERROR_BITS: Final = (
    "over temperature",
    "encoder",
    "supply voltage",
    "motor driver",
    "overspeed",
    "overcurrent",
    "emergency stop",
)
"""Bits 6 to 0 of the first byte of `GripperErrors`; bit 7 is any of them (docs/reference/grippers.md)."""

WATCHDOG_BIT: Final = 0x20
MOTOR_BIT: Final = 0x80
"""In the second byte of `GripperErrors` (docs/reference/grippers.md)."""


class GripperCode(IntEnum):
    """Command numbers, 6 bits (docs/reference/grippers.md)."""

    ESTOP = 0
    CLEAR_ERROR = 1
    HEARTBEAT = 9
    PING = 10
    IDLE = 12
    WATCHDOG = 15
    TEMPERATURE = 23
    VOLTAGE = 24
    INFO = 25
    ERRORS = 26
    CURRENT = 27
    ENCODER = 28
    HEARTBEAT_PERIOD = 30
    STATE = 60
    DRIVE = 61
    CALIBRATE = 62


ORDERS: Final[Mapping[GripperCode, Struct]] = {
    GripperCode.ESTOP: Struct(""),
    GripperCode.CLEAR_ERROR: Struct(""),
    GripperCode.IDLE: Struct(""),
    GripperCode.CALIBRATE: Struct(""),
    GripperCode.DRIVE: Struct(""),
    GripperCode.WATCHDOG: Struct(">IB"),
    GripperCode.HEARTBEAT_PERIOD: Struct(">I"),
}
"""Numbers of each order. `WATCHDOG`: a fault where nothing arrives for so many ms, 0 for never; an action that the
firmware stores and never uses. `HEARTBEAT_PERIOD`: ms, 0 for never."""

READINGS: Final[Mapping[GripperCode, Struct]] = {
    GripperCode.HEARTBEAT: Struct(""),
    GripperCode.PING: Struct(""),
    GripperCode.TEMPERATURE: Struct(">h"),
    GripperCode.VOLTAGE: Struct(">h"),
    GripperCode.CURRENT: Struct(">h"),
    GripperCode.ENCODER: Struct(">ii"),
    GripperCode.INFO: Struct(">BBBI"),
}
"""Numbers of each reading: degrees Celsius; mV; mA; ticks and ticks per second, positive opens; hardware, batch,
software and serial number."""

QUERIES: Final = (READINGS.keys() | {GripperCode.ERRORS}) - {GripperCode.HEARTBEAT}
"""What a remote frame can ask for; the answer has the same number."""


class GripperMessage(NamedTuple):
    """An order or a query (to the gripper), or a reading (from it), with its numbers; a query has none."""

    code: GripperCode
    numbers: tuple[int, ...] = ()


POLL: Final = GripperMessage(GripperCode.DRIVE)
"""Asks for `GripperState` and feeds the watchdog."""


@dataclass(frozen=True, slots=True)
class DriveOrder:
    """Go to a position; answered by `GripperState`.

    Attributes:
        position: 0 open to 255 closed.
        speed: 0 to 255.
        current_ma: Limit.
        activate: Wake the drive.
        go: Move; else it sleeps.
        estop: Raise the emergency stop; it stays up until an order without it, and a `CLEAR_ERROR`.
    """

    position: int
    speed: int
    current_ma: int
    activate: bool = True
    go: bool = True
    estop: bool = False


Order = GripperMessage | DriveOrder


@dataclass(frozen=True, slots=True)
class GripperErrors:
    """Active faults by name, and whether the motor is calibrated (by the maker; not the jaws)."""

    active: frozenset[str]
    motor_calibrated: bool = True


Answer = GripperState | GripperErrors | GripperMessage


def encode_order(node: int, order: Order) -> CanFrame:
    """An order or a query as the frame on the wire.

    Raises:
        struct.error: a number does not fit its field.
    """
    if isinstance(order, DriveOrder):
        flags = order.activate << 7 | order.go << 6 | order.estop << 5
        data = struct.pack(">BBhB", order.position, order.speed, order.current_ma, flags)
        return CanFrame(_id(node, GripperCode.DRIVE), data)
    if order.code in QUERIES:
        return CanFrame(_id(node, order.code), remote=True)
    return CanFrame(_id(node, order.code), ORDERS[order.code].pack(*order.numbers))


def decode_order(frame: CanFrame) -> tuple[int, Order]:
    """Node and order or query, as the gripper reads them.

    Raises:
        CodecError: no order of this protocol, or of another length.
    """
    node, code, _ = _parts(frame)
    layout = ORDERS.get(code)
    if frame.remote:
        if code in QUERIES:
            return node, GripperMessage(code)
    elif code is GripperCode.DRIVE and len(frame.data) == 5:
        position, speed, current_ma, flags = struct.unpack(">BBhB", frame.data)
        return node, DriveOrder(position, speed, current_ma, _bit(flags, 7), _bit(flags, 6), _bit(flags, 5))
    elif layout is not None and len(frame.data) == layout.size:
        return node, GripperMessage(code, layout.unpack(frame.data))
    raise CodecError(f"no order: {frame}")


def encode_answer(node: int, fault: bool, answer: Answer) -> CanFrame:
    """An answer as the frame on the wire; `fault` where any fault is active."""
    match answer:
        case GripperState():
            code, data = GripperCode.STATE, _state_bytes(answer)
        case GripperErrors():
            code, data = GripperCode.ERRORS, _error_bytes(answer, fault)
        case GripperMessage(code, numbers):
            data = READINGS[code].pack(*numbers)
    return CanFrame(_id(node, code, fault), data)


def decode_answer(frame: CanFrame) -> tuple[int, bool, Answer]:
    """Node, fault and answer, as the host reads them.

    Raises:
        CodecError: no answer of this protocol, or of another length.
    """
    node, code, fault = _parts(frame)
    data, layout = frame.data, READINGS.get(code)
    if not frame.remote:
        if code is GripperCode.STATE and len(data) == 4:
            return node, fault, _state(data)
        if code is GripperCode.ERRORS and len(data) == 2:
            return node, fault, _errors(data)
        if layout is not None and len(data) == layout.size:
            return node, fault, GripperMessage(code, layout.unpack(data))
    raise CodecError(f"no answer: {frame}")


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
    activated, going, hot, watchdog, estop, calibrated = (_bit(flags, place) for place in (7, 6, 3, 2, 1, 0))
    return GripperState(position, current_ma, finding, activated, going, hot, watchdog, estop, calibrated)


def _error_bytes(errors: GripperErrors, fault: bool) -> bytes:
    first = sum(1 << (6 - place) for place, name in enumerate(ERROR_BITS) if name in errors.active)
    second = MOTOR_BIT * errors.motor_calibrated | WATCHDOG_BIT * ("watchdog" in errors.active)
    return bytes([first | fault << 7, second])


def _errors(data: bytes) -> GripperErrors:
    active = {name for place, name in enumerate(ERROR_BITS) if _bit(data[0], 6 - place)}
    if data[1] & WATCHDOG_BIT:
        active.add("watchdog")
    return GripperErrors(frozenset(active), bool(data[1] & MOTOR_BIT))
