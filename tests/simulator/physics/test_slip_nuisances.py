"""What real recordings have beside slip, on the fingertip's plant."""

import numpy as np
import pytest

from simulator.physics.fingertip_settings import SlipBenchSettings
from simulator.physics.slip import SENSORS, SlipNuisances, SlipPlant

FINGERTIP = SENSORS["fingertip"]
FT = FINGERTIP.model_copy(update={"bridges": FINGERTIP.bridges[-1:], "rolling_n": 0.0})
NOISE_V = FT.bridges[0].noise


def shown(seconds=8.0, press_m=-1e-3, speed_m_s=0.0, changed=None, **nuisances):
    """The bridge and the plant, after an arm at constant speed."""
    settings = FT.model_copy(update={"nuisances": SlipNuisances(**nuisances), **(changed or {})})
    plant = SlipPlant(settings)
    plant.begin(key=(3, 1), press_m=press_m)
    n = round(seconds * settings.rate_hz)
    t_s = np.arange(1, n + 1) / settings.rate_hz
    return plant.advance(speed_m_s * t_s, np.full(n, press_m), np.zeros(n))[:, 0], plant


@pytest.mark.parametrize("factor", [1.2, 3.0])
def test_the_noise_changes_at_its_time_and_not_before(factor):
    quiet, _ = shown()
    louder, _ = shown(noise_factor=factor, change_s=4.0)
    assert np.array_equal(louder[:3999], quiet[:3999])
    assert np.std(louder[4000:]) == pytest.approx(factor * NOISE_V, rel=0.03)


def test_a_hum_is_switched_on_at_its_frequencies():
    values, _ = shown(hum=3.0, change_s=4.0)
    power = np.abs(np.fft.rfft(values[4000:])) ** 2
    assert sorted(np.argsort(power)[-3:] / 4.0) == [160.0, 320.0, 480.0]
    assert np.std(values[4000:]) == pytest.approx(np.hypot(1.0, 3.0) * NOISE_V, rel=0.03)
    assert np.std(values[:4000]) == pytest.approx(NOISE_V, rel=0.03)


def test_a_coarse_converter_leaves_few_levels():
    values, _ = shown(converter=2.0)
    assert np.allclose(values / (2.0 * NOISE_V), np.rint(values / (2.0 * NOISE_V)), atol=1e-9)
    assert len(np.unique(np.rint(values / (2.0 * NOISE_V)))) <= 5


def test_heavy_tails_put_two_percent_beyond_three_standard_deviations_of_the_middle():
    values, _ = shown(seconds=100.0, tails=1.4)
    sigma = np.median(np.abs(values)) / 0.6745
    assert np.mean(np.abs(values) > 3.0 * sigma) == pytest.approx(0.02, rel=0.25)


def test_a_tremor_is_there_under_load_alone():
    assert np.std(shown(tremor_n=0.05)[0]) == pytest.approx(NOISE_V, rel=0.03)
    loaded = shown(press_m=1e-2, tremor_n=0.05)[0][1000:]
    assert np.std(loaded) == pytest.approx(0.05 * FT.bridges[0].gain, rel=0.1)


def test_a_bump_bounces_as_often_as_it_is_set_ever_weaker():
    at_rest = {
        "bridges": (FT.bridges[0].model_copy(update={"noise": 0.0, "step": 0.0, "hysteresis": 0.0}),),
        "damping_ratio": 0.3,
    }
    once, _ = shown(press_m=1e-2, changed={**at_rest, "bumps_hz": 1.0})
    thrice, _ = shown(
        press_m=1e-2, changed={**at_rest, "bumps_hz": 1.0}, bounces=2, bounce_s=0.1, bounce_ratio=0.5
    )
    expected = once.copy()
    expected[100:] += 0.5 * once[:-100]
    expected[150:] += 0.25 * once[:-150]
    assert np.ptp(once) > 0.05
    assert np.allclose(thrice, expected, atol=1e-3 * np.ptp(once))


def test_smooth_friction_changes_more_often_than_it_is_sampled():
    patches = [
        np.mean(np.abs(np.diff(plant.slid_m[2000:])) / (FT.patch_m / factor))
        for factor, plant in ((f, shown(4.0, 1e-3, 0.01, smoothness=f)[1]) for f in (1.0, 10.0))
    ]
    assert patches[0] < 1.0
    assert patches[1] > 3.0


def test_a_table_that_moves_slides_under_a_tip_that_stands():
    _, plant = shown(2.0, 1e-3, table_m_s=0.01)
    assert np.diff(plant.slid_m[1000:]).mean() == pytest.approx(-1e-5, rel=0.05)


def test_a_bench_hands_its_nuisances_to_its_sensor():
    bench = SlipBenchSettings.model_validate({"nuisances": {"hum": 3.0, "hum_hz": [100.0]}})
    assert bench.of("fingertip").nuisances == SlipNuisances(hum=3.0, hum_hz=(100.0,))
    assert SlipBenchSettings().of("wrist").nuisances == SlipNuisances()
