"""The verb `list`, for which nothing is loaded that any other needs."""

from __future__ import annotations

from collections.abc import Sequence

import click

from config import listing, verbs


@click.command("list", cls=verbs.Verb)
@click.argument("words", metavar="[WORD]...", nargs=-1)
@click.option("--mock", "benches", flag_value="mock", multiple=True, help="Only those of this bench.")
@click.option("--emulated", "benches", flag_value="emulated", multiple=True, help="Only those of this bench.")
@click.option("--hardware", "benches", flag_value="hardware", multiple=True, help="Only those of this bench.")
@click.option("--detectors", "shown", flag_value="detector", help="List kinds of detectors instead.")
@click.option("--signals", "shown", flag_value="signal", help="List kinds of signals instead.")
@click.option("--drivers", "shown", flag_value="driver", help="List drivers instead.")
def list_(words: Sequence[str], benches: Sequence[str], shown: str | None) -> None:
    """Show the profiles, or those in which every WORD stands: a name, an item as A2, an experiment, a driver.

    All fit on a screen; of those that fit it shows devices, ports to set, trials and time as well.

    \b
    Example:
      run.py list
      run.py list slip
      run.py list --hardware
      run.py list --detectors
    """
    lines = listing.listed_kinds(shown, words) if shown else listing.listed_profiles(words, benches)
    click.echo("\n".join(click.style(line, bold=True) if line[1:2] == ":" else line for line in lines))
