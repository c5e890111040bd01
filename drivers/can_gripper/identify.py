"""Identity and state of the gripper on the bus, queried by `open`."""

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
from drivers.core.can_link import CanLink, ReceivedFrame, strange_frames
from drivers.core.clock import Clock
from drivers.core.errors import CodecError
from drivers.core.wire import Inquiry

ATTEMPTS = 4
"""How often a query is sent (assumption: three frames may be lost)."""

T = TypeVar("T")


class GripperIdentity(NamedTuple):
    """What a gripper reports of itself."""

    info: GripperInfo
    errors: GripperErrors
    temperature_c: float
    supply_v: float
    state: GripperState


def identify(name: str, settings: CanGripperSettings, link: CanLink, clock: Clock) -> GripperIdentity:
    """Query identity and state; nothing moves.

    Raises:
        PortError: the bus was taken away.
        SilentError: nothing came.
        ProtocolError: no frame is from this gripper.
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


def answer_from(node: int, received: ReceivedFrame) -> tuple[Answer, bool] | None:
    """An answer of this node, and whether it has a fault; None where the frame is something else."""
    try:
        sender, fault, answer = decode_answer(received.frame)
    except CodecError:
        return None
    return (answer, fault) if sender == node else None


def _answer(
    name: str, settings: CanGripperSettings, link: CanLink, clock: Clock, order: Order, kind: type[T]
) -> T:
    strangers = 0

    def parse(received: ReceivedFrame) -> T | None:
        nonlocal strangers
        answer = answer_from(settings.node, received)
        strangers += answer is None
        mine = answer is not None and isinstance(answer[0], kind) and _fits(order, answer[0])
        return answer[0] if mine else None  # type: ignore[index, return-value]

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
    return inquiry.ask(lambda: link.send(encode_order(settings.node, order)), parse, ATTEMPTS)


def _fits(order: Order, answer: object) -> bool:
    """Whether an answer fits an order: numbers carry the code that was queried."""
    return not (isinstance(order, AskState) and isinstance(answer, Number)) or answer.code is order.code
