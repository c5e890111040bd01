"""What all verbs of the command line share: errors as one line, exit codes, `--set`."""

from __future__ import annotations

import json
import math
import os
import sys
from collections.abc import Callable, Mapping, Sequence
from functools import partial, reduce
from importlib import import_module
from pathlib import Path
from shutil import get_terminal_size
from textwrap import fill
from typing import TYPE_CHECKING, Any, TextIO

import click

from drivers.core.errors import PROGRAM

if TYPE_CHECKING:
    from config.parts import ProfileParts
    from config.profile import Profile
    from controller.recording.run_folder import RunFolder

DONE, FAILED, USAGE, DEVICE, GUARD, INTERRUPTED = 0, 1, 2, 3, 4, 130
"""Exit codes."""

RATE_HZ = (0.01, 1e7)
"""Sample rates that a recording may have, Hz. Assumption: slower is a log book, faster no sensor of touch."""

LONGEST_S = 1e9
"""Longest mean time between false alarms that may be asked for, s: thirty years."""

PLOT_HELP = "Draw signal, statistic, threshold and events: a PNG, SVG or PDF file."

COLOURS = {"Went well": "green", "Went partly": "yellow", "Broken off": "yellow", "Went badly": "red"}
"""Of a verdict, by how it begins."""

NO_MEMORY = ("failed to map segment", "cannot allocate memory", "can't start new thread", "bad_alloc")
"""How loader and system say that no memory is left."""

MISTAKES = 24
"""How many mistakes of a profile are listed at once."""


class Named(click.Command):
    """Its help has the program's present name in the examples."""

    def get_help(self, ctx: click.Context) -> str:
        """See `click.Command`."""
        return super().get_help(ctx).replace("run.py", PROGRAM)


