"""The sound card's driver against a stand-in for PortAudio: none can be had without the hardware."""

from __future__ import annotations

import sys
import threading
import time
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from drivers.audio.driver import Audio, AudioSettings
from drivers.audio.oscillator import ToneWave
from drivers.clock import WallClock
from drivers.errors import PortError, ProtocolError
from drivers.messages import Chirp, Excite, Failed, Listen, Lost, Reached, Refused, Tone

RATE_HZ = 96_000

CARDS = [
    {"index": 0, "name": "HDA Intel: Analog", "max_input_channels": 2, "max_output_channels": 2},
    {"index": 1, "name": "HDMI", "max_input_channels": 0, "max_output_channels": 8},
    {"index": 2, "name": "USB Audio 24", "max_input_channels": 2, "max_output_channels": 2},
    {"index": 3, "name": "USB Audio 24 loopback", "max_input_channels": 2, "max_output_channels": 0},
]


class PortAudioError(Exception):
    pass


class Stream:
    """What a stream is told, and a hand to call its callback with."""

    opened: ClassVar[list[Stream]] = []

    def __init__(
        self, *, samplerate: int, dtype: str, callback: Any, finished_callback: Any, **rest: Any
    ) -> None:
        if rest["device"] == 0:
            raise PortAudioError("Invalid sample rate [PaErrorCode -9997]", -9997)
        assert (samplerate, dtype) == (RATE_HZ, "int32")
        self.samplerate, self.settings = samplerate, rest
        self.callback, self.finished = callback, finished_callback
        self.adc_s = 100.0
        self.running = False
        Stream.opened.append(self)

    def start(self) -> None:
        self.running = True

    def abort(self, ignore_errors: bool) -> None:
        self.running = False
        self.finished()

    def close(self, ignore_errors: bool) -> None: ...

    def buffer(self, counts: Any, missing: int = 0) -> Any:
        """Hand over a buffer of 24-bit counts, and take one of the drive, in full scales; `missing` were overrun."""
        n = len(counts)
        self.adc_s += missing / RATE_HZ
        stamp = SimpleNamespace(inputBufferAdcTime=self.adc_s)
        status = SimpleNamespace(input_overflow=missing > 0)
        indata = (counts << 8).astype(np.int32)
        self.adc_s += n / RATE_HZ
        if isinstance(self, InputStream):
            self.callback(indata, n, stamp, status)
            return None
        outdata = np.full((n, 2), 7, np.int32)
        self.callback(indata, outdata, n, stamp, status)
        return outdata / 2.0**31


class InputStream(Stream):
    pass


@pytest.fixture
def portaudio(monkeypatch: pytest.MonkeyPatch) -> Any:
    module: Any = ModuleType("sounddevice")
    module.query_devices = lambda: CARDS
    module.default = SimpleNamespace(device=(2, 2))
    module.Stream, module.InputStream, module.PortAudioError = Stream, InputStream, PortAudioError
    module.get_portaudio_version = lambda: (1246720, "PortAudio V19.7.0-devel")
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    Stream.opened = []
    return module


def audio(name: str, **settings: Any) -> Audio:
    return Audio(
        "audio", AudioSettings(port=f"sounddevice:{name}", **{"look_s": 0.0, **settings}), WallClock()
    )


def sound(n: int, seed: int = 1) -> Any:
    return np.random.default_rng(seed).integers(-(2**20), 2**20, (n, 2)).astype(np.int32)


def listening(name: str = "USB Audio 24") -> tuple[Audio, Stream]:
    device = audio(name)
    device.open()
    device.apply(Listen("audio", frozenset({"audio.fingers"})))
    return device, Stream.opened[-1]


@pytest.mark.usefixtures("portaudio")
def test_counts_come_to_the_last_bit_with_their_frames() -> None:
    device, stream = listening()
    first, second = sound(480), sound(480, 2)
    stream.buffer(first)
    stream.buffer(second)
    blocks = device.read()
    assert [block.seq for block in blocks] == [0, 480]
    assert np.array_equal(np.concatenate([block.values for block in blocks]), np.concatenate([first, second]))
    device.close()
    assert not [one for one in device.poll() if isinstance(one, Failed)]


@pytest.mark.usefixtures("portaudio")
def test_an_overrun_is_lost_frames_by_the_cards_own_time() -> None:
    device, stream = listening()
    stream.buffer(sound(480))
    stream.buffer(sound(480), missing=1234)
    blocks = device.read()
    assert [block.seq for block in blocks] == [0, 480 + 1234]
    assert [lost.samples for lost in device.poll() if isinstance(lost, Lost)] == [1234]
    assert device.account()["overruns"] == 1
    assert device.account()["frames_lost"] == 1234
    device.close()


@pytest.mark.usefixtures("portaudio")
def test_a_queue_that_nobody_empties_loses_its_oldest_and_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.audio.soundcard.WAITING_PACKETS", 10)
    device, stream = listening()
    stream.buffer(sound(480))
    device.read()
    for _ in range(25):
        stream.buffer(sound(480))
    blocks = device.read()
    assert sum(map(len, blocks)) == 10 * 480
    assert [lost.samples for lost in device.poll() if isinstance(lost, Lost)] == [15 * 480]
    device.close()


