"""What `run.py list` shows: names and summaries, nothing validated and nothing heavy imported."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from config.costs import counted, duration
from config.source import UNSET, ProfileError, bench_of, flatten, profile_names, read_source
from controller.registry import KINDS
from drivers.core.errors import PROGRAM


def listed_profiles() -> list[str]:
    """Every profile with its title, experiment, bench and devices; then the benches that they extend."""
    lines: list[str] = []
    benches: list[str] = []
    for name in profile_names():
        try:
            data = read_source(name).data
        except ProfileError as error:
            lines += [name, f"    broken: {error.problems[0]}"]
            continue
        if "parts" in data:
            lines += [
                f"{name:<28}{data.get('title', '')}",
                f"    one report of {', '.join(part.split()[0] for part in data['parts'])}",
            ]
            continue
        if "experiment" not in data:
            benches.append(name)
            continue
        lines += [
            f"{name:<28}{data.get('title', '')}",
            *_needs(data),
            f"        {counted(_trials(data))}: {duration(name, data['experiment'], bench_of(data), _trials(data))}",
        ]
    return [*lines, "", f"Benches to extend: {', '.join(benches)}", f"More of one: {PROGRAM} check PROFILE"]


def listed_kinds(family: str) -> list[str]:
    """Every driver, detector or signal."""
    return [f"{name:<20}{kind.summary}" for name, kind in KINDS[family].items()]


def _trials(data: Mapping[str, Any]) -> int:
    """How many a profile asks for."""
    asked = data.get("trials", {})
    cells = math.prod(len(values) for _, values in flatten(asked.get("grid", {})))
    return int(asked.get("repeats", 1)) * len(asked.get("list", [{}])) * cells


def _needs(data: Mapping[str, Any]) -> list[str]:
    """Bench and devices; ports where they are not all the bench's own."""
    bench, devices = bench_of(data), data.get("devices", {})
    drivers = ", ".join(f"{name} ({table.get('driver')})" for name, table in devices.items())
    lines = [f"    {data['experiment']} on the {bench} bench with {drivers}"]
    if any(table.get("port") != bench for table in devices.values()):
        ports = {name: str(table.get("port")) for name, table in devices.items()}
        lines += [
            f"        {name} at {'a port that is not set' if port.startswith(UNSET) else port}"
            for name, port in ports.items()
        ]
    return lines
