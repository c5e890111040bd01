"""A recording through a detector: run folders, CSV, NPZ and WAV files; one event a line."""

from __future__ import annotations

import math
import struct
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from zipfile import BadZipFile

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Detected
from controller.detectors.calibration import Statistic, calibrate_blocks
from controller.detectors.protocol import Detector
from controller.recording.reader import open_run
from controller.recording.series import TrialRecording
from controller.signals.iq import CARRIER_FROM_HZ, Iq, IqSettings
from drivers.messages import SampleBlock

UNITS = {"_m_s2": "m/s2", "_m_s": "m/s", "_hz": "Hz", "_s": "s", "_n": "N", "_v": "V", "_m": "m"}
"""Units that a column's name ends in; the first that fits decides. A column without one is a plain waveform."""

ENVELOPES = ("FS", "V", "")
"""Units that an envelope may be in; a file's columns need not say."""

JITTER = 0.25
"""Rows of a file are taken for regular samples where their times are within this share of a period of a common grid.
Assumption: rounding of times, not a sampler that wanders."""


LEAST_STEP_S, LATEST_S = 1e-9, 2.0**32
"""Between two rows of a file at least, and the latest time of one: a nanosecond, and the year 2106 where seconds count
from 1970. Assumption: no sensor of touch is faster; within these a grid can be counted in whole numbers."""


class ReplayError(ValueError):
    """The file cannot be replayed: one line with file, what is wrong and what to do."""


def replay(blocks: Sequence[SampleBlock], detector: Detector) -> Iterator[Detected]:
    """Everything that a detector says of recorded blocks, in order.

    Raises:
        ReplayError: the detector cannot hear such a recording.
    """
    for block in blocks:
        try:
            events = detector.push(block)
        except ValueError as error:
            raise ReplayError(f"{detector.name}: {error}") from None
        yield from events


def calibration_line(
    blocks: Sequence[SampleBlock], detector: Statistic, kind: str, false_alarm_interval_s: float
) -> dict[str, Any]:
    """The threshold that a recording without events asks for, as one JSON object.

    Args:
        blocks: The recording.
        detector: Whose threshold.
        kind: Of detector, as it was asked for.
        false_alarm_interval_s: Mean time between false alarms.

    Raises:
        ReplayError: a recording that says nothing about it: too short, at irregular times, not finite, dead.
    """
    try:
        found = calibrate_blocks(detector, blocks, false_alarm_interval_s)
    except ValueError as error:
        raise ReplayError(f"{kind}: {error}") from None
    return {
        "detector": kind,
        "threshold": found.threshold,
        "threshold_low": found.low,
        "threshold_high": found.high if math.isfinite(found.high) else None,
        "false_alarm_interval_s": found.false_alarm_interval_s,
        "recording_s": found.recording_s,
        "extrapolated": found.extrapolated,
    }


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


def read_inputs(
    path: Path,
    inputs: Sequence[str],
    *,
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    trial: int | None = None,
) -> Sequence[SampleBlock]:
    """Blocks of all streams that a detector hears, each given when its last sample has come, as the loop gives them.

    Args:
        path: As `read_blocks`.
        inputs: The detector's streams; of a file, one after the other.
        columns: For each input what `read_blocks` calls its column; of a run folder, of a WAV file and where there is
            one input it may be left out.
        rate_hz: As `read_blocks`.
        trial: As `read_blocks`.

    Raises:
        ReplayError: as `read_blocks`; or too few or too many columns, or streams that were not recorded together.
    """
    names = " and ".join(inputs)
    if path.is_file() and len(inputs) > 1 and len(columns) != len(inputs):
        raise ReplayError(
            f"{path}: {names} are heard, in this order; give --column for each, for example --column i,q --column x_m"
        )
    if len(columns) > len(inputs):
        raise ReplayError(
            f"{path}: {len(columns)} times --column, but {names} alone is heard; join them: i,q"
        )
    asked = [*columns, *[None] * (len(inputs) - len(columns))]
    read = [
        read_blocks(path, stream, column=column, rate_hz=rate_hz, trial=trial)
        for stream, column in zip(inputs, asked, strict=True)
    ]
    _check_overlap(path, read)
    given: list[SampleBlock] = [block for blocks in read for block in blocks if len(block)]
    return sorted(given, key=lambda block: block.last_s)


