"""The mock hand, matrices and audio keep the promises of sensors, in virtual time; faults; the envelope of sound."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from drivers.core.clock import VirtualClock
from drivers.core.errors import RefusedError
from drivers.core.messages import Chirp, Failed, Lost, Reached, Refused, Saturated, Sent
from simulator.devices.faults import Fault, FaultSchedule
from simulator.mocks.audio import MockAudio, MockAudioSettings
from simulator.mocks.barrett_hand import MockBarrettHand, MockBarrettHandSettings
from simulator.mocks.dsa_matrix import MockDsaMatrix, MockDsaMatrixSettings
from tests.contracts.audio_suite import FINGERS, GAINS, TONE, AudioContract, AudioTrial, SteadyFingers
from tests.contracts.crank import Crank
from tests.contracts.hand_suite import F1, FORCES_N, HandBench, HandContract
from tests.contracts.matrix_suite import TEXELS, MatrixBench, MatrixContract, steady
from tests.steady import SteadyForces


def scheduled(name: str, faults: Any) -> FaultSchedule:
    return FaultSchedule([Fault(device=name, **fault) for fault in faults])


def hand(*faults: dict[str, Any]) -> HandBench:
    clock, felt = VirtualClock(), SteadyForces(FORCES_N)
    settings = MockBarrettHandSettings()
    return HandBench(MockBarrettHand("hand", settings, clock, felt, scheduled("hand", faults)), clock)


def matrices(*faults: dict[str, Any]) -> MatrixBench:
    clock, settings = VirtualClock(), MockDsaMatrixSettings()
    return MatrixBench(MockDsaMatrix("dsa", settings, clock, steady(), scheduled("dsa", faults)), clock)


def audio(*faults: dict[str, Any], level: Any = "carrier", **settings: Any) -> AudioTrial:
    clock, given = VirtualClock(), MockAudioSettings(**settings)
    return AudioTrial(
        MockAudio("audio", given, clock, SteadyFingers(level), scheduled("audio", faults)), clock
    )


def envelope(*faults: dict[str, Any]) -> AudioTrial:
    return audio(*faults, level="envelope")


@pytest.fixture
def bench(request: pytest.FixtureRequest) -> Crank:
    return request.cls.made()


class TestMockHand(HandContract):
    made = staticmethod(hand)


class TestMockMatrix(MatrixContract):
    made = staticmethod(matrices)


class TestMockAudio(AudioContract):
    made = staticmethod(audio)


ALL = {"unplug": Failed, "silent": Lost, "lose": Lost, "corrupt": Lost, "full_scale": Saturated}


@pytest.mark.parametrize(
    ("made", "stream", "kind"),
    [(made, stream, kind) for made, stream in ((hand, F1), (audio, FINGERS), (envelope, FINGERS)) for kind in ALL]
    + [(matrices, TEXELS, kind) for kind in ("unplug", "silent", "lose")],
)  # fmt: skip
def test_faults_are_reported(made: Any, stream: str, kind: str) -> None:
    bench = made({"kind": kind, "at_s": 0.1, "for_s": 0.1})
    bench.listen(stream)
    bench.turn(0.3)
    always = {Sent, Saturated} if made is matrices else {Sent}  # a steady texel is at its end
    assert {type(one) for one in bench.statuses} - always == {ALL[kind]}


@pytest.mark.parametrize(("made", "stream"), [(hand, F1), (matrices, TEXELS), (audio, FINGERS)])
def test_a_silent_one_sends_nothing(made: Any, stream: str) -> None:
    bench = made({"kind": "silent", "at_s": 0.0})
    bench.listen(stream)
    bench.turn(0.3)
    assert bench.blocks == []
    assert not [status for status in bench.statuses if isinstance(status, Failed | Lost)]


@pytest.mark.parametrize(("made", "stream", "samples"), [(hand, F1, 1000), (matrices, TEXELS, 100)])
def test_a_mock_loses_nothing(made: Any, stream: str, samples: int) -> None:
    bench = made()
    bench.listen(stream)
    bench.turn(1.0)
    assert sum(map(len, bench.blocks_of(stream))) == samples
    assert bench.of(Lost) == []


def test_the_sound_card_says_for_how_long_it_may_be_left_alone_until_a_sweep_has_ended() -> None:
    bench = envelope()
    assert bench.device.alone_s == np.inf
    bench.device.apply(Chirp("audio", 38_000.0, 42_000.0, 0.3, 0.5))
    ends_s = bench.clock.now() + bench.device.alone_s
    bench.turn(ends_s + 0.1)
    assert [status.t_s for status in bench.of(Reached)] == [ends_s]
    assert bench.device.alone_s == np.inf


def test_the_envelope_is_baseband_of_both_fingers() -> None:
    bench = envelope()
    (info,) = bench.info.streams.values()
    assert (info.channels, info.rate_hz, info.scale) == (("I0", "Q0", "I1", "Q1"), 1000.0, 1.0)
    bench.device.apply(TONE)
    bench.listen(FINGERS)
    bench.turn(1.0)
    values = np.concatenate([block.values for block in bench.blocks])
    assert (values.shape, values.dtype) == ((1000, 4), np.float64)
    both = [0.5 * part for gain in GAINS for part in (gain.real, gain.imag)]
    assert values[0] == pytest.approx(both, abs=1e-5)


@pytest.mark.parametrize("level", ["envelope", "carrier"])
def test_sound_does_not_depend_on_how_it_is_cut(level: str) -> None:
    sound = []
    for block_samples, turn_s in ((9600, 0.005), (7, 0.35)):
        bench = audio(level=level, block_samples=block_samples)
        bench.listen(FINGERS)
        bench.device.apply(TONE)
        for _ in range(round(1.4 / turn_s)):
            bench.clock.wait_until(bench.clock.now() + turn_s)
            bench.blocks += bench.device.read()
        blocks = bench.blocks
        assert max(map(len, blocks)) <= block_samples
        assert all(after.seq == before.seq + len(before) for before, after in pairwise(blocks))
        sound.append(np.concatenate([block.values for block in blocks])[:1000])
    assert np.array_equal(*sound)


def test_without_a_subscriber_nothing_is_computed() -> None:
    bench = audio()
    bench.device.apply(TONE)
    bench.turn(1.0)
    assert bench.device._bench.asked == 0


def test_what_is_lost_is_a_gap_of_just_that_length() -> None:
    bench = audio({"kind": "lose", "at_s": 0.1, "for_s": 0.1})
    bench.listen(FINGERS)
    bench.turn(0.3)
    gaps = sum(after.seq - before.seq - len(before) for before, after in pairwise(bench.blocks))
    assert gaps == sum(lost.samples for lost in bench.of(Lost)) == pytest.approx(9600, abs=480)


def test_a_refused_drive_is_reported() -> None:
    bench = audio({"kind": "refuse", "at_s": 0.0})
    bench.device.apply(TONE)
    bench.turn(0.01)
    assert bench.of(Refused)[0].command == TONE


def test_a_bench_without_fingers_is_refused_in_one_line() -> None:
    with pytest.raises(RefusedError, match=r"^audio: this bench does not have fingers that sound while "):
        MockAudio("audio", MockAudioSettings(), VirtualClock(), object())  # type: ignore[arg-type]
