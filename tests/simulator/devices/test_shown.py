"""What a column or a counter shows of the bench."""

import numpy as np
import pytest

from config.profile import load_profile
from drivers.core.errors import RefusedError
from drivers.ni_daq.settings import NiDaqSettings
from simulator.devices.ni_daq import DRIFT_PPM, EmulatedNiDaq
from simulator.physics.stage_axis import StageAxis
from tests.refusals import refused

COUNTER = {"inputs": ("ctr0",), "counts": "x4", "unit": "m", "scale": 1e-6, "shows": ("position",)}
FORCE = {"inputs": ("ai0",), "unit": "N", "scale": 2.0, "shows": ("load_cell",)}


def daq(counter, mover=None):
    plant = load_profile("mock/transient").plant
    bench = plant.made(plant.settings)
    if mover is not None:
        bench.mount(mover)
    bench.begin(0.0, 1, 1, {"location": "f"}, plant.settings.model_dump(mode="json"))
    settings = NiDaqSettings(port="mock", rate_hz=1000.0, streams={"force": FORCE, "travel": counter})
    return bench, EmulatedNiDaq(settings, bench)


def test_a_counter_on_the_movers_encoder_counts_while_it_moves():
    axis = StageAxis(acceleration_m_s2=0.5, max_speed_m_s=0.02)
    bench, device = daq(COUNTER, axis)
    assert device.take(0.0)[:, 1].tolist() == [0.0]
    axis.move_to(0.0, 0.002, 0.01)
    bench.on_plan(0.0)
    counts = device.take(0.5)[:, 1]
    times_s = np.arange(1, len(counts) + 1) / (1000.0 * (1.0 + DRIFT_PPM * 1e-6))
    speeding = times_s < 0.02
    cruising = (times_s > 0.02) & (times_s < 0.2)
    assert counts[speeding] == pytest.approx(0.25e6 * times_s[speeding] ** 2, abs=0.5)
    assert counts[cruising] == pytest.approx(1e4 * (times_s[cruising] - 0.01), abs=0.5)
    assert counts[-1] == 2000.0


def test_without_a_mover_it_stands():
    _, device = daq(COUNTER)
    assert not device.take(0.1)[:, 1].any()


def test_a_counter_of_newtons_is_no_place():
    with refused(RefusedError, "ctr0 is in N, and position in m", 'unit = "m"'):
        daq(COUNTER | {"unit": "N"})
