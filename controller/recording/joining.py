"""Run folders that are written on: of trials that have ended, for one folder of all; and a run that broke off."""

import errno
import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from controller.outcomes import UNMEASURED
from controller.recording.mcap_file import Topic, topics
from controller.recording.reader import RecordedTrial, RecordingIndex
from controller.recording.run_folder import RunFolder, RunFolderError, lock, replace_file, writing
from controller.recording.trial_rows import Cell, read_rows


class EndedTrial(NamedTuple):
    """A trial as it stands in a run folder."""

    number: int
    outcome: str
    row: str
    cells: Mapping[str, Cell]
    events: Sequence[str]
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
            header, *lines = folder.trials_path.read_text("utf-8").splitlines(keepends=True)
            rows, cut = read_rows(folder.trials_path)
            events: dict[int, list[str]] = {}
            for event in folder.events_path.read_text("utf-8").splitlines(keepends=True):
                events.setdefault(json.loads(event)["trial"], []).append(event)
            index = RecordingIndex(folder.recordings)
            known = {path: topics(path) for path in {trial.path for trial in index.trials.values()}}
            if cut:
                raise ValueError("the last row of trials.csv")
            self.columns = header.rstrip("\n").split(",")
            self.trials: dict[int, EndedTrial] = {}
            for line, cells in zip(lines, rows, strict=True):
                number = int(cells["trial"])  # type: ignore[arg-type]
                recorded = index.trials.get(number)
                if recorded is None or recorded.length_s is None:
                    damage = "".join(f"; {each}" for each in index.damage[:1])
                    raise ValueError(f"the recording of trial {number} is not whole{damage}")
                outcome, own = str(cells["outcome"]), events.get(number, ())
                self.trials[number] = EndedTrial(
                    number, outcome, line, cells, own, recorded, known[recorded.path]
                )
        except (OSError, LookupError, TypeError, ValueError) as error:
            raise RunFolderError(f"{folder.path}: damaged or cut off ({error}); resume it first") from None


TORN = "interrupted.jsonl"
"""Where the events of torn trials go; their samples stay in the recording that they broke off."""


class ResumedRun(NamedTuple):
    """A run to go on with.

    Attributes:
        done: Outcomes of the trials that stay, by number.
        unrecorded: Trials that were measured, and whose samples were not written to their end.
    """

    folder: RunFolder
    manifest: Mapping[str, Any]
    done: Mapping[int, str]
    unrecorded: Sequence[int] = ()


def broken_off(folder: RunFolder) -> ResumedRun:
    """Read what a run has done; nothing is changed.

    A trial is done once its row and its samples are written. Where no recording is left at all, the rows stand.

    Raises:
        RunFolderError: no run, or one that cannot be read.
    """
    manifest = folder.read_manifest()
    try:
        rows, _ = read_rows(folder.trials_path)
        whole = [(int(row["trial"]), str(row["outcome"])) for row in rows]  # type: ignore[arg-type]
    except (ValueError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"{folder.trials_path}: damaged ({error}); mend that line, or run it anew"
        ) from None
    kept = {trial: outcome for trial, outcome in whole if outcome not in UNMEASURED}
    if not folder.recordings:
        return ResumedRun(folder, manifest, kept)
    recorded = RecordingIndex(folder.recordings).trials
    ended = {trial for trial, found in recorded.items() if found.length_s is not None}
    done = {trial: outcome for trial, outcome in kept.items() if trial in ended}
    return ResumedRun(folder, manifest, done, [trial for trial in kept if trial not in ended])


def hold(folder: RunFolder) -> int:
    """Hold a run's folder for this program alone, until the file descriptor that is returned is closed.

    Not every file system has such locks (some of a network): there the folder is not held.

    Raises:
        RunFolderError: another program writes into it.
        RecordingError: it cannot be opened.
    """
    with writing(folder.path, "opening"):
        held = os.open(folder.path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        lock(held)
    except OSError as error:
        if error.errno == errno.EWOULDBLOCK:
            os.close(held)
            raise RunFolderError(
                f"{folder.path}: this run goes on in another program; wait for its end"
            ) from None
    return held


def clear(resumed: ResumedRun) -> None:
    """Take out of trials.csv and events.jsonl what belongs to trials that are run again, in a folder that is held.

    Each file is replaced whole or not at all: a kill in between leaves a run that can be resumed once more.

    Raises:
        RunFolderError: another program has gone on with it since it was read.
        RecordingError: it cannot be written.
    """
    folder, done = resumed.folder, resumed.done
    if broken_off(folder) != resumed:
        raise RunFolderError(f"{folder.path}: another program went on with this run; resume it again")
    with writing(folder.path, "making ready"):
        header, *rows = _lines(folder.trials_path) or [b""]
        events = _lines(folder.events_path)
        if torn := [line for line in events if _trial_of_event(line) not in done]:
            with (folder.path / TORN).open("ab") as file:
                file.writelines(torn)
            stay = (line for line in events if _trial_of_event(line) in done)
            replace_file(folder.events_path, b"".join(stay))
        whole = [line for line in rows if line.endswith(b"\n") and int(line.split(b",")[0]) in done]
        if len(whole) < len(rows):
            replace_file(folder.trials_path, b"".join([header, *whole]))


def _lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True) if path.exists() else []


def _trial_of_event(line: bytes) -> object:
    """The trial of a whole line of events.jsonl, None of one that was cut off or damaged."""
    try:
        return json.loads(line)["trial"] if line.endswith(b"\n") else None
    except (ValueError, KeyError, TypeError):
        return None
