"""Reads a run folder again, whole or cut off at any byte."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field
from functools import cached_property
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from mcap.records import Channel, Footer, Metadata

from controller.outcomes import counted, is_success
from controller.recording.mcap_file import CLOSED_AFTERWARDS, ChunkPlace, close_cut, messages, records, topics
from controller.recording.run_folder import RunFolder, RunFolderError
from controller.recording.schemas import (
    RAW,
    READ,
    READINGS,
    SKIPPED,
    TRIAL,
    TRIAL_END,
    decode_block,
    reading_schema,
    schema_of,
)
from controller.recording.series import Series, TrialRecording
from controller.recording.trial_rows import Cell, read_rows
from controller.scales import si_unit
from drivers.core.messages import SampleBlock

if TYPE_CHECKING:
    from pandas import DataFrame

_TABLES = {"profile", "devices", "roles", "plant", "loop", "loss", "signals", "detectors", "outcomes", "exit"}
"""What of a manifest is a table of its own."""

NOTEBOOK_ROWS = 8
"""Trials that a notebook shows of a run (assumption: what leaves its cell on the screen)."""

KEPT_BYTES = 64 << 20
"""How much of what was read is kept: sections of a report and its page ask for the same trials (assumption)."""


@dataclass(frozen=True, eq=False, repr=False)
class Run:
    """A run as it stands on the disk.

    Attributes:
        trials: One mapping a trial, by column, in the order in which they ran.
        notes: What was found cut off or damaged, one sentence each.
    """

    folder: RunFolder
    manifest: Mapping[str, Any]
    trials: Sequence[Mapping[str, Cell]]
    events: Sequence[Mapping[str, Any]]
    notes: list[str] = field(default_factory=list)

    def __repr__(self) -> str:
        outcomes = counted(Counter(str(row["outcome"]) for row in self.trials), self.successes) or "no trial"
        return f"Run({self.folder.path.name}: {outcomes}; table, signal(TRIAL, STREAM), streams)"

    def _repr_html_(self) -> str:
        """For a notebook: what it is, its streams, and the first trials."""
        table = self.table.head(NOTEBOOK_ROWS).to_html(index=False, float_format="%.4g", border=0)
        return f"<p>{escape(repr(self))}<br>{escape(', '.join(self.streams))}</p>{table}"

    @property
    def simulated(self) -> bool:
        """Whether its numbers come from physics in software."""
        return self.manifest.get("bench") in ("mock", "emulated")

    @cached_property
    def resolved(self) -> Mapping[str, Any]:
        """The profile with all its settings; what is "none" in it (a device, a detector, a signal) is not there."""
        profile = (self.manifest.get("profile") or {}).get("resolved") or {}
        named = {name: profile.get(name) or {} for name in ("devices", "detectors", "signals")}
        there = {
            name: {key: table for key, table in tables.items() if isinstance(table, Mapping)}
            for name, tables in named.items()
        }
        return {name: there.get(name, value) for name, value in profile.items()}

    @property
    def measured_by(self) -> list[str]:
        """Devices of a simulated bench that are real: each at a port of its own."""
        devices = self.resolved.get("devices", {}) if self.simulated else {}
        return [
            name for name, table in devices.items() if table.get("port") not in (None, "mock", "emulated")
        ]

    @property
    def cut_off(self) -> bool:
        """Whether the run never came to its end."""
        exit_ = self.manifest.get("exit") or {}
        return bool(exit_.get("status") == "running" or self._index.cut)

    @cached_property
    def table(self) -> DataFrame:
        """The trials as a pandas table: a row each, columns as in trials.csv; units are in `attrs["units"]`."""
        import pandas as pd

        table = pd.DataFrame(list(self.trials))
        table.attrs["units"] = {name: unit for name in table if (unit := si_unit(name.rpartition(".")[2]))}
        return table

    def signal(self, trial: int, name: str) -> Series:
        """A stream of a trial: `run.signal(5, "board.load_cell").to_pandas()`, or `.to_xarray()`.

        Raises:
            KeyError: nothing was recorded of the trial, or it has no such stream.
            RunFolderError: the recording is damaged.
        """
        recording = self.trial(trial)
        if name not in recording.streams:
            raise KeyError(f"trial {trial} has no stream {name}; it has: {', '.join(recording.streams)}")
        return recording.stream(name)

    @property
    def streams(self) -> Sequence[str]:
        """Names of what the first recorded trial has."""
        return self.trial(self.recorded_trials[0]).streams if self.recorded_trials else []

    @cached_property
    def successes(self) -> Sequence[str] | None:
        """The outcomes that are success; None where the experiment declares none."""
        successes: Sequence[str] | None = self.manifest.get("successes")
        return successes

    def succeeded(self, row: Mapping[str, Any]) -> bool:
        """Whether a trial succeeded."""
        return is_success(row.get("outcome"), self.successes)

    def trial(self, number: int) -> TrialRecording:
        """What was recorded of a trial: `run.trial(5).stream("board.load_cell")` has `times_s` and `values`.

        Raises:
            KeyError: nothing was.
            RunFolderError: the recording is damaged.
        """
        return self._index.read(number)

    def events_of(self, trial: object) -> Sequence[Mapping[str, Any]]:
        """The events of a trial, in order."""
        return self._events.get(trial, ())

    @cached_property
    def _events(self) -> Mapping[object, Sequence[Mapping[str, Any]]]:
        found: dict[object, list[Mapping[str, Any]]] = {}
        for event in self.events:
            found.setdefault(event.get("trial"), []).append(event)
        return found

    @property
    def recorded_trials(self) -> Sequence[int]:
        """Numbers of the trials of which samples were recorded."""
        return sorted(self._index.trials)

    @property
    def factors(self) -> Sequence[str]:
        """Columns of what was varied: the trials' factors in the recording, and settings of the profile."""
        recorded = (name for trial in self._index.trials.values() for name in trial.factors)
        settings = (name for row in self.trials for name in row if "." in name)
        return list(dict.fromkeys((*recorded, *settings)))

    def readable(self, trial: int) -> TrialRecording | None:
        """What was recorded of a trial; None where nothing was, or where it is damaged, which is then in `notes`."""
        if trial not in self._index.trials:
            return None
        try:
            return self._index.read(trial)
        except RunFolderError as error:
            note = f"The recording of trial {trial} is damaged, and nothing here is drawn or computed from it: {error}."
            if note not in self.notes:
                self.notes.append(note)
            return None

    @cached_property
    def _index(self) -> RecordingIndex:
        return RecordingIndex(self.folder.recordings)


