"""A recording through a detector: run folders, and files of other programs; one event a line."""

import math
from collections.abc import Container, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from behaviors.events import Detected
from controller.detectors.calibration import (
    Statistic,
    calibrate_pieces,
    courses_of,
    limits_of,
    proposed,
    spans_of,
)
from controller.detectors.contract import part, trace
from controller.detectors.protocol import Detector, quantity_of, readings_of
from controller.recording.reader import Run, open_run
from controller.recording.run_folder import plain
from controller.recording.series import TrialRecording, joined
from controller.recording.tables import STEPS, Chosen, ReplayError, read_columns
from controller.signals.iq import CARRIER_FROM_HZ, Iq, IqSettings
from drivers.core.messages import Floats, SampleBlock, Saturated

ENVELOPES = ("FS", "V", "")
"""Units that an envelope may be in; a file's columns need not name one."""

SLOW_HZ = 5.0
"""Below this rate a recording's times may be in another unit than its column says (assumption)."""


RAIL, RAIL_LEVELS, RAIL_LOOK = 5, 16, 100_000
"""Samples in a row at the least or the largest value that are a converter at its rail, and of how many different values
in how many samples at least. Assumptions: noise of an unclipped sensor does not hold its extreme so long."""

ALIKE = 0.01
"""Two sample rates that differ by no more than this share are one (assumption)."""

LEAST_STEP_S, LATEST_S = 1e-9, 2.0**32
"""Between two rows of a file at least, and the latest time of one: a nanosecond, and the year 2106 where seconds count
from 1970. Assumption: no sensor of touch is faster; within these a grid can be counted in whole numbers."""


def replay(blocks: Sequence[SampleBlock], detector: Detector) -> Iterator[Detected]:
    """All events of a detector on recorded blocks, in order.

    Raises:
        ReplayError: the detector cannot use such a recording, or compared nothing of it with its threshold.
    """
    found = read = False
    for block in blocks:
        try:
            events = detector.push(block)
        except ValueError as error:
            raise ReplayError(f"{detector.name}: {error}") from None
        read |= not np.isnan(readings_of(detector)[:, 2]).all()
        found |= bool(events)
        yield from events
    if not found and not _decided(detector, blocks, read):
        own = [block for block in blocks if block.stream == detector.inputs[0]]
        span_s = own[-1].last_s - float(own[0].times[0])
        still = " or its mover stands still" if len(detector.inputs) > 1 else ""
        dead = " or the sensor is dead" if all((b.physical == own[0].physical[0]).all() for b in own) else ""
        raise ReplayError(
            f"{detector.name}: nothing was compared with the threshold in {sum(map(len, own))} samples"
            f" ({span_s:.6g} s): the recording is too short{still}{dead}"
        )


ADVISED, NEAR = 0.8, 1.0 / 3.0
"""Share of the largest statistic that is advised as a threshold where nothing reached the one there is; and share of
that which the largest is at least. Assumption: what stays farther away may be noise."""


def all_readings(detector: Detector, blocks: Sequence[SampleBlock]) -> Floats:
    """What a detector, reset, holds against its threshold, decision by decision; see `readings_of`."""
    detector.reset()
    return trace(detector, blocks)[1]


def nearest(blocks: Sequence[SampleBlock], detector: Detector) -> str:
    """How near a detector that reported no event came to its threshold, and what to do; "" where it does not show.

    The detector is reset, and hears the blocks again."""
    readings = all_readings(detector, blocks)
    readings = readings[np.isfinite(readings).all(axis=1)]
    if not len(readings):
        return ""
    t_s, value, threshold = readings[int(np.argmax(readings[:, 1] - readings[:, 2]))].tolist()
    said = f"largest {quantity_of(detector).name} {value:.3g} of {threshold:.3g} at {t_s:.4g} s"
    if value < NEAR * threshold or not hasattr(getattr(detector, "settings", None), "threshold"):
        return said
    return f"{said}: calibrate, or --set threshold={ADVISED * value:.2g}"


