"""Defects that are planted in the program, and within how many seeds the swarm finds each.

python -m tests.swarm.planted [--seeds 1000] [--seconds 60] [NUMBER…]
"""

from __future__ import annotations

import argparse
import inspect
import json
import os
import re
import sys
import textwrap
import time
from importlib import import_module
from typing import Any, NamedTuple

from behaviors.machine import _machine
from config.swarm.hunt import Hunt, deep_of, examined
from config.swarm.plan import drawn

QUICK = ("transient", "static", "transient_arm", "reckless")
"""Experiments of which a seed costs a tenth of a second."""


class Planted(NamedTuple):
    """A change of a function's source.

    Attributes:
        likely: What is in the plans that may show it, a regular expression; the seeds of others are counted alone.
    """

    where: str
    old: str
    new: str
    likely: str = ""


LOOP, GUARD, ARRIVALS = "controller.loop:Loop", "controller.guard:Guard", "controller.arrivals:Arrivals"
CAMPAIGN, BOUNDS = "controller.campaign:Campaign", "controller.limits:Bounds"
RECORDER, LINES = "controller.recording.recorder:Recorder", "controller.recording.trial_rows:Lines"

HANGS = '"hang"[^}]*(after = "APPROACH"[^}]*amount = (0.3|2.0)|amount = (0.3|2.0)[^}]*after = "APPROACH")'

DEFECTS = (
    Planted(
        f"{LOOP}._turn",
        "reason is not None or missing is not None or any(",
        "reason is not None or any(",
        'Reckless.*"silent", after = "APPROACH"',
    ),  # V5
    Planted(f"{LOOP}._turn", "guard.latch(t_s)", "pass", f"Reckless.*{HANGS}"),
    Planted(f"{LOOP}._turn", "self._stop_all()", "pass", 'Reckless.*after = "APPROACH"'),
    Planted(f"{LOOP}._stop_all", "self._send(Stop(name))", "pass"),
    Planted(f"{LOOP}._stop_and_see", "self._stop_all()", "pass", '"abort"'),
    Planted(f"{LOOP}._stop_and_see", "self.account.not_at_rest += sorted(pending)", "pass", '"silent"'),
    Planted(f"{GUARD}.way_out", "-speed_m_s, end_m", "speed_m_s, bounds.travel_m", 'retreat_n.*"overrun"'),
    Planted(f"{LOOP}._passes_on", "self._trial.outdated(event)", "False", '"late".*"pause"|"pause".*"late"'),
    Planted(f"{LOOP}._handle", "self._give_up(event)", "pass"),
    Planted(
        f"{LOOP}._handle",
        "self._trial.end_s = -math.inf",
        "pass",
        'Reckless.*after = "RETRACTING"',
    ),
    Planted(f"{LOOP}._apply", "self._trial.moving.add(command.device)", "pass"),
    Planted(f"{LOOP}._attend", "self._stop_all()", "pass"),
    Planted(f"{LOOP}._attend", "raise Aborted", "return"),
    Planted(f"{LOOP}._subscribe", "self._guard.arrivals.expect(asked | streams, now_s)", "pass", '"silent"'),
    Planted(f"{LOOP}._arrange", "self._trial.detectors[name].reset()", "pass", '"pause"'),
    Planted(
        f"{LOOP}._arrange",
        "wanted |= self._guard.inputs",
        "pass",
        '"board", kind = "silent", after = "PLACING"',
    ),
    Planted(f"{LOOP}._wait", "return late_s", "return 0.0", HANGS),
    Planted(f"{LOOP}._note", "self._trial.moving.discard(status.device)", "pass"),
    Planted(f"{LOOP}._record_event", "self.visits.append((after, event.t_s))", "pass"),
    Planted(f"{LOOP}._obey", "self._arrange(commands)", "pass"),
    Planted(f"{LOOP}._look", "if decided is not None:", "if False:"),
    Planted(f"{LOOP}._look", "self._record_blocks(gathered)", "pass"),
    Planted(f"{GUARD}.check", "if moving and late_s > settings.late_s", "if False", HANGS),
    Planted(
        f"{GUARD}.check",
        "reasons += [] if reason is None or braking else [reason]",
        "pass",
        'force_n.*"overrun"',
    ),
    Planted(
        f"{GUARD}.admit", "if self._stopped_s is not None and not", "if False and not", f"Reckless.*{HANGS}"
    ),
    Planted(
        f"{GUARD}._takes_load_away",
        "return self._goes_back(command) and not",
        "return True or not",
        f"Reckless.*{HANGS}",
    ),
    Planted(f"{GUARD}.reset", "self._stopped_s: float | None = None", "self._stopped_s = 0.0"),
    Planted(
        f"{BOUNDS}.position",
        "self.limits.travel_min_m, self.limits.travel_m",
        "-9.0, 9.0",
        'follow_m.*"overrun"[^}]*amount = 0.02',
    ),
    Planted(f"{ARRIVALS}._silent", "> limit_s:", "> 1e9:", '"silent"'),
    Planted(
        f"{ARRIVALS}._limit_s",
        "if self._moves_since_s is not None and stream in self._urgent:",
        "if False:",
        '"board", kind = "silent", after = "APPROACH"',
    ),
    Planted(f"{ARRIVALS}.expect", "self._seen_s.get(stream, t_s)", "t_s", '"silent"'),
    Planted(f"{ARRIVALS}.check", "min(self._last_s(block), t_s)", "block.last_s + 10.0", '"silent"'),
    Planted(
        "controller.campaign:_measured",
        "return ended or measured, reason",
        "return measured, reason",
        "Reckless",
    ),
    Planted(f"{CAMPAIGN}._trials", 'if outcome != "aborted":', "if False:"),
    Planted(f"{CAMPAIGN}._count", "counts[outcome] = counts.get(outcome, 0) + 1", "pass"),
    Planted(f"{CAMPAIGN}._trial", 'verdict = "aborted"', 'verdict = ""'),
    Planted(f"{RECORDER}.end_trial", "self._disk.post(self._rows, self._rows.add, line)", "len(line)"),
    Planted(f"{LINES}.commit", 'lines, self._lines = self._lines, ""', "lines = self._lines"),
    Planted("controller.recording.joining:broken_off", "if outcome not in UNMEASURED", "if outcome"),
    Planted("controller.recording.joining:clear", "if len(whole) < len(rows):", "if False:"),
    Planted(
        "controller.measures.trial:_holes",
        "> longest_s:",
        "> 1e9:",
        '"board", kind = "(lose|corrupt|silent)"[^}]*for_s',
    ),
    Planted(
        "behaviors.machine:Behavior.conclude_fault", "verdict_of(self.event)", '("contact", "")', '"refuse"'
    ),
)
"""In loop, guard, limits, campaign, recorder and behaviors."""


