"""What is fuzzed: every decoder of bytes that come from a line, a network or a disk, and what may come out of it.

A target takes any bytes. Where a checksum guards a decoder, the bytes are also taken as what a right one guards: the
fuzzer would hardly find it. Only the errors that a decoder promises may come out.
"""

import io
import json
import struct
import tempfile
import wave
import zipfile
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from config.profile import load_profile
from config.source import ProfileError
from config.trials import read_csv
from controller.recording.mcap_file import McapWriter
from controller.recording.reader import open_run
from controller.recording.run_folder import RunFolderError
from controller.recording.schemas import encode_block, schema_of
from controller.recording.tables import ReplayError, read_columns
from drivers.audio import codec as sound
from drivers.audio.recording import Recording
from drivers.audio.settings import AudioSettings
from drivers.barrett_hand import codec as hand
from drivers.barrett_hand.strain import FingerStrainSettings
from drivers.can_gripper import codec as gripper
from drivers.core.can_frame import CanFrame
from drivers.core.clock import VirtualClock
from drivers.core.errors import CodecError, DeviceError
from drivers.core.links import LineBuffer
from drivers.core.messages import Listen, StreamInfo
from drivers.dsa_matrix import codec as dsa
from drivers.dsa_matrix.driver import DsaMatrix, DsaMatrixSettings
from drivers.dsa_matrix.packets import MatrixPacket, PacketDecoder, encode_packet
from drivers.operator import codec as person
from drivers.sensor_board import codec as board
from drivers.sensor_board.framing import BoardFrameDecoder, frame
from drivers.sensor_board.streams import BoardStreams
from drivers.serial_lines.driver import SerialLines
from drivers.serial_lines.settings import SerialLinesSettings
from drivers.udp_force.codec import ForceRecord, decode_settings, encode_record
from drivers.udp_force.driver import UdpForce, UdpForceSettings
from drivers.zaber_stage import codec as zaber
from simulator.devices.audio import EmulatedAudio
from simulator.devices.barrett_hand import EmulatedBarrettHand
from simulator.devices.dsa_matrix import EmulatedDsaMatrix
from simulator.devices.sensor_board import EmulatedSensorBoard
from simulator.devices.slcan import EmulatedSlcan
from simulator.devices.ur_controller.controller import UrController, UrControllerSettings
from simulator.devices.ur_controller.rtde import PackageError
from simulator.devices.ur_controller.session import DashboardSession, RtdeSession, ScriptSession
from simulator.devices.zaber_stage import EmulatedZaberStage
from simulator.mocks.base import MemoryLine
from simulator.physics.fingertip_settings import Matrix
from simulator.physics.stage_axis import StageAxis
from simulator.wiring.emulator import ControlPort
from tests.contracts.audio_suite import SteadyFingers
from tests.steady import SteadyForces, SteadyTexels
from tests.unit.drivers.sensor_board.conftest import Source

BYTES_MAX: Final = 4096
"""Longest input: longer than any frame, short enough to be quick."""

BOARD_STREAMS: Final = {
    0: StreamInfo("board.load_cell", ("force",), "N", 1e-5, 1000.0),
    1: StreamInfo("board.accelerometer", ("x", "z"), "m/s2", 1e-3, 500.0),
    2: StreamInfo("board.period", ("period",), "s", 1e-7, None),
}


@dataclass(frozen=True)
class Target:
    """A decoder.

    Attributes:
        run: Gives it some bytes.
        seeds: Inputs that reach far into it, to begin with.
    """

    run: Callable[[bytes], None]
    seeds: Callable[[], Iterable[bytes]]


def _halves(data: bytes) -> tuple[bytes, ...]:
    """In two pieces, as a line may bring them; the first byte is where they part."""
    cut = data[0] if data else 0
    return data[1 : 1 + cut], data[1 + cut :]


# --- lines ---------------------------------------------------------------------------------------


