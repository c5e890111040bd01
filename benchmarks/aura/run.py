"""Envelope against carrier: time, and the difference; one finger against two; and what nobody hears."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline
from scipy.signal import welch

from benchmarks.aura import figures
from benchmarks.aura.scenes import DOWN, EDGE_S, Passage, begun, chained, demodulated
from benchmarks.results import FOLDER, save, table
from drivers.mock.physics.aura import ENVELOPE_HZ, RIGHT
from drivers.mock.physics.aura_settings import AuraSettings
from drivers.mock.physics.bench import Bench

SPEEDS_M_S = (0.01, 0.03, 0.3)
"""The paper's two (Fig. 4d), and one far beyond them."""

WAY_M = 0.053
"""From 55 mm to 2 mm before the pipe."""

QUIET = {"noise_fs_rthz": 0.0, "motion_fs": 0.0}

TURN_MS = 100
LONG_MS = 1000
"""How much is asked for at once: by a loop that is in no hurry, and by a study."""

BAND_HZ = (5.0, 100.0)
"""Where noise is compared: the band of the undulations, without the slow drift."""


def best_s(work: Callable[[], object], times: int) -> float:
    """Least processor time of some runs of the same work: who else is on the machine matters less to it."""
    taken = []
    for _ in range(times):
        begun_s = time.process_time()
        work()
        taken.append(time.process_time() - begun_s)
    return min(taken)


def rms(error: NDArray[np.complex128]) -> float:
    """Root mean square of what is complex."""
    return float(np.sqrt(np.mean(np.abs(error) ** 2)))


def decibels(amplitude: float) -> float:
    """An amplitude against 1."""
    return 20.0 * float(np.log10(amplitude))


def cost_s(bench: Bench, last: int, times: int) -> dict[str, float]:
    """Processor time of computing the last second of a bench, at each level, in long and in short turns."""
    found = {}
    for name, turn in (("long", LONG_MS), ("short", TURN_MS)):
        starts = range(last - ENVELOPE_HZ, last, turn)

        def envelope(starts: range = starts, turn: int = turn) -> None:
            for start in starts:
                bench.baseband(np.arange(start + 1, start + 1 + turn) / ENVELOPE_HZ)

        def carrier(starts: range = starts, turn: int = turn) -> None:
            for start in starts:
                bench.carrier(DOWN * start, DOWN * turn)

        found[f"envelope_{name}_s"] = best_s(envelope, 3 * times)
        found[f"carrier_{name}_s"] = best_s(carrier, times)
    return found


def differences(times: int) -> list[dict[str, float]]:
    """For each speed: what each level costs, and how far they are apart without noise."""
    rows = []
    for speed_m_s in SPEEDS_M_S:
        passage = Passage(1.0, speed_m_s, WAY_M)
        bench = begun(passage, **QUIET)
        bench.advance(passage.end_s + 1.0)
        first = round((passage.start_s + EDGE_S) * ENVELOPE_HZ)
        # the bench remembers four seconds: the nearer part of a slow passage
        first = max(first, round((passage.end_s - 2.5) * ENVELOPE_HZ))
        n = round((passage.end_s - EDGE_S) * ENVELOPE_HZ) - first
        ideal = bench.baseband(np.arange(first, first + n) / ENVELOPE_HZ)[:, RIGHT]
        chain = demodulated(bench, first, n)[:, RIGHT]
        swing = float(np.std(ideal))
        times_s, ours = chained(bench, first, n, RIGHT)
        # the chain's window is even: its outputs lie half a frame beside the milliseconds
        there = CubicSpline(np.arange(first, first + n) / ENVELOPE_HZ, ideal)(times_s)
        noisy = begun(passage)
        last = max(round(passage.end_s * ENVELOPE_HZ), 2 * ENVELOPE_HZ)
        noisy.advance(last / ENVELOPE_HZ)
        rows.append(
            {
                "speed_m_s": speed_m_s,
                **cost_s(noisy, last, times),
                "swing_dbfs": decibels(swing),
                "reference_dbfs": decibels(rms(chain - ideal)),
                "chain_dbfs": decibels(rms(ours - there)),
            }
        )
    return rows


def noises(seconds: float) -> dict[str, float]:
    """Noise in the band of the undulations, before nothing: the carrier's against the envelope's, in dB."""
    found = {}
    for name, passage in (
        ("rest", Passage(1e6, 0.01, 0.01)),
        ("motion", Passage(0.0, 0.0001, 1.0)),
    ):
        about = {"object": "none", "drift_fs": 0.0, "surface_m": 0.5}
        power = []
        for chain in (False, True):
            bench = begun(passage, **about)
            parts, first = [], 100
            while first < seconds * ENVELOPE_HZ:
                bench.advance((first + 1100) / ENVELOPE_HZ)
                instants = np.arange(first, first + ENVELOPE_HZ) / ENVELOPE_HZ
                part = demodulated(bench, first, ENVELOPE_HZ) if chain else bench.baseband(instants)
                parts.append(part[:, RIGHT])
                first += ENVELOPE_HZ
            signal = np.concatenate(parts)
            frequency_hz, density = welch(signal, ENVELOPE_HZ, nperseg=1000, return_onesided=False)
            inside = (np.abs(frequency_hz) >= BAND_HZ[0]) & (np.abs(frequency_hz) <= BAND_HZ[1])
            power.append(float(density[inside].mean()))
        found[f"{name}_dbfs_rthz"] = 10.0 * float(np.log10(power[0]))
        found[f"{name}_carrier_over_envelope_db"] = 10.0 * float(np.log10(power[1] / power[0]))
    found["chain_colour"] = colour(round(seconds))
    found["envelope_colour"] = AuraSettings().noise_colour
    return found


