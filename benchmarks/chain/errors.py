"""How wrong a chain is: against its own filter in long arithmetic, and against the true envelope."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from benchmarks.chain.chains import Chain, Complexes
from benchmarks.chain.scene import DECIMATION, ENVELOPES, RATE_HZ, Sound

SETTLED_S = 0.2
"""Outputs before are not scored: filters ring in, at both ends of a sound."""

LONG = np.longdouble
"""80 bits on this machine."""


def decibels(x: NDArray[np.complex128]) -> float:
    """Largest magnitude, dB of full scale."""
    return float(20.0 * np.log10(np.max(np.abs(x)) + 1e-30))


def against_truth(chain: Chain, heard: Sound, z: Complexes) -> float:
    """Largest error of any finger, dBFS, against the envelope at the time that each output speaks of."""
    t_s = (chain.first_frame + DECIMATION * np.arange(len(z))) / RATE_HZ
    scored = (t_s > SETTLED_S) & (t_s < heard.seconds - SETTLED_S)
    worst = -600.0
    for finger in range(z.shape[1]):
        truth = ENVELOPES[finger](t_s[scored])
        if "no Q" in chain.note:
            truth = truth.real.astype(np.complex128)
        worst = max(worst, decibels(z[scored, finger] - truth))
    return worst


def against_long(chain: Chain, heard: Sound, z: Complexes, count: int = 40) -> float | None:
    """Largest error of finger 0, dBFS, against the same low-pass in 80-bit arithmetic; None where there is none."""
    mixed = _mixed(heard)
    if chain.sos is not None:
        from scipy.signal import sosfilt

        sos = chain.sos.astype(LONG)
        n = min(len(mixed), RATE_HZ)
        exact = [sosfilt(sos, part[:n])[::DECIMATION] for part in (mixed.real, mixed.imag)]
        found = exact[0] + 1j * exact[1]
        return decibels((z[: len(found), 0] - found).astype(np.complex128))
    if chain.taps is None:
        return None
    taps = chain.taps.astype(LONG)
    half = 0.5 * (len(taps) - 1)
    errors = []
    for m in np.linspace(10, len(z) - 20, count).astype(int):
        middle = chain.first_frame + DECIMATION * m
        begin = round(middle - half)
        window = mixed[begin : begin + len(taps)]
        exact_z = np.sum(taps * window)
        if "no Q" in chain.note:
            exact_z = exact_z.real
        errors.append(complex(z[m, 0] - exact_z))
    return decibels(np.array(errors))


def _mixed(heard: Sound) -> NDArray[np.clongdouble]:
    """Finger 0 mixed down, phases exact to 80 bits."""
    whole = RATE_HZ * 1000
    frames = np.arange(heard.frame, heard.frame + len(heard.counts), dtype=np.int64) % whole
    cycles = (round(heard.drive_hz * 1000) * frames % whole).astype(LONG) / LONG(whole)
    turn = 2 * LONG("3.14159265358979323846264338327950288") * cycles
    x = heard.counts[:, 0].astype(LONG) * LONG(2.0) ** -22
    return x * (np.cos(turn) - 1j * np.sin(turn))
