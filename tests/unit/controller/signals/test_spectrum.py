import numpy as np
import pytest

from controller.signals.spectrum import BlockCutter, block_peaks


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
    power, frequency_hz = block_peaks(block[None, :, None], 1000.0)
    expected_power, expected_hz = defined_peak(block, 1000.0)
    assert power[0] == pytest.approx(expected_power, rel=1e-12)
    assert frequency_hz[0] == expected_hz


@pytest.mark.parametrize("sizes", [[1] * 200, [7] * 29, [200], [63, 1, 65, 71]])
def test_blocks_do_not_depend_on_how_samples_arrive(sizes):
    values = np.random.default_rng(2).standard_normal((203, 2))
    cutter, start, ends, blocks = BlockCutter(64), 0, [], []
    for size in sizes:
        found, complete = cutter.push(values[start : start + size])
        ends += (start + found).tolist()
        blocks.append(complete)
        start += size
    assert ends == [63, 127, 191]
    assert np.array_equal(np.concatenate(blocks), values[:192].reshape(3, 64, 2))


def test_after_a_reset_the_next_sample_begins_a_block():
    cutter = BlockCutter(4)
    cutter.push(np.ones((3, 1)))
    cutter.reset()
    assert cutter.push(np.ones((4, 1)))[0].tolist() == [3]


@pytest.mark.parametrize("bad", [np.nan, np.inf])
def test_a_value_that_is_not_finite_spoils_its_own_block_only(bad):
    blocks = np.random.default_rng(3).standard_normal((3, 4, 1))
    blocks[1, 1] = bad
    power, frequency_hz = block_peaks(blocks, 1000.0)
    assert np.isnan(power).tolist() == np.isnan(frequency_hz).tolist() == [False, True, False]


def test_a_block_of_one_sample_is_refused():
    with pytest.raises(ValueError, match="longer"):
        BlockCutter(1)
