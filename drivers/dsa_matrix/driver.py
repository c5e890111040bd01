"""Tactile matrices behind a DSACON32-M on a serial line."""

from collections.abc import Mapping, Sequence
from typing import TypeVar

import numpy as np
from pydantic import Field

from drivers.core.clock_model import DeviceClock
from drivers.core.errors import CodecError, ProtocolError, RefusedError
from drivers.core.links import SerialLink, SerialPort, open_serial
from drivers.core.messages import Command, DeviceInfo, Listen, Saturated, StreamInfo
from drivers.core.numbering import SampleStream
from drivers.core.wire import Inquiry, WireDriver, check_sensor
from drivers.dsa_matrix import codec
from drivers.dsa_matrix.packets import MatrixPacket, PacketDecoder, encode_packet

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
    """When it is asked again. Assumption: three raw frames of 210 cells are ahead of it on the line."""
    silence_timeout_s: float = Field(default=1.0, gt=0.0, le=60.0)
    """Silence after which the matrices have failed (assumption: a hundred frames)."""
    max_drift_ppm: float = Field(default=200.0, gt=0.0, le=10_000.0)
    """Bound on the drift between the controller's clock and the host's. Assumption: two crystals of 100 ppm."""


T = TypeVar("T", bound=codec.Answer)


