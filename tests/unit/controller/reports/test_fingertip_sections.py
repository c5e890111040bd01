"""The sections on B6 and B7, from recordings whose answer is known."""

import math
import re
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from behaviors.events import Tick
from controller.measures.bridge_calibration import Estimate
from controller.recording.reader import open_run
from controller.recording.recorder import Recorder
from controller.reports.pointer import read_sweeps
from controller.reports.report import build_report
from controller.reports.weights import compared, read_bridges
from drivers.core.messages import Loaded, SampleBlock, StreamInfo
from tests.unit.controller.reports.synthetic_runs import START, begun, text_of

STREAMS = {
    "board.fingertip": StreamInfo("board.fingertip", ("Fx", "Fy", "Ft"), "V", 1.0, 1000.0),
    "operator.load": StreamInfo("operator.load", ("Fx", "Fy", "Ft"), "N"),
    "signals.tip": StreamInfo("signals.tip", ("Fx", "Fy", "Ft", "Fn", "theta_rad"), "N", 1.0, 1000.0),
    "arm.pose": StreamInfo("arm.pose", ("x", "y", "z", "rx", "ry", "rz"), "m, rad", 1.0, 500.0),
}
PRINTED = {"x": (0.0694, 0.06), "y": (0.0326, 0.048), "t": (1.0291, 0.05)}
TOPS_N = {"x": 6.0, "y": 6.0, "t": 1.0}


def opened(root, experiment, bench, settings, factors):
    folder = begun(root, experiment, bench, settings)
    return folder, Recorder(folder, START, streams=STREAMS, factors=factors, measures=())


# --- B6 ----------------------------------------------------------------------------------------------


def write_weights(root, *, bench="mock", gains=None, outcome="calibrated", cycles=3):
    """A series for each bridge: the loop of a hysteresis as wide as printed, about a line of the gain given."""
    behavior = {"load_stream": "operator.load", "bridges_stream": "board.fingertip"}
    behavior |= {"preloads": 0, "weight_uncertainty": 0.001}
    folder, recorder = opened(root, "weights", bench, {"behavior": behavior}, ["bridge"])
    for trial, (bridge, (printed, width)) in enumerate(PRINTED.items(), start=1):
        gain = (gains or {}).get(bridge, printed)
        recorder.begin_trial(trial, {"bridge": bridge}, 100.0 * trial)
        rng = np.random.default_rng(trial)
        top_n = TOPS_N[bridge]
        weights_n = [top_n * step / 6.0 for step in range(1, 7)]
        cycle = [(n, -1.0) for n in weights_n] + [(n, 1.0) for n in weights_n[-2::-1]] + [(0.0, 0.0)]
        loads = [(0.0, 0.0), *cycle * cycles]
        for place, (load_n, side) in enumerate(loads):
            open_ = 1.0 - abs(load_n / top_n - 0.5) / 0.5
            volt = gain * (load_n + side * open_ * width * top_n / 2.0)
            row = np.zeros((1, 3))
            channel = "xyt".index(bridge)
            row[0, channel] = load_n
            values = 0.0001 * rng.normal(size=(200, 3))
            values[:, channel] = volt + 0.12 * printed / 3.5 * rng.normal(size=200)
            t_s = float(place)
            recorder.record([SampleBlock("operator.load", place, t_s, row, times_s=np.array([t_s]))])
            recorder.record([SampleBlock("board.fingertip", 1000 * place, t_s + 0.5, values, rate_hz=1000.0)])
            recorder.event(Loaded(t_s, "operator", bridge, load_n), state="HANGING", next_state="SWINGING")
        recorder.end_trial(outcome, {})
    recorder.close()
    return open_run(folder.path)


def test_each_bridge_is_recovered_from_the_recording_alone_and_trials_of_one_are_pooled(tmp_path):
    bridges = read_bridges([write_weights(tmp_path)])
    assert [paper["bridge"] for paper, _, _ in bridges] == ["x", "y", "t"]
    for paper, _, calibration in bridges:
        printed, width = PRINTED[paper["bridge"]]
        assert calibration.gain_v_n.value == pytest.approx(printed, rel=0.01)
        assert calibration.hysteresis.value == pytest.approx(width, abs=0.005)
        assert calibration.cycles == 3
    runs = [write_weights(tmp_path), write_weights(tmp_path)]
    assert [calibration.cycles for _, _, calibration in read_bridges(runs)] == [6, 6, 6]


def test_the_page_holds_ours_against_the_papers(tmp_path, undrawn):
    text = text_of(build_report([write_weights(tmp_path)]))
    assert "Fernandez" in text
    assert re.search(r"Fx: gain 0\.\d % \w+ the paper's 0\.0694 V/N, 0\.069\d V/N; the paper's gain,", text)
    assert re.search(r"Fx gain, V/N 0\.069\d 0\.06\d\d to 0\.07\d\d 0\.0694 yes", text)
    assert "Gain, hysteresis and noise of the simulated bridges were set from the figures" in text


def test_a_bridge_of_another_gain_is_reported_to_miss_the_papers(tmp_path, undrawn):
    text = text_of(build_report([write_weights(tmp_path, gains={"y": 0.05})]))
    assert re.search(r"Fy: gain 5\d\.\d % above the paper's 0\.0326 V/N, 0\.0[45]\d\d V/N; .*?outside", text)
    assert "agree with our 95 % intervals" in text, "the others do"
    assert re.search(r"Fy gain, V/N \S+ \S+ to \S+ 0\.0326 no", text)


