"""How a run was run: from its manifest, nothing left out."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from controller.outcomes import counted
from controller.recording.reader import Run
from controller.recording.series import Series, TrialRecording
from controller.reports.settings import shown
from controller.scales import scale_of

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
    profile = manifest.get("profile") or {}
    exit_ = manifest.get("exit") or {}
    status = str(exit_.get("status", "unknown"))
    if status == "running":
        status = "cut off: its end was not recorded"
    reason = f" – {exit_['reason']}" if exit_.get("reason") else ""
    facts = [
        ("profile", f"{profile.get('name', '?')}, hash {str(profile.get('hash', '?'))[:12]}"),
        ("experiment", str(manifest.get("experiment", "?"))),
        ("bench", _BENCH.get(str(manifest.get("bench")), str(manifest.get("bench", "?")))),
        ("clock", _CLOCK.get(str(manifest.get("clock")), str(manifest.get("clock", "?")))),
        ("ended", status + reason),
        ("outcomes", counted(manifest.get("outcomes") or {}, run.successes)),
        ("forecast", _foreseen(run)),
    ]
    rest = {name: value for name, value in manifest.items() if name not in _SHOWN_ELSEWHERE}
    return facts + [(name, text) for name, text in _flat(rest) if text]


def _foreseen(run: Run) -> str:
    """What was forecast of the approaches, and what they did; "none" where no stiffness or no force limit was known."""
    foreseen = [event for event in run.events if event["event"] == "Forecast"]
    did = [event for event in run.events if event["event"] == "Approached"]
    if not foreseen or not did:
        return "none"

    def most(events: Sequence[Mapping[str, Any]], key: str) -> str:
        values = [event.get(key) for event in events]
        known = [value for value in values if isinstance(value, int | float) and math.isfinite(value)]
        scale = scale_of(key)
        return f"{scale.factor * max(known):.3g} {scale.unit}" if known else "unknown"

    touch = f"at a touch {most(foreseen, 'most_n')} at the most, pressed {most(did, 'pressed_n')}"
    way = f"after the stop {most(foreseen, 'travel_m')} at the most, gone {most(did, 'travel_m')}"
    return f"{len(foreseen)} approaches; {touch}; {way}"


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
    status = str(exit_.get("status"))
    stops = []
    for event in (event for event in run.events if event["event"] == "GuardStopped"):
        when = f"Trial {event['trial']}, {event['t_s']:.3f} s after it began, in {event.get('state') or 'no state'}"
        stops.append(f"{when}: {event.get('reason') or 'no reason was recorded'}.")
    if status not in _ENDS and not stops:
        return None
    status = "guard" if stops else status
    return EarlyEnd(run.folder.path.name, _ENDS[status], stops, str(exit_.get("reason") or ""))


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


def statistic_of(run: Run, detector: str) -> tuple[str, str]:
    """What a detector of the run compares with its threshold, and its unit: as it declared them."""
    declared = (run.manifest.get("detectors") or {}).get(detector) or {}
    return str(declared.get("statistic") or "statistic"), str(declared.get("unit") or "")


def criterion_of(run: Run, detector: str) -> str:
    """`the detector “ours” (resonance, on board.accelerometer) compares the … (σ) with its threshold`."""
    name, unit = statistic_of(run, detector)
    declared = (run.manifest.get("detectors") or {}).get(detector) or {}
    kind = setting_of(run, "detectors", detector, "kind")
    what = ", on ".join(filter(None, (str(kind or ""), " and ".join(declared.get("inputs") or ()))))
    named, measured = (f" ({text})" if text else "" for text in (what, unit))
    return f"the detector “{detector}”{named} compares the {name}{measured} with its threshold"


def _flat(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, item in value.items():
        label = f"{prefix}{name}".replace("_", " ")
        if isinstance(item, Mapping):
            scalars = all(not isinstance(each, Mapping | list) for each in item.values())
            if item and scalars and len(item) <= 8:
                yield label, ", ".join(f"{key} {_said(each)}" for key, each in item.items())
            elif item:
                yield from _flat(item, f"{label} · ")
            else:
                yield label, "none" if name == "loss" else ""
        else:
            yield label, _said(item)


def _said(value: object) -> str:
    return "" if value is None or value == [] else shown(value)
