"""An emulated board that prints lines: what its columns show of the bench, on a clock of its own."""

import math

import numpy as np

from drivers.serial_lines.settings import SerialLinesSettings
from simulator.devices.far_end import EmulatedDevice
from simulator.devices.shown import ShownColumns
from simulator.physics.bench import Bench

DRIFT_PPM = -43.0
"""How much faster than the host's its clock runs. Assumption: an ordinary crystal, within 100 ppm."""

WRAPS_S = 5.0
"""Its clock is zero again so long after it is switched on, so that it is in a run (assumption)."""

IRREGULAR_HZ = 100.0
"""Lines a second where the profile has no rate (assumption)."""

KEPT_S = 0.05
"""How much of what it prints waits while it is not looked at; the rest is lost, as in a port's buffer (assumption)."""

DEVICE = "a board that prints lines"

BANNER = b"board is up\r\n"
"""What its sketch prints first (assumption)."""


class EmulatedSerialLines(EmulatedDevice):
    """Prints a line for each sample from its first moment on, as a sketch does; it takes nothing from the host.

    Args:
        settings: Of its driver: columns, units, format.

    Raises:
        RefusedError: a column that is named shows nothing of this bench.
    """

    called = DEVICE

    def __init__(self, settings: SerialLinesSettings, bench: Bench) -> None:
        super().__init__()
        self._settings, self._bench = settings, bench
        self._format = settings.format
        self._own_hz = settings.rate_hz or IRREGULAR_HZ  # by its own clock
        self._rate_hz = self._own_hz * (1.0 + DRIFT_PPM * 1e-6)
        self._shown = ShownColumns(settings.streams, bench, DEVICE)
        self._fields = ["0"] * settings.fields
        self._first_s: float | None = None
        self._next, self._on = 0, False
        self.watch(True, 0.0)

    def watch(self, on: bool, t_s: float) -> None:
        """Whether anybody looks from `t_s` on: in process, what nobody looks at need not be computed."""
        turned, self._on = on and not self._on, on
        self._shown.watch(on)
        if turned and self._first_s is not None:
            self._next = math.floor((t_s - self._first_s) * self._rate_hz + 1e-9) + 1

    @property
    def due_s(self) -> float:
        """When its next line is due."""
        if not self._on or self._first_s is None:
            return math.inf
        return self._first_s + self._next / self._rate_hz

    def receive(self, data: bytes, t_s: float) -> bytes:
        """It takes nothing from the host."""
        return self.step(t_s)

    def step(self, t_s: float) -> bytes:
        """The lines printed by `t_s`."""
        return b"".join(line for _, line in self.printed(t_s, KEPT_S))

    def printed(self, t_s: float, kept_s: float = math.inf) -> list[tuple[float, bytes]]:
        """The lines printed by `t_s`, within the last `kept_s`, each with its time: many at once cost little."""
        sent = []
        if self._first_s is None:
            self._first_s, sent = t_s, [(t_s, BANNER)]
        since_s = t_s - self._first_s
        first, self._next = self._next, math.floor(since_s * self._rate_hz + 1e-9) + 1
        first = max(first, math.ceil((since_s - min(kept_s, since_s)) * self._rate_hz))
        if not self._on or first >= self._next:
            return sent
        self._bench.advance(t_s)
        ticks = np.arange(first, self._next)
        times_s = np.minimum(self._first_s + ticks / self._rate_hz, t_s)
        shown = self._shown.at(times_s).tolist()
        for tick, at_s, values in zip(ticks.tolist(), times_s.tolist(), shown, strict=True):
            for column, value in zip(self._shown.columns, values, strict=True):
                self._fields[int(column)] = f"{value:.4f}"
            sent.append((at_s, self._format.encode(self._stamped(self._fields, tick))))
        return sent

    def _stamped(self, fields: list[str], tick: int) -> list[str]:
        """The line of a tick with the board's time and count."""
        s = self._settings
        if s.time_column is not None:
            shown = round(tick / self._own_hz / s.time_unit_s)
            before = round(WRAPS_S / s.time_unit_s)
            fields[s.time_column] = str((shown - before) % s.time_modulus if s.time_modulus else shown)
        if s.counter_column is not None and s.counter_modulus is not None:
            fields[s.counter_column] = str(tick % s.counter_modulus)
        return fields
