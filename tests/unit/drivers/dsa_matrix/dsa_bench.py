"""The real driver on emulated matrices, in virtual time: a link without a port."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.clock import WallClock
from drivers.core.messages import SampleBlock, Status
from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from simulator.devices.dsa_matrix import EmulatedDsaMatrix
from simulator.physics.fingertip_settings import Matrix

TURN_S = 0.005
STEP_S = 0.001


class Ramp:
    """Each cell reads its number in millivolts; the first reads host time, 10 ms a count."""

    def __init__(self, matrices: Sequence[Matrix]) -> None:
        self._matrices = tuple(matrices)
        self.cells = sum(matrix.rows * matrix.columns for matrix in self._matrices)
        self.full = False

    def matrices(self) -> Sequence[Matrix]:
        return self._matrices

    def advance(self, t_s: float) -> None:
        pass

    def texels_v(self, times_s: NDArray[np.float64]) -> NDArray[np.float64]:
        texels_v = np.tile(np.arange(self.cells) * 1e-3, (len(times_s), 1))
        texels_v[:, 0] = 5.0 if self.full else times_s % 40.0 * 0.1
        return texels_v


class Host:
    """Time, and the far end of the line."""

    def __init__(self, matrices: EmulatedDsaMatrix, begin_s: float) -> None:
        self.matrices = matrices
        self.now_s = begin_s
        self.fault: str | None = None
        self.cut: Callable[[bytes], bytes] = bytes
        self.written: list[bytes] = []
        self.closed = False
        self._arrived: list[tuple[float, bytes]] = []
        matrices.step(begin_s)

    def open(self, *_: object) -> Any:
        self.closed = False
        return self

    def advance(self, seconds: float) -> None:
        until_s = self.now_s + seconds
        while self.now_s < until_s - 1e-9:
            self.now_s = min(self.now_s + STEP_S, until_s)
            self._arrive(self.matrices.step(self.now_s))

    def send(self, data: bytes) -> float | None:
        if self.fault is not None:
            return None
        self.written.append(data)
        self._arrive(self.matrices.receive(self.cut(data), self.now_s))
        return self.now_s

    def receive(self) -> list[tuple[float, bytes]]:
        arrived, self._arrived = self._arrived, []
        return arrived

    def close(self) -> None:
        self.closed = True

    def _arrive(self, data: bytes) -> None:
        if data:
            self._arrived.append((self.now_s, data))


class HostClock(WallClock):
    """Bench time that begins with the host's."""

    def __init__(self, host: Host) -> None:
        self._host = host
        self._origin_s = host.now_s

    def now(self) -> float:
        return self._host.now_s - self._origin_s

    def monotonic_s(self) -> float:
        return self._host.now_s

    def rest(self, seconds: float) -> None:
        self._host.advance(seconds)


class Bench:
    """Driver, emulated matrices, what they feel."""

    def __init__(self, host: Host, source: Ramp, settings: DsaMatrixSettings) -> None:
        self.host = host
        self.source = source
        self.clock = HostClock(host)
        self.driver = DsaMatrix("dsa", settings, self.clock, host.open)
        self.blocks: list[SampleBlock] = []
        self.statuses: list[Status] = []

    def turn(self, seconds: float) -> None:
        until_s = self.host.now_s + seconds
        while self.host.now_s < until_s - 1e-9:
            self.host.advance(TURN_S)
            self.blocks += self.driver.read()
            self.statuses += self.driver.poll()

    def take(self, kind: type[Status]) -> list[Status]:
        found = [status for status in self.statuses if isinstance(status, kind)]
        self.statuses = [status for status in self.statuses if not isinstance(status, kind)]
        return found

    def frames(self) -> int:
        return sum(map(len, self.blocks))
