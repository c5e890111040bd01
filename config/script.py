"""The program's own call for scripts: the same campaign as `run.py run`, trials from Python."""

from collections.abc import Callable, Iterable, Mapping
from contextlib import closing
from pathlib import Path
from typing import Any

from config.assemble import build_rig, plan_campaign
from config.profile import load_profile
from controller.campaign import Campaign, Outcome
from controller.console import ConsoleOperator, PlainConsole
from controller.recording.reader import Run, open_run


def run_trials(
    profile: str | Path,
    trials: Iterable[Mapping[str, Any]],
    *,
    settings: Mapping[str, str] | None = None,
    seed: int = 0,
    out: Path = Path("runs"),
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
        ProfileError: the profile or a trial cannot be used.
        KeyboardInterrupt: somebody ended it; what was measured is in its folder. A script of many runs ends with it.
    """
    rows = [dict(row) for row in trials]
    once = {**(settings or {}), "trials.order": "listed", "trials.repeats": "1"}
    labels = [f"run_trials: trial {number}" for number in range(1, len(rows) + 1)]
    loaded = load_profile(profile, once, rows=rows, labels=labels)
    plan = plan_campaign(loaded, loaded.trials(seed), seed)
    with (
        closing(build_rig(loaded, devices=plan.devices)) as rig,
        ConsoleOperator(asking=rig.asking) as operator,
    ):
        outcome = Campaign(plan, rig, PlainConsole(operator, say), out).run()
    if operator.stopped:
        raise KeyboardInterrupt
    return outcome, open_run(outcome.folder)
