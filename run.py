"""The command line of touchbench: arguments → profile → rig → run → exit code."""

from __future__ import annotations

import json
import os
import sys
import tomllib
from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, closing, nullcontext
from importlib import metadata
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import TYPE_CHECKING, Any

import click

from config.verbs import (
    DEVICE,
    DONE,
    PLOT_HELP,
    USAGE,
    Program,
    Verb,
    all_spans,
    complain,
    endpoints_option,
    explained,
    jobs_options,
    out_option,
    realtime_option,
    recording_options,
    report_option,
    say,
    say_at_once,
    set_option,
    shard,
    span,
    watch_option,
)

if TYPE_CHECKING:
    from config.jobs import Crew
    from config.profile import Profile
    from controller.campaign import CampaignPlan, Console
    from controller.console import ConsoleOperator
    from controller.recording.mcap_file import Mirror
    from controller.recording.resuming import ResumedRun
    from controller.recording.run_folder import RunFolder
    from controller.watching.foxglove import FoxgloveStream
    from controller.watching.page import PageProcess


def _say_version(ctx: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    """Of the folder that this file is in, or of the package as it is installed."""
    if not wanted:
        return
    project = Path(__file__).with_name("pyproject.toml")
    if project.is_file():
        version = tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"]
    else:
        version = metadata.version("touchbench")
    click.echo(f"touchbench {version}")
    ctx.exit()


@click.group(cls=Program, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_say_version,
    help="Say which version this is.",
)
def cli() -> None:
    """Run touch experiments on a robot bench: simulated, emulated on the wire, or real.

    A profile says which bench, which experiment and which trials. To begin with:

    \b
      run.py list                    what there is
      run.py run mock/transient      42 approaches to a simulated finger, in seconds
      run.py VERB --help             more about a verb
    """


@cli.command("list", cls=Verb, short_help="Show profiles, detectors, signals or drivers.")
@click.option("--detectors", "shown", flag_value="detectors", help="List kinds of detectors instead.")
@click.option("--signals", "shown", flag_value="signals", help="List kinds of signals instead.")
@click.option("--drivers", "shown", flag_value="drivers", help="List drivers instead.")
def list_(shown: str | None) -> None:
    """Show the profiles, with the bench and the devices that each needs.

    \b
    Example:
      run.py list
      run.py list --detectors
    """
    from config.listing import listed_detectors, listed_drivers, listed_profiles, listed_signals

    listed = {
        "detectors": listed_detectors,
        "signals": listed_signals,
        "drivers": listed_drivers,
        None: listed_profiles,
    }
    lines = listed[shown]()
    click.echo("\n".join(lines))


@cli.command(cls=Verb, short_help="Validate a profile, print its settings, try its bench.")
@click.argument("profile")
@set_option
@click.option("--trials", "csv", type=click.Path(path_type=Path), help="Trials from a CSV file instead.")
@click.option("--connect", is_flag=True, help="Open every device and read each sensor; nothing moves.")
def check(profile: str, overrides: Mapping[str, str], csv: Path | None, connect: bool) -> int:
    """Validate a PROFILE and print every setting with the file that gave it.

    PROFILE is a name that `run.py list` shows, or the path of a TOML file. What is printed is a profile too. With
    --connect the bench is tried as well, which is the thing to do before a first run.

    \b
    Example:
      run.py check mock/transient
      run.py check hardware/transient --connect
    """
    from config.parts import parts_of

    if parts := parts_of(profile):
        common = [*_sets(overrides), *(["--connect"] if connect else [])]
        return max(int(check.main([*part, *common], standalone_mode=False)) for part in parts.runs)
    from config.assemble import plan_campaign
    from config.toml_text import to_toml
    from config.trials import distinct

    loaded = _loaded(profile, overrides, csv)
    origins = loaded.source.origins
    click.echo(
        f"# {loaded.name}: {loaded.experiment} on the {loaded.bench} bench, {len(loaded.trials(0))} trials"
    )
    click.echo(f"# sha256 {loaded.hash}\n")
    click.echo(to_toml(loaded.resolved, lambda path: origins.get(path, "default")), nl=False)
    trials = plan_campaign(loaded, distinct(loaded.trials(0)), 0).trials
    if not connect and loaded.bench != "mock":  # what a bench on the wire sends, it says when it is connected
        return DONE
    from config.assemble import build_rig
    from controller.doctor import compare, examine
    from controller.rig import TrialScene

    sound = True
    with closing(build_rig(loaded)) as rig:
        if not connect:
            for finding in compare(rig, trials):
                complain(finding.line)
                sound = False
            return DONE if sound else USAGE
        click.echo()
        plant = loaded.plant.settings.model_dump(mode="json") if loaded.plant else {}
        for finding in examine(rig, TrialScene(0, 0, {}, plant), trials):
            click.echo(finding.line)
            sound &= finding.sound
    return DONE if sound else DEVICE


@cli.command(cls=Verb, short_help="Say what a run would take, move and compute.")
@click.argument("profile")
@set_option
@click.option("--trials", "csv", type=click.Path(path_type=Path), help="Trials from a CSV file instead.")
def plan(profile: str, overrides: Mapping[str, str], csv: Path | None) -> None:
    """Say what running a PROFILE would take: time, disk, travel, force, and what each state computes.

    Nothing is opened or computed. Times and sizes are those that were measured with the experiment's shipped profile.

    \b
    Example:
      run.py plan mock/centering
      run.py plan hardware/transient --set trials.repeats=1
    """
    from config.parts import parts_of

    if parts := parts_of(profile):
        for part in parts.runs:
            plan.main([*part, *_sets(overrides)], standalone_mode=False)
        return
    from config.assemble import plan_campaign
    from config.costs import planned
    from config.jobs import jobs_for

    loaded = _loaded(profile, overrides, csv)
    trials = loaded.trials(0)
    whole = plan_campaign(loaded, trials, 0)
    click.echo("\n".join(planned(loaded, trials, next(iter(whole.trials)), jobs_for(loaded, whole, None))))


@cli.command(cls=Verb, short_help="Run an experiment, write a run folder and its report.")
@click.argument("profile")
@set_option
@click.option(
    "--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True, help="Of order and noise."
)
@click.option(
    "--trials", "csv", type=click.Path(path_type=Path), help="Trials from a CSV file: a factor a column."
)
@click.option(
    "--only", "numbers", type=int, multiple=True, metavar="TRIAL", help="This trial alone; repeatable."
)
@out_option
@report_option
@endpoints_option
@realtime_option
@jobs_options
@watch_option
@click.option("--foxglove", is_flag=True, help="Stream what is recorded to Foxglove as well, read-only.")
@click.option(
    "--shard",
    callback=shard,
    metavar="I/N",
    help="Every N-th trial from the I-th on alone; `merge` joins all N.",
)
def run(
    profile: str,
    overrides: Mapping[str, str],
    seed: int,
    csv: Path | None,
    numbers: Sequence[int],
    out: Path,
    reported: bool,
    endpoints: Path | None,
    realtime: bool,
    jobs: int | None,
    scheduler: str | None,
    watched: bool,
    foxglove: bool,
    shard: tuple[int, int] | None,
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
    from config.assemble import plan_campaign
    from config.parts import begin, parts_of
    from config.trials import chosen

    if parts := parts_of(profile):
        if csv or numbers or endpoints or realtime or shard or watched or foxglove:
            raise click.UsageError(f"{profile} has parts; run one of them with this option: see run.py list")
        folder = begin(profile, parts, ["--seed", str(seed), *_sets(overrides)], out)
        return _in_turn(folder, jobs, scheduler, reported)
    loaded = _loaded(profile, overrides, csv)
    if realtime and (loaded.bench != "emulated" or endpoints is not None):
        reason = "an emulator that runs has its own time" if endpoints else f"{loaded.name} is not emulated"
        raise click.BadParameter(reason, param_hint="--realtime")
    trials = loaded.trials(seed)
    asked = {
        "profile": profile,
        "set": dict(overrides),
        "trials": str(csv.resolve()) if csv else None,
        "only": list(numbers),
        **({"shard": list(shard)} if shard else {}),
    }
    picked = chosen(trials, numbers, None)
    others = {trial.id for trial in picked} - {trial.id for trial in chosen(picked, (), shard)}
    plan = plan_campaign(loaded, picked, seed, done=others, asked=asked)
    with ExitStack() as stack:
        stream = stack.enter_context(closing(_foxglove())) if foxglove else None
        crew = stack.enter_context(_crew(loaded, plan, 1 if foxglove else jobs, scheduler))
        return _carried_out(
            loaded, plan, out, endpoints, reported, crew, realtime=realtime, watched=watched, mirror=stream
        )


@cli.command(cls=Verb, short_help="Go on with a run that broke off.")
@click.argument("run", metavar="RUN")
@out_option
@report_option
@endpoints_option
@jobs_options
@watch_option
def resume(
    run: str,
    out: Path,
    reported: bool,
    endpoints: Path | None,
    jobs: int | None,
    scheduler: str | None,
    watched: bool,
) -> int:
    """Go on with a RUN where it stopped, in its own folder.

    Trials that are done stay. One that was torn, or that ended the run by a fault, the guard or the operator, is run
    again from its beginning. It is refused where profile, devices or program are not those that the run began with.

    \b
    Example:
      run.py resume latest
      run.py resume runs/2026-11-20T12-00-00Z_mock-transient_ab12

    Exit codes: as of `run`.
    """
    from config.assemble import plan_campaign
    from config.resuming import profile_of
    from controller.recording.resuming import broken_off
    from controller.recording.run_folder import RunFolder

    found = RunFolder.find(run, out)
    if "parts" in found.read_manifest():
        if watched:
            raise click.UsageError(f"{run} has parts: watch each with run.py watch")
        return _in_turn(found, jobs, scheduler, reported)
    resumed = broken_off(found)
    loaded, trials = profile_of(resumed.manifest, resumed.folder.path.name)
    seed, asked = int(resumed.manifest["seed"]), resumed.manifest["profile"].get("asked")
    plan = plan_campaign(loaded, trials, seed, done=resumed.done, asked=asked)
    if plan.count == 0:
        say(
            f"{resumed.folder.path.name}: all {len(trials)} trials are done; `run.py report {run}` shows them"
        )
        return DONE
    with _crew(loaded, plan, jobs, scheduler) as crew:
        return _carried_out(loaded, plan, out, endpoints, reported, crew, resumed, watched=watched)


@cli.command(cls=Verb, short_help="Join the shards of a run.")
@click.argument("shards", nargs=-1, required=True, metavar="RUN...")
@out_option
def merge(shards: Sequence[str], out: Path) -> None:
    """Join runs that were made with --shard into the run folder that one run would have written.

    It is refused where profile, seed or program differ, and where a trial is missing or there twice. Where a trial
    ended its shard, also when that was resumed, the joined run ends there, as one run would.

    \b
    Example:
      run.py merge shard_1/* shard_2/* shard_3/*
    """
    from config.merging import merged

    say(f"{merged(shards, out).path}")


def _carried_out(
    loaded: Profile,
    plan: CampaignPlan,
    out: Path,
    endpoints: Path | None,
    reported: bool,
    crew: Crew | None,
    resumed: ResumedRun | None = None,
    realtime: bool = False,
    watched: bool = False,
    mirror: Mirror | None = None,
) -> int:
    """Run a campaign and report it; returns the exit code."""
    from controller.console import ConsoleOperator
    from controller.recording.run_folder import RunFolder

    with ExitStack() as stack:
        page = stack.enter_context(closing(_page())) if watched else None
        if crew is not None:
            from config.jobs import in_parts

            operator = stack.enter_context(ConsoleOperator())
            outcome = in_parts(crew, loaded, plan, _console(operator, page), out, resumed).run()
        else:
            from config.assemble import build_rig
            from controller.campaign import Campaign

            rig = stack.enter_context(closing(build_rig(loaded, _endpoints(endpoints), realtime)))
            operator = stack.enter_context(ConsoleOperator(asking=rig.asking))
            outcome = Campaign(plan, rig, _console(operator, page), out, resumed, mirror).run()
    if outcome.error is None:
        (complain if outcome.exit_code else say)(outcome.line)
    try:
        if reported:
            _report([RunFolder(outcome.folder)])
    except Exception as error:
        if not outcome.exit_code:
            raise
        complain(f"no report: {explained(error)[1]}")
    if outcome.error is not None:
        raise outcome.error
    return outcome.exit_code


@cli.command(cls=Verb, short_help="Serve a profile's emulated devices.")
@click.argument("profile")
@set_option
@realtime_option
def emulate(profile: str, overrides: Mapping[str, str], realtime: bool) -> None:
    """Start the emulated devices of a PROFILE and say in one JSON line where they are.

    They serve until Ctrl+C: real bytes on pseudo-terminals, for this program or any other.

    \b
    Example:
      run.py emulate emulated/transient > bench.json
      run.py run emulated/transient --endpoints bench.json     (in another terminal)
    """
    import signal
    import threading

    from config.assemble import start_emulator

    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    with closing(start_emulator(_loaded(profile, overrides), realtime)) as emulator:
        click.echo(json.dumps(emulator.endpoints))
        sys.stdout.flush()
        ended.wait()


@cli.command(cls=Verb, short_help="Feed a recording to a detector.")
@recording_options
@click.argument("recording", type=click.Path(path_type=Path))
@click.option("--plot", type=click.Path(path_type=Path), metavar="FILE", help=PLOT_HELP)
def replay(detector: str, plot: Path | None, **given: Any) -> None:
    """Feed a RECORDING to a detector and print one JSON line an event.

    RECORDING is a run folder, a part of its name or `latest`, or a file: CSV (any separator, with or without a line of
    names), NPZ, MAT, WAV, MCAP. Of a run, a detector of the run's own profile has its settings there; where it has
    several of a kind, NAME is one of their names. What was read is said on standard error.

    \b
    Example:
      run.py replay latest --detector resonance --trial 4
      run.py replay latest:mock/centering --detector right_ours
      run.py replay approach.csv --detector pretouch --column i,q --column x_m
      run.py replay finger.csv --detector resonance.paper --column period_s --baseline 2:3 --set threshold_sigma=4
      run.py replay drag.wav --detector slip --column 0 --set threshold=21 --plot drag.png
      run.py replay bag.mcap --detector slip --column /wrench:wrench.force.z
    """
    from config.recordings import load
    from controller.replay import as_line
    from controller.replay import replay as replayed

    made, blocks, notes = load(detector, **given)
    events = list(replayed(blocks, made))
    complain("\n".join(notes))
    for event in events:
        click.echo(json.dumps(as_line(event, detector)))
    if not events:
        samples = sum(len(block) for block in blocks if block.stream == made.inputs[0])
        complain(f"{detector} found nothing in {samples} samples")
    if plot is not None:
        from controller.replay_plot import draw

        draw(plot, blocks, made, events)


@cli.command(cls=Verb, short_help="Find the threshold that a recording without events asks for.")
@recording_options
@click.argument(
    "recordings", type=click.Path(path_type=Path), nargs=-1, required=True, metavar="RECORDING..."
)
@click.option(
    "--span",
    "spans",
    multiple=True,
    callback=all_spans,
    metavar="T0:T1",
    help="Seconds of each recording that are quiet; all of it otherwise. May be given several times.",
)
@click.option(
    "--false-alarm-interval",
    "interval_s",
    type=click.FloatRange(min=0.0, min_open=True),
    metavar="S",
    required=True,
    help="Mean time between false alarms, in seconds.",
)
def calibrate(detector: str, interval_s: float, **given: Any) -> None:
    """Find the threshold with which a detector alarms falsely once in a stated time, on average.

    A RECORDING is one in which nothing happens that the detector shall report, but everything that it shall not: a run
    folder (all its trials), a part of its name or `latest`, or a file as `replay` takes it. Prints one JSON line: the
    threshold, its 95 % interval, whether the recordings were so short that it was extrapolated, and the false alarms
    that thresholds gave on pieces which were left out when they were set.

    \b
    Example:
      run.py calibrate rolling.csv --detector slip --column ft_v --rate 1000 --false-alarm-interval 3600
      run.py calibrate drag_*.csv --detector slip --span 0.5:2.2 --false-alarm-interval 60
      run.py calibrate latest --detector slip.paper --set input=board.flexible --false-alarm-interval 600
    """
    from config.assemble import calibratable
    from config.recordings import load_quiet
    from controller.detectors.calibration import Statistic
    from controller.replay import ReplayError, calibration_line

    loaded = load_quiet(detector, **given)
    pieces = [(one.detector, one.blocks) for one in loaded if isinstance(one.detector, Statistic)]
    if not pieces:
        raise ReplayError(
            f"--detector {detector}: no threshold that a recording could set; try {', '.join(calibratable())}"
        )
    line = calibration_line(pieces, detector, interval_s)
    complain("\n".join(dict.fromkeys(note for one in loaded for note in one.notes)))
    click.echo(json.dumps(line))


@cli.command(cls=Verb, short_help="Find the resonance in a transducer's frequency sweep.")
@click.argument("table", type=click.Path(path_type=Path), metavar="FILE")
@click.option(
    "--column", metavar="F,A", help="Columns of frequency and response, where there are more than two."
)
@click.option(
    "--span", callback=span, metavar="LOW:HIGH", help="Frequencies that count, Hz; all of them otherwise."
)
@click.option("--conductance", is_flag=True, help="The response is a conductance, not an amplitude.")
@click.option(
    "--plot", type=click.Path(path_type=Path), metavar="FILE", help="Draw it: a PNG, SVG or PDF file."
)
def sweep(
    table: Path, column: str | None, span: tuple[float, float] | None, conductance: bool, plot: Path | None
) -> None:
    """Find peak, band, sharpness and resonances in a transducer's sweep.

    FILE is a table of frequencies and amplitudes (peak to peak or RMS), or conductances, in Hz or kHz. Prints one JSON
    line: the peak, the band at half power with its Q, the band within 6 dB, and whether one resonance explains the
    sweep or two are needed (Akaike's criterion).

    \b
    Example:
      run.py sweep pair.csv --plot pair.png
      run.py sweep piezo.txt --conductance --span 222000:227000
    """
    from controller.sweep import analysed, draw_sweep, read_sweep, sweep_line

    measured = read_sweep(table, column, span, "conductance" if conductance else "amplitude")
    found = analysed(table, measured)
    complain(measured.note)
    click.echo(json.dumps(sweep_line(found)))
    if plot is not None:
        draw_sweep(plot, measured, found)


@cli.command(cls=Verb, short_help="Write the report of one or more runs.")
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@out_option
def report(runs: Sequence[str], out: Path) -> None:
    """Write the report of a RUN, or of several together, from the recordings alone.

    RUN is a run folder, a part of its name, `latest`, or `latest:PROFILE`. The page goes into the last one's folder. A
    run that was cut off is reported as far as it came, and its recording closed, so that Foxglove reads it as well.

    \b
    Example:
      run.py report latest
      run.py report latest:mock/static latest:mock/transient
    """
    from controller.recording.reader import close_recordings
    from controller.recording.run_folder import RunFolder

    folders = [RunFolder.find(name, out) for name in runs]
    for run in (run for folder in folders for run in folder.runs):
        close_recordings(run)
    _report(folders)


@cli.command(cls=Verb, short_help="Watch a run that goes on, in the browser.")
@click.argument("name", metavar="RUN")
@out_option
def watch(name: str, out: Path) -> None:
    """Serve the live page of a RUN that goes on, and print its link; it ends with the run, or by Ctrl+C.

    The page is on this machine alone, and whoever has the link can pause and stop the run. Stop is not a safety
    function: use the robot's emergency stop.

    \b
    Example:
      run.py watch latest
    """
    from controller.recording.run_folder import RunFolder, RunFolderError
    from controller.watching.page import Door, alive, serve

    folder = RunFolder.find(name, out).path
    if not alive(folder):
        raise RunFolderError(f"{folder}: this run does not go on; `run.py open {name}` shows its report")
    door = Door.open()
    click.echo(door.link)
    sys.stdout.flush()
    serve(folder, door, lambda: _browse(door.link))


@cli.command("open", cls=Verb, short_help="Open the report of a run in the browser.")
@click.argument("name", metavar="RUN")
@out_option
def open_(name: str, out: Path) -> None:
    """Open the report of a RUN in the browser, and print where it is; it is written where there is none yet.

    RUN is a run folder, a part of its name, `latest`, or `latest:PROFILE`.

    \b
    Example:
      run.py open latest
    """
    from controller.recording.run_folder import RunFolder

    folder = RunFolder.find(name, out)
    page = folder.path / "report.html"
    if not page.is_file():
        _report([folder])
    click.echo(page)
    _browse(page.resolve().as_uri())


@cli.command(cls=Verb, short_help="Write a run in the formats of other programs.")
@click.argument("run", metavar="RUN")
@click.option(
    "--to", type=click.Choice(["csv", "lerobot", "parquet", "rosbag2"]), required=True, help="Which format."
)
@click.option("--into", type=click.Path(path_type=Path), help="Folder to write into; RUN/FORMAT otherwise.")
@out_option
def export(run: str, to: str, into: Path | None, out: Path) -> None:
    """Write a RUN's trials and samples for other programs, and print the files.

    csv and parquet: trials, and samples as tidy tables (trial, stream, channel, t_s, value, unit). rosbag2: an MCAP
    file a trial with WrenchStamped, Imu and JointState, which ROS 2 plays. lerobot: a dataset (v3.0), an episode a
    trial, in which each frame says when each stream was sampled.

    \b
    Example:
      run.py export latest --to parquet
    """
    from controller.export import export as exported
    from controller.recording.reader import open_run

    opened = open_run(run, out)
    for path in exported(opened, to, into or opened.folder.path / to):
        click.echo(path)


@cli.command(cls=Verb, short_help="Show what differs between two runs.")
@click.argument("first", metavar="RUN")
@click.argument("second", metavar="RUN")
@out_option
def compare(first: str, second: str, out: Path) -> None:
    """Show which settings differ between two runs, and the mean difference of each result, second less first.

    Trials are paired by number and factors; behind a mean stands its 95 % interval (Student's). A page beside the
    second run's report has the figures of both side by side.

    \b
    Example:
      run.py compare 2026-11-20T12-00-00Z latest
    """
    from controller.comparing import compared, side_by_side
    from controller.recording.reader import open_run
    from controller.reports.report import build_report

    runs = open_run(first, out), open_run(second, out)
    lines = list(compared(*runs))
    click.echo("\n".join(lines))
    for run in runs:
        if not (run.folder.path / "report.html").is_file():
            build_report([run])
    click.echo(side_by_side(*runs, lines))


# --- what the verbs share ------------------------------------------------------------------------


def _loaded(profile: str, overrides: Mapping[str, str], csv: Path | None = None) -> Profile:
    from config.assemble import Table
    from config.profile import load_profile
    from config.trials import read_csv

    rows, labels = read_csv(csv) if csv else (None, None)
    return load_profile(profile, overrides, table=Table(), rows=rows, labels=labels)


def _crew(
    loaded: Profile, plan: CampaignPlan, jobs: int | None, scheduler: str | None
) -> AbstractContextManager[Crew | None]:
    """Who runs the trials; None is this process."""
    from config.costs import duration
    from config.jobs import Crew, cluster, cores, jobs_for

    kept = click.get_current_context().find_object(Crew)  # of a campaign of parts
    if scheduler is None:
        count = jobs_for(loaded, plan, jobs)
        if count > 1:
            say(f"{duration(loaded.name, loaded.experiment, loaded.bench, plan.count, count)}")
            return nullcontext(kept) if kept else closing(cores(count))
        return nullcontext()
    jobs_for(loaded, plan, 2)
    return nullcontext(kept) if kept else closing(cluster(scheduler))


def _endpoints(path: Path | None) -> Mapping[str, Any] | None:
    if path is None:
        return None
    try:
        endpoints = json.loads(path.read_text(encoding="utf-8"))
        host, port = endpoints["control"]["host"], endpoints["control"]["port"]
        if not (isinstance(host, str) and isinstance(port, int) and 0 < port < 65_536):
            raise ValueError
        if not all(isinstance(where, dict) for where in dict(endpoints["devices"]).values()):
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = error.strerror if isinstance(error, OSError) else "not the line that `run.py emulate` prints"
        raise click.BadParameter(f"{path}: {reason}", param_hint="--endpoints") from None
    return dict(endpoints)


def _console(operator: ConsoleOperator, page: PageProcess | None) -> Console:
    """The person's side: the terminal, and whoever watches."""
    from controller.console import PlainConsole
    from controller.watching.feed import Watched

    began = None if page is None else page.began
    if sys.stdout is None or not sys.stdout.isatty() or os.environ.get("TERM") == "dumb":
        return Watched(PlainConsole(operator, say_at_once), operator, began)
    from rich.console import Console as Terminal

    from controller.live import LiveConsole

    return Watched(LiveConsole(operator, Terminal()), operator, began)


def _page() -> PageProcess:
    """Begin to serve the live page; it is there once the run is."""
    from controller.watching.page import Door, PageProcess

    door = Door.open()
    link = door.link
    say(f"watch it: {link}")
    page = PageProcess(door)
    _browse(link)
    return page


def _foxglove() -> FoxgloveStream:
    """Begin to stream to Foxglove."""
    try:
        from controller.watching.foxglove import FoxgloveStream

        stream = FoxgloveStream()
    except ImportError:
        raise click.UsageError("--foxglove needs its SDK: pip install foxglove-sdk") from None
    except RuntimeError as error:
        raise click.UsageError(f"--foxglove: {error}") from None
    say(f"Foxglove: {stream.address}")
    return stream


def _browse(address: str) -> None:
    """Open an address where there is a screen."""
    import webbrowser

    if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)


def _sets(overrides: Mapping[str, str]) -> list[str]:
    """The options that gave these values."""
    return [f"--set={key}={value}" for key, value in overrides.items()]


def _in_turn(folder: RunFolder, jobs: int | None, scheduler: str | None, reported: bool) -> int:
    """Run the parts of a campaign that are left, and report all; returns the exit code."""
    from config.jobs import cluster, cores
    from config.parts import carry_on

    workers = [
        *(["--jobs", str(jobs)] if jobs else []),
        *(["--scheduler", scheduler] if scheduler else []),
    ]
    with closing(cluster(scheduler) if scheduler else cores(jobs)) as crew:
        code = carry_on(folder, run, resume, workers, crew, say)
    if reported and folder.runs:
        _report([folder])
    return code


def _report(folders: Sequence[RunFolder]) -> None:
    from controller.export import tidy
    from controller.recording.reader import open_run
    from controller.reports.report import tell

    runs = [open_run(run.path) for folder in folders for run in folder.runs]
    for run in runs:
        tidy(run)
    whole = folders[0].read_manifest() if len(folders) == 1 else {}
    page, lines = tell(runs, folders[-1].path, whole.get("title", ""), whole.get("paper", ()))
    usual = page.parent.parent.resolve() == Path("runs").resolve()
    newest = usual and max(page.parent.parent.iterdir()).name == page.parent.name
    where = "latest" if newest else page.parent
    if sys.stdout.isatty():
        lines = [fill(line, get_terminal_size().columns, subsequent_indent="  ") for line in lines]
    say("\n".join([*lines, f"report: {page}", f"to see it: run.py open {where}"]))


if __name__ == "__main__":
    cli(prog_name="run.py")
