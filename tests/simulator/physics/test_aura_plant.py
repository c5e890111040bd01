"""The aura's physics: what the paper states of it, and what follows from the equations by hand."""

import math
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from controller.signals.transducer import analyse
from drivers.core.messages import Floats
from simulator.physics.aura import COUNTS, LEFT, RIGHT, AuraMotion, AuraPlant, plate_echo
from simulator.physics.aura_part import aura_bench
from simulator.physics.aura_settings import (
    OBJECTS,
    SIDES,
    SIX,
    SOFT,
    AuraPlantSettings,
    EchoSettings,
    RoomSettings,
)
from simulator.physics.gripper_part import AuraBenchSettings

HALF_WAVE_M = 343.2 / 40_000.0 / 2.0
"""Half a wavelength in air of 20 degrees, where sound makes 343.2 m/s: 4.29 mm."""

QUIET: dict[str, Any] = {
    "noise_fs_rthz": 0.0,
    "motion_fs": 0.0,
    "drift_fs": 0.0,
    "gain_scatter_db": 0.0,
    "phase_scatter_rad": 0.0,
}


def motion(
    gap_m: Floats, left_m: Floats | None = None, force_n: float = 0.0, speed_m_s: float = 0.0
) -> AuraMotion:
    """The right finger at these distances, the left one blind unless it has its own."""
    n = len(gap_m)
    gaps_m = np.column_stack([gap_m, np.full(n, np.inf) if left_m is None else left_m])
    zeros = np.zeros(n)
    forces_n = np.column_stack([np.full(n, force_n), zeros])
    return AuraMotion(gaps_m, zeros, zeros, np.full(n, 0.063), forces_n, np.full(n, speed_m_s), zeros)


def plant(thing: str | None = "pipe", side: Any = "normal", trial: int = 1, **changed: Any) -> AuraPlant:
    """A plant before an object."""
    made = AuraPlant(AuraPlantSettings(**changed))
    made.begin((1, trial), None if thing is None else OBJECTS[thing], 0.03, side)
    return made


def seen(
    one: AuraPlant, moved: AuraMotion, hz: float = 40_000.0, level: float = 1.0
) -> NDArray[np.complex128]:
    """Its field, both fingers, all at the trial's first instant."""
    n = len(moved.y_m)
    return one.field(moved, np.zeros(n), np.full(n, hz), np.full(n, level))


def change(gap_m: Floats, **about: Any) -> NDArray[np.complex128]:
    """What the right finger's output has more at these distances than before nothing."""
    changed = QUIET | about
    thing, side = changed.pop("thing", "pipe"), changed.pop("side", "normal")
    with_it = seen(plant(thing, side, **changed), motion(gap_m))
    without = seen(plant(None, side, **changed), motion(gap_m))
    return (with_it - without)[:, RIGHT]


def spacing_m(gap_m: Floats, signal: Floats) -> float:
    """Mean distance between neighbouring maxima."""
    inner = signal[1:-1]
    tops = gap_m[1:-1][(inner > signal[:-2]) & (inner > signal[2:])]
    return float(np.mean(np.diff(tops)))


GAPS_M = np.linspace(0.02, 0.055, 7001)


def test_undulations_come_every_half_wavelength() -> None:
    # the decay moves maxima a little; the phase turns once every half wavelength
    turns = np.unwrap(np.angle(change(GAPS_M, bounce=0.0, edge=0.0))) / (2.0 * np.pi)
    assert abs(turns[-1] - turns[0]) == pytest.approx((0.055 - 0.02) / HALF_WAVE_M, rel=2e-4)
    assert spacing_m(GAPS_M, change(GAPS_M).real) == pytest.approx(HALF_WAVE_M, rel=0.02)


def test_warm_air_stretches_them_with_the_root_of_its_temperature() -> None:
    def turned(temperature_k: float) -> float:
        found = change(GAPS_M, bounce=0.0, edge=0.0, temperature_k=temperature_k)
        phase = np.unwrap(np.angle(found))
        return float(phase[-1] - phase[0])

    assert turned(293.15) / turned(313.15) == pytest.approx((313.15 / 293.15) ** 0.5, rel=1e-9)


@pytest.mark.parametrize("side", SIDES)
def test_every_side_sees_more_the_nearer_it_comes(side: str) -> None:
    size = np.abs(change(np.array([0.055, 0.03, 0.015, 0.004]), side=side, bounce=0.0, edge=0.0))
    assert (np.diff(size) > 0.0).all()
    assert size[0] > 0.0


def test_the_top_sees_and_feels_least() -> None:
    near = {side: abs(change(np.array([0.004]), side=side)[0]) for side in SIDES}
    assert min(near, key=near.__getitem__) == "top"
    settings = AuraPlantSettings()
    assert min(settings.sides, key=lambda side: settings.sides[side].coupling_fs) == "top"


