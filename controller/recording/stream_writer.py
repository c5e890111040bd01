"""Turns what the loop saw into `recording.mcap`, on the recorder's thread."""

from __future__ import annotations

import json
from collections.abc import Mapping
from datetime import datetime
from pathlib import Path

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
from drivers.messages import SampleBlock, StreamInfo


class StreamWriter:
    """Writes trials, sample blocks, skipped spans and log lines; implements `disk.DiskFile`.

    MCAP's log time is `wall_start` + the trial's offset + bench time.

    Args:
        path: The recording to make.
        wall_start: Calendar time at which the campaign's time is zero.
        streams: What is known of each stream; one that is not listed is named after its blocks.

    Raises:
        RecordingError: the file cannot be made.
    """

    def __init__(self, path: Path, wall_start: datetime, streams: Mapping[str, StreamInfo]) -> None:
        self.path = path
        self._start_ns = self._base_ns = round(wall_start.timestamp() * 1e6) * 1000  # exact to datetime's us
        self._streams = dict(streams)
        self._topics: dict[str, tuple[SampleSchema, int, int]] = {}
        self._samples: dict[str, list[SampleBlock]] = {}
        self._block, self._skipped, self._log = block_schema(), skipped_schema(), log_schema()
        try:
            self._file = McapWriter(path, library="touchbench")
            self._write_schemas()
        except OSError as error:
            raise RecordingError(path, "making", error) from error

    def begin_trial(self, trial: int, factors: Mapping[str, object], offset_s: float) -> None:
        """From now on bench time counts from `offset_s` of campaign time."""
        self._write_samples()
        self._base_ns = self._start_ns + round(offset_s * 1e9)
        text = json.dumps(factors, default=str)
        self._file.add_metadata("trial", {"trial": str(trial), "offset_s": repr(offset_s), "factors": text})

    def block(self, block: SampleBlock) -> None:
        """Write a sample block."""
        if not len(block):
            return
        _, _, raw = self._topics.get(block.stream) or self._new_topic(block)
        self._file.add_message(raw, self._ns(block.t0_s), encode_block(self._block, block), block.seq)
        self._samples.setdefault(block.stream, []).append(block)

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Write a span that nobody listened to."""
        message = self._skipped.message(stream=stream, t0_s=t0_s, t1_s=t1_s)
        self._file.add_message(self._skipped_channel, self._ns(t0_s), message.SerializeToString())

    def log(self, t_s: float, name: str, text: str, level: str) -> None:
        """Write a line for the log panel; `level` is one of `LOG_LEVELS`."""
        message = self._log.message(name=name, message=text, level=LOG_LEVELS.index(level))
        message.timestamp.FromNanoseconds(self._ns(t_s))
        self._file.add_message(self._log_channel, self._ns(t_s), message.SerializeToString())

    def commit(self, sync: bool) -> None:
        """End the chunk, and with `sync` see it on the disk."""
        self._write_samples()
        self._file.end_chunk()
        if sync:
            self._file.sync()

    def finish(self) -> None:
        """Write the index and the footer, and close."""
        self._file.finish()

    def abandon(self) -> None:
        """Close the file as it is, without a summary."""
        self._file.abandon()

    def _ns(self, t_s: float) -> int:
        return self._base_ns + round(t_s * 1e9)

    def _write_schemas(self) -> None:
        self._block_schema = self._file.add_schema(self._block.name, self._block.descriptors)
        schemas = [self._file.add_schema(each.name, each.descriptors) for each in (self._skipped, self._log)]
        self._skipped_channel = self._file.add_channel("/skipped", schemas[0], {})
        self._log_channel = self._file.add_channel("/events", schemas[1], {})

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
