"""The 96 kHz chain beside scipy's strongest: packed bytes of two channels to I and Q of both at 1 kHz.

`python -m benchmarks chain`. The rivals get their filters, and the drive's wave as a table that is
valid from the first frame on, ready made. results/chain.md keeps an earlier run with more rivals, in blocks, over 1e9
frames (chain_rivals.json).
"""

import os
from collections.abc import Callable, Sequence
from functools import partial
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from benchmarks.results import save, side_by_side_s
from controller.signals.demodulation import Cic, Fused, Oscillator, cic_taps, cosine_taps
from drivers.audio.codec import pack24, unpack24

RATE_HZ, OUTPUT_HZ, DRIVE_HZ, FINGERS = 96_000, 1000, 40_000.0, 2
DECIMATION = RATE_HZ // OUTPUT_HZ

FRAME = 96_000_000
"""Number of the first frame: a multiple of the decimation."""

UNDULATIONS = ((0.01, 7.0), (0.005, 70.0))
"""Full scales and Hz: a finger at 0.03 m/s, and one at 0.3 m/s. Assumption: 1 % of full scale."""

LEVELS = ((0.25 + 0.1j, 1.0), (-0.1 + 0.2j, -1.0))
"""Of each finger: the envelope's mean, full scale 1, and the direction in which undulations turn."""

OFFSET, HUM = 0.01, (0.01, 50.0)
"""The converter's offset, and mains that gets into the cable, full scales and Hz (assumption)."""

CUTOFF_HZ = 100.0
"""Of the Butterworth rival: undulations have frequencies below it (Rupavatharam et al., III.C)."""

SOSFILT, FIRWIN = "sosfilt, Butterworth of order 6 at 100 Hz", "firwin of 577 taps + upfirdn"
"""The rivals; the goal names the first."""

FIR_TAPS = 577
"""Of firwin: as long as ours, and odd, so that its delay is a whole number of frames."""

SETTLED_S = 0.2
"""Outputs before are not scored: filters ring in, at both ends of a sound."""

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]


class Chain(NamedTuple):
    """One way from sound to envelopes.

    Attributes:
        name: For tables.
        run: Packed counts, uint8 of shape (n, 6) → envelopes of both fingers, shape (m, 2), full scale 1.
        first_frame: Frame to which the first output refers, counted from the sound's first frame.
        delay_s: From the frame to which an output refers to the last frame that it needs; for an IIR its group delay
            at 0 Hz.
    """

    name: str
    run: Callable[[NDArray[np.uint8]], Complexes]
    first_frame: float
    delay_s: float


def envelope(finger: int, t_s: NDArray[np.float64]) -> Complexes:
    """True envelope of a finger, full scale 1."""
    mean, direction = LEVELS[finger]
    turns = [size * np.exp(direction * 2j * np.pi * hz * t_s) for size, hz in UNDULATIONS]
    return np.asarray(mean + np.sum(turns, axis=0))


def _drive(frames: int) -> Complexes:
    """The drive's wave from the first frame on; its phase is zero at frame 0."""
    numbers = np.arange(FRAME, FRAME + frames, dtype=np.int64)
    return Oscillator(DRIVE_HZ, float(RATE_HZ)).wave(numbers)


def sound(seconds: float) -> NDArray[np.uint8]:
    """Both fingers' sound as a converter of 24 bits packs it, shape (n, 6)."""
    n = round(seconds * RATE_HZ)
    wave, t_s = _drive(n), np.arange(n) / RATE_HZ
    stray = OFFSET + HUM[0] * np.sin(2.0 * np.pi * HUM[1] * t_s)
    signal = np.column_stack([(envelope(finger, t_s) * wave).real + stray for finger in range(FINGERS)])
    counts = np.rint(signal * 2.0**23).astype(np.int32)
    return np.frombuffer(pack24(counts), np.uint8).reshape(n, 3 * FINGERS)


