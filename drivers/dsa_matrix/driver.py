"""Tactile matrices behind a DSACON32-M on a serial line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from pydantic import Field

from drivers.core.errors import CodecError, RefusedError, check_streams, wrong
from drivers.core.links import SerialLink, SerialPort, open_serial
from drivers.core.messages import Command, DeviceInfo, Listen, StreamInfo
from drivers.core.wire import WireDriver
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.frames import MatrixFrames
from drivers.dsa_matrix.identify import MatrixIdentity, identify
from drivers.dsa_matrix.packets import PacketDecoder, encode_packet

BITS_PER_BYTE = 10
"""On the line: 8 data bits, a start and a stop bit."""

OVERHEAD_BYTES = 13
"""Of a frame beside its texels: preamble, id, length, time, flags, CRC (docs/reference/sensors.md)."""


class DsaMatrixSettings(SerialPort):
    """Tactile matrices, at the controller's default line speed."""

    frame_hz: int = Field(default=100, ge=1, le=1000)
    """Frames that are asked for, a second (the paper, 5.4: 10 ms between samples)."""
    rle: bool = True
    """Frames run-length encoded: without, 70 cells fit the line 75 times a second (docs/reference/sensors.md)."""
    threshold_counts: int | None = Field(default=None, ge=0, le=codec.TEXEL_MAX)
    """Texels below this are sent as 0 by the controller; None leaves its threshold as it is."""
    power_up_s: float = Field(default=12.0, gt=0.0, le=60.0)
    """How long to wait for the first answer: after power-up the controller is deaf for about 8 s."""
    reply_timeout_s: float = Field(default=0.5, gt=0.0, le=10.0)
    """How long an answer may take. Assumption: three raw frames of 210 cells are ahead of it on the line."""
    silence_timeout_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """Silence after which the matrices have failed (assumption: a hundred frames)."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between the controller's clock and the host's. Assumption: two crystals of 100 ppm."""


@dataclass(slots=True)
class _Order:
    """An order without an answer yet, and when it counts as lost."""

    request: codec.Request
    due_s: float
    repeated: bool = False