def _board(data: bytes) -> None:
    streams = BoardStreams(BOARD_STREAMS, VirtualClock(), 200.0)
    decoder = BoardFrameDecoder()
    bodies = [body for piece in _halves(data) for body in decoder.feed(piece)]
    for place, body in enumerate((*bodies, *data.split(b"\xff\x00\xff"))):
        with suppress(CodecError):
            message = board.decode(body)
            if isinstance(message, board.BoardSamples):
                streams.push(message, 10.0 + 0.01 * place)
    device = EmulatedSensorBoard(Source())
    for body in (b"", *data.split(b"\xff\x00\xff")):
        with suppress(ValueError):  # a body that is too long for a frame
            device.receive(b"\0" + frame(body), 1.0)
    device.receive(data, 1.0)
    device.step(1.02)


def _board_seeds() -> Iterable[bytes]:
    counts, times_us = np.array([-16384, 16777216], np.int32), np.array([7, 9], np.uint32)
    yield b"\xff\x00\xff".join(
        (
            bytes.fromhex("0100020140420f00 00c0ffff00000001".replace(" ", "")),
            board.encode(board.BoardSamples(2, 3, 7, counts, times_us))[1:-3],
        )
    )
    for code in (1, 2, 3, 4, 5, 6, 7):
        yield bytes([0x80, code, 1]) + struct.pack("<I", 7)[: {2: 4, 4: 1, 5: 4, 6: 1, 7: 2}.get(code, 0)]
    yield (
        b"\x03"
        + json.dumps(
            {
                "board": "b",
                "serial": "1",
                "version": "2",
                "streams": [
                    {
                        "id": 0,
                        "name": "n",
                        "channels": ["a"],
                        "rate_hz": 1000.0,
                        "unit": "N",
                        "scale": 1.0,
                        "kind": "samples",
                    }
                ],
            }
        ).encode()
    )


def _zaber(data: bytes) -> None:
    lines = LineBuffer(zaber.MAX_LINE)
    for line in [line for piece in _halves(data) for line in lines.feed(piece)]:
        for checksum in (True, False):
            with suppress(CodecError):
                zaber.decode_message(line, checksum=checksum)
        with suppress(CodecError):
            zaber.decode_request(line)
    axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.026)
    stage = EmulatedZaberStage(axis, homed=True)
    for place, text in enumerate(data.split(b"\n")):
        stage.receive(text + b"\n", 0.1 * place)
        with suppress(UnicodeDecodeError):
            body = text.decode("ascii")
            stage.receive(zaber.encode_request(zaber.StageRequest(1, 0, place % 100, body)), 0.1 * place)
    stage.step(1.0)


def _zaber_seeds() -> Iterable[bytes]:
    for text in (
        "get pos",
        "move abs 1000",
        "move vel -500",
        "home",
        "stop",
        "set maxspeed 9",
        "warnings clear",
    ):
        yield b"\0\n" + text.encode()
    yield b"\x05@01 1 07 OK BUSY -- 4321\r\n!01 1 IDLE FS\r\n#01 1 07 comment\r\n/1 1 07 get pos:4F\n"


class _Silent:
    """A node that receives everything."""

    def receive(self, frame: CanFrame, t_s: float) -> list[CanFrame]:
        for decode in (gripper.decode_order, gripper.decode_answer):
            with suppress(CodecError):
                decode(frame)
        for read in (hand.decode_query, hand.decode_reading):
            with suppress(CodecError):
                read(frame)
        return []

    def step(self, t_s: float) -> list[CanFrame]:
        return []

    def inject(self, kind: str, t_s: float) -> None:
        raise ValueError(kind)


def _slcan(data: bytes) -> None:
    fingers = SteadyForces(dict.fromkeys(hand.FINGERS, 1.0))
    adapter = EmulatedSlcan(_Silent(), EmulatedBarrettHand(FingerStrainSettings(), fingers))
    adapter.receive(b"C\rS6\rO\r", 0.0)
    for piece in _halves(data):
        adapter.receive(piece, 0.1)
    adapter.step(0.2)


def _slcan_seeds() -> Iterable[bytes]:
    yield b"\x03t00C119\rt4051 19\rt405119\rr0000\rV\rN\rS6\rC\rO\r"
    yield b"\x00t5664880100 00\rt56648801FF07\rt0018FFFFFFFFFFFFFFFF\rt7FF0\r"
    for number in range(0, 0x800, 0x40):
        yield f"\0t{number:03X}8001122334455667788\r".encode()


