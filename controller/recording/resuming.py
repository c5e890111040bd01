"""A run that broke off, made ready to go on: what was done stays, what was torn is taken out and done again."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from controller.outcomes import UNMEASURED, word_of
from controller.recording.ledger import read_ledger
from controller.recording.lock import lock
from controller.recording.run_folder import RecordingError, RunFolder, RunFolderError

TORN = "interrupted.jsonl"
"""Where the events of torn trials go; their samples stay in the recording that they broke off."""


@dataclass(frozen=True)
class ResumedRun:
    """A run to go on with.

    Attributes:
        folder: Of the run.
        manifest: As it stands there.
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
    kept = [(trial, outcome) for trial, outcome in whole if outcome not in UNMEASURED]
    outcomes: dict[str, int] = {}
    for _, outcome in kept:
        outcomes[outcome] = outcomes.get(outcome, 0) + 1
    return ResumedRun(folder, manifest, frozenset(trial for trial, _ in kept), outcomes)


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
    kept, torn = _parted(folder.events_path, resumed.done)
    try:
        if torn:
            with (folder.path / TORN).open("ab") as file:
                file.writelines(torn)
            _replace(folder.events_path, kept)
        rows, cut = read_ledger(folder.trials_path)
        if cut or len(rows) != len(resumed.done):
            lines = folder.trials_path.read_bytes().splitlines(keepends=True)
            whole = [line for line in lines if line.endswith(b"\n")]
            stays = [line for line, row in zip(whole[1:], rows, strict=True) if row["trial"] in resumed.done]
            _replace(folder.trials_path, [*whole[:1], *stays])
    except OSError as error:
        raise RecordingError(folder.path, "making ready", error) from error


def _parted(path: Path, done: frozenset[int]) -> tuple[list[bytes], list[bytes]]:
    """Lines of events of trials that stay, and all others."""
    kept: list[bytes] = []
    torn: list[bytes] = []
    lines = path.read_bytes().splitlines(keepends=True) if path.exists() else []
    for line in lines:
        try:
            stays = line.endswith(b"\n") and json.loads(line)["trial"] in done
        except (ValueError, KeyError, TypeError):
            stays = False
        (kept if stays else torn).append(line)
    return kept, torn


def _replace(path: Path, lines: list[bytes]) -> None:
    temporary = path.with_suffix(path.suffix + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.writelines(lines)
            file.flush()
            os.fsync(file.fileno())
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)
