"""Turns what the loop saw into `recording.mcap`, on the recorder's thread."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
from mcap.records import Channel, Schema
from numpy.typing import NDArray

from controller.limits import GuardSettings, shown_limits
from controller.recording.mcap_file import (
    CHANNEL_AT,
    MESSAGE,
    RECORD,
    TIMES_AT,
    McapWriter,
    Mirror,
    message_heads,
)
from controller.recording.run_folder import RecordingError
from controller.recording.schemas import (
    LOG_LEVELS,
    TRIAL,
    TRIAL_END,
    SampleSchema,
    block_schema,
    encode_block,
    log_schema,
    skipped_schema,
    state_schema,
)
from controller.recording.series import DETECTOR
from drivers.core.messages import SampleBlock, StreamInfo

MOST_ROWS = 8192
"""Messages that are put together at once: of a carrier half a megabyte, which stays in a processor's cache."""

_EVENTS = "/events"

Topic = tuple[Channel, Schema]
Floats = NDArray[np.float64]


class StreamWriter:
    """Writes trials, sample blocks, skipped spans and log lines; implements `disk.DiskFile`.

    MCAP's log time is `wall_start` + the trial's offset + bench time.

    Args:
        path: The recording to make.
        wall_start: Calendar time at which the campaign's time is zero.
        streams: What is known of each stream; one that is not listed is named after its blocks.
        mirror: Gets what is written as well.

    Raises:
        RecordingError: the file cannot be made.
    """

    def __init__(
        self,
        path: Path,
        wall_start: datetime,
        streams: Mapping[str, StreamInfo],
        mirror: Mirror | None = None,
    ) -> None:
        self.path = path
        self._start_ns = self._base_ns = round(wall_start.timestamp() * 1e6) * 1000  # exact to datetime's us
        self._streams = dict(streams)
        self._topics: dict[str, tuple[SampleSchema, int, int]] = {}
        self._channels: dict[str, int] = {}
        self._plotted: dict[str, tuple[SampleSchema, int]] = {}
        self._samples: dict[str, list[SampleBlock]] = {}
        self._lines: list[tuple[int, bytes]] = []
        self._trial = -1
        self._limits: GuardSettings | None = None
        self._state = ""
        self._block, self._skipped, self._log = block_schema(), skipped_schema(), log_schema()
        self._states = state_schema()
        try:
            self._file = McapWriter(path, "touchbench", mirror)
            self._write_schemas()
        except OSError as error:
            raise RecordingError(path, "making", error) from error

    def begin_trial(
        self, trial: int, factors: Mapping[str, object], offset_s: float, limits: GuardSettings | None = None
    ) -> None:
        """From now on bench time counts from `offset_s` of campaign time; the guard has these limits."""
        self._limits, self._state = limits, ""
        self._base_ns = self._start_ns + round(offset_s * 1e9)
        self._trial = trial
        text = json.dumps(factors, default=str)
        described = {
            "trial": str(trial),
            "offset_s": repr(offset_s),
            "base_ns": str(self._base_ns),
            "factors": text,
        }
        self.commit(sync=False)
        self._file.add_metadata(TRIAL, described)

    def end_trial(self, length_s: float, row: Mapping[str, str]) -> None:
        """The trial took so long and came to this row of trials.csv; the next one begins behind it."""
        self.commit(sync=False)
        self._file.add_metadata(TRIAL_END, {**row, "trial": str(self._trial), "length_s": repr(length_s)})

    def attach(self, name: str, data: bytes) -> None:
        """Put a JSON file into the recording."""
        self._file.add_attachment(name, "application/json", data, self._base_ns)

    def state(self, t_s: float, before: str, after: str) -> None:
        """Write the state that follows, of the first event of a trial the one before as well."""
        for at_s, state in ((0.0, before), (t_s, after)) if not self._state else ((t_s, after),):
            if state != self._state:
                self._state = state
                message = self._states.message(t_s=at_s, state=state)
                self._file.add_message(self._state_channel, self._ns(at_s), message.SerializeToString())

    def block(self, block: SampleBlock) -> None:
        """Write a sample block."""
        if not len(block):
            return
        _, _, raw = self._topics.get(block.stream) or self._new_topic(block)
        self._file.add_message(raw, self._ns(block.t0_s), encode_block(self._block, block), block.seq)
        self._samples.setdefault(block.stream, []).append(block)

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Write a span in which a stream had no subscriber."""
        message = self._skipped.message(stream=stream, t0_s=t0_s, t1_s=t1_s)
        self._file.add_message(self._skipped_channel, self._ns(t0_s), message.SerializeToString())

    def log(self, t_s: float, name: str, text: str, level: str) -> None:
        """Write a line for the log panel; `level` is one of `LOG_LEVELS`."""
        message = self._log.message(name=name, message=text, level=LOG_LEVELS.index(level))
        message.timestamp.FromNanoseconds(self._ns(t_s))
        self._lines.append((self._ns(t_s), message.SerializeToString()))

    def commit(self, sync: bool) -> None:
        """End the chunk, and with `sync` see it on the disk."""
        self._write_samples()
        self._file.end_chunk()
        for (
            log_time_ns,
            line,
        ) in self._lines:  # in a chunk of their own: each bears its time within it as well
            self._file.add_message(self._log_channel, log_time_ns, line)
        self._lines.clear()
        self._file.end_chunk()
        if sync:
            self._file.sync()

    def finish(self) -> None:
        """Write the index and the footer, and close."""
        self.commit(sync=False)
        self._file.finish()

    def abandon(self) -> None:
        """Close the file as it is, without a summary."""
        self._file.abandon()

    def take_over(
        self, plain: bytes, index: Mapping[int, NDArray[Any]], topics: Mapping[int, Topic], base_ns: int
    ) -> None:
        """Write a chunk of another recording, in this one's time.

        Args:
            plain: Its messages.
            index: Times and places of the messages, by channel there.
            topics: The channels there, with their schemas.
            base_ns: Log time there of the trial's bench time zero.
        """
        if any(channel.topic == _EVENTS for channel, _ in topics.values()):
            for offset, (_, length, _, _, time_ns, _) in message_heads(plain):
                line = self._log.message.FromString(
                    plain[offset + MESSAGE.size : offset + RECORD.size + length]
                )
                level = LOG_LEVELS[line.level]
                self.log((time_ns - base_ns) * 1e-9, line.name, line.message, level)
            return
        data = np.frombuffer(plain, np.uint8).copy()
        moved = {}
        for number in sorted(index):
            entries = index[number].copy()
            entries["log_time"] += np.uint64(
                (self._base_ns - base_ns) % 2**64
            )  # backwards: around to the same
            at = entries["offset"].astype(np.int64)[:, None]
            times = np.ascontiguousarray(entries["log_time"]).view(np.uint8).reshape(-1, 8)
            for place in TIMES_AT:
                data[at + (place + np.arange(8))] = times
            here = self._same_channel(*topics[number])
            data[at + (CHANNEL_AT + np.arange(2))] = np.frombuffer(here.to_bytes(2, "little"), np.uint8)
            moved[here] = entries
        times_ns = np.concatenate([entries["log_time"] for entries in moved.values()])
        packed = {channel: entries.tobytes() for channel, entries in moved.items()}
        self._file.add_chunk(data.tobytes(), packed, (int(times_ns.min()), int(times_ns.max())))

    def _same_channel(self, channel: Channel, schema: Schema) -> int:
        if channel.topic not in self._channels:
            raw = schema.name == self._block.name
            number = self._block_schema if raw else self._file.add_schema(schema.name, schema.data)
            self._channel(channel.topic, number, channel.metadata)
        return self._channels[channel.topic]

    def _channel(self, topic: str, schema: int, described: Mapping[str, str]) -> int:
        self._channels[topic] = self._file.add_channel(topic, schema, described)
        return self._channels[topic]

    def _ns(self, t_s: float) -> int:
        return self._base_ns + round(t_s * 1e9)

    def _write_schemas(self) -> None:
        self._block_schema = self._file.add_schema(self._block.name, self._block.descriptors)
        ours = (self._skipped, self._log, self._states)
        schemas = [self._file.add_schema(each.name, each.descriptors) for each in ours]
        self._skipped_channel = self._channel("/skipped", schemas[0], {})
        self._log_channel = self._channel(_EVENTS, schemas[1], {})
        self._state_channel = self._channel("/state", schemas[2], {})

    def _write_samples(self) -> None:
        """The plotted messages of all blocks since the last call: many at once cost as little as one."""
        for stream, blocks in self._samples.items():
            schema, samples, _ = self._topics[stream]
            times_s = np.concatenate([block.times for block in blocks])
            values = np.concatenate([block.physical for block in blocks])
            sequence = np.concatenate([block.seq + np.arange(len(block)) for block in blocks])
            log_times = self._base_ns + np.rint(times_s * 1e9).astype(np.int64)
            for begin in range(0, len(times_s), MOST_ROWS):
                part = slice(begin, begin + MOST_ROWS)
                rows = schema.encode(times_s[part], values[part])
                self._file.add_messages(samples, log_times[part], rows, sequence[part])
            self._write_derived(stream, blocks, times_s, values)
        self._samples.clear()

    def _write_derived(
        self, stream: str, blocks: Sequence[SampleBlock], times_s: Floats, values: Floats
    ) -> None:
        """What people plot of a stream: a period's frequency, and once a block the margin of what the guard watches."""
        if stream.endswith(".period"):
            name = f"{stream.removesuffix('period')}frequency"
            with np.errstate(divide="ignore"):
                frequency_hz = 1.0 / values[:, :1]
            self._write_plotted(StreamInfo(name, ("frequency",), "Hz"), times_s, frequency_hz)
        for what, watching, channels, limit, unit in shown_limits(self._limits) if self._limits else ():
            if watching == stream:
                firsts = np.cumsum([0, *map(len, blocks[:-1])])
                sizes = np.maximum.reduceat(np.linalg.norm(values[:, list(channels)], axis=1), firsts)
                margins = np.column_stack([sizes, np.full(len(sizes), limit), limit - sizes])
                info = StreamInfo(f"guard.{what}", ("largest", "limit", "margin"), unit)
                self._write_plotted(info, times_s[firsts], margins)

    def _write_plotted(self, info: StreamInfo, times_s: Floats, values: Floats) -> None:
        if info.name in self._streams:  # the bench has one of its own
            return
        if info.name not in self._plotted:
            schema = SampleSchema(info)
            number = self._file.add_schema(schema.name, schema.descriptors)
            self._plotted[info.name] = schema, self._channel(f"/{info.name.replace('.', '/')}", number, {})
        schema, channel = self._plotted[info.name]
        log_times = self._base_ns + np.rint(times_s * 1e9).astype(np.int64)
        self._file.add_messages(
            channel, log_times, schema.encode(times_s, values), np.zeros(len(times_s), np.int64)
        )

    def _new_topic(self, block: SampleBlock) -> tuple[SampleSchema, int, int]:
        width = block.values.shape[1]
        channels = ("value",) if width == 1 else tuple(f"value_{index}" for index in range(width))
        info = self._streams.get(block.stream) or StreamInfo(block.stream, channels, block.unit)
        if block.stream.startswith(DETECTOR):  # fields of the same names, whatever is compared
            info = StreamInfo(block.stream, ("statistic", "threshold"), "")
        schema = SampleSchema(info)
        topic = "/" + block.stream.replace(".", "/")
        described = {"stream": block.stream, "unit": info.unit or block.unit, "scale": repr(block.scale)}
        described["rate_hz"] = "" if block.rate_hz is None else repr(block.rate_hz)
        numbers = self._file.add_schema(schema.name, schema.descriptors), self._block_schema
        samples = self._channel(topic, numbers[0], described)
        raw = self._channel(f"/raw{topic}", numbers[1], described)
        self._topics[block.stream] = schema, samples, raw
        return self._topics[block.stream]
