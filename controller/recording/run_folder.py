"""The folder of one run: made, found, checked; its manifest is replaced whole or not at all."""

from __future__ import annotations

import errno
import hashlib
import json
import math
import os
import re
import secrets
import shutil
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from datetime import datetime
from numbers import Integral, Real
from pathlib import Path
from typing import IO, Any

FORMAT = 1
"""Version of the folder's layout, in the manifest as `format`."""

MANIFEST = "manifest.json"
TRIALS = "trials.csv"
EVENTS = "events.jsonl"


ROOM_BYTES = 1 << 18
"""What is kept free for the last manifest: some ten times the largest of a profile here."""

PROFILE_BYTES = 160
"""Longest part of a folder's name that a profile makes; a name may have 255 bytes, and time and digits take 27."""


class RunFolderError(ValueError):
    """The folder is no run, or cannot be read as one."""


_FIRST: Mapping[int | None, str] = {
    **dict.fromkeys((errno.ENOSPC, errno.EDQUOT, errno.EFBIG), "make room on that disk, or "),
    **dict.fromkeys((errno.EEXIST, errno.ENOTDIR, errno.EISDIR), "move away what stands there, or "),
    errno.EMFILE: "allow more open files (ulimit -n), or ",
}
"""What to do first about an error of the file system, by its number."""


class RecordingError(OSError):
    """A run can no longer be written: no disk space, no permission, the disk is gone.

    Args:
        option: The option that chooses another place; "" where there is none.
    """

    def __init__(self, path: Path, doing: str, cause: Exception, option: str = "--out") -> None:
        self.path = path
        self._given = path, doing, cause, option
        if isinstance(cause, OSError):
            number, reason = cause.errno, cause.strerror or str(cause)
            in_place = "copy the run folder to one that may be written, and give that one"
            advice = _FIRST.get(number, "") + (f"choose another folder with {option}" if option else in_place)
        else:
            number, reason = None, f"{type(cause).__name__} ({cause})"
            advice = "run again with --debug"
        super().__init__(number, f"recorder: {reason} while {doing} {path}; {advice}")

    def __reduce__(self) -> tuple[Any, ...]:  # that of OSError gives this one its number and its line
        return type(self), self._given

    def __str__(self) -> str:
        return str(self.strerror)


@contextmanager
def writing(path: Path, doing: str = "writing", option: str = "--out") -> Iterator[None]:
    """What the file system raises in here becomes a `RecordingError`, whose arguments these are."""
    try:
        yield
    except OSError as error:
        raise RecordingError(path, doing, error, option) from error