def _check_overlap(path: Path, read: Sequence[Sequence[SampleBlock]]) -> None:
    """Streams of which one ends before another begins tell nothing of each other."""
    first_out = min(read, key=lambda blocks: blocks[-1].last_s)[-1]
    last_in = max(read, key=lambda blocks: float(blocks[0].times[0]))[0]
    begin_s = float(last_in.times[0])
    if begin_s > first_out.last_s and last_in.stream != first_out.stream:
        raise ReplayError(
            f"{path}: {last_in.stream} begins at {begin_s:.6g} s, when {first_out.stream} has ended at"
            f" {first_out.last_s:.6g} s; choose streams that were recorded together"
        )


def enveloped(blocks: Sequence[SampleBlock], stream: str, settings: IqSettings) -> Sequence[SampleBlock]:
    """The same blocks, with a finger's sound made an envelope, as the chain of the bench does.

    Args:
        blocks: Of all streams.
        stream: The one in which an envelope is heard. At 4 kHz and more it is sound, with frame 0 at the drive's
            phase zero; below, an envelope already.
        settings: Of the chain; its channel is the first of what was read.

    Raises:
        ReplayError: neither sound of one finger nor an envelope, or sound that does not hold the drive.
    """
    chain = Iq(stream.removeprefix("signals."), settings)
    made: list[SampleBlock] = []
    for block in blocks:
        if block.stream != stream:
            made.append(block)
            continue
        if block.unit not in ENVELOPES:
            raise ReplayError(
                f"{stream}: {block.unit} is no envelope of a finger; choose I and Q, or its sound"
            )
        if block.rate_hz is None or block.rate_hz < CARRIER_FROM_HZ:
            made.append(block)
            continue
        if block.values.shape[1] != 1:
            raise ReplayError(
                f"{stream}: {block.values.shape[1]} channels of sound; choose one finger's, for example --column 0"
            )
        try:
            # full scale is told on the bench, where it stops the arm; here it is but heard
            parts = [part for part in chain.push(block) if isinstance(part, SampleBlock)]
        except ValueError as error:
            raise ReplayError(str(error)) from None
        made += [replace(part, stream=stream) for part in parts]
    if blocks and not any(block.stream == stream for block in made):
        raise ReplayError(f"{stream}: the sound is too short for an envelope; it takes some milliseconds")
    return sorted(made, key=lambda block: block.last_s)


def own_detectors(manifest: Mapping[str, Any], recording: TrialRecording) -> Mapping[str, Mapping[str, Any]]:
    """Kind and settings of each detector of the profile that a trial was run with, by name."""
    resolved = manifest.get("profile", {}).get("resolved", {})
    tables = {name: dict(table) for name, table in resolved.get("detectors", {}).items()}
    for factor, value in recording.factors.items():
        section, _, setting = factor.partition(".")
        name, _, key = setting.partition(".")
        if section == "detectors" and name in tables:
            # the settings of one kind mean nothing to another
            tables[name] = {"kind": value} if key == "kind" else {**tables[name], key: value}
    return tables


