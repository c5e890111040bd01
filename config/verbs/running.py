"""Verbs that run trials: `run`, `resume`, `merge`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from config import verbs
from config.assemble import build_rig, plan_campaign
from config.campaigns import on_bench, reconnected, rehearse, what_is_left
from config.costs import duration
from config.faults import fault_of
from config.jobs import Crew, crew_of, in_batches, jobs_for
from config.merging import merged
from config.parts import begin, carry_on, parts_of
from config.profile import Profile
from config.source import toml_value
from config.trials import chosen
from controller.campaign import CampaignPlan, Outcome
from controller.console import Console, ConsoleOperator, PlainConsole
from controller.recording.joining import ResumedRun
from controller.recording.run_folder import RunFolder
from drivers.core.errors import PROGRAM, lacking

if TYPE_CHECKING:
    from controller.watching.foxglove import FoxgloveStream
    from controller.watching.page import PageProcess


@click.command(cls=verbs.Verb)
@verbs.trials_options
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Of order and noise."
)
@verbs.many(
    "--fault",
    "faults",
    metavar="WORDS",
    help='What goes wrong on a simulated bench, as "board freeze 80 ms in APPROACH"; repeatable.',
)
@verbs.out_option
@verbs.report_option
@verbs.endpoints_option
@verbs.realtime_option
@verbs.jobs_options
@verbs.watch_option
@click.option("--foxglove", is_flag=True, help="Stream what is recorded to Foxglove as well, read-only.")
@click.option(
    "--shard",
    type=verbs.shard,
    metavar="I/N",
    help="Every N-th trial from the I-th on alone; `merge` joins all N.",
)
def run(
    profile: str,
    overrides: Mapping[str, str],
    seed: int,
    csv: Path | None,
    numbers: Sequence[int],
    faults: Sequence[str],
    out: Path,
    shard: tuple[int, int] | None,
    **how: Any,
) -> int:
    """Run the experiment of a PROFILE and write a run folder with its report.

    On a terminal Ctrl+C pauses: everything stops and is still watched, Enter goes on, and a second Ctrl+C ends the
    run. Whatever ends it, what was measured is on the disk and in the report.

    \b
    Example:
      run.py run mock/transient
      run.py run mock/transient --only 1 --set plant.noise_scale=0.5
      run.py run hardware/transient --trials my_trials.csv
      run.py run mock/centering --jobs 4

    Exit codes: 0 done, 1 the experiment failed, 2 usage or profile, 3 device, 4 the guard stopped or refused it, 130
    interrupted.
    """
    if parts := parts_of(profile):
        single = csv or numbers or shard or faults
        if single or any(how[name] for name in ("endpoints", "realtime", "watched", "foxglove")):
            raise click.UsageError(
                f"{profile} has parts; run one of them with this option: see {PROGRAM} list"
            )
        folder = begin(profile, parts, ["--seed", str(seed), *verbs.sets(overrides)], out)
        return _in_turn(folder, how["jobs"], how["scheduler"], how["reported"])
    if faults:
        overrides = _with_faults(profile, overrides, faults)
    loaded = verbs.loaded_profile(profile, overrides, csv)
    if how["realtime"] and (loaded.bench != "emulated" or how["endpoints"]):
        joined = "an emulator that runs has its own time" if how["endpoints"] else ""
        raise click.BadParameter(joined or f"{loaded.name} is not emulated", param_hint="--realtime")
    asked = {
        "profile": profile,
        "set": dict(overrides),
        "trials": str(csv.resolve()) if csv else None,
        "only": list(numbers),
        **({"shard": list(shard)} if shard else {}),
    }
    picked = chosen(loaded.trials(seed), numbers)
    own = chosen(picked, (), shard)
    if shard and not own:
        raise click.BadParameter(
            f"{shard[0]}/{shard[1]} holds none of the {len(picked)} trials; shards 1 to {len(picked)} hold them all",
            param_hint="--shard",
        )
    others = {trial.id for trial in picked} - {trial.id for trial in own}
    plan = plan_campaign(loaded, picked, seed, done=others, asked=asked)
    rehearse(loaded, plan, own)
    return _carried_out(loaded, plan, out, **how)


def _with_faults(profile: str, overrides: Mapping[str, str], words: Sequence[str]) -> dict[str, str]:
    """The settings of the command line with these faults beside those that the profile has."""
    try:
        more = [fault_of(each) for each in words]
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--fault") from None
    had = [fault.model_dump(exclude_none=True) for fault in verbs.loaded_profile(profile, overrides).faults]
    return {**overrides, "faults": toml_value([*had, *more])}


@click.command(cls=verbs.Verb)
@click.argument("run", metavar="RUN")
@verbs.out_option
@verbs.report_option
@verbs.endpoints_option
@verbs.jobs_options
@verbs.watch_option
def resume(run: str, out: Path, **how: Any) -> int:
    """Go on with a RUN where it stopped, in its own folder.

    Trials that are done stay. One that was torn, or that ended the run by a fault, the guard or the operator, is run
    again from its beginning. It is refused where profile, devices or program are not those that the run began with.

    \b
    Example:
      run.py resume latest
      run.py resume runs/2026-11-20T12-00-00Z_mock-transient_ab12

    Exit codes: as of `run`.
    """
    found = RunFolder.find(run, out)
    if "parts" in found.read_manifest():
        if how["watched"]:
            raise click.UsageError(f"{run} has parts: watch each with {PROGRAM} watch")
        return _in_turn(found, how["jobs"], how["scheduler"], how["reported"])
    loaded, plan, resumed = what_is_left(found)
    if resumed.unrecorded:
        numbers = ", ".join(map(str, resumed.unrecorded))
        verbs.say(f"not all samples were written of trials {numbers}: these are run again")
    if plan.count == 0:
        said = f"all {len(resumed.done)} trials are done; `{PROGRAM} report {run}` shows them"
        verbs.say(f"{resumed.folder.path.name}: {said}")
        return verbs.DONE
    return _carried_out(loaded, plan, out, resumed, **how)


@click.command(cls=verbs.Verb)
@click.argument("shards", nargs=-1, required=True, metavar="RUN...")
@verbs.out_option
def merge(shards: Sequence[str], out: Path) -> None:
    """Join runs that were made with --shard into the run folder that one run would have written.

    It is refused where profile, seed or program differ, and where a trial is missing or there twice. Where a trial
    ended its shard, also when that was resumed, the joined run ends there, as one run would.

    \b
    Example:
      run.py merge shard_1/* shard_2/* shard_3/*
    """
    verbs.say(f"{merged(shards, out).path}")


def _carried_out(
    loaded: Profile,
    plan: CampaignPlan,
    out: Path,
    resumed: ResumedRun | None = None,
    *,
    reported: bool,
    **how: Any,
) -> int:
    """Run a campaign and report it; returns the exit code."""

    def once(plan: CampaignPlan, resumed: ResumedRun | None) -> tuple[Outcome, bool, ConsoleOperator]:
        return _once(loaded, plan, out, resumed, **how)

    outcome, operator = reconnected(once, loaded, plan, resumed, verbs.complain)
    if outcome.error is None:
        (verbs.complain if outcome.exit_code else verbs.say)(outcome.line)
    try:
        if reported and RunFolder(outcome.folder).begun:
            verbs.report_on([RunFolder(outcome.folder)])
    except Exception as error:
        if not outcome.exit_code:
            raise
        verbs.complain(f"no report: {verbs.explained(error)[1]}")
    if outcome.error is not None:
        raise outcome.error
    return outcome.exit_code or (verbs.INTERRUPTED if operator.stopped else verbs.DONE)  # it came at the end


def _once(
    loaded: Profile,
    plan: CampaignPlan,
    out: Path,
    resumed: ResumedRun | None,
    *,
    endpoints: Mapping[str, Any] | None,
    jobs: int | None,
    scheduler: str | None,
    watched: bool,
    realtime: bool = False,
    foxglove: bool = False,
) -> tuple[Outcome, bool, ConsoleOperator]:
    """See `config.campaigns.Once`."""
    if realtime_note := verbs.real_time(loaded):
        verbs.say(realtime_note)
    with ExitStack() as stack:
        mirror = stack.enter_context(closing(_foxglove())) if foxglove else None
        crew = stack.enter_context(_crew(loaded, plan, 1 if foxglove else jobs, scheduler))
        workers = crew.count if crew else 1
        time = f"time: {duration(loaded.name, loaded.experiment, loaded.bench, plan.count, workers)}"
        page = stack.enter_context(closing(_page())) if watched else None
        rig = (
            None
            if crew
            else stack.enter_context(closing(build_rig(loaded, endpoints, realtime, plan.devices)))
        )
        operator = stack.enter_context(ConsoleOperator(asking=rig.asking if rig else ()))
        console = _console(operator, page, time, plan.manifest["successes"])
        if rig is None:
            assert crew is not None
            outcome = in_batches(crew, loaded, plan, console, out, resumed).run()
        else:
            outcome = on_bench(loaded, plan, rig, console, out, resumed, mirror)
    return outcome, rig is not None, operator


def _in_turn(folder: RunFolder, jobs: int | None, scheduler: str | None, reported: bool) -> int:
    """Run the parts of a campaign that are left, and report all; returns the exit code."""
    workers = [*(["--jobs", str(jobs)] if jobs else []), *(["--scheduler", scheduler] if scheduler else [])]
    with closing(crew_of(jobs, scheduler)) as crew:
        code = carry_on(folder, run, resume, workers, crew, verbs.say)
    if reported and folder.runs:
        verbs.report_on([folder])
    return code


def _crew(
    loaded: Profile, plan: CampaignPlan, jobs: int | None, scheduler: str | None
) -> AbstractContextManager[Crew | None]:
    """The workers that run the trials; None is this process."""
    count = jobs_for(loaded, plan.count, 2 if scheduler else jobs)
    if count == 1 and not scheduler:
        return nullcontext()
    kept = click.get_current_context().find_object(Crew)  # of a campaign of parts
    return nullcontext(kept) if kept else closing(crew_of(count, scheduler))


def _console(
    operator: ConsoleOperator, page: PageProcess | None, time: str, successes: Sequence[str] | None
) -> Console:
    """The person's side: the terminal, or a live page beside it; `time` is the expected duration, as text."""
    from controller.watching.feed import Watched

    if (screen := verbs.terminal()) is None:
        console: Console = PlainConsole(operator, verbs.say_at_once, time, successes)
    else:
        from controller.live import LiveConsole

        screen.print(time, highlight=False)
        console = LiveConsole(operator, screen, successes)
    Watched(console, operator, None if page is None else page.began)
    return console


def _page() -> PageProcess:
    """Begin to serve the live page; it is there once the run is."""
    from controller.watching.page import Door, PageProcess

    door = Door.open()
    link = door.link
    verbs.say(f"watch it: {link}")
    page = PageProcess(door)
    verbs.browse(link)
    return page


def _foxglove() -> FoxgloveStream:
    """Begin to stream to Foxglove."""
    try:
        from controller.watching.foxglove import FoxgloveStream

        stream = FoxgloveStream()
    except ImportError:
        raise click.UsageError(f"--foxglove: {'; '.join(lacking('foxglove-sdk', 'foxglove'))}") from None
    except RuntimeError as error:
        raise click.UsageError(f"--foxglove: {error}") from None
    verbs.say(f"Foxglove: {stream.address}")
    return stream