def _dsacon(data: bytes) -> None:
    decoder = PacketDecoder()
    packets = [packet for piece in _halves(data) for packet in decoder.feed(piece)] + decoder.flush()
    packets += [MatrixPacket(part[0], part[1:]) for part in data.split(b"\xaa\xbb") if part]
    for packet in packets:
        with suppress(CodecError):
            dsa.decode_request(packet)
    texels = SteadyTexels((Matrix(1, 2, 3.4e-3),), np.full(2, 1.0))
    device = EmulatedDsaMatrix(texels, 115_200)
    clock = VirtualClock()
    line = MemoryLine(device, clock)
    driver = DsaMatrix("dsa", DsaMatrixSettings(port="memory"), clock, line.connect)
    driver.open()
    driver.apply(Listen("dsa", frozenset({"dsa.taxels"})))
    for packet in packets:
        clock.rest(0.01)
        with suppress(ValueError):  # a payload that is too long for a packet
            line._arrived.append((clock.monotonic_s(), encode_packet(packet)))
        driver.read()
    device = EmulatedDsaMatrix(texels, 115_200)
    device.step(0.0)
    device.receive(data, 0.1)
    for packet in packets[:20]:
        with suppress(ValueError):  # a payload that is too long for a packet
            device.receive(encode_packet(packet), 0.2)
    device.step(0.3)


def _dsacon_seeds() -> Iterable[bytes]:
    texels = np.array([7, 4095], np.uint16)
    answers = [dsa.Frame(time_ms, rle, texels) for time_ms in (10, 20, 0) for rle in (True, False)]
    answers += [dsa.Done(dsa.Id.ACQUIRE, 0), dsa.Done(dsa.Id.THRESHOLD, 0, 5), dsa.SensorInfo(0, 1, 2, 3)]
    packets = [dsa.encode_answer(answer) for answer in answers]
    packets += [dsa.acquire(True, True, 100), dsa.request(dsa.Id.MATRIX, 0)]
    yield b"\0" + b"".join(map(encode_packet, packets))
    yield b"\xaa\xbb".join(bytes([packet.id]) + packet.payload for packet in packets)


def _rtde(data: bytes) -> None:
    controller = UrController(UrControllerSettings())
    session = RtdeSession(controller, set())
    with suppress(PackageError):
        for piece in _halves(data):
            session.feed(piece)
            controller.step()
            session.step()
    session.close()


def _packages(*packages: bytes) -> bytes:
    return b"".join(struct.pack(">H", len(package) + 2) + package for package in packages)


def _rtde_seeds() -> Iterable[bytes]:
    outputs = b"O" + struct.pack(">d", 500.0) + b"timestamp,actual_q,safety_status,actual_TCP_force"
    inputs = b"Iinput_int_register_0,input_double_register_0,input_bit_register_64"
    yield b"\x20" + _packages(b"V\0\2", b"v", outputs, b"S", b"P")
    yield b"\x20" + _packages(b"V\0\2", inputs, b"U\x01" + struct.pack(">id?", 7, 0.5, True), b"S")
    yield b"\x40" + _packages(outputs, b"S", inputs, b"U\x01\0\0")


def _script(data: bytes) -> None:
    controller = UrController(UrControllerSettings())
    for session in (ScriptSession(controller), DashboardSession(controller)):
        with suppress(PackageError):
            for piece in _halves(data):
                session.feed(piece)
        session.close()
    for _ in range(3):
        controller.step()


def _script_seeds() -> Iterable[bytes]:
    yield b"\x20def rtde_control():\n  # int register offset\n24 = 0\nend\n"
    yield b"\x05robotmode\nplay\nunlock protective stop\nsafetystatus\nstop\n"


def _audio(data: bytes) -> None:
    decoder = sound.FrameDecoder()
    with suppress(CodecError):
        for piece in _halves(data):
            decoder.feed(piece)
    recorder = EmulatedAudio(SteadyFingers())
    for place, line in enumerate(data.split(b"\n")[:20]):
        with suppress(CodecError):
            sound.decode_line(line)
        recorder.receive(line + b"\n", 0.001 * place)
    recorder.step(0.03)


