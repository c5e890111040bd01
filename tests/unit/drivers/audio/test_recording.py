"""Recordings in the fingers' place: real files, real libsndfile."""

import struct
import subprocess
import sys
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import soundfile

from drivers.audio.driver import Audio, AudioSettings
from drivers.core.clock import VirtualClock, WallClock
from drivers.core.errors import DeviceError, PortError, ProtocolError
from drivers.core.messages import Chirp, Failed, Listen, Reached, SampleBlock, Sent, Status, Tone
from tests.refusals import refused

FINGERS = frozenset({"audio.fingers"})

FULL = 2**23


def sound(seconds: float = 1.0, level: float = 0.25, channels: int = 2) -> Any:
    """24-bit counts of a carrier with noise, shape (n, channels)."""
    frames = np.arange(round(seconds * 96_000))[:, None]
    wave = level * FULL * np.cos(2.0 * np.pi * 5.0 / 12.0 * frames + np.arange(channels))
    noise = np.random.default_rng(3).normal(0.0, 50.0, (len(frames), channels))
    return np.clip(np.rint(wave + noise), -FULL, FULL - 1).astype(np.int32)


def write(path: Path, counts: Any, subtype: str = "PCM_24", rate_hz: int = 96_000) -> Path:
    data = counts / FULL if subtype in ("FLOAT", "PCM_16") else counts << 8
    soundfile.write(path, data, rate_hz, subtype=subtype)
    return path


def audio(path: Path | str, **settings: Any) -> Audio:
    return Audio("audio", AudioSettings(port=f"file:{path}", **settings), WallClock())


def played(device: Audio) -> tuple[list[SampleBlock], list[Status]]:
    """All of a recording that nothing paces, up to its end."""
    device.open()
    device.apply(Listen("audio", FINGERS))
    blocks: list[SampleBlock] = []
    statuses: list[Status] = []
    for _ in range(1000):
        blocks += device.read()
        statuses += device.poll()
        if any(isinstance(status, Failed) for status in statuses):
            break
    device.close()
    return blocks, statuses


@pytest.mark.parametrize(
    ("name", "subtype"),
    [
        ("take.wav", "PCM_24"),
        ("take.flac", "PCM_24"),
        ("take.wav", "PCM_32"),
        ("take.wav", "FLOAT"),
        ("take.rf64", "PCM_24"),
    ],
)
def test_a_recording_is_played_to_the_last_bit(tmp_path: Path, name: str, subtype: str) -> None:
    counts = sound(1.01)
    blocks, statuses = played(audio(write(tmp_path / name, counts, subtype), paced=False))
    assert np.array_equal(np.concatenate([block.values for block in blocks]), counts)
    assert blocks[0].seq == 0
    for before, after in pairwise(blocks):
        assert after.seq == before.seq + len(before)
        assert after.t0_s - blocks[0].t0_s == pytest.approx(after.seq / 96_000, abs=2e-6)
    (failed,) = [status for status in statuses if isinstance(status, Failed)]
    assert failed.reason == "the recording has ended, after 1.01 s"


def test_a_paced_recording_plays_in_real_time_and_runs_on_without_a_subscriber(tmp_path: Path) -> None:
    clock = VirtualClock()
    device = Audio("audio", AudioSettings(port=f"file:{write(tmp_path / 'take.wav', sound(2.0))}"), clock)
    device.open()
    assert device.read() == []
    device.apply(Listen("audio", FINGERS))
    first = []
    for turn in range(1, 61):
        clock.wait_until(turn * 0.005)
        first += device.read()
    device.apply(Listen("audio", frozenset()))
    clock.wait_until(0.5)
    assert device.read() == []
    device.apply(Listen("audio", FINGERS))
    clock.wait_until(0.55)
    again = device.read()
    device.close()
    packet = max(len(block) for block in first)
    assert first[0].seq == 0
    assert 0.3 * 96_000 - packet <= sum(map(len, first)) <= 0.3 * 96_000
    rounding_s = 1e-9
    assert all(block.last_s - rounding_s <= block.arrival_s <= clock.now() for block in first)
    assert abs(again[0].seq - 0.5 * 96_000) <= packet
    assert again[0].t0_s - first[0].t0_s == pytest.approx(again[0].seq / 96_000, abs=1e-5)


