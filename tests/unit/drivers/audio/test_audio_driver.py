"""The fingers' driver on a scripted source, in virtual time."""

from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from drivers.audio.codec import Sound
from drivers.audio.driver import Audio, AudioSettings
from drivers.audio.source import SourceFound, Swept
from drivers.core.clock import VirtualClock
from drivers.core.errors import PortError, ProtocolError, SilentError
from drivers.core.messages import Chirp, Excite, Failed, Listen, Lost, Reached, Refused, Saturated, Sent, Tone
from tests.contracts.crank import Crank
from tests.refusals import refused

RATE_HZ = 96_000
TURN_S = 0.005
PACKET = 480
LOOK = 96
"""Frames between two looks while it is opened."""
FULL = 2**23
STREAM = "audio.fingers"
ON, OFF = Listen("audio", frozenset({STREAM})), Listen("audio", frozenset())
FOUND = SourceFound(
    "the recorder", "M3", float(RATE_HZ), 2, 24, "audio frames", "S7", "1.2", {"address": "here"}
)
CHIRP = Chirp("audio", 20_000.0, 46_000.0, 0.5, 0.5, id=7)


def noise(n=PACKET, channels=2):
    return np.random.default_rng(3).integers(-(2**20), 2**20, (n, channels)).astype(np.int32)


class Source:
    """Notes the calls; returns what was put in, and what is new at each look while it runs by itself."""

    def __init__(self, clock):
        self.clock, self.fault, self.found, self.first = clock, None, FOUND, noise(24_000)
        self.calls, self.queue, self.runs, self.packets = [], [], 0, count()

    def open(self):
        self.calls.append("open")
        return self.found

    def peek(self, seconds):
        self.calls.append(("peek", seconds))
        return self.first

    def listen(self, on):
        self.calls.append(("listen", on))

    def drive(self, command):
        self.calls.append(command)

    def receive(self):
        if self.runs:
            self.runs -= 1
            self.put(next(self.packets) * LOOK, noise(LOOK))
        taken, self.queue = self.queue, []
        return taken

    def put(self, frame, counts=None):
        counts = noise() if counts is None else counts
        self.queue.append(Sound(frame, counts, self.clock.monotonic_s()))

    def account(self):
        return {"overruns": 3}

    def close(self):
        self.calls.append("close")


class Bench(Crank):
    """The driver, its source, and what the driver has reported."""

    def __init__(self, **settings):
        clock = VirtualClock()
        clock.rest(100.0)
        clock.restart()
        self.source = Source(clock)
        given = AudioSettings(port="tcp:here:1", **settings)
        super().__init__(Audio("audio", given, clock, lambda *_: self.source), clock, opens=False)

    def turn(self, seconds=TURN_S, turn_s=TURN_S):
        for _ in range(round(seconds / turn_s)):
            self.clock.rest(turn_s)
            self.blocks += self.device.read()
            self.statuses += self.device.poll()

    def refuses(self, kind, *named):
        with refused(kind, "audio: ", *named):
            self.device.open()
        assert self.source.calls[-1] == "close"


@pytest.fixture
def bench():
    """Open, and listened to."""
    made = Bench()
    made.device.open()
    made.device.apply(ON)
    made.turn()
    assert made.take(Sent)
    return made


# --- opening -------------------------------------------------------------------------------------


@pytest.mark.parametrize(("bits", "reported"), [(24, 24), (32, 32), (None, "not reported")])
def test_what_was_found_and_which_finger_is_where_stands_in_the_manifest(bits, reported):
    bench = Bench(channels=(1, 0))
    bench.source.found = replace(FOUND, bits=bits)
    info = bench.device.open()
    assert (info.device, info.model, info.serial, info.version) == ("audio", "M3", "S7", "1.2")
    assert info.clock == "audio frames"
    assert info.details == {
        "port": "tcp:here:1",
        "bits": reported,
        "channels": {"right": 1, "left": 0},
        "address": "here",
    }
    stream = info.streams[STREAM]
    assert (stream.channels, stream.unit, stream.rate_hz) == (("right", "left"), "FS", 96_000.0)
    assert bench.source.calls == ["open", ("peek", 0.25)]