def _decided(detector: Detector, blocks: Sequence[SampleBlock], read: bool) -> bool:
    """Whether a detector without events compared anything with its threshold; `read`: whether it had readings."""
    if isinstance(detector, Statistic):
        with suppress(ValueError):  # samples that are not finite, or lost
            return any(not np.isnan(course.statistic).all() for course in courses_of(detector, blocks))
    return read or not hasattr(detector, "readings")


def calibration_line(
    pieces: Sequence[tuple[Statistic, Sequence[SampleBlock]]],
    kind: str,
    false_alarm_interval_s: float,
    fixed: Container[str] = (),
    notes: list[str] | None = None,
) -> dict[str, Any]:
    """The threshold that recordings without events ask for, as one JSON object.

    Args:
        pieces: Recordings, each with the detector whose threshold is wanted, as it was set up for it.
        kind: Of detector, as it was asked for.
        fixed: Settings that are not proposed.
        notes: Lines are added on what the recordings could not carry, and how it held on those left out.

    Raises:
        ReplayError: recordings that allow no estimate: too short, at irregular times, not finite, dead.
    """
    try:
        others, pieces = proposed(pieces, fixed)
        found = calibrate_pieces(pieces, false_alarm_interval_s)
    except ValueError as error:
        raise ReplayError(f"{kind}: {error}") from None
    if notes is not None:
        notes += [*_own_alarms(pieces, kind, found.threshold), *limits_of(found)]
    named = {"low": "threshold_low", "high": "threshold_high"}
    values = {named.get(name, name): plain(value) for name, value in found._asdict().items()}
    return {"detector": kind, **others, **values}


def _own_alarms(
    pieces: Sequence[tuple[Statistic, Sequence[SampleBlock]]], kind: str, threshold: float
) -> Iterator[str]:
    """What is said where the threshold that is proposed is above the detector's own, and that would have alarmed."""
    own = getattr(getattr(pieces[0][0], "settings", None), "threshold", None)
    if own is None or not own < threshold:
        return
    courses = [course for detector, blocks in pieces for course in courses_of(detector, blocks)]
    maxima, _, span_s = spans_of(courses)
    if count := int(np.count_nonzero(maxima >= own)):
        yield (
            f"{kind}'s own threshold of {own:g} is reached in {count * span_s:.4g} of {len(maxima) * span_s:.4g} s: if"
            " those are true events, name the quiet seconds with --span"
        )


def as_line(event: Detected, kind: str) -> dict[str, Any]:
    """One event as one JSON object.

    Args:
        kind: Of detector, as it was asked for.
    """

    line = {"t_s": round(float(event.t_s), 9), "detector": kind, "event": type(event).__name__}
    line |= {"value": event.value, "threshold": event.threshold}
    line |= {
        extra: round(getattr(event, extra), 9) for extra in ("began_s", "sigma_s") if hasattr(event, extra)
    }
    reason = getattr(event, "reason", "")
    found: dict[str, Any] = plain({**line, "reason": reason} if reason else line)
    return found


def source(recording: Path | Run) -> Path | Run:
    """A run, opened by its folder or a part of its name; of a file its path.

    Raises:
        RunFolderError: no such run, or it cannot be read.
    """
    if isinstance(recording, Run) or recording.is_file() or (recording.suffix and not recording.is_dir()):
        return recording
    return open_run(recording)


def read_inputs(
    recording: Path | Run,
    inputs: Sequence[str],
    *,
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    trial: int | None = None,
    notes: list[str] | None = None,
) -> Sequence[SampleBlock]:
    """Blocks of all inputs of a detector, each given when its last sample has come, as the loop gives them.

    Args:
        recording: As `read_blocks`.
        inputs: The detector's streams; of a file, one after the other.
        columns: For each input what `read_blocks` calls its column; of a run folder, of a WAV file and where there is
            one input it may be left out.
        rate_hz: As `read_blocks`.
        trial: As `read_blocks`.
        notes: As `read_blocks`.

    Raises:
        ReplayError: as `read_blocks`; or too few or too many columns, or streams that were not recorded together.
    """
    names = " and ".join(inputs)
    if isinstance(recording, Path) and len(inputs) > 1 and len(columns) != len(inputs):
        raise ReplayError(
            f"{recording}: the inputs are {names}, in this order; give --column for each,"
            " for example --column i,q --column x_m"
        )
    if len(columns) > len(inputs):
        raise ReplayError(
            f"{recording}: {len(columns)} times --column, but {names} is the only input; join them: i,q"
        )
    asked = [*columns, *[None] * (len(inputs) - len(columns))]
    read = [
        read_blocks(recording, stream, column=column, rate_hz=rate_hz, trial=trial, notes=notes)
        for stream, column in zip(inputs, asked, strict=True)
    ]
    given: list[SampleBlock] = [block for blocks in read for block in blocks if len(block)]
    return sorted(given, key=lambda block: block.last_s)


