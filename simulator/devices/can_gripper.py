"""An emulated SSG-48: CAN frames on the motion of a drive; no bus, no clock."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from drivers.can_gripper import units
from drivers.can_gripper.codec import (
    POLL,
    QUERIES,
    Answer,
    DriveOrder,
    GripperCode,
    GripperErrors,
    GripperMessage,
    Order,
    decode_order,
    encode_answer,
)
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError
from drivers.gripper.state import GripperState
from simulator.devices.far_end import EmulatedDevice
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.bench import part
from simulator.physics.jaws_drive import JawsDrive

HEARTBEAT_S = 1.0
"""Period of its heartbeat (docs/reference/grippers.md)."""

INFO = (2, 25, 1, 4848)
"""What it says of itself: hardware, batch, firmware, serial number (assumption)."""

USUAL_C, HOT_C = 31, 80
"""Temperature that it reports while nothing is wrong, and when it is too hot (assumption)."""

SUPPLY_MV = 24_000
"""Supply that it reports (data sheet: 24 V)."""


class EmulatedCanGripper(EmulatedDevice):
    """Answers as the gripper does.

    Its habits, all of the firmware's: orders but `DriveOrder` and `POLL` have no answer; a `DriveOrder` is answered
    with the state before it; a fault puts the drive to sleep and stays until `CLEAR_ERROR`, and an emergency stop that
    came in a `DriveOrder` until a `DriveOrder` without it has come as well; faults do not undo the calibration; a
    `DriveOrder` aborts a calibration; only `POLL`, `DriveOrder` and queries feed the watchdog, whose action
    is never used.

    Args:
        source: The drive and jaws that it moves; its time is passed in.
        node: Its number on the bus.
        heartbeat_s: Period of its heartbeat; infinite is none.
    """

    called = "a gripper"

    def __init__(self, source: JawsDrive, node: int = 0, heartbeat_s: float = HEARTBEAT_S) -> None:
        super().__init__()
        self._node, self._usual_heartbeat_s = node, heartbeat_s
        self._source = source
        self._power_up()

    def _power_up(self) -> None:
        self._faults: set[str] = set()
        self._drive = DriveOrder(0, 0, 0, activate=False, go=False)
        self._awake = False
        self._watchdog_s = math.inf
        self._fed_s: float | None = None
        self._heartbeat_s = self._usual_heartbeat_s
        self._sent_s: float | None = None

    def receive(self, data: CanFrame, t_s: float) -> list[CanFrame]:
        """See `EmulatedDevice.receive`."""
        self._run(t_s)
        try:
            node, order = decode_order(data)
        except CodecError:
            return []
        if node != self._node:
            return []
        if isinstance(order, DriveOrder) or order == POLL or order.code in QUERIES:
            self._fed_s = t_s
        answer = self._obey(order, t_s)
        return [] if answer is None else [self._sent(answer, t_s)]

    def step(self, t_s: float) -> list[CanFrame]:
        """What it sends by `t_s` on its own: its heartbeat."""
        self._run(t_s)
        if self._sent_s is None or t_s - self._sent_s < self._heartbeat_s:
            return []
        return [self._sent(GripperMessage(GripperCode.HEARTBEAT), t_s)]

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """Faults: "stall" jams the jaws where they are until the next calibration, "overheat" can be cleared,
        "reboot" is a power failure."""
        return {
            "stall": self._source.jam,
            "overheat": lambda: self._break("over temperature"),
            "reboot": self._lose_power,
        }

    def _lose_power(self) -> None:
        self._power_up()
        self._source.power_up()

    def _run(self, t_s: float) -> None:
        """Let time pass, and the watchdog trip where it is due."""
        self._fed_s = t_s if self._fed_s is None else self._fed_s
        self._sent_s = t_s if self._sent_s is None else self._sent_s
        if t_s - self._fed_s >= self._watchdog_s:
            self._source.advance(self._fed_s + self._watchdog_s)
            self._break("watchdog")
            self._fed_s = t_s
        self._source.advance(t_s)

    def _break(self, fault: str) -> None:
        self._faults.add(fault)
        self._sleep()

    def _sleep(self) -> None:
        self._awake = False
        self._source.sleep()

    def _sent(self, answer: Answer, t_s: float) -> CanFrame:
        self._sent_s = t_s
        return encode_answer(self._node, bool(self._faults), answer)

    def _obey(self, order: Order, t_s: float) -> Answer | None:
        match order:
            case DriveOrder():
                state = self._state()
                self._go(order)
                return state
            case GripperMessage(GripperCode.DRIVE):
                return self._state()
            case GripperMessage(GripperCode.WATCHDOG, (period_ms, _)):
                if math.isinf(self._watchdog_s):
                    self._fed_s = t_s
                self._watchdog_s = period_ms * 1e-3 if period_ms else math.inf
            case GripperMessage(GripperCode.HEARTBEAT_PERIOD, (period_ms,)):
                self._heartbeat_s = period_ms * 1e-3 if period_ms else math.inf
            case GripperMessage(code):
                if code in QUERIES:
                    return self._reading(code)
                self._plain(code)
        return None

    def _go(self, order: DriveOrder) -> None:
        repeated, self._drive = order == self._drive, order
        if order.estop:
            self._break("emergency stop of a drive")
        if self._faults:
            return
        if not (order.activate and order.go):
            self._sleep()
        elif not (repeated and self._awake):
            self._awake = True
            speed_ticks_s = units.speed_ticks_s(order.speed)
            self._source.go(order.position / units.POSITION_COUNTS, speed_ticks_s, order.current_ma)

    def _plain(self, code: GripperCode) -> None:
        if code is GripperCode.CLEAR_ERROR:
            # It would be raised again at the next tick: an emergency stop in a `DriveOrder` is a level.
            self._faults &= {"emergency stop of a drive"} if self._drive.estop else set()
            self._sleep()
        elif code is GripperCode.ESTOP:
            self._break("emergency stop")
        elif code is GripperCode.IDLE:
            self._sleep()
        elif code is GripperCode.CALIBRATE and not self._faults:
            self._awake = False
            self._source.calibrate()

    def _reading(self, code: GripperCode) -> Answer:
        if code is GripperCode.ERRORS:
            return GripperErrors(frozenset(self._faults))
        source = self._source
        hot = "over temperature" in self._faults
        numbers: Mapping[GripperCode, tuple[int, ...]] = {
            GripperCode.PING: (),
            GripperCode.TEMPERATURE: (HOT_C if hot else USUAL_C,),
            GripperCode.VOLTAGE: (SUPPLY_MV,),
            GripperCode.INFO: INFO,
            GripperCode.CURRENT: (round(source.current_ma),),
            GripperCode.ENCODER: (source.ticks, round(source.ticks_s)),
        }
        return GripperMessage(code, numbers[code])

    def _state(self) -> GripperState:
        source = self._source
        return GripperState(
            position=round(source.closed_share * units.POSITION_COUNTS),
            current_ma=round(source.current_ma),
            finding=source.finding,
            activated=self._drive.activate,
            going=self._drive.go,
            over_temperature="over temperature" in self._faults,
            watchdog="watchdog" in self._faults,
            estop="emergency stop of a drive" in self._faults,
            calibrated=source.calibrated,
        )


def emulated(settings: Any, bench: object) -> EmulatedSlcan:
    """An adapter with the gripper on its bus, and the bench's jaws on the gripper.

    Raises:
        RefusedError: the bench has no jaws.
    """
    return EmulatedSlcan(EmulatedCanGripper(part(bench, "jaws", "gripper"), settings.node))
