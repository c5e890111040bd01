"""The chains: ours in every variant, and what scipy offers. Each takes packed bytes and gives I + jQ at 1 kHz.

The rivals get all they need ready made: filters, and the drive's wave as a table that is right from the first frame
on. All hear the whole sound at once; ours and sosfilt, which can be told to go on where it stopped, also in blocks of
10 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import signal

from benchmarks.chain.scene import DECIMATION, FINGERS, OUTPUT_HZ, RATE_HZ, Sound
from controller.signals.demodulation import Cic, Fused
from controller.signals.lowpass import cic_taps, cosine_taps
from controller.signals.oscillator import Oscillator
from drivers.audio.codec import unpack24

BLOCK = 960
"""Frames that come at once: 10 ms."""

CUTOFF_HZ = 100.0
"""Of the rivals' low-passes: undulations have frequencies below it (Rupavatharam et al., III.C)."""

FIR_TAPS = 577
"""Of firwin: as long as ours, and odd, so that its delay is a whole number of frames."""

Complexes = NDArray[np.complex128]


class Chain(NamedTuple):
    """One way from sound to envelopes.

    Attributes:
        name: For tables.
        run: All of a sound, some fingers → their envelopes, shape (n, fingers), full scale 1.
        first_frame: What the first output speaks of, counted from the sound's first frame.
        delay_s: From what an output speaks of to the last frame that it needs; for an IIR its group delay at 0 Hz.
        taps: Of its low-pass, where it has such; shape (n,).
        sos: Its sections, where it has such.
        note: What a reader should know.
        in_blocks: Whether it hears blocks of `BLOCK` frames.
    """

    name: str
    run: Callable[[Sound, tuple[int, ...]], Complexes]
    first_frame: float
    delay_s: float
    taps: NDArray[np.float64] | None
    sos: NDArray[np.float64] | None
    note: str = ""
    in_blocks: bool = False


def chains(drive_hz: float, frame: int) -> list[Chain]:
    """All of them, for a drive and a first frame (a multiple of the decimation)."""
    return [*_ours(drive_hz), *_rivals(drive_hz, frame)]


# ours


