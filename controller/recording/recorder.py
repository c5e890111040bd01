"""The recorder: it stands at the side, sees all and steers nothing."""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime

import numpy as np

from behaviors.events import BaselineRefused, ContactLost, Event, GuardStopped
from controller.recording.ledger import Ledger
from controller.recording.run_folder import RecordingError, RunFolder
from controller.recording.series import TrialRecording
from controller.recording.stream_writer import StreamWriter
from drivers.messages import Command, Failed, Lost, Refused, SampleBlock, Stalled, StreamInfo

_ERRORS = (GuardStopped, Failed, Stalled)
_WARNINGS = (Lost, Refused, BaselineRefused, ContactLost)


class Recorder:
    """Writes a run's trials, events and samples.

    `record`, `skip` and `event` never raise and never wait: where the disk is full or gone, `failure` holds
    the one clear error, which `end_trial`, `flush` and `close` raise. What is kept in memory goes on.

    Args:
        folder: The run's folder.
        wall_start: Calendar time at which the campaign's time is zero (UTC).
        streams: What the devices said of their streams, by `device.stream`.
        factors: Names of what the trials vary, in the order of the columns.
        measures: Names of what is measured of a trial, in the order of the columns.

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
    ) -> None:
        self.folder = folder
        self.trial = TrialRecording(-1)
        self._now_s = 0.0
        self._ledger = Ledger(folder.trials_path, factors, measures)
        self._writer = StreamWriter(folder.new_recording(), wall_start, streams)
        try:
            self._events = folder.events_path.open("ab", buffering=0)
        except OSError as error:
            self._writer.close()
            raise RecordingError(folder.events_path, "making", error) from error
        self._events_failure: RecordingError | None = None

    @property
    def failure(self) -> RecordingError | None:
        """Why nothing more can be written, or None."""
        return self._events_failure or self._writer.failure

    def begin_trial(self, trial: int, factors: Mapping[str, object], offset_s: float) -> TrialRecording:
        """Begin a trial whose bench time zero is `offset_s` in campaign time; returns what is kept of it."""
        self.trial = TrialRecording(trial, factors)
        self._now_s = 0.0
        self._writer.begin_trial(trial, factors, offset_s)
        text = ", ".join(f"{name} {value}" for name, value in factors.items())
        self._writer.log(0.0, "trial", f"trial {trial} begins: {text}", "INFO")
        return self.trial

    def record(self, blocks: Iterable[SampleBlock]) -> None:
        """Keep blocks as they are. Their arrays must not be written to afterwards."""
        for block in blocks:
            self.trial.add(block)
            self._now_s = max(self._now_s, block.t0_s)
            self._writer.block(block)

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Note that nobody listened to a stream from `t0_s` to `t1_s`: no loss. An empty span is none."""
        if t1_s > t0_s:
            self.trial.skip(stream, t0_s, t1_s)
            self._writer.skip(stream, t0_s, t1_s)

    def event(
        self, event: Event, *, state: str, next_state: str = "", commands: Sequence[Command] = ()
    ) -> None:
        """Write down an event, the state that heard it, the state that followed and the commands given."""
        self._now_s = max(self._now_s, event.t_s)
        name, details = describe_event(event)
        texts = [describe_command(command) for command in commands]
        line = {
            "t_s": round(event.t_s, 9),
            "trial": self.trial.trial,
            "event": name,
            "state": state,
            "next": next_state or state,
            "commands": texts,
            **details,
        }
        try:
            self._events.write(json.dumps(line, allow_nan=False).encode() + b"\n")
        except OSError as error:
            self._events_failure = self._events_failure or RecordingError(
                self.folder.events_path, "writing", error
            )
        level = (
            "ERROR" if isinstance(event, _ERRORS) else "WARNING" if isinstance(event, _WARNINGS) else "INFO"
        )
        said = " ".join(f"{key}={value}" for key, value in details.items())
        change = f" → {next_state}" if next_state and next_state != state else ""
        text = f"{name}{change} {said} {'; '.join(texts)}".strip()
        self._writer.log(event.t_s, state, text, level)

    def end_trial(self, outcome: str, measures: Mapping[str, object]) -> None:
        """Append the trial's row to trials.csv, on the disk when this returns.

        Raises:
            RecordingError: the row, or anything of the run before it, cannot be written.
            ValueError: a measure that has no column.
        """
        row = {**self.trial.factors, **measures, "trial": self.trial.trial, "outcome": outcome}
        self._ledger.append(row)
        self._writer.log(self._now_s, "trial", f"trial {self.trial.trial} ends: {outcome}", "INFO")
        if self.failure is not None:
            raise self.failure

    def flush(self) -> None:
        """Wait until everything is on the disk.

        Raises:
            RecordingError: it could not be written.
        """
        self._writer.flush()
        if self._events_failure is not None:
            raise self._events_failure

    def close(self) -> None:
        """Write what is left and close the files. May be called twice.

        Raises:
            RecordingError: it could not be written.
        """
        self._events.close()
        self._writer.close()
        if self._events_failure is not None:
            raise self._events_failure


def describe_event(event: Event) -> tuple[str, dict[str, object]]:
    """An event's name and, as JSON knows them, its other fields than the time."""
    details: dict[str, object] = {}
    for field in dataclasses.fields(event):
        if field.name != "t_s":
            details[field.name] = _plain(getattr(event, field.name))
    return type(event).__name__, details


def describe_command(command: Command) -> str:
    """A command as one reads it: `MoveAt(stage, 0.003785, 0.012)`."""
    values = (_plain(getattr(command, field.name)) for field in dataclasses.fields(command))
    texts = (f"{value:.6g}" if isinstance(value, float) else str(value) for value in values)
    return f"{type(command).__name__}({', '.join(texts)})"


def _plain(value: object) -> object:
    if isinstance(value, Command):
        return describe_command(value)
    if isinstance(value, float | np.floating):
        number = float(value)
        return number if math.isfinite(number) else None
    if isinstance(value, np.integer):
        return int(value)
    return value if isinstance(value, str | int | bool) or value is None else str(value)
