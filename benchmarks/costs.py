"""What a trial of each shipped experiment costs on the mock bench: bench time, computing, disk; into config/costs.toml.

Beside each stands its former cost, from that file.

python -m benchmarks.costs [PROFILE...]: these alone; the others keep their measured values.
"""

import sys
import tempfile
import time
import tomllib
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

from config.assemble import build_rig, plan_campaign
from config.costs import COSTS
from config.profile import load_profile
from config.source import ProfileError, profile_names, read_source
from controller.campaign import Campaign
from controller.console import Console
from controller.recording.run_folder import RunFolder

TRIALS = 3
"""How many trials are run; the first one warms up, and is not counted."""


def main(names: Sequence[str] = (), *, quick: bool = False) -> None:
    """Run some trials of each profile that has an experiment on a simulated bench, and write the table."""
    names = names or (("mock/transient",) if quick else ())
    simulated = (name for name in profile_names() if name.startswith(("mock/", "emulated/")))
    shipped = {name: read_source(name).data for name in simulated}
    before = tomllib.loads(COSTS.read_text("utf-8"))
    table = {} if not names else dict(before)
    for name in names or [name for name, data in shipped.items() if "experiment" in data]:
        try:
            measured = _cost(name, shipped[name]["devices"])
        except ProfileError as error:  # its drivers have settings that no mock one knows
            print(f"{name:30} not in virtual time: {error.problems[0]}", flush=True)
            continue
        found = zip(("bench_s", "computing_s", "disk_bytes"), measured, strict=True)
        table[name] = {"experiment": shipped[name]["experiment"], **dict(found)}
        _write(table)
        was_s, is_s = before.get(name, {}).get("computing_s"), table[name]["computing_s"]
        ratio = "" if was_s is None else f"  before {was_s:.3g}, ratio {is_s / was_s:.2f}"
        print(f"{name:30} {is_s:.3g} s a trial{ratio}", flush=True)


def _write(table: dict[str, dict[str, Any]]) -> None:
    lines = ["# What a trial costs on the mock bench, by profile: python -m benchmarks.costs", ""]
    for name, row in sorted(table.items(), key=lambda item: (not item[0].startswith("mock/"), item[0])):
        lines += [f'["{name}"]', f'experiment = "{row["experiment"]}"']
        lines += [*(f"{key} = {value:.3g}" for key, value in row.items() if key != "experiment"), ""]
    COSTS.write_text("\n".join(lines), encoding="utf-8")


def _cost(name: str, devices: Iterable[str]) -> tuple[float, float, float]:
    """Of a profile's trials in virtual time, whichever bench it is for."""
    profile = load_profile(name, {f"devices.{device}.port": "mock" for device in devices})
    some = profile.trials(0)[:TRIALS]
    with tempfile.TemporaryDirectory() as folder:
        for part in (some[:1], some[1:] or some):  # the first warms up
            with closing(build_rig(profile)) as rig:
                begun_s = time.process_time()
                outcome = Campaign(plan_campaign(profile, part, 0), rig, Console(), Path(folder)).run()
                computing_s = time.process_time() - begun_s
        size = sum(path.stat().st_size for path in outcome.folder.iterdir())
        bench_s = float(RunFolder(outcome.folder).read_manifest()["loop"]["bench_s"])
    return bench_s / len(part), computing_s / len(part), size / len(part)


if __name__ == "__main__":
    main(sys.argv[1:])