class DsaMatrix(WireDriver[SerialLink]):
    """The texels of tactile matrices; implements `drivers.core.protocols.Device`. It moves nothing.

    The controller reports its matrices and their cells. The stream `<name>.taxels` has one channel for each cell,
    `m<matrix>.r<row>.c<column>`, raw counts of about a millivolt; frames are dated by the controller's own clock
    (`numbering`), which counts milliseconds. A gap is reported as `Lost`: the controller drops the frames that the
    line is too slow for. A texel at full scale is reported as `Saturated`.
    """

    _settings: DsaMatrixSettings
    _opens = staticmethod(open_serial)

    def _prepare(self) -> None:
        self._stream = f"{self.name}.taxels"
        self._frames: MatrixFrames | None = None
        self._forget()

    def _forget(self) -> None:
        self._decoder = PacketDecoder()
        self._listening = False
        self._order: _Order | None = None
        self._refusal: str | None = None
        self._received_s = 0.0

    def _identify(self, link: SerialLink) -> DeviceInfo:
        """Stop frames that an earlier host has left on, query the matrices; wait for a controller that powers up."""
        s = self._settings
        found = identify(self.name, s.port, link, self._decoder, self._clock, s.power_up_s, s.reply_timeout_s)
        if s.threshold_counts is not None:
            found.set_threshold(s.threshold_counts)
        info = self._stream_info(found)
        self._frames = MatrixFrames(self.name, info, self._clock, s.max_drift_ppm)
        return DeviceInfo(
            self.name,
            model="DSACON32-M",
            serial=str(found.controller.serial),
            version=str(found.controller.software),
            streams={info.name: info},
            clock=f"{self.name} milliseconds",
            details={
                "port": s.port,
                "sensor_serial": found.sensor.serial,
                "matrices": [
                    {
                        "rows": matrix.cells_y,
                        "columns": matrix.cells_x,
                        "texel_m": (matrix.texel_width_mm * 1e-3, matrix.texel_height_mm * 1e-3),
                        "uid": matrix.uid.hex(),
                    }
                    for matrix in found.matrices
                ],
                "raw_limit_hz": self._raw_limit_hz(len(info.channels)),
            },
        )

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        link.send(encode_packet(codec.encode_request(self._acquire(False))))

    def _valid(self, command: Command) -> Command:
        if not isinstance(command, Listen):
            raise wrong(self.name, command, "it has no such command", "matrices can Listen")
        check_streams(self.name, command, command.streams, (self._stream,))
        return command

    def _carry_out(self, command: Command) -> None:
        wanted = isinstance(command, Listen) and bool(command.streams)
        if wanted == self._listening or self._link is None or self._frames is None:
            return
        self._turn()
        self._listening = wanted
        if wanted:
            self._frames.begin()
        self._ask(self._link, self._acquire(wanted))
        self._sent(command)

    def account(self) -> Mapping[str, object]:
        """Packets, errors and losses, and the drift of the controller's clock, for the manifest."""
        frames, counts = self._frames, self._decoder.counts
        if frames is None:
            return {}
        return {
            "packets": counts.good,
            "bad_crc": counts.bad_crc,
            "bytes_passed_over": counts.passed_over,
            "frames_wrong": frames.wrong,
            "frames_lost": frames.lost,
            "drift_ppm": frames.clock.model.drift_ppm,
        }

    def _acquire(self, run: bool) -> codec.Acquire:
        return codec.Acquire(run, self._settings.rle, self._settings.frame_hz if run else 0)

    def _raw_limit_hz(self, cells: int) -> float:
        return self._settings.baud / BITS_PER_BYTE / (OVERHEAD_BYTES + 2 * cells)

    def _stream_info(self, found: MatrixIdentity) -> StreamInfo:
        """The stream of the texels.

        Raises:
            RefusedError: there is no cell, or the line cannot carry raw frames at the rate that is asked for.
        """
        channels = codec.channel_names((matrix.cells_y, matrix.cells_x) for matrix in found.matrices)
        if not channels:
            raise RefusedError(self.name, "opening", "it has no matrix", "is the sensor plugged into it?")
        limit_hz, s = self._raw_limit_hz(len(channels)), self._settings
        if not s.rle and s.frame_hz > limit_hz:
            reason = f"{len(channels)} cells at {s.frame_hz} frames/s do not fit {s.baud} baud"
            raise RefusedError(
                self.name, "opening", reason, f"set rle = true, or frame_hz to {int(limit_hz)} at the most"
            )
        return StreamInfo(self._stream, channels, "V", codec.VOLT_PER_COUNT, float(s.frame_hz))

    def _ask(self, link: SerialLink, request: codec.Request) -> None:
        link.send(encode_packet(codec.encode_request(request)))
        now_s = self._received_s = self._clock.monotonic_s()
        self._order = _Order(request, now_s + self._settings.reply_timeout_s)

    def _update(self, link: SerialLink) -> str | None:
        """Process what has arrived; check for silence."""
        frames = self._frames
        assert frames is not None
        for arrival_s, data in link.receive():
            self._received_s = arrival_s
            for packet in self._decoder.feed(data):
                try:
                    answer = codec.decode_answer(packet)
                except CodecError:
                    frames.wrong += 1
                    continue
                if isinstance(answer, codec.Frame) and self._listening:
                    frames.push(answer, arrival_s)
                elif isinstance(answer, codec.Done):
                    self._settle(answer)
        self._statuses += frames.take_statuses()
        self._blocks += frames.take_blocks()
        return self._refusal or link.fault or self._overdue(link) or self._silent()

    def _settle(self, done: codec.Done) -> None:
        if done.id is codec.Id.ACQUIRE:
            self._order = None
        if done.error:
            self._refusal = f"it refuses to send frames: {codec.meaning(done.error)}"

    def _overdue(self, link: SerialLink) -> str | None:
        """Repeat an order that has no answer, once."""
        order, now_s = self._order, self._clock.monotonic_s()
        if order is None or now_s < order.due_s:
            return None
        if order.repeated:
            return f"no answer to an order, sent twice in {2 * self._settings.reply_timeout_s:g} s"
        self._ask(link, order.request)
        self._order = _Order(order.request, now_s + self._settings.reply_timeout_s, repeated=True)
        return None

    def _silent(self) -> str | None:
        silence_s = self._settings.silence_timeout_s
        if not self._listening or self._clock.monotonic_s() - self._received_s <= silence_s:
            return None
        return f"no frame in {silence_s:g} s; is the controller powered?"
