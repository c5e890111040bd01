"""How a run was run: from its manifest, nothing left out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from controller.recording.reader import Run
from controller.recording.series import Series, TrialRecording

_BENCH = {
    "mock": "mock: mock drivers on simulated physics, in the process",
    "emulated": "emulated: the real drivers over real bytes, on simulated physics",
    "hardware": "hardware: the real drivers and the real bench",
}
_CLOCK = {
    "virtual": "virtual: bench time jumps; latencies are the loop's turns, not the computer's",
    "wall": "wall clock",
}
_SHOWN_ELSEWHERE = ("format", "profile", "experiment", "bench", "clock", "exit", "title")


@dataclass(frozen=True, slots=True)
class RunAccount:
    """A run described: name, notes on what was cut off, and its facts as pairs."""

    name: str
    notes: Sequence[str]
    facts: Sequence[tuple[str, str]]


def account_of(run: Run) -> RunAccount:
    """The account of one run."""
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
    ]
    rest = {name: value for name, value in manifest.items() if name not in _SHOWN_ELSEWHERE}
    facts += [(name, text) for name, text in _flat(rest) if text]
    return RunAccount(run.folder.path.name, run.notes, facts)


_ENDS = {
    "guard": "The guard stopped every mover",
    "fault": "A fault ended the run",
    "aborted": "The run was interrupted",
    "failed": "The run failed",
}


@dataclass(frozen=True, slots=True)
class EarlyEnd:
    """That a run did not come to its end: what happened, and where, when and why, one sentence each."""

    name: str
    what: str
    stops: Sequence[str]
    reason: str


def early_end(run: Run) -> EarlyEnd | None:
    """How a run ended before its end; None where it ended as planned, or was cut off without a record."""
    exit_ = run.manifest.get("exit") or {}
    status = str(exit_.get("status"))
    stops = [
        f"Trial {event['trial']}, {event['t_s']:.3f} s after it began, in {event.get('state') or 'no state'}: "
        f"{event.get('reason') or 'no reason was recorded'}."
        for event in run.events
        if event["event"] == "GuardStopped"
    ]
    if status not in _ENDS and not stops:
        return None
    status = "guard" if stops else status
    return EarlyEnd(run.folder.path.name, _ENDS[status], stops, str(exit_.get("reason") or ""))


def series_of(recording: TrialRecording, kind: str) -> Series:
    """The stream `<device>.<kind>`, whatever the device is called; empty where there is none."""
    named = [name for name in recording.streams if name.endswith(f".{kind}")]
    return recording.stream(named[0] if named else kind)


def setting_of(run: Run, *path: str) -> Any:
    """A setting of the resolved profile, or None."""
    value: Any = (run.manifest.get("profile") or {}).get("resolved") or {}
    for name in path:
        value = value.get(name) if isinstance(value, Mapping) else None
    return value


def _flat(value: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, str]]:
    for name, item in value.items():
        label = f"{prefix}{name}".replace("_", " ")
        if isinstance(item, Mapping):
            scalars = all(not isinstance(each, Mapping | list) for each in item.values())
            if item and scalars and len(item) <= 8:
                yield label, ", ".join(f"{key} {_short(each)}" for key, each in item.items())
            elif item:
                yield from _flat(item, f"{label} · ")
            else:
                yield label, "none" if name == "loss" else ""
        elif isinstance(item, list):
            yield label, ", ".join(_short(each) for each in item)
        else:
            yield label, _short(item)


def _short(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else "" if value is None else str(value)
