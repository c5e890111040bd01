"""What a trial of each shipped experiment costs on the mock bench: bench time, computing, disk; into config/costs.toml.

python -m benchmarks.costs
"""

from __future__ import annotations

import tempfile
import time
from contextlib import closing
from pathlib import Path

from config.assemble import Table, build_rig, plan_campaign
from config.costs import COSTS
from config.jobs import Silent
from config.profile import load_profile
from config.source import profile_names, read_source
from controller.campaign import Campaign

TRIALS = 3
"""How many trials are run; the first one warms up, and is not counted."""


def main(*, quick: bool = False) -> None:
    """Run some trials of each mock profile that has an experiment, and write the table."""
    lines = ["# What a trial costs on the mock bench, by profile: python -m benchmarks.costs", ""]
    for name in profile_names():
        if name.startswith("mock/") and "experiment" in read_source(name).data:
            bench_s, computing_s, disk_bytes = _cost(name, 2 if quick else TRIALS)
            table = {"bench_s": bench_s, "computing_s": computing_s, "disk_bytes": disk_bytes}
            experiment = read_source(name).data["experiment"]
            lines += [f'["{name}"]', f'experiment = "{experiment}"']
            lines += [*(f"{key} = {value:.3g}" for key, value in table.items()), ""]
            print(name, table, flush=True)
    COSTS.write_text("\n".join(lines), encoding="utf-8")


def _cost(name: str, trials: int) -> tuple[float, float, float]:
    profile = load_profile(name, table=Table())
    some = profile.trials(0)[:trials]
    found = []
    with tempfile.TemporaryDirectory() as folder:
        for part in (some[:1], some[1:] or some):
            with closing(build_rig(profile)) as rig:
                begun_s = time.process_time()
                outcome = Campaign(plan_campaign(profile, part, 0), rig, Silent(), Path(folder)).run()
                computing_s = time.process_time() - begun_s
                bench_s = rig.clock.now() if len(part) == 1 else _bench_s(outcome.folder)
            size = sum(path.stat().st_size for path in outcome.folder.iterdir())
            found.append([each / len(part) for each in (bench_s, computing_s, size)])
    return found[-1][0], found[-1][1], found[-1][2]


def _bench_s(folder: Path) -> float:
    from controller.recording.run_folder import RunFolder

    return float(RunFolder(folder).read_manifest()["loop"]["bench_s"])


if __name__ == "__main__":
    main()
