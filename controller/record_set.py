"""Runs as a data set that others can load: signals, when things touched, moved and slid, factors, units, a licence."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from behaviors.events import Onset
from controller.detectors.onset import OnsetDetector, OnsetSettings
from controller.export import export
from controller.recording.reader import Run
from controller.recording.run_folder import RunFolderError, writing
from controller.recording.series import Series, TrialRecording
from controller.scales import si_unit

TRUTH, ENCODER, SENSOR, COMMAND = "truth of the simulation", "encoder", "the sensor itself", "command"
"""Where a label is from."""

TOUCH = ("touch_truth_s", "truth_contact_s")
"""Columns of trials.csv with a simulated bench's first touch."""

OVER_S, SIGMAS, LEAST_M = 0.02, 8.0, 2e-6
"""A mover moves where its position changes in this time by more than so many deviations of rest, and by this at least
(assumption: above the steps of any encoder of a stage or an arm)."""

REST = 0.2
"""Of a trial's pieces of 0.1 s this share is at rest at least (assumption), and tells an encoder's noise."""

TAP_HZ = 200.0
"""Sensors that are slower do not show a tap."""

BENCHES = {
    "mock": "simulated: physics in software, virtual time",
    "emulated": "simulated: physics in software, real drivers over emulated wires",
    "hardware": "measured on a real bench",
}


class Label(NamedTuple):
    """What happened in a trial; it ends with NaN where it is an instant."""

    trial: int
    what: str
    stream: str
    begin_s: float
    end_s: float
    sigma_s: float
    source: str


def write_set(run: Run, into: Path, *, licence: str, name: str, by: str) -> list[Path]:
    """Write a run as a data set.

    Args:
        into: A folder; made where it is not there.
        licence: Of the data, an SPDX identifier.
        name: Of the data set.
        by: Who publishes it.

    Returns:
        The files that were written.

    Raises:
        RunFolderError: nothing was recorded, or pyarrow is not installed.
        RecordingError: the files cannot be written.
    """
    if not run.recorded_trials:
        raise RunFolderError(f"{run.folder.path}: holds no recording of a trial; a data set needs one")
    paths = export(run, "parquet", into)
    paths += export(run, "rosbag2", into)
    import pandas as pd

    with writing(into, option="--into"):
        labels = into / "labels.parquet"
        rows = [label for trial in run.recorded_trials for label in labels_of(run, trial)]
        pd.DataFrame(rows, columns=Label._fields).to_parquet(labels, index=False)
        paths.append(labels)
        about = into / "dataset.json"
        text = json.dumps(described(run, paths, licence=licence, name=name, by=by), indent=1)
        about.write_text(text + "\n", encoding="utf-8")
    return [*paths, about]


def described(run: Run, paths: Sequence[Path], *, licence: str, name: str, by: str) -> Mapping[str, Any]:
    """What `dataset.json` says."""
    manifest = run.manifest
    bench = str(manifest.get("bench"))
    factors: dict[str, str] = {}
    streams: dict[str, Mapping[str, Any]] = {}
    for number in run.recorded_trials:
        trial = run.trial(number)
        factors |= {key: si_unit(key) for key in trial.factors}
        streams |= {name: _described(trial.stream(name)) for name in trial.streams if name not in streams}
    return {
        "name": name,
        "licence": licence,
        "published_by": by,
        "bench": bench,
        "origin": BENCHES.get(bench, bench),
        "experiment": manifest.get("experiment"),
        "profile": manifest.get("profile", {}).get("name"),
        "seed": manifest.get("seed"),
        "recorded_utc": manifest.get("started_utc"),
        "commit": manifest.get("commit"),
        "versions": manifest.get("versions"),
        "clock": "t_s: bench time, s since the trial began, one clock for all streams",
        "factors": factors,
        "streams": streams,
        "trials": [int(each) for each in run.recorded_trials],
        "sha256": {path.name: sha256(path.read_bytes()).hexdigest() for path in paths},
    }


def _described(series: Series) -> Mapping[str, Any]:
    return {"unit": series.unit, "channels": int(series.values.shape[1]), "rate_hz": _rate_hz(series)}


def _rate_hz(series: Series) -> float | None:
    """Of a stream with regular times; None where they are not."""
    steps = np.diff(series.times_s)
    if len(steps) < 2:
        return None
    step_s = float(np.median(steps))
    return round(1.0 / step_s, 3) if np.quantile(np.abs(steps - step_s), 0.9) < 0.1 * step_s else None


def labels_of(run: Run, trial: int) -> Iterator[Label]:
    """What happened in a trial, by the truth of a simulation, encoders, and each sensor's own first sign of the touch,
    by which clocks can be compared."""
    recording = run.trial(trial)
    found: Mapping[str, Any] = next((row for row in run.trials if row["trial"] == trial), {})
    touch_s = next((float(found[key]) for key in TOUCH if found.get(key) is not None), math.nan)
    if math.isfinite(touch_s):
        yield Label(trial, "touch", "", touch_s, math.nan, 0.0, TRUTH)
    if found.get("slip_s") is not None:
        source = COMMAND if found.get("reference") == "command" else TRUTH
        begin_s, end_s = (
            math.nan if found.get(key) is None else float(found[key]) for key in ("slip_s", "slip_end_s")
        )
        yield Label(trial, "slip", "", begin_s, end_s, 0.0, source)
    for stream in recording.streams:
        series = recording.stream(stream)
        if series.unit == "m":
            for begin_s, end_s in moves(series):
                step_s = float(np.median(np.diff(series.times_s)))
                yield Label(trial, "moves", stream, begin_s, end_s, step_s, ENCODER)
        elif not stream.startswith("detector."):
            yield from _taps(recording, trial, stream, touch_s)


def moves(series: Series) -> Sequence[tuple[float, float]]:
    """From when to when a mover moved, s, by its positions: the first three columns of a pose."""
    t_s, x = series.times_s, series.values[:, :3]
    if len(t_s) < 3:
        return []
    size = max(1, round(OVER_S / float(np.median(np.diff(t_s)))))
    way = np.linalg.norm(x[size:] - x[:-size], axis=1)
    if not len(way):
        return []
    pieces = np.array_split(way, max(1, len(way) // (5 * size)))
    noise = float(np.quantile([np.sqrt(np.mean(piece**2)) for piece in pieces], REST))
    moving = np.zeros(len(t_s), dtype=bool)
    moving[size // 2 : size // 2 + len(way)] = way > max(LEAST_M, SIGMAS * noise)
    edges = np.flatnonzero(np.diff(moving.astype(int), prepend=0, append=0))
    ends = zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True)
    return [(float(t_s[begin]), float(t_s[min(end, len(t_s) - 1)])) for begin, end in ends]


def _taps(recording: TrialRecording, trial: int, stream: str, touch_s: float) -> Iterator[Label]:
    """When a sensor first showed a touch, by `onset`; with a truth of it the first within half a second of that."""
    blocks = recording.blocks(stream)
    if not blocks or (blocks[0].rate_hz or 0.0) < TAP_HZ:
        return
    shown: list[Onset] = []
    for channel in range(blocks[0].values.shape[1]):
        detector = OnsetDetector(stream, OnsetSettings(input=stream, channel=channel))
        events = [event for block in blocks for event in detector.push(block)]
        shown += [event for event in events if isinstance(event, Onset)]
    near = [event for event in shown if not math.isfinite(touch_s) or abs(event.began_s - touch_s) < 0.5]
    if near:
        first = min(near, key=lambda event: event.began_s)
        yield Label(trial, "tap", stream, first.began_s, math.nan, first.sigma_s, SENSOR)
