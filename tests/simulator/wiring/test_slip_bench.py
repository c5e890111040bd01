"""The slip bench: what an arm does to the tip, and what five sensors, the arm and the truth make of it."""

import numpy as np
import pytest

from drivers.core.errors import RefusedError
from simulator.physics.fingertip_part import slip_bench
from simulator.physics.fingertip_settings import CONVERTER_V, FINGER, MATRIX, PLANTS, SlipBenchSettings
from simulator.physics.slip_track import PAUSE_S, SlipTruth, Track

RADIUS_M = 0.012


class Path:
    """A tool that is led: down at 2 mm/s from 0 to `deep_m`, then rolls, then slides, by times."""

    def __init__(self, deep_m=0.0035, roll_rad=0.6, slide_m=0.02, offset_s=0.0):
        self.deep_m, self.roll_rad, self.slide_m, self.offset_s = deep_m, roll_rad, slide_m, offset_s

    def place(self, t_s, position_m):
        pass

    def offsets(self, times_s):
        t_s = np.asarray(times_s) - self.offset_s
        found = np.zeros((len(t_s), 6))
        found[:, 2] = -np.clip(0.002 * t_s, 0.0, self.deep_m)
        found[:, 4] = self.roll_rad * np.clip((t_s - 2.5) / 2.0, 0.0, 1.0)
        found[:, 0] = RADIUS_M * found[:, 4] + self.slide_m * np.clip((t_s - 5.0) / 2.0, 0.0, 1.0)
        return found


def bench_of(sensor="fingertip", path=None, origin_s=0.0, **plant):
    bench = slip_bench(SlipBenchSettings())
    path = path or Path()
    path.offset_s = origin_s
    bench.mount(path)
    bench.begin(origin_s, 3, 1, {"sensor": sensor}, {"radius_m": RADIUS_M, **plant})
    return bench


def recorded(bench, until_s=8.0, step_s=0.005, rate_hz=1000.0, read=None):
    """Samples read as a device would, turn by turn."""
    read = read or (lambda times_s: bench.sample("fingertip", times_s))
    origin_s = bench.t_s
    parts, last = [], 0
    for turn in range(1, round(until_s / step_s) + 1):
        bench.advance(origin_s + turn * step_s)
        now = int(np.floor(turn * step_s * rate_hz + 1e-6))
        parts.append(read(origin_s + np.arange(last + 1, now + 1) / rate_hz))
        last = now
    return np.concatenate(parts)


def test_the_bridges_show_the_press_at_the_angle_of_the_tip():
    bench = bench_of(noise_scale=0.0)
    volts = recorded(bench, until_s=4.8)
    rolled = volts[4600:4790, :2] / [0.0694, 0.0326]
    # 0.5 mm into 5 kN/m at 0.6 rad; hysteresis is 6 % of 7 N and rolling does not press.
    assert rolled.mean(axis=0) == pytest.approx([2.5 * np.sin(0.6), 2.5 * np.cos(0.6)], abs=0.2)
    assert np.allclose(volts / CONVERTER_V, np.rint(volts / CONVERTER_V)), "whole counts of the converter"


def test_it_knows_when_contact_and_slip_really_began():
    bench = bench_of()
    recorded(bench)
    assert bench.contacts == [(pytest.approx(1.501, abs=1e-9), True)]
    (begin_s, began), (end_s, ended) = bench.slips
    assert (began, ended) == (True, False)
    # 10 mm/s against a spring of 0.2/1.2 of 12.8 kN/m until the friction of 2.5 N breaks: 0.5 N, 0.24 mm, 24 ms.
    assert 5.015 < begin_s < 5.04
    assert end_s == pytest.approx(7.0, abs=0.02)


