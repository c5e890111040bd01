"""Storage of benchmark figures, with the machine they were measured on."""

from __future__ import annotations

import json
import multiprocessing
import os
import platform
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import ProcessPoolExecutor
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import pandas as pd

FOLDER = Path(__file__).resolve().parent / "results"


def machine() -> dict[str, Any]:
    """The machine: ratios hold elsewhere, absolute times do not."""
    model = ""
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8").splitlines()
        model = next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")
    return {
        "cpu": model or platform.processor(),
        "cores": os.cpu_count(),
        "python": platform.python_version(),
        "date": datetime.now(UTC).date().isoformat(),
    }


def workers() -> ProcessPoolExecutor:
    """A process per core, each a fresh interpreter: a fork after loading numba's threads may hang."""
    return ProcessPoolExecutor(os.cpu_count(), multiprocessing.get_context("spawn"))


def progress(what: str) -> None:
    """Print the progress of a study, with the time of day."""
    print(f"{time.strftime('%H:%M:%S')}  {what}", flush=True)


def save(name: str, result: Mapping[str, Any], *, quick: bool = False) -> None:
    """Write one benchmark's figures as JSON, and print them; those of a quick run to build/quick. The page beside them
    is written by hand."""
    folder = Path("build/quick") if quick else FOLDER
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.json"
    path.write_text(json.dumps({"machine": machine(), **result}, indent=2) + "\n", encoding="utf-8")
    print("\n".join(shown(result)))


def shown(value: Any, title: str = "") -> Iterator[str]:
    """Rows as a table each, numbers as lines; lists of single measurements stay in the file."""
    if isinstance(value, Mapping):
        rows = list(value.values())
        if not rows or not all(isinstance(row, Mapping) for row in rows) or any(map(_deep, rows)):
            for key, part in value.items():
                yield from shown(part, f"{title}: {key}" if title else str(key))
            return
        value = [{"": key, **row} for key, row in value.items()]
    if not isinstance(value, (list, tuple)):
        yield f"{title}: {value:.4g}" if isinstance(value, float) else f"{title}: {value}"
    elif value and all(isinstance(row, Mapping) for row in value):
        flat = pd.json_normalize(list(value))
        columns = [name for name in flat if not any(isinstance(cell, (list, tuple)) for cell in flat[name])]
        yield f"\n{title}\n{flat[columns].to_string(index=False, float_format='{:.4g}'.format)}\n"


def _deep(row: Mapping[str, Any]) -> bool:
    """Whether it is a list of rows."""
    return all(isinstance(cell, Mapping) for cell in row.values())
