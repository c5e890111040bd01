"""The thread that turns what the loop saw into `recording.mcap`, so that the loop never waits for a disk."""

from __future__ import annotations

import json
import threading
from collections import deque
from collections.abc import Callable, Mapping
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np

from controller.recording.mcap_file import McapWriter
from controller.recording.run_folder import RecordingError
from controller.recording.schemas import (
    LOG_LEVELS,
    SampleSchema,
    block_schema,
    encode_block,
    log_schema,
    skipped_schema,
)
from drivers.clock import monotonic_s
from drivers.messages import SampleBlock, StreamInfo

WRITE_S = 0.2
"""Wall time between two writes, s: what a kill costs, with the write itself, is under one second."""

SYNC_S = 0.8
"""Wall time between two calls of fsync, s: what a power cut costs, under one second with `WRITE_S`."""

CLOSE_S = 30.0
"""Longest wait for the disk on flush and close, s (assumption: a disk that takes longer is gone)."""


class StreamWriter:
    """Writes what is posted, in order, on a thread of its own; posting costs a microsecond and never raises.

    MCAP's log time is `wall_start` + the trial's offset + bench time. Where writing fails, `failure` says
    why, and what is posted afterwards is dropped.

    Args:
        path: The recording to make.
        wall_start: Calendar time at which the campaign's time is zero.
        streams: What is known of each stream; one that is not listed is named after its blocks.

    Raises:
        RecordingError: the file cannot be made.
    """

    def __init__(self, path: Path, wall_start: datetime, streams: Mapping[str, StreamInfo]) -> None:
        self.path = path
        self.failure: RecordingError | None = None
        self._start_ns = self._base_ns = round(wall_start.timestamp() * 1e6) * 1000  # exact to datetime's us
        self._streams = dict(streams)
        self._topics: dict[str, tuple[SampleSchema, int, int]] = {}
        self._samples: dict[str, list[SampleBlock]] = {}
        self._queue: deque[tuple[Callable[..., None], tuple[Any, ...]]] = deque()
        self._waiting: deque[threading.Event] = deque()
        self._wake = threading.Event()
        self._closing = False
        self._synced_s = monotonic_s()
        self._block, self._skipped, self._log = block_schema(), skipped_schema(), log_schema()
        try:
            self._file = McapWriter(path, library="touchbench")
        except OSError as error:
            raise RecordingError(path, "making", error) from error
        self._queue.append((self._write_schemas, ()))
        self._thread = threading.Thread(target=self._run, name="recorder", daemon=True)
        self._thread.start()

    def begin_trial(self, trial: int, factors: Mapping[str, object], offset_s: float) -> None:
        """From now on bench time counts from `offset_s` of campaign time."""
        self._queue.append((self._write_trial, (trial, dict(factors), offset_s)))

    def block(self, block: SampleBlock) -> None:
        """Post a sample block."""
        self._queue.append((self._write_block, (block,)))

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Post a span that nobody listened to."""
        self._queue.append((self._write_skip, (stream, t0_s, t1_s)))

    def log(self, t_s: float, name: str, message: str, level: str) -> None:
        """Post a line for the log panel; `level` is one of `LOG_LEVELS`."""
        self._queue.append((self._write_log, (t_s, name, message, level)))

    def flush(self) -> None:
        """Wait until all that was posted is on the disk.

        Raises:
            RecordingError: it could not be written, now or before.
        """
        done = threading.Event()
        self._waiting.append(done)
        self._wake.set()
        if self._thread.is_alive() and not done.wait(CLOSE_S):
            self._fail("writing", TimeoutError(None, f"the disk took more than {CLOSE_S:g} s"))
        self._raise_failure()

    def close(self) -> None:
        """Write the rest, the index and the footer. May be called twice.

        Raises:
            RecordingError: it could not be written, now or before.
        """
        if not self._closing:
            self._closing = True
            self._wake.set()
            self._thread.join(CLOSE_S)
            try:
                if self.failure is None:
                    self._file.finish()
                else:
                    self._file.abandon()
            except OSError as error:
                self._fail("closing", error)
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self.failure is not None:
            raise self.failure

    def _fail(self, doing: str, error: Exception) -> None:
        if self.failure is None:
            self.failure = RecordingError(self.path, doing, error)
            self.failure.__cause__ = error

    def _run(self) -> None:
        closing = False
        while not closing:
            self._wake.wait(WRITE_S)
            self._wake.clear()
            # asked before the turn: what was posted during the one before is still to be written
            closing = self._closing
            waiting = [self._waiting.popleft() for _ in range(len(self._waiting))]
            try:
                self._turn(sync=bool(waiting))
            except Exception as error:  # the loop goes on without a recording, and says so at the trial's end
                self._fail("writing", error)
            for done in waiting:
                done.set()

    def _turn(self, *, sync: bool) -> None:
        while self._queue:
            write, arguments = self._queue.popleft()
            if self.failure is None:
                write(*arguments)
        if self.failure is not None:
            return
        self._write_samples()
        self._file.end_chunk()
        if sync or monotonic_s() - self._synced_s >= SYNC_S:
            self._file.sync()
            self._synced_s = monotonic_s()

    # --- on the thread ---------------------------------------------------------------------------

    def _ns(self, t_s: float) -> int:
        return self._base_ns + round(t_s * 1e9)

    def _write_schemas(self) -> None:
        self._block_schema = self._file.add_schema(self._block.name, self._block.descriptors)
        schemas = [self._file.add_schema(each.name, each.descriptors) for each in (self._skipped, self._log)]
        self._skipped_channel = self._file.add_channel("/skipped", schemas[0], {})
        self._log_channel = self._file.add_channel("/events", schemas[1], {})

    def _write_trial(self, trial: int, factors: Mapping[str, object], offset_s: float) -> None:
        self._write_samples()
        self._base_ns = self._start_ns + round(offset_s * 1e9)
        text = json.dumps(factors, default=str)
        self._file.add_metadata("trial", {"trial": str(trial), "offset_s": repr(offset_s), "factors": text})

    def _write_block(self, block: SampleBlock) -> None:
        if not len(block):
            return
        _, _, raw = self._topics.get(block.stream) or self._new_topic(block)
        self._file.add_message(raw, self._ns(block.t0_s), encode_block(self._block, block), block.seq)
        self._samples.setdefault(block.stream, []).append(block)

    def _write_samples(self) -> None:
        """The plotted messages of all blocks since the last call: many at once cost as little as one."""
        for stream, blocks in self._samples.items():
            schema, samples, _ = self._topics[stream]
            times_s = np.concatenate([block.times for block in blocks])
            rows = schema.encode(times_s, np.concatenate([block.physical for block in blocks]))
            sequence = np.concatenate([block.seq + np.arange(len(block)) for block in blocks])
            log_times = self._base_ns + np.rint(times_s * 1e9).astype(np.int64)
            self._file.add_messages(samples, log_times, rows, sequence)
        self._samples.clear()

    def _new_topic(self, block: SampleBlock) -> tuple[SampleSchema, int, int]:
        width = block.values.shape[1]
        channels = ("value",) if width == 1 else tuple(f"value_{index}" for index in range(width))
        info = self._streams.get(block.stream) or StreamInfo(block.stream, channels, block.unit)
        schema = SampleSchema(info)
        topic = "/" + block.stream.replace(".", "/")
        described = {"stream": block.stream, "unit": info.unit, "scale": repr(block.scale)}
        described["rate_hz"] = "" if block.rate_hz is None else repr(block.rate_hz)
        numbers = self._file.add_schema(schema.name, schema.descriptors), self._block_schema
        samples = self._file.add_channel(topic, numbers[0], described)
        raw = self._file.add_channel(f"/raw{topic}", numbers[1], described)
        self._topics[block.stream] = schema, samples, raw
        return self._topics[block.stream]

    def _write_skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        message = self._skipped.message(stream=stream, t0_s=t0_s, t1_s=t1_s)
        self._file.add_message(self._skipped_channel, self._ns(t0_s), message.SerializeToString())

    def _write_log(self, t_s: float, name: str, text: str, level: str) -> None:
        message = self._log.message(name=name, message=text, level=LOG_LEVELS.index(level))
        message.timestamp.FromNanoseconds(self._ns(t_s))
        self._file.add_message(self._log_channel, self._ns(t_s), message.SerializeToString())