def colour(seconds: int) -> float:
    """Correlation of neighbouring outputs of the program's chain, in white noise."""
    bench = begun(Passage(1e6, 0.01, 0.01), object="none", drift_fs=0.0)
    bench.advance(float(seconds))
    power = product = 0.0
    for second in range(seconds):
        still = chained(bench, second * ENVELOPE_HZ, ENVELOPE_HZ, RIGHT)[1]
        still = still - still.mean()
        power += np.vdot(still, still).real
        product += np.vdot(still[:-1], still[1:]).real
    return float(product / power)


def hearing(times: int) -> dict[str, Any]:
    """Seconds of work for a second of bench time, by who hears what; the arm moves all the while."""
    passage = Passage(0.0, 0.01, WAY_M)
    found: dict[str, Any] = {}
    for name, wired in (("both", ("right", "left")), ("right", ("right",))):
        bench = begun(passage, wired=wired)
        bench.advance(5.0)
        found[name] = cost_s(bench, 5000, times)

    def deaf() -> None:
        alone = begun(passage)
        for turn in range(1, 50 + 1):
            alone.advance(turn * TURN_MS / 1000.0)
        assert alone.account()["computed"] == {"envelope": 0, "carrier": 0}

    begin_s = statistics.median(best_s(lambda: begun(passage), 1) for _ in range(times))
    found["nobody"] = max(best_s(deaf, times) - begin_s, 0.0) / 5.0
    return found


def main(quick: bool = False) -> None:
    """Measure, print, save."""
    times = 3 if quick else 30
    rows = differences(times)
    noise = noises(5.0 if quick else 60.0)
    heard = hearing(times)
    text = page(rows, noise, heard)
    print(text)
    if not quick:
        save("aura", {"levels": rows, "noise": noise, "work_s_per_s": heard})
        (FOLDER / "aura.md").write_text(text, encoding="utf-8")
        figures.draw()


def page(rows: list[dict[str, float]], noise: dict[str, float], heard: dict[str, Any]) -> str:
    """The figures as a Markdown page."""
    levels = table(
        [
            "speed, m/s",
            "envelope, ms",
            "in turns of 0.1 s",
            "carrier, ms",
            "in turns of 0.1 s",
            "speed-up",
            "in turns of 0.1 s",
            "undulations, dBFS",
            "difference, long filter",
            "difference, the chain",
        ],
        [
            [
                f"{row['speed_m_s']:g}",
                f"{1e3 * row['envelope_long_s']:.2f}",
                f"{1e3 * row['envelope_short_s']:.2f}",
                f"{1e3 * row['carrier_long_s']:.0f}",
                f"{1e3 * row['carrier_short_s']:.0f}",
                f"{row['carrier_long_s'] / row['envelope_long_s']:.0f}",
                f"{row['carrier_short_s'] / row['envelope_short_s']:.0f}",
                f"{row['swing_dbfs']:.0f}",
                f"{row['reference_dbfs']:.0f}",
                f"{row['chain_dbfs']:.0f}",
            ]
            for row in rows
        ],
    )
    nobody = f"{1e3 * heard['nobody']:.2f}"
    work = table(
        ["heard", "envelope, ms", "carrier, ms"],
        [
            *(
                [
                    words,
                    f"{1e3 * heard[name]['envelope_long_s']:.2f}",
                    f"{1e3 * heard[name]['carrier_long_s']:.0f}",
                ]
                for words, name in (("both fingers", "both"), ("one finger", "right"))
            ),
            ["nobody", nobody, nobody],
        ],
    )
    return f"""# The aura at envelope and at carrier level

Simulated: [what, and what is assumed](../../docs/explanation/aura.md). Time is the processor's for one second of bench
time on one core, two fingers, a second at once, the best of several runs; the chain that turns a carrier into an
envelope is not in it.

{levels}

The difference is the root mean square of (carrier demodulated, minus envelope), dBFS, without noise, on the last 2.5 s
at most before 2 mm from the pipe: by a filter of 20 ms in double precision that is flat to 150 Hz, and by the program's
own chain (`iq`, `fused`). It is what a filter makes of the motion within its length, and rounding to 24 bits. The
standard deviation of the undulations stands beside it.

Noise between {BAND_HZ[0]:g} and {BAND_HZ[1]:g} Hz, before nothing: the carrier's, through the same filter, is
{noise["rest_carrier_over_envelope_db"]:+.2f} dB of the envelope's at rest and
{noise["motion_carrier_over_envelope_db"]:+.2f} dB in motion. From one millisecond to the next the chain leaves a
correlation of {noise["chain_colour"]:.2f} in white noise; the envelope's is set to {noise["envelope_colour"]:.2f}.

What nobody hears is not computed: the same second with one finger wired (`plant.wired`), and with none heard
("nobody": following where tool, jaws and object are is all that is left).

{work}

![Undulations at two speeds, and what each object sends back](../figures/aura_speeds.png)
"""