def _audio_seeds() -> Iterable[bytes]:
    counts = np.arange(12, dtype=np.int32).reshape(6, 2)
    yield (
        b"\x10" + sound.encode(sound.Sound(2**33, counts)) + sound.encode(sound.SoundMessage(5, {"reply": 1}))
    )
    requests = [
        {"do": "hello", "tag": 1},
        {"do": "start", "tag": 2},
        {"do": "tone", "frequency_hz": 40_000.0, "level": 0.5, "tag": 3},
        {"do": "chirp", "from_hz": 30_000.0, "to_hz": 40_000.0, "duration_s": 0.01, "level": 0.5, "tag": 4},
        {"do": "silence", "tag": 5},
        {"do": "stop", "tag": 6},
    ]
    yield b"".join(map(sound.encode_line, requests))


def _person(data: bytes) -> None:
    lines = LineBuffer(person.LINE_MAX)
    for line in [line for piece in _halves(data) for line in lines.feed(piece)]:
        with suppress(CodecError):
            person.encode(person.decode(line))


def _person_seeds() -> Iterable[bytes]:
    yield b'\x09{"hello": "x"}\n{"answer": 3, "done": true, "reason": "r"}\n{"ask": 1, "says": "s"}\n'
    yield b'\0{"ask": 1, "says": "s", "load": {"bridge": "x", "force_n": 2.5}}\n'


class _Sends:
    """A device that sends some bytes once it is looked at, in two parts, and takes what comes."""

    def __init__(self, parts: Iterable[bytes]) -> None:
        self._parts = iter(parts)

    def step(self, t_s: float) -> bytes:
        return next(self._parts, b"")

    def receive(self, data: bytes, t_s: float) -> bytes:
        return b""

    def inject(self, kind: str, t_s: float) -> None:
        raise ValueError(kind)


class _Settled(SerialLines):
    settled = (0.0, 3)


def _printed(data: bytes) -> None:
    whole = b"".join(b"%d,1.5,%d\n" % (10_000 * tick, tick) for tick in range(3))
    streams = {"force": {"columns": (1,), "unit": "N"}}
    given: dict[str, Any]
    for given in ({}, {"time_column": None}, {"counter_column": 2, "counter_modulus": 256, "rate_hz": 100.0}):
        clock = VirtualClock()
        settings = SerialLinesSettings(port="x", streams=streams, reply_timeout_s=0.01, **given)
        line = MemoryLine(_Sends([b"5,0\n" + whole, *_halves(data)]), clock)
        board = _Settled("uno", settings, clock, line.connect)
        board.open()
        board.apply(Listen("uno", frozenset({"uno.force"})))
        for _ in range(4):
            clock.rest(0.01)
            for block in board.read():
                assert np.isfinite(block.times).all()


def _printed_seeds() -> Iterable[bytes]:
    yield b"30000,1.5,3\r\n40000,nan,4\r\n4294967295,-1e9,255\r\n0,2,0\r\n"
    yield b"\xff\x00ets Jul 29\r\n,,\r\n1_0,2,3\n1e400,1,1\n-1,2,3\n0.5,1,2\n99999999999999999999,1,1\n"


def _rdt(data: bytes) -> None:
    clock = VirtualClock()
    settings = UdpForceSettings(
        host="x", counts_per_n=1.0, counts_per_nm=1.0, rate_hz=1000.0, sample_hz=7000.0, reply_timeout_s=0.01
    )
    first = encode_record(ForceRecord(1, 7, 0, (0,) * 6))
    line = MemoryLine(_Sends([first, data]), clock)
    box = UdpForce("ft", settings, clock, line.connect)
    box.open()
    box.apply(Listen("ft", frozenset({"ft.force", "ft.normal"})))
    for _ in range(3):
        clock.rest(0.01)
        for block in box.read():
            assert np.isfinite(block.times).all()
    with suppress(CodecError):
        decode_settings(data.decode("utf-8", "replace"))


