"""The sound card's driver against a stand-in for PortAudio: none can be had without the hardware."""

import sys
from collections.abc import Iterator
from types import ModuleType, SimpleNamespace
from typing import Any, ClassVar

import numpy as np
import pytest

from behaviors.events import Contact
from controller.detectors.level import LevelDetector, LevelSettings
from controller.signals.iq import Iq, IqSettings
from drivers.audio.driver import Audio, AudioSettings
from drivers.audio.oscillator import tone
from drivers.audio.soundcard import SoundCard
from drivers.audio.source import Swept
from drivers.core.clock import WallClock
from drivers.core.errors import PortError
from drivers.core.messages import (
    Chirp,
    Excite,
    Failed,
    Listen,
    Lost,
    Reached,
    Refused,
    SampleBlock,
    Status,
    Tone,
)
from tests.refusals import refused

RATE_HZ = 96_000
ROUND_TRIP = 2400  # frames from the card's output to its input, as it reports itself

CARDS = [
    {"index": 0, "name": "HDA Intel: Analog", "max_input_channels": 2, "max_output_channels": 2},
    {"index": 1, "name": "HDMI", "max_input_channels": 0, "max_output_channels": 8},
    {"index": 2, "name": "USB Audio 24", "max_input_channels": 2, "max_output_channels": 2},
    {"index": 3, "name": "USB Audio 24 loopback", "max_input_channels": 2, "max_output_channels": 0},
]


class PortAudioError(Exception):
    pass


class Stream:
    """A stream's arguments, and a way to call its callback."""

    opened: ClassVar[list[Any]] = []

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

    def buffer(self, counts: Any, missing: int = 0, *flags: str) -> Any:
        """Hand over a buffer of 24-bit counts, and take one of the drive, in full scales; `missing` were overrun."""
        n = len(counts)
        self.adc_s += missing / RATE_HZ
        stamp = SimpleNamespace(
            inputBufferAdcTime=self.adc_s, outputBufferDacTime=self.adc_s + ROUND_TRIP / RATE_HZ
        )
        names = ("input_underflow", "input_overflow", "output_underflow", "output_overflow")
        status = SimpleNamespace(**{name: name in flags for name in names})
        status.input_overflow |= missing > 0
        indata = (counts << 8).astype(np.int32)
        self.adc_s += n / RATE_HZ
        if isinstance(self, InputStream):
            self.callback(indata, n, stamp, status)
            return None
        outdata = np.full((n, self.settings["channels"][1]), 7, np.int32)
        self.callback(indata, outdata, n, stamp, status)
        return outdata / 2.0**31


class InputStream(Stream):
    pass


