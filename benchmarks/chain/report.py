"""The benchmark as a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.results import table

ASKED_RATIO, ASKED_ERROR_DBFS = 10.0, -120.0
"""Times faster than sosfilt, and the error that comes with it."""


def _number(value: float | None, digits: int = 0) -> str:
    return "–" if value is None else f"{value:.{digits}f}"


def _rows(rows: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    return [
        [
            row["chain"],
            f"{row['times_real_time']:,.0f}",
            _number(row["times_sosfilt"], 1),
            _number(row.get("delay_ms"), 1),
            _number(row.get("error_own_filter_dbfs")),
            _number(row.get("error_envelope_dbfs")),
            row["note"],
        ]
        for row in rows
    ]


def document(result: Mapping[str, Any]) -> str:
    """The page."""
    head = ["chain", "x real time", "x sosfilt", "delay, ms", "own filter, dBFS", "true envelope, dBFS", ""]
    ours = next(row for row in result["chains"] if row["chain"] == "ours, fused" and not row["in_blocks"])
    error = max(ours["error_own_filter_dbfs"], ours["error_envelope_dbfs"])
    met = ours["times_sosfilt"] >= ASKED_RATIO and error <= ASKED_ERROR_DBFS
    whole, blocks = ([row for row in result["chains"] if row["in_blocks"] is flag] for flag in (False, True))
    shares = [[row["heard"], f"{row['ms_a_second']:.3f}", f"{row['share']:.3f}"] for row in result["heard"]]
    drifts = [
        [
            row["chain"],
            f"{row['frames']:,}",
            str(row["outputs_that_differ"]),
            {True: "yes", False: "no", None: "–"}[row.get("last_equals_python_integers")],
            f"{row['cpu_s']:.1f}",
        ]
        for row in result["drift"]
    ]
    return f"""# The 96 kHz chain

From packed 24-bit counts of two channels to I and Q of both at 1 kHz, one core, simulated sound of
{result["sound_s"]:g} s. [How it works](../../docs/explanation/chain.md). The rivals get their filters and the drive's
wave ready made. Times are the shortest CPU time of several rounds in which all took turns (load {result["load"]:.1f}):
ratios hold, absolute times do not.

*own filter*: largest error against the same low-pass in 80-bit arithmetic. *true envelope*: largest error against the
envelope that was put in: 0.27 of full scale, undulations of 0.01 at 7 Hz and 0.005 at 70 Hz, with an offset and hum on
the cable, and 24-bit rounding; at the time that the chain's delay says. What a low-pass does to 70 Hz is in it: a
Butterworth of 100 Hz bends amplitudes and phases there.

## Drive at 40 kHz, all of the sound at once

{table(head, _rows(whole))}

Asked: at least {ASKED_RATIO:g} times faster than sosfilt, with an error of at most {ASKED_ERROR_DBFS:g} dBFS. Found:
{ours["times_sosfilt"]:.1f} times, {error:.0f} dBFS: {"met" if met else "missed"}.

## In blocks of {1e3 * result["block_frames"] / 96_000:g} ms

As sound comes: beside sosfilt that goes on where it stopped. More than half of our time is then calls from Python.

{table(head, _rows(blocks))}

## Drive at {result["other_drive"][0]["drive_hz"]:.3f} Hz

No table holds a period of it. The mixer is in the fused filter's taps, so that it costs the same; the rivals get a wave
that was computed beforehand.

{table(head, _rows([row for row in result["other_drive"] if not row["in_blocks"]]))}

## What is not needed is not paid for

Signals as a profile has them: int32 blocks of {1e3 * result["block_frames"] / 96_000:g} ms, with times, losses and
excursions; milliseconds of CPU a second of sound.

{table(["a state hears", "ms a second", "of both"], shares)}

## Drift

Full-scale noise that repeats every second: every output must be that of the second second, to the bit; the last one is
computed once more in Python's own integers.

{table(["chain", "frames", "outputs that differ", "last = Python's integers", "CPU, s"], drifts)}
"""