@pytest.mark.parametrize(
    ("name", "printed", "low", "high", "met"),
    [
        ("resolution_n", "0.12", 0.1164, 0.1196, True),  # 0.1185 is printed as 0.12
        ("resolution_n", "0.12", 0.1255, 0.13, False),
        ("resolution_n", "0.12", 0.10, 0.1149, False),
        ("gain_v_n", "0.0326", 0.03264, 0.034, True),
        ("gain_v_n", "0.0326", 0.0327, 0.034, False),
    ],
)
def test_a_printed_figure_stands_for_what_is_rounded_to_it(name, printed, low, high, met):
    own = SimpleNamespace(**{name: Estimate(0.5 * (low + high), low, high)})
    assert compared({name: printed}, own, name).met == met


def test_a_real_bench_is_not_called_simulated_and_series_that_were_not_finished_calibrate_nothing(
    tmp_path, undrawn
):
    assert "simulated" not in text_of(build_report([write_weights(tmp_path, bench="hardware")]))
    text = text_of(build_report([write_weights(tmp_path, outcome="aborted")]))
    assert "No bridge was calibrated to the end (3 trials began)." in text


# --- B7 ----------------------------------------------------------------------------------------------

ANGLES = (-1.0, 0.0, 1.0)
OFF = {"up": -0.01, "down": 0.03}


def write_pointer(root, forces_n=(1.0, 3.0), *, bench="mock", angles=ANGLES, outcomes=()):
    behavior = {"detector": "touch", "forces_stream": "signals.tip", "pose_stream": "arm.pose"}
    settings = {"behavior": behavior | {"angles_rad": list(ANGLES)}}
    folder, recorder = opened(root, "pointer", bench, settings, ["detectors.touch.threshold"])
    down = Rotation.from_rotvec([0.0, math.pi, 0.0])
    for trial, force_n in enumerate(forces_n, start=1):
        recorder.begin_trial(trial, {"detectors.touch.threshold": force_n}, 100.0 * trial)
        t_s = 1.0

        def pose(angle_rad, t_s):
            turned = (Rotation.from_rotvec([0.0, angle_rad, 0.0]) * down).as_rotvec()
            values = np.tile([0.4, 0.0, 0.2, *turned], (10, 1))
            return SampleBlock("arm.pose", round(t_s * 500), t_s, values, rate_hz=500.0)

        recorder.event(Tick(t_s), state="HOMING", next_state="ZEROING")
        recorder.record([pose(0.0, t_s)])
        for going, sweep in (("up", angles), ("down", angles[::-1])):
            for angle_rad in sweep:
                t_s += 1.0
                measured = angle_rad + OFF[going] * force_n
                row = [force_n * math.sin(measured), force_n * math.cos(measured), 0.0, force_n, measured]
                recorder.event(Tick(t_s), state="RESTING", next_state="RECORDING")
                recorder.record([pose(angle_rad, t_s)])
                rows = np.tile(row, (20, 1))
                recorder.record([SampleBlock("signals.tip", round(t_s * 1000), t_s, rows, rate_hz=1000.0)])
                recorder.event(Tick(t_s + 0.4), state="RECORDING", next_state="LIFTING")
        recorder.end_trial(outcomes[trial - 1] if outcomes else "contact", {})
    recorder.close()
    return open_run(folder.path)


def test_a_sweep_that_was_broken_off_counts_in_no_figure(tmp_path):
    (sweep,) = read_sweeps(
        [write_pointer(tmp_path, (3.0, 1.0, 1.0), outcomes=("fault", "contact", "aborted"))]
    )
    assert (sweep.force_n, len(sweep.trials)) == (1.0, 1)


def test_sweeps_are_read_from_the_recording_force_by_force(tmp_path):
    sweeps = read_sweeps([write_pointer(tmp_path, (3.0, 1.0))])
    assert [sweep.force_n for sweep in sweeps] == [1.0, 3.0]
    for sweep in sweeps:
        assert sweep.pressed_n == pytest.approx(sweep.force_n)
        assert sweep.errors.bias == pytest.approx(0.01 * sweep.force_n)
        assert sweep.errors.largest == pytest.approx(0.03 * sweep.force_n)
        assert sweep.errors.hysteresis == pytest.approx(0.04 * sweep.force_n)


def test_trials_of_one_force_are_pooled_and_each_has_its_own_hysteresis(tmp_path):
    (sweep,) = read_sweeps([write_pointer(tmp_path, (2.0, 2.02)), write_pointer(tmp_path, (1.98,))])
    assert len(sweep.trials) == 3
    # half the trials' touches went one way: pairs are made within a trial, and the widest of the trials' loops counts
    assert sweep.errors.hysteresis == pytest.approx(0.04 * 2.02)


def test_the_page_states_the_error_over_the_whole_range_and_that_a_trial_had_no_touch(tmp_path, undrawn):
    text = text_of(build_report([write_pointer(tmp_path)]))
    rms = math.degrees(math.sqrt(np.mean([0.01**2, 0.03**2, 0.03**2, 0.09**2])))
    assert f"From −57° to +57° the contact's angle is off by {rms:.2f}° " in text
    assert "at most 5.16° (3.0 N)" in text
    assert "1.00 6 +0.57 1.26 1.28 1.72 2.29 0.00" in text
    assert "The simulated tip reads Fn sin θ and Fn cos θ exactly" in text
    text = text_of(build_report([write_pointer(tmp_path, (1.0,), angles=())]))
    assert "No touch was recorded (1 trials began)." in text


def test_figures_of_both_sections_are_saved_for_print(tmp_path):
    runs = [write_weights(tmp_path), write_pointer(tmp_path)]
    build_report(runs, tmp_path / "page")
    names = {path.name for path in (tmp_path / "page" / "figures").rglob("*.svg")}
    assert names == {"fig_6_calibration.svg", "fig_11_theta.svg"}