def test_a_drive_stands_in_the_recording_and_a_sweep_takes_its_time(tmp_path: Path) -> None:
    device = audio(write(tmp_path / "take.wav", sound(1.0)), paced=False)
    assert device.open().details["drive"] == "as recorded"
    device.apply(Tone("audio", 40_000.0, 0.5))
    device.apply(Chirp("audio", 20_000.0, 46_000.0, 0.5, 0.5))
    device.apply(Listen("audio", FINGERS))
    statuses: list[Status] = []
    blocks: list[SampleBlock] = []
    for _ in range(4):
        blocks += device.read()
        statuses += device.poll()
    assert [type(status.command) for status in statuses if isinstance(status, Sent)] == [Tone, Chirp, Listen]
    (reached,) = [status for status in statuses if isinstance(status, Reached)]
    assert reached.t_s - blocks[0].t0_s == pytest.approx(0.5, abs=1e-4)


def bad(tmp_path: Path, kind: str) -> Path:
    """A file of a bad kind."""
    path = tmp_path / "take.wav"
    counts = sound(0.5)
    if kind == "absent":
        return path
    if kind == "text":
        path.write_text("no sound at all, but a few lines of text, and some more of them")
    elif kind == "mono":
        write(path, counts[:, :1])
    elif kind == "44.1 kHz":
        write(path, counts, rate_hz=44_100)
    elif kind == "16 bit":
        write(path, counts, "PCM_16")
    elif kind == "cut flac":
        path = write(tmp_path / "take.flac", counts)
        path.write_bytes(path.read_bytes()[:-20_000])
    elif kind == "cut rf64":
        path = write(tmp_path / "take.rf64", counts)
        path.write_bytes(path.read_bytes()[:-20_000])
    else:
        whole = write(path, counts).read_bytes()
        path.write_bytes(whole[: 30 if kind == "cut header" else len(whole) // 2])
    return path


@pytest.mark.parametrize(
    ("kind", "error", "named"),
    [
        ("absent", PortError, "there is no such file while opening {path}"),
        ("text", ProtocolError, "it is cut off or no sound (Format not recognised) while opening {path}"),
        ("mono", ProtocolError, "the recording take.wav has 1 channel where two fingers need 2"),
        ("44.1 kHz", ProtocolError, "the recording take.wav has 44100 frames a second, not 96000"),
        ("16 bit", ProtocolError, "the recording take.wav has 16 bits a sample, not 24"),
        ("cut header", ProtocolError, "it is cut off or no sound ("),
        ("cut data", ProtocolError, "it is cut off: 144022 of 288043 bytes are there while opening {path}"),
        ("cut flac", ProtocolError, "it is cut off: 0.50 s are promised, and its end is not there"),
        ("cut rf64", ProtocolError, "it is cut off: "),
    ],
)
def test_bad_sound_gets_one_clear_line(
    tmp_path: Path, kind: str, error: type[DeviceError], named: str
) -> None:
    path = bad(tmp_path, kind)
    with refused(error, "audio: ", named.format(path=path)):
        audio(path).open()


def test_a_recording_without_a_length_in_its_header_is_played_as_far_as_it_goes(tmp_path: Path) -> None:
    path = write(tmp_path / "take.wav", sound(0.5))
    data = bytearray(path.read_bytes())
    # A recorder that was killed has not come back to write them.
    data[4:8] = struct.pack("<I", 0)
    path.write_bytes(data)
    blocks, _ = played(audio(path, paced=False))
    assert sum(map(len, blocks)) == 48_000


@pytest.mark.parametrize("port", ["/dev/ttyUSB0", "soundcard:USB", "wav:take.wav", "emulated"])
def test_a_port_of_no_known_kind_gets_one_clear_line(port: str) -> None:
    with refused(PortError, "audio: ", f"{port} is no source of sound", "write port"):
        Audio("audio", AudioSettings(port=port), WallClock()).open()


def test_what_a_port_does_not_need_is_not_imported() -> None:
    unneeded = "{'soundfile', 'sounddevice', 'drivers.audio.network', 'scipy', 'numba'}"
    asked = f"import sys, drivers.audio.driver; print(sorted({unneeded} & set(sys.modules)))"
    done = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
