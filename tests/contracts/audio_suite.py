"""What the fingers' audio promises: run for the mock driver in virtual time, for the real one over TCP."""

import cmath
import math
from itertools import pairwise
from typing import Any, Literal

import numpy as np
import pytest

from drivers.core.messages import Chirp, Excite, Home, Listen, Lost, Reached, Saturated, Sent, Tone
from tests.contracts.crank import TURN_S, Crank
from tests.contracts.sensor_suite import SensorContract

FINGERS = "audio.fingers"

RATE_HZ = 96_000

GAINS = (cmath.rect(0.1, 0.3), cmath.rect(0.2, -1.0))
"""Of the right finger and the left: amplitude and phase for a drive of full scale."""

TONE = Tone("audio", 40_000.0, 0.5)

LOUD = 0.9
"""A drive above this level takes both fingers beyond full scale."""


class SteadyFingers:
    """A bench on which nothing moves: each finger sends the drive back by its gain, with a converter's noise."""

    level: Literal["envelope", "carrier"] = "carrier"

    def __init__(self, level: Literal["envelope", "carrier"] = "carrier") -> None:
        self.level = level
        self.t_s = 0.0
        self.asked = 0
        self._drives: list[tuple[float, float, float, float]] = [(-math.inf, 0.0, 0.0, 0.0)]

    def advance(self, t_s: float, observe: frozenset[str] | None = None) -> None:
        self.t_s = max(self.t_s, t_s)

    def drive(self, frequency_hz: float, level: float) -> None:
        self._drives.append((self.t_s, frequency_hz, level, math.inf))

    def chirp(self, from_hz: float, to_hz: float, duration_s: float, level: float) -> None:
        self._drives.append((self.t_s, from_hz, level, self.t_s + duration_s))

    def silence(self) -> None:
        self._drives.append((self.t_s, 0.0, 0.0, math.inf))

    def baseband(self, times_s: Any) -> Any:
        assert times_s[-1] <= self.t_s + 1e-9
        _, level = self._at(times_s)
        found = np.outer(level, GAINS)
        return np.where(level[:, None] > LOUD, 2.0, found) + 1e-6 * (np.rint(times_s * 1e3) % 3)[:, None]

    def carrier(self, first_frame: int, n: int, *, drift_ppm: float = 0.0) -> Any:
        frames = np.arange(first_frame, first_frame + n)
        times_s = frames / (RATE_HZ * (1.0 + 1e-6 * drift_ppm))
        assert times_s[-1] <= self.t_s
        self.asked += n
        frequency_hz, level = self._at(times_s)
        turns = frequency_hz * (frames % 96_000_000) / RATE_HZ % 1.0
        wave = np.real(np.outer(level * np.exp(2j * np.pi * turns), GAINS))
        noise = (frames * 7919 % 101 - 50)[:, None]
        counts = np.rint(np.where(level[:, None] > LOUD, 20.0, 1.0) * wave * 2**23) + noise
        return np.clip(counts, -(2**23), 2**23 - 1).astype(np.int32)

    def _at(self, times_s: Any) -> tuple[Any, Any]:
        starts = np.array([drive[0] for drive in self._drives])
        drives = np.array(self._drives)[np.searchsorted(starts, times_s, side="right") - 1]
        return drives[:, 1], np.where(times_s < drives[:, 3], drives[:, 2], 0.0)


class AudioTrial(Crank):
    """An audio device called `audio`."""

    def record(self, frames: int, seconds: float = 5.0) -> None:
        """Turn until so many frames have come."""
        end_s = self.clock.now() + seconds
        while sum(map(len, self.blocks)) < frames and self.clock.now() < end_s:
            self.turn(TURN_S)

    def phasors(self, frequency_hz: float, frames: int) -> Any:
        """What both fingers send of a frequency, against the frames' own phase, over the last so many; full scale 1."""
        counts = np.concatenate([block.physical for block in self.blocks])[-frames:]
        numbers = np.concatenate([block.seq + np.arange(len(block)) for block in self.blocks])[-frames:]
        turns = frequency_hz * (numbers % 96_000_000) / RATE_HZ % 1.0
        return 2.0 * (counts * np.exp(-2j * np.pi * turns)[:, None]).mean(axis=0)


