"""Counter-based Gaussian noise: any sample of any stream, at once and in any order.

Philox4x32-10 (Salmon, Moraes, Dror, Shaw: Parallel random numbers, as easy as 1, 2, 3; SC 2011) is a bijection of a
128-bit counter under a 64-bit key. Key and counter here are made of (seed, trial, stream, index), so what is skipped,
cut into blocks or shared among workers changes no sample.
"""

import math

import numpy as np
from numpy.typing import NDArray

from drivers.core.compiled import compiled

_MASK = np.uint64(0xFFFFFFFF)
_HALF = np.uint64(32)
_MULTIPLIER_0 = np.uint64(0xD2511F53)
_MULTIPLIER_1 = np.uint64(0xCD9E8D57)
_WEYL_0 = np.uint64(0x9E3779B9)
_WEYL_1 = np.uint64(0xBB67AE85)
_ROUNDS = 10
"""Constants and number of rounds of Philox4x32-10, from the paper."""

_TO_UNIT = 2.0**-53


@compiled(inline="always")
def philox(
    c0: np.uint64, c1: np.uint64, c2: np.uint64, c3: np.uint64, k0: np.uint64, k1: np.uint64
) -> tuple[np.uint64, np.uint64, np.uint64, np.uint64]:
    """Four random 32-bit words (in 64-bit integers) for a counter of four and a key of two such words."""
    for _ in range(_ROUNDS):
        product_0 = _MULTIPLIER_0 * c0
        product_1 = _MULTIPLIER_1 * c2
        c0, c1, c2, c3 = (
            (product_1 >> _HALF) ^ c1 ^ k0,
            product_1 & _MASK,
            (product_0 >> _HALF) ^ c3 ^ k1,
            product_0 & _MASK,
        )
        k0 = (k0 + _WEYL_0) & _MASK
        k1 = (k1 + _WEYL_1) & _MASK
    return c0, c1, c2, c3


@compiled()
def normal(seed: int, trial: int, stream: int, index: int) -> float:
    """One standard normal deviate (Box-Muller on 53-bit uniforms): the sample `index` of a stream.

    Args:
        seed: Of the run, 0 to 2^63 - 1.
        trial: Number of the trial, 0 to 2^32 - 1.
        stream: Number of the stream, 0 to 2^32 - 1.
        index: Number of the sample; two's complement where negative.
    """
    radius, angle = _polar(seed, trial, stream, index >> 1)
    return radius * (math.sin(angle) if index & 1 else math.cos(angle))


@compiled(inline="always")
def _polar(seed: int, trial: int, stream: int, number: int) -> tuple[float, float]:
    """Radius and angle of a Box-Muller pair: two neighbours share one block, as its cosine and its sine."""
    u_seed = np.uint64(seed)
    pair = np.uint64(number)
    w0, w1, w2, w3 = philox(
        pair & _MASK,
        pair >> _HALF,
        np.uint64(stream) & _MASK,
        u_seed >> _HALF,
        u_seed & _MASK,
        np.uint64(trial) & _MASK,
    )
    # (0, 1]: the logarithm of zero never occurs
    radius_uniform = (np.float64((w0 << np.uint64(21)) | (w1 >> np.uint64(11))) + 1.0) * _TO_UNIT
    angle_uniform = np.float64((w2 << np.uint64(21)) | (w3 >> np.uint64(11))) * _TO_UNIT
    return math.sqrt(-2.0 * math.log(radius_uniform)), 2.0 * math.pi * angle_uniform


@compiled()
def _fill(seed: int, trial: int, stream: int, indices: NDArray[np.int64], out: NDArray[np.float64]) -> None:
    i = 0
    while i < indices.size:
        index = indices[i]
        radius, angle = _polar(seed, trial, stream, index >> 1)
        out[i] = radius * (math.sin(angle) if index & 1 else math.cos(angle))
        i += 1
        if i < indices.size and index & 1 == 0 and indices[i] == index + 1:
            out[i] = radius * math.sin(angle)
            i += 1


def gaussian_at(key: tuple[int, int], stream: int, indices: NDArray[np.int64]) -> NDArray[np.float64]:
    """Standard normal deviates of a stream at given sample numbers, shape (n,).

    Args:
        key: Seed of the run and number of the trial.
        indices: Numbers of the samples, shape (n,).
    """
    out = np.empty(indices.size)
    _fill(key[0], key[1], stream, indices, out)
    return out
