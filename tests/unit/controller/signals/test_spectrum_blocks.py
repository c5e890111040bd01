import numpy as np
import pytest

from controller.signals.spectrum_blocks import SpectrumBlocks, block_peaks


def defined_peak(block, rate_hz):
    """Section 3 of the paper, literally: equation (3), equation (4), no DC, the largest."""
    n = len(block)
    powers = []
    for k in range(1, n // 2 + 1):
        phi = sum(block[m] * np.exp(-2j * np.pi * k * m / n) for m in range(n))
        powers.append(abs(phi) ** 2 / n)
    best = int(np.argmax(powers))
    return powers[best], (best + 1) * rate_hz / n


@pytest.mark.parametrize("size", [2, 16, 63, 64])
def test_the_peak_is_that_of_the_papers_definition(size):
    block = np.random.default_rng(size).standard_normal(size) + 5.0
    power, frequency_hz = block_peaks(block[None], 1000.0)
    expected_power, expected_hz = defined_peak(block, 1000.0)
    assert power[0] == pytest.approx(expected_power, rel=1e-12)
    assert frequency_hz[0] == expected_hz


def test_a_tone_on_a_bin_has_a_quarter_of_n_times_its_amplitude_squared():
    tone = 3.0 * np.cos(2 * np.pi * 12 * np.arange(64) / 64)
    power, frequency_hz = block_peaks(tone[None], 1000.0)
    assert power[0] == pytest.approx(64 / 4 * 9.0, rel=1e-12)
    assert frequency_hz[0] == 187.5


@pytest.mark.parametrize("sizes", [[1] * 200, [7] * 29, [200], [63, 1, 65, 71]])
def test_blocks_do_not_depend_on_how_samples_arrive(sizes):
    values = np.random.default_rng(2).standard_normal((203, 2))
    whole = SpectrumBlocks(64).push(values, 1000.0)
    assert whole.ends.tolist() == [63, 127, 191]
    blocks, start, powers = SpectrumBlocks(64), 0, []
    ends = []
    for size in sizes:
        found = blocks.push(values[start : start + size], 1000.0)
        ends += (start + found.ends).tolist()
        powers.append(found.power)
        start += size
    assert ends == whole.ends.tolist()
    assert np.array_equal(np.concatenate(powers), whole.power)


def test_after_a_reset_the_next_sample_begins_a_block():
    blocks = SpectrumBlocks(4)
    blocks.push(np.ones((3, 1)), 1000.0)
    blocks.reset()
    assert blocks.push(np.ones((4, 1)), 1000.0).ends.tolist() == [3]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_value_that_is_not_finite_spoils_its_own_block_only(bad):
    values = np.random.default_rng(3).standard_normal((12, 1))
    values[5] = bad
    found = SpectrumBlocks(4).push(values, 1000.0)
    assert np.isnan(found.power[:, 0]).tolist() == [False, True, False]
    assert np.isnan(found.frequency_hz[:, 0]).tolist() == [False, True, False]


def test_a_block_of_one_sample_is_refused():
    with pytest.raises(ValueError, match="no frequency"):
        SpectrumBlocks(1)
