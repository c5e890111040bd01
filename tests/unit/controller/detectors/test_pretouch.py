"""Pre-touch on envelopes that no plant made."""

import math
from dataclasses import replace

import numpy as np
import pytest

from behaviors.events import PreTouch, PreTouchLost
from controller.detectors.calibration import calibrate_pieces, span_maxima, threshold_for
from controller.detectors.level import LevelSettings
from controller.detectors.pretouch import PreTouchDetector, PreTouchSettings
from controller.detectors.pretouch_paper import PreTouchPaperDetector, PreTouchPaperSettings
from controller.signals.undulation import fit_wave
from drivers.core.messages import SampleBlock

RATE_HZ = 1000.0
SURFACE_M = 0.055
UNDULATION_M = 0.00429


def trip(*legs):
    """Way of a mover: (speed in m/s, seconds) after each other, shape (n,)."""
    speeds = np.concatenate([np.full(round(seconds * RATE_HZ), speed) for speed, seconds in legs])
    return np.concatenate(([0.0], np.cumsum(speeds) / RATE_HZ))[:-1]


def blocks_of(way_m, size=0.001, seed=1, sigma=5e-5, undulation_m=UNDULATION_M, sign=-1.0):
    """Envelope of a finger whose object is SURFACE_M ahead, and its encoder."""
    rng = np.random.default_rng(seed)
    gap_m = SURFACE_M - way_m
    z = size * (1.0 + np.maximum(gap_m, 0.0) / 0.01) ** -2 * np.exp(sign * 2j * np.pi * gap_m / undulation_m)
    z += 0.1 - 0.07j + sigma * (rng.standard_normal(len(z)) + 1j * rng.standard_normal(len(z)))
    values = np.column_stack([z.real, z.imag])
    return (
        SampleBlock("signals.right", 0, 0.0, values, rate_hz=RATE_HZ, unit="FS"),
        SampleBlock("arm.position", 0, 0.0, way_m[::2, None], rate_hz=RATE_HZ / 2.0, unit="m"),
    )


def ours(**settings):
    """In a room without echoes, before an object straight ahead, by default."""
    settings = {"background_fs": 0.0, "obliquity": (1.0,)} | settings
    return PreTouchDetector("near", PreTouchSettings(**settings))


def events_of(detector, *blocks):
    return [event for block in blocks for event in detector.push(block)]


def first_m(way_m, **settings):
    events = events_of(ours(**settings), *blocks_of(way_m))
    assert isinstance(events[0], PreTouch)
    return events[0].position_m


def test_the_place_at_which_it_sees_hardly_depends_on_the_speed_nor_on_its_changes_and_pauses():
    places_m = [first_m(trip((v, 0.05 / v)), level_fs=1e-4) for v in (0.003, 0.01, 0.03, 0.1)]
    assert np.ptp(places_m) < 0.003
    uneven = first_m(trip((0.01, 1.0), (0.0, 2.0), (0.03, 0.5), (0.005, 5.0)), level_fs=1e-4)
    assert uneven == pytest.approx(places_m[1], abs=0.002)


@pytest.mark.parametrize("off", [0.98, 1.02])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_a_speed_of_sound_that_is_off_by_two_per_cent_and_the_sense_of_rotation_do_not_matter(off, sign):
    way_m = trip((0.01, 5.0))
    events = events_of(ours(), *blocks_of(way_m, undulation_m=off * UNDULATION_M, sign=sign))
    assert isinstance(events[0], PreTouch)
    assert events[0].position_m < 0.02


def test_standing_still_gives_no_events_and_the_object_left_behind_one():
    events = events_of(ours(), *blocks_of(trip((0.01, 4.0), (0.0, 30.0))))
    assert [type(event) for event in events] == [PreTouch]
    assert events[0].t_s < 4.0
    assert events[0].position_m == pytest.approx(0.01 * events[0].t_s, abs=1e-4)
    assert events[0].value > events[0].threshold
    way_m = trip((0.01, 5.0), (0.0, 1.0), (-0.03, 5.0))
    events = events_of(ours(), *blocks_of(way_m, sigma=1e-4))
    assert [type(event) for event in events] == [PreTouch, PreTouchLost]
    assert events[1].t_s > 6.0