@pytest.fixture(autouse=True)
def portaudio(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    module: Any = ModuleType("sounddevice")
    module.query_devices = lambda: CARDS
    module.default = SimpleNamespace(device=(2, 2))
    module.Stream, module.InputStream, module.PortAudioError = Stream, InputStream, PortAudioError
    module.get_portaudio_version = lambda: (1246720, "PortAudio V19.7.0-devel")
    monkeypatch.setitem(sys.modules, "sounddevice", module)
    Stream.opened = []
    yield module
    for stream in Stream.opened:
        stream.running = False


def audio(name: str, **settings: Any) -> Audio:
    return Audio(
        "audio", AudioSettings(port=f"sounddevice:{name}", **{"look_s": 0.0, **settings}), WallClock()
    )


def sound(n: int, seed: int = 1) -> Any:
    return np.random.default_rng(seed).integers(-(2**20), 2**20, (n, 2)).astype(np.int32)


def reported(device: Audio, kind: type[Status]) -> list[Any]:
    return [status for status in device.poll() if isinstance(status, kind)]


def listening(name: str = "USB Audio 24", **settings: Any) -> tuple[Audio, Stream]:
    device = audio(name, **settings)
    device.open()
    device.apply(Listen("audio", frozenset({"audio.fingers"})))
    return device, Stream.opened[-1]


def test_counts_come_to_the_last_bit_with_their_frames() -> None:
    device, stream = listening()
    first, second = sound(480), sound(480, 2)
    stream.buffer(first)
    stream.buffer(second)
    blocks = device.read()
    assert [block.seq for block in blocks] == [0, 480]
    assert np.array_equal(np.concatenate([block.values for block in blocks]), np.concatenate([first, second]))
    device.close()
    assert not reported(device, Failed)


def test_an_overrun_of_a_card_without_output_is_lost_frames_by_the_cards_own_time() -> None:
    device, stream = listening("USB Audio 24 loopback")
    stream.buffer(sound(480))
    stream.buffer(sound(480), missing=1234)
    blocks = device.read()
    assert [block.seq for block in blocks] == [0, 480 + 1234]
    assert [lost.samples for lost in reported(device, Lost)] == [1234]
    assert device.account()["overruns"] == 1
    assert device.account()["frames_lost"] == 1234


@pytest.mark.parametrize("name", ["USB Audio 24", "USB Audio 24 loopback"])
def test_input_that_portaudio_made_up_is_not_handed_out(name: str) -> None:
    device, stream = listening(name)
    stream.buffer(sound(480))
    stream.buffer(np.zeros((480, 2), np.int32), 0, "input_underflow")
    for _ in range(20):
        stream.buffer(sound(480))
    blocks = device.read()
    assert all(block.values.any(axis=1).all() for block in blocks)
    (lost,) = reported(device, Lost)
    assert lost.samples >= 480


@pytest.mark.parametrize("flag", ["output_underflow", "output_overflow", "input_overflow"])
@pytest.mark.parametrize("latency_s", [0.005, 0.02])
def test_whatever_the_card_loses_leaves_out_the_input_until_the_drive_is_back(
    flag: str, latency_s: float
) -> None:
    device, stream = listening("USB Audio 24", latency_s=latency_s)
    stream.buffer(sound(480))
    missing = 7 if flag == "input_overflow" else 0
    counts = [sound(480, seed) for seed in range(20)]
    stream.buffer(counts[0], missing, flag)
    for one in counts[1:]:
        stream.buffer(one)
    # the round trip that the card reports, or twice the buffering that it was asked for, whichever is longer
    doubtful = max(ROUND_TRIP, round(2 * latency_s * RATE_HZ))
    first, *rest = device.read()
    assert (first.seq, len(first)) == (0, 480)
    assert rest[0].seq == 480 + missing + doubtful
    assert np.array_equal(np.concatenate([block.values for block in rest]), np.concatenate(counts)[doubtful:])
    assert [lost.samples for lost in reported(device, Lost)] == [missing + doubtful]
    account = device.account()
    assert (account["overruns"], account["underruns"]) == ((1, 0) if missing else (0, 1))


def test_a_queue_that_is_not_emptied_loses_its_oldest_and_reports_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("drivers.audio.soundcard.WAITING_PACKETS", 10)
    device, stream = listening()
    stream.buffer(sound(480))
    device.read()
    for _ in range(25):
        stream.buffer(sound(480))
    blocks = device.read()
    assert sum(map(len, blocks)) == 10 * 480
    assert [lost.samples for lost in reported(device, Lost)] == [15 * 480]


def test_the_drive_is_locked_to_the_frames_and_goes_on_without_a_step_whatever_is_lost() -> None:
    device, stream = listening()
    assert not stream.buffer(sound(480)).any()
    device.apply(Tone("audio", 40_000.0, 0.5))
    out = [stream.buffer(sound(480)), stream.buffer(sound(333))]
    # the card plays buffer after buffer: frames of input that were not taken leave no gap in the output
    out.append(stream.buffer(sound(480), missing=100))
    out.append(stream.buffer(sound(480), 0, "output_underflow"))
    for wave, first in zip(out, (480, 960, 960 + 333, 960 + 333 + 480), strict=True):
        assert wave == pytest.approx(
            np.repeat(tone(first, len(wave), 40_000.0, 0.5)[:, None], 2, axis=1), abs=3e-7
        )
    device.apply(Excite("audio", False))
    assert not stream.buffer(sound(480)).any()


class Finger:
    """What is played comes back, weaker and later, with noise; the card may drop frames on either way."""

    LEVEL = 0.2

    def __init__(self, stream: Stream) -> None:
        self.stream = stream
        self.line = np.zeros(ROUND_TRIP)
        self.share = self.LEVEL
        self.rng = np.random.default_rng(3)

    def run(self, seconds: float, missing: int = 0, *flags: str) -> None:
        """Buffers of 5 ms; of the first one the card reports a loss before it."""
        self.line = self.line[missing:]
        for k in range(round(seconds * RATE_HZ / 480)):
            input_, self.line = self.line[:480], self.line[480:]
            counts = np.rint((self.share * input_ + 1e-4 * self.rng.standard_normal(480)) * 2**23)
            given = np.column_stack([counts, counts]).astype(np.int32)
            played = self.stream.buffer(given, 0 if k else missing, *(() if k else flags))
            self.line = np.concatenate([self.line, played[:, 0]])

    def slip(self, frames: int) -> None:
        """The output ran dry: so many frames of silence were played before what is to come."""
        self.line = np.concatenate([self.line, np.zeros(frames)])


def driven() -> tuple[Audio, Finger]:
    """A finger whose tone has come back already."""
    device, stream = listening()
    device.apply(Tone("audio", 40_000.0, 1.0))
    finger = Finger(stream)
    finger.run(0.1)
    device.read()
    return device, finger


def envelope(device: Audio) -> list[SampleBlock]:
    signal = Iq("right", IqSettings())
    made = [thing for block in device.read() for thing in signal.push(block)]
    return [block for block in made if isinstance(block, SampleBlock)]


def contacts(blocks: list[SampleBlock]) -> list[float]:
    detector = LevelDetector("touch", LevelSettings())
    return [event.t_s for block in blocks for event in detector.push(block) if isinstance(event, Contact)]


@pytest.mark.parametrize("slip", [1, 2, 5, 50, 480])
def test_output_that_ran_dry_turns_the_phase_and_reads_as_no_contact(slip: int) -> None:
    device, finger = driven()
    finger.run(1.5)
    finger.slip(slip)
    finger.run(1.5, 0, "output_underflow")
    blocks = envelope(device)
    z = np.concatenate([block.physical for block in blocks]).view(np.complex128)[:, 0]
    before, after = np.mean(z[200:1000]), np.mean(z[-1000:])
    assert abs(before) == pytest.approx(finger.LEVEL, rel=1e-3)
    turned = np.angle(after / before * np.exp(2j * np.pi * 5 / 12 * slip))
    assert turned == pytest.approx(0.0, abs=1e-3)
    assert not contacts(blocks)


def test_the_same_slip_without_a_report_of_the_card_reads_as_contact() -> None:
    device, finger = driven()
    finger.run(1.5)
    finger.slip(1)
    finger.run(1.5)
    assert contacts(envelope(device))


@pytest.mark.parametrize("slip", [0, 1, 6])
def test_a_contact_after_a_loss_is_seen(slip: int) -> None:
    device, finger = driven()
    finger.run(1.5)
    finger.slip(slip)
    finger.run(1.5, 0, "output_underflow")
    finger.share = 1.1 * finger.LEVEL
    finger.run(1.0)
    assert len(contacts(envelope(device))) == 1


def test_lost_input_turns_nothing_where_the_card_knows_how_much_it_was() -> None:
    device, finger = driven()
    finger.run(1.5)
    finger.run(1.5, 101, "input_overflow")
    blocks = envelope(device)
    z = np.concatenate([block.physical for block in blocks]).view(np.complex128)[:, 0]
    assert np.angle(np.mean(z[-1000:]) / np.mean(z[200:1000])) == pytest.approx(0.0, abs=1e-3)
    assert not contacts(blocks)


@pytest.mark.parametrize("missing", [0, 77])
def test_a_chirp_ends_with_the_frame_at_which_its_end_arrives(missing: int) -> None:
    card = SoundCard("audio", AudioSettings(port="sounddevice:USB Audio 24"), WallClock(), "USB Audio 24")
    card.open()
    stream = Stream.opened[-1]
    stream.buffer(sound(480))
    stream.buffer(sound(480), missing)
    card.drive(Chirp("audio", 20_000.0, 46_000.0, 0.01, 1.0))
    played = [np.abs(stream.buffer(sound(480))).max() for _ in range(6)]
    assert played == [pytest.approx(1.0, abs=1e-3)] * 2 + [0.0] * 4
    assert card.receive() == [], "it is still on its way back"
    stream.buffer(sound(480))
    (swept,) = card.receive()
    assert isinstance(swept, Swept)
    assert swept.frame == 960 + missing + 960 + ROUND_TRIP


def test_a_drive_that_follows_a_chirp_is_not_notified_of_its_end() -> None:
    device, stream = listening()
    device.apply(Chirp("audio", 20_000.0, 46_000.0, 0.005, 1.0))
    stream.buffer(sound(480))
    device.apply(Excite("audio", False))
    for _ in range(10):
        stream.buffer(sound(480))
    device.read()
    assert not reported(device, Reached)


def test_a_card_without_output_listens_and_refuses_to_drive() -> None:
    device, stream = listening("USB Audio 24 loopback")
    assert isinstance(stream, InputStream)
    stream.buffer(sound(480))
    assert len(device.read()) == 1
    device.apply(Tone("audio", 40_000.0, 0.5))
    device.read()
    (refusal,) = reported(device, Refused)
    assert refusal.reason == "the sound card has no output"


def test_a_card_that_is_pulled_out_has_failed() -> None:
    device, stream = listening()
    stream.finished()
    device.read()
    (failed,) = reported(device, Failed)
    assert failed.reason == "the sound card is gone"


def test_the_systems_own_choice_and_an_exact_name_are_taken() -> None:
    assert audio("").open().model == "USB Audio 24"
    assert audio("USB Audio 24").open().model == "USB Audio 24"
    assert audio("loop").open().model == "USB Audio 24 loopback"


@pytest.mark.parametrize(
    ("name", "cause", "remedy"),
    [
        ("Scarlett", "no input is called Scarlett", "HDA Intel: Analog, USB Audio 24, USB Audio 24 loopback"),
        ("USB", "2 inputs are called so: USB Audio 24, USB Audio 24 loopback", "more of the name"),
        (
            "HDA",
            "HDA Intel: Analog does not open at 96000 Hz (Invalid sample rate [PaErrorCode -9997])",
            "96 kHz",
        ),
    ],
)
def test_a_card_that_is_not_to_be_had_is_refused(name: str, cause: str, remedy: str) -> None:
    with refused(PortError, "audio: ", cause, remedy):
        audio(name).open()


def test_no_card_at_all_is_reported_as_none(portaudio: Any) -> None:
    portaudio.query_devices = list
    with refused(PortError, "no input is called USB", "there are: none"):
        audio("USB").open()


def test_a_missing_sounddevice_says_how_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "sounddevice", None)
    with refused(PortError, "audio: ", "sounddevice is not installed", "'touchbench[sound]'"):
        audio("USB").open()


