"""Scenes of the benchmark: a finger that passes at a constant speed, and what filters make of its carrier."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.signal import firwin

from controller.signals.iq import Iq, IqSettings
from drivers.messages import SampleBlock
from drivers.mock.physics.aura import COUNTS
from drivers.mock.physics.aura_drive import FRAME_HZ
from drivers.mock.physics.bench import Bench
from drivers.mock.physics.gripper_part import AuraBenchSettings
from drivers.mock.physics.stage_axis import AxisMotion, Piece
from drivers.mock.wiring import benches

Floats = NDArray[np.float64]
Complexes = NDArray[np.complex128]

DOWN = 96
"""Frames to a sample of the envelope."""

TAPS = 1919
CUT_HZ = 350.0
KAISER = 12.0
"""The reference's filter: 20 ms long, flat within 1e-5 up to 150 Hz, 118 dB down from 550 Hz on."""

EDGE_S = 0.012
"""Longer than half of it: so far from either end of a passage it sees constant speed alone."""


class Passage(AxisMotion):
    """A tool that moves along x at a constant speed, from some instant to another, and stands before and after.

    Args:
        start_s: When it sets off.
        speed_m_s: How fast.
        way_m: How far.
    """

    def __init__(self, start_s: float, speed_m_s: float, way_m: float) -> None:
        super().__init__()
        self.start_s, self.end_s = start_s, start_s + way_m / speed_m_s
        self._way_m = way_m
        self.replace(start_s, [Piece(start_s, 0.0, speed_m_s, 0.0), Piece(self.end_s, way_m, 0.0, 0.0)])

    def place(self, t_s: float, position_m: float) -> None:
        """The passage stays as it is, whatever trial begins."""
        if not self._pieces:
            super().place(t_s, position_m)

    def offsets(self, times_s: Floats) -> Floats:
        """Displacement from the start pose, shape (n, 6)."""
        found = np.zeros((len(times_s), 6))
        found[:, 0] = np.interp(times_s, [self.start_s, self.end_s], [0.0, self._way_m])
        return found


def begun(passage: Passage, **about: Any) -> Bench:
    """A bench at the beginning of its trial, driven at 40 kHz."""
    settings = AuraBenchSettings(scene="ahead", **about)
    bench = benches.aura(settings)
    bench.mount(passage)
    bench.restart()
    bench.begin(0.0, 1, 1, {}, settings.model_dump(mode="json"))
    bench.drive(40_000.0, 0.5)
    return bench


def demodulated(bench: Bench, first: int, n: int) -> Complexes:
    """I and Q of milliseconds `first` to `first + n - 1` from the carrier, by one long filter in double precision.

    Returns:
        Full scale 1.0, shape (n, 2).
    """
    begin = DOWN * first - TAPS // 2
    frames = begin + np.arange(DOWN * (n - 1) + TAPS)
    phase = (40_000 * frames % FRAME_HZ) * (2.0 * np.pi / FRAME_HZ)
    mixed = bench.carrier(begin, len(frames)) * (2.0 / COUNTS * np.exp(-1j * phase))[:, None]
    low_pass = firwin(TAPS, CUT_HZ, fs=float(FRAME_HZ), window=("kaiser", KAISER))
    windows = np.lib.stride_tricks.sliding_window_view(mixed, TAPS, axis=0)[::DOWN]
    return np.asarray(windows @ low_pass, dtype=np.complex128)


def chained(bench: Bench, first: int, n: int, finger: int) -> tuple[Floats, Complexes]:
    """I and Q of a finger through the program's own chain, from the carrier of `n` milliseconds from `first` on.

    Returns:
        Times of the outputs, shape (m,), and the outputs, full scale 1.0, shape (m,).
    """
    chain = Iq("finger", IqSettings(channel=finger))
    counts = bench.carrier(DOWN * first, DOWN * n)
    sound = SampleBlock(
        "audio.fingers", DOWN * first, first / 1000.0, counts, rate_hz=float(FRAME_HZ), scale=1.0 / COUNTS
    )
    (block,) = [block for block in chain.push(sound) if isinstance(block, SampleBlock)]
    return block.times, block.physical @ np.array([1.0, 1.0j])
