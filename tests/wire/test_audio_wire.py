"""The real audio driver over TCP, an emulated recorder at its far end: bounded traffic, servers that stop."""

import socket
import threading
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.audio.driver import Audio, AudioSettings
from drivers.core.clock import WallClock
from drivers.core.errors import DeviceError, PortError, ProtocolError, SilentError
from drivers.core.messages import Failed, Lost, Refused, SampleBlock
from simulator.devices.audio import EmulatedAudio
from simulator.devices.faults import Fault, FaultSchedule
from simulator.wiring.far_ends import TcpLine
from tests.contracts.audio_suite import FINGERS, TONE, AudioContract, AudioTrial, SteadyFingers

PATIENT = {"reply_timeout_s": 5.0, "silence_timeout_s": 5.0}
"""The machine may be busy with other tests."""


class Server:
    """An emulated recorder on a port of its own."""

    def __init__(self, serve: Any) -> None:
        self.recorder = EmulatedAudio(SteadyFingers())
        self.faults = FaultSchedule()
        self.port = serve.wire(TcpLine(self.recorder), self.faults)
        self.lock, self.clock = serve.lock(self.port), serve.clock

    def fault(self, kind: str, for_s: float | None = None) -> None:
        with self.lock:
            self.faults.add(Fault(device="audio", kind=kind, at_s=self.clock.monotonic_s(), for_s=for_s))


@pytest.fixture
def connect(serve: Any) -> Iterator[Callable[..., AudioTrial]]:
    devices: list[Audio] = []

    def made(port: str, **settings: Any) -> AudioTrial:
        given = AudioSettings(port=port, **{**PATIENT, "look_s": 0.05, **settings})
        devices.append(Audio("audio", given, serve.clock))
        return AudioTrial(devices[-1], serve.clock)

    yield made
    for device in devices:
        device.close()


@pytest.fixture
def server(serve: Any) -> Server:
    return Server(serve)


@pytest.fixture
def bench(server: Server, connect: Callable[..., AudioTrial]) -> AudioTrial:
    return connect(server.port)


class TestWireAudio(AudioContract):
    pass


def gaps(blocks: list[SampleBlock]) -> int:
    return sum(after.seq - before.seq - len(before) for before, after in pairwise(blocks))


def test_frames_are_counted_beyond_32_bits(bench: AudioTrial) -> None:
    bench.listen(FINGERS)
    bench.record(4800)
    assert bench.blocks[0].seq > 2**32


def test_what_the_fault_lose_takes_is_counted_exactly(server: Server, bench: AudioTrial) -> None:
    bench.listen(FINGERS)
    bench.record(4800)
    server.fault("lose", for_s=0.3)
    bench.turn(0.8)
    assert server.recorder.dropped >= 0.2 * 96_000
    assert sum(one.samples for one in bench.of(Lost)) == server.recorder.dropped
    assert gaps(bench.blocks) == server.recorder.dropped == bench.device.account()["frames_lost"]
    assert bench.of(Failed) == []


def test_a_refused_drive_is_reported(server: Server, bench: AudioTrial) -> None:
    with server.lock:
        server.recorder.inject("refuse", server.clock.monotonic_s())
    bench.device.apply(TONE)
    refused = bench.until(Refused)
    assert refused.command == TONE
    assert "its amplifier is off" in refused.reason


def test_a_second_host_is_hung_up_on(server: Server, bench: AudioTrial) -> None:
    hung_up = r"(socket disconnected|reset by peer)\) while connecting to .*no other host connected"
    with pytest.raises(ProtocolError, match=hung_up):
        Audio("audio", AudioSettings(port=server.port), server.clock).open()
    bench.listen(FINGERS)
    bench.record(4800)
    assert bench.blocks


def test_it_can_be_opened_again_and_the_drive_is_silent(server: Server, bench: AudioTrial) -> None:
    bench.device.apply(TONE)
    bench.turn(0.05)
    bench.device.close()
    bench.clock.rest(0.1)
    bench.device.open()
    bench.listen(FINGERS)
    bench.record(9600)
    assert max(np.abs(block.values).max() for block in bench.blocks) <= 50


class Other:
    """A server that answers its client with something else, or with nothing."""

    def __init__(self, sends: bytes) -> None:
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = "tcp:{}:{}".format(*self._listener.getsockname())
        self._sends = sends
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        connection, _ = self._listener.accept()
        connection.settimeout(60.0)
        connection.recv(100)
        connection.sendall(self._sends)
        while connection.recv(100):
            pass
        connection.close()
        self._listener.close()


@pytest.mark.parametrize(
    ("sends", "patience_s", "error", "message"),
    [
        (b"HTTP/1.1 400\r\n\r\n", 20.0, ProtocolError, "a frame begins with b'TBA1', not with b'HTTP'"),
        (b"", 0.3, SilentError, "it does not answer in 2 s"),
    ],
)
def test_what_is_no_recorder_is_not_opened(
    sends: bytes, patience_s: float, error: type[DeviceError], message: str
) -> None:
    with pytest.raises(error, match=message):
        Audio("audio", AudioSettings(port=Other(sends).port, reply_timeout_s=patience_s), WallClock()).open()


@pytest.mark.parametrize(
    ("port", "message"),
    [
        ("tcp:127.0.0.1:1", r"127.0.0.1:1 cannot be opened .*Connection refused.*is that host up"),
        ("tcp:127.0.0.1", "it is no address"),
        ("tcp:127.0.0.1:99999", "it is no address"),
    ],
)
def test_an_address_without_a_recorder_is_a_port_error(port: str, message: str) -> None:
    with pytest.raises(PortError, match=message) as error:
        Audio("audio", AudioSettings(port=port), WallClock()).open()
    assert "\n" not in str(error.value)
