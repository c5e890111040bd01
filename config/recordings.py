"""What `replay` and `calibrate` share: a detector, and its input from a recording."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from config.assemble import make_detector
from config.hints import near_or_all
from config.source import ProfileError, given_value
from config.validation import validated
from controller.detectors.protocol import Detector, envelope_of
from controller.outcomes import UNMEASURED
from controller.own_modules import found, is_own, own_folders
from controller.recording.reader import Run
from controller.recording.tables import ReplayError
from controller.registry import KINDS
from controller.replay import (
    between,
    enveloped,
    own_detectors,
    read_inputs,
    read_trial,
    source,
)
from controller.signals.iq import IqSettings
from drivers.core.messages import SampleBlock


class Input(NamedTuple):
    """A detector and its input.

    Attributes:
        blocks: Of all its inputs, in order of time.
        notes: A line for each input: what was read.
    """

    detector: Detector
    blocks: Sequence[SampleBlock]
    notes: Sequence[str]


CHAIN = "iq."
"""What begins a setting of the chain from sound to envelope, after `--set`."""


def load(
    asked: str,
    recording: Path | Run,
    overrides: Mapping[str, str],
    *,
    columns: Sequence[str] = (),
    rate_hz: float | None = None,
    baseline: tuple[float, float] | None = None,
    trial: int | None = None,
) -> Input:
    """A detector, and its blocks of a recording, in order of time.

    Args:
        asked: Kind of detector; of a run folder also a detector's name in the run's profile.
        recording: A run, its folder or a part of its name, or a file that `controller.recording.tables` reads.
        overrides: Settings as TOML values; those of the chain from sound to envelope begin with `iq.`. Of a run whose
            profile has such a detector, its settings in that trial are the defaults.
        columns: For each input, as `controller.replay.read_inputs` takes them.
        rate_hz: Of a file without times.
        baseline: Times in seconds: its input begins at the first; a detector with a baseline learns between them.
        trial: Of a run folder; None is its first.

    Raises:
        ProfileError: no such detector, or settings that it does not take.
        ReplayError: the recording does not hold its inputs.
        RunFolderError: no such run.
    """
    chain = {key.removeprefix(CHAIN): text for key, text in overrides.items() if key.startswith(CHAIN)}
    overrides = {key: text for key, text in overrides.items() if not key.startswith(CHAIN)}
    recording = source(recording)
    if trial is not None and isinstance(recording, Path):
        raise ReplayError(
            f"--trial {trial}: {recording} is a file, only a run folder has trials; leave it out"
        )
    if rate_hz is not None and isinstance(recording, Run):
        raise ReplayError(
            f"--rate {rate_hz:g}: {recording.folder.path} is a run folder and has its own times; leave it out"
        )
    kind, own = _in_run(recording, asked, overrides, trial) if isinstance(recording, Run) else (asked, {})
    made = make_detector(kind, {**own, **overrides}, baseline, _folders(recording))
    notes: list[str] = []
    blocks = read_inputs(recording, made.inputs, columns=columns, rate_hz=rate_hz, trial=trial, notes=notes)
    path = recording.folder.path if isinstance(recording, Run) else recording
    envelope = envelope_of(made)
    if envelope is not None:
        blocks = enveloped(blocks, envelope, _chain_settings(made, chain))
    elif chain:
        raise ProfileError(f"--set {CHAIN}{min(chain)}: {asked} takes no envelope of a sound; leave it out")
    if baseline is not None:
        blocks = between(blocks, baseline[0])
    if not any(block.stream == made.inputs[0] for block in blocks):
        raise ReplayError(f"{path}: no sample of {made.inputs[0]} from --baseline on; begin earlier")
    return Input(made, blocks, notes)


def load_quiet(
    asked: str,
    recordings: Sequence[Path],
    overrides: Mapping[str, str],
    *,
    spans: Sequence[tuple[float, float]] = (),
    trial: int | None = None,
    **given: Any,
) -> Sequence[Input]:
    """What a threshold is set on: each recording, of a run each trial, and of each the spans that are asked for. A note
    names the trials that broke off.

    Args:
        asked: As `load`.
        recordings: As `load` takes one.
        overrides: As `load`.
        spans: Times in seconds of what is quiet; all of it where there are none.
        trial: Of run folders; None is all that were recorded.
        given: As `load`.

    Raises:
        ProfileError, ReplayError, RunFolderError: as `load`; or a span without a sample, or a detector that is not set
            alike in all.
    """
    loaded: list[Input] = []
    first: tuple[str, Detector] | None = None
    for recording in recordings:
        read = source(recording)
        run, path = (read, read.folder.path) if isinstance(read, Run) else (None, recording)
        trials = run.recorded_trials if run is not None and trial is None else [trial]
        outcomes = {row["trial"]: row["outcome"] for row in run.trials} if run is not None else {}
        broken = [f"{one} ({outcomes[one]})" for one in trials if outcomes.get(one) in UNMEASURED]
        for one in trials or [None]:
            whole = load(asked, read, overrides, trial=one, **given)
            if broken:
                said = f"{path.name}: trials that broke off are included: {', '.join(broken)}; --trial N takes one"
                whole = whole._replace(notes=[*whole.notes, said])
            where = str(path) if one is None else f"{path}, trial {one}"
            first = first or (where, whole.detector)
            _check_alike(*first, where, whole.detector)
            cut = [between(whole.blocks, *span) for span in spans] or [whole.blocks]
            for span, blocks in zip(spans, cut, strict=False):
                if not blocks:
                    raise ReplayError(f"{path}: no sample from {span[0]:g} to {span[1]:g} s")
            _check_finite(path, [block for blocks in cut for block in blocks], whole.detector.inputs[0])
            loaded += [whole._replace(blocks=blocks) for blocks in cut]
    return loaded


def _check_alike(first: str, one: Detector, where: str, other: Detector) -> None:
    """Refuse a second recording whose detector differs from that of the first in more than its threshold."""
    ours, theirs = ({"kind": type(each), **dict(getattr(each, "settings", ()))} for each in (one, other))
    for key, value in ours.items():
        if key != "threshold" and theirs[key] != value:
            here, there = (getattr(each, "__name__", each) for each in (theirs[key], value))
            same = here == there  # two classes of the user's own that have one name
            raise ReplayError(
                f"{where}: {key} = {here}, but {'another ' * same}{there} in {first}; one threshold is for one kind"
                " and setting: choose a trial with --trial, or set it for all with --set"
            )


def _check_finite(path: Path, blocks: Sequence[SampleBlock], stream: str) -> None:
    """Refuse a recording whose values no statistic can be made of."""
    for block in blocks:
        lost_s = block.times[~np.isfinite(block.physical).all(axis=1)]
        if block.stream == stream and len(lost_s):
            raise ReplayError(
                f"{path}: a value at {lost_s[0]:.6g} s is not finite; name the seconds before and after it with --span"
                " T0:T1, or cut the recording there"
            )


def not_calibratable(kind: str) -> ReplayError:
    """The error of a kind of detector that shows no number which it holds against a threshold."""
    shown = [name for name, entry in KINDS["detector"].items() if hasattr(found(entry.made), "statistic")]
    return ReplayError(f"--detector {kind}: no threshold that a recording could set; try {', '.join(shown)}")


def _in_run(
    run: Run, asked: str, overrides: Mapping[str, str], trial: int | None
) -> tuple[str, Mapping[str, str]]:
    """Kind and settings (TOML values) of the detector that is meant: the run's own where it has one of that kind."""
    recording = read_trial(run, trial)
    tables = own_detectors(run.manifest, recording)
    if asked not in KINDS["detector"] and not is_own(asked):
        if asked not in tables:
            known = {*KINDS["detector"], *tables}
            raise ProfileError(f"--detector {asked}: no such detector; {near_or_all(asked, known)}")
        return _split(run, tables[asked])
    alike = {name: table for name, table in tables.items() if table["kind"] == asked}
    streams = {
        key: given_value(f"--set {key}", text) for key, text in overrides.items() if key.endswith("input")
    }
    meant = {name: table for name, table in alike.items() if streams.items() <= table.items()}
    recorded = {
        name: table
        for name, table in meant.items()
        if set(make_detector(*_split(run, table)).inputs) <= set(recording.streams)
    } or meant
    if len(recorded) > 1:
        names = " or ".join(sorted(recorded))
        raise ReplayError(
            f"{run.folder.path}: {len(recorded)} detectors of kind {asked} in trial {recording.trial}; choose"
            f" --detector {names}"
        )
    return _split(run, next(iter(recorded.values()))) if recorded else (asked, {})