def _ours(drive_hz: float) -> list[Chain]:
    oscillator = Oscillator(drive_hz, float(RATE_HZ))

    def fused(finger: int) -> Fused:
        return Fused(finger, oscillator, DECIMATION)

    def in_phase(finger: int) -> Fused:
        return Fused(finger, oscillator, DECIMATION, quadrature=False)

    def cic(finger: int) -> Cic:
        return Cic(finger, oscillator, DECIMATION)

    low_pass, sums = cosine_taps(DECIMATION), cic_taps(DECIMATION) / DECIMATION**3
    said: dict[str, tuple[Callable[[int], Fused | Cic], NDArray[np.float64], str]] = {
        "fused": (fused, low_pass, "the default"),
        "cic": (cic, sums, "int64 to the end, no drift"),
        "in_phase": (in_phase, low_pass, "no Q: blind spots"),
    }
    made = []
    for name, (make, taps, note) in said.items():
        half = 0.5 * (len(taps) - 1)
        first = -(-len(taps) // DECIMATION) * DECIMATION - 1 - half
        for in_blocks in (False, True):
            run = _run(make, in_blocks)
            made.append(Chain(f"ours, {name}", run, first, half / RATE_HZ, taps, None, note, in_blocks))
    return made


def _run(
    make: Callable[[int], Fused | Cic], in_blocks: bool
) -> Callable[[Sound, tuple[int, ...]], Complexes]:
    # made once: a chain's tables are not built anew for each sound
    demodulators = [make(finger) for finger in range(FINGERS)]

    def run(heard: Sound, fingers: tuple[int, ...]) -> Complexes:
        columns = []
        for finger in fingers:
            demodulator = demodulators[finger]
            demodulator.reset()
            size = BLOCK if in_blocks else len(heard.packed)
            parts = [
                demodulator.push(heard.packed[start : start + size], heard.frame + start).values
                for start in range(0, len(heard.packed), size)
            ]
            values = np.concatenate(parts) * (demodulator.scale * 2.0**-23)
            columns.append(values.view(np.complex128)[:, 0])
        return np.column_stack(columns)

    return run


# theirs


def _rivals(drive_hz: float, frame: int) -> list[Chain]:
    oscillator = Oscillator(drive_hz, float(RATE_HZ))
    sos = signal.butter(6, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    second = signal.butter(2, CUTOFF_HZ, fs=RATE_HZ, output="sos")
    b, a = signal.butter(2, CUTOFF_HZ, fs=RATE_HZ)
    fir = signal.firwin(FIR_TAPS, 0.5 * OUTPUT_HZ, fs=RATE_HZ, window=("kaiser", 8.0))

    @cache  # made in the round that is not timed
    def table(n: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        wave = oscillator.wave(np.arange(frame, frame + n, dtype=np.int64)) * 2.0**-22
        return wave.real.copy(), -wave.imag

    def by_table(
        heard: Sound, fingers: tuple[int, ...]
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """I and Q before the low-pass."""
        counts = unpack24(heard.packed.reshape(-1)).reshape(-1, FINGERS)
        cosine, minus_sine = table(len(counts))
        return [(counts[:, finger] * cosine, counts[:, finger] * minus_sine) for finger in fingers]

    def filtered(
        low_pass: Callable[[NDArray[np.float64]], NDArray[np.float64]],
    ) -> Callable[[Sound, tuple[int, ...]], Complexes]:
        def run(heard: Sound, fingers: tuple[int, ...]) -> Complexes:
            return np.column_stack([low_pass(i) + 1j * low_pass(q) for i, q in by_table(heard, fingers)])

        return run

    def in_blocks(heard: Sound, fingers: tuple[int, ...]) -> Complexes:
        states = np.zeros((len(fingers), 2, len(sos), 2))
        # a block is a whole number of the drive's periods and of outputs
        cosine, minus_sine = table(BLOCK)
        parts = []
        for start in range(0, len(heard.packed), BLOCK):
            counts = unpack24(heard.packed[start : start + BLOCK].reshape(-1)).reshape(-1, FINGERS)
            part = np.empty((BLOCK // DECIMATION, len(fingers)), np.complex128)
            for place, finger in enumerate(fingers):
                i, states[place, 0] = signal.sosfilt(sos, counts[:, finger] * cosine, zi=states[place, 0])
                q, states[place, 1] = signal.sosfilt(sos, counts[:, finger] * minus_sine, zi=states[place, 1])
                part[:, place] = i[::DECIMATION] + 1j * q[::DECIMATION]
            parts.append(part)
        return np.concatenate(parts)

    def literal(heard: Sound, fingers: tuple[int, ...]) -> Complexes:
        counts = unpack24(heard.packed.reshape(-1)).reshape(-1, FINGERS)
        cosine, _ = table(len(counts))
        columns = [signal.lfilter(b, a, counts[:, finger] * cosine)[::DECIMATION] for finger in fingers]
        return np.column_stack(columns).astype(np.complex128)

    def two_steps(x: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.asarray(signal.decimate(signal.decimate(x, 12, ftype="fir"), 8, ftype="fir"))

    # scipy's own lengths: 20 q + 1 taps a step of `decimate`, 20 down + 1 of `resample_poly`
    two_steps_s = (10 * 12 + 10 * 8 * 12) / RATE_HZ
    butterworth = "Butterworth, order 6, 100 Hz"
    delay_s = _delay_s(sos)
    streamed = Chain("sosfilt, I/Q", in_blocks, -delay_s * RATE_HZ, delay_s, None, sos, butterworth, True)
    return [
        *([streamed] if BLOCK % oscillator.period == 0 else []),
        Chain(
            "sosfilt, I/Q",
            filtered(lambda x: np.asarray(signal.sosfilt(sos, x))[::DECIMATION]),
            -delay_s * RATE_HZ,
            delay_s,
            None,
            sos,
            butterworth,
        ),
        Chain(
            "firwin + upfirdn, I/Q",
            filtered(lambda x: np.asarray(signal.upfirdn(fir, x, down=DECIMATION))),
            -0.5 * (FIR_TAPS - 1),
            0.5 * (FIR_TAPS - 1) / RATE_HZ,
            fir,
            None,
            "577 taps",
        ),
        Chain("decimate, I/Q", filtered(two_steps), 0.0, two_steps_s, None, None, "by 12 and 8, FIR"),
        Chain(
            "resample_poly, I/Q",
            filtered(lambda x: np.asarray(signal.resample_poly(x, 1, DECIMATION))),
            0.0,
            10 * DECIMATION / RATE_HZ,
            None,
            None,
            "its own filter",
        ),
        Chain(
            "literal: cosine, lfilter",
            literal,
            -_delay_s(second) * RATE_HZ,
            _delay_s(second),
            None,
            None,
            "no Q",
        ),
    ]


def _delay_s(sos: NDArray[np.float64]) -> float:
    """Group delay at 0 Hz of sections, s: the slope of their phase near it."""
    small_hz = 0.1
    _, response = signal.sosfreqz(sos, [small_hz], fs=RATE_HZ)
    return float(-np.angle(response[0]) / (2.0 * np.pi * small_hz))