def enveloped(blocks: Sequence[SampleBlock], stream: str, settings: IqSettings) -> Sequence[SampleBlock]:
    """The same blocks, with a finger's sound made an envelope, as the chain of the bench does.

    Args:
        stream: The one that holds the envelope; any other is a mover's position. At 4 kHz and more it is sound, with
            frame 0 at the drive's phase zero; below, an envelope already.
        settings: Of the chain; its channel is the first of what was read.

    Raises:
        ReplayError: neither sound of one finger nor an envelope, or sound that does not hold the drive; a position in
            another unit than metres.
    """
    chain = Iq(stream.removeprefix("signals."), settings)
    made: list[SampleBlock] = []
    for block in blocks:
        if block.stream != stream:
            if block.unit not in ("m", ""):
                raise ReplayError(
                    f"{block.stream}: {block.unit} is no position; choose one in m (mm, cm and um are converted)"
                )
            made.append(block)
            continue
        if block.unit not in ENVELOPES:
            raise ReplayError(
                f"{stream}: {block.unit} is no envelope of a finger; choose I and Q, or its sound"
            )
        if block.rate_hz is None or block.rate_hz < CARRIER_FROM_HZ:
            made.append(block)
            continue
        if block.values.shape[1] != 1:
            raise ReplayError(
                f"{stream}: {block.values.shape[1]} channels of sound; choose one finger's, for example --column 0"
            )
        try:
            parts = chain.push(block)
        except ValueError as error:
            raise ReplayError(str(error)) from None
        full = next((part for part in parts if isinstance(part, Saturated)), None)
        if full is not None:  # what stops the arm on the bench is no envelope here
            raise ReplayError(
                f"{stream}: the converter is at full scale at {full.t_s:.6g} s; turn the gain down and record again,"
                " or cut the recording there"
            )
        made += [replace(part, stream=stream) for part in parts if isinstance(part, SampleBlock)]
    if blocks and not any(block.stream == stream for block in made):
        raise ReplayError(f"{stream}: the sound is too short for an envelope; it takes some milliseconds")
    return sorted(made, key=lambda block: block.last_s)


def own_detectors(manifest: Mapping[str, Any], recording: TrialRecording) -> Mapping[str, Mapping[str, Any]]:
    """Kind and settings of each detector of the profile that a trial was run with, by name."""
    resolved = manifest.get("profile", {}).get("resolved", {})
    named = resolved.get("detectors", {}).items()
    tables = {name: dict(table) for name, table in named if isinstance(table, Mapping)}  # not what is "none"
    kinds_first = sorted(recording.factors.items(), key=lambda factor: not factor[0].endswith(".kind"))
    for factor, value in kinds_first:
        section, _, setting = factor.partition(".")
        name, _, key = setting.partition(".")
        if section == "detectors" and name in tables:
            # the settings of one kind mean nothing to another
            tables[name] = {"kind": value} if key == "kind" else {**tables[name], key: value}
    return tables


def read_trial(run: Run, trial: int | None) -> TrialRecording:
    """What was recorded of one of a run's trials; None is the first.

    Raises:
        ReplayError: nothing was recorded of it.
    """
    path, trials = run.folder.path, run.recorded_trials
    if not trials:
        reason = " ".join(["holds no recording of a trial (recording.mcap).", *run.notes])
        raise ReplayError(f"{path}: {reason.rstrip('.')}")
    chosen = trials[0] if trial is None else trial
    if chosen not in trials:
        raise ReplayError(
            f"{path}: no recording of trial {trial}; recorded are {min(trials)} to {max(trials)}"
        )
    return run.trial(chosen)


