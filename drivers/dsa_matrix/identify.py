"""Identity of the controller and its matrices, queried by `open`, through power-up if need be."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from drivers.core.clock import Clock
from drivers.core.errors import CodecError, ProtocolError, RefusedError
from drivers.core.links import SerialLink
from drivers.core.wire import Inquiry
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.packets import MatrixPacket, PacketDecoder, encode_packet

ATTEMPTS = 3
"""How often a query is sent to a controller that has answered before (assumption)."""

T = TypeVar("T", bound=codec.Answer)


@dataclass(frozen=True, slots=True)
class MatrixIdentity:
    """The controller and what is connected to it.

    Attributes:
        controller: Its identity.
        sensor: That is connected.
        matrices: Of the sensor.
        set_threshold: Sets the threshold of all matrices and reads it back.
    """

    controller: codec.ControllerInfo
    sensor: codec.SensorInfo
    matrices: tuple[codec.MatrixInfo, ...]
    set_threshold: Callable[[int], None]


def identify(
    name: str,
    port: str,
    link: SerialLink,
    decoder: PacketDecoder,
    clock: Clock,
    power_up_s: float,
    timeout_s: float,
) -> MatrixIdentity:
    """Stop the frames of an earlier host, then query the controller and its matrices.

    Args:
        name: Of the device, for errors.
        port: Its port, for errors.
        link: To the port.
        decoder: Left in step with the line.
        clock: Times the answers.
        power_up_s: How long to wait for the first answer.
        timeout_s: How long any other may take.

    Raises:
        PortError: the port was taken away.
        SilentError: nothing came.
        ProtocolError: what came is no answer of a DSACON32-M.
        RefusedError: it answers with an error.
    """
    dialogue = _Dialogue(name, port, link, decoder, clock, timeout_s)
    attempts = max(ATTEMPTS, round(power_up_s / timeout_s))
    dialogue.ask(codec.Acquire(run=False, rle=True, frames_per_s=0), codec.Done, attempts)
    controller = dialogue.ask(codec.AskMatrices(codec.Id.CONTROLLER), codec.ControllerInfo)
    sensor = dialogue.ask(codec.AskMatrices(codec.Id.SENSOR), codec.SensorInfo)
    matrices = tuple(
        dialogue.ask(codec.AskMatrix(codec.Id.MATRIX, number), codec.MatrixInfo)
        for number in range(sensor.matrices)
    )

    def set_threshold(counts: int) -> None:
        dialogue.ask(codec.SetThreshold(counts), codec.Done)
        for number in range(sensor.matrices):
            held = dialogue.ask(codec.AskMatrix(codec.Id.THRESHOLD, number), codec.Threshold).counts
            if held != counts:
                reason = f"matrix {number} was set to threshold {counts} and holds {held}"
                raise RefusedError(name, "setting it up", reason, "is its firmware older than release 268?")

    return MatrixIdentity(controller, sensor, matrices, set_threshold)


class _Dialogue:
    """Questions, one at a time."""

    def __init__(
        self, name: str, port: str, link: SerialLink, decoder: PacketDecoder, clock: Clock, timeout_s: float
    ) -> None:
        self._name = name
        self._doing = f"asking who is at {port}"
        self._link = link
        self._decoder = decoder
        self._inquiry = Inquiry(
            name,
            self._doing,
            link,
            clock,
            timeout_s,
            strange=self._strange,
            stranger="is another device at this port, or the baud rate wrong?",
            silent="is it powered?",
        )

    def ask(self, request: codec.Request, kind: type[T], attempts: int = ATTEMPTS) -> T:
        """Ask until this packet's answer comes."""
        packet = codec.encode_request(request)

        def send() -> None:
            self._decoder.flush()  # left over from the last attempt
            self._link.send(encode_packet(packet))

        def parse(arrived: tuple[float, bytes]) -> T | None:
            answers = [
                self._decoded(received, kind)
                for received in self._decoder.feed(arrived[1])
                if received.id == packet.id
            ]
            return next((answer for answer in answers if answer is not None), None)

        return self._inquiry.ask(send, parse, attempts)

    def _decoded(self, packet: MatrixPacket, kind: type[T]) -> T | None:
        try:
            answer = codec.decode_answer(packet)
        except CodecError as error:
            raise ProtocolError(self._name, self._doing, str(error), "is it a DSACON32-M?") from error
        refusal = getattr(answer, "error", 0)
        if refusal:
            reason = f"it answers with an error: {codec.meaning(refusal)}"
            raise RefusedError(self._name, self._doing, reason, "is its sensor plugged in?")
        return answer if isinstance(answer, kind) else None

    def _strange(self) -> str:
        noise = self._decoder.noise.replace(codec.POWER_UP_NOISE, b"")
        packets = self._decoder.counts.good
        return f"{noise!r} and {packets} packets came, and no answer" if noise or packets else ""
