"""A run that broke off, made ready to go on: what was done stays, what was torn is taken out and done again."""

from __future__ import annotations

import json
import os
from collections import Counter
from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

from controller.outcomes import UNMEASURED, word_of
from controller.recording.ledger import read_ledger
from controller.recording.lock import lock
from controller.recording.run_folder import RecordingError, RunFolder, RunFolderError, replace_file

TORN = "interrupted.jsonl"
"""Where the events of torn trials go; their samples stay in the recording that they broke off."""


class ResumedRun(NamedTuple):
    """A run to go on with.

    Attributes:
        done: Numbers of the trials that stay.
        outcomes: How often each of their outcomes was.
    """

    folder: RunFolder
    manifest: Mapping[str, Any]
    done: frozenset[int]
    outcomes: Mapping[str, int]


def broken_off(folder: RunFolder) -> ResumedRun:
    """Read what a run has done; nothing is changed.

    Raises:
        RunFolderError: no run, or one that cannot be read.
    """
    manifest = folder.read_manifest()
    try:
        rows, _ = read_ledger(folder.trials_path)
        whole = [(int(row["trial"]), word_of(manifest, row)) for row in rows]  # type: ignore[arg-type]
    except (ValueError, KeyError, TypeError) as error:
        raise RunFolderError(
            f"{folder.trials_path}: damaged ({error}); mend that line, or run it anew"
        ) from None
    kept = {trial: outcome for trial, outcome in whole if outcome not in UNMEASURED}
    return ResumedRun(folder, manifest, frozenset(kept), dict(Counter(kept.values())))


def hold(folder: RunFolder) -> int:
    """Hold a run's folder for this program alone, until the file descriptor that is returned is closed.

    Raises:
        RunFolderError: another program writes into it.
        RecordingError: it cannot be opened.
    """
    try:
        held = os.open(folder.path, os.O_RDONLY | os.O_DIRECTORY)
    except OSError as error:
        raise RecordingError(folder.path, "opening", error) from error
    try:
        lock(held)
    except OSError:
        os.close(held)
        raise RunFolderError(
            f"{folder.path}: this run goes on in another program; wait for its end"
        ) from None
    return held


def clear(resumed: ResumedRun) -> None:
    """Take out of trials.csv and events.jsonl what belongs to trials that are run again.

    Each file is replaced whole or not at all: a kill in between leaves a run that can be resumed once more.

    Raises:
        RecordingError: it cannot be written.
    """
    folder = resumed.folder
    try:
        header, *rows = _lines(folder.trials_path) or [b""]
        events = _lines(folder.events_path)
        stay = [line for line in events if _trial_of_event(line) in resumed.done]
        if len(stay) < len(events):
            with (folder.path / TORN).open("ab") as file:
                file.writelines(line for line in events if _trial_of_event(line) not in resumed.done)
            replace_file(folder.events_path, b"".join(stay))
        whole = [line for line in rows if line.endswith(b"\n") and int(line.split(b",")[0]) in resumed.done]
        if len(whole) < len(rows):
            replace_file(folder.trials_path, b"".join([header, *whole]))
    except OSError as error:
        raise RecordingError(folder.path, "making ready", error) from error


def _lines(path: Path) -> list[bytes]:
    return path.read_bytes().splitlines(keepends=True) if path.exists() else []


def _trial_of_event(line: bytes) -> object:
    """The trial of a whole line of events.jsonl, None of one that was cut off or damaged."""
    try:
        return json.loads(line)["trial"] if line.endswith(b"\n") else None
    except (ValueError, KeyError, TypeError):
        return None
