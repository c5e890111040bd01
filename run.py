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

from config.verbs import (
    Program,
    by_hand,
    certify,
    characterize,
    profiles,
    quiet,
    recordings,
    results,
    running,
    swarm,
)
from drivers.core.errors import PROGRAM


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


@click.group(cls=Program, context_settings={"help_option_names": ["-h", "--help"]})
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


for _module in (profiles, certify, running, by_hand, recordings, characterize, quiet, results, swarm):
    for _verb in _module.VERBS:
        cli.add_command(_verb)


if __name__ == "__main__":
    cli(prog_name=PROGRAM)
