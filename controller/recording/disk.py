"""The thread that does all writing of a run, so that the loop never waits for a disk."""

import errno
import os
import threading
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any, Protocol

from controller.recording.run_folder import RecordingError
from drivers.core.clock import monotonic_s

WRITE_S = 0.2
"""Wall time between two writes, s: what a kill costs, with the write itself, is under one second."""

SYNC_S = 0.8
"""Wall time between two calls of fsync, s: what a power cut costs, under one second with `WRITE_S`."""

GONE_S = 30.0
"""Longest wait for a disk that writes nothing at all, s (assumption: one that takes longer is gone)."""

BACKLOG = 100_000
"""How many posts may wait for the disk: half a minute of the busiest bench, an arm, a board and a hand at 200 turns a
second; the samples among them are in memory anyway, as long as their trial lasts."""


class DiskFile(Protocol):
    """One file that the thread writes; all but `path` is called on the thread alone."""

    path: Path

    def commit(self, sync: bool) -> None:
        """Hand what was collected to the kernel, and with `sync` to the disk."""

    def finish(self) -> None:
        """Write the end and close."""

    def abandon(self) -> None:
        """Close as it is; never raises."""


class DiskThread:
    """Does what is posted, in order; posting costs a microsecond, never waits for the disk and never raises.

    Where writing a file fails, `failure` is the reason, and what is posted for that file afterwards is dropped; the
    others go on. More than `BACKLOG` posts are never held: a disk that cannot keep up is a failure as well.

    Args:
        files: What is written, in the order in which it is committed.
        patient: Whether `room` waits for the disk where the backlog is full: on a bench in virtual time, which is
            ahead of any disk and whose time stands still meanwhile.
    """

    def __init__(self, files: Sequence[DiskFile], *, patient: bool = False) -> None:
        self._files = files
        self._patient = patient
        self._failures: dict[Path, RecordingError] = {}
        self._queue: deque[tuple[DiskFile, Callable[..., None], tuple[Any, ...]]] = deque()
        self._waiting: deque[tuple[threading.Event, bool]] = deque()
        self._wake = threading.Event()
        self._ended = threading.Event()
        self._closing = False
        self._gone = False
        self._done = 0
        self._busy = files[0].path
        self._synced_s = monotonic_s()
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        try:
            self._thread.start()
        except RuntimeError:  # no memory for a thread: what is there stays readable
            for file in files:
                with suppress(OSError):
                    file.finish()
            raise

    @property
    def failure(self) -> RecordingError | None:
        """Why something of the run can no longer be written, or None."""
        return next(iter(self._failures.values()), None)

    def post(self, file: DiskFile, write: Callable[..., None], *arguments: object) -> None:
        """Have `write(*arguments)` called on the thread; what it raises is a failure of `file`."""
        self._queue.append((file, write, arguments))

    def room(self) -> bool:
        """Whether more samples may be posted; False with `failure` set where the disk cannot keep up."""
        if len(self._queue) < BACKLOG:
            return True
        if self._patient:
            self.flush(sync=False)
        else:
            late = TimeoutError(None, f"the disk cannot keep up, {BACKLOG} posts wait for it")
            self._fail(self._busy, late)
        return self.failure is None

    def fill(self) -> None:
        """Be full from now on, as a simulated disk is: what was posted before is written."""
        if self.failure is None:
            self.flush(sync=False)
            for file in self._files:
                self._fail(file.path, OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))

    def flush(self, *, sync: bool = True) -> None:
        """Wait until all that was posted is written, and with `sync` on the disk; a failure is in `failure`."""
        done = threading.Event()
        self._waiting.append((done, sync))
        self._wake.set()
        self._await(done)

    def close(self) -> None:
        """Write the rest, finish every file, end the thread. May be called twice."""
        self._closing = True
        self._wake.set()
        self._await(self._ended)

    def _await(self, done: threading.Event) -> None:
        """Wait as long as the thread gets on."""
        seen = self._done
        while not (self._gone or self._ended.is_set() or done.wait(GONE_S)):
            if self._done == seen:
                self._gone = True  # it is not waited for again
                self._fail(self._busy, TimeoutError(None, f"the disk took nothing for {GONE_S:g} s"))
            seen = self._done

    def _fail(self, path: Path, error: Exception, doing: str = "writing") -> None:
        if path not in self._failures:
            failure = error
            if not isinstance(failure, RecordingError):
                failure = RecordingError(path, doing, error)
                failure.__cause__ = error
            self._failures[path] = failure

    # --- on the thread ---------------------------------------------------------------------------

    def _run(self) -> None:
        closing = False
        while not closing:
            self._wake.wait(WRITE_S)
            self._wake.clear()
            # asked before the turn: what was posted during the one before is still to be written
            closing = self._closing
            waiting = [self._waiting.popleft() for _ in range(len(self._waiting))]
            for _ in range(len(self._queue)):
                file, write, arguments = self._queue.popleft()
                self._try(file, write, *arguments)
            self._commit(sync=any(sync for _, sync in waiting))
            for done, _ in waiting:
                done.set()
        for file in self._files:
            self._try(file, file.finish, doing="closing")
            file.abandon()
        self._ended.set()

    def _commit(self, *, sync: bool) -> None:
        sync = sync or monotonic_s() - self._synced_s >= SYNC_S
        for file in self._files:
            self._try(file, file.commit, sync)
        if sync:
            self._synced_s = monotonic_s()

    def _try(
        self, file: DiskFile, write: Callable[..., None], *arguments: object, doing: str = "writing"
    ) -> None:
        self._busy = file.path
        if file.path not in self._failures:
            try:
                write(*arguments)
            except Exception as error:  # whatever it was: the run ends by it, in order, and reports it
                self._fail(file.path, error, doing)
        self._done += 1