def read_blocks(
    recording: Path | Run,
    stream: str,
    *,
    column: str | None = None,
    rate_hz: float | None = None,
    trial: int | None = None,
    notes: list[str] | None = None,
) -> Sequence[SampleBlock]:
    """Blocks of one stream from a recording.

    Args:
        recording: A run, or a file that `controller.recording.tables` reads.
        stream: Name of the detector's input; in a run, the recorded stream.
        column: Of a file as `read_columns` takes it; of a run's stream: the channel's number, from 0. Several with
            commas between them. None is the only one there is besides the times; of a run's stream, all.
        rate_hz: Sample rate of a file without times, or in place of them. Otherwise regular times give it, with a
            jump in `seq` where rows are missing; times that wander are resampled; those of events give none.
        trial: Of a run; None is its first.
        notes: A line is added on the input: samples, rate, duration, gaps, unit, where the times are from,
            how many samples are no finite numbers.

    Raises:
        ReplayError: the file is not there, is none of these, does not hold what is asked for, or no finite
            number of it.
    """
    if isinstance(recording, Run):
        path, name, remark = recording.folder.path, stream, ""
        blocks = _from_run(recording, stream, trial, column)
    elif not recording.is_file():
        raise ReplayError(f"{recording}: no such file or run folder; list runs with: ls runs")
    else:
        path, chosen = recording, read_columns(recording, column)
        name = chosen.name
        blocks, remark = _from_columns(path, stream, chosen, rate_hz)
    remark += _check_values(path, name, blocks)
    if notes is not None:
        notes.append(f"{path.name}: {name}: {_summary(blocks)}{remark}")
    return blocks


def _from_columns(
    path: Path, stream: str, chosen: Chosen, asked_hz: float | None
) -> tuple[Sequence[SampleBlock], str]:
    """Blocks of a file's columns, and a note on their times."""
    values, times_s, rate_hz = chosen.values, chosen.times_s, asked_hz or chosen.rate_hz
    if times_s is None and rate_hz is None:
        raise ReplayError(
            f"{path}: no column of times (t_s, t_ms, time, timestamp …), so the sample rate is needed: --rate HZ"
        )
    if not len(values):
        raise ReplayError(f"{path}: column {chosen.name} has no rows")
    if times_s is not None and (wrong := _no_times(times_s)).any():
        row = int(np.flatnonzero(wrong)[0])
        raise ReplayError(
            f"{path}: {chosen.clock}: {times_s[row]:.9g} s in row {row + 1}: times must be finite and rise from row to"
            f" row, by {LEAST_STEP_S:g} s at least; where they were rounded too coarsely, call the column something"
            " else and give --rate HZ"
        )
    unit, t0_s = chosen.unit, 0.0 if times_s is None else float(times_s[0])
    if times_s is None or rate_hz is not None:
        remark = _other_rate(chosen, asked_hz) if asked_hz else f"; rate from {chosen.clock}"
        return [SampleBlock(stream, 0, t0_s, values, rate_hz=rate_hz, unit=unit)], remark
    # periods and frequencies come one a cycle: even where they look regular they are no samples
    found, remark = None if unit in ("s", "Hz") else regular(times_s, values), f"; times from {chosen.clock}"
    if found is None:
        return [SampleBlock(stream, 0, t0_s, values, times_s=times_s, unit=unit)], remark
    blocks = [
        SampleBlock(stream, seq, float(at_s[0]), piece, rate_hz=found.rate_hz, times_s=at_s, unit=unit)
        for seq, piece, at_s in found.pieces
    ]
    if found.resampled:
        remark += f"; resampled, for its times wander by up to {1e3 * found.jitter_s:.3g} ms"
    slow = "; are these milliseconds? then call the column t_ms" if found.rate_hz < SLOW_HZ else ""
    return blocks, remark + slow