class Program(Named, click.Group):
    """All verbs; an error is one line on standard error and an exit code, never a page of usage.

    Args:
        verbs: Of each its module in this package, and what it does.
    """

    def __init__(self, *args: Any, verbs: Mapping[str, tuple[str, str]], **extra: Any) -> None:
        super().__init__(*args, **extra)
        self._verbs = verbs

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Their names."""
        return [*self._verbs]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command:
        """A verb, whose module is loaded now."""
        if cmd_name not in self._verbs:
            raise click.exceptions.NoSuchCommand(cmd_name, possibilities=self._verbs, ctx=ctx)
        try:
            module = import_module(f"{__name__}.{self._verbs[cmd_name][0]}")
        except Exception as error:
            code, line = explained(error)
            complain(line)
            ctx.exit(code)
        found = (each for each in vars(module).values() if isinstance(each, click.Command))
        return next(each for each in found if each.name == cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """What each does, without loading it."""
        with formatter.section("Commands"):
            formatter.write_dl([(name, about) for name, (_, about) in self._verbs.items()])

    def main(self, *args: Any, **extra: Any) -> Any:
        """Run, and end the process with the exit code."""
        _open_standard_streams()
        try:
            given = args[0] if args else extra.get("args")
            for argument in sys.argv[1:] if given is None else given:
                if not argument.isprintable() and any(0xDC80 <= ord(letter) <= 0xDCFF for letter in argument):
                    raise click.UsageError(f"{argument!a} is no UTF-8 text")
            code = super().main(*args, **{**extra, "standalone_mode": False})
        except click.exceptions.NoArgsIsHelpError as error:
            click.echo(error.format_message())
            code = USAGE
        except click.ClickException as error:
            verb = error.ctx.command_path if isinstance(error, click.UsageError) and error.ctx else PROGRAM
            complain(f"{verb}: {error.format_message().rstrip('.')}; see: {verb} --help")
            code = USAGE
        except (click.Abort, KeyboardInterrupt):
            complain("interrupted")
            code = INTERRUPTED
        except BrokenPipeError:
            # The reader of the output has gone, `run.py list | head` for one.
            _discard(sys.stdout)
            code = FAILED
        sys.exit(code)


class Finite(click.FloatRange):
    """A range of numbers, which NaN is in none of."""

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> float:
        """The number."""
        number: float = super().convert(value, param, ctx)
        if math.isnan(number):
            self.fail(f"{value} is no number", param, ctx)
        return number


class Verb(Named):
    """A verb; with --debug an error shows where it came from."""

    def __init__(self, *args: Any, **extra: Any) -> None:
        super().__init__(*args, **extra)
        self.params.append(click.Option(["--debug"], is_flag=True, help="Show where an error came from."))

    def invoke(self, ctx: click.Context) -> Any:
        """Run the verb; returns the exit code."""
        debug = ctx.params.pop("debug")
        try:
            return super().invoke(ctx) or DONE
        except (click.ClickException, click.exceptions.Exit, BrokenPipeError, KeyboardInterrupt):
            raise
        except (Exception, SystemExit) as error:
            from controller.own_modules import as_error, own_place

            if debug if isinstance(error, Exception) else not own_place(error):
                raise
            code, line = explained(as_error(error))
            complain(line)
            return code


def _lacking(missing: ModuleNotFoundError) -> str:
    return f"{sys.executable} lacks {missing.name}: call .venv/bin/python {PROGRAM}, which `make run` sets up"


def _starved(error: BaseException | None) -> bool:
    """Whether no memory was left, by an error or by one behind it."""
    says = isinstance(error, MemoryError) or any(words in str(error).lower() for words in NO_MEMORY)
    return error is not None and (says or _starved(error.__cause__ or error.__context__))


def explained(error: Exception) -> tuple[int, str]:
    """Exit code and line for an error; an unforeseen one is the program's own."""
    if _starved(error):
        return FAILED, "no memory is left for this program; close others, or raise its limit (ulimit -v)"
    try:
        from config.jobs import JobsError
        from config.source import ProfileError
        from controller.guard import GuardRefusal
        from controller.loop import UnfitStreamError
        from controller.own_modules import KindError, own_place
        from controller.recording.run_folder import RecordingError, RunFolderError
        from controller.recording.tables import ReplayError
        from drivers.core.errors import DeviceError
    except ModuleNotFoundError as missing:
        return USAGE, _lacking(missing)
    if isinstance(error, ModuleNotFoundError) and not own_place(error):
        return USAGE, _lacking(error)

    if isinstance(error, ProfileError):
        lines = list(error.problems[:MISTAKES])
        more = len(error.problems) - len(lines)
        return USAGE, "\n".join([*lines, f"and {more} more"] if more else lines)
    sorts = {
        GUARD: (GuardRefusal,),
        USAGE: (RunFolderError, ReplayError, JobsError, UnfitStreamError, KindError),
        DEVICE: (DeviceError,),
        FAILED: (RecordingError,),
    }
    for code, kinds in sorts.items():
        if isinstance(error, kinds):
            return code, f"guard: {error}" if code == GUARD else str(error)
    message = " ".join(str(error).split())
    kind, place = type(error).__name__, own_place(error)
    line = f"{place}: {kind}: {message}" if place else f"unexpected {kind}: {message}"
    return FAILED, f"{line}; run again with --debug to see where"


def complain(line: str) -> None:
    """Print a mistake on standard error."""
    say(line, err=True)


def real_time(profile: Profile) -> str:
    """Why an emulated bench runs in real time without having been asked to, or ""."""
    own = ", ".join(f"{name} at {port}" for name, port in profile.real_ports.items())
    return own and f"in real time, as with --realtime: beside emulated devices there is {own}"


def say(line: str, *, err: bool = False) -> None:
    """Print a line that counts for less than the exit code: where it cannot be written, it is dropped."""
    try:
        click.echo(line, err=err)
    except OSError:
        _discard(sys.stderr if err else sys.stdout)


def say_at_once(line: str) -> None:
    """Print a line on standard output without Python's lock on it: a thread that hangs in here holds up no other.

    Raises:
        OSError: it cannot be written, or its reader has left.
    """
    try:
        descriptor = sys.stdout.fileno()
    except (AttributeError, ValueError):  # none, or one in memory
        click.echo(line)
        return
    data = f"{line}\n".encode(sys.stdout.encoding, errors="replace")
    while data:
        data = data[os.write(descriptor, data) :]


