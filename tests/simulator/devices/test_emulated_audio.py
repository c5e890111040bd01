"""The emulated recorder by itself: bytes in, bytes out, at times of the test's choice."""

from typing import Any

import numpy as np
import pytest

from drivers.audio.codec import FrameDecoder, Sound, SoundMessage, encode_line
from simulator.devices.audio import EmulatedAudio
from tests.contracts.audio_suite import GAINS, SteadyFingers


class Host:
    """Sends commands to a recorder, and keeps all that it sends."""

    def __init__(self, **settings: Any) -> None:
        self.bench = SteadyFingers()
        self.recorder = EmulatedAudio(self.bench, **settings)
        self.decoder = FrameDecoder()
        self.sound: list[Sound] = []
        self.messages: list[SoundMessage] = []

    def receive(self, data: bytes) -> None:
        for frame in self.decoder.feed(data):
            (self.sound if isinstance(frame, Sound) else self.messages).append(frame)  # type: ignore[arg-type]

    def send(self, t_s: float, **command: Any) -> None:
        self.receive(self.recorder.receive(encode_line(command), t_s))

    def run(self, until_s: float, step_s: float) -> None:
        t_s = self.bench.t_s
        while t_s < until_s:
            t_s = min(until_s, t_s + step_s)
            self.receive(self.recorder.step(t_s))

    @property
    def counts(self) -> Any:
        return np.concatenate([sound.counts for sound in self.sound])


def test_it_sends_the_same_however_often_it_is_stepped() -> None:
    recordings = []
    for step_s in (0.001, 0.02, 0.7):
        host = Host()
        host.send(0.1, do="start", tag=1)
        host.send(0.2, do="tone", frequency_hz=40_000.0, level=0.5, tag=2)
        host.run(1.0, step_s)
        recordings.append((host.sound[0].frame, host.counts))
    assert len({frame for frame, _ in recordings}) == 1
    assert all(np.array_equal(recordings[0][1], counts) for _, counts in recordings)
    assert len(recordings[0][1]) == pytest.approx(0.9 * 96_000, abs=480)


@pytest.mark.parametrize("drift_ppm", [-200.0, 0.0, 200.0])
def test_its_counter_runs_on_its_own_clock_and_a_tones_phase_by_its_counter(drift_ppm: float) -> None:
    host = Host(drift_ppm=drift_ppm)
    host.send(0.0, do="tone", frequency_hz=39_123.457, level=1.0 / 2.0, tag=1)
    host.send(10.0, do="start", tag=2)
    host.run(10.1, 0.001)
    assert host.messages[-1].frame - 45 * 96_000_000 == pytest.approx(
        960_000 * (1.0 + drift_ppm * 1e-6), abs=1
    )
    frames = host.sound[0].frame % 96_000_000 + np.arange(len(host.counts))
    turns = 39_123.457 * frames / 96_000.0 % 1.0
    found = 2.0 * (host.counts / 2**23 * np.exp(-2j * np.pi * turns)[:, None]).mean(axis=0)
    assert found == pytest.approx(0.5 * np.array(GAINS), abs=1e-4)


def test_what_is_lossy_is_counted_and_the_counter_goes_on() -> None:
    host = Host(drift_ppm=0.0)
    host.send(0.0, do="start", tag=1)
    host.run(0.1, 0.001)
    host.recorder.lossy = True
    host.run(0.2, 0.001)
    host.recorder.lossy = False
    host.run(0.3, 0.001)
    first, last = host.sound[0], host.sound[-1]
    sent = sum(len(sound.counts) for sound in host.sound)
    assert host.recorder.dropped == 20 * 480
    assert last.frame + len(last.counts) - first.frame == sent + host.recorder.dropped


@pytest.mark.parametrize(
    ("line", "why"),
    [
        (b"HELLO\n", "no JSON"),
        (b"[1]\n", "no JSON object"),
        (b'{"do":"dance","tag":9}\n', "there is no dance; there are hello, start"),
        (b'{"do":"tone","tag":9}\n', "tone: KeyError 'frequency_hz'"),
        (b'{"do":"tone","frequency_hz":"high","level":0.5,"tag":9}\n', "tone: ValueError"),
        (b'{"do":"tone","frequency_hz":NaN,"level":0.5,"tag":9}\n', "tone: ValueError"),
        (b'{"do":"chirp","from_hz":null,"tag":9}\n', "chirp: TypeError"),
        (b'{"do":' + b"[" * 200_000 + b"]" * 200_000 + b"}\n", "no JSON"),
        (b'{"do":[[]],"tag":[[]]}\n', "there is no list"),
    ],
)
def test_what_it_does_not_understand_it_refuses(line: bytes, why: str) -> None:
    host = Host()
    host.receive(host.recorder.receive(line, 0.0))
    assert why in str(host.messages[0].content["refused"])


def test_lines_may_come_in_pieces() -> None:
    host = Host()
    line = encode_line({"do": "hello", "tag": 7})
    for at, byte in enumerate(line):
        host.receive(host.recorder.receive(bytes([byte]), at * 1e-4))
    assert host.messages[0].content["reply"] == 7
    assert host.messages[0].content["channels"] == 2


def test_a_host_that_is_gone_leaves_silence() -> None:
    host = Host()
    host.send(0.0, do="start", tag=1)
    host.send(0.0, do="tone", frequency_hz=40_000.0, level=0.5, tag=2)
    host.recorder.hang_up(0.1)
    assert host.recorder.step(0.2) == b""
    host.send(0.3, do="start", tag=1)
    host.sound.clear()
    host.run(0.4, 0.001)
    assert np.abs(host.counts).max() <= 50


def test_a_sweep_is_reported_at_its_end() -> None:
    host = Host(drift_ppm=0.0)
    host.send(1.0, do="chirp", from_hz=20e3, to_hz=40e3, duration_s=0.5, level=0.5, tag=1)
    host.run(1.499, 0.001)
    assert [message.content for message in host.messages] == [{"reply": 1}]
    host.run(1.51, 0.001)
    assert host.messages[-1].content == {"event": "swept"}
    assert host.messages[-1].frame - 45 * 96_000_000 == 144_000