def _rdt_seeds() -> Iterable[bytes]:
    yield b"".join(
        encode_record(ForceRecord(rdt, 7 * rdt % 2**32, 0, (rdt % 2**31,) * 6))
        for rdt in (1, 2, 5, 4, 2**32 - 1, 0)
    )
    yield encode_record(ForceRecord(2**32 - 1, 0, 0x80020000, (2**31 - 1,) * 6))
    yield b"<scfgfu>N</scfgfu><scfgtu>Nm</scfgtu><cfgcpf>1e6</cfgcpf><cfgcpt>x</cfgcpt>"


@cache
def _control_port() -> ControlPort:
    return ControlPort(lambda request: {"account": request.model_dump(mode="json")})


def _control(data: bytes) -> None:
    for line in data.split(b"\n"):
        json.dumps(_control_port()._answered(line))


def _control_seeds() -> Iterable[bytes]:
    yield b"{}"
    yield b'{"trial": 1, "seed": 2, "factors": {"plant.noise_scale": 0.5}, "plant": {"kind": "finger"}}'
    yield b'{"fault": {"device": "stage", "kind": "stall", "at_s": 1.0}}\n{"account": false}'


# --- files ---------------------------------------------------------------------------------------


@cache
def _folder() -> Path:
    return Path(tempfile.mkdtemp(prefix="touchbench-fuzz-"))


def _file(name: str, data: bytes) -> Path:
    path = _folder() / name
    path.write_bytes(data)
    return path


def _run_folder(data: bytes) -> None:
    """Recording, table, events and manifest, parted by a mark; what is missing is as a small run leaves it."""
    parts = dict(zip(RUN_FILES, data.split(MARK), strict=False))
    folder = _folder() / "2026-01-01T00-00-00Z_mock-fuzz_0000"
    folder.mkdir(exist_ok=True)
    for name, whole in _small_run().items():
        (folder / name).write_bytes(parts.get(name) or whole)
    with suppress(RunFolderError):
        run = open_run(folder)
        for trial in run.recorded_trials:
            recording = run.readable(trial)
            if recording is not None:
                recording.stream("board.load_cell").between(0.0, 1.0)


MARK: Final = b"\x00--\x00"

RUN_FILES: Final = ("recording.mcap", "trials.csv", "events.jsonl", "manifest.json")


@cache
def _small_run() -> Mapping[str, bytes]:
    return {
        "recording.mcap": _small_recording(),
        "trials.csv": b"trial,outcome,location,delay_s\n1,contact,a,0.25\n",
        "events.jsonl": b'{"t_s": 1.5, "trial": 1, "event": "Contact", "state": "APPROACH", "next": "STOPPING"}\n',
        "manifest.json": json.dumps(
            {"format": 1, "bench": "mock", "outcomes": {"contact": 1}, "exit": {"status": "done"}}
        ).encode(),
    }


@cache
def _small_recording() -> bytes:
    path = _folder() / "small.mcap"
    path.unlink(missing_ok=True)
    schema, info = schema_of("Block"), BOARD_STREAMS[0]
    writer = McapWriter(path)
    channel = writer.topic("/raw/board.load_cell", schema.name, schema.descriptors, {"stream": info.name})
    writer.add_metadata("trial", {"trial": "1", "factors": "{}", "base_ns": "0"})
    for place in range(2):
        block = info.block(10 * place, 0.01 * place, np.arange(10, dtype=np.int32)[:, None])
        writer.add(channel, place, encode_block(schema, block), place)
    writer.finish()
    return path.read_bytes()


def _run_folder_seeds() -> Iterable[bytes]:
    yield MARK.join(_small_run().values())
    yield MARK.join((b"", b"trial,outcome\n1,contact\n2,", b'{"trial": 1'))


def _columns(suffix: str, *columns: str | None) -> Callable[[bytes], None]:
    def run(data: bytes) -> None:
        path = _file(f"input{suffix}", data)
        for column in columns:
            with suppress(ReplayError):
                read_columns(path, column)

    return run