def read_trial(path: Path, trial: int | None) -> tuple[Mapping[str, Any], TrialRecording]:
    """A run's manifest, and what was recorded of one of its trials; None is the first.

    Raises:
        ReplayError: nothing was recorded of it.
    """
    run = open_run(path)
    trials = run.recorded_trials
    chosen = trials[0] if trial is None and trials else trial
    if chosen is None or chosen not in trials:
        known = f"{min(trials)} to {max(trials)}" if trials else "none"
        raise ReplayError(f"{path}: no recording of trial {trial}; recorded are {known}")
    return run.manifest, run.recording(chosen)


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
        column: Of a CSV or NPZ file: its name; of a WAV file or of a run's stream: the channel's number, from 0.
            Several with commas between them. None is the only one there is besides the time; of a run's stream, all.
        rate_hz: Sample rate of a CSV or NPZ file without a column `t_s`, or in place of it. Otherwise times on a
            regular grid give it, with a jump in `seq` where rows are missing; irregular ones give none.
        trial: Of a run folder; None is its first.

    Raises:
        ReplayError: the file is not there, is none of these, or does not hold what is asked for.
    """
    if path.is_dir():
        return _from_run(path, stream, trial, column)
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
    if times_s is not None and not _are_times(times_s):
        raise ReplayError(
            f"{path}: column t_s must be seconds that rise from row to row, by {LEAST_STEP_S:g} s at least"
        )
    if not len(values):
        raise ReplayError(f"{path}: column {name} has no rows")
    unit = next((unit for end, unit in UNITS.items() if name.endswith(end)), "")
    t0_s = 0.0 if times_s is None else float(times_s[0])
    if times_s is None or rate_hz is not None:
        return [SampleBlock(stream, 0, t0_s, values, rate_hz=rate_hz, unit=unit)]
    # periods and frequencies come one a cycle: even where they look regular they are no samples
    grid = None if unit in ("s", "Hz") else _grid(times_s)
    if grid is None:
        return [SampleBlock(stream, 0, t0_s, values, times_s=times_s, unit=unit)]
    regular_hz, places = grid
    starts = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    return [
        SampleBlock(
            stream,
            int(places[first]),
            float(times_s[first]),
            values[first:last],
            rate_hz=regular_hz,
            times_s=times_s[first:last],
            unit=unit,
        )
        for first, last in zip(starts, [*starts[1:], len(values)], strict=True)
    ]


def _are_times(times_s: NDArray[np.float64]) -> bool:
    return bool((np.abs(times_s) < LATEST_S).all() and (np.diff(times_s) >= LEAST_STEP_S).all())


def _grid(times_s: NDArray[np.float64]) -> tuple[float, NDArray[np.int64]] | None:
    """Rate of a regular grid and each time's place on it, from 0; None where the times are on none."""
    if len(times_s) < 2:
        return None
    steps_s = np.diff(times_s)
    places = np.concatenate(([0], np.cumsum(np.rint(steps_s / np.median(steps_s)).astype(np.int64))))
    period_s = float(times_s[-1] - times_s[0]) / max(1, int(places[-1]))
    off = np.abs((times_s - times_s[0]) / period_s - places)
    if (np.diff(places) < 1).any() or off.max() > JITTER:
        return None
    return 1.0 / period_s, places


def _from_run(path: Path, stream: str, trial: int | None, column: str | None) -> Sequence[SampleBlock]:
    _, recording = read_trial(path, trial)
    blocks = recording.blocks(stream)
    if not blocks:
        raise ReplayError(
            f"{path}: trial {recording.trial} has no stream {stream}; it has"
            f" {', '.join(recording.streams) or 'none'} (choose one with --set input=NAME)"
        )
    if column is None:
        return blocks
    channels = _channels(f"{path}: {stream} has", column, blocks[0].values.shape[1])
    return [replace(block, values=block.values[:, channels]) for block in blocks]


def _channels(where: str, column: str, count: int) -> list[int]:
    """Numbers of channels as they are written on the command line."""
    words = column.split(",")
    unknown = next((word for word in words if not (word.isdecimal() and int(word) < count)), None)
    if unknown is not None:
        raise ReplayError(f"{where} no channel {unknown}; there are 0 to {count - 1}")
    return [int(word) for word in words]