@pytest.mark.usefixtures("portaudio")
def test_the_drive_is_locked_to_the_frames() -> None:
    device, stream = listening()
    assert not stream.buffer(sound(480)).any()
    device.apply(Tone("audio", 40_000.0, 0.5))
    out = [stream.buffer(sound(480)), stream.buffer(sound(333))]
    out.append(stream.buffer(sound(480), missing=100))
    expected = ToneWave(40_000.0, 0.5)
    for wave, first in zip(out, (480, 960, 960 + 333 + 100), strict=True):
        assert wave == pytest.approx(np.repeat(expected.at(first, len(wave))[:, None], 2, axis=1), abs=3e-7)
    device.apply(Excite("audio", False))
    assert not stream.buffer(sound(480)).any()
    device.close()


@pytest.mark.usefixtures("portaudio")
def test_a_chirp_is_told_when_it_is_over() -> None:
    device, stream = listening()
    device.apply(Chirp("audio", 20_000.0, 46_000.0, 0.01, 1.0))
    first = stream.buffer(sound(480))
    assert np.abs(first).max() == pytest.approx(1.0, abs=1e-6)
    device.read()
    assert not [one for one in device.poll() if isinstance(one, Reached)]
    stream.buffer(sound(480))
    assert not stream.buffer(sound(480)).any()
    device.read()
    assert len([one for one in device.poll() if isinstance(one, Reached)]) == 1
    device.close()


@pytest.mark.usefixtures("portaudio")
def test_a_card_without_output_listens_and_refuses_to_drive() -> None:
    device, stream = listening("USB Audio 24 loopback")
    assert isinstance(stream, InputStream)
    stream.buffer(sound(480))
    assert len(device.read()) == 1
    device.apply(Tone("audio", 40_000.0, 0.5))
    device.read()
    (refused,) = [one for one in device.poll() if isinstance(one, Refused)]
    assert refused.reason == "the sound card has no output"
    device.close()


@pytest.mark.usefixtures("portaudio")
def test_a_card_that_is_pulled_out_has_failed() -> None:
    device, stream = listening()
    stream.finished()
    device.read()
    (failed,) = [one for one in device.poll() if isinstance(one, Failed)]
    assert failed.reason == "the sound card is gone"
    device.close()


@pytest.mark.usefixtures("portaudio")
def test_the_systems_own_choice_and_an_exact_name_are_taken() -> None:
    assert audio("").open().model == "USB Audio 24"
    assert audio("USB Audio 24").open().model == "USB Audio 24"
    assert audio("loop").open().model == "USB Audio 24 loopback"


@pytest.mark.usefixtures("portaudio")
@pytest.mark.parametrize(
    ("name", "line"),
    [
        (
            "Scarlett",
            "audio: no input is called Scarlett while choosing the sound card; there are: HDA Intel: Analog, "
            "USB Audio 24, USB Audio 24 loopback",
        ),
        (
            "USB",
            "audio: 2 inputs are called so: USB Audio 24, USB Audio 24 loopback while choosing the sound card; "
            "write more of the name",
        ),
        (
            "HDA",
            "audio: HDA Intel: Analog does not open at 96000 Hz (Invalid sample rate [PaErrorCode -9997]) while "
            "opening the sound card; is it held by another program, and can it do 96 kHz?",
        ),
    ],
)
def test_a_card_that_is_not_to_be_had_gets_one_clear_line(name: str, line: str) -> None:
    with pytest.raises(PortError) as error:
        audio(name).open()
    assert str(error.value) == line


def test_no_card_at_all_is_said_to_be_none(portaudio: Any) -> None:
    portaudio.query_devices = list
    with pytest.raises(PortError, match=r"no input is called USB .*; there are: none$"):
        audio("USB").open()


def test_a_missing_sounddevice_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with pytest.raises(
        PortError, match=r"^audio: it is not installed while loading sounddevice; .*requirements/sound\.txt$"
    ):
        audio("USB").open()


def test_a_missing_portaudio_says_how_to_install_it(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sounddevice.py").write_text('raise OSError("PortAudio library not found")\n')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    with pytest.raises(PortError, match=r"^audio: PortAudio is missing .*apt install libportaudio2$"):
        audio("USB").open()


def test_a_card_that_hears_nothing_is_refused(portaudio: Any) -> None:
    class Live(Stream):
        """A card that runs by itself, with nothing at its input."""

        def start(self) -> None:
            super().start()
            threading.Thread(target=self.run, daemon=True).start()

        def run(self) -> None:
            while self.running:
                self.buffer(np.zeros((480, 2), np.int32))
                time.sleep(0.001)

    portaudio.Stream = Live
    with pytest.raises(ProtocolError, match=r"the right finger is silent: nothing has moved in 0\.[12]"):
        audio("USB Audio 24", look_s=0.1).open()
    assert not Stream.opened[-1].running
