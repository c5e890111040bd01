"""The program's own call for scripts: the same campaign as `run.py run`, trials from Python."""

import json
from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from operator import index
from pathlib import Path
from typing import Any

from config.assemble import build_rig, plan_campaign
from config.campaigns import on_bench, reconnected, rehearse
from config.profile import load_profile
from config.source import ProfileError
from controller.campaign import CampaignPlan, Outcome
from controller.console import ConsoleOperator, PlainConsole
from controller.recording.joining import ResumedRun
from controller.recording.reader import Run, open_run


def run_trials(
    profile: str | Path,
    trials: Iterable[Mapping[str, Any]],
    *,
    settings: Mapping[str, str] | None = None,
    seed: int = 0,
    out: str | Path = "runs",
    say: Callable[[str], None] = print,
) -> tuple[Outcome, Run]:
    """Run trials on a profile's bench, in the order given.

    Args:
        profile: A name as `run.py list` shows it, or the path of a TOML file.
        trials: One mapping of factors each: the experiment's own (`speed_m_s`), or a dotted setting.
        settings: Other values for settings, as after `--set`: `{"behavior.settle_s": "5.0"}`.
        say: Takes a line a trial.

    Returns:
        How it ended, and the run as it can be read from its folder.

    Raises:
        ProfileError: profile, trial or seed cannot be used, or guard or movers do not permit what it commands.
        DeviceError: another program has one of a real bench's devices.
        KeyboardInterrupt: somebody ended it; what was measured is in its folder. A script of many runs ends with it.
    """
    seed, out = index(seed), Path(out)
    if not 0 <= seed < 2**63:
        raise ProfileError(f"run_trials: seed = {seed}: a whole number from 0 to 2**63 - 1")
    # numbers of NumPy are numbers as any other
    given = json.loads(json.dumps([dict(row) for row in trials], default=_plain))
    rows = {f"run_trials: trial {number}": row for number, row in enumerate(given, start=1)}
    once = {**(settings or {}), "trials.order": "listed", "trials.repeats": "1"}
    loaded = load_profile(profile, once, rows=rows)
    asked = {"profile": str(profile), "set": once, "scripted": True}
    planned = plan_campaign(loaded, loaded.trials(seed), seed, asked=asked)
    rehearse(loaded, planned, loaded.trials(seed))

    def opened_once(plan: CampaignPlan, resumed: ResumedRun | None) -> tuple[Outcome, bool, ConsoleOperator]:
        with (
            closing(build_rig(loaded, devices=plan.devices)) as rig,
            ConsoleOperator(asking=rig.asking) as operator,
        ):
            outcome = on_bench(loaded, plan, rig, PlainConsole(operator, say), out, resumed)
        return outcome, True, operator

    outcome, operator = reconnected(opened_once, loaded, planned, None, say)
    if operator.stopped:
        raise KeyboardInterrupt
    return outcome, open_run(outcome.folder)


def _plain(value: Any) -> Any:
    return value.tolist() if hasattr(value, "tolist") else str(value)