def _read_csv(path: Path) -> Mapping[str, NDArray[np.float64]]:
    try:
        with path.open(encoding="utf-8-sig") as file:
            header = [name.strip() for name in file.readline().split(",")]
            rows = file.readlines()
            table = (
                np.loadtxt(rows, delimiter=",", ndmin=2) if any(map(str.strip, rows)) else np.empty((0, 0))
            )
    except (OSError, ValueError, UnicodeDecodeError) as error:
        raise ReplayError(f"{path}: no table of numbers under one line of names: {error}") from None
    twice = next((name for place, name in enumerate(header) if name in header[:place]), None)
    if twice is not None:
        raise ReplayError(f"{path}: two columns are called '{twice}' in the first line; rename one")
    if table.size and table.shape[1] != len(header):
        raise ReplayError(f"{path}: {table.shape[1]} columns, but the first line names {len(header)}")
    return {name: table[:, place] if table.size else np.empty(0) for place, name in enumerate(header)}


def _read_npz(path: Path) -> Mapping[str, NDArray[np.float64]]:
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            found = {name: file[name] for name in file.files}
            # numbers that have two parts are none that a detector hears
            arrays = {name: array.astype(np.float64, casting="same_kind") for name, array in found.items()}
    except (OSError, ValueError, TypeError, BadZipFile) as error:
        raise ReplayError(f"{path}: no NPZ file of numbers: {error}") from None
    flat = {name: array for name, array in arrays.items() if array.ndim == 1}
    if not flat:
        raise ReplayError(f"{path}: no array of one dimension in it; it has {', '.join(arrays) or 'nothing'}")
    return flat


def _columns(
    path: Path, table: Mapping[str, NDArray[np.float64]], column: str | None
) -> tuple[str, NDArray[np.float64], NDArray[np.float64] | None]:
    """The first column's name, the values of all that are asked for, and their times where there are any."""
    names = [name for name in table if name != "t_s"]
    chosen = column.split(",") if column else names
    if not column and len(names) != 1:
        raise ReplayError(f"{path}: which column? choose with --column; there are {', '.join(names)}")
    unknown = next((name for name in chosen if name not in table), None)
    if unknown is not None:
        raise ReplayError(f"{path}: no column {unknown}; there are {', '.join(names)}")
    times_s = table.get("t_s")
    rows = {
        **{name: len(table[name]) for name in chosen},
        **({} if times_s is None else {"t_s": len(times_s)}),
    }
    other = next((name for name, count in rows.items() if count != rows[chosen[0]]), None)
    if other is not None:
        raise ReplayError(f"{path}: {chosen[0]} has {rows[chosen[0]]} rows, {other} has {rows[other]}")
    return chosen[0], np.column_stack([table[name] for name in chosen]), times_s


def _read_wav(path: Path, column: str | None) -> tuple[str, NDArray[np.float64], float]:
    """Channels in full-scale units (-1 to 1), and the sample rate."""
    from scipy.io import wavfile

    try:
        rate_hz, samples = wavfile.read(path)
    except (OSError, ValueError, struct.error) as error:
        raise ReplayError(f"{path}: no WAV file that can be read: {error}") from None
    channels = samples if samples.ndim == 2 else samples[:, None]
    if column is None and channels.shape[1] > 1:
        raise ReplayError(f"{path}: {channels.shape[1]} channels; choose one with --column 0")
    chosen = channels[:, _channels(f"{path}:", column or "0", channels.shape[1])].astype(np.float64)
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
            timed = block.times_s is not None
            kept.append(
                replace(
                    block,
                    seq=block.seq + first,
                    t0_s=float(block.times[first]),
                    values=block.values[first:],
                    times_s=block.times[first:] if timed else None,
                )
            )
    return kept


__all__ = [
    "ReplayError",
    "as_line",
    "between",
    "calibration_line",
    "enveloped",
    "own_detectors",
    "read_blocks",
    "read_inputs",
    "read_trial",
    "replay",
]
