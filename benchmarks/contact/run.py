"""The contact study: `python -m benchmarks contact [--quick]`; writes results/contact.json.

Results are cached under runs/benchmarks by their inputs: an interrupted study continues.
"""

from __future__ import annotations

import pickle
from collections.abc import Iterator, Mapping, Sequence
from hashlib import sha256
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from benchmarks.contact.bound import bound, separations, waited, waits
from benchmarks.contact.holding import held
from benchmarks.contact.rivals import OURS
from benchmarks.contact.scenes import level
from benchmarks.contact.study import (
    SEED_JUDGED,
    SEED_SET,
    Key,
    Record,
    batch,
    compared,
    joined,
    swept,
)
from benchmarks.results import save, workers

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[1]

SOURCES = (
    *(path for path in HERE.glob("*.py") if path.name != "run.py"),
    *ROOT.glob("controller/detectors/resonance*.py"),
    ROOT / "controller" / "signals" / "envelope.py",
    *(path for path in ROOT.glob("drivers/mock/physics/finger*.py") if path.name != "finger_part.py"),
)
"""Files on which the cached batches depend."""

CHUNK = 50

SOME = 28
"""Approaches with each assumption broken: two per row of Table I."""

LEVELS = {"printed": "As printed", "hard": "Hard"}

CHANGES: Mapping[str, Mapping[str, float]] = {
    "tendon friction of 50 uN m": {"tendon_friction_n_m": 5e-5},
    "ripple of 10 % at 100 Hz": {"drive_ripple": 0.1},
    "drift of the frequency by 1 % a minute": {"drift_1_s": 2.0 * 0.01 / 60.0},
    # a fortieth of the oscillation
    "vibration at 12 Hz": {"vibration_m_s2": 0.05, "vibration_hz": 12.0},
    "vibration at 28 Hz": {"vibration_m_s2": 0.05, "vibration_hz": 28.0},
    "sliding probe, 0.3 times 8 mm": {"slide_m": 0.0024},
}
"""Further effects of a real finger, one by one. Their sizes are assumptions."""

BROKEN = (0.05, 0.1, 0.3)

TAKEN: Mapping[str, tuple[Sequence[str], int]] = {
    "resonance higher": (("joint_n_m_rad",), 2),
    "Q lower": (("joint_n_m_s_rad", "base_n_m_s_rad"), 1),
    "drive weaker": (("drive_n_m",), -1),
    "contact softer": (("pad_n_m", "back_n_m"), -1),
    "more of the noise slow": (("wander",), 1),
}
"""Settings of the finger that differ from the one used for thresholds, and the exponent."""


class Task(NamedTuple):
    """Some approaches, generated and evaluated in one process."""

    scene: str
    seed: int
    first: int
    approaches: int
    settings: Mapping[str, Any]
    noise: float = 1.0

    def run(self) -> Any:
        """Results of all variants."""
        return batch(
            self.settings, self.seed, range(self.first, self.first + self.approaches), noise=self.noise
        )


class Holds(NamedTuple):
    """Approaches with a probe that stands and leaves."""

    scene: str
    approaches: int

    def run(self) -> Any:
        """Results of the program's detector."""
        return held(self.scene, self.approaches)


class Bound(NamedTuple):
    """Approaches with and without the probe."""

    scene: str
    first: int
    approaches: int

    def run(self) -> Any:
        """How far the two lie apart."""
        return separations(self.scene, self.approaches, self.first)


class Waits(NamedTuple):
    """Approaches with a probe that stands, and with one that is gone."""

    scene: str
    approaches: int

    def run(self) -> Any:
        """When the two can be distinguished."""
        return waits(self.scene, self.approaches)


def tasks(quick: bool) -> Iterator[Task | Holds | Bound | Waits]:
    """All tasks."""
    some = 7 if quick else SOME
    for name in LEVELS:
        finger = level(name).model_dump()
        for seed, many in ((SEED_SET, 500), (SEED_JUDGED, 1000)):
            for first in range(0, CHUNK if quick else many, CHUNK):
                yield Task(name, seed, first, CHUNK, finger)
        yield Holds(name, 7 if quick else 98)
        yield Bound(name, 0, 7 if quick else 56)
        yield Waits(name, 7 if quick else 98)
    printed = level("printed").model_dump()
    yield Task("none", SEED_JUDGED, 0, some, printed)
    for share in BROKEN:
        yield Task(f"noise {share:.0%} larger after the baseline", SEED_JUDGED, 0, some, printed, 1.0 + share)
    for name, (settings, power) in TAKEN.items():
        for share in BROKEN:
            changed = {each: printed[each] * (1.0 + share) ** power for each in settings}
            yield Task(f"{name} by {share:.0%}", SEED_JUDGED, 0, some, {**printed, **changed})
    for name, other in CHANGES.items():
        yield Task(name, SEED_JUDGED, 0, some, {**printed, **other})


def main(quick: bool = False) -> None:
    """Run the study, or the rest of it."""
    code = sha256(b"".join(path.read_bytes() for path in sorted(SOURCES))).hexdigest()[:12]
    folder = ROOT / "runs" / "benchmarks" / f"contact_{code}"
    folder.mkdir(parents=True, exist_ok=True)
    wanted = list(tasks(quick))
    with workers() as pool:
        done = list(pool.map(_kept, wanted, [folder] * len(wanted)))
    found = figures(dict(zip(wanted_names(wanted), done, strict=True)))
    save("contact", found, quick=quick)


def _kept(task: Task | Holds | Bound | Waits, folder: Path) -> Any:
    path = folder / (sha256(repr((type(task).__name__, *task)).encode()).hexdigest()[:16] + ".pickle")
    if not path.exists():
        done = task.run()
        path.with_suffix(".part").write_bytes(pickle.dumps(done))
        path.with_suffix(".part").rename(path)
    return pickle.loads(path.read_bytes())


def wanted_names(wanted: Sequence[Task | Holds | Bound | Waits]) -> list[tuple[Any, ...]]:
    """Key of each result."""
    return [(type(task).__name__, *task[: 3 if isinstance(task, Task) else 2]) for task in wanted]


def figures(done: Mapping[tuple[Any, ...], Any]) -> dict[str, Any]:
    """All figures of the study."""
    parts: dict[tuple[str, int], list[Mapping[Key, Record]]] = {}
    for key, result in done.items():
        if key[0] == "Task":
            parts.setdefault((key[1], key[2]), []).append(result)
    records = {key: joined(each) for key, each in parts.items()}
    return {
        "approaches": [len(records["hard", seed][OURS, "all"].before) for seed in (SEED_SET, SEED_JUDGED)],
        "levels": {name: compared(records[name, SEED_SET], records[name, SEED_JUDGED]) for name in LEVELS},
        "curves": {name: swept(records[name, SEED_SET], records[name, SEED_JUDGED]) for name in LEVELS},
        "broken": {
            scene: compared(records["printed", SEED_SET], each)
            for (scene, _), each in records.items()
            if scene not in LEVELS
        },
        "held": {
            name: next(each for key, each in done.items() if key[:2] == ("Holds", name)) for name in LEVELS
        },
        "bound": {
            name: bound(np.concatenate([each for key, each in done.items() if key[:2] == ("Bound", name)]))
            for name in LEVELS
        },
        "waits": {
            name: next(waited(each) for key, each in done.items() if key[:2] == ("Waits", name))
            for name in LEVELS
        },
    }
