"""Who has a bench's devices open: each program leaves a note, so that another can find it and have it stop."""

from __future__ import annotations

import fcntl
import json
import os
import signal
import tempfile
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from controller.rig import Rig
from drivers.core.clock import monotonic_s, rest
from drivers.core.errors import PROGRAM, DeviceError
from drivers.core.settings import Settings

LOOK_S = 0.02
"""How often it is looked whether a program has ended."""

SHARED = ("mock", "emulated", "console")
"""Ports that are no device of the bench: each program has its own."""

Addresses = Mapping[str, Mapping[str, Any]]
"""By device, the settings that say where it is: `{"stage": {"port": "/dev/ttyUSB0"}}`."""


def folder() -> Path:
    """Where the notes of this user's programs are."""
    runtime = os.environ.get("XDG_RUNTIME_DIR")
    base = Path(runtime) if runtime and os.access(runtime, os.W_OK) else Path(tempfile.gettempdir())
    return base / f"touchbench-{os.getuid()}"


def addresses(rig: Rig) -> Addresses:
    """Where the devices of a rig are."""
    found = {name: getattr(device, "_settings", None) for name, device in rig.devices.items()}
    return {name: address(settings) for name, settings in found.items() if settings is not None}


def address(settings: Settings) -> Mapping[str, Any]:
    """What of a device's settings says where it is: its port, or its host and whatever else is marked as an address."""
    keys = dict.fromkeys((*settings.keys_of("address"), "port"))
    return {key: getattr(settings, key) for key in keys if key in type(settings).model_fields}


class Holding:
    """This program's note. Use as a context manager, around the time in which the devices are open.

    A note is locked as long as its program lives: one that was killed leaves a note that says nothing. Where no note
    can be written, the program goes on without one. Of two programs that begin at once, none or one gets the devices:
    each leaves its note before it looks for others.

    Args:
        alone: Whether to refuse where another program of this user has one of the devices: on a real bench.
    """

    def __init__(self, profile: str, doing: str, where: Addresses, alone: bool = False) -> None:
        self._alone = {name: at for name, at in where.items() if alone and at.get("port") not in SHARED}
        self._note = {"pid": os.getpid(), "profile": profile, "doing": doing, "devices": where}
        self._path: Path | None = None

    def __enter__(self) -> Holding:
        with suppress(OSError):
            folder().mkdir(mode=0o700, exist_ok=True)
            descriptor, path = tempfile.mkstemp(".json", f"{os.getpid()}-", folder())
            self._path, self._descriptor = Path(path), descriptor
            fcntl.flock(descriptor, fcntl.LOCK_EX)
            self.tell()
        for other in holders("", self._alone):
            other.let_go()
            self.__exit__()
            name = next(name for name, at in self._alone.items() if _shares(other.note, {name: at}))
            remedy = f"wait for its end, or end it: {PROGRAM} stop {other.note['profile']}"
            raise DeviceError(name, "opening", f"{other} has it", remedy)
        return self

    def tell(self, **more: Any) -> None:
        """Add to the note: what `not_at_rest` lists was not seen standing still at the end."""
        if self._path is not None:
            self._note.update(more)
            data = json.dumps(self._note, default=str).encode()
            with suppress(OSError):
                os.pwrite(self._descriptor, data, 0)
                os.ftruncate(self._descriptor, len(data))

    def __exit__(self, *_: object) -> None:
        if self._path is not None:
            self._path.unlink(missing_ok=True)
            os.close(self._descriptor)
            self._path = None


class Holder:
    """Another program, by its note.

    Args:
        descriptor: Of the note; the program's last word stays readable when it has ended.
    """

    def __init__(self, descriptor: int, note: Mapping[str, Any]) -> None:
        self._descriptor = descriptor
        self._ended = False
        self.note = note
        self.pid: int = note["pid"]
        self.devices: Addresses = note["devices"]

    def __str__(self) -> str:
        return f"{self.note['doing']} of {self.note['profile']} (process {self.pid})"

    def ask(self) -> None:
        """Have it stop every mover and end."""
        with suppress(OSError):  # it has ended meanwhile
            os.kill(self.pid, signal.SIGTERM)

    def let_go(self) -> None:
        """Look at it no more."""
        os.close(self._descriptor)

    def ended(self, patience_s: float) -> bool:
        """Wait for its end."""
        until_s = monotonic_s() + patience_s
        while not self._ended:
            with suppress(OSError):
                fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
                self._ended = True
                self.note = _read(self._descriptor) or self.note
                break
            if monotonic_s() >= until_s:
                return False
            rest(LOOK_S)
        return True

    @property
    def not_at_rest(self) -> Sequence[str] | None:
        """The movers that it did not see standing still at its end; None where it did not say."""
        told: Sequence[str] | None = self.note.get("not_at_rest")
        return told


def holders(profile: str, where: Addresses) -> Iterator[Holder]:
    """The programs that live and have a device of these open, or the bench of this profile."""
    for path in sorted(folder().glob("*.json")):
        try:
            descriptor = os.open(path, os.O_RDWR)
        except OSError:
            continue
        try:
            fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            note = _read(descriptor)
            if (
                note
                and note["pid"] != os.getpid()
                and (_shares(note, where) or (profile and note["profile"] == profile))
            ):
                yield Holder(descriptor, note)
                continue
        else:
            path.unlink(missing_ok=True)  # its program was killed
        os.close(descriptor)


def _shares(note: Mapping[str, Any], where: Addresses) -> bool:
    theirs = [_place(each) for each in note["devices"].values() if each]
    return any(_place(each) in theirs for each in where.values() if each)


def _place(at: Mapping[str, Any]) -> Mapping[str, Any]:
    """An address with the names of serial ports resolved: each has several (/dev/serial/by-id)."""
    return {
        key: os.path.realpath(value) if isinstance(value, str) and value.startswith("/") else value
        for key, value in at.items()
    }


def _read(descriptor: int) -> Mapping[str, Any] | None:
    try:
        note: Mapping[str, Any] = json.loads(os.pread(descriptor, 1 << 20, 0))
    except ValueError:  # it is being written
        return None
    return note