class DsaMatrix(WireDriver[SerialLink]):
    """The texels of tactile matrices. It moves nothing.

    The controller reports its matrices and their cells. The stream `<name>.taxels` has one channel for each cell,
    `m<matrix>.r<row>.c<column>`, raw counts of about a millivolt; frames are dated by the controller's own clock
    (`numbering`), which counts milliseconds. A gap is reported as `Lost`: the controller drops the frames that the
    line is too slow for. A texel at full scale is reported as `Saturated`.
    """

    _settings: DsaMatrixSettings
    _opens = staticmethod(open_serial)

    def _prepare(self) -> None:
        self._stream: SampleStream | None = None
        self._forget()

    def _forget(self) -> None:
        self._decoder = PacketDecoder()
        self._listening = False
        self._saturated = False
        self._missing = self._wrong = 0
        self._ordered: bool | None = None  # whether frames were asked for or stopped, without an answer yet
        self._repeated = False
        self._due_s = self._received_s = 0.0
        self._refusal: str | None = None

    def _identify(self, link: SerialLink) -> DeviceInfo:
        """Stop frames that an earlier host has left on, query the matrices; wait for a controller that powers up."""
        s = self._settings
        self._ask(link, self._acquire(False), codec.Done, s.power_up_s)
        controller = self._ask(link, codec.request(codec.Id.CONTROLLER), codec.ControllerInfo)
        sensor = self._ask(link, codec.request(codec.Id.SENSOR), codec.SensorInfo)
        matrices = [
            self._ask(link, codec.request(codec.Id.MATRIX, number), codec.MatrixInfo)
            for number in range(sensor.matrices)
        ]
        if s.threshold_counts is not None:
            self._set_threshold(link, s.threshold_counts, sensor.matrices)
        info = self._stream_info(matrices)
        self._own_clock = DeviceClock(s.max_drift_ppm, wrap_s=codec.TIME_MODULUS * 1e-3)
        self._stream = SampleStream(info, self._own_clock, self._clock, np.int32)
        return DeviceInfo(
            self.name,
            model="DSACON32-M",
            serial=str(controller.serial),
            version=str(controller.software),
            streams={info.name: info},
            clock=f"{self.name} milliseconds",
            details={
                "port": s.port,
                "sensor_serial": sensor.serial,
                "matrices": [
                    {
                        "rows": matrix.cells_y,
                        "columns": matrix.cells_x,
                        "texel_m": (matrix.texel_width_mm * 1e-3, matrix.texel_height_mm * 1e-3),
                        "uid": matrix.uid.hex(),
                    }
                    for matrix in matrices
                ],
                "raw_limit_hz": self._raw_limit_hz(len(info.channels)),
            },
        )

    def _set_threshold(self, link: SerialLink, counts: int, matrices: int) -> None:
        self._ask(link, codec.request(codec.Id.SET_THRESHOLD, codec.ALL_MATRICES_BIT, counts), codec.Done)
        for number in range(matrices):
            held = self._ask(link, codec.request(codec.Id.THRESHOLD, number), codec.Done).counts
            if held != counts:
                reason = f"matrix {number} was set to threshold {counts} and holds {held}"
                advice = "is its firmware older than release 268?"
                raise RefusedError(self.name, "setting it up", reason, advice)

    def _ask(self, link: SerialLink, request: MatrixPacket, kind: type[T], patience_s: float = 0.0) -> T:
        """Ask until the answer to this request comes; raises a `DeviceError`."""
        doing = f"asking who is at {self._settings.port}"

        def send() -> None:
            self._decoder.flush()  # left over from the last attempt
            link.send(encode_packet(request))

        def parse(arrived: tuple[float, bytes]) -> T | None:
            for packet in self._decoder.feed(arrived[1]):
                if packet.id != request.id:
                    continue
                try:
                    answer = codec.decode_answer(packet)
                except CodecError as error:
                    raise ProtocolError(self.name, doing, str(error), "is it a DSACON32-M?") from error
                refusal = getattr(answer, "error", 0)
                if refusal:
                    reason = f"it answers with an error: {codec.meaning(refusal)}"
                    raise RefusedError(self.name, doing, reason, "is its sensor plugged in?")
                if isinstance(answer, kind):
                    return answer
            return None

        inquiry = Inquiry(
            self.name,
            doing,
            link,
            self._clock,
            self._settings.reply_timeout_s,
            strange=self._strange,
            stranger="is another device at this port, or the baud rate wrong?",
            silent="is it powered?",
        )
        return inquiry.ask(send, parse, patience_s)

    def _strange(self) -> str:
        noise = self._decoder.noise.replace(codec.POWER_UP_NOISE, b"")
        packets = self._decoder.good
        return f"{noise!r} and {packets} packets came, and no answer" if noise or packets else ""

    def _leave(self, link: SerialLink, failure: str | None) -> None:
        link.send(encode_packet(self._acquire(False)))

    def _valid(self, command: Command) -> Command:
        return check_sensor(self.name, command, (f"{self.name}.taxels",), "matrices", (Listen,))

    def _carry_out(self, command: Command) -> None:
        wanted = isinstance(command, Listen) and bool(command.streams)
        if wanted == self._listening or self._link is None or self._stream is None:
            return
        self._turn()
        self._listening = wanted
        if wanted:
            self._stream.begin()
            self._saturated = False
        self._order(self._link, wanted)
        self._sent(command)

    def account(self) -> Mapping[str, object]:
        """Packets, errors and losses, and the drift of the controller's clock, for the manifest."""
        if self._stream is None:
            return {}
        return {
            "packets": self._decoder.good,
            "bad_crc": self._decoder.bad_crc,
            "bytes_passed_over": self._decoder.passed_over,
            "frames_wrong": self._wrong,
            "frames_lost": self._missing,
            **self._own_clock.account(self.name),
        }

    def _acquire(self, run: bool) -> MatrixPacket:
        return codec.acquire(run, self._settings.rle, self._settings.frame_hz if run else 0)

    def _raw_limit_hz(self, cells: int) -> float:
        return self._settings.baud / BITS_PER_BYTE / (OVERHEAD_BYTES + 2 * cells)

    def _stream_info(self, matrices: Sequence[codec.MatrixInfo]) -> StreamInfo:
        """The stream of the texels.

        Raises:
            RefusedError: there is no cell, or the line cannot carry raw frames at the rate that is asked for.
        """
        channels = codec.channel_names((matrix.cells_y, matrix.cells_x) for matrix in matrices)
        if not channels:
            raise RefusedError(self.name, "opening", "it has no matrix", "is the sensor plugged into it?")
        limit_hz, s = self._raw_limit_hz(len(channels)), self._settings
        if not s.rle and s.frame_hz > limit_hz:
            reason = f"{len(channels)} cells at {s.frame_hz} frames/s do not fit {s.baud} baud"
            raise RefusedError(
                self.name, "opening", reason, f"set rle = true, or frame_hz to {int(limit_hz)} at the most"
            )
        return StreamInfo(f"{self.name}.taxels", channels, "V", codec.VOLT_PER_COUNT, float(s.frame_hz))

    def _order(self, link: SerialLink, run: bool, repeated: bool = False) -> None:
        """Ask for frames, or for none."""
        link.send(encode_packet(self._acquire(run)))
        self._received_s = self._clock.monotonic_s()
        self._due_s = self._received_s + self._settings.reply_timeout_s
        self._ordered, self._repeated = run, repeated

    def _update(self, link: SerialLink) -> str | None:
        """Process what has arrived; check for silence."""
        stream = self._stream
        assert stream is not None
        for arrival_s, data in link.receive():
            self._received_s = arrival_s
            for packet in self._decoder.feed(data):
                try:
                    answer = codec.decode_answer(packet)
                except CodecError:
                    self._wrong += 1
                    continue
                if isinstance(answer, codec.Frame) and self._listening:
                    self._take(stream, answer, arrival_s)
                elif isinstance(answer, codec.Done):
                    self._settle(answer)
        self._blocks += stream.take()
        return self._refusal or link.fault or self._overdue(link) or self._silent()

    def _take(self, stream: SampleStream, frame: codec.Frame, arrival_s: float) -> None:
        info = stream.info
        if len(frame.texels) != len(info.channels):
            self._wrong += 1
            return
        bench_s, lost = stream.push(frame.texels, frame.time_ms * 1e-3, arrival_s)
        if lost is not None:
            self._missing += lost
            self._lost(bench_s, info.name, lost)
        full = bool((frame.texels >= codec.TEXEL_MAX).any())
        if full and not self._saturated:
            self._report(Saturated(bench_s, self.name, info.name, codec.TEXEL_MAX * info.scale))
        self._saturated = full

    def _settle(self, done: codec.Done) -> None:
        if done.id is codec.Id.ACQUIRE:
            self._ordered = None
        if done.error:
            self._refusal = f"it refuses to send frames: {codec.meaning(done.error)}"

    def _overdue(self, link: SerialLink) -> str | None:
        """Repeat an order that has no answer, once."""
        if self._ordered is None or self._clock.monotonic_s() < self._due_s:
            return None
        if self._repeated:
            return f"no answer to an order, sent twice in {2 * self._settings.reply_timeout_s:g} s"
        self._order(link, self._ordered, repeated=True)
        return None

    def _silent(self) -> str | None:
        silence_s = self._settings.silence_timeout_s
        if not self._listening or self._clock.monotonic_s() - self._received_s <= silence_s:
            return None
        return f"no frame in {silence_s:g} s; is the controller powered?"