class RunFolder:
    """Where one run keeps its files."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.manifest_path = path / MANIFEST
        self.trials_path = path / TRIALS
        self.events_path = path / EVENTS
        self._room: IO[bytes] | None = None

    @property
    def runs(self) -> Sequence[RunFolder]:
        """The run, or where it is a campaign of parts those that were begun, in their order.

        Raises:
            RunFolderError: no run, or a damaged manifest.
        """
        if "parts" not in self.read_manifest():
            return [self]
        parts = [RunFolder(manifest.parent) for manifest in self.path.glob(f"*/{MANIFEST}")]
        return sorted(parts, key=lambda part: str(part.read_manifest().get("started_utc")))

    @property
    def begun(self) -> bool:
        """Whether its devices were opened, or are being opened: a run that ended before that has nothing to show."""
        if self.trials_path.is_file():
            return True
        manifest = self.read_manifest()
        return "parts" in manifest or (manifest.get("exit") or {}).get("status") not in ("fault", "failed")

    @property
    def recordings(self) -> Sequence[Path]:
        """The recordings, oldest first: one, and one more for each time that the run was resumed."""
        return sorted(self._numbered, key=self._numbered.__getitem__)

    def new_recording(self) -> Path:
        """Name of the recording to write now; what is there is never written over."""
        numbers = self._numbered.values()
        return self.path / (f"recording_{max(numbers) + 1}.mcap" if numbers else "recording.mcap")

    @property
    def _numbered(self) -> Mapping[Path, int]:
        """The recordings with their numbers; a copy under another name is none."""
        found = (
            (path, re.fullmatch(r"recording(?:_(\d+))?\.mcap", path.name))
            for path in self.path.glob("*.mcap")
        )
        return {path: int(match[1] or 1) for path, match in found if match}

    @classmethod
    def create(cls, root: Path, profile: str, started_utc: datetime) -> RunFolder:
        """Make `root/<UTC>_<profile>_<4 hex>/`.

        Raises:
            RecordingError: the folder cannot be made.
        """
        stamp = started_utc.strftime("%Y-%m-%dT%H-%M-%SZ")
        name = f"{stamp}_{_folder_part(profile)}_{secrets.token_hex(2)}"
        try:
            (root / name).mkdir(parents=True)
        except OSError as error:
            if (root / name).is_dir():  # the same second and the same four digits
                return cls.create(root, profile, started_utc)
            raise RecordingError(root / name, "making", error) from error
        return cls(root / name)

    @classmethod
    def find(cls, text: str | Path, root: Path = Path("runs")) -> RunFolder:
        """The run at a path, or the one under `root` whose name contains `text`.

        `latest` is the newest of all, `latest:mock/transient` the newest of that profile, of parts as well; one whose
        devices could not be opened is neither.

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
        whole, parts = ([each.parent for each in root.glob(f"{below}/{MANIFEST}")] for below in ("*", "*/*"))
        runs = sorted([*whole, *parts], key=lambda run: run.name)
        keyword, _, profile = str(text).partition(":")
        if str(text) == "latest":
            matches = [run for run in sorted(whole) if cls(run).begun][-1:]
        elif keyword == "latest":
            own = [run for run in runs if _profile_of(run.name) == _folder_part(profile)]
            matches = [run for run in own if cls(run).begun][-1:]
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
        text = json.dumps(plain({"format": FORMAT, **manifest}), indent=2, allow_nan=False)
        with writing(self.manifest_path):
            replace_file(self.manifest_path, f"{text}\n".encode())

    def keep_room(self) -> None:
        """Occupy as much of the disk as the last manifest takes until `end`, under no name: a killed program leaves
        nothing of it."""
        with suppress(OSError):  # not every file system can; the run is none the worse for it
            self._room = tempfile.TemporaryFile(dir=self.path)  # noqa: SIM115 - held to the run's end
            os.posix_fallocate(self._room.fileno(), 0, ROOM_BYTES)

    def end(self, manifest: Mapping[str, Any]) -> None:
        """Write the last manifest, in the room that was kept for it where the disk is full.

        Raises:
            RecordingError: it cannot be written.
        """
        if self._room is not None:
            with suppress(OSError):
                self._room.truncate(0)  # a child process may hold it open as well
                self._room.close()
            self._room = None
        self.write_manifest(manifest)

    def read_manifest(self) -> dict[str, Any]:
        """The manifest.

        Raises:
            RunFolderError: no run folder, a damaged manifest, or one of a later version.
        """
        try:
            manifest = json.loads(self.manifest_path.read_text("utf-8"))
        except FileNotFoundError:
            reason = f"no run folder, for it has no {MANIFEST}"
            raise RunFolderError(f"{self.path}: {reason}; give a folder that `run` made") from None
        except (ValueError, OSError) as error:
            raise RunFolderError(f"{self.manifest_path}: cut off or damaged ({error})") from None
        if not isinstance(manifest, dict) or "format" not in manifest:
            raise RunFolderError(
                f"{self.manifest_path}: not the manifest of a run; give a folder that `run` made"
            )
        if manifest["format"] != FORMAT:
            other = f"format {manifest['format']}, this program reads {FORMAT}"
            raise RunFolderError(f"{self.manifest_path}: {other}; update it")
        return manifest


def replace_file(path: Path, data: bytes) -> None:
    """Replace a file whole or not at all; its mode stays, and so does a link to it. May raise `OSError`."""
    path = path.resolve()
    temporary = path.with_suffix(path.suffix + ".tmp")
    try:
        with temporary.open("wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())
        with suppress(FileNotFoundError):  # it is a new one
            shutil.copymode(path, temporary)
        temporary.replace(path)
    finally:
        with suppress(OSError):
            temporary.unlink(missing_ok=True)


def plain(value: Any) -> Any:
    """A value as JSON knows it: what is not finite becomes null, what is of no JSON type its text."""
    if isinstance(value, Mapping):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [plain(item) for item in value]
    if isinstance(value, set | frozenset):
        return sorted(plain(item) for item in value)
    if value is None or isinstance(value, str | int):
        return value
    if isinstance(value, Real):  # of NumPy's as well
        number = int(value) if isinstance(value, Integral) else float(value)
        return number if math.isfinite(number) else None
    return str(value)


def _folder_part(profile: str) -> str:
    """What a profile makes of a folder's name: of one with a long path its end, after a digest of the whole."""
    part = profile.replace("/", "-")
    name = part.encode("utf-8", errors="surrogateescape")
    if len(name) <= PROFILE_BYTES:
        return part
    digest = hashlib.sha256(name).hexdigest()[:8]
    return f"{digest}-{name[-PROFILE_BYTES + 9 :].decode(errors='ignore')}"


def _profile_of(name: str) -> str:
    """The profile's part of a run folder's name."""
    return name.partition("_")[2].rpartition("_")[0]


def lock(descriptor: int) -> None:
    """Lock what is open for this program alone, until it is closed.

    Raises:
        OSError: another program holds it, or the system or the file system has no such locks.
    """
    try:
        import fcntl
    except ImportError:  # Windows, where runs are read and none is made
        raise OSError("this system has no flock") from None
    fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
