"""Counter-based noise: the published bijection, a standard normal, and nothing that depends on order."""

import numpy as np
import pytest

from simulator.physics.noise import gaussian_at, normal, philox

WORDS = [
    # known answers for philox4x32-10, from Random123's kat_vectors
    ((0, 0, 0, 0), (0, 0), (0x6627E8D5, 0xE169C58D, 0xBC57AC4C, 0x9B00DBD8)),
    ((0xFFFFFFFF,) * 4, (0xFFFFFFFF,) * 2, (0x408F276D, 0x41C83B0E, 0xA20BC7C6, 0x6D5451FD)),
    (
        (0x243F6A88, 0x85A308D3, 0x13198A2E, 0x03707344),
        (0xA4093822, 0x299F31D0),
        (0xD16CFE09, 0x94FDCCEB, 0x5001E420, 0x24126EA1),
    ),
]


def gaussian(key, stream, first, n):
    return gaussian_at(key, stream, np.arange(first, first + n, dtype=np.int64))


@pytest.mark.parametrize(("counter", "key", "expected"), WORDS)
def test_philox_gives_the_published_answers(counter, key, expected):
    assert tuple(int(word) for word in philox(*(np.uint64(word) for word in (*counter, *key)))) == expected


def test_the_noise_is_standard_normal():
    from scipy.stats import kstest  # a second to load: for this test alone

    sample = gaussian((7, 3), 0, 0, 200_000)
    assert kstest(sample, "norm").pvalue > 1e-3
    assert abs(np.corrcoef(sample[:-1], sample[1:])[0, 1]) < 4 / np.sqrt(sample.size)


def test_skipping_and_order_change_no_sample():
    whole = gaussian((7, 3), 2, -50, 1000)
    assert np.array_equal(gaussian((7, 3), 2, 313, 17), whole[363:380])
    order = np.random.default_rng(1).permutation(1000)
    assert np.array_equal(gaussian_at((7, 3), 2, order - 50), whole[order])
    assert normal(7, 3, 2, 900) == whole[950]


@pytest.mark.parametrize(("key", "stream"), [((8, 3), 2), ((7, 4), 2), ((7, 3), 1), ((7 + 2**40, 3), 2)])
def test_another_seed_trial_or_stream_is_other_noise(key, stream):
    a, b = gaussian((7, 3), 2, 0, 20_000), gaussian(key, stream, 0, 20_000)
    assert abs(np.corrcoef(a, b)[0, 1]) < 4 / np.sqrt(a.size)
