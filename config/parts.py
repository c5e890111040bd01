"""A profile of parts: several runs, one after the other, in one folder and with one report."""

from __future__ import annotations

import shlex
from collections.abc import Callable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING

import click
from click.core import ParameterSource
from pydantic import Field

from config.source import ProfileError, profile_names, read_source
from config.validation import validated
from config.verbs import INTERRUPTED
from drivers.core.clock import utc_now
from drivers.core.errors import PROGRAM
from drivers.core.settings import Settings

if TYPE_CHECKING:
    from config.jobs import Crew
    from controller.recording.run_folder import RunFolder


class Shown(Settings):
    """A table or figure of a paper, and where it is here."""

    item: str
    """Its name in the paper."""

    shows: str
    """What it shows."""

    part: str = ""
    """The profile among the parts that repeats it; "" where none does."""

    differs: str = Field(min_length=1)
    """Why ours comes out otherwise, or is not there."""


class ProfileParts(Settings):
    """The content of a profile of parts."""

    title: str
    """Of the report."""

    parts: tuple[str, ...] = Field(min_length=1)
    """Arguments of `run`, one run each: "mock/touch --set trials.repeats=4"."""

    paper: tuple[Shown, ...] = ()
    """The paper's tables and figures, in its order."""

    @property
    def runs(self) -> Sequence[Sequence[str]]:
        """The arguments of each run; the profile first."""
        return [shlex.split(part) for part in self.parts]

    @property
    def tried(self) -> Sequence[Sequence[str]]:
        """The arguments of each run that select profile and trials: other verbs take them as well."""
        return [_trials_of(arguments) for arguments in self.runs]


def parts_of(name_or_path: str) -> ProfileParts | None:
    """The content of a profile of parts; None for a profile of trials.

    Raises:
        ProfileError: no such profile, or a mistake in it.
    """
    source = read_source(name_or_path)
    if "parts" not in source.data:
        return None
    parts = validated(ProfileParts, source.data, lambda place: f"{source.origin(place)}: {'.'.join(place)}")
    folder = source.folders[0]
    lines = tuple(_line(part, folder) for part in parts.parts)
    paper = tuple(shown.model_copy(update={"part": _beside(shown.part, folder)}) for shown in parts.paper)
    parts = parts.model_copy(update={"parts": lines, "paper": paper})
    problems = [f"parts = {part!r}: {wrong}" for part in parts.parts if (wrong := _mistake(part))]
    named = {"", *(arguments[0] for arguments in (() if problems else parts.runs))}
    problems = problems or [
        f"paper {shown.item}: part = {shown.part!r} is none of the parts"
        for shown in parts.paper
        if shown.part not in named
    ]
    if problems:
        raise ProfileError([f"{source.files[-1]}: {problem}" for problem in problems])
    return parts


def _beside(name: str, folder: Path) -> str:
    """The name of a part's profile; where that stands beside the profile of parts, as it is found from here."""
    with suppress(OSError):  # told as what it is when it is read
        if name and name not in profile_names() and (folder / name).is_file():
            path, here = (folder / name).resolve(), Path.cwd()
            return str(path.relative_to(here) if path.is_relative_to(here) else path)
    return name


def _line(part: str, folder: Path) -> str:
    """Likewise a part's whole line."""
    with suppress(ValueError):
        name, *more = shlex.split(part)
        return shlex.join([found, *more]) if (found := _beside(name, folder)) != name else part
    return part


def _mistake(part: str) -> str:
    """Why nothing can be run by a part's line; "" where it can."""
    try:
        given = run_context(shlex.split(part))
        if given.get_parameter_source("out") is not ParameterSource.DEFAULT:
            return "all parts write into one folder; leave --out out"
        if "parts" in read_source(given.params["profile"]).data:
            return "has parts itself; name those here"
    except (ValueError, click.ClickException) as error:  # a ProfileError is one as well
        return (error.format_message() if isinstance(error, click.ClickException) else str(error)).rstrip(".")
    except click.exceptions.Exit:
        return "asks for help alone"
    return ""


def run_context(arguments: Sequence[str]) -> click.Context:
    """What `run` reads in the arguments of a part."""
    from config.verbs.running import run

    return run.make_context("run", list(arguments))


def _trials_of(arguments: Sequence[str]) -> list[str]:
    """Of the arguments of a part those that select profile and trials."""
    given = run_context(arguments).params
    settings = [f"--set={key}={text}" for key, text in given["overrides"].items()]
    chosen = [f"--only={number}" for number in given["numbers"]]
    return [given["profile"], *settings, *chosen, *([f"--trials={given['csv']}"] if given["csv"] else [])]


def begin(name: str, parts: ProfileParts, common: Sequence[str], out: Path) -> RunFolder:
    """Make the folder of a campaign of parts; its manifest lists the runs.

    Args:
        common: Arguments of every run, behind its own.

    Raises:
        RecordingError: it cannot be written.
    """
    from controller.recording.run_folder import RunFolder

    started = utc_now()
    folder = RunFolder.create(out, name, started)
    folder.write_manifest(
        {
            "profile": {"name": name},
            "title": parts.title,
            "parts": [[*arguments, *common] for arguments in parts.runs],
            "paper": [shown.model_dump() for shown in parts.paper],
            "started_utc": started.isoformat(),
        }
    )
    return folder


def carry_on(
    folder: RunFolder,
    run: click.Command,
    resume: click.Command,
    workers: Sequence[str],
    crew: Crew,
    show: Callable[[str], None],
) -> int:
    """Run the parts of a campaign that are not done; what was begun goes on.

    Args:
        workers: Arguments of both: where trials are run.
        crew: These workers; they stay from part to part.

    Returns:
        The exit code of the first part that broke off or was interrupted, be it at its end; the parts behind it are not
        begun. Else that of the first part in which no trial succeeded.
    """
    parts, begun = folder.read_manifest()["parts"], folder.runs
    failed = 0
    for number, arguments in enumerate(parts):
        show(f"[{number + 1}/{len(parts)}] {' '.join(arguments)}")
        verb, first = (resume, [str(begun[number].path)]) if number < len(begun) else (run, arguments)
        code = verb.main(
            [*first, "--out", str(folder.path), "--no-report", *workers],
            prog_name=f"{PROGRAM} {verb.name}",
            standalone_mode=False,
            obj=crew,
        )
        if code == INTERRUPTED or (code and not _ended(folder, number)):
            return int(code)
        failed = failed or int(code)
    return failed


def _ended(folder: RunFolder, number: int) -> bool:
    """Whether a part came to its end, with or without success."""
    runs = folder.runs
    return number < len(runs) and runs[number].read_manifest()["exit"]["status"] == "done"
