"""The 96 kHz chain: `python -m benchmarks chain`, or `python -m benchmarks.chain [--quick]`."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from benchmarks.chain.chains import BLOCK, Chain, chains
from benchmarks.chain.drift import endure
from benchmarks.chain.errors import against_long, against_truth
from benchmarks.chain.report import document
from benchmarks.chain.scene import DRIVE_HZ, RATE_HZ, Sound, sound
from benchmarks.results import FOLDER, save
from controller.signals.iq import Iq, IqSettings
from controller.signals.protocol import Signals
from drivers.messages import SampleBlock

OTHER_HZ = 40_123.457
"""A drive whose period is 96,000,000 frames: no table holds it."""

BOTH = (0, 1)


def best_s(runs: Sequence[Callable[[], object]], rounds: int) -> list[float]:
    """Shortest CPU time of each, s; they take turns, so that a busy machine is busy for all of them."""
    taken = np.full((rounds, len(runs)), np.inf)
    for run in runs:
        run()
    for turn in range(rounds):
        for place, run in enumerate(runs):
            started = time.process_time()
            run()
            taken[turn, place] = time.process_time() - started
    return [float(t) for t in taken.min(axis=0)]


def compared(heard: Sound, rounds: int) -> list[dict[str, Any]]:
    """Every chain on the same sound."""
    every = chains(heard.drive_hz, heard.frame)
    times_s = best_s([_on(chain, heard) for chain in every] + [heard.packed.copy], rounds)
    slow_s = {c.in_blocks: t for c, t in zip(every, times_s, strict=False) if c.name == "sosfilt, I/Q"}
    rows = []
    for chain, taken_s in zip(every, times_s, strict=False):
        z = chain.run(heard, BOTH)
        rows.append(
            {
                "chain": chain.name,
                "note": chain.note,
                "drive_hz": heard.drive_hz,
                "times_real_time": heard.seconds / taken_s,
                "in_blocks": chain.in_blocks,
                "times_sosfilt": slow_s[chain.in_blocks] / taken_s if chain.in_blocks in slow_s else None,
                "delay_ms": 1e3 * chain.delay_s,
                "error_own_filter_dbfs": against_long(chain, heard, z),
                "error_envelope_dbfs": against_truth(chain, heard, z),
            }
        )
        print(f"{chain.name:26} {rows[-1]['times_real_time']:7.0f} x real time", flush=True)
    rows.append(
        {
            "chain": "copying the input in memory",
            "note": "",
            "drive_hz": heard.drive_hz,
            "times_real_time": heard.seconds / times_s[-1],
            "in_blocks": False,
            "times_sosfilt": slow_s[False] / times_s[-1],
        }
    )
    return rows


def _on(chain: Chain, heard: Sound) -> Callable[[], object]:
    return lambda: chain.run(heard, BOTH)


def heard_by(heard: Sound, rounds: int) -> list[dict[str, Any]]:
    """What the signals of a profile cost where a state hears both fingers, one, or none; blocks of 10 ms."""
    blocks = [
        SampleBlock(
            "audio.fingers",
            heard.frame + start,
            start / RATE_HZ,
            heard.counts[start : start + BLOCK],
            rate_hz=float(RATE_HZ),
            unit="FS",
            scale=2.0**-23,
        )
        for start in range(0, len(heard.counts), BLOCK)
    ]
    names = ("signals.right", "signals.left")
    runs = []
    for count in (2, 1, 0):
        settings = [IqSettings(channel=channel) for channel in BOTH]
        signals = Signals([Iq("right", settings[0]), Iq("left", settings[1])])

        def run(signals: Signals = signals, wanted: frozenset[str] = frozenset(names[:count])) -> None:
            signals.hear(frozenset())
            signals.hear(wanted)
            for block in blocks:
                signals.push([block])

        runs.append(run)
    both_s, one_s, none_s = best_s(runs, rounds)
    return [
        {"heard": heard_name, "ms_a_second": 1e3 * taken / heard.seconds, "share": taken / both_s}
        for heard_name, taken in (("both fingers", both_s), ("one finger", one_s), ("no pre-touch", none_s))
    ]


def main(quick: bool = False) -> None:
    """Run it; writes results/chain.json and results/chain.md."""
    seconds, rounds, frames = (4.0, 3, 10**7) if quick else (10.0, 9, 10**9)
    rows = compared(sound(seconds), rounds)
    other = compared(sound(seconds, OTHER_HZ), max(2, rounds // 2))
    shares = heard_by(sound(seconds), rounds)
    drifts = [endure(kind, frames) for kind in ("cic", "fused")]
    name = "chain_quick" if quick else "chain"
    result = {
        "simulated": True,
        "sound_s": seconds,
        "block_frames": BLOCK,
        "load": os.getloadavg()[0],
        "chains": rows,
        "other_drive": other,
        "heard": shares,
        "drift": drifts,
        "drive_hz": DRIVE_HZ,
    }
    save(name, result)
    page = document(result)
    (FOLDER / f"{name}.md").write_text(page, encoding="utf-8")
    print(page)


if __name__ == "__main__":
    main()