@pytest.mark.parametrize(
    ("changes", "settings", "cause", "remedy"),
    [
        ({"channels": 1}, {}, "1 channel where two fingers need 2", "`channels`"),
        ({"channels": 2}, {"channels": (0, 3)}, "2 channels where two fingers need 4", "`channels`"),
        ({"rate_hz": 48_000.0}, {}, "48000 frames a second, not 96000", "record at 96000 Hz"),
        ({"bits": 16}, {}, "16 bits a sample, not 24", "24-bit format"),
    ],
)
def test_a_source_that_cannot_carry_the_fingers_is_refused_unheard(changes, settings, cause, remedy):
    bench = Bench(**settings)
    bench.source.found = replace(FOUND, **changes)
    bench.refuses(ProtocolError, "the recorder has", cause, remedy)
    assert bench.source.calls == ["open", "close"]


def test_the_fingers_channels_alone_are_looked_at():
    bench = Bench(channels=(2, 1))
    bench.source.found = replace(FOUND, channels=3)
    bench.source.first = noise(24_000, 3)
    bench.source.first[:, 0] = 0
    bench.device.open()
    bench.source.first[:, 1] = 0
    bench.refuses(ProtocolError, "the left finger is silent", "0.25 s", "`channels`")


@pytest.mark.parametrize("settings", [{"look_s": 0.0}, {}])
def test_no_look_is_taken_where_none_is_wanted_or_there_is_nothing_to_look_at(settings):
    bench = Bench(**settings)
    bench.source.first = noise(0)
    bench.device.open()
    assert bench.source.calls == ["open", *([("peek", 0.25)] if not settings else [])]


