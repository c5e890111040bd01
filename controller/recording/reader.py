"""Reads a run folder again, whole or cut off at any byte."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from mcap.records import Channel, Footer, Metadata

from controller.recording.ledger import Cell, read_ledger
from controller.recording.mcap_file import messages, records
from controller.recording.run_folder import RunFolder, RunFolderError
from controller.recording.schemas import block_schema, decode_block, skipped_schema
from controller.recording.series import TrialRecording


@dataclass(frozen=True, eq=False)
class Run:
    """A run as it stands on the disk.

    Attributes:
        folder: Where it is.
        manifest: How it was run.
        trials: One mapping a trial, by column, in the order in which they ran.
        events: One mapping an event.
        notes: What was found cut off, one sentence each.
    """

    folder: RunFolder
    manifest: Mapping[str, Any]
    trials: Sequence[Mapping[str, Cell]]
    events: Sequence[Mapping[str, Any]]
    notes: list[str] = field(default_factory=list)

    @property
    def simulated(self) -> bool:
        """Whether its numbers come from physics in software."""
        return self.manifest.get("bench") in ("mock", "emulated")

    @property
    def cut_off(self) -> bool:
        """Whether the run never came to its end."""
        exit_ = self.manifest.get("exit") or {}
        return bool(exit_.get("status") == "running" or self._index.cut)

    @property
    def recorded_trials(self) -> Sequence[int]:
        """Numbers of the trials of which samples were recorded."""
        return sorted(trial for trial in self._index.chunks if trial >= 0)

    def recording(self, trial: int) -> TrialRecording:
        """What was recorded of a trial.

        Raises:
            KeyError: nothing was.
            ValueError: the recording is damaged.
        """
        return self._index.read(trial)

    @cached_property
    def _index(self) -> _Index:
        return _Index(self.folder.recordings)


def open_run(path: str | Path, root: Path = Path("runs")) -> Run:
    """Open a run: a folder, a part of its name under `root`, or `latest`.

    Raises:
        RunFolderError: there is no such run, or it cannot be read.
    """
    folder = RunFolder.find(path, root)
    manifest = folder.read_manifest()
    try:
        trials, row_cut = read_ledger(folder.trials_path)
        events, event_cut = _read_events(folder.events_path)
        run = Run(folder, manifest, trials, events)
        index = run._index
    except ValueError as error:
        raise RunFolderError(str(error)) from error
    if (manifest.get("exit") or {}).get("status") == "running":
        run.notes.append("The run was cut off: its manifest still says that it is running.")
    if row_cut:
        run.notes.append("The last line of trials.csv is incomplete and was left out.")
    ended = sum((manifest.get("outcomes") or {}).values())
    if ended > len(trials):
        run.notes.append(f"trials.csv has {len(trials)} rows, but {ended} trials ended: the others are lost.")
    if event_cut:
        run.notes.append("The last line of events.jsonl is incomplete and was left out.")
    if index.cut:
        run.notes.append("The recording has no footer; it was read up to its last whole chunk.")
    return run


def _read_events(path: Path) -> tuple[list[dict[str, Any]], bool]:
    """All whole lines, and whether a last one was cut off."""
    if not path.exists():
        return [], False
    whole, _, cut = path.read_text("utf-8", errors="replace").rpartition("\n")
    try:
        return [json.loads(line) for line in whole.splitlines()], bool(cut)
    except ValueError as error:
        raise ValueError(f"{path}: a damaged line ({error})") from error


class _Index:
    """Which chunks of which file belong to which trial; nothing is decompressed before it is asked for."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self.cut = False
        self.chunks: dict[int, list[tuple[Path, int, int]]] = {}
        self.factors: dict[int, dict[str, object]] = {}
        self._channels: dict[Path, dict[int, Channel]] = {}
        self._block, self._skipped = block_schema(), skipped_schema()
        for path in paths:
            self._scan(path)

    def _scan(self, path: Path) -> None:
        channels = self._channels[path] = {}
        present, whole = -1, False
        for record in records(path):
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Metadata) and record.name == "trial":
                present = int(record.metadata["trial"])
                self.factors[present] = json.loads(record.metadata["factors"])
                self.chunks[present] = []  # a trial that was run again replaces its first attempt
            elif isinstance(record, tuple):
                self.chunks.setdefault(present, []).append((path, *record))
            whole = isinstance(record, Footer)
        self.cut = self.cut or not whole

    def read(self, trial: int) -> TrialRecording:
        if trial not in self.chunks:
            raise KeyError(f"trial {trial}: nothing was recorded of it")
        recording = TrialRecording(trial, self.factors.get(trial))
        for path, body, length in self.chunks[trial]:
            for topic, data in self._messages(path, body, length):
                if topic.topic == "/skipped":
                    skipped = self._skipped.message.FromString(data)
                    recording.skip(skipped.stream, skipped.t0_s, skipped.t1_s)
                else:
                    recording.add(decode_block(self._block, topic.metadata["stream"], data))
        return recording

    def _messages(self, path: Path, body: int, length: int) -> Iterator[tuple[Channel, bytes]]:
        channels = self._channels[path]
        wanted = frozenset(
            number
            for number, each in channels.items()
            if each.topic == "/skipped" or each.topic.startswith("/raw/")
        )
        for number, data in messages(path, body, length, wanted):
            yield channels[number], data
