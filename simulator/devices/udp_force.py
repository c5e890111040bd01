"""An emulated Net F/T box: records of what the bench does to its tool, on a clock of its own."""

import math
from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from drivers.core.errors import CodecError
from drivers.udp_force.codec import (
    MODULUS,
    RECORD_BYTES,
    BoxSettings,
    ForceRecord,
    decode_request,
    encode_record,
)
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import Bench

BOX = BoxSettings(1e6, 1e6, 1000.0, 7000.0)
"""Where the profile says nothing. Assumption: of 7,000 samples a second every seventh is sent."""

DRIFT_PPM = 29.0
"""How much faster than the host's its clock runs. Assumption: an ordinary crystal, within 100 ppm."""

FIRST_FT = MODULUS - 35_000
"""Number of its first sample: it wraps after 5 s, so that it does in a run (assumption)."""

NOISE_COUNTS = 20
"""Largest noise of a torque, in which nothing else of a bench shows (assumption)."""

INT32: Final = np.iinfo(np.int32)


class EmulatedUdpForce(EmulatedDevice):
    """Answers as the box does: datagrams in, records out, time from outside. The pushed axis is the profile's `normal`.
    A zero is taken, or with the number 0 taken away, as OnRobot's boxes do it.

    Args:
        settings: Of its driver; what they leave open is `BOX`.
        bench: Whose tool is on the sensor.
    """

    datagram = RECORD_BYTES
    """Bytes of each datagram that it sends."""

    called = "a force sensor's box"

    def __init__(self, settings: Any, bench: Bench) -> None:
        super().__init__()
        given = dict(settings)
        self.box = BoxSettings(*(given.get(key) or own for key, own in zip(BOX._fields, BOX, strict=True)))
        normal = settings.normal
        self._towards = [0.0, 0.0, 0.0]
        self._towards["xyz".index(normal[1])] = 1.0 if normal[0] == "-" else -1.0
        self._bench = bench
        self._scale = np.repeat([self.box.counts_per_n, self.box.counts_per_nm], 3)
        self._hz = self.box.rate_hz * (1.0 + DRIFT_PPM * 1e-6)
        self._zero = self._latest = np.zeros(6, np.int64)
        self._on_s: float | None = None
        self._next: int | None = None
        self._rdt = 0
        self._rng = np.random.default_rng(0)

    @property
    def endpoint(self) -> Mapping[str, float]:
        """What its page of settings says, for the driver."""
        return self.box._asdict()

    @property
    def due_s(self) -> float:
        """When its next record is due."""
        return math.inf if self._next is None or self._on_s is None else self._on_s + self._next / self._hz

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take a request at `t_s`; returns the records that are due, and one that was asked for by itself."""
        sent = self.step(t_s)
        try:
            command, number = decode_request(data)
        except CodecError:
            return sent
        if command == "bias":
            self._zero = self._latest + self._zero if number else np.zeros(6, np.int64)
        else:
            self._bench.feel(command == "start" and number != 1)
            now = math.floor((t_s - (self._on_s or 0.0)) * self._hz + 1e-9)
            self._next = now + 1 if command == "start" and number != 1 else None
            self._rdt = 0
            sent += self._record(now) if command == "start" and number == 1 else b""
        return sent

    def step(self, t_s: float) -> bytes:
        """Records sent by `t_s`."""
        if self._on_s is None:
            self._on_s = t_s
        sent = b""
        while self._next is not None and self.due_s <= t_s:
            self._bench.advance(self.due_s)
            felt = self._bench.wrench(np.array([self.due_s]), self._towards)[0]
            counts = np.rint(felt * self._scale).astype(np.int64) - self._zero
            counts[3:] += self._rng.integers(-NOISE_COUNTS, NOISE_COUNTS + 1, 3)
            self._latest = np.clip(counts, INT32.min, INT32.max)
            sent += self._record(self._next)
            self._next += 1
        return sent

    def _record(self, tick: int) -> bytes:
        self._rdt += 1
        ft = FIRST_FT + round(tick * self.box.sample_hz / self.box.rate_hz)
        return encode_record(ForceRecord(self._rdt % MODULUS, ft % MODULUS, 0, tuple(self._latest.tolist())))