def test_a_missing_portaudio_says_how_to_install_it(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "sounddevice.py").write_text('raise OSError("PortAudio library not found")\n')
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "sounddevice", raising=False)
    with refused(PortError, "audio: ", "PortAudio is missing", "apt install libportaudio2"):
        audio("USB").open()


def test_the_drive_goes_out_on_the_channels_that_the_profile_names_alone(portaudio: Any) -> None:
    portaudio.query_devices = lambda: [
        {"index": 4, "name": "Octet", "max_input_channels": 8, "max_output_channels": 8}
    ]
    device, stream = listening("Octet", drive_channels=(2, 5))
    device.apply(Tone("audio", 40_000.0, 0.5))
    played = stream.buffer(sound(480))
    assert sorted(np.flatnonzero(np.abs(played).max(axis=0) > 0.1)) == [2, 5]
    assert not played[:, [0, 1, 3, 4, 6, 7]].any()


@pytest.mark.parametrize(
    ("card", "outputs", "settings", "named"),
    [
        ("Duet", 2, {"drive_channels": (0, 2)}, ("Duet has 2 outputs", "names 2", "from 0")),
        ("pulse", 2, {"latency_s": 0.02}, ("pulse is a sound server", "latency_s = 0.1")),
        ("default", 2, {"latency_s": 0.02}, ("default is a sound server", "latency_s = 0.1")),
    ],
)
def test_a_card_that_cannot_do_what_the_profile_asks_for_is_refused(
    portaudio: Any, card: str, outputs: int, settings: dict[str, Any], named: tuple[str, ...]
) -> None:
    found = {"index": 4, "name": card, "max_input_channels": 2, "max_output_channels": outputs}
    portaudio.query_devices = lambda: [found]
    with refused(PortError, "audio", *named):
        audio(card, **settings).open()
    audio(card, latency_s=0.1).open()