def test_sound_that_has_to_be_waited_for_is_listened_to_for_as_long_as_the_look_takes():
    bench = Bench()
    bench.source.first, bench.source.runs = None, 1000
    bench.source.queue.append(Swept(0, bench.clock.monotonic_s()))
    bench.device.open()
    assert bench.clock.now() == pytest.approx(0.25)
    assert bench.source.calls[2:] == [("listen", True), ("listen", False)]
    bench.source.runs = 0
    bench.clock.rest(3.0)
    bench.device.apply(ON)
    bench.source.put(12 * RATE_HZ // 4)
    bench.turn()
    assert bench.blocks[0].t0_s == pytest.approx(3.0, abs=0.01), "the look fitted the converter's clock"


def test_what_comes_of_a_source_that_stops_during_the_look_is_looked_at():
    bench = Bench()
    bench.source.first, bench.source.runs = None, 20
    bench.device.open()
    assert bench.clock.now() == pytest.approx(1.25, abs=TURN_S)


def test_a_source_that_sends_nothing_during_the_look_is_silent():
    bench = Bench(look_s=0.5, silence_timeout_s=2.0)
    bench.source.first = None
    bench.refuses(SilentError, "no sound in 2.5 s", "is it running?")
    assert bench.clock.now() == pytest.approx(2.5, abs=TURN_S)


def test_a_source_that_goes_away_during_the_look_is_a_port_that_is_gone():
    bench = Bench()
    bench.source.first = None
    source: Any = bench.source
    receive = source.receive

    def goes():
        source.fault = "the cable is out"
        return receive()

    source.receive = goes
    bench.refuses(PortError, "the cable is out", "docs/reference/sensors.md")
    assert bench.clock.now() == pytest.approx(0.001)


# --- sound ---------------------------------------------------------------------------------------


def test_sound_is_handed_out_while_it_is_listened_to_and_a_pause_is_not_lost(bench):
    bench.source.put(0)
    bench.device.apply(ON)
    bench.source.put(PACKET)
    bench.device.apply(OFF)
    bench.source.put(2 * PACKET)
    bench.turn()
    assert [block.seq for block in bench.blocks] == [0, PACKET], "what was waiting was asked for"
    bench.device.apply(OFF)
    bench.source.put(20 * PACKET)
    bench.device.apply(ON)
    bench.source.put(21 * PACKET)
    bench.turn()
    assert [block.seq for block in bench.blocks[2:]] == [21 * PACKET]
    assert bench.source.calls[2:] == [("listen", on) for on in (True, False, True)]
    assert bench.take(Lost) == bench.take(Failed) == []
    assert [status.command for status in bench.take(Sent)] == [ON, OFF, OFF, ON]


def test_missing_frames_are_lost_and_counted(bench):
    bench.source.put(0)
    bench.turn()
    bench.source.put(3 * PACKET)
    bench.turn()
    assert bench.take(Lost) == [Lost(bench.blocks[1].t0_s, "audio", STREAM, 2 * PACKET)]
    account = bench.device.account()
    assert (account["frames"], account["frames_lost"], account["overruns"]) == (2 * PACKET, 2 * PACKET, 3)


def test_a_converter_that_begins_anew_has_failed_and_nothing_more_of_it_is_taken(bench):
    bench.source.put(0)
    bench.source.put(0)
    bench.source.put(PACKET)
    bench.turn()
    assert [failed.reason for failed in bench.take(Failed)] == [
        f"the converter began anew: after frame {PACKET - 1} came 0"
    ]
    assert len(bench.blocks) == 1
    bench.source.put(2 * PACKET)
    bench.turn(2.0)
    assert bench.take(Failed) == []
    assert len(bench.blocks) == 1


def test_each_excursion_of_a_finger_is_reported_with_its_time_and_value():
    bench = Bench(channels=(1, 0))
    bench.device.open()
    bench.device.apply(ON)
    counts = noise(960)
    counts[96, 0] = -FULL
    counts[192, 1] = FULL - 1
    bench.source.put(0, counts)
    bench.turn()
    t0_s = bench.blocks[0].t0_s
    left, right = bench.take(Saturated)
    assert left == Saturated(pytest.approx(t0_s + 0.001), "audio", STREAM, -1.0)
    assert right == Saturated(pytest.approx(t0_s + 0.002), "audio", STREAM, pytest.approx(1.0, abs=1e-6))
    assert bench.device.account()["saturations"] == 2
    assert np.array_equal(bench.blocks[0].values, counts[:, [1, 0]])


def test_a_pause_ends_an_excursion_and_a_finger_s_silence(bench):
    full = noise()
    full[:, 0], full[-1, 1] = 7, FULL - 1
    frames = count(step=PACKET)
    for _ in range(190):
        bench.source.put(next(frames), full)
        bench.turn()
    assert len(bench.take(Saturated)) == 1, "again and again within 0.1 s"
    bench.device.apply(OFF)
    bench.device.apply(ON)
    for _ in range(190):
        bench.source.put(next(frames), full)
        bench.turn()
    assert len(bench.take(Saturated)) == 1
    assert bench.take(Failed) == []
    for _ in range(11):
        bench.source.put(next(frames), full)
        bench.turn()
    (failed,) = bench.take(Failed)
    assert failed.reason == "the right finger is silent: nothing has moved in 1 s; is it plugged in?"


# --- what goes wrong -----------------------------------------------------------------------------


def test_a_source_that_sends_nothing_while_it_is_listened_to_has_failed(bench):
    bench.source.put(0)
    bench.turn()
    began_s = bench.clock.now()
    bench.turn(0.995)
    bench.source.put(200 * PACKET)
    bench.turn()
    assert bench.take(Failed) == []
    bench.turn(1.5)
    (failed,) = bench.take(Failed)
    assert failed.reason == "no sound in 1 s; is the source running?"
    assert failed.t_s - began_s == pytest.approx(2.0, abs=2 * TURN_S)


def test_a_source_without_a_subscriber_may_be_silent_and_a_pause_does_not_count():
    bench = Bench()
    bench.device.open()
    bench.turn(2.0)
    bench.device.apply(ON)
    bench.turn(0.9)
    bench.device.apply(OFF)
    bench.turn(5.0)
    bench.device.apply(ON)
    bench.turn(0.9)
    assert bench.take(Failed) == []


def test_a_host_that_was_away_does_not_blame_the_source(bench):
    bench.turn(38.0, turn_s=2.0)
    assert bench.take(Failed) == [], "19 turns, each counts as 50 ms"
    bench.turn(6.0, turn_s=2.0)
    assert len(bench.take(Failed)) == 1


# --- drive ---------------------------------------------------------------------------------------


def test_every_drive_goes_to_the_source_and_what_it_declines_is_refused(bench):
    tone = Tone("audio", 40_000.0, 0.5, id=3)
    drives = [tone, CHIRP, Excite("audio", False)]
    for drive in drives:
        bench.device.apply(drive)
    assert bench.source.calls[-3:] == drives
    declined = Refused(bench.clock.now(), "audio", tone, "no output")
    bench.source.queue.append(declined)
    bench.turn()
    assert bench.take(Refused) == [declined]
    assert [status.command for status in bench.take(Sent)] == drives


@pytest.mark.parametrize("listens", [False, True])
def test_the_end_of_a_chirp_is_reported_under_its_id_at_the_time_of_its_frame(bench, listens):
    if listens:
        bench.source.put(0)
        bench.turn()
    bench.device.apply(CHIRP)
    bench.clock.rest(0.5)
    bench.source.queue.append(Swept(PACKET, bench.clock.monotonic_s()))
    t_s = bench.blocks[0].t0_s + TURN_S if listens else bench.clock.now()
    bench.turn()
    assert bench.take(Reached) == [Reached(pytest.approx(t_s, abs=1e-6), "audio", 0.0, command_id=7)]


def test_the_end_of_a_chirp_that_has_arrived_when_the_next_begins_is_not_reported_under_the_next(bench):
    bench.device.apply(CHIRP)
    bench.source.queue.append(Swept(PACKET, bench.clock.monotonic_s()))
    bench.device.apply(replace(CHIRP, id=8))
    bench.turn()
    assert [reached.command_id for reached in bench.take(Reached)] == [7]


@pytest.mark.parametrize("drive", [CHIRP, Tone("audio", 40_000.0, 0.5), Excite("audio", False)])
def test_a_source_that_has_failed_by_then_is_silenced_and_driven_no_more(bench, drive):
    bench.source.fault = "the cable is out"
    bench.device.apply(drive)
    bench.turn()
    silenced = isinstance(drive, Excite)
    assert (drive in bench.source.calls) is silenced
    assert [failed.reason for failed in bench.take(Failed)] == ["the cable is out"]
    assert [status.reason for status in bench.take(Refused)] == ["the cable is out"] * (not silenced)
    assert len(bench.take(Sent)) == silenced


def test_a_drive_is_switched_off_after_a_failure_too_and_nothing_else_is_played(bench):
    bench.turn(2.0)
    (failed,) = bench.take(Failed)
    tone, off = Tone("audio", 40_000.0, 0.5), Excite("audio", False)
    for drive in (tone, off):
        bench.device.apply(drive)
    assert [call for call in bench.source.calls if call in (tone, off)] == [off]
    now_s = bench.clock.now()
    assert bench.device._statuses == [Refused(now_s, "audio", tone, failed.reason), Sent(now_s, "audio", off)]


# --- account and statuses ------------------------------------------------------------------------


def test_the_account_outlives_the_source_and_begins_anew_with_the_next():
    bench = Bench()
    assert bench.device.account() == {}
    bench.device.open()
    bench.device.apply(ON)
    counts = noise()
    counts[5, 0] = FULL - 1
    bench.source.put(0, counts)
    bench.turn()
    account = bench.device.account()
    assert set(account) == {"frames", "frames_lost", "saturations", "drift_ppm", "overruns"}
    assert (account["frames"], account["saturations"]) == (PACKET, 1)
    bench.device.close()
    bench.device.close()
    assert bench.device.account() == account
    bench.device.open()
    assert bench.device.account()["frames"] == bench.device.account()["saturations"] == 0


def test_the_end_of_the_sound_is_reported_after_the_sound(bench):
    bench.source.put(0)
    bench.clock.rest(TURN_S)
    assert bench.device.poll() == [], "it is read first"
    assert len(bench.device.read()) == 1
    bench.device.apply(OFF)
    bench.source.fault = "the cable is out"
    assert [type(status) for status in bench.device.poll()] == [Sent, Failed]


@pytest.mark.parametrize("given", [{"channels": (0, 0)}, {"channels": (-1, 0)}, {"drive_channels": (1, 1)}])
def test_a_channel_that_stands_twice_or_is_none_is_refused(given):
    with pytest.raises(ValidationError, match=r"each channel once, counted from 0"):
        AudioSettings(port="sounddevice:", **given)