def test_neither_motion_before_nothing_nor_a_drifting_level_is_an_object():
    way_m = trip((0.0, 0.5), (0.01, 4.0), (0.0, 0.3), (-0.03, 4.0 / 3.0))
    quiet = [not events_of(ours(), *blocks_of(way_m, size=0.0, seed=seed)) for seed in range(100)]
    assert sum(quiet) >= 99  # at its own threshold of 18
    way_m = trip((0.01, 5.0))
    signal, encoder = blocks_of(way_m, size=0.0)
    drifted = signal.values + np.linspace(0.0, 0.003, len(signal))[:, None]
    block = SampleBlock("signals.right", 0, 0.0, drifted, rate_hz=RATE_HZ)
    assert events_of(ours(), block, encoder) == []


@pytest.mark.parametrize("cosine", [1.0, 0.9, -1.0])
def test_a_wall_that_stands_still_is_no_object_at_its_own_settings_and_an_object_before_it_is(cosine):
    way_m = trip((0.01, 5.0))
    wall = 1e-4 * np.exp(2j * np.pi * cosine * way_m / UNDULATION_M)
    found = []
    for size in (0.0, 0.02):
        signal, encoder = blocks_of(way_m, size=size)
        values = signal.values + np.column_stack([wall.real, wall.imag])
        block = SampleBlock("signals.right", 0, 0.0, values, rate_hz=RATE_HZ)
        found.append(events_of(PreTouchDetector("near", PreTouchSettings()), block, encoder))
    assert found[0] == []
    assert isinstance(found[1][0], PreTouch)
    assert SURFACE_M - found[1][0].position_m > 0.025


def test_calibrated_fingers_of_different_gain_detect_at_one_distance():
    way_m = trip((0.01, 5.4))
    plain = events_of(ours(level_fs=1e-4), *blocks_of(way_m, size=0.001))[0].position_m
    less_sensitive = events_of(ours(level_fs=1e-4), *blocks_of(way_m, size=0.0005))[0].position_m
    calibrated = events_of(ours(level_fs=1e-4, gain=2.0), *blocks_of(way_m, size=0.0005))[0].position_m
    assert calibrated == pytest.approx(plain, abs=0.0005)
    assert less_sensitive > plain + 0.002


def test_an_object_beside_the_path_is_found_at_its_obliquity():
    """The distance grows with the cosine of 60 degrees: so do the undulations' lengths."""
    blocks = blocks_of(trip((0.01, 5.0)), undulation_m=2.0 * UNDULATION_M)
    assert events_of(ours(), *blocks) == [] or events_of(ours(), *blocks)[0].position_m > 0.02
    assert events_of(ours(obliquity=(1.0, 0.5)), *blocks)[0].position_m < 0.02


@pytest.mark.parametrize("share", [0.7, 1.0, 1.15, 1.3, 1.42])
def test_an_object_that_moves_by_itself_or_a_wave_of_another_length_is_seen_as_far(share):
    """By default, in a room not known to be empty."""
    blocks = blocks_of(trip((0.01, 5.0)), undulation_m=UNDULATION_M / share)
    assert events_of(PreTouchDetector("near", PreTouchSettings()), *blocks)[0].position_m < 0.03


def test_it_can_be_calibrated_with_the_position_as_third_column_and_not_without():
    back_and_forth_m = np.abs((np.arange(120_000) * 1e-5 + 0.02) % 0.08 - 0.04)
    signal, _ = blocks_of(back_and_forth_m, size=0.0)
    columns = np.column_stack([signal.values, back_and_forth_m])
    scores = ours().statistic(columns, RATE_HZ)
    assert 3.0 < threshold_for(span_maxima(scores, RATE_HZ), 30.0).threshold < 30.0
    with pytest.raises(ValueError, match="three columns"):
        ours().statistic(signal.values, RATE_HZ)


