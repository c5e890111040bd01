"""The command line of touchbench: arguments → profile → rig → run → exit code.

A verb reads its arguments in `config/verbs`. `run` loads a profile (`config/profile.py`), has the bench assembled
(`config/assemble.py`) and its trials run one by one (`controller/campaign.py`, `controller/loop.py`), and reports what
was recorded (`controller/reports`). Nothing heavy is imported before a verb needs it.
"""

from __future__ import annotations

import sys
import tomllib
from pathlib import Path

try:
    import click
except ModuleNotFoundError:
    sys.exit(f"{sys.executable} lacks click: call .venv/bin/python run.py, which `make run` sets up")

from config.verbs import Program
from drivers.core.errors import PROGRAM

VERBS = {
    "calibrate": ("recordings", "Find the threshold that a recording without events asks for."),
    "certify": ("certify", "Drive each limit of a bench past once: does it act?"),
    "characterize": ("characterize", "What a sensor can do, on one page, from its recordings."),
    "check": ("profiles", "Validate a profile, print its settings, try its bench."),
    "compare": ("results", "Show what differs between two runs."),
    "emulate": ("profiles", "Serve a profile's emulated devices."),
    "export": ("results", "Write a run in the formats of other programs."),
    "home": ("by_hand", "Send a profile's movers to their reference positions."),
    "jog": ("by_hand", "Move a device while a key is held."),
    "list": ("listing", "Show profiles, detectors, signals or drivers."),
    "merge": ("running", "Join the shards of a run."),
    "monitor": ("by_hand", "Show a profile's streams as they come; nothing moves."),
    "open": ("results", "Open the report of a run in the browser."),
    "plan": ("profiles", "Show what a run would take, move and compute."),
    "quiet": ("quiet", "Set thresholds by a minute at rest on the bench."),
    "record-set": ("results", "Write a run as a data set that others can load."),
    "replay": ("recordings", "Feed a recording to a detector."),
    "report": ("results", "Write the report of one or more runs."),
    "resume": ("running", "Go on with a run that broke off."),
    "run": ("running", "Run an experiment, write a run folder and its report."),
    "stop": ("by_hand", "Stop every mover of a profile, beside whatever runs."),
    "swarm": ("swarm", "Play short campaigns in which things go wrong, and check what must hold."),
    "sweep": ("recordings", "Find the resonance in a transducer's frequency sweep."),
    "tare": ("by_hand", "Take what force sensors read now for zero."),
    "watch": ("results", "Watch a run that goes on, in the browser."),
}
"""Of each verb its module in config/verbs, which is loaded when it is called, and what it does."""


def _print_version(ctx: click.Context, parameter: click.Parameter, wanted: bool) -> None:
    """Of the folder that this file is in, or of the package as it is installed."""
    if not wanted:
        return
    from importlib import metadata  # which loads what reads mail

    project = Path(__file__).with_name("pyproject.toml")
    if project.is_file():
        version = tomllib.loads(project.read_text(encoding="utf-8"))["project"]["version"]
    else:
        version = metadata.version("touchbench")
    click.echo(f"touchbench {version}")
    ctx.exit()


@click.group(cls=Program, verbs=VERBS, context_settings={"help_option_names": ["-h", "--help"]})
@click.option(
    "--version",
    is_flag=True,
    expose_value=False,
    is_eager=True,
    callback=_print_version,
    help="Print the version.",
)
def cli() -> None:
    """Run touch experiments on a robot bench: simulated, emulated on the wire, or real.

    A profile defines the bench, the experiment and the trials. To begin with:

    \b
      run.py list                    what there is
      run.py run mock/transient      42 approaches to a simulated finger, in seconds
      run.py VERB --help             more about a verb
    """


if __name__ == "__main__":
    cli(prog_name=PROGRAM)
