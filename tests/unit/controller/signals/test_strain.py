"""Bridges in, forces out."""

import numpy as np
import pytest

from controller.signals.strain import CHANNELS, Strain, StrainSettings
from drivers.core.messages import SampleBlock, Saturated

GAINS = np.array([0.0694, 0.0326, 1.0291])
COUNT_V = 20.0 / 2**16


def block(forces_n, seq=0, rate_hz=1000.0):
    counts = np.rint(np.asarray(forces_n) * GAINS / COUNT_V).astype(np.int32)
    return SampleBlock(
        "board.fingertip", seq, seq / rate_hz, counts, rate_hz=rate_hz, unit="V", scale=COUNT_V, arrival_s=9.0
    )


def strain(**settings):
    return Strain("tip", StrainSettings(**settings))


def test_forces_normal_force_and_angle_come_out_of_the_bridges():
    (made,) = strain().push(block([[3.0, 4.0, 0.5], [-2.0, 2.0, -0.5]]))
    assert made.stream == "signals.tip"
    assert strain().info.channels == CHANNELS == ("Fx", "Fy", "Ft", "Fn", "theta_rad")
    # half a count of the converter is 2, 5 and 0.15 mN
    expected = [[3.0, 4.0, 0.5, 5.0, np.arctan2(3.0, 4.0)], [-2.0, 2.0, -0.5, np.sqrt(8.0), -np.pi / 4]]
    assert made.values == pytest.approx(np.array(expected), abs=0.006)
    assert (made.seq, made.t0_s, made.rate_hz, made.arrival_s) == (0, 0.0, 1000.0, 9.0)


def test_offsets_are_subtracted():
    (made,) = strain(offset_v=(0.0694, 0.0, 0.0)).push(block([[2.0, 1.0, 0.0]]))
    assert made.values[0, 0] == pytest.approx(1.0, abs=0.006)


@pytest.mark.parametrize("size", [1, 2, 7, 50])
@pytest.mark.parametrize(("bridge", "limit_n"), [(0, 10.0), (1, 10.0), (2, 1.5)])
def test_an_overload_of_any_bridge_is_reported_once_however_the_samples_are_cut(size, bridge, limit_n):
    forces_n = np.zeros((50, 3))
    forces_n[10:30, bridge] = -1.05 * limit_n
    forces_n[40:, bridge] = 1.05 * limit_n
    signal = strain()
    overloads = [
        thing
        for start in range(0, 50, size)
        for thing in signal.push(block(forces_n[start : start + size], seq=start))
        if isinstance(thing, Saturated)
    ]
    assert [(one.t_s, one.stream) for one in overloads] == [
        (pytest.approx(0.012), "signals.tip"),
        (pytest.approx(0.042), "signals.tip"),
    ]
    assert [one.value for one in overloads] == pytest.approx([-1.05 * limit_n, 1.05 * limit_n], rel=0.01)


def test_a_spike_and_the_range_that_was_tested_are_no_overload():
    forces_n = np.zeros((20, 3))
    forces_n[5:7] = 50.0
    forces_n[10:] = [7.0, 7.0, 1.0]
    assert len(strain().push(block(forces_n))) == 1


def test_a_gap_restarts_the_count():
    signal = strain()
    over = block([[11.0, 0.0, 0.0]] * 2)
    after = block([[11.0, 0.0, 0.0]] * 2, seq=100)
    assert len(signal.push(over)) == len(signal.push(after)) == 1


def test_a_stream_with_other_channels_is_refused_in_one_line():
    wrong = SampleBlock("board.flexible", 0, 0.0, np.zeros((4, 1)), rate_hz=1000.0)
    with pytest.raises(ValueError, match=r"board\.flexible: 1 channels .* three bridges"):
        strain().push(wrong)
