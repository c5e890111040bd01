"""A recording through a detector: run folders, CSV, NPZ and WAV files; one event a line."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Detected
from controller.detectors.protocol import Detector
from controller.recording.reader import open_run
from drivers.messages import SampleBlock

UNITS = {"_m_s2": "m/s2", "_m_s": "m/s", "_hz": "Hz", "_s": "s", "_n": "N", "_v": "V", "_m": "m"}
"""Units that a column's name ends in; the first that fits decides. A column without one is a plain waveform."""


class ReplayError(ValueError):
    """The file cannot be replayed: one line with file, what is wrong and what to do."""


def replay(blocks: Sequence[SampleBlock], detector: Detector) -> Iterator[Detected]:
    """Everything that a detector says of recorded blocks, in order."""
    for block in blocks:
        yield from detector.push(block)


def as_line(event: Detected, kind: str) -> dict[str, Any]:
    """One event as one JSON object.

    Args:
        event: What the detector said.
        kind: Of detector, as it was asked for.
    """

    def plain(value: float) -> float | None:
        return float(value) if math.isfinite(value) else None

    line = {
        "t_s": round(float(event.t_s), 9),
        "detector": kind,
        "event": type(event).__name__,
        "value": plain(event.value),
        "threshold": plain(event.threshold),
    }
    reason = getattr(event, "reason", "")
    return {**line, "reason": reason} if reason else line


def read_blocks(
    path: Path,
    stream: str,
    *,
    column: str | None = None,
    rate_hz: float | None = None,
    trial: int | None = None,
) -> Sequence[SampleBlock]:
    """Blocks of one stream from a recording.

    Args:
        path: A run folder, or a CSV, NPZ or WAV file.
        stream: Name that the detector hears it under; in a run folder, the recorded stream.
        column: Of a CSV or NPZ file: its name; of a WAV file: the channel's number, from 0. None is the only one there
            is besides the time.
        rate_hz: Sample rate of a CSV or NPZ file without a column `t_s`.
        trial: Of a run folder; None is its first.

    Raises:
        ReplayError: the file is not there, is none of these, or does not hold what is asked for.
    """
    if path.is_dir():
        return _from_run(path, stream, trial)
    if not path.is_file():
        raise ReplayError(f"{path}: no such file or run folder; list runs with: ls runs")
    suffix = path.suffix.lower()
    if suffix == ".csv":
        name, values, times_s = _columns(path, _read_csv(path), column)
    elif suffix == ".npz":
        name, values, times_s = _columns(path, _read_npz(path), column)
    elif suffix == ".wav":
        name, values, rate_hz = _read_wav(path, column)
        times_s = None
    else:
        raise ReplayError(
            f"{path}: '{suffix}' is no recording; give a run folder or a .csv, .npz or .wav file"
        )
    if times_s is None and rate_hz is None:
        raise ReplayError(f"{path}: no column t_s, so the sample rate is needed: --rate HZ")
    if times_s is not None and not (np.isfinite(times_s).all() and (np.diff(times_s) > 0.0).all()):
        raise ReplayError(f"{path}: column t_s must be finite and rise from row to row")
    if not len(values):
        raise ReplayError(f"{path}: column {name} has no rows")
    unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
    t0_s = 0.0 if times_s is None else float(times_s[0])
    regular_hz = rate_hz if times_s is None else None
    return [SampleBlock(stream, 0, t0_s, values[:, None], rate_hz=regular_hz, times_s=times_s, unit=unit)]


def _from_run(path: Path, stream: str, trial: int | None) -> Sequence[SampleBlock]:
    run = open_run(path)
    trials = run.recorded_trials
    chosen = trials[0] if trial is None and trials else trial
    if chosen is None or chosen not in trials:
        known = f"{min(trials)} to {max(trials)}" if trials else "none"
        raise ReplayError(f"{path}: no recording of trial {trial}; recorded are {known}")
    recording = run.recording(chosen)
    blocks = recording.blocks(stream)
    if not blocks:
        raise ReplayError(
            f"{path}: trial {chosen} has no stream {stream}; it has {', '.join(recording.streams) or 'none'}"
            " (choose one with --set input=NAME)"
        )
    return blocks


