"""The emulated fingers of a BarrettHand: CAN frames on the forces at their tips; no bus, no clock."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Literal, Protocol, get_args

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from drivers.barrett_hand import codec
from drivers.barrett_hand.strain import FingerStrainSettings
from drivers.core.can_frame import CanFrame
from drivers.core.errors import CodecError
from simulator.devices.slcan import EmulatedSlcan
from simulator.physics.bench import part

Fault = Literal["silent", "saturate"]


class FingerForces(Protocol):
    """The forces that the fingers feel. Its time is passed in."""

    def advance(self, t_s: float) -> None:
        """Let time pass until `t_s`."""

    def forces_n(self, finger: int, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Force at a fingertip, compression positive, at ascending times up to the present; shape (n,)."""


def counts(forces_n: NDArray[np.float64], settings: FingerStrainSettings) -> NDArray[np.int64]:
    """What a gauge reads under forces; same shape."""
    ideal = np.rint(forces_n / settings.newton_per_count) + settings.zero_counts
    return np.asarray(np.clip(np.nan_to_num(ideal, nan=0.0), 0, codec.COUNTS_MAX), dtype=np.int64)


class EmulatedBarrettHandSettings(FingerStrainSettings):
    """What the emulated hand is."""

    mode: int = Field(default=0, ge=0, le=8)
    """Its mode at power-up; 0 is idle (assumption)."""


class EmulatedBarrettHand:
    """Answers as the hand's nodes do: fingers 11 to 13 and the spread, which has no gauge.

    Settings are kept and reported; none of them moves anything here. A finger beyond the range in which it works
    falls back to mode 0: the hand protects itself.

    Args:
        settings: What it is.
        source: What its fingers feel.
    """

    def __init__(self, settings: EmulatedBarrettHandSettings, source: FingerForces) -> None:
        self._settings = settings
        self._source = source
        self._silent = False
        self._saturated = False
        self._values = {
            node: {
                codec.Property.MODE: settings.mode,
                codec.Property.COMMAND: 0,
                codec.Property.TARGET: 0,
                codec.Property.POSITION: 0,
            }
            for node in (*codec.FINGERS, codec.SPREAD)
        }

    def receive(self, frame: CanFrame, t_s: float) -> list[CanFrame]:
        """Take a frame at `t_s`; returns what its nodes answer at once."""
        self._source.advance(t_s)
        try:
            request = codec.decode_request(frame)
        except CodecError:
            return []
        if self._silent:
            return []
        if request.group:
            nodes = list(self._values) if request.receiver == codec.HAND else []
        else:
            nodes = [request.receiver] if request.receiver in self._values else []
        if request.value is not None:
            for node in nodes:
                if request.property in self._values[node]:
                    self._values[node][codec.Property(request.property)] = request.value
            return []
        values = {node: self._value(node, request.property, t_s) for node in nodes}
        return [
            codec.encode_reply(codec.HandReply(node, request.property, value))
            for node, value in values.items()
            if value is not None
        ]

    def step(self, t_s: float) -> list[CanFrame]:
        """It sends nothing on its own."""
        self._source.advance(t_s)
        return []

    def inject(self, kind: str, t_s: float) -> None:
        """Break something at `t_s`.

        Args:
            kind: "silent" is for good; "saturate" puts every gauge at its lower end, for good.
            t_s: When.

        Raises:
            ValueError: it cannot break in that way.
        """
        if kind == "silent":
            self._silent = True
        elif kind == "saturate":
            self._saturated = True
        else:
            raise ValueError(f"a hand knows no fault {kind!r}; it knows {', '.join(get_args(Fault))}")

    def _value(self, node: int, wanted: int, t_s: float) -> int | None:
        if wanted != codec.Property.STRAIN:
            return self._values[node].get(codec.Property(wanted)) if wanted in self._values[node] else None
        if node == codec.SPREAD:
            return None
        reading = int(counts(self._source.forces_n(node, np.array([t_s])), self._settings)[0])
        reading = 0 if self._saturated else reading
        lowest, highest = codec.SAFE_COUNTS
        if not lowest <= reading <= highest:
            self._values[node][codec.Property.MODE] = 0
        return reading


def emulated(settings: Mapping[str, Any], bench: object) -> EmulatedSlcan:
    """An adapter with the hand on its bus.

    Raises:
        RefusedError: the bench has no fingers.
    """
    return EmulatedSlcan(EmulatedBarrettHand(EmulatedBarrettHandSettings(), part(bench, "fingers", "hand")))
