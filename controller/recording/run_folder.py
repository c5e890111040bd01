"""The folder of one run: made, found, checked; its manifest is replaced whole or not at all."""

from __future__ import annotations

import json
import math
import os
import secrets
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

FORMAT = 1
"""Version of the folder's layout, in the manifest as `format`."""

MANIFEST = "manifest.json"
TRIALS = "trials.csv"
EVENTS = "events.jsonl"


class RunFolderError(ValueError):
    """The folder is no run, or cannot be read as one."""


class RecordingError(OSError):
    """A run can no longer be written: no disk space, no permission, the disk is gone."""

    def __init__(self, path: Path, doing: str, cause: Exception) -> None:
        self.path = path
        if isinstance(cause, OSError):
            number, reason = cause.errno, cause.strerror or str(cause)
            advice = "make room on that disk, or choose another with --out"
            if isinstance(cause, PermissionError):
                advice = "choose a folder that may be written, with --out"
        else:
            number, reason = None, f"{type(cause).__name__} ({cause})"
            advice = "trials.csv and events.jsonl go on; run again with --debug"
        super().__init__(number, f"recorder: {reason} while {doing} {path}; {advice}")

    def __str__(self) -> str:
        return str(self.strerror)


class RunFolder:
    """Where one run keeps its files.

    Args:
        path: The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.manifest_path = path / MANIFEST
        self.trials_path = path / TRIALS
        self.events_path = path / EVENTS

    @property
    def recordings(self) -> Sequence[Path]:
        """The recordings, oldest first: one, and one more for each time that the run was resumed."""
        return sorted(self.path.glob("recording*.mcap"), key=lambda path: (len(path.name), path.name))

    def new_recording(self) -> Path:
        """Name of the recording to write now; what is there is never written over."""
        count = len(self.recordings)
        return self.path / ("recording.mcap" if count == 0 else f"recording_{count + 1}.mcap")

    @classmethod
    def create(cls, root: Path, profile: str, started_utc: datetime) -> RunFolder:
        """Make `root/<UTC>_<profile>_<4 hex>/`.

        Raises:
            RecordingError: the folder cannot be made.
        """
        stamp = started_utc.strftime("%Y-%m-%dT%H-%M-%SZ")
        name = f"{stamp}_{profile.replace('/', '-')}_{secrets.token_hex(2)}"
        try:
            root.mkdir(parents=True, exist_ok=True)
            (root / name).mkdir()
        except FileExistsError:
            if (root / name).is_dir():  # the same second and the same four digits
                return cls.create(root, profile, started_utc)
            raise RecordingError(root, "making", NotADirectoryError(20, "a file is in the way")) from None
        except OSError as error:
            raise RecordingError(root / name, "making", error) from error
        return cls(root / name)

    @classmethod
    def find(cls, text: str | Path, root: Path = Path("runs")) -> RunFolder:
        """The run at a path, or the one under `root` whose name contains `text`.

        `latest` is the newest of all, `latest:mock/transient` the newest of that profile.

        Raises:
            RunFolderError: none, several, or no run.
        """
        path = Path(text)
        if path.name == MANIFEST:
            path = path.parent
        if path.is_dir():
            folder = cls(path)
            folder.read_manifest()
            return folder
        runs = sorted(manifest.parent for manifest in root.glob(f"*/{MANIFEST}"))
        word, _, profile = str(text).partition(":")
        if word == "latest":
            matches = [
                run for run in runs if not profile or _profile_of(run.name) == profile.replace("/", "-")
            ][-1:]
        else:
            matches = [run for run in runs if str(text) in run.name]
        if len(matches) == 1:
            return cls.find(matches[0])
        if matches:
            names = ", ".join(run.name for run in matches[:3])
            raise RunFolderError(f"{text}: {len(matches)} runs match ({names}…); give more of the name")
        raise RunFolderError(f"{text}: no such run folder; `ls {root}` shows what there is")

    def write_manifest(self, manifest: Mapping[str, Any]) -> None:
        """Replace the manifest: a reader, or a kill, sees the old one or the new one, never a part.

        Raises:
            RecordingError: it cannot be written.
        """
        temporary = self.manifest_path.with_suffix(".json.tmp")
        try:
            with temporary.open("w", encoding="utf-8") as file:
                json.dump(_plain({"format": FORMAT, **manifest}), file, indent=2, allow_nan=False)
                file.write("\n")
                file.flush()
                os.fsync(file.fileno())
            temporary.replace(self.manifest_path)
        except OSError as error:
            raise RecordingError(self.manifest_path, "writing", error) from error

    def read_manifest(self) -> dict[str, Any]:
        """The manifest.

        Raises:
            RunFolderError: no run folder, a damaged manifest, or one of a later version.
        """
        try:
            manifest = json.loads(self.manifest_path.read_text("utf-8"))
        except FileNotFoundError:
            raise RunFolderError(
                f"{self.path}: no run folder, for it has no {MANIFEST}; give a folder that `run` made"
            ) from None
        except (ValueError, OSError) as error:
            raise RunFolderError(f"{self.manifest_path}: cut off or damaged ({error})") from None
        if not isinstance(manifest, dict) or "format" not in manifest:
            raise RunFolderError(
                f"{self.manifest_path}: not the manifest of a run; give a folder that `run` made"
            )
        if manifest["format"] != FORMAT:
            raise RunFolderError(
                f"{self.manifest_path}: format {manifest['format']}, this program reads {FORMAT}; update it"
            )
        return manifest


def _plain(value: object) -> Any:
    """A value as JSON knows it: what is not finite becomes null, what is of no JSON type its text."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(item) for item in value]
    if isinstance(value, set | frozenset):
        return sorted(_plain(item) for item in value)
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    return value if value is None or isinstance(value, str | bool | int) else str(value)


def _profile_of(name: str) -> str:
    """The profile's part of a run folder's name."""
    return name.partition("_")[2].rpartition("_")[0]
