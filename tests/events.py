"""Events of the detectors on kept recordings: shows what changed, and keeps it: python -m tests.events"""

import json
import math
import tomllib
from collections.abc import Iterator, Mapping, Sequence
from difflib import SequenceMatcher
from pathlib import Path
from typing import Any

import click

from config.recordings import load
from controller.replay import as_line, replay

FOLDER = Path(__file__).parent / "data" / "events"
CASES: Mapping[str, Mapping[str, Any]] = tomllib.loads((FOLDER / "cases.toml").read_text("utf-8"))
KEPT = FOLDER / "events.json"

TIME_S = 1e-6
"""By how much an event's time may differ, s: rounding; a sample is 1,000 times as long."""

VALUE = 1e-4
"""By how much its value may, relatively: the same sums in another order, on another machine (assumption)."""

Events = Sequence[Mapping[str, Any]]


def detected(case: str) -> Events:
    """The events of a case's detector on its recording."""
    asked = CASES[case]
    overrides = {key: json.dumps(value) for key, value in asked.get("set", {}).items()}
    baseline = tuple(asked["baseline"]) if "baseline" in asked else None
    found = load(
        asked["detector"], FOLDER / asked["recording"], overrides, columns=asked["columns"], baseline=baseline
    )
    return [as_line(event, asked["detector"]) for event in replay(found.blocks, found.detector)]


def kept() -> dict[str, Events]:
    """Their events when they were last kept."""
    return json.loads(KEPT.read_text("utf-8")) if KEPT.exists() else {}


def changes(before: Events, after: Events) -> Iterator[str]:
    """A line for each event that is gone (-), new (+), or not where or what it was (~); none where all is equal."""
    names = [[event["event"] for event in events] for events in (before, after)]
    for tag, a, b, c, d in SequenceMatcher(a=names[0], b=names[1], autojunk=False).get_opcodes():
        if tag == "equal":
            yield from filter(None, map(_moved, before[a:b], after[c:d]))
            continue
        yield from (f"- {_line(event)}" for event in before[a:b])
        yield from (f"+ {_line(event)}" for event in after[c:d])


def _moved(old: Mapping[str, Any], new: Mapping[str, Any]) -> str:
    later_s = new["t_s"] - old["t_s"]
    parts = [f"{later_s:+.6f} s (at most {TIME_S:g})"] if abs(later_s) > TIME_S else []
    for name in ("value", "threshold"):
        one, other = (math.nan if event[name] is None else event[name] for event in (old, new))
        if not (math.isclose(one, other, rel_tol=VALUE) or (math.isnan(one) and math.isnan(other))):
            parts.append(f"{name} {one:.6g} → {other:.6g} (at most {VALUE:g} of it)")
    return f"~ {_line(old)}: {', '.join(parts)}" if parts else ""


def _line(event: Mapping[str, Any]) -> str:
    return f"{event['t_s']:.6f} s {event['event']} {event['value']}"


if __name__ == "__main__":
    old, new = kept(), {case: detected(case) for case in CASES}
    for case in dict.fromkeys((*old, *new)):
        lines = list(changes(old.get(case, ()), new.get(case, ())))
        click.echo("\n  ".join([case, *(lines or ["as before"])]))
    KEPT.write_text(json.dumps(new, indent=1) + "\n", "utf-8")
