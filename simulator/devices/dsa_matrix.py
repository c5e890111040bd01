"""Emulated tactile matrices behind a DSACON32-M: packets on whatever their texels feel; no port, no clock."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from drivers.core.errors import CodecError
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.packets import PacketDecoder, encode_packet
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import Bench, part

BITS_PER_BYTE = 10
"""On the line: 8 data bits, a start and a stop bit."""

DEAF_S = 8.0
"""How long it ignores commands after power-up (docs/reference/sensors.md)."""

NOISE_S = (7.0, 7.41, 7.82)
"""When it sends its noise after power-up (the maker's public library: three times in 0.82 s, after about 7 s)."""

REFUSED = 5
UNKNOWN = 13
"""Error codes: "feature not supported", "unknown command" (the maker's public library)."""


FASTEST_HZ = 1000
"""Most frames a second that it takes (assumption: its clock counts milliseconds)."""


def counts(texels_v: NDArray[np.float64], threshold: int = 0) -> NDArray[np.uint16]:
    """What the converter makes of texels; same shape. Below the threshold it gives 0."""
    ideal = np.nan_to_num(np.rint(texels_v / codec.VOLT_PER_COUNT), nan=0.0)
    held = np.clip(ideal, 0, codec.TEXEL_MAX)
    return np.asarray(np.where(held < threshold, 0, held), dtype=np.uint16)


SERIAL, SOFTWARE = 9210, 290
"""What it reports: a serial number (assumption), a release that can set thresholds (the maker's public library: from
268)."""

DRIFT_PPM = -53.0
"""How much faster than the host's its clock runs. Assumption: an ordinary crystal, within 100 ppm."""

START_MS = codec.TIME_MODULUS - 5_000
"""What its clock shows at the first call, in ms: 5 s before it wraps, so that it does in a run."""


class EmulatedDsaMatrix(EmulatedDevice):
    """Answers as the controller does: bytes in, bytes out, and time from outside.

    Frames are taken on the grid of its own clock. One frame may wait for the line; the next is dropped
    silently (assumption: a buffer of one frame).

    Args:
        source: What its texels feel.
        baud: Line speed in bits per second: bytes take their time, and frames that find the line busy are dropped.
        drift_ppm: Of its clock.
        start_ms: What its clock shows at the first call.
        booted: False where it is switched on at the first call: deaf for 8 s, with noise on the line.
    """

    called = "a matrix controller"

    def __init__(
        self,
        source: Bench,
        baud: int,
        drift_ppm: float = DRIFT_PPM,
        start_ms: int = START_MS,
        booted: bool = True,
    ) -> None:
        self._baud = baud
        self._rate = 1.0 + drift_ppm * 1e-6
        self._booted = booted
        self._source = source
        self._matrices = tuple(source.matrices())
        self._line = PacketDecoder()
        self._coming: list[tuple[float, bytes]] = []
        self._free_s = -math.inf
        self._power_s: float | None = None
        self._start_ms = start_ms
        self._noise: list[float] = []
        self._deaf_s = -math.inf
        self._threshold = 0
        self._rate_hz, self._rle = 0, False
        self._tick = 0
        self._refusals = 0

    def receive(self, data: bytes, t_s: float) -> bytes:
        """Take bytes from the host at `t_s`; returns what is on the line by then."""
        self._run(t_s)
        if t_s >= self._deaf_s:
            for packet in self._line.feed(data):
                try:
                    answer = self._obey(packet.id, codec.decode_request(packet), t_s)
                except CodecError:
                    answer = codec.Done(codec.Id.ACQUIRE, UNKNOWN)
                self._send(encode_packet(codec.encode_answer(answer)), t_s)
        return self._take(t_s)

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """Faults: "refuse" answers the next command with an error; "reboot" is a power failure."""
        return {
            "refuse": self._refuse_next,
            "reboot": lambda: self._power_up(t_s, 0, booted=False),
        }

    def _refuse_next(self) -> None:
        self._refusals += 1

    # time

    def _power_up(self, t_s: float, start_ms: int, booted: bool) -> None:
        self._power_s, self._start_ms = t_s, start_ms
        self._rate_hz, self._rle = 0, False
        self._coming.clear()
        self._noise = [] if booted else [t_s + after_s for after_s in NOISE_S]
        self._deaf_s = -math.inf if booted else t_s + DEAF_S

    def _clock_s(self, t_s: float) -> float:
        """Seconds of its own clock since power-up."""
        assert self._power_s is not None
        return (t_s - self._power_s) * self._rate

    def _host_s(self, clock_s: float) -> float:
        assert self._power_s is not None
        return self._power_s + clock_s / self._rate

    def _run(self, t_s: float) -> None:
        if self._power_s is None:
            self._power_up(t_s, self._start_ms, self._booted)
        self._source.advance(t_s)
        while self._noise and self._noise[0] <= t_s:
            self._send(codec.POWER_UP_NOISE, self._noise.pop(0))
        rate_hz = self._rate_hz
        if rate_hz == 0:
            return
        while self._tick <= math.floor(self._clock_s(t_s) * rate_hz):
            clock_s = self._tick / rate_hz
            self._tick += 1
            self._send_frame(clock_s, min(self._host_s(clock_s), t_s))

    def _send_frame(self, clock_s: float, host_s: float) -> None:
        (texels,) = counts(self._source.texels_v(np.array([host_s])), self._threshold)
        time_ms = (self._start_ms + math.floor(clock_s * 1e3 + 1e-6)) % codec.TIME_MODULUS
        packet = encode_packet(codec.encode_answer(codec.Frame(time_ms, self._rle, texels)))
        if self._free_s - host_s > len(packet) * BITS_PER_BYTE / self._baud:
            return
        self._send(packet, host_s)

    # the line

    def _send(self, data: bytes, t_s: float) -> None:
        """Put bytes on the line; the host has them when the last of them has come."""
        self._free_s = max(self._free_s, t_s) + len(data) * BITS_PER_BYTE / self._baud
        self._coming.append((self._free_s, data))

    def _take(self, t_s: float) -> bytes:
        sent = b"".join(data for due_s, data in self._coming if due_s <= t_s)
        self._coming = [(due_s, data) for due_s, data in self._coming if due_s > t_s]
        return sent

    # commands

    def _obey(self, request: int, numbers: tuple[int, ...], t_s: float) -> codec.Answer:
        error = REFUSED if self._refusals else 0
        self._refusals = max(0, self._refusals - 1)
        match request, numbers:
            case codec.Id.CONTROLLER, _:
                return codec.ControllerInfo(error, SERIAL, 0x10, SOFTWARE, 0x80 | bool(self._rate_hz) << 6)
            case codec.Id.SENSOR, _:
                return codec.SensorInfo(error, len(self._matrices), 0x10, 3210)
            case codec.Id.MATRIX, (number,):
                return self._matrix(number, error)
            case codec.Id.THRESHOLD, _:
                return codec.Done(codec.Id.THRESHOLD, error, self._threshold)
            case codec.Id.SET_THRESHOLD, (_, threshold):
                self._threshold = self._threshold if error else threshold
                return codec.Done(codec.Id.SET_THRESHOLD, error)
            case _, (flags, rate_hz):
                error = REFUSED if rate_hz > FASTEST_HZ else error
                if not error:
                    self._rle = bool(flags & codec.RLE_BIT)
                    self._rate_hz = rate_hz if flags & codec.RUN_BIT else 0
                    self._tick = math.floor(self._clock_s(t_s) * rate_hz) + 1
        return codec.Done(codec.Id.ACQUIRE, error)

    def _matrix(self, number: int, error: int) -> codec.MatrixInfo:
        if number >= len(self._matrices):
            return codec.MatrixInfo(error or REFUSED, 0.0, 0.0, 0, 0, bytes(6))
        matrix = self._matrices[number]
        size_mm = matrix.texel_m * 1e3
        uid = bytes([0, 0, 0, 0, 0, number])
        return codec.MatrixInfo(error, size_mm, size_mm, matrix.columns, matrix.rows, uid)


def emulated(settings: Any, bench: Any) -> EmulatedDsaMatrix:
    """The matrices' controller, on a line as fast as the driver's.

    Raises:
        RefusedError: the bench has no taxels.
    """
    part(bench, "texels_v", "matrix")
    return EmulatedDsaMatrix(bench, settings.baud)
