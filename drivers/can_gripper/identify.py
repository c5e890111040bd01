"""Who is at the other end of the bus, and how it is: what `open` asks."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

from drivers.can_gripper.brackets import CanGripperSettings
from drivers.can_gripper.codec import decode_answer, encode_order
from drivers.can_gripper.messages import (
    Answer,
    AskState,
    GripperCode,
    GripperErrors,
    GripperInfo,
    GripperState,
    Number,
    Order,
    Poll,
)
from drivers.can_link import CanLink, ReceivedFrame, strange_frames
from drivers.clock import Clock
from drivers.errors import CodecError
from drivers.wire import Inquiry

ATTEMPTS = 4
"""How often a question is asked (assumption: three frames may be lost)."""

T = TypeVar("T")


class GripperIdentity(NamedTuple):
    """What a gripper says of itself."""

    info: GripperInfo
    errors: GripperErrors
    temperature_c: float
    supply_v: float
    state: GripperState


def identify(name: str, settings: CanGripperSettings, link: CanLink, clock: Clock) -> GripperIdentity:
    """Ask who it is, and how; nothing moves.

    Raises:
        PortError: the bus was taken away.
        SilentError: nothing came.
        ProtocolError: what came is none of this gripper's.
    """

    def answer(order: Order, kind: type[T]) -> T:
        return _answer(name, settings, link, clock, order, kind)

    return GripperIdentity(
        answer(AskState(GripperCode.INFO), GripperInfo),
        answer(AskState(GripperCode.ERRORS), GripperErrors),
        float(answer(AskState(GripperCode.TEMPERATURE), Number).value),
        answer(AskState(GripperCode.VOLTAGE), Number).value * 1e-3,
        answer(Poll(), GripperState),
    )


def heard_from(node: int, heard: ReceivedFrame) -> tuple[Answer, bool] | None:
    """What this node says, and whether it has a fault; None where it is not this gripper that speaks."""
    try:
        sender, fault, answer = decode_answer(heard.frame)
    except CodecError:
        return None
    return (answer, fault) if sender == node else None


def _answer(
    name: str, settings: CanGripperSettings, link: CanLink, clock: Clock, order: Order, kind: type[T]
) -> T:
    strangers = 0

    def hear(heard: ReceivedFrame) -> T | None:
        nonlocal strangers
        said = heard_from(settings.node, heard)
        strangers += said is None
        mine = said is not None and isinstance(said[0], kind) and _fits(order, said[0])
        return said[0] if mine else None  # type: ignore[index, return-value]

    where = f"node {settings.node}, and the bus at {settings.bitrate} bit/s?"
    inquiry = Inquiry(
        name,
        f"asking who is at {settings.port}",
        link,
        clock,
        settings.reply_timeout_s,
        strange=lambda: strange_frames(strangers, link),
        stranger=f"is the gripper {where}",
        silent=f"is it powered with 24 V, {where}",
    )
    return inquiry.ask(lambda: link.send(encode_order(settings.node, order)), hear, ATTEMPTS)


def _fits(order: Order, answer: object) -> bool:
    """A temperature is no voltage: numbers bear the code that was asked for."""
    return not (isinstance(order, AskState) and isinstance(answer, Number)) or answer.code is order.code