def _split(run: Run, table: Mapping[str, Any]) -> tuple[str, Mapping[str, str]]:
    """Kind of a run's detector, and its settings as TOML values: what JSON makes of a setting, TOML reads."""
    kind, own = table["kind"], {key: json.dumps(value) for key, value in table.items() if key != "kind"}
    try:
        make_detector(kind, own, folders=_folders(run))
    except ProfileError as error:
        problem = error.problems[0].removeprefix("--set ")
        raise ReplayError(
            f"{run.folder.path}: its {kind} is of another version ({problem}); replay it with the commit that its"
            " manifest names"
        ) from None
    return kind, own


def _folders(recording: Path | Run) -> Sequence[Path]:
    """Where a detector of the user's own is looked for: where the run found it, and here."""
    return [*(own_folders(recording.manifest) if isinstance(recording, Run) else ()), Path.cwd()]


def _chain_settings(detector: Detector, given: Mapping[str, str]) -> IqSettings:
    """Settings of the chain before a detector: its drive must be the one that the detector is set to."""
    drive_hz = getattr(getattr(detector, "settings", None), "drive_hz", None)
    values = {key: given_value(f"--set {CHAIN}{key}", text) for key, text in given.items()}
    if drive_hz is not None and values.setdefault("drive_hz", drive_hz) != drive_hz:
        raise ProfileError(
            f"--set {CHAIN}drive_hz = {values['drive_hz']}: the detector has drive_hz = {drive_hz:g}; set both alike"
        )
    return validated(IqSettings, values, lambda place: f"--set {CHAIN}{'.'.join(place)}")
