"""Measures: touches of a pointer, contacts, sweeps, the sign of the first contact."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from behaviors.chirp import ChirpSettings
from behaviors.events import BaselineReady, BaselineRefused, Contact
from behaviors.first_contact import FirstContactSettings
from behaviors.flexion import FlexionSettings
from behaviors.proximal import ProximalSettings
from behaviors.stiffness import StiffnessSettings
from behaviors.transient import TransientSettings
from controller.measures import chirp, first_contact, flexion, proximal, stiffness
from controller.measures.pointer import Touch, errors_of, touches_of, turned_rad
from controller.measures.transient import measure
from controller.measures.trial import TrialEvidence, spans_of
from controller.recording.series import TrialRecording
from drivers.core.messages import SampleBlock

DOWN = Rotation.from_rotvec([0.0, 3.1416, 0.0])
"""The start pose: the tool looks down. Its rotation vector is as long as half a turn, where the sign jumps."""


def posed(angle_rad, n=10, jitter=0.0):
    """Poses turned about base y: x, y, z and the rotation vector, shape (n, 6)."""
    turns = [Rotation.from_rotvec([jitter * (-1) ** i, angle_rad, 0.0]) * DOWN for i in range(n)]
    return np.array([[0.4, -0.1, 0.25, *turn.as_rotvec()] for turn in turns])


def recorded(angles, errors, force_n=3.0, jitter=0.0):
    """A recording of touches of a second each, after a second at the start pose; with the visits."""
    recording, visits = TrialRecording(1), [("HOMING", 0.0), ("ZEROING", 1.0)]
    recording.add(SampleBlock("arm.pose", 0, 1.0, posed(0.0, jitter=jitter), rate_hz=500.0))
    t_s = 2.0
    for angle_rad, error_rad in zip(angles, errors, strict=True):
        visits += [("DESCENDING", t_s), ("RECORDING", t_s + 0.5), ("LIFTING", t_s + 0.9)]
        measured = angle_rad + error_rad
        forces = np.tile([force_n * math.sin(measured), force_n * math.cos(measured), 0.1], (50, 1))
        # Recorded during the descent as well, before it touches: not part of the touch.
        recording.add(SampleBlock("signals.tip", int(t_s * 1000), t_s, np.full((50, 3), 9.0), rate_hz=1000.0))
        recording.add(SampleBlock("signals.tip", int(t_s * 1000) + 600, t_s + 0.6, forces, rate_hz=1000.0))
        poses = posed(angle_rad, jitter=jitter)
        recording.add(SampleBlock("arm.pose", int(t_s * 500), t_s + 0.6, poses, rate_hz=500.0))
        t_s += 1.0
    return recording, visits


TIP = {"forces_stream": "signals.tip", "pose_stream": "arm.pose"}


def touches(angles, errors, *, broken_s=(), **how):
    return touches_of(*recorded(angles, errors, **how), **TIP, angles=len(angles) // 2, broken_s=broken_s)


ANGLES = [-1.5, 0.0, 1.5, 1.5, 0.0, -1.5]
ERRORS = [0.01, 0.02, -0.03, 0.01, 0.04, -0.02]


@pytest.mark.parametrize("jitter", [0.0, 1e-4])
def test_true_and_measured_angles_are_those_of_arm_and_forces(jitter):
    found = touches(ANGLES, ERRORS, jitter=jitter)
    assert [touch.true_rad for touch in found] == pytest.approx(ANGLES, abs=1e-6)
    assert [touch.error_rad for touch in found] == pytest.approx(ERRORS, abs=1e-6)
    assert [touch.force_n for touch in found] == pytest.approx([3.0] * 6)
    assert [touch.going for touch in found] == ["up"] * 3 + ["down"] * 3


def test_a_touch_that_a_pause_broke_off_does_not_count_and_without_a_start_pose_nothing_is_true():
    whole = touches(ANGLES, ERRORS)
    with_broken = touches([-1.5, *ANGLES], [0.5, *ERRORS], broken_s={2.9})
    assert [touch._replace(going="") for touch in with_broken] == [each._replace(going="") for each in whole]
    recording, visits = recorded(ANGLES, ERRORS)
    assert touches_of(recording, visits[2:], **TIP, angles=3) == []
    assert math.isnan(errors_of([])["bias"])


def test_errors_are_taken_between_half_a_turn_either_way_and_a_turn_counts_about_base_y():
    touch = Touch(true_rad=-1.57, measured_rad=1.57 + math.pi, spread_rad=0.0, force_n=1.0, going="up")
    assert touch.error_rad == pytest.approx(3.14 + math.pi - 2.0 * math.pi)
    start = DOWN.as_rotvec()
    now = (Rotation.from_rotvec([0.0, 0.7, 0.0]) * DOWN).as_rotvec()
    assert turned_rad(start, now) == pytest.approx(0.7)
    assert turned_rad(now, start) == pytest.approx(-0.7)


def test_the_errors_over_all_touches_are_their_mean_spread_and_largest_and_hysteresis_that_of_a_whole_sweep():
    errors = errors_of(touches(ANGLES, ERRORS))
    assert errors["bias"] == pytest.approx(np.mean(ERRORS), abs=1e-6)
    assert errors["sd"] == pytest.approx(np.std(ERRORS, ddof=1), abs=1e-6)
    assert errors["rms"] == pytest.approx(math.sqrt(np.mean(np.square(ERRORS))), abs=1e-6)
    assert errors["max"] == pytest.approx(0.04, abs=1e-6)
    assert errors["hysteresis"] == pytest.approx(0.04, abs=1e-6), "at 1.5 rad: up -0.03, down 0.01"
    recording, visits = recorded(ANGLES, ERRORS)
    found = touches_of(recording, visits[:-6], **TIP, angles=3)
    assert len(found) == 4
    errors = errors_of(found)
    assert errors["bias"] == pytest.approx(np.mean(ERRORS[:4]), abs=1e-6)
    assert math.isnan(errors["hysteresis"])


def test_a_pose_whose_rotation_vector_jumps_between_both_signs_of_half_a_turn_has_a_mean_all_the_same():
    """Half a turn one way is half a turn the other way: a controller reports either."""
    recording, visits = recorded(ANGLES, ERRORS)
    jumping = np.array([[0.0] * 3 + [0.0, sign * (math.pi - 1e-4), 0.0] for sign in (1.0, -1.0, 1.0, -1.0)])
    other = TrialRecording(1)
    for stream in recording.streams:
        for block in recording.blocks(stream):
            if not (stream == "arm.pose" and block.t0_s == 1.0):
                other.add(block)
    other.add(SampleBlock("arm.pose", 0, 1.0, jumping, rate_hz=500.0))
    found = touches_of(other, visits, **TIP, angles=3)
    assert [touch.true_rad for touch in found] == pytest.approx(ANGLES, abs=1e-3)


def test_every_visit_to_a_state_has_its_span():
    visits = [("A", 0.0), ("B", 1.0), ("A", 2.0)]
    assert spans_of(visits, "A") == [(0.0, 1.0), (2.0, math.inf)]
    assert spans_of(visits, "C") == []


STREAMS = (("board.load_cell", "N"), ("board.period", "s"), ("stage.position", "m"), ("board.tendon", "m"))


def evidence(t_s, truth=None, force_n=None):
    """One contact event; baseline to 2 s, approach and hold to 3 s; what is not given hardly changes."""
    values = np.linspace(0.030, 0.031, 4000)
    recording = TrialRecording(1)
    for stream, unit in STREAMS:
        given = values if force_n is None or stream != "board.load_cell" else force_n
        recording.add(SampleBlock(stream, 0, 0.0, given[:, None], rate_hz=1000.0, unit=unit))
    entered_s = {"BASELINE": 0.0, "FLEXING": 1.0, "APPROACH": 2.0, "STOPPING": 2.9, "RETRACTING": 3.0}
    visits, events = list(entered_s.items()), [Contact(t_s, "contact", 29.0, 28.5)]
    listening = {"contact": SimpleNamespace(inputs=())}
    return TrialEvidence({}, recording, events, entered_s, visits, truth=truth, detectors=listening)


def real(noise_n, push_n):
    """Measured of a load cell that has noise and is pushed from 2.5 s on, without the truth."""
    force_n = np.random.default_rng(1).normal(0.0, noise_n, 4000)
    force_n[2500:] += push_n
    return measure(evidence(2.7, force_n=force_n), TransientSettings(), "contact")


def test_an_event_from_just_before_the_approach_that_stops_it_is_a_false_contact():
    outcome, row = measure(evidence(1.99), TransientSettings(), "contact")
    assert (outcome, row["false_contacts"], row["detect_s"]) == ("false_contact", 1, 1.99)


BY_TIME = pytest.mark.parametrize(("t_s", "false"), [(2.7, 0), (2.5, 0), (2.4999, 1), (2.45, 1)])
TOUCH = [(2.5, True), (3.1, False)]


@BY_TIME
def test_a_contact_before_the_touch_is_false_however_soon_the_touch_follows(t_s, false):
    outcome, row = measure(evidence(t_s, TOUCH), TransientSettings(), "contact")
    assert (outcome, row["false_contacts"]) == ("false_contact" if false else "contact", false)


@BY_TIME
def test_flexion_counts_a_contact_before_the_touch_as_false(t_s, false):
    _, row = flexion.measure(evidence(t_s, TOUCH), FlexionSettings(), "contact")
    assert (row["contact_false"], row["contact_blind"]) == (false, false)
    assert row["contact_event_s"] == (None if false else pytest.approx(max(0.0, t_s - 2.5)))


def test_a_contact_of_a_detector_that_stays_armed_after_the_stop_is_not_the_one_that_stopped():
    found = evidence(2.7, TOUCH)
    found.entered_s["STOPPING"] = 2.7
    found.events.append(Contact(2.95, "contact", 29.0, 28.5))
    _, row = measure(found, TransientSettings(), "contact")
    assert (row["detect_s"], found.ending_contact("contact").t_s) == (2.7, 2.7)
    del found.entered_s["STOPPING"]
    assert found.ending_contact("contact").t_s == 2.95


def test_what_refused_its_baseline_has_no_score_and_a_detector_of_another_name_no_column():
    found = evidence(2.7, TOUCH)
    found.events.insert(0, BaselineRefused(0.5, "contact", 28.0, math.nan, "no variance"))
    _, row = flexion.measure(found, FlexionSettings(), "contact")
    assert row["contact_false"] is row["contact_share"] is row["contact_blind"] is None
    found.events.insert(1, BaselineReady(0.9, "contact", 28.0, 28.5))
    assert flexion.measure(found, FlexionSettings(), "contact")[1]["contact_false"] == 0
    found = evidence(2.7, TOUCH)
    found.events.append(Contact(2.7, "mine", 29.0, 28.5))
    _, row = flexion.measure(found, FlexionSettings(detector="mine"), "contact")
    assert (row["false_contacts"], row["contact_false"]) == (0, 0)


@pytest.mark.parametrize(("back_s", "heard"), [(3.0, True), (2.99, False)])
def test_the_link_is_told_only_where_both_were_heard_for_long_enough_after_the_detection(back_s, heard):
    """The proximal link stands still from the touch on."""
    settings = ProximalSettings(waveform_streams=("board.near", "board.far"))
    found = evidence(2.7, TOUCH)
    swing = np.sin(0.2 * np.arange(4000))
    for stream, after in (("board.near", 0.1), ("board.far", 1.0)):
        values = np.where(np.arange(4000) < 2600, 1.0, after) * swing
        found.recording.add(SampleBlock(stream, 0, 0.0, values[:, None], rate_hz=1000.0, unit="m/s2"))
    found.entered_s |= {"STOPPING": 2.7, "RETRACTING": back_s}
    outcome, row = proximal.measure(found, settings, "contact")
    assert (outcome, row["identified"]) == ("contact", "distal" if heard else None)
    assert row["ratio_db"] == (pytest.approx(20.0, abs=0.5) if heard else None)
    with pytest.raises(ValueError, match="waveform_streams"):
        ProximalSettings.model_validate({})


@pytest.mark.parametrize(("noise_n", "told"), [(0.0002, True), (0.003, False)])
def test_a_real_load_cell_whose_noise_reaches_the_onset_shows_none(noise_n, told):
    outcome, row = real(noise_n, 0.2)
    assert outcome == "contact"
    assert row["delay_s"] == (pytest.approx(0.2, abs=0.002) if told else None)
    assert row["false_contacts"] == (0 if told else None)


@pytest.mark.parametrize(("push_n", "judged"), [(-0.2, ("wrong_sign", None)), (0.0, ("false_contact", 1))])
def test_a_real_load_cell_that_reads_a_push_as_negative_has_the_wrong_sign(push_n, judged):
    outcome, row = real(2e-4, push_n)
    assert (outcome, row["false_contacts"]) == judged


SHORTLY = [("SETTLING", 0.0), ("ZEROING", 1.0), ("PLACING", 2.0), ("RECORDING", 3.0), ("RINGING", 5.0)]


def rested(condition, force_n, zero_n=0.0, channel=0):
    """A contact at rest from 3 to 5 s; another channel of the cell has a force of its own."""
    times_s = np.arange(6000) / 1000.0
    force = np.full((6000, 3), 0.7)
    force[:, channel] = zero_n + np.where(times_s < 3.0, 0.0, force_n)
    swing = np.sin(2.0 * np.pi * 28.0 * times_s)[:, None]
    recording = TrialRecording(1)
    for stream, values in (("board.load_cell", force), ("board.accelerometer", swing)):
        recording.add(SampleBlock(stream, 0, 0.0, values, rate_hz=1000.0, unit="x"))
    visits = [*SHORTLY, ("RETRACTING", 5.5)]
    return TrialEvidence({"condition": condition}, recording, entered_s=dict(visits), visits=visits)


@pytest.mark.parametrize(("zero_n", "channel"), [(0.0, 0), (0.02, 2), (-0.3, 2)])
@pytest.mark.parametrize(
    ("condition", "force_n", "judged"),
    [
        ("none", 0.0, "recorded"),
        ("full", 0.0, "no_contact"),
        ("light", 0.0, "no_contact"),
        ("light", 0.1, "recorded"),
        ("full", 0.1, "recorded"),
    ],
)
def test_a_contact_at_rest_is_one_by_the_load_cell_less_its_zero(condition, force_n, judged, zero_n, channel):
    settings = StiffnessSettings(light_m=0.004, full_m=0.01, load_cell_channel=channel, period_stream=None)
    outcome, row = stiffness.measure(rested(condition, force_n, zero_n, channel), settings, "recorded")
    assert outcome == judged
    assert [row["force_n"], row["force_peak_n"]] == pytest.approx([force_n, force_n])
    assert row["touching"] == (force_n > 0.0)


def test_the_load_cells_channel_is_that_of_the_settings():
    found = evidence(2.7, TOUCH)
    force_n = np.zeros((4000, 3))
    force_n[2500:, 2] = 0.2
    found.recording.add(SampleBlock("arm.force", 0, 0.0, force_n, rate_hz=1000.0, unit="N"))
    peaks_n = [
        measure(found, TransientSettings(load_cell_stream="arm.force", load_cell_channel=channel), "contact")[
            1
        ]["force_peak_n"]
        for channel in (0, 2)
    ]
    assert peaks_n == [0.0, pytest.approx(0.2)]


def heard(values, entered_s):
    recording = TrialRecording(1)
    recording.add(SampleBlock("audio.fingers", 0, 0.0, values, rate_hz=96_000.0, unit="FS"))
    return TrialEvidence({}, recording, entered_s=entered_s)


@pytest.mark.parametrize("late_s", [0.0, 0.06])
def test_the_best_frequency_is_where_most_comes_back_however_late_it_comes(late_s):
    """The order stands at 0.1 s; 60 ms of buffers and latency are 1.6 kHz of this sweep."""
    settings = ChirpSettings(duration_s=1.0)
    times_s = np.arange(0, 1.4, 1.0 / 96_000.0)
    swept_s = times_s - 0.1 - late_s
    f_hz = 20_000.0 + 26_000.0 * swept_s
    gain = 1.0 / np.sqrt(1.0 + ((f_hz - 39_500.0) / 1000.0) ** 2)
    tone = gain * np.sin(2 * np.pi * (20_000.0 * swept_s + 13_000.0 * swept_s**2))
    tone *= (swept_s >= 0) & (swept_s < 1.0)
    noise = 1e-3 * np.random.default_rng(1).standard_normal((len(tone), 2))
    evidence = heard(tone[:, None] * [1.0, 0.5] + noise, {"SWEEPING": 0.1, "RINGING": 1.1 + late_s})
    _, row = chirp.measure(evidence, settings, "swept")
    assert row["best_hz"] == pytest.approx(39_500.0, abs=chirp.STEP_HZ)
    # half a band, and a millisecond of 26 kHz a second
    assert row["unsure_hz"] == pytest.approx(125.0 + 26.0)
    assert row["band_low_hz"] == pytest.approx(38_500.0, abs=2 * chirp.STEP_HZ)
    assert row["band_high_hz"] == pytest.approx(40_500.0, abs=2 * chirp.STEP_HZ)
    # (1 + 1/4) / 2 over twice the noise's variance
    assert row["over_noise_db"] == pytest.approx(10 * math.log10(0.625 / 2e-6), abs=1.0)


def test_a_sweep_that_a_pause_broke_off_is_not_taken_for_silence():
    """A loud tone in the first second, silence from 2 s, the sweep from 3 s on."""
    times_s = np.arange(0.0, 4.2, 1.0 / 96_000.0)
    noise = 1e-3 * np.random.default_rng(1).standard_normal(len(times_s))
    sound = np.where((times_s < 1.0) | ((times_s >= 3.0) & (times_s < 4.0)), np.sin(2e5 * times_s), 0.0)
    values = np.column_stack([sound + noise] * 2)
    evidence = heard(values, {"SILENT": 2.0, "SWEEPING": 3.0, "RINGING": 4.0})
    _, row = chirp.measure(evidence, ChirpSettings(duration_s=1.0), "swept")
    # half a square over the noise's variance
    assert row["over_noise_db"] == pytest.approx(10 * math.log10(0.5 / 1e-6), abs=1.0)


@pytest.mark.parametrize(("echo", "judged"), [(0.0, "no_echo"), (1e-2, "swept")])
def test_a_sweep_without_an_echo_is_no_success_whatever_the_cards_offset(echo, judged):
    times_s = np.arange(0.0, 1.4, 1.0 / 96_000.0)
    noise = 1e-3 * np.random.default_rng(1).standard_normal((len(times_s), 2))
    tone = echo * np.sin(2e5 * times_s) * ((times_s >= 0.2) & (times_s < 1.2))
    evidence = heard(0.1 + noise + tone[:, None], {"SILENT": 0.0, "SWEEPING": 0.2, "RINGING": 1.2})
    outcome, row = chirp.measure(evidence, ChirpSettings(duration_s=1.0), "swept")
    assert (outcome, row["best_hz"] is None) == (judged, judged == "no_echo")
    # half a square of the echo, and the noise itself, over the noise
    assert row["over_noise_db"] == pytest.approx(10 * math.log10(1.0 + 0.5 * echo**2 / 1e-6), abs=1.0)


def test_a_sweep_that_did_not_come_to_its_end_gives_no_frequency_and_a_downward_one_is_a_mistake():
    evidence = heard(np.ones((96_000, 2)), {"SILENT": 0.0, "SWEEPING": 0.2, "FAILED": 0.9})
    assert chirp.measure(evidence, ChirpSettings(), "fault") == ("fault", dict.fromkeys(chirp.COLUMNS))
    with pytest.raises(ValueError, match="from_hz must be below to_hz"):
        ChirpSettings(from_hz=46_000.0, to_hz=20_000.0)


@pytest.mark.parametrize(("sign", "outcome"), [(1.0, "contact"), (-1.0, "wrong_sign")])
def test_pressing_reads_positive(sign, outcome):
    force_n = np.zeros(4000)
    force_n[2500:3000] = sign * 0.2
    found, row = first_contact.measure(evidence(2.51, force_n=force_n), FirstContactSettings(), "contact")
    assert found == outcome
    assert row["force_peak_n"] == pytest.approx(0.2)