def _other_rate(chosen: Chosen, asked_hz: float) -> str:
    """What is said where a file states another rate than is asked for, or its own times give one, by the usual step
    between rows (some may be missing) and by the mean one (times may be rounded); "" where either agrees."""
    own_hz = [chosen.rate_hz] if chosen.rate_hz else []
    if chosen.times_s is not None and len(chosen.times_s) > 1:
        steps_s = np.diff(chosen.times_s)
        own_hz = [1.0 / float(np.median(steps_s)), 1.0 / float(np.mean(steps_s))]
    if not own_hz:
        return ""
    if any(abs(asked_hz / each_hz - 1.0) <= ALIKE for each_hz in own_hz):
        return ""
    return (
        f"; but {chosen.clock} says {own_hz[0]:.6g} Hz, and --rate was taken: leave it out if that is right"
    )


def _no_times(times_s: Floats) -> NDArray[np.bool_]:
    """Which rows' times are none, or do not come after that of the row before, unless those of a steady rate repeat
    because they were rounded; shape (n,)."""
    none = ~(np.abs(times_s) < LATEST_S)
    rises = np.diff(times_s, prepend=-math.inf) >= LEAST_STEP_S
    repeat = not none.any() and not rises.all() and _rounded(times_s) is not None
    return none if repeat else none | ~rises


def _check_values(path: Path, name: str, blocks: Sequence[SampleBlock]) -> str:
    """How many samples are no finite numbers and when the first one is, as text; "" where all are finite."""
    lost = [block.times[~np.isfinite(block.physical).all(axis=1)] for block in blocks]
    count = sum(map(len, lost))
    if not count:
        return at_rail(blocks)
    if count == sum(len(block) for block in blocks):
        raise ReplayError(
            f"{path}: {name}: no value is a finite number; is it the right column, is the sensor alive?"
        )
    first_s = next(float(times_s[0]) for times_s in lost if len(times_s))
    return f"; {count} samples are no finite numbers, the first at {first_s:.6g} s"


def at_rail(blocks: Sequence[SampleBlock]) -> str:
    """What is said of a converter that stands at an end of its range for `RAIL` samples in a row; "" where none does.

    A channel of a few values alone, as a switch, has no rails; nor has a place, for a mover rests at an end of its way.
    """
    if blocks[0].unit == "m":
        return ""
    series = joined(blocks)
    live = [x for x in series.values.T if len(np.unique(x[:RAIL_LOOK])) > RAIL_LEVELS]
    for x, end in ((each, float(end)) for each in live for end in (each.max(), each.min())):
        edges = np.flatnonzero(np.diff((x == end).astype(np.int8), prepend=0, append=0))
        begins, lengths = edges[::2], edges[1::2] - edges[::2]
        if (lengths >= RAIL).any():
            first_s = float(series.times_s[begins[lengths >= RAIL][0]])
            many = int(lengths[lengths >= RAIL].sum())
            return (
                f"; the converter is at its rail ({end:.6g}) in {many} samples, the first at {first_s:.6g} s"
            )
    return ""


def _summary(blocks: Sequence[SampleBlock]) -> str:
    """Samples, rate, duration, gaps and unit of a stream."""
    series = joined(blocks)
    span_s = float(series.times_s[-1] - series.times_s[0])
    rate_hz, missing = blocks[0].rate_hz, [gap.samples for gap in series.gaps]
    rate = "irregular" if rate_hz is None else f"{rate_hz:.6g} Hz"
    gaps = f"{len(missing)} gaps ({sum(missing)} samples)" if missing else "no gaps"
    return f"{len(series)} samples, {rate}, {span_s:.6g} s, {gaps}, {series.unit or 'no unit'}"


def _from_run(run: Run, stream: str, trial: int | None, column: str | None) -> Sequence[SampleBlock]:
    path, recording = run.folder.path, read_trial(run, trial)
    blocks = recording.blocks(stream)
    if not blocks:
        raise ReplayError(
            f"{path}: trial {recording.trial} has no stream {stream}; it has"
            f" {', '.join(recording.streams) or 'none'} (choose one with --set input=NAME)"
        )
    if column is None:
        return blocks
    count, asked = blocks[0].values.shape[1], column.split(",")
    if unknown := [each for each in asked if each not in map(str, range(count))]:
        raise ReplayError(f"{path}: {stream} has no channel {unknown[0]}; there are 0 to {count - 1}")
    return [replace(block, values=block.values[:, [*map(int, asked)]]) for block in blocks]