def columns_of(way_m, wall_fs=0.0, size=0.0, seed=1):
    """I, Q and position before a wall that faces, whose echo does not grow."""
    signal, _ = blocks_of(way_m, size=size, seed=seed)
    wall = wall_fs * np.exp(2j * np.pi * way_m / UNDULATION_M)
    return np.column_stack([signal.values + np.column_stack([wall.real, wall.imag]), way_m])


def test_the_background_that_a_room_asks_for_is_its_own_waves():
    to_and_fro_m = trip((0.01, 4.0), (-0.01, 4.0))
    detector = PreTouchDetector("near", PreTouchSettings())
    found = detector.proposed(columns_of(to_and_fro_m, 3e-4), RATE_HZ)["background_fs"]
    assert 3e-4 < found < 3.6e-4
    loud = columns_of(trip((0.01, 5.0)), 3e-4, seed=2)
    assert np.nanmax(detector.statistic(loud, RATE_HZ)) > 18.0
    assert np.nanmax(detector.set_to(background_fs=found).statistic(loud, RATE_HZ)) < 18.0
    assert detector.proposed(columns_of(to_and_fro_m), RATE_HZ)["background_fs"] < 5e-5


def test_an_object_is_seen_at_each_of_several_approaches_from_as_far():
    """At the first it was near: that is no background at the second."""
    way_m = trip((0.01, 5.0), (-0.01, 5.0), (0.01, 5.0), (-0.01, 5.0), (0.01, 5.0))
    events = events_of(PreTouchDetector("near", PreTouchSettings()), *blocks_of(way_m, size=0.02))
    places_m = [event.position_m for event in events if isinstance(event, PreTouch)]
    assert len(places_m) == 3
    assert max(places_m) < 0.03


def test_calibrating_compiles_nothing_beside_what_a_bench_needs():
    detector = ours()
    detector.warm_up()
    detector.statistic(np.random.default_rng(4).standard_normal((100, 3)), RATE_HZ)
    # in a table a column is not in one piece, and numba compiles anew for that
    layouts = {argument.layout for types in fit_wave.signatures for argument in types[1:]}  # type: ignore[attr-defined]
    assert layouts == {"C"}


def test_blocks_of_envelope_and_encoder_give_the_threshold_of_the_three_columns():
    way_m = np.abs((np.arange(120_000) * 1e-5 + 0.02) % 0.08 - 0.04)
    signal, encoder = blocks_of(way_m, size=0.0)
    scores = ours().statistic(np.column_stack([signal.values, way_m]), RATE_HZ)
    from_columns = threshold_for(span_maxima(scores, RATE_HZ), 30.0)
    parts = [(block, at) for block in (signal, encoder) for at in range(0, len(block), 500)]
    cut = [replace(b, seq=at, t0_s=at / b.rate_hz, values=b.values[at : at + 500]) for b, at in parts]
    # the encoder has half the rate, and its straight lines are cut where the mover turns
    found = calibrate_pieces([(ours(), cut)], 30.0)
    assert found.threshold == pytest.approx(from_columns.threshold, rel=0.05)


