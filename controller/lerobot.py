"""A run as a LeRobot dataset: an episode a trial, a frame for each sample of the fastest stream.

Layout v3.0 of huggingface/lerobot (src/lerobot/datasets): data/ and meta/ in Parquet, meta/info.json, meta/stats.json.
"""

import json
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
from numpy.typing import NDArray

from controller.recording.reader import Run
from controller.recording.run_folder import RunFolderError
from controller.recording.series import Series
from drivers.core.messages import Floats

VERSION = "v3.0"
"""Of the layout."""

FILES = 1000
"""Files of a folder, as LeRobot has them."""

ROUNDING = 1e-9
"""Of a rate by its times: so much above a whole number is none."""

INDICES = ("timestamp", "frame_index", "episode_index", "index", "task_index")
"""Columns that every dataset has."""


def write_lerobot(run: Run, out: Path) -> list[Path]:
    """Write a run's trials as episodes.

    A frame holds of each stream the last sample until then, `observation.STREAM` in its own unit, and the bench time of
    that sample, `time.STREAM` (s): NaN before its first one. Frames are as many a second as the fastest stream has
    samples, or a few more. Samples that came closer together than frames are in none: their number is put into the
    run's notes. There is no action: a state machine moves the bench.

    Raises:
        RunFolderError: nothing was recorded, or the folder has episodes of a larger dataset.
    """
    trials = {trial: _streams(run, trial) for trial in run.recorded_trials}
    widths = {name: one.values.shape[1] for streams in trials.values() for name, one in streams.items()}
    if not widths:
        raise RunFolderError(f"{run.folder.path}: no samples were recorded")
    rates_hz = [one.rate_hz for streams in trials.values() for one in streams.values()]
    fps = max(1, math.ceil(np.nan_to_num(rates_hz).max() * (1.0 - ROUNDING)))
    places = [{"chunk_index": number // FILES, "file_index": number % FILES} for number in range(len(trials))]
    own = [out / "data" / _file(**place) for place in places]
    if others := sorted(set(out.glob("data/*/*.parquet")) - set(own)):
        raise RunFolderError(f"{others[0]}: of another dataset; choose a folder without one with --into")
    left_out: dict[str, int] = {}
    tasks: dict[str, int] = {}
    episodes: list[dict[str, Any]] = []
    whole: dict[str, list[NDArray[Any]]] = {}
    frames = 0
    for episode, (trial, streams) in enumerate(trials.items()):
        task = ", ".join(f"{name} {value}" for name, value in run.trial(trial).factors.items())
        task = f"{run.manifest.get('experiment', '')}: {task}"
        columns = _frames(streams, widths, fps)
        for name, one in streams.items():
            kept = len(np.unique(columns[f"time.{name}"][~np.isnan(columns[f"time.{name}"])]))
            left_out[name] = left_out.get(name, 0) + len(one) - kept
        length = len(columns["timestamp"])
        columns |= {
            "frame_index": np.arange(length),
            "episode_index": np.full(length, episode),
            "index": np.arange(frames, frames + length),
            "task_index": np.full(length, tasks.setdefault(task, len(tasks))),
        }
        _write(own[episode], columns)
        episodes.append(
            {
                "episode_index": episode,
                "tasks": [task],
                "length": length,
                "dataset_from_index": frames,
                "dataset_to_index": frames + length,
                **{f"data/{name}": value for name, value in places[episode].items()},
                **dict.fromkeys(("meta/episodes/chunk_index", "meta/episodes/file_index"), 0),
                "trial": trial,
            }
        )
        for name, values in columns.items():
            whole.setdefault(name, []).append(_moments(values))
        frames += length
    features = {name: _feature(name, widths) for name in whole}
    meta = out / "meta"
    listed = meta / "episodes" / _file(0, 0)
    listed.parent.mkdir(parents=True, exist_ok=True)
    pd.DataFrame(episodes).to_parquet(listed, index=False)
    pd.DataFrame({"task_index": list(tasks.values())}, index=pd.Index(tasks, name="task")).to_parquet(
        meta / "tasks.parquet"
    )
    info = {
        "codebase_version": VERSION,
        "robot_type": "touchbench",
        "total_episodes": len(episodes),
        "total_frames": frames,
        "total_tasks": len(tasks),
        "chunks_size": FILES,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": fps,
        "splits": {"train": f"0:{len(episodes)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    (meta / "info.json").write_text(json.dumps(info, indent=4), "utf-8")
    stats = {name: _joined(parts) for name, parts in whole.items()}
    (meta / "stats.json").write_text(json.dumps(stats, indent=4), "utf-8")
    if lost := ", ".join(f"{count} of {name}" for name, count in left_out.items() if count):
        run.notes.append(f"The dataset has {fps} frames a second; samples between two are in none: {lost}.")
    return [*own, listed, *(meta / name for name in ("tasks.parquet", "info.json", "stats.json"))]


def _streams(run: Run, trial: int) -> Mapping[str, Series]:
    recording = run.trial(trial)
    return {name: one for name in recording.streams if len(one := recording.stream(name))}


def _frames(streams: Mapping[str, Series], widths: Mapping[str, int], fps: int) -> dict[str, NDArray[Any]]:
    """The columns of an episode; frames fall on the fastest stream's samples."""
    fastest = max(streams.values(), key=lambda one: np.nan_to_num(one.rate_hz))
    begin_s = min(float(one.times_s[0]) for one in streams.values())
    end_s = max(float(one.times_s[-1]) for one in streams.values())
    before = np.ceil(round((float(fastest.times_s[0]) - begin_s) * fps, 3))
    first_s = float(fastest.times_s[0]) - before / fps
    count = int(np.ceil(round((end_s - first_s) * fps, 3))) + 1
    times_s = first_s + np.arange(count) / fps
    columns: dict[str, NDArray[Any]] = {"timestamp": (np.arange(count) / fps).astype(np.float32)}
    for name, width in widths.items():
        values, own_s = np.full((count, width), np.nan, np.float32), np.full(count, np.nan)
        one = streams.get(name)
        if one is not None:
            last = np.searchsorted(one.times_s, times_s + 0.25 / fps, side="right") - 1
            present = last >= 0
            values[present], own_s[present] = one.values[last[present]], one.times_s[last[present]]
        columns[f"observation.{name}"], columns[f"time.{name}"] = values, own_s
    return columns


def _feature(name: str, widths: Mapping[str, int]) -> dict[str, Any]:
    kind = "int64" if name in INDICES[1:] else "float64" if name.startswith("time.") else "float32"
    width = widths.get(name.removeprefix("observation."), 1) if name.startswith("observation.") else 1
    return {"dtype": kind, "shape": [width], "names": None}


def _write(path: Path, columns: Mapping[str, NDArray[Any]]) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    arrays = {
        name: pa.array(values.ravel())
        if values.size == len(values)
        else pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])
        for name, values in columns.items()
    }
    pq.write_table(pa.table(arrays), path, compression="snappy")


def _moments(values: NDArray[Any]) -> Floats:
    """Least, largest, sum, sum of squares and number of each channel, missing values left out."""
    known = values.reshape(len(values), -1).astype(float)
    finite = np.isfinite(known)
    low, high = np.where(finite, known, np.inf).min(axis=0), np.where(finite, known, -np.inf).max(axis=0)
    known = np.where(finite, known, 0.0)
    return np.array([low, high, known.sum(axis=0), (known**2).sum(axis=0), finite.sum(axis=0)])


def _joined(parts: Sequence[Floats]) -> dict[str, Any]:
    """A feature's statistics as LeRobot keeps them."""
    low, high = np.min([part[0] for part in parts], axis=0), np.max([part[1] for part in parts], axis=0)
    total, squares, count = np.sum([part[2:] for part in parts], axis=0)
    mean = total / np.maximum(count, 1)
    deviation = np.sqrt(np.maximum(squares / np.maximum(count, 1) - mean**2, 0.0))
    found = {"min": low, "max": high, "mean": mean, "std": deviation}
    plain = {name: np.where(count > 0, values, 0.0).tolist() for name, values in found.items()}
    return {**plain, "count": [int(count[0])]}


def _file(chunk_index: int, file_index: int) -> str:
    return f"chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