class AudioContract(SensorContract):
    """Subclasses give a fixture `bench` of `SteadyFingers`, at carrier level."""

    stream = FINGERS
    senseless = (
        *(Home("audio"), Excite("audio", True), Listen("audio", frozenset({"audio.thumb"}))),
        *(Tone("audio", math.nan, 0.5), Tone("audio", 48_000.0, 0.5)),
        *(Tone("audio", 40_000.0, 1.1), Tone("audio", 40_000.0, math.nan)),
        Chirp("audio", 20_000.0, math.inf, 1.0, 0.5),
        *(Chirp("audio", 20_000.0, 40_000.0, duration_s, 0.5) for duration_s in (0.0, math.inf)),
    )

    def check_pause(self, bench: AudioTrial, missing: int, pause: float) -> None:
        assert missing >= 0.75 * pause, "the pause is a gap in the numbers"
        assert bench.of(Lost) == [], "and was asked for"

    def test_two_fingers_arrive_in_24_bit_counts(self, bench: AudioTrial) -> None:
        (info,) = bench.info.streams.values()
        assert (info.name, info.channels, info.unit) == (FINGERS, ("right", "left"), "FS")
        assert (info.scale, info.rate_hz) == (2.0**-23, 96_000.0)
        assert not bench.info.mover
        bench.listen(FINGERS)
        bench.record(4800)
        assert {block.values.dtype for block in bench.blocks} == {np.dtype(np.int32)}
        assert {(block.unit, block.scale, block.rate_hz) for block in bench.blocks} == {
            ("FS", 2.0**-23, 96_000.0)
        }

    def test_blocks_follow_one_another_in_sequence_and_time(self, bench: AudioTrial) -> None:
        bench.listen(FINGERS)
        bench.record(48_000)
        assert sum(map(len, bench.blocks)) >= 48_000
        for before, after in pairwise(bench.blocks):
            assert after.seq == before.seq + len(before)
            assert after.t0_s > before.t0_s
        first, last = bench.blocks[0], bench.blocks[-1]
        # Half a second: the clock model is still learning; 20 ms is the longest delay measured on a pty.
        assert last.t0_s - first.t0_s == pytest.approx((last.seq - first.seq) / RATE_HZ, abs=0.02)
        assert all(block.device_t0_s is not None and block.arrival_s is not None for block in bench.blocks)
        # Times never turn back: what came late makes its successors late, until the clock model knows better.
        assert all(block.last_s <= block.arrival_s + 0.02 for block in bench.blocks)
        assert bench.of(Lost) == []

    @pytest.mark.parametrize("frequency_hz", [40_000.0, 39_123.457])
    def test_the_frames_numbers_are_the_phase_reference(self, bench: AudioTrial, frequency_hz: float) -> None:
        bench.listen(FINGERS)
        bench.turn(0.03)
        bench.device.apply(Tone("audio", frequency_hz, 0.5))
        bench.turn(0.1)
        bench.blocks.clear()
        bench.record(9600)
        assert bench.phasors(frequency_hz, 9600) == pytest.approx(0.5 * np.array(GAINS), abs=1e-4)
        assert [type(sent.command) for sent in bench.of(Sent)] == [Listen, Tone]

    def test_excitation_off_is_silence(self, bench: AudioTrial) -> None:
        bench.device.apply(TONE)
        bench.listen(FINGERS)
        bench.turn(0.1)
        bench.device.apply(Excite("audio", False))
        bench.turn(0.1)
        bench.blocks.clear()
        bench.record(9600)
        assert np.abs(np.concatenate([block.values for block in bench.blocks])).max() <= 50

    def test_a_chirp_is_reported_when_it_is_over(self, bench: AudioTrial) -> None:
        bench.listen(FINGERS)
        bench.turn(0.05)
        bench.device.apply(Chirp("audio", 20_000.0, 46_000.0, 0.3, 0.5))
        reached = bench.until(Reached)
        (sent,) = [sent for sent in bench.of(Sent) if isinstance(sent.command, Chirp)]
        assert reached.t_s - sent.t_s == pytest.approx(0.3, abs=0.05)
        assert reached.position_m == 0.0

    def test_a_chirp_that_something_newer_replaces_does_not_end(self, bench: AudioTrial) -> None:
        bench.device.apply(Chirp("audio", 20_000.0, 46_000.0, 0.1, 0.5))
        bench.device.apply(TONE)
        bench.turn(0.3)
        assert bench.of(Reached) == []

    def test_a_clipped_finger_is_reported_once(self, bench: AudioTrial) -> None:
        bench.device.apply(Tone("audio", 40_000.0, 1.0))
        bench.listen(FINGERS)
        bench.record(28_800)
        assert [(one.stream, abs(one.value)) for one in bench.of(Saturated)] == [
            (FINGERS, pytest.approx(1.0, abs=1e-6))
        ] * 2, "both fingers, once each"