def _read_csv(path: Path) -> Mapping[str, NDArray[np.float64]]:
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = [name.strip() for name in file.readline().split(",")]
            table = np.loadtxt(file, delimiter=",", ndmin=2)
    except (OSError, ValueError, UnicodeDecodeError) as error:
        raise ReplayError(f"{path}: no table of numbers under one line of names: {error}") from None
    if table.size and table.shape[1] != len(header):
        raise ReplayError(f"{path}: {table.shape[1]} columns, but the first line names {len(header)}")
    return {name: table[:, place] if table.size else np.empty(0) for place, name in enumerate(header)}


def _read_npz(path: Path) -> Mapping[str, NDArray[np.float64]]:
    try:
        with np.load(path, allow_pickle=False) as file:
            arrays = {name: np.asarray(file[name], dtype=np.float64) for name in file.files}
    except (OSError, ValueError) as error:
        raise ReplayError(f"{path}: no NPZ file of numbers: {error}") from None
    flat = {name: array for name, array in arrays.items() if array.ndim == 1}
    if not flat:
        raise ReplayError(f"{path}: no array of one dimension in it; it has {', '.join(arrays) or 'nothing'}")
    return flat


def _columns(
    path: Path, table: Mapping[str, NDArray[np.float64]], column: str | None
) -> tuple[str, NDArray[np.float64], NDArray[np.float64] | None]:
    """The column's name and values, and its times where there are any."""
    names = [name for name in table if name != "t_s"]
    chosen = column or (names[0] if len(names) == 1 else None)
    if chosen is None:
        raise ReplayError(f"{path}: which column? choose with --column; there are {', '.join(names)}")
    if chosen not in table:
        raise ReplayError(f"{path}: no column {chosen}; there are {', '.join(names)}")
    times_s = table.get("t_s")
    if times_s is not None and len(times_s) != len(table[chosen]):
        raise ReplayError(f"{path}: {chosen} has {len(table[chosen])} rows, t_s has {len(times_s)}")
    return chosen, table[chosen], times_s


def _read_wav(path: Path, column: str | None) -> tuple[str, NDArray[np.float64], float]:
    """A channel in full-scale units (-1 to 1), and the sample rate."""
    from scipy.io import wavfile

    try:
        rate_hz, samples = wavfile.read(path)
    except (OSError, ValueError) as error:
        raise ReplayError(f"{path}: no WAV file that can be read: {error}") from None
    channels = samples.reshape(len(samples), -1)
    if column is None and channels.shape[1] > 1:
        raise ReplayError(f"{path}: {channels.shape[1]} channels; choose one with --column 0")
    if column is not None and not (column.isdecimal() and int(column) < channels.shape[1]):
        raise ReplayError(f"{path}: no channel {column}; there are 0 to {channels.shape[1] - 1}")
    chosen = channels[:, int(column or 0)].astype(np.float64)
    if samples.dtype == np.uint8:  # 8-bit WAV is unsigned, silence is 128
        chosen = (chosen - 128.0) / 128.0
    elif np.issubdtype(samples.dtype, np.integer):
        chosen = chosen / float(np.iinfo(samples.dtype).max + 1)
    return f"channel {column or 0}", chosen, float(rate_hz)


def between(blocks: Sequence[SampleBlock], t0_s: float) -> Sequence[SampleBlock]:
    """The samples from `t0_s` on: a baseline that begins there is the first thing that a detector hears."""
    kept: list[SampleBlock] = []
    for block in blocks:
        first = int(np.searchsorted(block.times, t0_s - 1e-9))
        if first < len(block):
            irregular = block.times_s is not None
            kept.append(
                SampleBlock(
                    block.stream,
                    block.seq + first,
                    float(block.times[first]),
                    block.values[first:],
                    rate_hz=block.rate_hz,
                    times_s=block.times[first:] if irregular else None,
                    unit=block.unit,
                    scale=block.scale,
                )
            )
    return kept


__all__ = ["ReplayError", "as_line", "between", "read_blocks", "replay"]
