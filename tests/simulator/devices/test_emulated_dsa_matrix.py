"""The emulated controller, in the bytes of its command set."""

import numpy as np
import pytest

from drivers.dsa_matrix.packets import MatrixPacket, PacketDecoder, encode_packet
from simulator.devices.dsa_matrix import EmulatedDsaMatrix, EmulatedDsaMatrixSettings, counts
from simulator.physics.fingertip_settings import Matrix
from tests.steady import SteadyTexels

CELLS = np.arange(6) * 0.5


class Line:
    """One controller, and time."""

    def __init__(self, **settings: object) -> None:
        source = SteadyTexels([Matrix(2, 3, 0.0034)], CELLS)
        values = {"drift_ppm": 0.0, "start_ms": 1000, **settings}
        self.matrices = EmulatedDsaMatrix(EmulatedDsaMatrixSettings.model_validate(values), source)
        self.decoder = PacketDecoder()
        self.t_s = 50.0
        self.matrices.step(self.t_s)

    def send(self, number: int, payload: str = "") -> list[MatrixPacket]:
        raw = self.matrices.receive(encode_packet(MatrixPacket(number, bytes.fromhex(payload))), self.t_s)
        return self.decoder.feed(raw) + self.wait(0.05)

    def wait(self, seconds: float) -> list[MatrixPacket]:
        got = []
        for _ in range(round(seconds * 1000)):
            self.t_s += 1e-3
            got += self.decoder.feed(self.matrices.step(self.t_s))
        return got


def test_infos_are_reported() -> None:
    line = Line()
    assert line.send(0x01)[0].payload.hex() == "0000fa2300001022018000000040420f0000"
    assert line.send(0x02)[0].payload.hex() == "000001000000108a0c000000"
    (matrix,) = line.send(0x0B, "00")
    assert len(matrix.payload) == 52
    assert matrix.payload[10:14] == b"\x03\0\x02\0", "three columns, two rows"
    (absent,) = line.send(0x0B, "01")
    assert absent.payload[:2] == b"\x05\0"


def test_more_frames_than_its_clock_can_distinguish_are_refused() -> None:
    assert Line().send(0x03, "80 e9 03") == [MatrixPacket(0x03, b"\x05\0")]


def test_frames_come_row_by_row_until_they_are_stopped() -> None:
    line = Line()
    acknowledged, *frames = line.send(0x03, "80 64 00")
    assert acknowledged == MatrixPacket(0x03, b"\0\0")
    frames += line.wait(0.95)
    assert len(frames) == pytest.approx(100, abs=1)
    first, second = frames[0].payload, frames[1].payload
    assert first[5:].hex() == "0000f401e803dc05d007c409"
    assert first[4] == 0
    assert int.from_bytes(second[:4], "little") - int.from_bytes(first[:4], "little") == 10
    line.send(0x03, "00 00 00")
    assert line.wait(0.5) == []


def test_runs_are_encoded_when_asked_for() -> None:
    line = Line()
    line.send(0x13, "02 00 D0 07")
    frame = line.send(0x03, "81 64 00")[-1]
    assert frame.payload[4:].hex() == "010040d017c419"


def test_a_threshold_is_kept() -> None:
    line = Line()
    assert line.send(0x13, "02 00 96 00") == [MatrixPacket(0x13, b"\0\0")]
    assert line.send(0x14, "00") == [MatrixPacket(0x14, b"\0\0\x96\0")]


def test_at_power_up_it_makes_noise_and_is_deaf_for_eight_seconds() -> None:
    line = Line(booted=False)
    assert line.send(0x01) == []
    line.wait(7.9)
    assert line.decoder.noise == b"\x1b[5n" * 3
    assert line.send(0x01) == []
    line.wait(0.1)
    assert len(line.send(0x01)) == 1


def test_bytes_take_their_time_on_the_line() -> None:
    """18 + 8 bytes of ten bits at 9600 baud: 27 ms."""
    line = Line(baud=9600)
    request = encode_packet(MatrixPacket(0x01))
    assert line.matrices.receive(request, line.t_s) == b""
    assert line.matrices.step(line.t_s + 0.0270) == b""
    assert len(line.matrices.step(line.t_s + 0.0272)) == 26


def test_an_unknown_command_and_a_refused_one_are_answered_with_an_error() -> None:
    line = Line()
    assert line.send(0x55)[0].payload == b"\x0d\0"
    line.matrices.inject("refuse", line.t_s)
    assert line.send(0x03, "81 64 00") == [MatrixPacket(0x03, b"\x05\0")]
    assert line.wait(0.2) == []


def test_a_packet_with_a_wrong_crc_has_no_answer() -> None:
    line = Line()
    raw = bytearray(encode_packet(MatrixPacket(0x03, b"\x81\x64\0")))
    raw[-1] ^= 1
    assert line.matrices.receive(bytes(raw), line.t_s) == b""
    assert line.wait(0.1) == []


def test_texels_saturate_at_their_converters_ends() -> None:
    assert counts(np.array([-1.0, 0.0, 0.0004, 0.0016, 9.0, np.nan])).tolist() == [0, 0, 0, 2, 4095, 0]
    assert counts(np.array([0.149, 0.150]), threshold=150).tolist() == [0, 150]


def test_faults_it_does_not_know_are_refused() -> None:
    with pytest.raises(ValueError, match="matrices know no fault 'stall'"):
        Line().matrices.inject("stall", 50.0)
