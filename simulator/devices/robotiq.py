"""An emulated Robotiq gripper behind its URCap's socket: lines on the motion of a drive; no socket, no clock."""

from collections.abc import Callable, Mapping

from drivers.can_gripper.units import FORCE_N_PER_MA, TICKS_PER_M
from drivers.core.links import LineBuffer
from drivers.gripper.state import GripFinding
from drivers.robotiq import codec
from drivers.robotiq.settings import RobotiqSettings
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import part

MAX_LINE = 200
"""Longest line that is kept, in bytes (assumption)."""

OBJECT = {
    GripFinding.MOVING: 0,
    GripFinding.OBJECT_OPENING: codec.OPENING_OBJECT,
    GripFinding.OBJECT_CLOSING: codec.CLOSING_OBJECT,
    GripFinding.AT_POSITION: 3,
}

SETTABLE = ("ACT", "GTO", "ATR", "ARD", "FOR", "SPE", "POS")
"""What an order may set (URCap)."""


class EmulatedRobotiq(EmulatedDevice):
    """Answers as the URCap does, on the bench's jaws, whose drive is an SSG-48's: 60 N at the most.

    Orders take effect at once. Activation opens and closes the jaws; what was activated before stays so. A question for
    what it does not have is answered by `?`.

    Args:
        settings: Of the driver: which gripper it is, and its fingers.
        bench: Has the jaws that it moves, whose time is passed in.

    Raises:
        RefusedError: the bench has no jaws.
    """

    called = "a Robotiq"

    def __init__(self, settings: RobotiqSettings, bench: object) -> None:
        super().__init__()
        self._units = settings.units()
        self._source = source = part(bench, "jaws", "gripper")
        self._lines = LineBuffer(MAX_LINE)
        self._fault = 0
        active = int(source.calibrated)
        self._set = {**dict.fromkeys(SETTABLE, 0), "ACT": active, "GTO": active}
        self._set["POS"] = self._position()

    def receive(self, data: bytes, t_s: float) -> bytes:
        """See `EmulatedDevice.receive`."""
        self._run(t_s)
        return b"".join(self._answer(line.decode("ascii", "replace")) for line in self._lines.feed(data))

    def _run(self, t_s: float) -> None:
        self._source.advance(t_s)

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """Faults: "stall" jams the jaws where they are until the next activation, "overheat" is cleared by one,
        "reboot" is a power failure."""
        return {"stall": self._source.jam, "overheat": self._overheat, "reboot": self._lose_power}

    def _overheat(self) -> None:
        self._fault = 8
        self._source.sleep()

    def _lose_power(self) -> None:
        self._set.update(ACT=0, GTO=0)
        self._source.power_up()

    def _answer(self, line: str) -> bytes:
        match line.split():
            case ["GET", name]:
                value = self._readings().get(name)
                return b"?" if value is None else f"{name} {value}".encode()
            case ["SET", *words] if words and len(words) % 2 == 0:
                names, numbers = words[::2], words[1::2]
                known = all(name in SETTABLE for name in names)
                if known and all(number.isdecimal() and int(number) <= codec.COUNTS for number in numbers):
                    self._obey(dict(zip(names, map(int, numbers), strict=True)))
                    return codec.ACK.encode()
        return b"?"

    def _readings(self) -> dict[str, int]:
        source, s = self._source, self._set
        status = 0 if not s["ACT"] else codec.ACTIVE if source.calibrated else 1
        return {**s, "POS": self._position(), "PRE": s["POS"], "STA": status} | {
            "OBJ": OBJECT[source.finding],
            "FLT": self._fault,
        }

    def _position(self) -> int:
        return self._units.position_at(self._source.closed_share)

    def _obey(self, values: Mapping[str, int]) -> None:
        before = dict(self._set)
        self._set.update(values)
        s, source = self._set, self._source
        if not s["ACT"]:
            self._fault = 0
            s["GTO"] = 0
            source.sleep()
        elif not before["ACT"]:
            source.power_up()
            source.calibrate()
        elif not source.calibrated or self._fault:
            return
        elif s["GTO"] and any(name in values for name in ("GTO", "POS", "SPE", "FOR")):
            share = min(max(self._units.closed_share(s["POS"]), 0.0), 1.0)
            self._go(share)
        elif before["GTO"] and not s["GTO"] and source.finding is GripFinding.MOVING:
            self._go(source.closed_share)

    def _go(self, closed_share: float) -> None:
        speed_ticks_s = self._units.speed_m_s(self._set["SPE"]) * TICKS_PER_M
        current_ma = self._units.force_n(self._set["FOR"]) / FORCE_N_PER_MA
        self._source.go(closed_share, speed_ticks_s, current_ma)
