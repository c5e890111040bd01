"""An emulated National Instruments device: what its inputs and counters show of the bench, on a clock of its own."""

import math
from typing import Any

import numpy as np

from drivers.core.messages import Floats
from drivers.ni_daq.settings import NiDaqSettings
from simulator.devices.far_end import EmulatedDevice
from simulator.devices.shown import ShownColumns
from simulator.physics.bench import Bench, part

DRIFT_PPM = 31.0
"""How much faster than the host's its clock runs. Assumption: an ordinary crystal, within 100 ppm."""

DEVICE = "analog inputs"

RANGES_V = (0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0)
"""Ends of the ranges that it has: a USB-6363's (data sheet). It takes the next wider one, where there is one."""


class EmulatedNiDaq(EmulatedDevice):
    """Samples its inputs from its first moment on, without noise of its own, within its range; its output switches what
    excites the bench.

    Attributes:
        range_v: Where its inputs end, of either sign.

    Raises:
        RefusedError: an input that is named shows nothing of this bench.
    """

    called = DEVICE

    def __init__(self, settings: NiDaqSettings, bench: Bench) -> None:
        super().__init__()
        self._bench = bench
        self.range_v = next((end_v for end_v in RANGES_V if end_v >= settings.range_v), settings.range_v)
        self._hz = settings.rate_hz * (1.0 + DRIFT_PPM * 1e-6)
        self._shown = ShownColumns(settings.streams, bench, DEVICE)
        self._order = [self._shown.columns.index(name) for name in (*settings.analog, *settings.counters)]
        self._analog = len(settings.analog)
        self._excite = part(bench, "excite", DEVICE) if settings.drive else None
        self._begun_s: float | None = None
        self.next, self._on = 0, False
        self.watch(True, 0.0)

    def watch(self, on: bool, t_s: float) -> None:
        """Whether anybody looks from `t_s` on: in process, what nobody looks at need not be computed."""
        if on and not self._on and self._begun_s is not None:
            self.next = self._taken(t_s)
        self._on = on
        self._shown.watch(on)

    def due_s(self, samples: int) -> float:
        """When it will have taken so many samples more."""
        if not self._on or self._begun_s is None:
            return math.inf
        return self._begun_s + (self.next + samples - 1) / self._hz

    def take(self, t_s: float) -> Floats:
        """Samples that it took since the last call by `t_s`, shape (n, inputs): volts, then counts."""
        if self._begun_s is None:
            self._begun_s = t_s
        first, self.next = self.next, self._taken(t_s)
        if first >= self.next:
            return np.empty((0, len(self._order)))
        self._bench.advance(t_s)
        times_s = np.minimum(self._begun_s + np.arange(first, self.next) / self._hz, t_s)
        shown = self._shown.at(times_s)[:, self._order]
        shown[:, : self._analog] = np.clip(shown[:, : self._analog], -self.range_v, self.range_v)
        shown[:, self._analog :] = np.rint(shown[:, self._analog :])
        return shown

    def drive(self, volts: float, t_s: float) -> None:
        """Its output gives so many volts, or a sine of this amplitude, from `t_s` on."""
        if self._excite is not None:
            self._bench.advance(t_s)
            self._excite(volts != 0.0)

    def _taken(self, t_s: float) -> int:
        assert self._begun_s is not None
        return math.floor((t_s - self._begun_s) * self._hz + 1e-9) + 1


def emulated(settings: NiDaqSettings, bench: Bench) -> Any:
    """The device that a profile describes, behind the maker's server.

    Raises:
        PortError: the library is not installed.
        RefusedError: see `EmulatedNiDaq`.
    """
    from simulator.devices.ni_daq_server import NiDaqServer

    return NiDaqServer(settings, EmulatedNiDaq(settings, bench))
