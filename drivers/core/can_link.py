"""For CAN drivers: a python-can bus, and one thread that receives from it and can poll at a fixed rate."""

from __future__ import annotations

import logging
import math
import select
import threading
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, NamedTuple

from pydantic import Field

from drivers.core.can_frame import CanFrame
from drivers.core.clock import Clock
from drivers.core.errors import PortError, first_line, lacking
from drivers.core.links import JOIN_TIMEOUT_S, SerialPort, drained, open_serial
from drivers.core.settings import Settings

if TYPE_CHECKING:
    import can

RECEIVE_S = 0.05
"""Longest wait for a frame while nothing is polled: how long closing may take (assumption)."""

SERIAL_WAIT_S = 0.005
"""Longest wait of slcan for one byte: python-can's 1 ms would wake an idle thread a thousand times a second."""


class CanPort(Settings):
    """Where a CAN bus is; settings of drivers on one are derived from these."""

    port: str = Field(min_length=1)
    """Serial port of a slcan adapter, or what python-can calls the channel: `can0`, `PCAN_USBBUS1`, `0`, a multicast
    address, the name of a virtual bus."""
    interface: str = "slcan"
    """Which of python-can's interfaces, as its documentation names them: `socketcan`, `pcan`, `kvaser`, `gs_usb` …"""
    options: dict[str, bool | int | float | str] = Field(default={})
    """What else that interface takes, by its names; `bitrate` has its own setting."""
    bitrate: int = Field(default=1_000_000, ge=10_000, le=1_000_000)
    """Bits per second on the bus; a socketcan interface has its own (`ip link set can0 type can bitrate …`)."""
    tty_baud: int = Field(default=115_200, ge=9_600, le=4_000_000)
    """Line speed to a slcan adapter in bits per second; USB adapters ignore it."""

    @property
    def serial_port(self) -> bool:
        """See `Settings.serial_port`: a slcan adapter is at one."""
        return self.interface == "slcan"


def _bus(port: CanPort) -> can.BusABC:
    """The interface of python-can's that the port names."""
    if port.interface == "slcan":
        from drivers.core.can_slcan import PromptSlcan

        return PromptSlcan(
            port.port,
            tty_baudrate=port.tty_baud,
            bitrate=port.bitrate,
            sleep_after_open=0.0,
            timeout=SERIAL_WAIT_S,
        )
    import can

    channel = int(port.port) if port.port.isdecimal() else port.port
    # A python-can configuration file must not change what a profile does.
    options: dict[str, Any] = {"bitrate": port.bitrate, **port.options}
    return can.Bus(interface=port.interface, channel=channel, ignore_config=True, **options)


@dataclass(frozen=True, slots=True)
class PeriodicQuestion:
    """A question that is sent in every cycle.

    Cycle k is due at `period_s` times k after the first. The question is sent when the answers of the cycle before
    are in, or have had `answer_s`; a cycle that is late by more than half a period is skipped, so that a sample is
    never farther than that from its due time.

    Attributes:
        answers: Identifiers of the frames that answer it.
    """

    frame: CanFrame
    answers: frozenset[int]
    period_s: float
    answer_s: float


class ReceivedFrame(NamedTuple):
    """A frame and when it was in hand, in monotonic seconds.

    `cycle` and `due_s` are the number and the due time of the cycle that it answers, None where it answers none of the
    present question.
    """

    frame: CanFrame
    arrival_s: float
    cycle: int | None = None
    due_s: float | None = None


