"""An emulated recorder of the fingers: its side of the connection; no socket, no clock of the host's."""

import math
from collections.abc import Callable, Mapping
from typing import Any

from drivers.audio.codec import MAX_LINE_BYTES, Sound, SoundMessage, decode_line, encode
from drivers.audio.oscillator import WHOLE
from drivers.audio.settings import FINGERS, RATE_HZ
from drivers.core.errors import CodecError
from simulator.devices.far_end import EmulatedDevice
from simulator.physics.bench import Bench, part

DRIFT_PPM = 43.0
"""How much faster than the host's its clock runs. Assumption: an ordinary crystal, within 100 ppm."""

START_FRAME = 45 * WHOLE
"""What its counter shows when the bench's time begins: beyond 32 bits, and every tone's phase is zero at the counter's
frame 0 too."""

PACKET_FRAMES = 480
"""Frames in a packet. Assumption: 5 ms."""

IDENTITY = {"recorder": "emulated recorder", "serial": "R1", "version": "1.0", "rate_hz": float(RATE_HZ)}
"""What it says of itself (assumption)."""


class EmulatedAudio(EmulatedDevice):
    """Follows docs/reference/sensors.md: bytes in, bytes out, and time from outside.

    Its converter runs by itself; sound is computed while the host subscribes. One host at a time: `hang_up` ends its
    connection, which silences the drive. While `lossy`, packets are dropped as by a converter's overrun: the counter
    goes on.

    Args:
        drift_ppm: Of its clock.

    Attributes:
        lossy: True drops every packet.
    """

    called = "a recorder"

    def __init__(self, bench: Bench, drift_ppm: float = DRIFT_PPM) -> None:
        super().__init__()
        self._drift_ppm = drift_ppm
        self._bench = bench
        self._line = bytearray()
        self._on = False
        self._refusals = 0
        self._next = 0
        self._offset = START_FRAME
        self._sweep_end: int | None = None
        self.dropped = 0
        self.lossy = False
        self._orders: Mapping[str, Callable[[Mapping[str, Any], int], Mapping[str, Any]]] = {
            "hello": self._hello,
            "start": self._start,
            "stop": self._stop,
            "tone": self._tone,
            "chirp": self._chirp,
            "silence": self._hush,
        }

    def receive(self, data: bytes, t_s: float) -> bytes:
        """See `EmulatedDevice.receive`."""
        self._run(t_s)
        self._line += data
        *lines, rest = bytes(self._line).split(b"\n")
        self._line = bytearray(rest[-MAX_LINE_BYTES:])
        for line in lines:
            try:
                command = decode_line(line)
            except CodecError as error:
                self._reply({"reply": 0, "refused": str(error)}, t_s)
                continue
            tag = command.get("tag")
            self._reply(
                {"reply": tag if isinstance(tag, int) else 0, **self._obey(command, self._frame(t_s))}, t_s
            )
        return self._take(t_s)

    def hang_up(self, t_s: float) -> None:
        """The host is gone: nothing is recorded or driven any more."""
        self._bench.advance(t_s)
        self._bench.silence()
        self._on = False
        self._sweep_end = None
        self._line.clear()
        self._outbox = b""

    def _ways(self, t_s: float) -> Mapping[str, Callable[[], object]]:
        """Faults: "refuse" affects the next drive; "restart" sets the converter's counter back."""
        return {"refuse": self._refuse_next, "restart": self._begin_anew}

    def _refuse_next(self) -> None:
        self._refusals += 1

    def _begin_anew(self) -> None:
        self._offset = -self._next

    # time

    def _frame(self, t_s: float) -> int:
        """How many frames are over on the bench's count."""
        return math.floor(t_s * RATE_HZ * (1.0 + self._drift_ppm * 1e-6))

    def _run(self, t_s: float) -> None:
        self._bench.advance(t_s)
        over, size = self._frame(t_s), PACKET_FRAMES
        if self._sweep_end is not None and self._sweep_end <= over:
            self._put(SoundMessage(self._sweep_end + self._offset, {"event": "swept"}))
            self._sweep_end = None
        while self._on and self._next + size <= over:
            if self.lossy:
                self.dropped += size
            else:
                counts = self._bench.carrier(self._next, size, drift_ppm=self._drift_ppm)
                self._put(Sound(self._next + self._offset, counts))
            self._next += size

    # commands

    def _obey(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        name = command.get("do")
        order = self._orders.get(name) if isinstance(name, str) else None
        if order is None:
            what = name if isinstance(name, str) else type(name).__name__
            return {"refused": f"there is no {what}; there are {', '.join(self._orders)}"}
        try:
            return order(command, frame)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            return {"refused": f"{name}: {type(error).__name__} {error}"}

    def _hello(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        return {**IDENTITY, "channels": len(FINGERS), "bits": 24}

    def _start(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        if not self._on:
            self._on, self._next = True, frame
        return {}

    def _stop(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        self._on = False
        return {}

    def _tone(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        return self._driven(
            lambda: self._bench.drive(_finite(command, "frequency_hz"), _finite(command, "level"))
        )

    def _chirp(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        span = [_finite(command, key) for key in ("from_hz", "to_hz", "duration_s", "level")]
        answer = self._driven(lambda: self._bench.chirp(*span))
        if not answer:
            self._sweep_end = frame + round(span[2] * RATE_HZ)
        return answer

    def _hush(self, command: Mapping[str, Any], frame: int) -> Mapping[str, Any]:
        self._sweep_end = None
        self._bench.silence()
        return {}

    def _driven(self, drive: Callable[[], None]) -> Mapping[str, Any]:
        if self._refusals:
            self._refusals -= 1
            return {"refused": "its amplifier is off"}
        self._sweep_end = None
        drive()
        return {}

    def _reply(self, content: Mapping[str, Any], t_s: float) -> None:
        self._put(SoundMessage(self._frame(t_s) + self._offset, content))

    def _put(self, frame: Sound | SoundMessage) -> None:
        self._outbox += encode(frame)


def _finite(command: Mapping[str, Any], key: str) -> float:
    value = float(command[key])
    if not math.isfinite(value):
        raise ValueError(f"{key} is {value}")
    return value


def emulated(settings: object, bench: Bench) -> EmulatedAudio:
    """A recorder on the network, wired to the bench's fingers and to their drive.

    Raises:
        RefusedError: the bench has no such fingers.
    """
    part(bench, "carrier", "audio")
    return EmulatedAudio(bench)