def _owner(defect: Planted) -> tuple[Any, str]:
    """What has the function, and its name there."""
    module_name, _, path = defect.where.partition(":")
    owner: Any = import_module(module_name)
    *outer, name = path.split(".")
    for each in outer:
        owner = getattr(owner, each)
    return owner, name


def source_of(defect: Planted) -> str:
    """Source of the function that it changes."""
    owner, name = _owner(defect)
    return textwrap.dedent(inspect.getsource(getattr(owner, name)))


def plant(defect: Planted) -> None:
    """Change the program in this process."""
    owner, name = _owner(defect)
    module, source = import_module(defect.where.partition(":")[0]), source_of(defect)
    assert defect.old in source, f"{defect.where} no longer has {defect.old!r}"
    scope: dict[str, Any] = {}
    code = compile(source.replace(defect.old, defect.new, 1), module.__file__ or "", "exec")
    exec(code, module.__dict__, scope)
    setattr(owner, name, scope[name])
    for other in list(sys.modules.values()):  # a function is imported by its name
        if owner is module and getattr(other, name, None) is not None and other is not module:
            setattr(other, name, scope[name])
    _machine.cache_clear()  # behaviors that were made have the methods from before


def found(seeds: int, seconds: float, likely: str = "") -> dict[str, Any]:
    """How many seeds it took until something did not hold, how many of them were played, and what."""
    until_s, hunt = time.process_time() + seconds, Hunt()
    for number, seed in enumerate(range(10_000, 10_000 + seeds), start=1):
        plan = drawn(seed, QUICK)
        if not re.search(likely, plan.toml(), re.DOTALL):
            continue
        violations = examined(plan, deep_of(plan), hunt)
        hunt.seeds += 1
        about = {"seeds": number, "played": hunt.seeds}
        if violations:
            first = violations[0]
            return {**about, "end": first.end, "checker": first.checker, "what": first.what[:100]}
        if time.process_time() > until_s:
            return {**about, "end": ""}
    return {"seeds": seeds, "played": hunt.seeds, "end": ""}


def main() -> None:
    """Plant each in a process of its own, forked from one that has loaded everything."""
    parser = argparse.ArgumentParser()
    parser.add_argument("--seeds", type=int, default=1000)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("numbers", type=int, nargs="*")
    given = parser.parse_args()
    print(json.dumps({"unchanged": found(8, given.seconds)}), flush=True)  # and everything is loaded
    for number in given.numbers or range(len(DEFECTS)):
        child = os.fork()
        if child == 0:
            try:
                plant(DEFECTS[number])
                line: dict[str, Any] = found(given.seeds, given.seconds, DEFECTS[number].likely)
            except BaseException as error:
                line = {"error": repr(error)}
            print(
                json.dumps(
                    {"number": number, "where": DEFECTS[number].where, "new": DEFECTS[number].new, **line}
                ),
                flush=True,
            )
            os._exit(0)
        os.waitpid(child, 0)


if __name__ == "__main__":
    main()
