"""Turns what the loop saw into `recording.mcap`, on the recorder's thread."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from controller.limits import GuardSettings, shown_limits
from controller.recording.mcap_file import ChunkPlace, McapWriter, Topic, messages
from controller.recording.run_folder import writing
from controller.recording.schemas import (
    EVENTS,
    LOG_LEVELS,
    SKIPPED,
    STATE,
    TRIAL,
    TRIAL_END,
    RowSchema,
    Schema,
    encode_block,
    log_schema,
    reading_schema,
    sample_schema,
    schema_of,
)
from controller.recording.series import DETECTOR, PLOT_S, bins_of, extremes_of_each
from drivers.core.messages import Floats, Ints, SampleBlock, StreamInfo

if TYPE_CHECKING:
    from controller.watching.foxglove import FoxgloveStream


class StreamWriter:
    """Writes trials, sample blocks, skipped spans and log lines; implements `disk.DiskFile`.

    MCAP's log time is `wall_start` + the trial's offset + bench time.

    Args:
        wall_start: Calendar time at which the campaign's time is zero.
        streams: What is known of each stream; one that is not listed is named after its blocks.

    Raises:
        RecordingError: the file cannot be made.
    """

    def __init__(
        self,
        path: Path,
        wall_start: datetime,
        streams: Mapping[str, StreamInfo],
        mirror: FoxgloveStream | None = None,
    ) -> None:
        self.path = path
        self._start_ns = self._base_ns = round(wall_start.timestamp() * 1e6) * 1000  # exact to datetime's us
        self._streams = dict(streams)
        self._plots: dict[str, RowSchema] = {}
        self._pieces: dict[str, list[tuple[Floats, Floats, Ints]]] = {}
        self._trial = -1
        self._limits: GuardSettings | None = None
        self._state = ""
        self._block, self._skipped, self._log = schema_of("Block"), schema_of("Skipped"), log_schema()
        self._states, self._readings = schema_of("State"), reading_schema()
        with writing(path, "making"):
            self._file = McapWriter(path, mirror)

    def begin_trial(
        self, trial: int, factors: Mapping[str, object], offset_s: float, limits: GuardSettings | None = None
    ) -> None:
        """From now on bench time counts from `offset_s` of campaign time; the guard has these limits."""
        self._write_plots(ended=True)
        self._pieces.clear()
        self._limits, self._state = limits, ""
        self._base_ns = self._start_ns + round(offset_s * 1e9)
        self._trial = trial
        described = {"trial": str(trial), "offset_s": repr(offset_s), "base_ns": str(self._base_ns)}
        self._file.add_metadata(TRIAL, described | {"factors": json.dumps(factors, default=str)})

    def end_trial(self, length_s: float, row: Mapping[str, str]) -> None:
        """The trial took so long and came to this row of trials.csv; the next one begins behind it."""
        self._write_plots(ended=True)
        self._file.add_metadata(TRIAL_END, {**row, "trial": str(self._trial), "length_s": repr(length_s)})

    def attach(self, name: str, data: bytes) -> None:
        """Put a JSON file into the recording."""
        self._file.attach(name, "application/json", data, self._base_ns)

    def state(self, t_s: float, before: str, after: str) -> None:
        """Write the state that follows, of the first event of a trial the one before as well."""
        for at_s, state in ((0.0, before), (t_s, after)) if not self._state else ((t_s, after),):
            if state != self._state:
                self._state = state
                self._add(STATE, self._states, at_s, self._states.pack(t_s=at_s, state=state))

    def block(self, block: SampleBlock) -> None:
        """Write a sample block; of what a detector reads each reading is a message, for programs and people."""
        if not len(block):
            return
        topic = f"/{block.stream.replace('.', '/')}"
        described = {"stream": block.stream, "unit": block.unit}
        if block.stream.startswith(DETECTOR):
            seqs = range(block.seq, block.seq + len(block))
            self._add_rows(self._readings, block.times, block.physical, seqs, topic, **described)
            return
        if block.stream not in self._streams:
            width = block.values.shape[1]
            channels = ("value",) if width == 1 else tuple(f"value_{place}" for place in range(width))
            self._streams[block.stream] = StreamInfo(block.stream, channels, block.unit)
        data = encode_block(self._block, block)
        self._add(f"/raw{topic}", self._block, block.t0_s, data, block.seq, **described)
        numbers = np.arange(block.seq, block.seq + len(block))
        self._pieces.setdefault(block.stream, []).append((block.times, block.physical, numbers))

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Write a span in which a stream had no subscriber."""
        data = self._skipped.pack(stream=stream, t0_s=t0_s, t1_s=t1_s)
        self._add(SKIPPED, self._skipped, t0_s, data)

    def log(self, t_s: float, name: str, text: str, level: str) -> None:
        """Write a line for the log panel; `level` is one of `LOG_LEVELS`."""
        message = self._log.message(name=name, message=text, level=LOG_LEVELS.index(level))
        message.timestamp.FromNanoseconds(self._ns(t_s))
        self._add(EVENTS, self._log, t_s, message.SerializeToString())

    def commit(self, sync: bool) -> None:
        """End the chunk, and with `sync` see it on the disk."""
        self._write_plots(ended=False)
        self._file.flush(sync=sync)

    def finish(self) -> None:
        """Write the index and the footer, and close."""
        self._write_plots(ended=True)
        self._file.finish()

    def abandon(self) -> None:
        """Close the file as it is, without a summary."""
        self._file.abandon()

    def copy(self, path: Path, chunk: ChunkPlace, topics: Mapping[int, Topic], base_ns: int) -> None:
        """Write a chunk of another recording, in this one's time.

        Args:
            base_ns: Log time there of the trial's bench time zero.
        """
        later_ns = self._base_ns - base_ns
        for number, sequence, log_time_ns, data in messages(path, chunk):
            channel, schema = topics[number]
            here = self._file.topic(channel.topic, schema.name, schema.data, channel.metadata)
            if channel.topic == EVENTS:  # its messages bear the time as well
                line = self._log.message.FromString(data)
                line.timestamp.FromNanoseconds(log_time_ns + later_ns)
                self._file.add(here, log_time_ns + later_ns, line.SerializeToString(), sequence)
            else:
                self._file.add(here, log_time_ns + later_ns, data, sequence)

    def _ns(self, t_s: float) -> int:
        return self._base_ns + round(t_s * 1e9)

    def _add(
        self, topic: str, schema: Schema, t_s: float, data: bytes, sequence: int = 0, **described: str
    ) -> None:
        number = self._file.topic(topic, schema.name, schema.descriptors, described)
        self._file.add(number, self._ns(t_s), data, sequence)

    def _add_rows(
        self,
        schema: RowSchema,
        times_s: Floats,
        values: Floats,
        numbers: Sequence[int],
        topic: str,
        **described: str,
    ) -> None:
        channel = self._file.topic(topic, schema.name, schema.descriptors, described)
        times_ns = (self._base_ns + np.rint(times_s * 1e9).astype(np.int64)).tolist()
        for t_ns, data, number in zip(times_ns, schema.encode(times_s, values), numbers, strict=True):
            self._file.add(channel, t_ns, data, number)

    # --- what people plot ------------------------------------------------------------------------

    def _write_plots(self, *, ended: bool) -> None:
        """The extremes of all samples since the last call, up to the stretch that may go on; many at once cost as
        little as one. Of more channels the stretches are longer, for each channel has extremes of its own."""
        for stream, pieces in self._pieces.items():
            times_s, values, numbers = map(np.concatenate, zip(*pieces, strict=True))
            if not len(times_s):
                continue
            pairs, whole = bins_of(times_s, 2 * PLOT_S * values.shape[1], ended=ended)
            starts, _ = bins_of(times_s[:whole], PLOT_S * values.shape[1], ended=True)
            self._pieces[stream] = [(times_s[whole:], values[whole:], numbers[whole:])]
            self._write_margins(stream, times_s[pairs], values[:whole], pairs)
            kept = extremes_of_each(values[:whole], starts)
            info, times_s, values = self._streams[stream], times_s[kept], values[kept]
            frequency = f"{stream.removesuffix('period')}frequency"
            if stream.endswith(".period") and frequency not in self._streams:
                info = StreamInfo(frequency, ("frequency",), "Hz")
                with np.errstate(divide="ignore"):
                    values = 1.0 / values[:, :1]
            self._plot(info, times_s, values, numbers[kept].tolist())

    def _write_margins(self, stream: str, times_s: Floats, values: Floats, starts: NDArray[np.intp]) -> None:
        """Of what the guard watches the largest of each two stretches, the limit and what is left to it."""
        for what, watched, channels, limit, unit in shown_limits(self._limits) if self._limits else ():
            if watched == stream and len(starts):
                largest = np.maximum.reduceat(np.linalg.norm(values[:, list(channels)], axis=1), starts)
                info = StreamInfo(f"guard.{what}", ("largest", "limit", "margin"), unit)
                margins = np.column_stack([largest, np.full_like(largest, limit), limit - largest])
                self._plot(info, times_s, margins, [0] * len(starts))

    def _plot(self, info: StreamInfo, times_s: Floats, values: Floats, numbers: Sequence[int]) -> None:
        if info.name not in self._plots:
            self._plots[info.name] = sample_schema(info)
        topic = f"/{info.name.replace('.', '/')}"
        self._add_rows(self._plots[info.name], times_s, values, numbers, topic, unit=info.unit)