def test_soft_things_send_back_less_than_any_of_the_six() -> None:
    size = {thing: np.abs(change(GAPS_M, thing=thing)).mean() for thing in (*SIX, *SOFT)}
    assert max(size[thing] for thing in SOFT) < min(size[thing] for thing in SIX)


def test_contact_shifts_the_level_with_the_force_and_no_further_than_it_can() -> None:
    one = plant(**QUIET)
    rest = seen(one, motion(np.zeros(1)))[0, RIGHT]

    def shift(force_n: float) -> complex:
        return complex(seen(one, motion(np.zeros(1), force_n=force_n))[0, RIGHT] - rest)

    full = shift(100.0)
    assert abs(full) == pytest.approx(AuraPlantSettings().sides["normal"].coupling_fs, rel=1e-9)
    assert abs(shift(AuraPlantSettings().force_n)) == pytest.approx(0.6321 * abs(full), rel=1e-4)
    assert shift(0.0) == 0.0


def test_the_left_finger_does_not_feel_what_presses_the_right_one() -> None:
    one = plant(**QUIET)
    free, pressed = (seen(one, motion(np.zeros(1), force_n=force_n))[0, LEFT] for force_n in (0.0, 10.0))
    assert free == pressed


def test_two_fingers_at_one_frequency_hardly_disturb_each_other() -> None:
    gap_m = np.linspace(0.005, 0.04, 500)
    between = motion(gap_m, 0.044 - gap_m)
    alone = seen(plant(cross_fs=0.0, **QUIET), between)[:, RIGHT]
    both = seen(plant(**QUIET), between)[:, RIGHT]
    swing = np.abs(alone - alone.mean()).max()
    assert 0.0 < np.abs((both - both.mean()) - (alone - alone.mean())).max() < 0.1 * swing


def test_mismatch_is_the_ratio_of_the_fingers() -> None:
    gap_m = np.full(1, 0.01)
    alike = {**QUIET, "imbalance_fs": (0.2, 0.2), "imbalance_rad": (0.5, 0.5)}
    right, left = seen(plant(mismatch_db=1.5, **alike), motion(gap_m, gap_m))[0]
    assert 20.0 * np.log10(abs(right) / abs(left)) == pytest.approx(1.5, abs=1e-9)


def test_a_finger_transfers_best_at_40_khz_in_a_band_that_its_quality_gives() -> None:
    frequency_hz = np.arange(20_000.0, 46_000.0, 10.0)
    power = np.abs(plant().response(RIGHT, frequency_hz)) ** 2
    assert frequency_hz[power.argmax()] == 40_000.0
    band_hz = np.ptp(frequency_hz[power >= 0.5])
    assert band_hz == pytest.approx(40_000.0 / AuraPlantSettings().quality, abs=20.0)


def test_the_imbalance_wanders_as_far_as_specified_and_slowly() -> None:
    times_s = np.arange(0.0, 600.0, 0.1)
    ends, steps = [], []
    for trial in range(60):
        one = plant(None, trial=trial, **(QUIET | {"drift_fs": 5e-4}))
        n = len(times_s)
        found = one.field(motion(np.full(n, np.inf)), times_s, np.full(n, 40_000.0), np.ones(n), (RIGHT,))[
            :, RIGHT
        ]
        ends.append(found[[0, -1]].real)
        steps.append(np.abs(np.diff(found)).max())
    assert np.std(np.array(ends) - np.mean(ends)) == pytest.approx(5e-4, rel=0.2)
    assert max(steps) < 0.1 * 5e-4


def test_a_drive_on_another_clock_turns_the_envelope_by_the_difference() -> None:
    times_s = np.arange(0.0, 5.0, 0.01)
    n = len(times_s)
    one = plant(None, drive_ppm=20.0, **QUIET)
    found = one.field(motion(np.full(n, np.inf)), times_s, np.full(n, 40_000.0), np.ones(n))[:, RIGHT]
    turns = np.unwrap(np.angle(found)) / (2.0 * np.pi)
    assert (turns[-1] - turns[0]) / times_s[-1] == pytest.approx(0.8, rel=1e-9)


def envelope(one: AuraPlant, numbers: NDArray[np.int64], speed_m_s: float = 0.01) -> Any:
    """Noisy envelope of both fingers at half drive, coming nearer."""
    times_s = numbers / 1000.0
    n = len(numbers)
    moved = motion(0.055 - 0.01 * times_s, speed_m_s=speed_m_s)
    return one.envelope(moved, numbers, times_s, np.full(n, 40_000.0), np.full(n, 0.5))


