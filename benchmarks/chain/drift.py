"""Does a chain drift? The same second of noise over and over: every later second must equal the second one."""

from __future__ import annotations

import time
from typing import Any

import numpy as np

from benchmarks.chain.scene import DECIMATION, DRIVE_HZ, RATE_HZ
from controller.signals.demodulation import Cic, Fused
from controller.signals.lowpass import cic_taps
from controller.signals.oscillator import Oscillator


def endure(kind: str, frames: int) -> dict[str, Any]:
    """Push at least so many frames of full-scale noise that repeats every second; what differs, and the run time.

    A second holds whole periods of the drive and whole outputs, so that outputs repeat with it, exactly, unless
    something drifts. The last output is computed once more in Python's own integers (cic).
    """
    oscillator = Oscillator(DRIVE_HZ, float(RATE_HZ))
    chain = Cic(0, oscillator, DECIMATION) if kind == "cic" else Fused(0, oscillator, DECIMATION)
    noise = np.random.default_rng(7).integers(-(1 << 23), 1 << 23, (RATE_HZ, 1)).astype(np.int32)
    seconds = -(-frames // RATE_HZ)
    started = time.process_time()
    chain.push(noise, 0)
    first = chain.push(noise, RATE_HZ).values
    differing, last = 0, first
    for second in range(2, seconds):
        last = chain.push(noise, second * RATE_HZ).values
        differing += int(np.count_nonzero(last != first))
    cpu_s = time.process_time() - started
    found: dict[str, Any] = {
        "chain": kind,
        "frames": seconds * RATE_HZ,
        "outputs_that_differ": differing,
        "cpu_s": cpu_s,
    }
    if isinstance(chain, Cic):
        wave = [[int(w) for w in row] for row in chain._table]
        taps = [int(tap) for tap in cic_taps(DECIMATION)]
        begin = RATE_HZ - len(taps)
        exact = [
            sum(t * int(noise[begin + k, 0]) * row[(begin + k) % 12] for k, t in enumerate(taps))
            for row in wave
        ]
        found["last_equals_python_integers"] = [int(value) for value in last[-1]] == exact
        integrators = np.abs(chain._state[:, 0].astype(np.float64)).max()
        found["largest_integrator"] = float(integrators)
    return found