def between(blocks: Sequence[SampleBlock], t0_s: float, t1_s: float = math.inf) -> Sequence[SampleBlock]:
    """The samples with t0_s <= t < t1_s: a baseline that begins there takes the first of them."""
    kept: list[SampleBlock] = []
    for block in blocks:
        first, last = (int(at) for at in np.searchsorted(block.times, [t0_s - 1e-9, t1_s - 1e-9]))
        if first < last:
            kept.append(part(block, first, last))
    return kept


ROUNDING = 0.25
"""Rows are regular samples where their times are within this share of a period of a common grid: times that were
rounded when they were written, as 1 ms at 400 Hz (assumption)."""

ROUNDED = 1.25
"""Times that were rounded to whole units are within so many units of each other beside the line through them: one, and
what the line is off and the clock wanders (assumption)."""

WHOLE = 1e-3
"""Steps this near a whole number of units are one: what numbers in binary leave of decimals (assumption)."""

ALTERNATES, OFTEN, EVEN = 12, 0.05, 0.8
"""Steps of both lengths that must be there at the least; share of the longer ones; and where they are fewer, the share
of those that come at two adjacent distances. Assumptions: losses by chance are not as even as a rate that was rounded,
and those of a program that loses a row of each block all come at one distance."""

WANDERING = 0.95
"""So large a share of the steps must be in that range for the rows to be samples at all (assumption)."""


class Regular(NamedTuple):
    """A recording at one rate.

    Attributes:
        pieces: Samples in a row, in order: number of the first one on the grid, values (n, channels), times (n,); a
            jump of the numbers is a gap.
        jitter_s: How far the file's times are from the grid, at most.
        resampled: Whether the values were interpolated to the grid.
    """

    rate_hz: float
    pieces: Sequence[tuple[int, Floats, Floats]]
    jitter_s: float
    resampled: bool


def regular(times_s: Floats, values: Floats) -> Regular | None:
    """Samples at a regular rate, or None where the times are those of events, not of samples.

    Times on a grid are kept as they are, and those that were rounded so coarsely that they repeat are those of the line
    through them. Times that wander about one are interpolated to it by cubic splines,
    each stretch between two gaps by itself.

    Args:
        times_s: Rising, shape (n,).
        values: Shape (n, channels).
    """
    if len(times_s) < 2:
        return None
    if (rounded := _rounded(times_s)) is not None:
        return _pieces(*rounded, values)
    steps_s = np.diff(times_s)
    median_s = float(np.median(steps_s))
    # their mean: where 2.5 ms was rounded to 2 or 3, the median is one of the two; twice, for 5 ms is usual beside 3
    usual_s = median_s
    for _ in range(2):
        usual = steps_s[_usual(steps_s, usual_s)]
        usual_s = float(usual.mean()) if len(usual) else usual_s
    places = np.concatenate(([0], np.cumsum(np.rint(steps_s / usual_s).astype(np.int64))))
    period_s = float(times_s[-1] - times_s[0]) / max(1, int(places[-1]))
    off_s = times_s - times_s[0] - period_s * places
    # a line through them all, for the first and the last time were rounded too
    centred = places - places.mean()
    slope_s = float(centred @ off_s) / max(1.0, float(centred @ centred))
    period_s += slope_s
    jitter_s = 0.5 * float(np.ptp(off_s - slope_s * centred))
    if np.diff(places).min() >= 1 and jitter_s <= ROUNDING * period_s:
        return _pieces(period_s, places, times_s, jitter_s, values)
    return _resampled(times_s, values, median_s)


def _pieces(
    period_s: float, places: NDArray[np.int64], times_s: Floats, jitter_s: float, values: Floats
) -> Regular:
    """Samples at their numbers on a grid, as they are."""
    starts = np.flatnonzero(np.diff(places, prepend=-2) != 1)
    pieces = [
        (int(places[first]), values[first:last], times_s[first:last])
        for first, last in zip(starts, [*starts[1:], len(values)], strict=True)
    ]
    return Regular(1.0 / period_s, pieces, jitter_s, False)


