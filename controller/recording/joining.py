"""Run folders of trials that have ended, for one folder that has all of them: `Recorder.take_over` writes it."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from typing import NamedTuple

from controller.recording.mcap_file import Topic, topics
from controller.recording.reader import RecordedTrial, RecordingIndex
from controller.recording.run_folder import RunFolder, RunFolderError


class EndedTrial(NamedTuple):
    """A trial as it stands in a run folder.

    Attributes:
        row: Its line of trials.csv.
        events: Its lines of events.jsonl.
        topics: Channels and schemas of that recording.
    """

    number: int
    outcome: str
    row: str
    events: Sequence[bytes]
    recorded: RecordedTrial
    topics: Mapping[int, Topic]


class EndedRun:
    """A run folder, trial by trial.

    Args:
        folder: Of a run that has ended, or of some trials of one.

    Attributes:
        trials: By number, in the order in which they were run.

    Raises:
        RunFolderError: no run, or one that was not written to its end.
    """

    def __init__(self, folder: RunFolder) -> None:
        self.folder = folder
        self.manifest = folder.read_manifest()
        try:
            header, *rows = folder.trials_path.read_text("utf-8").splitlines(keepends=True)
            events: dict[int, list[bytes]] = {}
            for line in folder.events_path.read_bytes().splitlines(keepends=True):
                events.setdefault(json.loads(line)["trial"], []).append(line)
            index = RecordingIndex(folder.recordings)
            known = {path: topics(path) for path in folder.recordings}
            if index.damage:
                raise ValueError(index.damage[0])
            self.columns = header.rstrip("\n").split(",")
            self.trials: dict[int, EndedTrial] = {}
            for row in rows:
                cell, outcome, _ = f"{row},".split(",", 2)
                number = int(cell)
                recorded = index.trials.get(number)
                if recorded is None or recorded.length_s is None:
                    raise ValueError(f"the recording of trial {number} is not whole")
                if recorded.base_ns is None:
                    raise RunFolderError(
                        f"{folder.path}: recorded by an older program (no 'base_ns'); run it anew with this one"
                    )
                own = events.get(number, ())
                self.trials[number] = EndedTrial(
                    number, outcome.strip(), row, own, recorded, known[recorded.path]
                )
        except RunFolderError:
            raise
        except (OSError, KeyError, ValueError) as error:
            raise RunFolderError(f"{folder.path}: damaged or cut off ({error}); resume it first") from None