def test_the_preamplifiers_noise_has_the_colour_and_size_that_were_set() -> None:
    quiet = {key: value for key, value in QUIET.items() if key != "noise_fs_rthz"}
    one = plant(None, noise_colour=0.24, **quiet)
    found = envelope(one, np.arange(200_000), speed_m_s=0.0)
    i = found[:, RIGHT].real - found[:, RIGHT].real.mean()
    assert np.mean(i[1:] * i[:-1]) / np.mean(i**2) == pytest.approx(0.24, abs=0.01)
    assert np.mean(i[2:] * i[:-2]) / np.mean(i**2) == pytest.approx(0.0, abs=0.01)
    # at frequencies far below 1 kHz: twice the converter's density, for both sidebands fall there
    slow = i.reshape(-1, 100).mean(axis=1)
    assert np.var(slow) / 5.0 == pytest.approx(2.0 * (5e-7) ** 2, rel=0.1)


def test_motion_makes_noise_and_rest_makes_none() -> None:
    one = plant(None, **(QUIET | {"motion_fs": 2e-4}))
    numbers = np.arange(100_000)
    still, slow, fast = (
        np.std(envelope(one, numbers, speed_m_s)[:, RIGHT].real) for speed_m_s in (0.0, 0.01, 0.04)
    )
    assert still == pytest.approx(0.0, abs=1e-12)
    assert slow == pytest.approx(1e-4, rel=0.02)
    assert fast == pytest.approx(2e-4, rel=0.02)


def carrier(one: AuraPlant, first: int, n: int, **about: float) -> NDArray[np.int32]:
    """Counts at half drive, the right finger at rest 1 cm from the pipe."""
    frames = np.arange(first, first + n)
    phase = 2.0 * np.pi * ((5 * frames) % 12) / 12.0
    moved = motion(np.full(n, 0.01), **about)
    return one.carrier(moved, frames, 0.0, np.full(n, 40_000.0), np.full(n, 0.5), phase)


def test_the_carrier_holds_the_same_field_to_half_a_count() -> None:
    one = plant(**QUIET)
    field = 0.5 * seen(one, motion(np.full(1, 0.01)))[0]
    counts = carrier(one, 7, 1200)
    phase = 2.0 * np.pi * ((5 * np.arange(7, 1207)) % 12) / 12.0
    expected = COUNTS * (field * np.exp(1j * phase)[:, None]).real
    assert np.abs(counts - expected).max() <= 0.5 + 1e-6


def test_too_loud_a_carrier_is_clipped_as_a_converter_does() -> None:
    counts = carrier(plant(imbalance_fs=(3.0, 0.1), **QUIET), 0, 120)
    assert counts[:, RIGHT].max() == COUNTS - 1
    assert counts[:, RIGHT].min() == -COUNTS
    assert np.abs(counts[:, LEFT]).max() < 0.1 * COUNTS


# --- a room that is less kind ----------------------------------------------------------------------


def in_room(x_m: Floats, speed_m_s: float = 0.01, **room: Any) -> NDArray[np.complex128]:
    """What a room adds to the right finger's output along a way of the tool, at 0.01 m/s, before nothing."""
    n = len(x_m)
    moved = motion(np.full(n, np.inf), speed_m_s=speed_m_s)._replace(x_m=x_m)
    fields = [
        plant(None, **QUIET, room=RoomSettings(**about)).field(
            moved, x_m / 0.01, np.full(n, 40_000.0), np.full(n, 1.0)
        )[:, RIGHT]
        for about in (room, {})
    ]
    return np.asarray(fields[0] - fields[1])


@pytest.mark.parametrize("cosine", [1.0, 0.5, -1.0])
def test_a_still_echo_turns_with_the_way_towards_it_and_grows_with_nearness(cosine: float) -> None:
    x_m = np.arange(0.0, 0.05, 1e-4)
    found = in_room(x_m, echoes=(EchoSettings(size_fs=1e-4, away_m=0.3, cosine=cosine),))
    assert abs(found[0]) == pytest.approx(1e-4)
    turns = np.unwrap(np.angle(found))[-1] - np.angle(found)[0]
    wave_rad_m = 2.0 * math.pi * 40_000.0 / AuraPlantSettings().sound_m_s(293.15)
    assert turns - 2.0 * wave_rad_m * cosine * x_m[-1] == pytest.approx(0.0, abs=1e-6)
    assert abs(found[-1]) / abs(found[0]) == pytest.approx((0.31 / (0.31 - cosine * x_m[-1])) ** 2)