def _rounded(times_s: Floats) -> tuple[float, NDArray[np.int64], Floats, float] | None:
    """Period, numbers on its grid, times and jitter of samples at a steady rate whose times were rounded to a unit
    (a power of ten, s) that is about as long as the period: 800 Hz in whole milliseconds has steps of 1, 1, 1 and 2.
    None of any others, in which a step of 2 is a gap."""
    steps_s = np.diff(times_s)
    units_s = [10.0**-power for power in range(7)]
    unit_s = next((unit_s for unit_s in units_s if _whole(steps_s / unit_s)), None)
    if unit_s is None:
        return None
    ticks = np.rint(steps_s / unit_s)
    least = int(np.median(ticks))
    if np.count_nonzero(ticks == least - 1) > np.count_nonzero(ticks == least + 1):
        least -= 1
    short, long = (np.count_nonzero(ticks == step) for step in (least, least + 1))
    if least not in (0, 1) or ticks.min() < least or min(short, long) < ALTERNATES:
        return None
    if least == 1 and long < OFTEN * short:
        apart = np.diff(np.flatnonzero(ticks == least + 1))
        even = np.abs(apart - np.median(apart)) <= 1
        if even.mean() < EVEN or not np.ptp(apart[even]):
            return None
    # each stretch between two gaps beside one line, all of one slope
    stretch = np.concatenate(([0], np.cumsum(ticks > least + 1)))
    rows, sizes = np.arange(len(times_s)), np.bincount(stretch)
    middles = (np.bincount(stretch, rows) / sizes)[stretch]
    middles_s = (np.bincount(stretch, times_s) / sizes)[stretch]
    period_s = float((rows - middles) @ (times_s - middles_s)) / float((rows - middles) @ (rows - middles))
    grid_s = middles_s + period_s * (rows - middles)
    firsts = np.flatnonzero(np.diff(stretch, prepend=-1))
    off_s = times_s - grid_s
    jitter_s = float((np.maximum.reduceat(off_s, firsts) - np.minimum.reduceat(off_s, firsts)).max())
    if jitter_s > ROUNDED * unit_s:
        return None
    places = np.concatenate(([0], np.cumsum(np.rint(np.diff(grid_s) / period_s).astype(np.int64))))
    return period_s, places, times_s if least else grid_s, 0.5 * jitter_s


def _whole(steps: Floats) -> bool:
    return bool(np.abs(steps - np.rint(steps)).max(initial=0.0) < WHOLE)


def _usual(steps_s: Floats, period_s: float) -> NDArray[np.bool_]:
    """Which steps are in the range `STEPS` of a period; shape as theirs."""
    return (steps_s >= STEPS[0] * period_s) & (steps_s <= STEPS[1] * period_s)


def _resampled(times_s: Floats, values: Floats, median_s: float) -> Regular | None:
    steps_s = np.diff(times_s)
    usual = _usual(steps_s, median_s)
    if usual.mean() < WANDERING:
        return None
    period_s = float(steps_s[usual].mean())
    starts = [0, *(np.flatnonzero(steps_s > STEPS[1] * median_s) + 1)]
    pieces: list[tuple[int, Floats, Floats]] = []
    jitter_s, seq = 0.0, 0
    for first, last in zip(starts, [*starts[1:], len(times_s)], strict=True):
        since_s, rows = times_s[first:last], values[first:last]
        seq = max(seq, round(float(since_s[0] - times_s[0]) / period_s))
        count = 1 + int((since_s[-1] - since_s[0]) / period_s + 1e-9)
        grid_s = since_s[0] + period_s * np.arange(count)
        pieces.append((seq, _interpolated(grid_s, since_s, rows), grid_s))
        drift_s = since_s - since_s[0] - period_s * np.arange(len(since_s))
        jitter_s = max(jitter_s, float(np.abs(drift_s - np.median(drift_s)).max()))
        seq += count + 1  # a gap stays one, however the rounding falls
    return Regular(1.0 / period_s, pieces, jitter_s, True)


def _interpolated(grid_s: Floats, times_s: Floats, values: Floats) -> Floats:
    if len(times_s) < 4 or not np.isfinite(values).all():
        found = [np.interp(grid_s, times_s, values[:, channel]) for channel in range(values.shape[1])]
        return np.column_stack(found)
    from scipy.interpolate import CubicSpline

    spline: Floats = CubicSpline(times_s, values)(grid_s)
    return spline
