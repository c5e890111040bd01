"""The verb that looks for failures: `swarm`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import click

from config import verbs
from config.swarm.checkers import Violation
from config.swarm.hunt import Hunt, hunted, replayed, shrunk
from config.swarm.plan import SCENES
from drivers.core.errors import PROGRAM


def _seeds(value: str) -> range:
    try:
        first, last = (int(part) for part in value.split(":"))
    except ValueError:
        raise click.BadParameter(f"'{value}' is no range of seeds; write 0:1000") from None
    if not 0 <= first < last:
        raise click.BadParameter(f"{value} holds no seed; write 0:1000")
    return range(first, last)


@click.command(cls=verbs.Verb)
@click.option(
    "--seeds", type=_seeds, default="0:200", show_default=True, metavar="A:B", help="From A to before B."
)
@click.option("--profile", help="Check this plan, a profile with [[faults]], instead of seeds.")
@click.option("--minutes", type=click.FloatRange(0.0), help="Begin no other seed after so long.")
@verbs.many("--experiment", "experiments", help="Draw this experiment alone; repeatable.")
@click.option(
    "--out", type=verbs.FILE, default=Path("runs/swarm"), show_default=True, help="Folder of failing plans."
)
@click.option("--table", type=verbs.FILE, help="Write which cells were seen to this file.")
def swarm(
    seeds: Sequence[int],
    profile: str | None,
    minutes: float | None,
    experiments: Sequence[str],
    out: Path,
    table: Path | None,
) -> int:
    """Play short campaigns on mock benches in which things go wrong as a seed draws them, and check what must hold.

    A seed draws experiment, trials, settings, faults. What fails is made small and written as a profile of at most ten
    lines, which `run` plays and `swarm --profile` checks again.

    \b
    Example:
      run.py swarm --seeds 0:1000
      run.py swarm --profile runs/swarm/17.toml

    Exit codes: 0 all holds, 1 something does not.
    """
    if profile is not None:
        findings = replayed(Path(profile))
        for finding in findings:
            verbs.say(_line(finding))
        return 1 if findings else 0
    for name in experiments:
        if name not in SCENES:
            raise click.BadParameter(f"'{name}': it draws {', '.join(SCENES)}", param_hint="--experiment")
    hunt = Hunt()
    for seed, plan, deep, findings in hunted(seeds, hunt, experiments, minutes):
        first = findings[0]
        small, runs = shrunk(plan, deep, first.end)
        out.mkdir(parents=True, exist_ok=True)
        path = out / f"{seed}.toml"
        path.write_text(small.toml(f"{first.end} {first.checker}: seed {seed}, made small in {runs} runs"))
        verbs.say(f"seed {seed}: {_line(first)}; {path}: {PROGRAM} run {path}")
    verbs.say(hunt.summary())
    if table is not None:
        table.write_text(hunt.page())
    return 1 if hunt.findings else 0


def _line(found: Violation) -> str:
    where = [
        f"trial {found.trial}" if found.trial is not None else "",
        f"{found.t_s:.3f} s" if found.t_s is not None else "",
        found.state,
    ]
    return f"{found.end} ({found.checker}) {', '.join(part for part in where if part)}: {found.what}"
