"""Compiles what the shipped profiles need, so that no run has to wait for it: `python -m config.precompile`."""

from collections.abc import Iterator
from contextlib import closing
from importlib import import_module
from typing import Any

from config.assemble import build_rig, make_detectors, make_signals
from config.profile import load_profile
from config.source import profile_names, read_source
from controller.detectors.protocol import Compiled
from controller.registry import KINDS
from drivers.core.compiled import make_signed


def parts() -> Iterator[Any]:
    """Benches, signals and detectors of the mock profiles, those with equal settings once."""
    seen = []
    for name in profile_names():
        if not name.startswith("mock/") or "experiment" not in read_source(name).data:
            continue
        profile = load_profile(name)
        with closing(build_rig(profile)):
            pass  # which loads the drivers and their kinematics
        assert profile.plant is not None
        made: list[tuple[Any, Any]] = [(profile.plant, profile.plant.made(profile.plant.settings))]
        made += zip(profile.signals.values(), make_signals(profile), strict=True)
        made += zip(profile.detectors.values(), make_detectors(profile).values(), strict=True)
        for entry, part in made:
            if entry not in seen:
                seen.append(entry)
                yield part


if __name__ == "__main__":
    for part in parts():
        if isinstance(part, Compiled):  # and a bench has the same method
            part.warm_up()
    for driver in KINDS["driver"].values():  # an emulated arm has kernels that no mock one needs
        if driver.emulated:
            import_module(driver.emulated.partition(":")[0])
    make_signed()
