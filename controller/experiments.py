"""The experiments: one row names the behavior, its measure and its section of the report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from controller.named import found_beside, is_own


class Experiment(NamedTuple):
    """One experiment.

    Attributes:
        summary: One line for people.
        behavior: `module:Class` of the state machine, whose parameters name its settings and factors.
        measures: Module with `COLUMNS` and `measure`.
        report: Module whose `section(runs, figures)` reports it; "" for the standard section of any experiment.
        pooled: Whether that section is given trials in which a setting of the profile was varied together, and
            separates them by itself.
    """

    summary: str
    behavior: str
    measures: str
    report: str = ""
    pooled: bool = False


EXPERIMENTS: Mapping[str, Experiment] = {
    "aura": Experiment(
        "a finger approaches an object, may touch it, and comes back: pre-touch, contact, objects (C2, C4, C5)",
        "behaviors.aura:Aura",
        "controller.measures.aura",
        "controller.reports.aura",
    ),
    "centering": Experiment(
        "find an object between two fingers without touching it, go to the middle, close (C3)",
        "behaviors.centering:Centering",
        "controller.measures.centering",
        "controller.reports.centering",
    ),
    "chirp": Experiment(
        "sweep the drive for the frequency that transfers best (C1)",
        "behaviors.chirp:ChirpSweep",
        "controller.measures.chirp",
        "controller.reports.chirp",
    ),
    "flexion": Experiment(
        "approach while the tendon moves: a fixed threshold and one that follows the tendon (A3)",
        "behaviors.flexion:Flexion",
        "controller.measures.flexion",
        "controller.reports.flexion",
    ),
    "grasp": Experiment(
        "find an object by its aura, centre on it, close until it is felt, lift it, hold it against slip",
        "behaviors.grasp:Grasp",
        "controller.measures.grasp",
    ),
    "pointer": Experiment(
        "touch with the tip turned over its whole range: the contact's angle against the true one (B7)",
        "behaviors.pointer:Pointer",
        "controller.measures.pointer",
        "controller.reports.pointer",
        pooled=True,
    ),
    "proximal": Experiment(
        "approach to either link, and identify the touched one by an accelerometer on each (A4)",
        "behaviors.transient:Transient",
        "controller.measures.proximal",
        "controller.reports.proximal",
    ),
    "slip": Experiment(
        "touch, roll, slip, stop with one of five force sensors, and what slip detectors make of it (B1 to B5, B8)",
        "behaviors.slip:RollSlip",
        "controller.measures.slip",
        "controller.reports.slip",
        pooled=True,
    ),
    "static": Experiment(
        "none, light and full contact at rest: waveform, frequency, amplitude (A1)",
        "behaviors.static:Static",
        "controller.measures.static",
        "controller.reports.static",
    ),
    "tradeoff": Experiment(
        "approach to a depth: what every threshold on frequency, amplitude and phase would have detected (A5)",
        "behaviors.transient:Transient",
        "controller.measures.tradeoff",
        "controller.reports.tradeoff",
    ),
    "transient": Experiment(
        "approach until contact, stop, retract: delay, extent and force (A2, Table I)",
        "behaviors.transient:Transient",
        "controller.measures.transient",
        "controller.reports.transient",
        pooled=True,
    ),
    "weights": Experiment(
        "known weights on a bridge of the fingertip: gain, hysteresis, resolution (B6)",
        "behaviors.weights:Weights",
        "controller.measures.weights",
        "controller.reports.weights",
    ),
}


def experiment_of(name: str, folders: Sequence[Path] = ()) -> Experiment:
    """The row of an experiment.

    Args:
        name: In the table, or `module:Behavior` of the user's own: the module has `COLUMNS` and `measure` beside the
            behavior, and may have `section`. Its row is made of that; an unknown name's is empty.
        folders: Where a module of the user's own is looked for.

    Raises:
        NamedError: a module of the user's own that cannot be imported.
    """
    if not is_own(name):
        return EXPERIMENTS.get(name, Experiment("", "", ""))
    module = name.partition(":")[0]
    found_beside(name, folders)
    return Experiment("", name, module, module if hasattr(found_beside(module, folders), "section") else "")
