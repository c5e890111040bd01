"""What answers at ports that no profile uses: each is asked for a name, which moves and changes nothing."""

import logging
import re
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress

import serial

from drivers.core.errors import CodecError
from drivers.dsa_matrix.codec import ControllerInfo, Id, decode_answer, request
from drivers.dsa_matrix.packets import PacketDecoder, encode_packet
from drivers.sensor_board.codec import BoardCode, BoardHello, CommandFrame, decode, encode
from drivers.sensor_board.framing import BoardFrameDecoder
from drivers.zaber_stage.models import stage_model

ANSWER_S = 0.3
"""How long an answer is waited for (assumption: ten times what an adapter's latency and a stage's answer take)."""

BOOT_S = 2.5
"""How long a board that opening its port has reset takes to begin (assumption: an Uno's bootloader waits for 2 s)."""


def _stage(heard: bytes) -> str:
    found = re.search(rb"@(\d\d) \d OK \S+ \S+ (\d+)", heard)
    if not found:
        return ""
    model = stage_model(int(found[2]))
    known = f", {model.name}: microstep_m = {model.microstep_m:.10g}" if model else ""
    return f"zaber_stage: address {int(found[1])}, device id {int(found[2])}{known}"


def _adapter(heard: bytes) -> str:
    found = re.search(rb"V[0-9A-F]{4}\r", heard)
    return "a CAN adapter (slcan); what is on its bus was not asked" if found else ""


def _matrix(heard: bytes) -> str:
    for packet in PacketDecoder().feed(heard):
        if packet.id == Id.CONTROLLER and isinstance(found := decode_answer(packet), ControllerInfo):
            return f"dsa_matrix: DSACON32-M, serial {found.serial}"
    return ""


def _board(heard: bytes) -> str:
    for body in BoardFrameDecoder().feed(b"\0" + heard):
        if isinstance(found := decode(body), BoardHello):
            return f"sensor_board: {found.board}, serial {found.serial}"
    return ""


def _printer(heard: bytes) -> str:
    found = re.search(rb"\n((?:-?\d+(?:\.\d*)?[,;\t ]+)+-?\d+(?:\.\d*)?)\r?\n", heard)
    return f"serial_lines: it prints '{found[1].decode()}'" if found else ""


QUESTIONS: Sequence[tuple[int, bytes, Callable[[bytes], str]]] = (
    (115_200, b"", _printer),
    (115_200, b"\n/get deviceid\n", _stage),
    (115_200, b"\rV\r", _adapter),
    (115_200, encode_packet(request(Id.CONTROLLER)), _matrix),
    (921_600, b"\0" + encode(CommandFrame(BoardCode.HELLO, 0)), _board),
)
"""Line speed, what is asked, and who gives such an answer, "" where nobody known does. For the kinds that can be told
apart, at the line speeds with which they are delivered. What is on a CAN bus is not asked: at another bit rate than the
bus has, that would disturb what runs there."""


def who_answers(ports: Sequence[str]) -> Sequence[str]:
    """What answers at each of these serial ports, all of them at once; opening one resets many a board."""
    with ThreadPoolExecutor(max(1, len(ports))) as threads:
        return list(threads.map(_who, ports))


def can_interfaces() -> Sequence[str]:
    """The CAN interfaces that python-can finds, as a profile names them; none where it is not installed."""
    try:
        import can
    except ImportError:
        return ()
    logging.getLogger("can").setLevel(logging.CRITICAL)  # of every library that is not installed
    found = can.detect_available_configs(["socketcan", "pcan", "kvaser", "gs_usb", "ixxat", "vector"])
    return [f"{each['interface']}:{each['channel']}" for each in found]


def _who(port: str) -> str:
    try:
        with serial.Serial(port, exclusive=True, timeout=ANSWER_S, write_timeout=ANSWER_S) as line:
            heard = b""
            for again in (False, True):
                for baud, asked, who in QUESTIONS:
                    line.baudrate = baud
                    line.write(asked)
                    answer = line.read(4096)
                    heard += answer
                    with suppress(CodecError):
                        if found := who(answer):
                            return found
                if not again:
                    time.sleep(BOOT_S)
                    line.reset_input_buffer()
    except OSError as error:  # pyserial's own are of these
        return f"not asked: {error}"
    if heard:
        return f"sends {heard[:20]!r}, which is of no kind known here"
    return "nothing that is known here answers"