def test_ripple_goes_with_the_way_and_vibration_with_time_while_the_arm_moves() -> None:
    x_m = np.arange(0.0, 0.05, 1e-4)
    ripple = in_room(x_m, ripple_fs=1e-4, ripple_m=0.005)
    assert ripple[50:] == pytest.approx(ripple[:-50], abs=1e-12)
    shaken = in_room(x_m, vibration_fs=1e-4, vibration_hz=10.0)
    assert shaken[10:] == pytest.approx(shaken[:-10], abs=1e-12)
    assert not in_room(x_m, speed_m_s=0.0, vibration_fs=1e-4).any()
    assert np.abs(ripple).max() == pytest.approx(1e-4, rel=0.01)


def test_a_second_path_changes_an_echo_by_its_share_at_the_most() -> None:
    gap_m = np.arange(0.004, 0.055, 1e-4)
    ratio = change(gap_m, room=RoomSettings(second_path=0.1)) / change(gap_m)
    assert np.abs(ratio).max() == pytest.approx(1.1, abs=0.005)
    assert np.abs(ratio).min() == pytest.approx(0.9, abs=0.005)


def test_fingers_scatter_each_by_itself_and_from_trial_to_trial() -> None:
    gains = np.array(
        [
            np.abs(seen(plant(None, trial=i, finger_scatter_db=1.0), motion(np.array([np.inf]))))
            for i in range(400)
        ]
    )
    scatter_db = np.std(20.0 * np.log10(gains[:, 0]), axis=0)
    assert scatter_db == pytest.approx([1.0, 1.0], abs=0.12)


def test_a_pair_with_two_resonances_is_found_between_them_as_sharp_as_it_is() -> None:
    frequency_hz = np.linspace(38_000.0, 43_000.0, 22)
    pair = AuraPlant(AuraPlantSettings(resonance_hz=(40_300.0,) * 2, second_hz=(40_600.0,) * 2, quality=45.0))
    found = analyse(frequency_hz, np.abs(pair.response(RIGHT, frequency_hz)))
    assert 40_400.0 < found.peak_hz < 40_500.0
    assert [one.q for one in found.resonances] == pytest.approx([45.0, 45.0], rel=0.05)


@pytest.mark.parametrize("plate", [(0, 0), (1, 2)])
def test_a_plates_echo_is_what_each_piece_hears_of_the_mirror_image_of_each(plate: tuple[int, int]) -> None:
    wave_rad_m, decay_m = 730.0, 0.01
    y_m, z_m = np.meshgrid(0.003 * np.arange(9), 0.055 / 18 * np.arange(18), indexing="ij")
    shape = np.cos(math.pi * plate[0] * (y_m / 0.003 + 0.5) / 9) * np.cos(
        math.pi * plate[1] * (z_m / (0.055 / 18) + 0.5) / 18
    )

    def heard(gap_m: float) -> complex:
        total = 0j
        for y, z, moves in zip(y_m.ravel(), z_m.ravel(), shape.ravel(), strict=True):
            way_m = np.sqrt((y_m - y) ** 2 + (z_m - z) ** 2 + 4.0 * gap_m**2)
            total += moves * complex((shape * np.exp(-1j * wave_rad_m * way_m) / (way_m + decay_m)).sum())
        point = np.exp(-2j * wave_rad_m * gap_m) / (2.0 * gap_m + decay_m)
        return complex(total / point)

    gaps_m = [0.005, 0.025, 0.06]
    found = plate_echo(plate, np.array(gaps_m), np.full(3, wave_rad_m), decay_m)
    expected = np.array([heard(gap_m) for gap_m in gaps_m])
    assert found == pytest.approx(expected / abs(expected[1]), rel=1e-3)


class Turned:
    """Carries the gripper at its start pose, turned about the approach of the fingers' tips."""

    def __init__(self, turn_rad: float) -> None:
        self.turn_rad = turn_rad

    def offsets(self, times_s: Floats) -> Floats:
        return np.tile([0.0, 0.0, 0.0, 0.0, 0.0, self.turn_rad], (len(times_s), 1))


def test_fingers_with_nothing_before_them_hear_the_same_however_they_are_turned() -> None:
    def heard(turn_rad: float) -> Any:
        settings = AuraBenchSettings(scene="ahead", object="none")
        bench = aura_bench(settings)
        bench.mount(Turned(turn_rad))
        bench.begin(0.0, 1, 1, {}, settings.model_dump(mode="json"))
        bench.drive(40_000.0, 0.5)
        bench.advance(0.05)
        return bench.baseband(np.arange(1, 51) / 1000.0), bench.carrier(0, 960)

    envelope, counts = heard(0.3)
    assert np.abs(envelope).min() > 0.0
    assert (envelope == heard(0.0)[0]).all()
    assert (counts == heard(0.0)[1]).all()
