"""The aura's bench: where fingers and object are, what touches what, and that no cadence changes a sample."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.signal import firwin

from drivers.core.errors import RefusedError
from drivers.core.messages import Floats
from simulator.physics.aura import COUNTS, LEFT, RIGHT
from simulator.physics.aura_part import aura_bench
from simulator.physics.bench import Bench
from simulator.physics.gripper_part import AuraBenchSettings
from simulator.physics.stage_axis import AxisMotion

PIPE_M = 0.01905
SURFACE_M = 0.055


class Tool:
    """Straight ways in time: displacement along base axes at some instants, shape (n, 3)."""

    def __init__(
        self, times_s: list[float], places_m: list[tuple[float, float, float]], yaws_rad: Any = None
    ) -> None:
        self._times_s = times_s
        self._places_m = np.array(places_m)
        self._yaws_rad = np.zeros(len(times_s)) if yaws_rad is None else np.array(yaws_rad)

    def place(self, t_s: float, position_m: float) -> None:
        """The way stays as it is."""

    def offsets(self, times_s: Floats) -> Floats:
        """Shape (n, 6)."""
        found = np.zeros((len(times_s), 6))
        for axis in range(3):
            found[:, axis] = np.interp(times_s, self._times_s, self._places_m[:, axis])
        found[:, 5] = np.interp(times_s, self._times_s, self._yaws_rad)
        return found


def begun(tool: Any, trial: int = 1, factors: dict[str, Any] | None = None, **about: Any) -> Bench:
    """A bench at the beginning of a trial, its drive on."""
    settings = AuraBenchSettings(**about)
    bench = aura_bench(settings)
    bench.mount(tool)
    bench.restart()
    bench.begin(0.0, 7, trial, factors or {}, settings.model_dump(mode="json"))
    bench.drive(40_000.0, 0.5)
    return bench


def pressing(speed_m_s: float = 0.01) -> Tool:
    """0.5 mm into what is 55 mm ahead, a second there, and back."""
    arrival_s = 1.0 + (SURFACE_M + 0.0005) / speed_m_s
    far = (SURFACE_M + 0.0005, 0.0, 0.0)
    here = (0.0, 0.0, 0.0)
    return Tool([1.0, arrival_s, arrival_s + 1.0, 2.0 * arrival_s], [here, far, far, here])


def samples(bench: Bench, until_s: float, turn_s: float) -> Any:
    """The envelope, read at every turn."""
    parts, known = [], 0
    for turn in range(1, round(until_s / turn_s) + 1):
        last = round(turn * turn_s * 1000.0)
        bench.advance(last / 1000.0)
        parts.append(bench.baseband(np.arange(known + 1, last + 1) / 1000.0))
        known = last
    return np.concatenate(parts)


def test_contact_begins_and_ends_where_the_finger_reaches_the_surface() -> None:
    bench = begun(pressing(), scene="ahead")
    bench.advance(15.0)
    # 55 mm at 10 mm/s after a second's rest; back at the surface 0.5 mm after it set off again
    assert [made for _, made in bench.contacts] == [True, False]
    assert [t_s for t_s, _ in bench.contacts] == pytest.approx([6.5, 7.6], abs=0.002)
    assert bench.finger_contacts == (bench.contacts, [])


@pytest.mark.parametrize("turn_s", [0.001, 0.013, 1.5])
def test_turns_of_any_length_give_the_same_samples(turn_s: float) -> None:
    expected = samples(begun(pressing(), scene="ahead"), 7.8, 0.1)
    found = samples(begun(pressing(), scene="ahead"), 7.8, turn_s)
    assert len(found) in (7800, 7500)
    assert (found == expected[: len(found)]).all()


def test_samples_are_the_same_after_a_time_without_a_subscriber() -> None:
    expected = samples(begun(pressing(), scene="ahead"), 7.0, 0.1)
    deaf = begun(pressing(), scene="ahead")
    deaf.advance(6.4)
    deaf.advance(7.0)
    assert deaf.account()["computed"] == {"envelope": 0, "carrier": 0}
    assert (deaf.baseband(np.arange(6401, 7001) / 1000.0) == expected[6400:7000]).all()
    assert deaf.account()["computed"] == {"envelope": 1200, "carrier": 0}


def test_an_unwired_finger_is_not_computed_and_the_other_reads_the_same() -> None:
    both, right = (begun(pressing(), scene="ahead", **wired) for wired in ({}, {"wired": ("right",)}))
    expected, found = samples(both, 7.0, 0.1), samples(right, 7.0, 0.1)
    assert (found[:, RIGHT] == expected[:, RIGHT]).all()
    assert not found[:, LEFT].any()
    counts, alone = (bench.carrier(96 * 6500, 9600) for bench in (both, right))
    assert (alone[:, RIGHT] == counts[:, RIGHT]).all()
    assert not alone[:, LEFT].any()
    assert both.account()["computed"] == {"envelope": 14_000, "carrier": 19_200}
    assert right.account()["computed"] == {"envelope": 7_000, "carrier": 9_600}


def test_trials_differ_in_noise_alone_and_a_trial_repeats_itself() -> None:
    first, again, other = (samples(begun(pressing(), trial, scene="ahead"), 2.0, 0.1) for trial in (1, 1, 2))
    assert (first == again).all()
    assert (first != other).all()


def test_nothing_there_is_nothing_touched() -> None:
    bench = begun(pressing(), factors={"object": "none"}, scene="ahead")
    bench.advance(8.0)
    assert bench.contacts == []
    assert not bench.wrench(np.array([7.0]), (1.0, 0.0, 0.0)).any()


def test_the_arm_feels_what_the_finger_is_pressed_with() -> None:
    bench = begun(pressing(), scene="ahead")
    bench.advance(7.0)
    wrench = bench.wrench(np.array([6.0, 6.52, 6.9]), (1.0, 0.0, 0.0))
    # 2 N/mm: nothing before, 0.2 mm deep, 0.5 mm deep; against the motion
    assert wrench[:, 0] == pytest.approx([0.0, -0.4, -1.0], abs=0.03)
    assert not wrench[:, 1:].any()


def test_both_fingers_distances_follow_the_tool() -> None:
    bench = begun(Tool([0.0, 1.0], [(0.0, 0.0, 0.0), (0.005, 0.0, 0.0)]), object_x_m=0.002)
    bench.advance(2.0)
    gap_m = 0.5 * (0.063 - PIPE_M)  # jaws of 15 mm brackets open 48 mm wider
    found = bench.distances(np.array([0.001, 1.5]))
    # forward takes the left finger towards the object
    assert found[0] == pytest.approx([gap_m - 0.002, gap_m + 0.002], abs=1e-5)
    assert found[1] == pytest.approx([gap_m + 0.003, gap_m - 0.003], abs=1e-12)


def test_an_object_slides_before_one_finger_and_stays_where_it_was_pushed() -> None:
    gap_m = 0.5 * (0.063 - PIPE_M)
    there = (gap_m + 0.003, 0.0, 0.0)
    bench = begun(Tool([0.0, 2.5, 5.0], [(0.0, 0.0, 0.0), there, (0.0, 0.0, 0.0)]))
    bench.advance(5.5)
    assert bench.finger_contacts[RIGHT] == []
    assert [made for _, made in bench.finger_contacts[LEFT]] == [True, False]
    # pushed 3 mm forward, which is farther from the left finger
    assert bench.distances(np.array([5.4]))[0] == pytest.approx([gap_m - 0.003, gap_m + 0.003], abs=1e-5)


def calibrated(bench: Bench) -> float:
    """Let the gripper find its ends and open; returns when it has."""
    bench.jaws.calibrate()
    bench.jaws.advance(5.0)
    assert bench.jaws.calibrated
    bench.jaws.go(0.0, 40_000.0, 300.0)
    bench.jaws.advance(8.0)
    return 8.0


def gripping(turn_s: float) -> Bench:
    """Above the object until 8 s, then down over it, then the jaws close on it at 10 s until 11.5 s."""
    above, down = (0.0, 0.0, 0.1), (0.002, 0.0, 0.0)
    bench = begun(Tool([8.0, 9.9], [above, down]))
    calibrated(bench)
    now_s = 8.0
    closing = False
    while now_s < 11.4:
        now_s = round(now_s + turn_s, 9)
        if now_s > 10.0 and not closing:
            bench.jaws.advance(10.0)
            bench.jaws.go(1.0, 20_000.0, 300.0)
            closing = True
        bench.jaws.advance(now_s)
    bench.advance(11.5)
    return bench


def test_jaws_close_fully_above_an_object_and_on_it_where_it_is() -> None:
    above = begun(Tool([0.0], [(0.0, 0.0, 0.1)]))
    calibrated(above)
    assert above.contacts == []
    bench = gripping(0.01)
    # a stop of 300 mA x 0.0462 N/mA, within friction, squeezes 20 N/mm
    assert bench.jaws.width_m == pytest.approx(PIPE_M - 13.86 / 2e4, abs=1e-4)
    assert [made for _, made in bench.contacts] == [True, True]
    (first_s, _), (second_s, _) = bench.contacts
    assert bench.finger_contacts[LEFT][0][0] == first_s < second_s
    force_n = bench.jaws.contact_n
    assert force_n == pytest.approx(13.86, abs=0.6)
    assert bench.wrench(np.array([11.4]), (1.0, 0.0, 0.0))[0] == pytest.approx(np.zeros(6), abs=1e-12)


@pytest.mark.parametrize("turn_s", [0.001, 0.0137, 0.3])
def test_turns_of_any_length_grip_the_same(turn_s: float) -> None:
    expected, found = gripping(0.01), gripping(turn_s)
    times_s = np.arange(10_001, 11_500) / 1000.0
    assert (found.baseband(times_s) == expected.baseband(times_s)).all()
    assert found.contacts == expected.contacts


def test_what_is_held_goes_along_and_contact_ends_when_the_jaws_open() -> None:
    above, down, aside = (0.0, 0.0, 0.1), (0.0, 0.0, 0.0), (0.01, 0.0, 0.0)
    bench = begun(Tool([8.0, 9.9, 12.0, 13.0], [above, down, down, aside]))
    calibrated(bench)
    bench.jaws.advance(10.0)
    bench.jaws.go(1.0, 20_000.0, 300.0)
    bench.jaws.advance(14.0)
    bench.jaws.go(0.0, 20_000.0, 300.0)
    bench.jaws.advance(16.0)
    assert [made for _, made in bench.contacts] == [True, True, False, False]
    right_m, left_m = bench.distances(np.array([15.9]))[0]
    assert right_m == pytest.approx(left_m, abs=3e-4)


def test_a_restart_leaves_nothing_of_the_trial_before() -> None:
    bench = gripping(0.01)
    bench.restart()
    bench.begin(0.0, 7, 1, {}, AuraBenchSettings().model_dump(mode="json"))
    assert bench.jaws.width_m == 0.063
    assert not bench.jaws.calibrated
    assert bench.contacts == []
    bench.advance(0.01)
    assert np.abs(bench.baseband(np.array([0.005]))).max() < 1e-4  # silence but for noise


def test_carrier_and_envelope_agree_without_noise() -> None:
    quiet = {"noise_fs_rthz": 0.0, "motion_fs": 0.0}
    bench = begun(pressing(), scene="ahead", **quiet)
    bench.advance(6.4)
    taps, down = 1919, 96
    first = 96 * 4000
    counts = bench.carrier(first - taps // 2, 96 * 2000 + taps - 1)
    frames = np.arange(first - taps // 2, first + 96 * 2000 + taps // 2)
    mixed = 2.0 * counts[:, RIGHT] / COUNTS * np.exp(-2j * np.pi * ((5 * frames) % 12) / 12.0)
    low_pass = firwin(taps, 350.0, fs=96_000.0, window=("kaiser", 12.0))
    chain = np.array([mixed[k * down : k * down + taps] @ low_pass for k in range(2000)])
    ideal = bench.baseband(np.arange(4000, 6000) / 1000.0)[:, RIGHT]
    error_db = 20.0 * np.log10(np.abs(chain - ideal).max() / np.abs(ideal - ideal.mean()).max())
    assert error_db < -60.0


@pytest.mark.parametrize("parts", [1, 7])
def test_frames_are_the_same_in_blocks_of_any_length(parts: int) -> None:
    bench = begun(pressing(), scene="ahead")
    bench.advance(2.0)
    whole = bench.carrier(96 * 1500, 9600)
    cuts = np.linspace(0, 9600, parts + 1).astype(int)
    pieces = [bench.carrier(96 * 1500 + a, b - a) for a, b in pairwise(cuts.tolist())]
    assert (np.concatenate(pieces) == whole).all()


def test_silence_and_sweeps_begin_at_the_benchs_present_time() -> None:
    bench = begun(Tool([0.0], [(0.0, 0.0, 0.0)]), noise_fs_rthz=0.0)
    bench.advance(1.0)
    bench.silence()
    bench.advance(2.0)
    bench.chirp(20_000.0, 46_000.0, 1.0, 0.5)
    bench.advance(4.0)
    size = np.abs(bench.baseband(np.array([0.9, 1.1, 2.77, 2.1, 3.1])))[:, RIGHT]
    assert size[0] > 0.01
    assert size[1] == size[4] == 0.0
    assert size[2] > 5.0 * size[3]  # near 40 kHz at 0.77 s of the sweep, far from it at 0.1 s


def test_a_mover_of_one_axis_is_refused() -> None:
    bench = aura_bench(AuraBenchSettings())
    with pytest.raises(RefusedError, match="moves along one axis alone"):
        bench.mount(AxisMotion())


def test_a_second_mover_is_refused() -> None:
    bench = begun(Tool([0.0], [(0.0, 0.0, 0.0)]))
    with pytest.raises(RefusedError, match="another mover carries it already"):
        bench.mount(Tool([0.0], [(0.0, 0.0, 0.0)]))


def test_an_unknown_object_is_refused_with_a_list_of_those_there_are() -> None:
    bench = begun(Tool([0.0], [(0.0, 0.0, 0.0)]))
    with pytest.raises(RefusedError, match="choose one of pipe, mug"):
        bench.begin(0.0, 7, 1, {"object": "teapot"}, AuraBenchSettings().model_dump(mode="json"))


def test_brackets_cannot_change_within_a_run() -> None:
    bench = begun(Tool([0.0], [(0.0, 0.0, 0.0)]))
    with pytest.raises(RefusedError, match="closed_width_m holds for all trials"):
        bench.begin(0.0, 7, 1, {}, AuraBenchSettings(closed_width_m=0.02).model_dump(mode="json"))


def test_half_a_turn_of_the_wrist_puts_each_finger_where_the_other_was() -> None:
    """Forward the left finger comes to the pipe, with the wrist turned the right one. A pipe 10 mm along the axis is in
    the middle between fingers that have turned by a quarter."""
    far = [(0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (0.025, 0.0, 0.0)]
    straight, turned = (
        begun(Tool([0.0, 1.0, 4.0], far, [0.0, yaw, yaw]), closed_width_m=0.015, object_x_m=0.0, lean_rad=0.0)
        for yaw in (0.0, np.pi)
    )
    for bench in (straight, turned):
        bench.advance(2.0)
    at = np.array([1.999])
    assert turned.distances(at)[0] == pytest.approx(straight.distances(at)[0, ::-1], abs=1e-12)
    for bench in (straight, turned):
        bench.advance(4.0)
    right, left = straight.finger_contacts
    assert len(left) == 1
    assert not right
    assert turned.finger_contacts == (left, right)
    half_way = begun(Tool([0.0, 1.0], [(0.0, 0.0, 0.0)] * 2, [0.0, np.pi]), object_x_m=0.01, lean_rad=0.0)
    half_way.advance(1.0)
    assert half_way.distances(np.array([0.5]))[0] == pytest.approx((0.063 - PIPE_M) / 2.0, abs=1e-9)
