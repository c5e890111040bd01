"""The mock audio keeps the promises of audio, in virtual time; its envelope, its faults."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import Chirp, Failed, Lost, Reached, Refused, Saturated, Status
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.audio import MockAudio, MockAudioSettings
from tests.contracts.audio_suite import FINGERS, GAINS, TONE, AudioContract, AudioTrial, SteadyFingers


def opened(level: Any, *faults: dict[str, Any], **settings: Any) -> AudioTrial:
    clock = VirtualClock()
    schedule = FaultSchedule([Fault(device="audio", **fault) for fault in faults])
    bench = SteadyFingers(level)
    return AudioTrial(MockAudio("audio", MockAudioSettings(**settings), clock, bench, schedule), clock)


@pytest.fixture
def trial() -> AudioTrial:
    return opened("carrier")


class TestMockAudio(AudioContract):
    pass


def test_the_sound_card_says_for_how_long_it_may_be_left_alone_until_a_sweep_has_ended() -> None:
    trial = opened("envelope")
    assert trial.device.alone_s == np.inf
    trial.device.apply(Chirp("audio", 38_000.0, 42_000.0, 0.3, 0.5))
    ends_s = trial.clock.now() + trial.device.alone_s
    trial.turn(ends_s + 0.1)
    assert [status.t_s for status in trial.of(Reached)] == [ends_s]
    assert trial.device.alone_s == np.inf


def test_the_envelope_is_baseband_of_both_fingers() -> None:
    trial = opened("envelope")
    (info,) = trial.info.streams.values()
    assert (info.channels, info.rate_hz, info.scale) == (("I0", "Q0", "I1", "Q1"), 1000.0, 1.0)
    trial.device.apply(TONE)
    trial.listen(FINGERS)
    trial.turn(1.0)
    values = np.concatenate([block.values for block in trial.blocks])
    assert values.shape == (1000, 4)
    assert values.dtype == np.float64
    assert values[0] == pytest.approx(
        [0.5 * part for gain in GAINS for part in (gain.real, gain.imag)], abs=1e-5
    )


@pytest.mark.parametrize("level", ["envelope", "carrier"])
def test_sound_does_not_depend_on_how_it_is_cut(level: str) -> None:
    sound = []
    for block_samples, turn_s in ((9600, 0.005), (7, 0.35)):
        trial = opened(level, block_samples=block_samples)
        trial.listen(FINGERS)
        trial.device.apply(TONE)
        for _ in range(round(1.4 / turn_s)):
            trial.clock.wait_until(trial.clock.now() + turn_s)
            trial.blocks += trial.device.read()
        blocks = trial.blocks
        assert max(map(len, blocks)) <= block_samples
        assert all(after.seq == before.seq + len(before) for before, after in pairwise(blocks))
        sound.append(np.concatenate([block.values for block in blocks])[:1000])
    assert np.array_equal(*sound)


def test_without_a_subscriber_nothing_is_computed() -> None:
    trial = opened("carrier")
    trial.device.apply(TONE)
    trial.turn(1.0)
    assert trial.device._bench.asked == 0


@pytest.mark.parametrize("level", ["envelope", "carrier"])
@pytest.mark.parametrize(
    ("kind", "status"), [("unplug", Failed), ("lose", Lost), ("corrupt", Lost), ("full_scale", Saturated)]
)
def test_faults_are_reported(level: str, kind: str, status: type[Status]) -> None:
    trial = opened(level, {"kind": kind, "at_s": 0.1, "for_s": 0.1})
    trial.listen(FINGERS)
    trial.turn(0.3)
    assert {type(one) for one in trial.statuses[1:]} == {status}


def test_what_is_lost_is_a_gap_of_just_that_length() -> None:
    trial = opened("carrier", {"kind": "lose", "at_s": 0.1, "for_s": 0.1})
    trial.listen(FINGERS)
    trial.turn(0.3)
    gaps = sum(after.seq - before.seq - len(before) for before, after in pairwise(trial.blocks))
    assert gaps == sum(lost.samples for lost in trial.of(Lost)) == pytest.approx(9600, abs=480)


def test_a_refused_drive_is_reported() -> None:
    trial = opened("carrier", {"kind": "refuse", "at_s": 0.0})
    trial.device.apply(TONE)
    trial.turn(0.01)
    assert trial.of(Refused)[0].command == TONE


def test_a_silent_one_sends_nothing() -> None:
    trial = opened("carrier", {"kind": "silent", "at_s": 0.0})
    trial.listen(FINGERS)
    trial.turn(0.3)
    assert trial.blocks == []


def test_a_bench_without_fingers_is_refused_in_one_line() -> None:
    with pytest.raises(RefusedError, match=r"^audio: this bench does not have fingers that sound while "):
        MockAudio("audio", MockAudioSettings(), VirtualClock(), object())  # type: ignore[arg-type]
