"""Verbs on recordings, of this program or another: `replay`, `calibrate`, `sweep`."""

import json
from pathlib import Path
from typing import Any

import click

from behaviors.events import BaselineReady
from config import verbs
from config.recordings import load, load_quiet, not_calibratable
from controller.detectors.calibration import Statistic
from controller.replay import as_line, calibration_line, nearest
from controller.replay import replay as replayed


@click.command(cls=verbs.Verb)
@verbs.recording_options
@click.argument("recording", type=verbs.FILE)
@click.option("--plot", type=verbs.FILE, metavar="FILE", help=verbs.PLOT_HELP)
def replay(detector: str, plot: Path | None, **given: Any) -> None:
    """Feed a RECORDING to a detector and print one JSON line an event.

    RECORDING is a run folder, a part of its name or `latest`, or a file: CSV (any separator, with or without a line of
    names), NPZ, MAT, WAV, MCAP. Of a run, a detector of the run's own profile has its settings there; where it has
    several of a kind, NAME is one of their names. A summary of the input goes to standard error.

    \b
    Example:
      run.py replay latest --detector resonance --trial 4
      run.py replay latest:mock/centering --detector right_ours
      run.py replay approach.csv --detector pretouch --column i,q --column x_m
      run.py replay finger.csv --detector resonance.paper --column period_s --baseline 2:3 --set threshold_sigma=4
      run.py replay drag.wav --detector slip --column 0 --set threshold=21 --plot drag.png
      run.py replay bag.mcap --detector slip --column /wrench:wrench.force.z
    """
    made, blocks, notes = load(detector, **given)
    events = list(replayed(blocks, made))
    verbs.complain("\n".join(notes))
    for event in events:
        click.echo(json.dumps(as_line(event, detector)))
    if all(isinstance(event, BaselineReady) for event in events):
        samples = sum(len(block) for block in blocks if block.stream == made.inputs[0])
        near = nearest(blocks, made)
        verbs.complain(f"{detector} found nothing in {samples} samples" + (f"; {near}" if near else ""))
    if plot is not None:
        from controller.replay_plot import draw

        for note in draw(plot, blocks, made, events):
            verbs.complain(note)


@click.command(cls=verbs.Verb)
@verbs.recording_options
@verbs.recordings_argument
@verbs.many(
    "--span",
    "spans",
    type=verbs.span,
    metavar="T0:T1",
    help="Seconds of each recording that are quiet; all of it otherwise. May be given several times.",
)
@verbs.interval_option(required=True)
def calibrate(detector: str, interval_s: float, **given: Any) -> None:
    """Find the threshold with which a detector alarms falsely once in a stated time, on average.

    A RECORDING is one in which nothing happens that the detector shall report, but everything that it shall not; if
    it has events too, name the quiet seconds with --span. It is a run folder (all its trials), a part of its name or
    `latest`, or a file as `replay` takes it. Prints one JSON line: the
    threshold, its 95 % interval, whether the recordings were so short that it was extrapolated, and the false alarms
    that thresholds gave on pieces which were left out when they were set. Of `pretouch` it proposes `background_fs`
    too, unless --set gives it: the threshold holds with that.

    \b
    Example:
      run.py calibrate rolling.csv --detector slip --column ft_v --rate 1000 --false-alarm-interval 3600
      run.py calibrate drag_*.csv --detector slip --span 0.5:2.2 --false-alarm-interval 60
      run.py calibrate latest --detector slip.paper --set input=board.flexible --false-alarm-interval 600
    """
    loaded = load_quiet(detector, **given)
    pieces = [(one.detector, one.blocks) for one in loaded if isinstance(one.detector, Statistic)]
    if not pieces:
        raise not_calibratable(detector)
    limits: list[str] = []
    line = calibration_line(pieces, detector, interval_s, given["overrides"], limits)
    verbs.complain("\n".join(dict.fromkeys([note for one in loaded for note in one.notes] + limits)))
    click.echo(json.dumps(line))


@click.command(cls=verbs.Verb)
@click.argument("table", type=verbs.FILE, metavar="FILE")
@click.option(
    "--column", metavar="F,A", help="Columns of frequency and response, where there are more than two."
)
@click.option(
    "--span",
    type=verbs.span,
    metavar="LOW:HIGH",
    help="Frequencies that count, Hz; all of them otherwise.",
)
@click.option("--conductance", is_flag=True, help="The response is a conductance, not an amplitude.")
@click.option("--plot", type=verbs.FILE, metavar="FILE", help="Draw it: a PNG, SVG or PDF file.")
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
    from controller.sweep import draw_sweep, read_sweep, sweep_line

    measured = read_sweep(table, column, span, "conductance" if conductance else "amplitude")
    verbs.complain(measured.note)
    click.echo(json.dumps(sweep_line(measured.figures)))
    if plot is not None:
        draw_sweep(plot, measured)
