"""The sections on B6 and B7, from rows and recordings whose answer is known."""

import math
import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from behaviors.events import Tick
from controller.measures import columns_of
from controller.recording.reader import open_run
from controller.recording.recorder import Recorder
from controller.reports.pointer import touched
from controller.reports.report import build_report
from controller.reports.weights import compared
from drivers.core.messages import SampleBlock, StreamInfo
from tests.unit.controller.reports.synthetic_runs import START, begun, text_of, write_rows

STREAMS = {
    "signals.tip": StreamInfo("signals.tip", ("Fx", "Fy", "Ft", "Fn", "theta_rad"), "N", 1.0, 1000.0),
    "arm.pose": StreamInfo("arm.pose", ("x", "y", "z", "rx", "ry", "rz"), "m, rad", 1.0, 500.0),
}
PRINTED = {"x": (0.0694, 0.06, 0.12), "y": (0.0326, 0.048, 0.12), "t": (1.0291, 0.05, 0.01)}


# --- B6 ----------------------------------------------------------------------------------------------


def write_weights(root, *, bench="mock", gains=None, outcome="calibrated"):
    """A series for each bridge: the figures that are printed, or another gain, each within a twentieth."""
    rows = []
    for bridge, (printed, width, smallest_n) in PRINTED.items():
        gain = (gains or {}).get(bridge, printed)
        row = {}
        for name, value in (("gain{}_v_n", gain), ("hysteresis{}", width), ("resolution{}_n", smallest_n)):
            row |= {name.format(end): value * (1.0 + off) for end, off in (("_low", -0.05), ("_high", 0.05))}
            row[name.format("")] = value
        rows.append(({"bridge": bridge}, outcome, row))
    resolved = {"behavior": {"weight_uncertainty": 0.001, "weights_x_n": [1.0, 6.0]}}
    return write_rows(
        begun(root, "weights", bench, resolved, successes=["calibrated"]), rows, columns_of("weights")
    )


def test_the_page_holds_ours_against_the_papers(tmp_path, undrawn):
    text = text_of(build_report([write_weights(tmp_path)]))
    assert "Fernandez" in text
    assert "Fx: gain 0.0 % above the paper's 0.0694 V/N, 0.0694 V/N; the paper's gain," in text
    assert "Fx gain, V/N 0.0694 0.0659 to 0.0729 0.0694 yes" in text
    assert "up to 6 N on Fx (the paper 7 N) and" in text
    assert "Gain, hysteresis and noise of the simulated bridges were set from the figures" in text


def test_a_bridge_of_another_gain_is_reported_to_miss_the_papers(tmp_path, undrawn):
    text = text_of(build_report([write_weights(tmp_path, gains={"y": 0.05})]))
    assert re.search(r"Fy: gain 53\.4 % above the paper's 0\.0326 V/N, 0\.0500 V/N; .*?outside", text)
    assert "agree with our 95 % intervals" in text, "the others do"
    assert "Fy gain, V/N 0.0500 0.0475 to 0.0525 0.0326 no" in text


@pytest.mark.parametrize(
    ("name", "low_name", "printed", "low", "high", "met"),
    [
        ("resolution_n", "resolution_{}_n", "0.12", 0.1164, 0.1196, True),  # 0.1185 is printed as 0.12
        ("resolution_n", "resolution_{}_n", "0.12", 0.1255, 0.13, False),
        ("resolution_n", "resolution_{}_n", "0.12", 0.10, 0.1149, False),
        ("gain_v_n", "gain_{}_v_n", "0.0326", 0.03264, 0.034, True),
        ("gain_v_n", "gain_{}_v_n", "0.0326", 0.0327, 0.034, False),
        ("hysteresis", "hysteresis_{}", "0.06", None, None, False),
    ],
)
def test_a_printed_figure_stands_for_what_is_rounded_to_it(name, low_name, printed, low, high, met):
    row = {name: 0.06, low_name.format("low"): low, low_name.format("high"): high}
    assert compared({name: printed}, row, name).met == met


def test_a_real_bench_is_not_called_simulated_and_series_that_were_not_finished_calibrate_nothing(
    tmp_path, undrawn
):
    assert "simulated" not in text_of(build_report([write_weights(tmp_path, bench="hardware")]))
    text = text_of(build_report([write_weights(tmp_path, outcome="aborted")]))
    assert "No bridge was calibrated to the end (3 trials began)." in text


# --- B7 ----------------------------------------------------------------------------------------------

ANGLES = (-1.0, 0.0, 1.0)
OFF = {"up": -0.01, "down": 0.03}


def write_pointer(root, forces_n=(1.0, 3.0), *, outcomes=None):
    behavior = {"detector": "touch", "forces_stream": "signals.tip", "pose_stream": "arm.pose"}
    settings = {"behavior": behavior | {"angles_rad": list(ANGLES)}}
    folder = begun(root, "pointer", "mock", settings)
    factors, measures = ["detectors.touch.threshold"], columns_of("pointer")
    recorder = Recorder(folder, START, streams=STREAMS, factors=factors, measures=measures)
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
        for going, sweep in (("up", ANGLES), ("down", ANGLES[::-1])):
            for angle_rad in sweep:
                t_s += 1.0
                measured = angle_rad + OFF[going] * force_n
                row = [force_n * math.sin(measured), force_n * math.cos(measured), 0.0, force_n, measured]
                recorder.event(Tick(t_s), state="RESTING", next_state="RECORDING")
                recorder.record([pose(angle_rad, t_s)])
                rows = np.tile(row, (20, 1))
                recorder.record([SampleBlock("signals.tip", round(t_s * 1000), t_s, rows, rate_hz=1000.0)])
                recorder.event(Tick(t_s + 0.4), state="RECORDING", next_state="LIFTING")
        about = {"theta_rms_rad": math.sqrt(0.0005) * force_n, "theta_max_rad": 0.03 * force_n}
        outcome = outcomes[trial - 1] if outcomes else "contact"
        recorder.end_trial(outcome, about | {"touches": 6, "force_n": force_n})
    recorder.close()
    return open_run(folder.path)


def test_a_sweep_is_read_from_the_recording_and_one_that_was_broken_off_counts_in_no_figure(tmp_path):
    ran = ("fault", "contact", "aborted")
    ((row, touches),) = touched([write_pointer(tmp_path, (3.0, 2.0, 1.0), outcomes=ran)])
    assert row["trial"] == 2
    assert [touch.true_rad for touch in touches] == pytest.approx([*ANGLES, *ANGLES[::-1]])
    assert [touch.error_rad for touch in touches] == pytest.approx([-0.02] * 3 + [0.06] * 3)
    assert [touch.force_n for touch in touches] == pytest.approx([2.0] * 6)


def test_the_page_states_the_error_over_the_whole_range_and_that_a_trial_had_no_touch(tmp_path):
    page = build_report([write_pointer(tmp_path)])
    text = text_of(page)
    rms = math.degrees(math.sqrt(np.mean([0.01**2, 0.03**2, 0.03**2, 0.09**2])))
    assert f"From −57° to +57° the contact's angle is off by {rms:.2f}° " in text
    assert "at most 5.16° (3.0 N)" in text
    assert "The simulated tip reads Fn sin θ and Fn cos θ exactly" in text
    assert [path.name for path in (page.parent / "figures").iterdir()] == ["fig_11_theta.svg"]
    text = text_of(build_report([write_pointer(tmp_path, (1.0,), outcomes=("fault",))]))
    assert "No touch was recorded (1 trials began)." in text