def _discard(stream: TextIO) -> None:
    """Discard what is still to be written to a stream that takes nothing more."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


def _open_standard_streams() -> None:
    """Open those that the caller closed: a file of the run would take their place, and the output go into it."""
    for descriptor in (0, 1, 2):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest number that is free


def _overrides(ctx: click.Context, parameter: click.Parameter, values: Sequence[str]) -> dict[str, str]:
    pairs = [value.partition("=") for value in values]
    for key, equals, _ in pairs:
        if not (key.strip() and equals):
            raise click.BadParameter(f"'{key}' gives no value; write for example --set limits.force_n=1.5")
    return {key.strip(): text.strip() for key, _, text in pairs}


def span(value: str) -> tuple[float, float]:
    """Two times in seconds out of `2:12`."""
    try:
        begin_s, end_s = (float(part) for part in value.split(":"))
    except ValueError:
        raise click.BadParameter(f"'{value}' is no span; write seconds as in 2:12") from None
    if not 0.0 <= end_s - begin_s < float("inf") or begin_s == end_s:
        raise click.BadParameter(f"'{value}' ends before it begins")
    return begin_s, end_s


FILE = click.Path(path_type=Path)
many = partial(click.option, multiple=True)


def options(*given: Callable[[Any], Any]) -> Callable[[Any], Any]:
    """Options and arguments as one, in the order of the help."""
    return lambda verb: reduce(lambda made, one: one(made), reversed(given), verb)


set_option = many(
    "--set",
    "overrides",
    metavar="KEY=VALUE",
    callback=_overrides,
    help="Another value for one setting, for example limits.force_n=1.5; may be given several times.",
)


trials_options = options(
    click.argument("profile"),
    set_option,
    click.option("--trials", "csv", type=FILE, help="Trials from a CSV file: a factor a column."),
    many("--only", "numbers", type=int, metavar="TRIAL", help="This trial alone; repeatable."),
)
"""A PROFILE, other values for its settings, other trials, and which of them."""

out_option = click.option(
    "--out", type=FILE, default=Path("runs"), show_default=True, help="Folder of all runs."
)
report_option = click.option(
    "--report/--no-report", "reported", default=True, help="Write the report as well.", show_default=True
)


def joined(path: str) -> Mapping[str, Any]:
    """What an emulator printed into a file."""
    try:
        endpoints = json.loads(Path(path).read_text(encoding="utf-8"))
        host, port = endpoints["control"]["host"], endpoints["control"]["port"]
        if not (isinstance(host, str) and isinstance(port, int) and 0 < port < 65_536):
            raise ValueError
        if not all(isinstance(where, dict) for where in dict(endpoints["devices"]).values()):
            raise ValueError
    except (OSError, ValueError, KeyError, TypeError) as error:
        reason = (
            error.strerror if isinstance(error, OSError) else f"not the line that `{PROGRAM} emulate` prints"
        )
        raise click.BadParameter(f"{path}: {reason}", param_hint="--endpoints") from None
    return dict(endpoints)


endpoints_option = click.option(
    "--endpoints",
    type=joined,
    metavar="FILE",
    help="Join the emulator whose line `run.py emulate` printed into this file.",
)

realtime_option = click.option(
    "--realtime",
    is_flag=True,
    help="Let an emulated bench's time follow the wall clock, even when late: to measure latencies.",
)

watch_option = click.option(
    "--watch", "watched", is_flag=True, help="Serve a live page as well: signals, trials, pause and stop."
)


def shard(value: str) -> tuple[int, int]:
    """Which shard of how many, out of `3/7`."""
    which, _, count = value.partition("/")
    if not (which.isdecimal() and count.isdecimal() and 1 <= int(which) <= int(count)):
        raise click.BadParameter(f"'{value}' is no shard; write for example 1/7 to 7/7")
    return int(which), int(count)


jobs_options = options(
    click.option(
        "--jobs",
        type=click.IntRange(min=1),
        metavar="N",
        help="Run the trials in N processes; by default on all cores, where it is worth their start.",
    ),
    click.option("--scheduler", metavar="ADDRESS", help="Run the trials on the workers of a Dask scheduler."),
)
"""Where the trials of a simulated campaign are run."""


rate_option = click.option(
    "--rate",
    "rate_hz",
    type=Finite(min=RATE_HZ[0], max=RATE_HZ[1]),
    metavar="HZ",
    help="Sample rate of a file without times, or in place of them.",
)


def interval_option(**more: Any) -> Callable[[Any], Any]:
    """How seldom a detector may alarm falsely."""
    most = Finite(min=0.0, min_open=True, max=LONGEST_S)
    about = "Mean time between false alarms, in seconds."
    return click.option("--false-alarm-interval", "interval_s", type=most, metavar="S", help=about, **more)


recordings_argument = click.argument("recordings", type=FILE, nargs=-1, required=True, metavar="RECORDING...")


recording_options = options(
    click.option(
        "--detector",
        required=True,
        metavar="NAME",
        help="Kind of detector (run.py list --detectors), or of a run a detector of its profile.",
    ),
    set_option,
    many(
        "--column",
        "columns",
        metavar="C[,C]",
        help="Columns of a file by name; channels of a WAV file or a run's stream, from 0; TOPIC:FIELD of an "
        "MCAP file. Once for each input of the detector, in its order.",
    ),
    rate_option,
    click.option(
        "--baseline",
        type=span,
        metavar="T0:T1",
        help="Start at T0; a detector with a baseline learns for T1 - T0 seconds.",
    ),
    click.option("--trial", type=int, help="Trial of a run folder; `replay` takes its first one otherwise."),
)
"""The options of `replay` and `calibrate` for the recording and the detector."""


def loaded_profile(profile: str, overrides: Mapping[str, str], csv: Path | None = None) -> Profile:
    """A profile with settings and trials of the command line."""
    from config.profile import load_profile
    from config.trials import read_csv

    return load_profile(profile, overrides, rows=read_csv(csv) if csv else None)


def for_each_part(verb: click.Command, parts: ProfileParts, more: Sequence[str]) -> int:
    """Call a verb for each part of a profile of parts; returns the worst exit code."""
    return max(int(verb.main([*part, *more], standalone_mode=False)) for part in parts.tried)


def sets(overrides: Mapping[str, str]) -> list[str]:
    """The options that gave these values."""
    return [f"--set={key}={value}" for key, value in overrides.items()]


def report_on(folders: Sequence[RunFolder], also: Sequence[str] = ()) -> None:
    """Write the report of some runs, its figures in other formats as well, and print its summary."""
    from controller.export import tidy
    from controller.recording.reader import open_run
    from controller.recording.run_folder import RunFolder
    from controller.reports.report import build_report_with_summary

    if sys.stdout.isatty():
        say("writing the report")
    runs = [open_run(run.path) for folder in folders for run in folder.runs]
    for run in runs:
        tidy(run)
    whole = folders[0].read_manifest() if len(folders) == 1 else {}
    page, lines = build_report_with_summary(
        runs,
        folders[0].path if len(folders) == 1 else None,
        whole.get("title", ""),
        whole.get("paper", ()),
        also,
    )
    usual = page.parent.parent.resolve() == Path("runs").resolve()
    newest = usual and RunFolder.find("latest").path.name == page.parent.name
    where = "latest" if newest else page.parent
    if sys.stdout.isatty():
        lines = [fill(line, get_terminal_size().columns, subsequent_indent="  ") for line in lines]
    opens = [f"to see it: {PROGRAM} open {where}"] if len(folders) == 1 else []
    say("\n".join(lines[:-1]))
    say_verdict(lines[-1])
    say("\n".join([f"report: {page}", *opens]))


def say_verdict(line: str) -> None:
    """Print how a run went; on a terminal apart from what stands above it, and in colour."""
    if not sys.stdout.isatty():
        say(line)
        return
    colour = next((colour for word, colour in COLOURS.items() if line.startswith(word)), None)
    word, colon, rest = line.partition(":")
    say(f"\n{click.style(word, fg=colour, bold=True)}{click.style(colon + rest, bold=True)}")


def terminal() -> Any:
    """Where to draw; None where the output is no terminal that can be drawn on."""
    if sys.stdout is None or not sys.stdout.isatty() or os.environ.get("TERM") == "dumb":
        return None
    from rich.console import Console

    return Console()


def browse(address: str) -> None:
    """Open an address where there is a screen."""
    import webbrowser

    if sys.platform == "darwin" or os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"):
        webbrowser.open(address)