def close_recordings(folder: RunFolder) -> None:
    """Close what a killed run left open, for other programs; a file that cannot be closed stays as it is."""
    for path in folder.recordings:
        with suppress(Exception):  # `open_run` reports what is damaged
            close_cut(path)


def open_run(path: str | Path, root: Path = Path("runs")) -> Run:
    """Open a run: a folder, a part of its name under `root`, or `latest`.

    Raises:
        RunFolderError: there is no such run, or it cannot be read.
    """
    folder = RunFolder.find(path, root)
    manifest = folder.read_manifest()
    if "parts" in manifest:
        names = ", ".join(part.path.name for part in folder.runs) or "none yet"
        raise RunFolderError(f"{folder.path}: holds several runs; give one of them: {names}")
    with _reading(folder.manifest_path):
        _check([manifest], dict.fromkeys(_TABLES & set(manifest), dict))
        _check([{"successes": [], **manifest}], {"successes": list | None})
        ended = sum((manifest.get("outcomes") or {}).values())
    with _reading(folder.trials_path):
        trials, row_cut = read_rows(folder.trials_path)
        _check(trials, {"trial": int, "outcome": str})
    with _reading(folder.events_path):
        events, event_cut = _read_events(folder.events_path)
        _check(events, {"trial": int, "event": str, "t_s": int | float})
    run = Run(folder, manifest, trials, events)
    index = run._index
    if (manifest.get("exit") or {}).get("status") == "running":
        run.notes.append("The run was cut off: its manifest still says that it is running.")
    if row_cut:
        run.notes.append("The last line of trials.csv is incomplete and was left out.")
    if ended > len(trials):
        run.notes.append(f"trials.csv has {len(trials)} rows, but {ended} trials ended: the others are lost.")
    if event_cut:
        run.notes.append("The last line of events.jsonl is incomplete and was left out.")
    if trials and not folder.recordings:
        run.notes.append("There is no recording.mcap: nothing that was sampled can be shown.")
    if index.closed:
        run.notes.append("The recording was cut off, and closed afterwards behind its last whole chunk.")
    elif index.cut:
        run.notes.append("The recording has no footer; it was read up to its last whole chunk.")
    run.notes.extend(index.damage)
    return run


@contextmanager
def _reading(what: object) -> Iterator[None]:
    """Data from the disk may be anything, and passes through CSV, JSON, MCAP, zstd, protobuf and NumPy. Each has
    errors of its own; here all of them become the one that callers handle.
    """
    try:
        yield
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise RunFolderError(f"{what}: damaged ({reason})") from error


def _check(rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, Any]) -> None:
    for number, row in enumerate(rows, start=1):
        for name, kind in kinds.items():
            if not isinstance(row.get(name), kind):
                raise ValueError(f"row {number} has no {name}")


