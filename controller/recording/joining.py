"""Puts trials that were run apart into one run folder, indistinguishable from that of one run."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path

from mcap.records import Metadata

from controller.recording.event_log import EventLog
from controller.recording.ledger import Ledger
from controller.recording.mcap_file import ChunkPlace, records, topics
from controller.recording.run_folder import RecordingError, RunFolder, RunFolderError
from controller.recording.schemas import TRIAL, TRIAL_END
from controller.recording.stream_writer import StreamWriter


@dataclass
class _Recorded:
    """What a recording has of a trial; `base_ns` is the log time of its bench time zero."""

    path: Path
    base_ns: int
    factors: Mapping[str, object]
    length_s: float | None = None
    chunks: list[ChunkPlace] = field(default_factory=list)


class Parts:
    """A run folder, trial by trial.

    Args:
        folder: Of a run that has ended, or of a part of one.

    Raises:
        RunFolderError: no run, or one that was not written to its end.
    """

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder
        self.manifest = folder.read_manifest()
        try:
            header, *rows = folder.trials_path.read_text("utf-8").splitlines(keepends=True)
            self.columns = header.rstrip("\n").split(",")
            self._rows = {int(row.split(",", 1)[0]): row for row in rows}
            self._events: dict[int, list[bytes]] = {}
            for line in folder.events_path.read_bytes().splitlines(keepends=True):
                self._events.setdefault(json.loads(line)["trial"], []).append(line)
            self._recorded: dict[int, _Recorded] = {}
            self.topics = {path: topics(path) for path in folder.recordings}
            for path in folder.recordings:
                self._scan(path)
        except KeyError as error:
            raise RunFolderError(
                f"{folder.path}: recorded by an older program (no {error}); run it anew with this one"
            ) from None
        except (OSError, ValueError) as error:
            raise RunFolderError(f"{folder.path}: damaged or cut off ({error}); resume it first") from None

    @property
    def trials(self) -> Sequence[int]:
        """Numbers of the trials that have a row, in the order in which they were run."""
        return list(self._rows)

    def _scan(self, path: Path) -> None:
        present: _Recorded | None = None
        for record in records(path):
            if isinstance(record, ChunkPlace) and present is not None:
                present.chunks.append(record)
            elif isinstance(record, Metadata):
                present = self._noted(path, record, present)

    def _noted(self, path: Path, record: Metadata, present: _Recorded | None) -> _Recorded | None:
        noted = record.metadata
        if record.name == TRIAL:
            present = _Recorded(path, int(noted["base_ns"]), json.loads(noted["factors"]))
            self._recorded[int(noted["trial"])] = present  # one that was run again replaces its first attempt
        elif record.name == TRIAL_END and present is not None:
            present.length_s = float(noted["length_s"])
            present = None
        return present

    def outcome(self, trial: int) -> str:
        """How a trial ended."""
        return self._rows[trial].split(",", 2)[1]

    def row(self, trial: int) -> str:
        """A trial's line of trials.csv."""
        return self._rows[trial]

    def events(self, trial: int) -> Sequence[bytes]:
        """A trial's lines of events.jsonl."""
        return self._events.get(trial, ())

    def recorded(self, trial: int) -> _Recorded:
        """Where the samples of a trial are.

        Raises:
            RunFolderError: they are not whole.
        """
        found = self._recorded.get(trial)
        if found is None or found.length_s is None:
            raise RunFolderError(f"{self.folder.path}: the recording of trial {trial} is not whole")
        return found


class Joiner:
    """Writes the trials of several folders into one, in the order in which they are given.

    Args:
        folder: Where to.
        wall_start: Calendar time at which the campaign's time is zero.
        columns: Of trials.csv, the first two left out.

    Raises:
        RecordingError: it cannot be written.
    """

    def __init__(self, folder: RunFolder, wall_start: datetime, columns: Sequence[str]) -> None:
        self._ledger = Ledger(folder.trials_path, (), columns)
        self._streams = StreamWriter(folder.new_recording(), wall_start, {})
        self._events = EventLog(folder.events_path)
        self._path = folder.path
        self._offset_s = 0.0

    def add(self, parts: Parts, trial: int) -> float:
        """Take over one trial: samples, events, row; returns how long it took, in s of bench time.

        Raises:
            RecordingError: it cannot be written.
            RunFolderError: it is not whole where it comes from.
        """
        recorded = parts.recorded(trial)
        assert recorded.length_s is not None
        try:
            self._streams.begin_trial(trial, recorded.factors, self._offset_s)
            for chunk in recorded.chunks:
                self._streams.copy(recorded.path, chunk, parts.topics[recorded.path], recorded.base_ns)
            self._streams.end_trial(recorded.length_s, self._ledger.cells(parts.row(trial)))
        except OSError as error:
            raise RecordingError(self._path, "writing", error) from error
        self._offset_s += recorded.length_s
        for line in parts.events(trial):
            self._events.add_line(line)
        self._ledger.add(parts.row(trial))
        return recorded.length_s

    def attach(self, name: str, data: bytes) -> None:
        """Put a JSON file into the recording."""
        self._streams.attach(name, data)

    def commit(self) -> None:
        """See all that was taken over on the disk, each row after its samples and events.

        Raises:
            RecordingError: it cannot be written.
        """
        try:
            self._streams.commit(sync=True)
            self._events.commit(sync=True)
            self._ledger.commit(sync=True)
        except RecordingError:
            raise
        except OSError as error:
            raise RecordingError(self._path, "writing", error) from error

    def close(self) -> None:
        """Finish the files.

        Raises:
            RecordingError: it cannot be written.
        """
        try:
            self.commit()
            self._streams.finish()
        except OSError as error:
            raise RecordingError(self._path, "closing", error) from error
        finally:
            self._streams.abandon()
            self._events.finish()