def ours(name: str, demodulators: Sequence[Fused | Cic], taps: int) -> Chain:
    """One of the program's chains; its tables are built once."""

    def run(packed: NDArray[np.uint8]) -> Complexes:
        for demodulator in demodulators:
            demodulator.reset()
        parts = [demodulator.push(packed, FRAME).values for demodulator in demodulators]
        values = parts[0] if len(parts) == 1 else np.hstack(parts)
        return (values * (demodulators[0].scale * 2.0**-23)).view(np.complex128)

    half = 0.5 * (taps - 1)
    return Chain(name, run, -(-taps // DECIMATION) * DECIMATION - 1 - half, half / RATE_HZ)


def theirs(frames: int) -> list[Chain]:
    """The two strongest chains from scipy, for a sound of so many frames."""
    sos = signal.butter(6, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    fir = signal.firwin(FIR_TAPS, 0.5 * OUTPUT_HZ, fs=RATE_HZ, window=("kaiser", 8.0))
    wave = _drive(frames) * 2.0**-22
    cosine, minus_sine = wave.real.copy(), -wave.imag

    def chain(name: str, delay_s: float, low_pass: Callable[[Floats], Floats]) -> Chain:
        def run(packed: NDArray[np.uint8]) -> Complexes:
            counts = unpack24(packed.reshape(-1)).reshape(-1, FINGERS).T
            return np.column_stack([low_pass(x * cosine) + 1j * low_pass(x * minus_sine) for x in counts])

        return Chain(name, run, -delay_s * RATE_HZ, delay_s)

    _, near_zero = signal.sosfreqz(sos, [0.1], fs=RATE_HZ)
    delay_s = float(-np.angle(near_zero[0]) / (2.0 * np.pi * 0.1))  # at 0 Hz the phase's slope
    half_s = 0.5 * (FIR_TAPS - 1) / RATE_HZ
    return [
        chain(SOSFILT, delay_s, lambda x: np.asarray(signal.sosfilt(sos, x))[::DECIMATION]),
        chain(FIRWIN, half_s, lambda x: np.asarray(signal.upfirdn(fir, x, down=DECIMATION))),
    ]


def error_dbfs(chain: Chain, z: Complexes, seconds: float) -> float:
    """Largest error of any finger against the true envelope at the time to which each output refers."""
    t_s = (chain.first_frame + DECIMATION * np.arange(len(z))) / RATE_HZ
    scored = (t_s > SETTLED_S) & (t_s < seconds - SETTLED_S)
    worst = max(np.abs(z[scored, finger] - envelope(finger, t_s[scored])).max() for finger in range(FINGERS))
    return float(20.0 * np.log10(worst))


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    seconds, rounds = (4.0, 3) if quick else (10.0, 30)
    packed = sound(seconds)
    drive, fir = Oscillator(DRIVE_HZ, float(RATE_HZ)), len(cosine_taps(DECIMATION))
    chains = [
        ours("ours, fused FIR, both in one pass", [Fused((0, 1), drive, DECIMATION)], fir),
        ours("ours, fused FIR, one after the other", [Fused((k,), drive, DECIMATION) for k in (0, 1)], fir),
        ours("ours, integer CIC", [Cic(k, drive, DECIMATION) for k in (0, 1)], len(cic_taps(DECIMATION))),
        *theirs(len(packed)),
    ]
    works = [(lambda: None, partial(chain.run, packed)) for chain in chains]
    taken = side_by_side_s(works, rounds).min(axis=0).tolist()
    rival_s = taken[[chain.name for chain in chains].index(SOSFILT)]
    rows = [
        {
            "chain": chain.name,
            "times_real_time": seconds / taken_s,
            "times_sosfilt": rival_s / taken_s,
            "delay_ms": 1e3 * chain.delay_s,
            "error_envelope_dbfs": error_dbfs(chain, chain.run(packed), seconds),
        }
        for chain, taken_s in zip(chains, taken, strict=True)
    ]
    found = {"simulated": True, "sound_s": seconds, "load": os.getloadavg()[0], "chains": rows}
    save("chain", found, quick=quick)
