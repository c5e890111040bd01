"""The echo of docs/explanation/aura.md (2), evaluated with 40 digits, beside what the compiled field gives."""

import numpy as np
import pytest
from mpmath import mp, mpc, mpf

from simulator.physics.aura_kernel import HALF_LENGTH_M, HALF_WIDTH_M, Air, AuraThing, reflected

WAVE_RAD_M = 2.0 * np.pi * 40_000.0 / 343.2


def exact(gap_m, y_m, z_m, wave_rad_m, strength, thing, air):
    """u / (1 - beta u) by the page's equation, shares of the pad as lengths over lengths."""
    with mp.workdps(40):
        gap, y, z, k = mpf(gap_m), mpf(y_m), mpf(z_m), mpf(wave_rad_m)
        width, length = mpf(HALF_WIDTH_M), mpf(HALF_LENGTH_M)
        depth, top, bottom = mpf(thing.half_depth_m), mpf(thing.top_m), mpf(thing.bottom_m)
        across = min(depth, y + width) - max(-depth, y - width)
        along = min(top, z + length) - max(bottom, z - length)
        edge = mpf(air.edge)
        a_y = mpf(strength) * (edge + (1 - edge) * max(across, mpf(0)) / (2 * width))

        def sent(d, at):
            level = (1 + d / mpf(air.decay_m)) ** -mpf(air.decay_power) * mp.exp(-2 * mpf(air.loss_np_m) * d)
            return level * mp.sqrt(mpf(thing.radius_m) / (mpf(thing.radius_m) + d)) * mp.expj(-2 * k * at)

        u = mpc(0)
        if along > 0:
            d = mp.hypot(gap, mp.hypot(min(across, mpf(0)), mpf(0)))
            u += a_y * along / (2 * length) * sent(d, d)
        aside = mp.hypot(gap, max(mpf(0), abs(y) - depth - width))
        for end in (top, bottom):
            d = mp.hypot(aside, z - end)
            u += a_y * edge * sent(d, d)
        return complex(u / (1 - mpf(air.bounce) * u))


def worst(points, wave_rad_m, air, thing):
    """Largest difference, as a share of the echo."""
    found = []
    for gap_m, y_m, z_m in points:
        expected = exact(gap_m, y_m, z_m, wave_rad_m, 0.9, thing, air)
        found.append(abs(reflected(gap_m, y_m, z_m, wave_rad_m, 0.9, thing, air) - expected) / abs(expected))
    return max(found)


AIR = Air(decay_m=0.01, decay_power=2.0, loss_np_m=0.15, bounce=0.5, edge=0.1)
THING = AuraThing(strength=1.0, half_depth_m=0.02, bottom_m=-0.05, top_m=0.06, radius_m=0.03)
RNG = np.random.default_rng(4)


@pytest.mark.parametrize("reach_m", [1e-6, 0.06, 10.0])
def test_the_echo_is_exact_from_a_micrometre_to_ten_metres(reach_m):
    """Ten metres are 2,300 turns: 15,000 rad, each good to 1e-16 of it."""
    points = RNG.uniform((0.0, -0.05, -0.1), (reach_m, 0.05, 0.1), (150, 3))
    assert worst(points, WAVE_RAD_M, AIR, THING) < 1e-11


@pytest.mark.parametrize("ends", [(0.0, 0.0, 1e6), (0.99, 1.0, 1e-6), (0.99, 0.5, 0.03)])
def test_it_is_at_the_ends_of_its_constants(ends):
    bounce, edge, radius_m = ends
    air, thing = AIR._replace(bounce=bounce, edge=edge), THING._replace(radius_m=radius_m)
    points = RNG.uniform((0.0, -0.01, -0.04), (0.05, 0.01, 0.04), (150, 3))
    assert worst(points, WAVE_RAD_M, air, thing) < 1e-11


def test_it_is_where_the_pad_passes_the_objects_edge():
    """The share that faces it begins with the last bit: no jump beyond rounding."""
    edge_m = THING.half_depth_m + HALF_WIDTH_M
    points = [(0.01, np.nextafter(edge_m, side), 0.0) for side in (0.0, 1.0)] + [(0.01, edge_m, 0.0)]
    assert worst(points, WAVE_RAD_M, AIR, THING) < 1e-11
    heights = [reflected(*point, WAVE_RAD_M, 0.9, THING, AIR) for point in points]
    assert max(abs(one - other) for one in heights for other in heights) < 1e-14
