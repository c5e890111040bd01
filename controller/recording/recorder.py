"""The recorder: keeps everything, controls nothing."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from datetime import datetime
from typing import TYPE_CHECKING, Any

import numpy as np

from behaviors.events import BaselineRefused, ContactLost, Event, GuardStopped
from controller.detectors.protocol import Quantity
from controller.limits import GuardSettings
from controller.recording.disk import DiskThread
from controller.recording.run_folder import RecordingError, RunFolder
from controller.recording.series import BIN_S, DETECTOR, TrialRecording, bins_of, extremes_of_each
from controller.recording.stream_writer import StreamWriter
from controller.recording.trial_rows import Lines, TrialRows, event_line
from controller.scales import as_text
from drivers.core.clock import rest
from drivers.core.messages import Command, Failed, Floats, Lost, Refused, SampleBlock, Stalled, StreamInfo

if TYPE_CHECKING:
    from controller.recording.joining import EndedTrial
    from controller.watching.foxglove import FoxgloveStream


_ERRORS = (GuardStopped, Failed, Stalled)
_WARNINGS = (Lost, Refused, BaselineRefused, ContactLost)

READINGS_S = 0.1
"""Over how long a detector's readings are gathered before they are kept, s: a person sees no less, and a block costs
as much as ten readings."""


class Recorder:
    """Writes a run's trials, events and samples, all of it on a thread of its own.

    `record`, `skip` and `event` never raise and never wait: where the disk is full or gone, or cannot keep up,
    `failure` holds the one clear error, which `end_trial`, `flush` and `close` raise. What is kept in memory goes on.

    Args:
        wall_start: Calendar time at which the campaign's time is zero (UTC).
        streams: The devices' descriptions of their streams, by `device.stream`.
        factors: Names of what the trials vary, in the order of the columns.
        measures: Names of what is measured of a trial, in the order of the columns.
        patient: Whether `record` may wait for a disk that cannot keep up: in virtual time, which waits too.
        busy_s: How long a simulated disk takes besides for what is recorded now; infinite: it is full.

    Raises:
        RecordingError: the folder cannot be written.
    """

    def __init__(
        self,
        folder: RunFolder,
        wall_start: datetime,
        *,
        streams: Mapping[str, StreamInfo],
        factors: Sequence[str],
        measures: Sequence[str],
        patient: bool = False,
        mirror: FoxgloveStream | None = None,
        busy_s: Callable[[], float] = float,
    ) -> None:
        self.folder = folder
        self.trial = TrialRecording(-1)
        self._now_s = self._offset_s = 0.0
        self._readings: dict[str, list[Floats]] = {}
        self._quantities: Mapping[str, Quantity] = {}
        self._taken: list[str] = []
        self._rows, self._events = TrialRows(folder.trials_path, factors, measures), Lines(folder.events_path)
        self._streams = StreamWriter(folder.new_recording(), wall_start, streams, mirror)
        self._busy_s = busy_s
        self._disk = DiskThread((self._streams, self._events, self._rows), patient=patient)

    @property
    def failure(self) -> RecordingError | None:
        """Why nothing more can be written, or None."""
        return self._disk.failure

    def begin_trial(
        self,
        trial: int,
        factors: Mapping[str, object],
        offset_s: float,
        limits: GuardSettings | None = None,
        quantities: Mapping[str, Quantity] | None = None,
    ) -> TrialRecording:
        """Begin a trial whose bench time zero is `offset_s` in campaign time; returns what is kept of it.

        `quantities` are those of the detectors' readings, by detector.
        """
        self.trial = TrialRecording(trial, factors)
        self._now_s = 0.0
        self._readings.clear()
        self._quantities = quantities or {}
        self._disk.post(self._streams, self._streams.begin_trial, trial, dict(factors), offset_s, limits)
        text = ", ".join(f"{name} {value}" for name, value in factors.items())
        self._log(0.0, f"trial {trial} begins: {text}")
        return self.trial

    def record(self, blocks: Iterable[SampleBlock]) -> None:
        """Keep blocks as they are. Their arrays must not be written to afterwards."""
        busy_s = self._busy_s()
        if busy_s == math.inf:
            self._disk.fill()
        elif busy_s:
            self._disk.post(self._streams, rest, busy_s)
        room = self._disk.room()
        for block in blocks:
            self.trial.add(block)
            self._now_s = max(self._now_s, block.t0_s)
            if room:
                self._disk.post(self._streams, self._streams.block, block)

    def readings(self, detector: str, readings: Floats, decided_s: Sequence[float]) -> None:
        """Keep what a detector held against its threshold, as samples of the stream `detector.NAME`: of each bin the
        least, the largest, and what it decided by.

        Args:
            readings: Time, statistic and threshold of each decision, shape (n, 3).
            decided_s: Times of those that an event followed from.
        """
        gathered = self._readings.setdefault(detector, [])
        decided = np.isin(readings[:, 0], decided_s) if len(decided_s) else np.zeros(len(readings))
        gathered.append(np.column_stack([readings, decided]))
        if readings[-1, 0] - gathered[0][0, 0] >= READINGS_S:
            self._keep_readings(detector)

    def _keep_readings(self, detector: str, *, ended: bool = False) -> None:
        """Keep what was gathered, up to the bin that may go on."""
        gathered = np.concatenate(self._readings.pop(detector))
        starts, whole = bins_of(gathered[:, 0], BIN_S, ended=ended)
        if whole < len(gathered):
            self._readings[detector] = [gathered[whole:]]
        kept = np.union1d(extremes_of_each(gathered[:whole, 1], starts), np.flatnonzero(gathered[:whole, 3]))
        if not len(kept):
            return
        readings, stream = gathered[kept, :3], DETECTOR + detector
        before = self.trial.blocks(stream, -1)
        seq = before[-1].seq + len(before[-1]) if before else 0
        unit = (self._quantities[detector].unit if detector in self._quantities else None) or ""
        times_s = readings[:, 0]
        self.record(
            [SampleBlock(stream, seq, float(times_s[0]), readings[:, 1:], times_s=times_s, unit=unit)]
        )

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Note that a stream had no subscriber from `t0_s` to `t1_s`: no loss. An empty span is one only where samples
        came before: a sensor that is stopped and started in one turn misses some."""
        if t1_s > t0_s or self.trial.blocks(stream):
            self.trial.skip(stream, t0_s, t1_s)
            self._disk.post(self._streams, self._streams.skip, stream, t0_s, t1_s)

    def event(
        self, event: Event, *, state: str, next_state: str = "", commands: Sequence[Command] = ()
    ) -> None:
        """Write down an event, the state that handled it, the state that followed and the commands given."""
        self._now_s = max(self._now_s, event.t_s)
        if self._disk.room():
            what = event, state, next_state or state, tuple(commands)
            self._disk.post(self._events, self._note_event, self.trial.trial, *what)
            self._disk.post(self._streams, self._log_event, *what)

    def end_trial(self, outcome: str, measures: Mapping[str, object], length_s: float = 0.0) -> None:
        """Append the trial's row to trials.csv, on the disk when this returns; it took `length_s` of bench time.

        The row comes after what it summarises. Where that cannot be written, the row says fault, and nothing measured.

        Raises:
            RecordingError: the row, or anything of the run before it, cannot be written.
            ValueError: a measure that has no column.
        """
        for detector in list(self._readings):
            self._keep_readings(detector, ended=True)
        row = {**self.trial.factors, **measures, "trial": self.trial.trial, "outcome": outcome}
        line = self._rows.line(row)
        self._log(self._now_s, f"trial {self.trial.trial} ends: {outcome}")
        self._disk.post(self._streams, self._streams.end_trial, length_s, self._rows.cells(line))
        self._disk.flush(sync=False)
        if self.failure is not None:
            line = self._rows.line(row | dict.fromkeys(measures) | {"outcome": "fault"})
        self._disk.post(self._rows, self._rows.add, line)
        self._disk.flush(sync=False)
        self._raise_failure()

    def take_over(self, trial: EndedTrial) -> None:
        """Write a trial of another run folder, behind those that were written; its files stay until `flush`, which
        writes its row once all else of it is on the disk."""
        recorded, streams, post = trial.recorded, self._streams, self._disk.post
        post(streams, streams.begin_trial, trial.number, recorded.factors, self._offset_s)
        for chunk in recorded.chunks:
            post(streams, streams.copy, recorded.path, chunk, trial.topics, recorded.base_ns)
        post(streams, streams.end_trial, recorded.length_s, self._rows.cells(trial.row))
        for line in trial.events:
            post(self._events, self._events.add, line)
        self._taken.append(trial.row)
        self._offset_s += recorded.length_s or 0.0

    def attach(self, name: str, data: bytes) -> None:
        """Put a JSON file into the recording."""
        self._disk.post(self._streams, self._streams.attach, name, data)

    def flush(self) -> None:
        """Wait until everything is on the disk.

        Raises:
            RecordingError: it could not be written.
        """
        self._disk.flush()
        self._raise_failure()
        if self._taken:
            self._disk.post(self._rows, self._rows.add, "".join(self._taken))
            self._taken.clear()
            self._disk.flush()
            self._raise_failure()

    def close(self) -> None:
        """Write what is left and close the files. May be called twice.

        Raises:
            RecordingError: it could not be written.
        """
        self._disk.close()
        self._raise_failure()

    def _raise_failure(self) -> None:
        if self.failure is not None:
            raise self.failure

    def _log(self, t_s: float, text: str) -> None:
        self._disk.post(self._streams, self._streams.log, t_s, "trial", text, "INFO")

    # --- on the thread ---------------------------------------------------------------------------

    def _note_event(self, *what: Any) -> None:
        self._events.add(event_line(*what))

    def _log_event(self, event: Event, state: str, next_state: str, commands: Sequence[Command]) -> None:
        """An event as a line of the log panel."""
        bad, odd = isinstance(event, _ERRORS), isinstance(event, _WARNINGS)
        level = "ERROR" if bad else "WARNING" if odd else "INFO"
        change = f" → {next_state}" if next_state != state else ""
        text = "; ".join([f"{as_text(event)}{change}", *map(as_text, commands)])
        self._streams.log(event.t_s, state, text, level)
        self._streams.state(event.t_s, state, next_state)