def _read_events(path: Path) -> tuple[list[dict[str, Any]], bool]:
    """All whole lines, and whether a last one was cut off."""
    if not path.exists():
        return [], False
    whole, _, cut = path.read_text("utf-8", errors="replace").rpartition("\n")
    return [json.loads(line) for line in whole.splitlines()], bool(cut)


@dataclass
class RecordedTrial:
    """Where a recording has a trial.

    Attributes:
        base_ns: Log time of its bench time zero.
        length_s: How long it took, s of bench time; None where it did not come to its end.
    """

    path: Path
    factors: dict[str, object]
    base_ns: int
    length_s: float | None = None
    chunks: list[ChunkPlace] = field(default_factory=list)


class RecordingIndex:
    """Which chunks of which file belong to which trial; nothing is decompressed before it is asked for."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self.cut = self.closed = False
        self.damage: list[str] = []
        self.trials: dict[int, RecordedTrial] = {}
        self._channels: dict[Path, dict[int, Channel]] = {}
        self._kept: dict[int, TrialRecording] = {}
        self._kept_bytes = 0
        self._block, self._skipped = schema_of("Block"), schema_of("Skipped")
        self._readings = reading_schema()
        for path in paths:
            try:
                with _reading(path):
                    self._scan(path)
            except RunFolderError as error:
                self.damage.append(f"{error}; what stands behind that place was not read.")

    def _scan(self, path: Path) -> None:
        present: RecordedTrial | None = None
        whole = False
        for record in records(path):
            if isinstance(record, ChunkPlace) and present is not None:
                present.chunks.append(record)
            elif isinstance(record, Metadata):
                noted = record.metadata
                if record.name == TRIAL:
                    factors = dict(json.loads(noted["factors"]))
                    present = RecordedTrial(path, factors, int(noted["base_ns"]))
                    self.trials[int(noted["trial"])] = present  # run again: in place of its first attempt
                elif record.name == TRIAL_END and present is not None:
                    present.length_s = float(noted.get("length_s", 0.0))
                self.closed = self.closed or record.name == CLOSED_AFTERWARDS
            whole = isinstance(record, Footer)
        self.cut = self.cut or self.closed or not whole

    def read(self, trial: int) -> TrialRecording:
        """What was recorded of a trial.

        Raises:
            KeyError: nothing was.
            RunFolderError: it is damaged.
        """
        if trial not in self.trials:
            raise KeyError(f"trial {trial}: nothing was recorded of it")
        if trial in self._kept:
            return self._kept[trial]
        found = self.trials[trial]
        path, recording, size = found.path, TrialRecording(trial, found.factors), 0
        widths: dict[str, tuple[int, ...]] = {}
        for chunk in found.chunks:
            with _reading(f"{path}, the chunk at byte {chunk.body}"):
                channels = self._wanted(path)
                readings: dict[int, list[tuple[int, bytes]]] = {}
                for number, sequence, _, data in messages(path, chunk):
                    if number not in channels:
                        continue
                    channel, size = channels[number], size + len(data)
                    if channel.topic == SKIPPED:
                        skipped = self._skipped.message.FromString(data)
                        recording.skip(skipped.stream, skipped.t0_s, skipped.t1_s)
                    elif channel.topic.startswith(RAW):
                        block = decode_block(self._block, channel.metadata["stream"], data)
                        if widths.setdefault(block.stream, block.values.shape[1:]) != block.values.shape[1:]:
                            raise ValueError(f"{block.stream}: a block with another number of channels")
                        recording.add(block)
                    else:
                        readings.setdefault(number, []).append((sequence, data))
                for number, several in readings.items():
                    recording.add(self._joined(channels[number], several))
        if self._kept_bytes + size <= KEPT_BYTES:
            self._kept[trial] = recording
            self._kept_bytes += size
        return recording

    def _joined(self, channel: Channel, several: Sequence[tuple[int, bytes]]) -> SampleBlock:
        """A detector's readings in a row."""
        read = [self._readings.message.FromString(data) for _, data in several]
        table = np.array([[getattr(each, name) for name in READINGS] for each in read])
        stream, unit, times_s = channel.metadata["stream"], channel.metadata["unit"], table[:, 0]
        return SampleBlock(stream, several[0][0], float(times_s[0]), table[:, 1:], times_s=times_s, unit=unit)

    def _wanted(self, path: Path) -> Mapping[int, Channel]:
        """The channels that are read: blocks, detectors' readings, and skipped spans."""
        if path not in self._channels:
            found = {number: channel for number, (channel, _) in topics(path).items()}
            read = (SKIPPED, RAW, READ)
            self._channels[path] = {
                number: one for number, one in found.items() if one.topic.startswith(read)
            }
        return self._channels[path]
