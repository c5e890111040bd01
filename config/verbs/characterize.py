"""The verb `characterize`: what a sensor can do, on one page, from recordings of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import click

from config import verbs
from config.assemble import make_detector
from config.recordings import not_calibratable
from config.source import ProfileError
from controller.detectors.calibration import Statistic
from controller.recording.tables import ReplayError
from controller.replay import read_blocks, source


@click.command(cls=verbs.Verb)
@verbs.recordings_argument
@click.option("--column", metavar="C", help="The sensor's column, as in `replay`.")
@click.option("--stream", default="sensor", help="Of a run folder: the stream, DEVICE.STREAM.")
@click.option(
    "--trial", type=click.IntRange(min=1), metavar="N", help="Of a run folder; its first otherwise."
)
@verbs.rate_option
@verbs.many(
    "--quiet",
    type=verbs.span,
    metavar="T0:T1",
    help="Seconds in which nothing happens; all of it otherwise.",
)
@verbs.many("--touch", "touches", type=float, metavar="S", help="When something touched.")
@verbs.many("--slip", "slips", type=verbs.span, metavar="T0:T1", help="From when to when it slid.")
@click.option("--reference", metavar="C", help="A column that shows the touches: another sensor, a tap.")
@click.option("--per-newton", type=float, metavar="X", help="The sensor's reading for 1 N.")
@click.option("--unit", metavar="TEXT", help="Of the readings, where the column's name does not end in it.")
@verbs.many(
    "--detector", "detectors", metavar="NAME", help="Kinds; slip, force.threshold and onset otherwise."
)
@verbs.set_option
@click.option("--name", metavar="TEXT", help="The sensor's name on the page.")
@click.option("--out", type=verbs.FILE, default=Path("certificate"), show_default=True, metavar="FILE")
def characterize(
    recordings: tuple[Path, ...],
    overrides: dict[str, str],
    column: str | None,
    stream: str,
    trial: int | None,
    rate_hz: float | None,
    quiet: Sequence[tuple[float, float]],
    touches: Sequence[float],
    slips: Sequence[tuple[float, float]],
    reference: str | None,
    per_newton: float | None,
    unit: str | None,
    detectors: Sequence[str],
    name: str | None,
    out: Path,
) -> None:
    """What a sensor can do, from recordings of it: FILE.html, one page, and FILE.json.

    Noise, quantisation, drift, outliers, mains; latency and jitter against a reference; thresholds at 1, 10 and 100
    false alarms an hour and the delays at these; and what it cannot say, and what to record next. Times hold for every
    RECORDING. `compare A.json B.json` sets two beside each other.

    \b
    Example:
      run.py characterize microphone.wav --quiet 0:5 --touch 6.2 --touch 7.9
      run.py characterize load_cell.csv --column Force --reference Hammer --quiet 0:20 --unit N --per-newton 1
      run.py characterize drag.csv --column ft_v --rate 1000 --quiet 0:3 --slip 3.2:5 --out ft
    """
    from controller.characterize import SensorRecording, Truth, certificate

    made = _made(detectors, overrides)
    notes: list[str] = []
    given: list[SensorRecording] = []
    for path in recordings:
        where = source(path)
        how: Mapping[str, Any] = {"rate_hz": rate_hz, "trial": trial, "notes": notes}
        blocks = read_blocks(where, stream, column=column, **how)
        second = read_blocks(where, stream, column=reference, **how) if reference else ()
        if unit is not None:
            blocks = [replace(block, unit=unit) for block in blocks]
        given.append(SensorRecording(path.name, blocks, second))
    title = name or recordings[0].stem
    if per_newton is None and given[0].blocks[0].unit == "N":
        per_newton = 1.0
    try:
        found = certificate(given, Truth(quiet, touches, slips), made, name=title, per_newton=per_newton)
    except ValueError as error:
        raise ReplayError(f"{recordings[0]}: {error}") from None
    verbs.complain("\n".join(notes))
    _show(found, out)


def _made(kinds: Sequence[str], overrides: Mapping[str, str]) -> dict[str, Callable[[], Statistic]]:
    """What makes a detector of each kind, with other values for the settings of a single one."""
    if "threshold" in overrides:
        raise ProfileError("--set threshold: characterize finds the thresholds itself; leave it out")
    kinds = kinds or ("slip", "force.threshold", "onset")
    made: dict[str, Callable[[], Statistic]] = {}
    for kind in kinds:
        own = overrides if len(kinds) == 1 else {}
        one = make_detector(kind, own, None, ())
        if not isinstance(one, Statistic):
            raise not_calibratable(kind)
        made[kind] = partial(make_detector, kind, own, None, ())  # type: ignore[assignment]
    if overrides and len(kinds) != 1:
        raise ProfileError(f"--set {min(overrides)}: of which detector? name one with --detector")
    return made


def _show(found: Mapping[str, Any], out: Path) -> None:
    """Print what was found, and write both files."""
    from controller.characterize import HEADS, cells, page

    rows = [HEADS, *map(cells, found["rows"])]
    widths = [max(len(line[place]) for line in rows) for place in range(5)]
    for line in rows:
        click.echo("  ".join(cell.ljust(width) for cell, width in zip(line, widths, strict=False)).rstrip())
    for line in found["cannot_say"]:
        click.echo(f"cannot say: {line}")
    for path, text in (
        (out.with_suffix(".json"), json.dumps(found, indent=1) + "\n"),
        (out.with_suffix(".html"), page(found)),
    ):
        try:
            path.write_text(text, "utf-8")
        except OSError as error:
            raise click.BadParameter(f"{path}: {error.strerror or error}", param_hint="--out") from None
        click.echo(path)