def test_rolling_along_by_radius_times_angle_does_not_slip_and_less_does():
    assert bench_and_slips(Path(slide_m=0.0)) == []
    skidding = Path(slide_m=0.0)
    straight = skidding.offsets
    vars(skidding)["offsets"] = lambda times_s: straight(times_s) * [0.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    slips = bench_and_slips(skidding)
    assert slips, "the tip turns on the spot: its skin slides"
    assert 2.5 < slips[0][0] < 4.5


def bench_and_slips(path):
    bench = bench_of(path=path)
    bench.advance(8.0)
    return list(bench.slips)


@pytest.mark.parametrize("sensor", PLANTS)
def test_neither_turns_nor_the_time_of_beginning_change_what_is_felt(sensor):
    def felt(step_s, origin_s):
        bench = bench_of(sensor, origin_s=origin_s)
        volts = recorded(bench, 6.0, step_s)
        shifted = [(round(t_s - origin_s, 6), began) for t_s, began in bench.slips]
        return volts, shifted

    volts, slips = felt(0.005, 0.0)
    other_volts, other_slips = felt(0.125, 0.0)
    assert np.array_equal(volts, other_volts)
    assert slips == other_slips
    later_volts, later_slips = felt(0.005, 100.0)
    assert slips == later_slips
    assert np.allclose(volts, later_volts, atol=2 * CONVERTER_V)


def test_the_table_presses_the_tool_up_and_holds_it_back():
    bench = bench_of(rolling_scale=0.0)
    wrench = recorded(bench, 6.5, rate_hz=500.0, read=lambda times_s: bench.wrench(times_s, (0.0, 0.0, -1.0)))
    pressed, sliding = wrench[1100:1200], wrench[2750:3200]
    assert pressed[:, 2] == pytest.approx(2.5, abs=1e-9)
    assert sliding[:, 0].mean() == pytest.approx(-0.2 * 2.5, abs=0.05), "friction 0.2, against the motion"
    assert not wrench[:, 3:].any()
    assert not wrench[:700].any(), "in the air"


@pytest.mark.parametrize("sensor", PLANTS)
def test_the_sensors_that_the_tip_does_not_carry_feel_nothing(sensor):
    bench = bench_of(sensor)
    bench.advance(4.0)
    times_s = np.arange(3000, 4000) / 1000.0
    felt = {
        "fingertip": float(np.abs(bench.sample("fingertip", times_s)[:, :2]).mean()) / 0.02,
        "flexible_finger": float(np.std(bench.sample("flexible", times_s))) / 0.0025,
        "barrett_finger": float(np.std(bench.forces_n(FINGER, times_s))) / 0.024,
        "dsa": float(bench.texels_v(times_s[::10]).max()) / 0.05,
    }
    assert {name for name, share in felt.items() if share > 1.0} == {sensor} - {"wrist"}
    # noise, as slip_sensors has it: 2 mV, and 5 mV at 0.24 V/N
    if sensor != "flexible_finger":
        assert np.std(bench.sample("flexible", times_s)) == pytest.approx(0.002, rel=0.1)
    assert np.std(bench.forces_n(12, times_s)) == pytest.approx(0.005 / 0.24, rel=0.1)


def test_the_patch_on_the_matrix_lies_in_its_middle_and_wanders_as_the_tip_rolls():
    bench = bench_of("dsa")
    bench.advance(4.8)
    shown = bench.texels_v(np.array([2.4, 4.75])).reshape(2, MATRIX.rows, MATRIX.columns)
    rows = (shown.sum(axis=2) * np.arange(MATRIX.rows)).sum(axis=1) / shown.sum(axis=(1, 2))
    assert rows[0] == pytest.approx((MATRIX.rows - 1) / 2, abs=0.2)
    assert rows[1] - rows[0] == pytest.approx(RADIUS_M * 0.6 / MATRIX.texel_m, abs=0.3)
    # half of the plant's 500 mV/N of 2.5 N lies between two rows, exp(-1/8) of it on each
    assert shown[0].max() == pytest.approx(0.5 * 2.5 * np.exp(-0.125), abs=0.05)


def test_a_weight_on_a_bridge_reads_as_its_force_and_goes_away_but_for_the_hysteresis():
    bench = bench_of(path=Path(deep_m=0.0), noise_scale=0.0)
    readings = []
    for number, force_n in enumerate((0.0, 5.0, 7.0, 5.0, 0.0)):
        bench.load("x", force_n)
        bench.advance(0.1 * (number + 1))
        readings.append(bench.sample("fingertip", np.array([bench.t_s]))[0])
    volts = np.array(readings)
    assert volts[2, 0] == pytest.approx(0.0694 * 7.0, rel=0.06)
    # 6 % of 7 N at 0.0694 V/N between loading and unloading, at most
    assert 0.5 * 0.06 < (volts[3, 0] - volts[1, 0]) / (0.0694 * 7.0) < 1.05 * 0.06
    assert np.abs(volts[:, 1:]).max() < 2 * CONVERTER_V, "nothing hangs on the others"


def test_a_weight_needs_the_fingertip_and_an_arm_is_needed_to_slide():
    with pytest.raises(RefusedError, match="the tip carries wrist"):
        bench_of("wrist").load("x", 1.0)
    bench = slip_bench(SlipBenchSettings())
    with pytest.raises(RefusedError, match="cannot slide and roll"):
        bench.mount(object())
    with pytest.raises(RefusedError, match="no such sensor"):
        bench.begin(0.0, 1, 1, {"sensor": "whisker"}, {})


def test_bumps_and_another_structure_reach_the_plant():
    settings = SlipBenchSettings(bumps_hz=2.0, mode_scale=1.3, damping_scale=3.0, friction=0.4)
    tip, nominal = settings.of("fingertip"), SlipBenchSettings().of("fingertip")
    assert (tip.bumps_hz, tip.friction) == (2.0, 0.4)
    assert tip.mode_hz == pytest.approx(1.3 * 180.0)
    assert tip.damping_ratio == pytest.approx(3.0 * nominal.damping_ratio)
    assert tip.mass_kg * tip.mode_hz**2 == pytest.approx(nominal.mass_kg * nominal.mode_hz**2), (
        "its stiffness stays"
    )


def test_the_track_keeps_the_latest_samples_and_holds_between_them():
    track = Track(100.0, 1)
    for start in range(0, 1000, 250):
        track.push(np.arange(start + 1, start + 251, dtype=float)[:, None])
    assert track.at(np.array([9.999, 10.0, 10.7])).ravel().tolist() == [999.0, 1000.0, 1000.0]
    assert track.at(np.array([0.5])).item() == 601.0, "what is no longer kept reads as the oldest"


def test_a_pause_ends_a_slip_and_a_new_contact_is_none():
    truth = SlipTruth(1000.0, 5.0)
    pause = int(PAUSE_S * 1000) + 10
    slid = np.concatenate([[0.0, 0.0, 0.3, 0.3], [0.3, 0.4, 0.4, 0.5], np.full(pause, 0.5), [0.6]])
    normal = np.concatenate([[0.0, 0.0], np.ones(len(slid) - 2)])
    truth.follow(np.arange(1, len(slid) + 1), slid, normal)
    assert truth.contacts == [(5.003, True)]
    last = 5.0 + len(slid) / 1000.0
    assert [began for _, began in truth.slips] == [True, False, True, False]
    assert [t_s for t_s, _ in truth.slips] == pytest.approx([5.006, 5.008, last, last])


def test_the_account_is_of_all_trials():
    bench = bench_of()
    bench.advance(1.0)
    bench.begin(1.0, 3, 2, {"sensor": "dsa"}, {"radius_m": RADIUS_M})
    bench.advance(3.0)
    assert bench.account() == {"computed": {"fingertip": 1000, "dsa": 200}}
