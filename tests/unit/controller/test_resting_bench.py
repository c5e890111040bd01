"""Whether a bench was at rest, as its streams show."""

import numpy as np
import pytest

from controller.guard import GuardSettings
from controller.quiet import unrest
from drivers.core.messages import SampleBlock, Saturated
from tests.refusals import check_refusal

LIMITS = GuardSettings(
    travel_m=0.01,
    speed_m_s=0.01,
    force_n=2.0,
    force_stream="board.load_cell",
    position_stream="stage.position",
)

NOISE_N = 0.01 * np.random.default_rng(1).standard_normal((10_000, 1))


def of(stream, values):
    """Ten seconds of a stream, in blocks."""
    parts = np.array_split(values, 100)
    places = np.cumsum([0, *map(len, parts)])
    rate_hz = len(values) / 10.0
    return [
        SampleBlock(stream, int(at), at / rate_hz, part, rate_hz=rate_hz)
        for at, part in zip(places[:-1], parts, strict=True)
    ]


def reasons(*blocks, events=(), known=True):
    return list(unrest([each for own in blocks for each in own], events, LIMITS, known))


def test_noise_and_a_place_that_stays_are_rest():
    places_m = 0.003 + 1e-5 * NOISE_N / NOISE_N.std()
    assert reasons(of("board.load_cell", NOISE_N), of("stage.position", places_m)) == []
    assert reasons(of("board.taxel", np.zeros((1000, 2)))) == []


def test_slow_drift_is_rest_and_a_wave_is():
    ramp = NOISE_N + np.linspace(0.0, 0.1, 10_000)[:, None]
    wave = np.sin(2.0 * np.pi * 28.0 * np.arange(10_000) / 1000.0)[:, None]
    assert reasons(of("board.load_cell", ramp), of("board.accelerometer", wave)) == []


@pytest.mark.parametrize(
    ("stream", "values", "named"),
    [
        ("stage.position", 0.001 + np.linspace(0.0, 2e-4, 1000)[:, None], ("went 0.20 mm",)),
        ("board.load_cell", NOISE_N + 0.3, ("reads 0.3 N", "tare")),
        ("board.load_cell", NOISE_N - 0.3, ("reads 0.3 N",)),
        ("board.finger", NOISE_N + 0.1 * (np.arange(10_000) >= 4000)[:, None], ("4 s after", "touched")),
    ],
)
def test_motion_a_load_and_a_touch_are_none(stream, values, named):
    (line,) = reasons(of(stream, values))
    check_refusal(line, stream, *named)


def test_a_load_is_not_held_against_a_limit_that_is_not_the_benchs_own():
    assert reasons(of("board.load_cell", NOISE_N + 0.3), known=False) == []


def test_a_stream_beyond_its_range_is_none():
    (line,) = reasons(events=[Saturated(1.0, "signals", "signals.tip", 12.0)])
    check_refusal(line, "signals.tip", "12")