def test_the_position_beside_a_recorded_sample_is_the_live_one():
    """A pose along a slanting direction, an encoder that falls silent for a second, and lost samples."""
    signal, encoder = blocks_of(trip((0.01, 6.0)))
    pose = np.column_stack([encoder.values[:, 0], 0.3 - encoder.values[:, 0], np.zeros((len(encoder), 4))])
    kept = np.r_[0:1000, 1500 : len(pose)]
    readings = SampleBlock("arm.pose", 0, 0.0, pose[kept], times_s=encoder.times[kept], unit="m")
    values = signal.values.copy()
    times_s = signal.times.copy()
    values[4000:4100], times_s[4000:4100] = np.nan, np.nan
    detector = ours(position_input="arm.pose", direction=(1.0, -1.0, 0.0))
    found = detector.columns(values, times_s, [signal, readings])
    along_m = (encoder.values[:, 0] - (0.3 - encoder.values[:, 0])) / math.sqrt(2.0)
    expected_m = np.interp(signal.times, encoder.times, along_m)
    expected_m[1999:3000] = np.nan  # between the last reading, at 1.998 s, and the next, at 3 s
    expected_m[4000:4100] = np.nan
    expected_m[-1] = np.nan  # the encoder's last reading is before it
    assert found[:, 2] == pytest.approx(expected_m, abs=1e-12, nan_ok=True)
    assert np.array_equal(found[:, :2], values, equal_nan=True)


def test_settings_that_make_no_sense_are_refused():
    for settings in (PreTouchSettings, PreTouchPaperSettings, LevelSettings):
        with pytest.raises(ValueError, match="a direction has a length"):
            settings(direction=(0.0, 0.0, 0.0))
    with pytest.raises(ValueError, match="shares"):
        PreTouchSettings(obliquity=(0.0,))


# --- the paper's ---------------------------------------------------------------------------------


def paper(**settings):
    return PreTouchPaperDetector("near", PreTouchPaperSettings(**settings))


def tone(amplitude, hertz, n=2000, offset=0.1):
    values = offset + amplitude * np.sin(2.0 * np.pi * hertz * np.arange(n) / RATE_HZ)
    return SampleBlock("signals.right", 0, 0.0, values[:, None], rate_hz=RATE_HZ)


@pytest.mark.parametrize(("hertz", "inside"), [(2.0, True), (50.0, True), (100.0, True), (102.0, False)])
def test_the_papers_power_is_that_between_0_and_100_hz(hertz, inside):
    power = paper().statistic(tone(0.01, hertz).values, RATE_HZ)[499]
    assert power == pytest.approx(0.5 * 0.01**2 if inside else 0.0, rel=1e-6, abs=1e-12)


def test_literally_the_bridges_imbalance_swamps_the_papers_power():
    literal = paper(remove_dc=False).statistic(tone(0.001, 4.0).values, RATE_HZ)[499]
    assert literal == pytest.approx(0.1**2 + 0.5 * 0.001**2, rel=1e-6)
    assert paper().statistic(tone(0.001, 4.0).values, RATE_HZ)[499] == pytest.approx(0.5 * 0.001**2, rel=1e-6)


def test_the_papers_events_come_with_the_last_sample_of_a_window_in_turn_and_with_an_encoders_position():
    values = np.concatenate([tone(0.0, 5.0).values, tone(0.01, 5.0).values, tone(0.0, 5.0).values])
    events = events_of(paper(), SampleBlock("signals.right", 0, 0.0, values, rate_hz=RATE_HZ))
    assert [(type(event), event.t_s) for event in events] == [(PreTouch, 2.499), (PreTouchLost, 4.499)]
    assert math.isnan(events[0].position_m)
    events = events_of(paper(position_input="arm.position"), *blocks_of(trip((0.01, 5.4)), size=0.01))
    assert events[0].position_m == pytest.approx(0.01 * events[0].t_s, abs=1e-4)


def test_a_window_with_a_value_that_is_not_finite_or_with_a_gap_is_skipped():
    values = tone(0.01, 5.0).values.copy()
    values[100] = np.nan
    spoiled = events_of(paper(), SampleBlock("signals.right", 0, 0.0, values, rate_hz=RATE_HZ))
    assert spoiled[0].t_s == pytest.approx(0.999)
    whole = tone(0.01, 5.0)
    parts = (
        SampleBlock("signals.right", 0, 0.0, whole.values[:400], rate_hz=RATE_HZ),
        SampleBlock("signals.right", 450, 0.45, whole.values[450:1000], rate_hz=RATE_HZ),
    )
    assert events_of(paper(), *parts)[0].t_s == pytest.approx(0.949)
