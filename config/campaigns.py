"""What the command line and a script do alike with a campaign: see before that it can run, say whose the bench is, open
devices anew where one failed, go on with what is left."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from config.assemble import plan_campaign
from config.merging import profile_of
from config.profile import Profile
from config.rehearsal import refusals
from config.source import ProfileError
from config.trials import Trial, of_each_value
from controller.campaign import EXIT_DEVICE, Campaign, CampaignPlan, Outcome
from controller.console import Console, ConsoleOperator
from controller.holding import Holding, addresses
from controller.own_modules import is_own
from controller.recording.joining import ResumedRun, broken_off
from controller.recording.run_folder import RunFolder
from controller.rig import Rig
from drivers.core.clock import rest

if TYPE_CHECKING:
    from controller.watching.foxglove import FoxgloveStream  # a library that not everybody has

RECONNECT_S = 5.0
"""How long a real bench is left alone before its devices are opened anew. Assumption: a USB port is there again."""

Once = Callable[[CampaignPlan, ResumedRun | None], tuple[Outcome, bool, ConsoleOperator]]
"""Runs a campaign with its devices opened once: how it ended, whether they were opened in this process, and what the
person has pressed."""


def rehearse(loaded: Profile, plan: CampaignPlan, trials: Sequence[Trial]) -> None:
    """See that guard and movers permit what the trials command, before anything is opened. A simulated scene is refused
    before anything moves in any case. A behavior of the user's own may command by what it remembers: a rehearsal could
    refuse what runs.

    Raises:
        ProfileError: they do not.
    """
    if is_own(loaded.experiment):
        return
    few = plan_campaign(loaded, of_each_value(trials), plan.seed, devices=plan.devices).trials
    if problems := list(refusals(loaded, few, lambda scene: None)):
        raise ProfileError(problems)


def on_bench(
    loaded: Profile,
    plan: CampaignPlan,
    rig: Rig,
    console: Console,
    out: Path,
    resumed: ResumedRun | None,
    mirror: FoxgloveStream | None = None,
) -> Outcome:
    """Run a campaign in this process, as the one program that has these devices: `stop` finds it.

    Raises:
        DeviceError: another program has one of a real bench's devices.
        RecordingError, RunFolderError: as of `Campaign.run`.
    """
    with Holding(loaded.name, "run", addresses(rig), loaded.bench == "hardware") as note:
        outcome = Campaign(plan, rig, console, out, resumed, mirror).run()
        note.tell(not_at_rest=outcome.not_at_rest)
    return outcome


def what_is_left(folder: RunFolder) -> tuple[Profile, CampaignPlan, ResumedRun]:
    """Of a run that broke off: its profile, the trials that are left, and what is done.

    Raises:
        RunFolderError: it cannot go on: what differs, and what to do.
    """
    resumed = broken_off(folder)
    loaded, trials = profile_of(resumed.manifest, folder.path.name)
    seed, asked = int(resumed.manifest["seed"]), resumed.manifest["profile"].get("asked")
    return loaded, plan_campaign(loaded, trials, seed, done=resumed.done, asked=asked), resumed


def reconnected(
    once: Once, loaded: Profile, plan: CampaignPlan, resumed: ResumedRun | None, say: Callable[[str], None]
) -> tuple[Outcome, ConsoleOperator]:
    """Run a campaign; where a device failed, all stands still and the profile permits one more (`trials.reconnects`),
    go on with devices opened anew, as a run that is resumed.

    Returns:
        How it ended, and what the person has pressed.
    """
    outcome, again, operator = once(plan, resumed)
    permitted = loaded.trial_settings.reconnects
    for number in range(1, permitted + 1):
        if outcome.exit_code != EXIT_DEVICE or operator.halted or not again:
            break
        if outcome.not_at_rest:
            say("it is not reconnected: something may still move")
            break
        say(f"{outcome.line}; reconnected, {number} of {permitted}")
        rest(0.0 if loaded.bench == "mock" else RECONNECT_S)
        _, plan, resumed = what_is_left(RunFolder(outcome.folder))
        outcome, _, operator = once(plan, resumed)
    return outcome, operator
