"""Verbs on a run folder: `report`, `watch`, `open`, `export`, `record-set`, `compare`."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path

import click

from config import verbs
from controller.recording.reader import close_recordings, open_run
from controller.recording.run_folder import RunFolder, RunFolderError
from drivers.core.errors import PROGRAM


@click.command(cls=verbs.Verb)
@click.argument("runs", nargs=-1, required=True, metavar="RUN...")
@click.option("--print", "for_print", is_flag=True, help="Save figures as PDF and PNG as well.")
@verbs.out_option
def report(runs: Sequence[str], for_print: bool, out: Path) -> None:
    """Write the report of a RUN, or of several together, from the recordings alone.

    RUN is a run folder, a part of its name, `latest`, or `latest:PROFILE`. The page of one goes into its folder, of
    several into `report_A_B` beside the last. A run that was cut off is reported as far as it came, and its recording
    closed, so that Foxglove reads it as well.

    \b
    Example:
      run.py report latest
      run.py report latest:mock/static latest:mock/transient
    """
    folders = [RunFolder.find(name, out) for name in runs]
    for run in (run for folder in folders for run in folder.runs):
        close_recordings(run)
    verbs.report_on(folders, ("pdf", "png") if for_print else ())


@click.command(cls=verbs.Verb)
@click.argument("name", metavar="RUN")
@verbs.out_option
def watch(name: str, out: Path) -> None:
    """Serve the live page of a RUN that goes on, and print its link; it stays until the page is closed, or Ctrl+C.

    The page is on this machine alone, and anyone with the link can pause and stop the run. Stop is not a safety
    function: use the robot's emergency stop.

    \b
    Example:
      run.py watch latest
    """
    from controller.watching.page import Door, alive, serve

    folder = RunFolder.find(name, out).path
    if not alive(folder):
        raise RunFolderError(f"{folder}: this run does not go on; `{PROGRAM} open {name}` shows its report")
    door = Door.open()
    click.echo(door.link)
    sys.stdout.flush()
    serve(lambda: folder, door, lambda: verbs.browse(door.link))


@click.command("open", cls=verbs.Verb)
@click.argument("name", metavar="RUN")
@verbs.out_option
def open_(name: str, out: Path) -> None:
    """Open the report of a RUN in the browser, and print where it is; it is written where there is none yet.

    RUN is a run folder, a part of its name, `latest`, or `latest:PROFILE`.

    \b
    Example:
      run.py open latest
    """
    folder = RunFolder.find(name, out)
    page = folder.path / "report.html"
    if not page.is_file():
        verbs.report_on([folder])
    click.echo(page)
    verbs.browse(page.resolve().as_uri())


@click.command(cls=verbs.Verb)
@click.argument("run", metavar="RUN")
@click.option(
    "--to", type=click.Choice(["csv", "lerobot", "parquet", "rosbag2"]), required=True, help="Which format."
)
@click.option("--into", type=verbs.FILE, help="Folder to write into; RUN/FORMAT otherwise.")
@verbs.out_option
def export(run: str, to: str, into: Path | None, out: Path) -> None:
    """Write a RUN's trials and samples for other programs, and print the files.

    csv and parquet: trials, and samples as tidy tables (trial, stream, channel, t_s, value, unit). rosbag2: an MCAP
    file a trial with WrenchStamped, Imu and JointState, which ROS 2 plays. lerobot: a dataset (v3.0), an episode a
    trial, in which each frame has the time of each stream's sample.

    \b
    Example:
      run.py export latest --to parquet
    """
    from controller.export import export as exported

    opened = open_run(run, out)
    paths = exported(opened, to, into or opened.folder.path / to)
    for note in opened.notes:
        verbs.complain(note)
    for path in paths:
        click.echo(path)


@click.command("record-set", cls=verbs.Verb)
@click.argument("run", metavar="RUN")
@click.option("--into", type=verbs.FILE, required=True, help="Folder to write into.")
@click.option("--licence", metavar="SPDX", required=True, help="Of the data, for example CC-BY-4.0.")
@click.option("--by", metavar="TEXT", required=True, help="Who publishes it.")
@click.option("--name", metavar="TEXT", help="Of the data set; the folder's name otherwise.")
@verbs.out_option
def record_set(run: str, into: Path, licence: str, by: str, name: str | None, out: Path) -> None:
    """Write a RUN as a data set that others can load without this program, and print the files.

    samples.parquet (trial, stream, channel, t_s, value, unit), trials.parquet (factors and measures), labels.parquet
    (when something touched, moved or slid, by the truth of a simulation or by encoders; when each sensor first showed
    the touch, with its uncertainty), an MCAP file a trial, and dataset.json: licence, units, rates, seed, checksums.

    \b
    Example:
      run.py record-set latest --into slips --licence CC-BY-4.0 --by "A lab"
    """
    from controller.record_set import write_set

    opened = open_run(run, out)
    paths = write_set(opened, into, licence=licence, name=name or into.name, by=by)
    for note in opened.notes:
        verbs.complain(note)
    for path in paths:
        click.echo(path)


@click.command(cls=verbs.Verb)
@click.argument("first", metavar="RUN")
@click.argument("second", metavar="RUN")
@verbs.out_option
def compare(first: str, second: str, out: Path) -> None:
    """Show which settings differ between two runs, and the mean difference of each result, second less first.

    Trials are paired by number and factors; behind a mean stands its 95 % interval (Student's). A page beside the
    second run's report has tables and figures of both side by side. Two JSON files of `characterize` are set beside
    each other, a line for each quantity.

    \b
    Example:
      run.py compare mine.json theirs.json
      run.py compare 2026-11-20T12-00-00Z latest
    """
    if first.endswith(".json") and second.endswith(".json"):
        from controller.characterize import differences

        pages = []
        for path in (first, second):
            try:
                pages.append(json.loads(Path(path).read_text("utf-8")))
                pages[-1]["rows"], pages[-1]["sensor"]
            except (OSError, ValueError, LookupError, TypeError) as error:
                reason = f"{path}: no certificate of `{PROGRAM} characterize` ({error})"
                raise click.BadParameter(reason, param_hint="RUN") from None
        click.echo("\n".join(differences(*pages)))
        return
    from controller.comparing import compared, side_by_side
    from controller.reports.report import build_report

    runs = open_run(first, out), open_run(second, out)
    lines = list(compared(*runs))
    click.echo("\n".join(lines))
    for run in runs:
        if not (run.folder.path / "report.html").is_file():
            build_report([run])
    page, verdict = side_by_side(*runs, lines)
    verbs.say_verdict(verdict)
    click.echo(page)
