"""The emulated fingers of a BarrettHand: CAN frames on the forces at their tips; no bus, no clock."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import FingerStrainSettings
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError
from simulator.devices.far_end import EmulatedDevice
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.bench import Bench, part


def counts(forces_n: NDArray[np.float64], settings: FingerStrainSettings) -> NDArray[np.int64]:
    """What a gauge reads under forces; same shape."""
    ideal = np.rint(forces_n / settings.newton_per_count) + settings.zero_counts
    return np.asarray(np.clip(np.nan_to_num(ideal, nan=0.0), 0, codec.COUNTS_MAX), dtype=np.int64)


WAKES_S = 0.25
"""How long a controller is deaf while it wakes (assumption: libbarrett waits 0.3 s)."""


class EmulatedBarrettHand(EmulatedDevice):
    """Answers as the nodes of fingers 11 to 13 do when they are asked for their status or their strain.

    A node that sleeps answers for its status alone; one that wakes hears nothing.

    Args:
        asleep: As all are after power-up.
    """

    called = "a hand"

    def __init__(self, settings: FingerStrainSettings, source: Bench, *, asleep: bool = True) -> None:
        super().__init__()
        self._settings = settings
        self._ready_s = dict.fromkeys(codec.FINGERS, math.inf if asleep else -math.inf)
        self._source = source

    def receive(self, data: CanFrame, t_s: float) -> list[CanFrame]:
        """See `EmulatedDevice.receive`."""
        self._run(t_s)
        for finger, ready_s in self._ready_s.items():
            if data == codec.encode_wake(finger) and ready_s == math.inf:
                self._ready_s[finger] = t_s + WAKES_S
        for subject in (codec.STATUS, codec.STRAIN):
            try:
                receiver, group = codec.decode_query(data, subject)
            except CodecError:
                continue
            asked = codec.FINGERS if group and receiver == codec.HAND else () if group else (receiver,)
            return [
                self._answer(finger, subject, t_s) for finger in asked if self._hears(finger, subject, t_s)
            ]
        return []

    def _hears(self, finger: int, subject: int, t_s: float) -> bool:
        ready_s = self._ready_s.get(finger)
        return ready_s is not None and (ready_s <= t_s or (ready_s == math.inf and subject == codec.STATUS))

    def _answer(self, finger: int, subject: int, t_s: float) -> CanFrame:
        if subject == codec.STRAIN:
            return codec.encode_reading(finger, self._reading(finger, t_s))
        return codec.encode_reading(finger, codec.READY if self._ready_s[finger] <= t_s else 0, codec.STATUS)

    def _run(self, t_s: float) -> None:
        self._source.advance(t_s)

    def _reading(self, finger: int, t_s: float) -> int:
        return int(counts(self._source.forces_n(finger, np.array([t_s])), self._settings)[0])


def emulated(settings: object, bench: Any) -> EmulatedSlcan:
    """An adapter with the hand on its bus.

    Raises:
        RefusedError: the bench has no fingers.
    """
    part(bench, "forces_n", "hand")
    return EmulatedSlcan(EmulatedBarrettHand(FingerStrainSettings(), bench))
