"""The verb `quiet`: which bench is listened to, and where its thresholds are written."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import Any

import click

from config import verbs
from config.assemble import limits_of, make_detectors, scene_of, used_by
from config.needs import Needs, refuse_missing
from config.profile import Profile
from config.source import PROFILES, ProfileError, with_setting
from config.trials import chosen
from config.verbs.by_hand import session_on
from controller.console import EndingOperator
from controller.quiet import Proposal, listened, proposals, unrest
from controller.recording.run_folder import replace_file
from drivers.core.errors import PROGRAM
from drivers.core.messages import Command, Excite, Tone

SETTLE_S = 2.0
"""How long a bench settles where its trials do not say (assumption)."""

KEY = "threshold"
"""The setting that is written."""


@click.command(cls=verbs.Verb)
@verbs.trials_options
@verbs.endpoints_option
@click.option(
    "--seconds",
    type=verbs.Finite(min=5.0, max=86_400.0),
    default=60.0,
    show_default=True,
    help="How long the bench is listened to.",
)
@verbs.interval_option(default=3600.0, show_default=True)
@verbs.many(
    "--detector", "named", metavar="NAME", help="Write this one's as well, where it is set elsewhere."
)
@click.option("--dry-run", is_flag=True, help="Show the thresholds and write nothing.")
def quiet(
    profile: str,
    overrides: Mapping[str, str],
    csv: Path | None,
    numbers: Sequence[int],
    endpoints: Mapping[str, Any] | None,
    seconds: float,
    interval_s: float,
    named: Sequence[str],
    dry_run: bool,
) -> int:
    """Listen to the bench of a PROFILE at rest and write thresholds of its detectors into that file.

    Nothing moves; an excitation or a drive is on, as in the trials. Only ports need to be set, and what signals are
    made with. Written are thresholds that are not set yet, or that stand in this file, its comments stay; others are
    shown beside what they are. What moves is louder than what rests: run.py calibrate takes a run without events.

    \b
    Example:
      run.py quiet my_slip.toml --dry-run
      run.py quiet my_slip.toml --seconds 600

    Exit codes: 0 done, 1 the bench is not at rest or no detector can be set by that, 2 usage or profile, 3 device, 130
    interrupted.
    """
    loaded = verbs.loaded_profile(profile, overrides, csv)
    target = None if dry_run else own_file(profile)
    used = used_by(loaded, chosen(loaded.trials(0), numbers))
    own, trial, _ = used[0]
    parts = frozenset[tuple[str, str]]().union(*(needs.parts for _, _, needs in used))
    armed = {part for of, part in parts if of == "detectors"}
    if not armed:
        raise click.UsageError(f"{loaded.name}: its trials arm no detector")
    excused = {path for path in loaded.source.unset if path[0] == "devices" and path[-1] != "port"}
    own = replace(own, excused=frozenset(excused))
    heard = Needs(frozenset(part for part in parts if part[0] != "detectors"), moves=False)
    refuse_missing([(own, None, heard)])
    detectors = {each: detector for each, detector in make_detectors(own).items() if each in armed}
    limits = limits_of(own)
    streams = {stream for each in detectors.values() for stream in each.inputs}
    watched = (limits.position_stream, limits.pose_stream, limits.force_stream)
    streams |= {
        stream for stream in watched if stream is not None and stream.partition(".")[0] in heard.devices
    }
    settle_s = getattr(own.behavior, "settle_s", SETTLE_S)
    verbs.say(f"{loaded.name}: {seconds:g} s at rest, after {settle_s:g} s; touch nothing")
    scene = scene_of(own, trial)
    with (
        EndingOperator() as operator,
        session_on(
            own, heard.devices, operator, endpoints, doing="quiet", scene=scene, kept_s=math.inf
        ) as bench,
    ):
        result, blocks = listened(bench, streams, drive_of(own), settle_s, seconds)
    if result.outcome != "done":
        unrested = "not at rest: " * (result.outcome == "guard")
        verbs.complain(f"{unrested}{result.reason or result.outcome}; nothing is written")
        return {"guard": verbs.FAILED, "fault": verbs.DEVICE}.get(result.outcome, verbs.INTERRUPTED)
    if reasons := list(unrest(blocks, result.events, limits)):
        for reason in reasons:
            verbs.complain(f"not at rest: {reason}")
        return verbs.FAILED
    for stream, count in bench.lost.items():
        verbs.complain(f"{stream}: {count} samples lost")
    found = list(proposals(detectors, blocks, interval_s))
    for proposal in found:
        verbs.say(proposal.line)
    verbs.say(f"They hold at rest; what moves is louder: {PROGRAM} calibrate, on a run without events")
    if target is not None:
        _write(target, own, found, named)
    return verbs.DONE if any(proposal.found for proposal in found) else verbs.FAILED


def own_file(name: str) -> Path:
    """The file of a profile that thresholds may be written to.

    Raises:
        ProfileError: it is one that comes with the program.
    """
    path = next((each for each in (Path(name), Path(f"{name}.toml")) if each.is_file()), None)
    if path is None or (PROFILES / f"{name}.toml").is_file() or path.resolve().is_relative_to(PROFILES):
        raise ProfileError(
            f'{name}: comes with the program, and is not written to; make a file of your own with extends = "{name}"'
            f" and name that: {PROGRAM} quiet my_bench.toml; or --dry-run"
        )
    return path


def drive_of(profile: Profile) -> Command | None:
    """What makes the sensors of an experiment hear anything: by its settings, an excitation or the fingers' drive."""
    settings: Any = profile.behavior
    exciter = getattr(settings, "exciter", None)
    if exciter is None:
        return None
    if "drive_hz" in type(settings).model_fields:
        return Tone(exciter, settings.drive_hz, settings.drive_level)
    return Excite(exciter, True)


def _write(target: Path, profile: Profile, found: Sequence[Proposal], named: Sequence[str]) -> None:
    """Write the thresholds that are not set, stand in the file itself, or were asked for by name."""
    text, source, written = target.read_text(encoding="utf-8"), profile.source, []
    for proposal in found:
        path = ("detectors", proposal.detector, KEY)
        settings = profile.detectors[proposal.detector].settings
        if proposal.found is None or KEY not in type(settings).model_fields:
            continue
        elsewhere = path not in source.unset and source.origins.get(path) != source.files[-1]
        if elsewhere and proposal.detector not in named:
            present = getattr(settings, KEY)
            shown = f"{present:g}" if present is not None else "its own from each baseline"
            verbs.say(
                f"{proposal.detector}: stays as it is set elsewhere, {shown}; --detector {proposal.detector}"
            )
            continue
        value = float(f"{proposal.found.threshold:.4g}")
        text = with_setting(text, path, value, f"quiet, {date.today()}: {proposal.evidence}")
        written.append(f"{target}: [detectors.{proposal.detector}] {KEY} = {value:g}")
    try:
        replace_file(target, text.encode())
    except OSError as error:
        reason = f"{target}: {error.strerror or error}; it is as it was"
        raise ProfileError(f"{reason}: make room, or write access to its folder, or --dry-run") from None
    for line in written:
        verbs.say(line)