def open_can(device: str, port: CanPort, clock: Clock) -> CanLink:
    """Open a CAN bus.

    Raises:
        PortError: absent, busy, forbidden, or no such interface: one line with what to do.
    """
    doing = "opening its bus"
    try:
        import can
    except ImportError as error:
        raise PortError(device, doing, *lacking("python-can", "can")) from error
    logging.getLogger("can").addHandler(
        logging.NullHandler()
    )  # what an absent library prints, the error says
    if port.interface == "slcan":
        # python-can reports neither the error number nor that another program holds the port.
        open_serial(device, SerialPort(port=port.port, baud=port.tty_baud), clock).close()
    if port.interface not in can.VALID_INTERFACES:
        known = ", ".join(sorted(can.VALID_INTERFACES))
        raise PortError(
            device, doing, f"python-can knows no interface {port.interface}", f"there are: {known}"
        )
    try:
        bus = _bus(port)
    except Exception as error:  # each maker's library has its own
        raise PortError(
            device,
            doing,
            f"{port.interface} {port.port} cannot be opened ({first_line(error)})",
            f"is it up? see: ip link show {port.port}"
            if port.interface == "socketcan"
            else "see: ls /dev/serial/by-id"
            if port.interface == "slcan"
            else f"its library, port and options: see python-can's documentation of {port.interface}",
        ) from error
    if port.interface == "slcan":
        with suppress(OSError, ValueError, NotImplementedError):  # ptys refuse
            bus.serialPortOrig.set_low_latency_mode(True)  # type: ignore[attr-defined]
        with suppress(OSError):  # the next program to open it gets an error
            bus.serialPortOrig.exclusive = True  # type: ignore[attr-defined]
    return CanLink(device, bus, clock)


def strange_frames(others: int, link: CanLink) -> str:
    """Describes what arrived instead of an answer; "" where nothing did."""
    if not (others or link.malformed):
        return ""
    return f"{others} frames of others and {link.malformed} malformed ones came, and no answer"


