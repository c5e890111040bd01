import numpy as np
import pytest
from pydantic import ValidationError

from behaviors.events import SlipEnded, SlipStarted
from controller.detectors.slip import SlipDetector, SlipPaperDetector, SlipPaperSettings, SlipSettings
from drivers.messages import SampleBlock

STREAM = "board.tangential"


def block(values, rate_hz=1000.0, seq=0):
    values = np.asarray(values, dtype=float)
    columns = values[:, None] if values.ndim == 1 else values
    return SampleBlock(STREAM, seq, seq / rate_hz, columns, rate_hz=rate_hz, unit="V")


def shaken(n, knock_share, rate_hz=1000.0, seed=1, frequency=180.0, size=0.1, noise=0.003):
    """Noise, and a structure that rings at every knock."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(0.2 * rate_hz)) / rate_hz
    ring = np.exp(-34.0 * t_s) * np.sin(2 * np.pi * frequency * t_s)
    knocks = (rng.random(n) < knock_share) * rng.standard_normal(n) * size
    return noise * rng.standard_normal(n) + np.convolve(knocks, ring)[:n]


def slip_after_quiet(rate_hz=1000.0, seed=1, quiet_s=3.0, slip_s=1.0):
    quiet, slip = round(quiet_s * rate_hz), round(slip_s * rate_hz)
    return np.concatenate(
        [
            shaken(quiet, 0.0, rate_hz, seed),
            shaken(slip, 200.0 / rate_hz, rate_hz, seed + 1),
            shaken(quiet, 0.0, rate_hz, seed + 2),
        ]
    )


# --- the paper's ---------------------------------------------------------------------------------


def test_the_papers_detector_speaks_at_the_last_sample_of_the_block_that_decides():
    tone = 0.3 * np.sin(2 * np.pi * 187.5 * np.arange(64) / 1000.0)
    x = np.concatenate([np.zeros(128), tone, tone, np.zeros(64)])
    events = SlipPaperDetector("slip", SlipPaperSettings()).push(block(x))
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert [event.t_s for event in events] == [pytest.approx(0.191), pytest.approx(0.319)]
    # a tone on a bin: N / 4 x amplitude^2 x frequency
    assert events[0].value == pytest.approx(16 * 0.09 * 187.5, rel=1e-9)


@pytest.mark.parametrize(
    ("rate_hz", "block_s", "size"), [(1000.0, 0.064, 64), (100.0, 0.16, 16), (2000.0, 0.064, 128)]
)
def test_the_block_is_as_long_at_every_rate(rate_hz, block_s, size):
    detector = SlipPaperDetector("slip", SlipPaperSettings(block_s=block_s))
    statistic = detector.statistic(np.random.default_rng(1).standard_normal((4 * size, 1)), rate_hz)
    assert np.flatnonzero(~np.isnan(statistic)).tolist() == [k * size - 1 for k in (1, 2, 3, 4)]


def test_the_channel_with_the_highest_frequency_decides():
    n = np.arange(64)
    strong_and_slow = 3.0 * np.sin(2 * np.pi * 2 * n / 64)
    weak_and_fast = 0.01 * np.sin(2 * np.pi * 20 * n / 64)
    detector = SlipPaperDetector("slip", SlipPaperSettings())
    product = detector.statistic(np.column_stack([strong_and_slow, weak_and_fast]), 1000.0)[-1]
    assert product == pytest.approx(16 * 1e-4 * 312.5, rel=1e-6)


def test_a_lost_block_starts_the_papers_block_anew():
    tone = 0.3 * np.sin(2 * np.pi * 187.5 * np.arange(96) / 1000.0)
    detector = SlipPaperDetector("slip", SlipPaperSettings())
    assert detector.push(block(tone[:32])) == []
    assert detector.push(block(tone[:63], seq=64)) == []
    assert [event.t_s for event in detector.push(block(tone[63:64], seq=127))] == [pytest.approx(0.127)]


# --- ours ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate_hz", [500.0, 1000.0, 2000.0, 4000.0])
def test_slip_is_found_and_its_end_too_at_any_rate(rate_hz):
    events = SlipDetector("slip", SlipSettings()).push(block(slip_after_quiet(rate_hz), rate_hz))
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert 3.0 < events[0].t_s < 3.1
    assert 4.0 < events[1].t_s < 4.3
    assert events[0].value > events[0].threshold


@pytest.mark.parametrize("frequency", [125.0, 180.0, 375.0])
def test_bumps_are_not_slip(frequency):
    """Ten minutes of one bump a second, half as strong again as the knocks of slip above."""
    x = shaken(600_000, 0.001, seed=5, frequency=frequency, size=0.15)
    assert SlipDetector("slip", SlipSettings(threshold=40.0)).push(block(x)) == []


def test_an_offset_a_ramp_and_a_step_are_not_slip():
    x = shaken(20_000, 0.0, seed=6) + 3.0
    x[8000:] += 0.0001 * np.arange(12_000)
    x[12_000:] += 1.0
    x[16_000:] -= 1.0
    assert SlipDetector("slip", SlipSettings()).push(block(x)) == []


def test_it_is_not_armed_before_it_knows_the_noise():
    """Slip from the first sample on is taken for noise: nothing is said in the first second."""
    events = SlipDetector("slip", SlipSettings()).push(block(shaken(1000, 0.2, seed=7)))
    assert events == []


def test_of_several_channels_the_one_that_slips_decides():
    slipping = slip_after_quiet()
    still = shaken(len(slipping), 0.0, seed=9)
    both = SlipDetector("slip", SlipSettings()).push(block(np.column_stack([still, slipping])))
    alone = SlipDetector("slip", SlipSettings(channel=1)).push(block(np.column_stack([still, slipping])))
    other = SlipDetector("slip", SlipSettings(channel=0)).push(block(np.column_stack([still, slipping])))
    assert [event.t_s for event in both] == [event.t_s for event in alone]
    assert len(alone) == 2
    assert other == []


def test_lost_samples_in_slip_do_not_end_it():
    x = slip_after_quiet()
    detector = SlipDetector("slip", SlipSettings())
    events = [*detector.push(block(x[:3500])), *detector.push(block(x[3550:], seq=3550))]
    assert [type(event) for event in events] == [SlipStarted, SlipEnded]
    assert 4.0 < events[1].t_s < 4.3


@pytest.mark.parametrize("lost", [700, -2000])
def test_after_a_long_gap_or_a_stream_begun_anew_evidence_begins_anew(lost):
    x = slip_after_quiet()
    detector = SlipDetector("slip", SlipSettings())
    started = detector.push(block(x[:3500]))
    ended = detector.push(block(shaken(500, 0.0, seed=8), seq=3500 + lost))
    assert [type(event) for event in (*started, *ended)] == [SlipStarted, SlipEnded]
    assert ended[0].t_s == pytest.approx((3500 + lost) / 1000.0)


def test_statistic_is_what_push_holds_against_the_threshold():
    x = slip_after_quiet()
    settings = SlipSettings(threshold=20.0)
    statistic = SlipDetector("slip", settings).statistic(x[:, None], 1000.0)
    started = SlipDetector("slip", settings).push(block(x))[0]
    first = int(np.argmax(statistic > 20.0))
    assert started.t_s == pytest.approx(first / 1000.0)
    assert started.value == statistic[first]


@pytest.mark.parametrize("kind", [SlipDetector, SlipPaperDetector])
def test_a_channel_that_is_not_there_is_said_in_one_line(kind):
    settings = SlipSettings(channel=3) if kind is SlipDetector else SlipPaperSettings(channel=3)
    with pytest.raises(ValueError, match=r"board.tangential: no channel 3 .* it has 1"):
        kind("slip", settings).push(block(np.zeros(10)))


@pytest.mark.parametrize("kind", [SlipDetector, SlipPaperDetector])
def test_irregular_times_are_refused(kind):
    settings = SlipSettings() if kind is SlipDetector else SlipPaperSettings()
    irregular = SampleBlock(STREAM, 0, 0.0, np.zeros((3, 1)), times_s=np.array([0.0, 0.1, 0.3]))
    with pytest.raises(ValueError, match="irregular times while detecting slip"):
        kind("slip", settings).push(irregular)


@pytest.mark.parametrize(
    "field", [{"threshold": 0.0}, {"order": 1}, {"jump_s": -1.0}, {"knocks_hz": float("nan")}, {"n": 64}]
)
def test_settings_out_of_bounds_are_refused(field):
    with pytest.raises(ValidationError):
        SlipSettings(**field)