def _csv_seeds() -> Iterable[bytes]:
    yield b"t_s,force\n0.0,1.0\n0.001,1.5\n0.002,2.5\n"
    yield b"# comment\ntime (ms);f\n0,0;1,0\n0,1;1,5\n"
    yield b"timestamp\tf\n2026-01-01T00:00:00Z\t1\n2026-01-01T00:00:01Z\t2\n"
    yield b"1.0 2.0\n1.5 2.5\n"
    yield b"t_s,f\n1e-320,1\n2e-320,2\n"


def _npz_seeds() -> Iterable[bytes]:
    for save in (np.savez, np.savez_compressed):
        packed = io.BytesIO()
        save(packed, t_s=np.arange(4) * 1e-3, force=np.arange(4.0))
        yield packed.getvalue()
    packed = io.BytesIO()
    with zipfile.ZipFile(packed, "w") as opened:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (3,), }\n"
        opened.writestr(
            "f.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(24)
        )
    yield packed.getvalue()


def _wav_seeds() -> Iterable[bytes]:
    for width in (1, 2, 3, 4):
        packed = io.BytesIO()
        with wave.open(packed, "wb") as opened:
            opened.setnchannels(2)
            opened.setsampwidth(width)
            opened.setframerate(96_000)
            opened.writeframes(bytes(range(48)) * width)
        yield packed.getvalue()


def _mcap_seeds() -> Iterable[bytes]:
    yield _small_recording()


def _played(data: bytes) -> None:
    """A WAV file in the fingers' place."""
    path = _file("take.wav", data)
    recording = Recording("audio", AudioSettings(port=f"file:{path}", paced=False), VirtualClock(), str(path))
    with suppress(DeviceError):
        recording.open()
        recording.peek(0.01)
        recording.listen(True)
        recording.receive()
    recording.close()


def _profile(data: bytes) -> None:
    path = _file("profile.toml", data)
    with suppress(ProfileError):
        load_profile(path)


def _profile_seeds() -> Iterable[bytes]:
    yield b'extends = "mock/transient"\n[limits]\nforce_n = 1.5\n'
    yield b'extends = "mock/transient"\n[trials]\nrepeats = 2\nlist = [ { location = "f", speed_m_s = 0.003 } ]\n'
    yield b'extends = "mock/slip"\nseed = 7\n[detectors.slip]\nkind = "slip.paper"\n[trials.grid]\nx = [1, 2]\n'
    yield b'extends = "mock/static"\nfaults = [{ device = "board", kind = "silent", at_s = 1 }]\n'


def _trials(data: bytes) -> None:
    path = _file("trials.csv", data)
    with suppress(ProfileError):
        read_csv(path)


def _trials_seeds() -> Iterable[bytes]:
    yield b"location,speed_m_s\na,0.003\nf,0.004\n"
    yield b'location,"plant.noise_scale"\n"a",true\n'


TARGETS: Final[Mapping[str, Target]] = {
    "board": Target(_board, _board_seeds),
    "printed": Target(_printed, _printed_seeds),
    "rdt": Target(_rdt, _rdt_seeds),
    "zaber": Target(_zaber, _zaber_seeds),
    "slcan": Target(_slcan, _slcan_seeds),
    "dsacon": Target(_dsacon, _dsacon_seeds),
    "rtde": Target(_rtde, _rtde_seeds),
    "ur_script": Target(_script, _script_seeds),
    "audio": Target(_audio, _audio_seeds),
    "operator": Target(_person, _person_seeds),
    "control_port": Target(_control, _control_seeds),
    "run_folder": Target(_run_folder, _run_folder_seeds),
    "csv": Target(_columns(".csv", None, "force", "f"), _csv_seeds),
    "npz": Target(_columns(".npz", None, "force"), _npz_seeds),
    "wav": Target(_columns(".wav", None, "0,1"), _wav_seeds),
    "mcap": Target(_columns(".mcap", None, "/raw/board.load_cell:seq"), _mcap_seeds),
    "played_wav": Target(_played, _wav_seeds),
    "profile": Target(_profile, _profile_seeds),
    "trials_csv": Target(_trials, _trials_seeds),
}
"""By name."""