class CanLink:
    """An open bus with its own thread.

    The thread fills a queue with time-stamped frames; between them it sends the periodic question, for which the loop
    turns too slowly. It raises nothing. Malformed lines, truncated frames and those of other kinds (extended, error,
    FD) are counted and dropped. What an adapter refuses is not reported (python-can drops its BEL): the answer does
    not come.

    `send`, `receive` and `ask` never wait; they belong to one thread, the loop's.

    Attributes:
        fault: Why the bus is gone, or None while it stands.
        malformed: Lines and frames dropped.
    """

    def __init__(self, device: str, bus: can.BusABC, clock: Clock) -> None:
        self.fault: str | None = None
        self.malformed = 0
        self._bus = bus
        self._clock = clock
        self._sending = threading.Lock()
        self._arrived: deque[tuple[PeriodicQuestion | None, ReceivedFrame]] = deque()
        self._question: PeriodicQuestion | None = None
        self._asked: PeriodicQuestion | None = None
        """The thread's own: it may still send this one after the loop has set another."""
        self._closing = False
        self._thread = threading.Thread(target=self._run, name=f"{device}-can", daemon=True)
        self._thread.start()

    def send(self, frame: CanFrame) -> float | None:
        """Hand a frame to the kernel, without waiting; a bus that has no room for it is gone.

        Returns:
            The monotonic time in seconds at which it was taken, or None where the bus is gone (see `fault`).
        """
        import can

        if self.fault is not None or self._closing:
            return None
        message = can.Message(
            arbitration_id=frame.id, data=frame.data, is_remote_frame=frame.remote, is_extended_id=False
        )
        try:
            with self._sending:
                self._bus.send(message)  # without a time-out it takes the frame at once or not at all
        except (can.CanError, OSError) as error:
            self.fault = self.fault or f"the bus takes no frame ({error})"
            return None
        return self._clock.monotonic_s()

    def receive(self) -> list[ReceivedFrame]:
        """What has arrived since the last call, in order."""
        return [  # the cycles of an earlier question mean nothing
            received if question is self._question else received._replace(cycle=None, due_s=None)
            for question, received in drained(self._arrived)
        ]

    def ask(self, question: PeriodicQuestion | None) -> None:
        """Send a question periodically from now on, or none; cycles count from 0 each time."""
        self._question = question

    def close(self) -> None:
        """Close the bus and wait for the thread. Never raises; may be called twice."""
        self._closing = True
        self._clock.leave()  # the thread may wait for a time that would wait for this one
        self._thread.join(JOIN_TIMEOUT_S)
        if self.fault is not None:
            with suppress(Exception):  # the kernel would wait half a minute for what the adapter never took
                self._bus.serialPortOrig.reset_output_buffer()  # type: ignore[attr-defined]
        with suppress(Exception):  # the adapter may be gone
            self._bus.shutdown()
        with suppress(AttributeError, OSError):  # slcan leaves its port open where closing the channel fails
            self._bus.serialPortOrig.close()  # type: ignore[attr-defined]

    def _run(self) -> None:
        while not self._closing and self.fault is None:
            question = self._question
            if question is None:
                self._read(RECEIVE_S)
            else:
                self._poll(question)

    def _poll(self, question: PeriodicQuestion) -> None:
        """Send a question in every cycle until the loop sets another one."""
        self._asked = question
        origin_s = self._clock.monotonic_s()
        number = 0
        while question is self._question and not self._closing and self.fault is None:
            due_s = origin_s + number * question.period_s
            self._clock.rest(max(0.0, due_s - self._clock.monotonic_s()))
            # A late answer would be taken for one to this cycle, and each later one for the next cycle's.
            self._read_pending(question.answer_s)
            self.send(question.frame)
            waiting = set(question.answers)
            until_s = self._clock.monotonic_s() + question.answer_s
            self._clock.hold(until_s)  # an answer needs its time
            while waiting and self.fault is None and (left_s := until_s - self._clock.monotonic_s()) > 0.0:
                for received in self._read(left_s, waiting, number, due_s):
                    waiting.discard(received.frame.id)
            number = max(
                number + 1, math.ceil((self._clock.monotonic_s() - origin_s) / question.period_s - 0.5)
            )
        self._asked = None
        self._clock.leave()

    def _read_pending(self, limit_s: float) -> None:
        """Read all frames that have arrived already, for at most `limit_s`."""
        import can

        until_s = self._clock.monotonic_s() + limit_s
        # A virtual bus has nothing to select on, and nothing that could be late.
        with suppress(NotImplementedError, can.CanError, OSError, ValueError):
            while self.fault is None and select.select([self._bus.fileno()], [], [], 0.0)[0]:
                self._read(0.0)
                if self._clock.monotonic_s() > until_s:
                    break

    def _read(
        self,
        wait_s: float,
        waiting: frozenset[int] | set[int] = frozenset(),
        cycle: int | None = None,
        due_s: float | None = None,
    ) -> list[ReceivedFrame]:
        """Queue at most one frame; `waiting` are the answers of this cycle that are not in yet."""
        import can

        try:
            message = self._bus.recv(wait_s)
        except (ValueError, IndexError):  # a line that is no slcan
            self.malformed += 1
            return []
        except (can.CanError, OSError, TypeError) as error:  # TypeError: the port went while it was read
            if isinstance(error.__cause__, UnicodeDecodeError):
                self.malformed += 1
                with suppress(can.CanError):  # python-can would keep the noise before every other line
                    self._bus.flush()  # type: ignore[attr-defined]
            elif not self._closing:
                self.fault = self.fault or f"the bus was taken away ({error})"
            return []
        arrival_s = self._clock.monotonic_s()
        if message is None:
            return []
        truncated = not message.is_remote_frame and len(message.data) != message.dlc
        if truncated or message.is_extended_id or message.is_error_frame or message.is_fd:
            self.malformed += 1
            return []
        frame = CanFrame(message.arbitration_id, bytes(message.data), message.is_remote_frame)
        received = ReceivedFrame(frame, arrival_s, *((cycle, due_s) if frame.id in waiting else (None, None)))
        self._arrived.append((self._asked, received))
        return [received]
