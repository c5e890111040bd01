"""Verbs on a profile: `check`, `plan`, `emulate`."""

from __future__ import annotations

import json
import signal
import sys
from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import closing
from dataclasses import replace
from itertools import chain
from pathlib import Path

import click

from config import verbs
from config.assemble import build_rig, own_kinds, plan_campaign, scene_check, scene_of, start_emulator
from config.costs import counted, planned
from config.jobs import jobs_for
from config.parts import parts_of
from config.profile import Profile
from config.rehearsal import refusals
from config.source import ProfileError, to_toml
from config.trials import Trial, chosen, distinct
from controller.campaign import TrialPlan
from controller.contracts import tried
from controller.doctor import compare, examine, summary
from controller.holding import Holding, addresses
from controller.rig import Rig
from drivers.core.clock import rest


@click.command(cls=verbs.Verb)
@verbs.trials_options
@click.option("--connect", is_flag=True, help="Open every device and read each sensor; nothing moves.")
@click.option("--ports", "ask", is_flag=True, help="Likewise, and ask who is at ports it does not use.")
@click.option("--verbose", is_flag=True, help="With --connect, print every setting as well.")
def check(
    profile: str,
    overrides: Mapping[str, str],
    csv: Path | None,
    numbers: Sequence[int],
    connect: bool,
    ask: bool,
    verbose: bool,
) -> int:
    """Validate a PROFILE and print every setting with the file that gave it.

    PROFILE is a name that `run.py list` shows, or the path of a TOML file. What is printed is a profile too. With
    --connect the bench is tried instead, which is the thing to do before a first run: only its ports need to be set.

    \b
    Example:
      run.py check mock/transient
      run.py check hardware/transient --connect
    """
    connect |= ask
    if parts := parts_of(profile):
        flags = [*["--connect"] * connect, *["--ports"] * ask, *["--verbose"] * verbose]
        return verbs.for_each_part(check, parts, [*verbs.sets(overrides), *flags])
    loaded = verbs.loaded_profile(profile, overrides, csv)
    origins, asked = loaded.source.origins, chosen(loaded.trials(0), numbers)
    click.echo(f"# {loaded.name}: {loaded.experiment} on the {loaded.bench} bench, {counted(len(asked))}")
    if note := verbs.real_time(loaded):
        click.echo(f"# {note}")
    click.echo(f"# sha256 {loaded.hash}\n")
    if verbose or not connect:
        click.echo(to_toml(loaded.shown, lambda path: origins.get(path, "default")), nl=connect)
    planned = distinct(asked)
    # to try the bench its ports are enough: nothing moves
    excused = frozenset(path for path in loaded.source.unset if path[-1] != "port")
    trying = replace(loaded, excused=excused) if connect else loaded
    campaign = plan_campaign(trying, planned, 0)
    named = [
        (where, stream)
        for where, stream in dict.fromkeys(
            ref for trial in planned for ref in loaded.for_trial(trial).unverified
        )
        if stream.partition(".")[0] in campaign.devices
    ]
    code, said = verbs.DONE, ""
    if connect or loaded.bench == "mock":
        with (
            closing(build_rig(trying, devices=campaign.devices)) as rig,
            # a device that another program has would be stopped by being opened
            Holding(loaded.name, "check", addresses(rig), loaded.bench == "hardware"),
        ):
            code, said = _tried(loaded, rig, campaign.trials, named, connect, ask)
    elif named:
        names = ", ".join(sorted({name for _, name in named}))
        click.echo(f"# not verified without --connect, as the device tells its streams then: {names}")
    refused = _refused(loaded, planned, campaign.devices)
    if refused:
        code = verbs.USAGE
        verbs.complain(verbs.explained(refused)[1])
    elif code == verbs.DONE and not connect:
        click.echo("# nothing is missing")
    if connect:
        click.echo(said + (f", {len(refused.problems)} more to be set before a run" if refused else ""))
    return code


def _refused(loaded: Profile, planned: Sequence[Trial], devices: Collection[str]) -> ProfileError | None:
    """Values that a run would miss; where it has all, what plant, guard and movers would refuse of it."""
    try:
        trials = plan_campaign(loaded, planned, 0).trials
        problems = list(refusals(loaded, trials, scene_check(loaded, devices)))
    except ProfileError as error:
        return error
    return ProfileError(problems) if problems else None


def _tried(
    loaded: Profile,
    rig: Rig,
    trials: Iterable[TrialPlan],
    named: Sequence[tuple[str, str]],
    connect: bool,
    ask: bool,
) -> tuple[int, str]:
    """Look at a bench and at classes of the user's own, a line for each thing found; exit code and summary."""
    scene = scene_of(loaded)
    entries = {name: loaded.devices[name] for name in rig.devices}
    ports = {name: entry.port for name, entry in entries.items()}
    watchdogs = {
        name: getattr(entry.settings, key)
        for name, entry in entries.items()
        for key in entry.settings.keys_of("silences")
    }
    looked = compare(rig, trials, named)
    if connect:
        looked = examine(rig, scene, trials, named, ports, watchdogs, ask)
    own = own_kinds(loaded, rig.devices)
    code, findings = verbs.DONE, []
    for finding in chain(looked, tried(rig, scene, **own) if own else ()):
        findings.append(finding)
        if finding.of_profile:
            verbs.complain(finding.line)
            code = code or verbs.USAGE
        else:
            click.echo(f"{finding.verdict:4}  {finding.line}")
            code = code if finding.verdict != "fail" else verbs.DEVICE
    return code, summary(findings)


@click.command(cls=verbs.Verb)
@verbs.trials_options
def plan(profile: str, overrides: Mapping[str, str], csv: Path | None, numbers: Sequence[int]) -> int:
    """Show what running a PROFILE would take: time, disk, travel, force, and what each state computes.

    Nothing is opened or computed. Times and sizes are those that were measured with the experiment's shipped profile.

    \b
    Example:
      run.py plan mock/centering
      run.py plan hardware/transient --set trials.repeats=1
    """
    if parts := parts_of(profile):
        return verbs.for_each_part(plan, parts, verbs.sets(overrides))
    loaded = verbs.loaded_profile(profile, overrides, csv)
    trials = chosen(loaded.trials(0), numbers)
    varied = plan_campaign(loaded, distinct(trials), 0)
    click.echo("\n".join(planned(loaded, trials, varied, jobs_for(loaded, len(trials), None))))
    return verbs.DONE


@click.command(cls=verbs.Verb)
@click.argument("profile")
@verbs.set_option
@verbs.realtime_option
def emulate(profile: str, overrides: Mapping[str, str], realtime: bool) -> None:
    """Start the emulated devices of a PROFILE and print their addresses in one JSON line.

    They serve until Ctrl+C: real bytes on pseudo-terminals, for this program or any other.

    \b
    Example:
      run.py emulate emulated/transient > bench.json
      run.py run emulated/transient --endpoints bench.json     (in another terminal)
    """
    ended: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: ended.append(number))
    loaded = verbs.loaded_profile(profile, overrides)
    devices = plan_campaign(loaded, loaded.trials(0), 0).devices
    with closing(start_emulator(loaded, realtime, devices)) as emulator:
        click.echo(json.dumps(emulator.endpoints))
        sys.stdout.flush()
        while not ended:  # looked at: a signal that another thread takes would not end a wait
            rest(0.1)
