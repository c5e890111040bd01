"""Orders to the board: tags, replies, one repetition, silence."""

from dataclasses import dataclass

from drivers.core.links import SerialLink
from drivers.core.messages import Command
from drivers.sensor_board.codec import BoardCode, BoardReply, CommandFrame, encode

TAGS = 256
"""The tag is a u8. By the time it wraps, the replies to earlier orders are in."""


@dataclass(slots=True, eq=False)
class BoardOrder:
    """An order on its way.

    Attributes:
        command: The command that it carries out, or None for the driver's own.
        sent_s: Monotonic time in seconds at which its last byte was first written; None where it was not.
        due_s: When the reply should be here, in `BoardDialogue`'s time.
        repeated: It has been written twice.
        superseded: A later order on the same thing has been written: this one must not be repeated.
    """

    code: BoardCode
    argument: int | None
    command: Command | None
    frame: bytes
    sent_s: float | None
    due_s: float
    repeated: bool = False
    superseded: bool = False

    @property
    def subject(self) -> tuple[BoardCode, int | None]:
        """Its subject: of two orders on the same one, the later holds."""
        if self.code is BoardCode.TARE:
            return self.code, self.argument
        return (BoardCode.START if self.code is BoardCode.STOP else self.code), None


class BoardDialogue:
    """Orders that have no reply yet.

    An order without a reply is written once more, under its tag. Orders set a state, so repeating one does no harm,
    unless a newer one on the same thing was sent; then it is dropped. One that stays without a reply is a fault of
    the board. Nothing here waits. Its time (`attended_s`) stands still while the host is away.
    """

    def __init__(self, link: SerialLink, timeout_s: float) -> None:
        self._link = link
        self.timeout_s = timeout_s
        self._tag = 0
        self._orders: dict[int, BoardOrder] = {}

    @property
    def idle(self) -> bool:
        """Whether no reply is awaited."""
        return not self._orders

    def awaits(self, code: BoardCode) -> bool:
        """Whether a reply to such an order is awaited."""
        return any(order.code is code for order in self._orders.values())

    def ask(
        self, attended_s: float, code: BoardCode, argument: int | None = None, command: Command | None = None
    ) -> BoardOrder:
        """Write an order; `attended_s` is the time now."""
        self._tag = (self._tag + 1) % TAGS
        frame = encode(CommandFrame(code, self._tag, argument))
        sent_s = self._link.send(frame)
        order = BoardOrder(code, argument, command, frame, sent_s, attended_s + self.timeout_s)
        for earlier in self._orders.values():
            earlier.superseded |= earlier.subject == order.subject
        self._orders[self._tag] = order
        return order

    def answered(self, reply: BoardReply) -> BoardOrder | None:
        """The order that this replies to; None for a reply that is not awaited."""
        order = self._orders.get(reply.tag)
        if order is None or order.code != reply.code:
            return None
        return self._orders.pop(reply.tag)

    def turn(self, attended_s: float) -> str | None:
        """Repeat what is overdue; returns what is wrong where the board does not answer, or None."""
        for tag, order in list(self._orders.items()):
            if attended_s < order.due_s:
                continue
            if order.superseded:
                del self._orders[tag]
            elif order.repeated:
                return f"no reply to {order.code.name.lower()}, asked twice in {2 * self.timeout_s:g} s"
            else:
                self._link.send(order.frame)
                order.repeated = True
                order.due_s = attended_s + self.timeout_s
        return None
