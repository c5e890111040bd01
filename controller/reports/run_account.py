"""How a run was run: from its manifest, nothing left out."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from controller.outcomes import counted
from controller.recording.reader import Run
from controller.recording.series import Series, TrialRecording
from controller.reports.counts import Trials
from controller.reports.settings import flat, shown

_BENCH = {
    "mock": "mock: mock drivers on simulated physics, in the process",
    "emulated": "emulated: the real drivers over real bytes, on simulated physics",
    "hardware": "hardware: the real drivers and the real bench",
}
_CLOCK = {
    "virtual": "virtual: bench time jumps; latencies are the loop's turns, not the computer's",
    "held": "wall clock, held while a process of the emulated bench is late",
    "wall": "wall clock",
}
_SHOWN_ELSEWHERE = ("format", "profile", "experiment", "bench", "clock", "exit", "title", "outcomes")


def facts_of(run: Run) -> list[tuple[str, str]]:
    """How a run was run, as pairs."""
    manifest = run.manifest
    profile, exit_ = (manifest.get(name) or {} for name in ("profile", "exit"))
    experiment, bench, clock = (str(manifest.get(name, "?")) for name in ("experiment", "bench", "clock"))
    status = str(exit_.get("status", "unknown"))
    status = "cut off: its end was not recorded" if status == "running" else status
    facts = [
        ("profile", f"{profile.get('name', '?')}, hash {str(profile.get('hash', '?'))[:12]}"),
        ("experiment", experiment),
        ("bench", _BENCH.get(bench, bench)),
        ("clock", _CLOCK.get(clock, clock)),
        ("ended", f"{status} – {exit_['reason']}" if exit_.get("reason") else status),
        ("outcomes", counted(manifest.get("outcomes") or {}, run.successes)),
    ]
    rest = {name: value for name, value in manifest.items() if name not in _SHOWN_ELSEWHERE}
    rest |= {"loss": rest["loss"] or "none"} if "loss" in rest else {}
    lines = [(path.replace("_", " "), value) for path, value in flat(rest, joint=" · ", whole=_short)]
    return facts + [
        (name, text) for name, value in lines if value not in (None, []) and (text := shown(value))
    ]


def _short(table: Mapping[str, Any]) -> bool:
    """Whether a table is one line: few values, none of them a table or a list."""
    return len(table) <= 8 and not any(isinstance(each, Mapping | list) for each in table.values())


_ENDS = {
    "guard": "The guard stopped every mover",
    "fault": "A fault ended the run",
    "aborted": "The run was interrupted",
    "failed": "The run failed",
}


class EarlyEnd(NamedTuple):
    """That a run did not come to its end: what happened, and where, when and why, one sentence each."""

    name: str
    what: str
    stops: Sequence[str]
    reason: str


def early_end(run: Run) -> EarlyEnd | None:
    """How a run ended before its end; None where it ended as planned, or was cut off without a record."""
    exit_ = run.manifest.get("exit") or {}
    stops = [
        f"Trial {event['trial']}, {event['t_s']:.3f} s after it began, in {event.get('state') or 'no state'}:"
        f" {event.get('reason') or 'no reason was recorded'}."
        for event in Trials(run.events).where(event="GuardStopped")
    ]
    what = _ENDS.get("guard" if stops else str(exit_.get("status")))
    return EarlyEnd(run.folder.path.name, what, stops, str(exit_.get("reason") or "")) if what else None


def series_of(recording: TrialRecording, kind: str) -> Series:
    """The stream `<device>.<kind>`, whatever the device is called; empty where there is none."""
    named = [name for name in recording.streams if name.endswith(f".{kind}")]
    return recording.stream(named[0] if named else kind)


def recorded(runs: Iterable[Run]) -> Iterator[tuple[Run, Mapping[str, Any], TrialRecording]]:
    """Every trial whose recording can be read: its run, its row, and the recording."""
    for run in runs:
        for row in run.trials:
            recording = run.readable(int(row["trial"] or 0))
            if recording is not None:
                yield run, row, recording


def experiment_in(run: Run) -> str:
    """What a run's manifest calls its experiment."""
    return str(run.manifest.get("experiment", ""))


def setting_of(run: Run, *path: str) -> Any:
    """A setting of the resolved profile, or None."""
    value: Any = run.resolved
    for name in path:
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def entered_s(run: Run, trial: object) -> dict[str, float]:
    """When a trial last entered each of its states; an event within a state has that state as its next one, too."""
    own = run.events_of(trial)
    return {str(e["next"]): float(e["t_s"]) for e in own if e.get("next") != e.get("state")}


def acting_of(run: Run) -> str:
    """The detector whose event ends what it runs beside, by the behavior's settings."""
    return str(setting_of(run, "behavior", "detector") or "contact")


def declared_of(run: Run, detector: str) -> Mapping[str, Any]:
    """What a detector of the run declared: its inputs, and the name of the `statistic` that it compares with its
    threshold, with its unit."""
    return {"statistic": "statistic", **((run.manifest.get("detectors") or {}).get(detector) or {})}


def criterion_of(run: Run, detector: str) -> str:
    """`the detector “ours” (resonance, on board.accelerometer) compares the … (σ) with its threshold`."""
    declared, kind = declared_of(run, detector), setting_of(run, "detectors", detector, "kind")
    what = ", on ".join(filter(None, (kind, " and ".join(declared.get("inputs") or ()))))
    named, measured = (f" ({text})" if text else "" for text in (what, declared.get("unit")))
    return (
        f"the detector “{detector}”{named} compares the {declared['statistic']}{measured} with its threshold"
    )
