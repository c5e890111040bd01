"""Calibrated forces of a strain-gauge fingertip: three bridges in volts → Fx, Fy, Ft, Fn and the contact's angle."""

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, Strict

from drivers.core.messages import SampleBlock, Saturated, StreamInfo
from drivers.core.settings import Settings, StreamName

Three = Annotated[tuple[float, float, float], Strict(False)]

FORCES = ("Fx", "Fy", "Ft")
CHANNELS = (*FORCES, "Fn", "theta_rad")


class StrainSettings(Settings):
    """The calibration of a fingertip: V12 = kx Fx, V34 = ky Fy, V56 = kt Ft."""

    input: StreamName = "board.fingertip"
    """Stream of the three bridges, V, in this order."""

    gain_v_n: Three = (0.0694, 0.0326, 1.0291)
    """V/N of each bridge. Fernandez et al., 4.2."""

    offset_v: Three = (0.0, 0.0, 0.0)
    """What each bridge reads without a force, V."""

    overload_n: Three = (10.0, 10.0, 1.5)
    """Force limits, N (B of the acceptance list: tested to 7, 7, 1 N, never beyond 10, 10, 1.5 N)."""

    overload_s: float = Field(default=0.003, ge=0.0, le=1.0)
    """How long a force must be beyond to count, s. Assumption: three samples at 1 kHz, so that a single spike stops
    nothing."""


class Strain:
    """Turns bridges into forces: Fn = hypot(Fx, Fy), theta = atan2(Fx, Fy), Ft = Mz / r (Fernandez et al., section 2).

    A force beyond `overload_n` is reported as `Saturated`, once each time; of several the first. Without
    contact theta is that of the noise.

    Args:
        name: In the profile; the stream is `signals.<name>`.
    """

    def __init__(self, name: str, settings: StrainSettings) -> None:
        self.name = name
        self.inputs = (settings.input,)
        self.info = StreamInfo(f"signals.{name}", CHANNELS, "N")
        self._gain_v_n = np.array(settings.gain_v_n)
        self._offset_v = np.array(settings.offset_v)
        self._overload_n = np.array(settings.overload_n)
        self._overload_s = settings.overload_s
        self.reset()

    def reset(self) -> None:
        """Clear the overloads."""
        self._next_seq: int | None = None
        self._beyond = np.zeros(len(FORCES), np.int64)
        self._reported = np.zeros(len(FORCES), bool)

    def push(self, block: SampleBlock) -> Sequence[SampleBlock | Saturated]:
        """Process the next samples of the bridges.

        Raises:
            ValueError: the stream has not three channels.
        """
        volts = block.physical
        if volts.shape[1] != len(FORCES):
            raise ValueError(
                f"{block.stream}: {volts.shape[1]} channels while making forces of them; it needs the three bridges"
            )
        forces_n = (volts - self._offset_v) / self._gain_v_n
        normal_n = np.hypot(forces_n[:, 0], forces_n[:, 1])
        theta_rad = np.arctan2(forces_n[:, 0], forces_n[:, 1])
        made = SampleBlock(
            self.info.name,
            block.seq,
            block.t0_s,
            np.column_stack([forces_n, normal_n, theta_rad]),
            rate_hz=block.rate_hz,
            times_s=block.times_s,
            unit=self.info.unit,
            device_t0_s=block.device_t0_s,
            arrival_s=block.arrival_s,
        )
        return (made, *self._overloads(block, forces_n))

    def _overloads(self, block: SampleBlock, forces_n: NDArray[np.float64]) -> list[Saturated]:
        if block.seq != self._next_seq:
            self._beyond[:] = 0
        self._next_seq = block.seq + len(block)
        beyond = np.abs(forces_n) > self._overload_n
        if not beyond.any():
            self._beyond[:] = 0
            self._reported[:] = False
            return []
        patience = max(1, round(self._overload_s * (block.rate_hz or 0.0)))
        overloads = []
        for place, row in enumerate(beyond):
            self._beyond = np.where(row, self._beyond + 1, 0)
            self._reported &= row
            found = np.flatnonzero((self._beyond >= patience) & ~self._reported)
            if found.size:
                self._reported[found] = True
                value_n = float(forces_n[place, found[0]])
                overloads.append(Saturated(float(block.times[place]), "signals", self.info.name, value_n))
        return overloads
