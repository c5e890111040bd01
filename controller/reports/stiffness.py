"""The part of the page on A6: frequency against the contact's stiffness, location and depth."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.static import StaticFactors
from controller.measures.stiffness import COLUMNS
from controller.recording.reader import Run
from controller.reports.counts import Trials, is_number, larger, near
from controller.reports.figures import FAINT, INK, LOOKS, Figures
from controller.reports.papers import table
from controller.reports.run_account import setting_of
from controller.reports.section import Kind, Section, kind_of, measured, told

INERTIA_KG_M2, JOINT_N_M_RAD, ARM_M = 1.2e-4, 2.5, 0.05
"""The paper's single link (II): I, k1, and l1, taken to mean location f."""

STIFFNESS, DEPTH = "plant.pad_n_m", "behavior.full_m"
"""Settings that trials vary."""

FACTORS = ("condition", STIFFNESS, "location", DEPTH)
"""In the order of the table."""

SEEN = {"loop": "frequency_hz", "ringing": "ring_hz"}
"""What is read in two ways, by its column: while the loop drives the finger, and after."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The paper's model, the loop and the ringing over stiffness, location and depth."""
    rows, usual_n_m = Trials.of(runs, StaticFactors), setting_of(runs[0], "plant", "pad_n_m")
    full = rows.where(condition="full")
    plain = full.where(**{STIFFNESS: None, DEPTH: None})
    free = rows.where(condition="none")
    stiff = ({0.0: free} if free else {}) | _numbered(full, STIFFNESS)
    places = {str(key[0]): own for key, own in plain.by("location").items()}
    deep = _numbered(full, DEPTH)
    printed = {row["stiffness_n_m"]: row for row in table("backus_model")}
    # free, the base's inertia was fitted to what the paper measured, 28 Hz, and not to its model
    kinds = {n_m: kind_of(runs, Kind.PREDICTED if n_m == 10000.0 else Kind.FITTED) for n_m in printed}
    ends = [places[end].mean("ring_hz") for end in ("d", "h") if end in places]
    forces = sorted((own.mean("force_n").mean, own.mean("frequency_hz")) for own in deep.values())
    return told(
        runs,
        "Frequency against stiffness, location and depth (A6)",
        "stiffness",
        {
            "modelled": [
                (row, kinds[n_m], own, ring, near(ring, row["frequency_hz"], row["tolerance_hz"]))
                for n_m, row in printed.items()
                if (own := stiff.get(n_m)) and not math.isnan((ring := own.mean("ring_hz")).mean)
            ],
            "ends": ends,
            "apart": larger(*ends) if len(ends) == 2 else None,
            "forces": forces,
            "rises": larger(forces[-1][1], forces[0][1]) if len(forces) > 1 else None,
            "measured": measured(rows.by(*FACTORS).values(), FACTORS, COLUMNS),
            "figure": _draw(figures, stiff, places, deep, usual_n_m),
        },
        paper="backus",
    )


def model_hz(contact_n_m: float, arm_m: float = ARM_M) -> float:
    """The paper's second equation: the resonance of its single link, Hz."""
    return math.sqrt((JOINT_N_M_RAD + contact_n_m * arm_m**2) / INERTIA_KG_M2) / (2.0 * math.pi)


def from_tip_m(location: str) -> float:
    """Where a location is, from the distal end (Table I)."""
    rows = table("backus_table_1")
    return float(next(row["micrometer_m"] for row in rows if row["location"] == location))


def arm_of(location: str) -> float:
    """From the joint to a location."""
    return ARM_M + from_tip_m("f") - from_tip_m(location)


def _numbered(rows: Trials, name: str) -> dict[float, Trials]:
    return {key[0]: own for key, own in rows.by(name).items() if is_number(key[0])}


def _draw(
    figures: Figures,
    by_stiffness: Mapping[float, Trials],
    by_location: Mapping[str, Trials],
    by_depth: Mapping[float, Trials],
    usual_n_m: Any,
) -> str:
    stiff = {n_m: own for n_m, own in by_stiffness.items() if n_m}
    at_mm = [1e3 * arm_of(where) for where in by_location]
    panels: list[tuple[str, Sequence[float], Mapping[Any, Trials], Any, Any]] = []
    if len(stiff) > 1:
        line = np.geomspace(min(stiff), max(stiff), 61)
        panels.append(("stiffness of the contact (N/m)", list(stiff), stiff, line, [*map(model_hz, line)]))
    if len(by_location) > 1:
        line = np.linspace(min(at_mm), max(at_mm), 61 if is_number(usual_n_m) else 0)
        model = [model_hz(usual_n_m, mm / 1e3) for mm in line]
        panels.append(("location: from the joint (mm)", at_mm, by_location, line, model))
    if len(by_depth) > 1:
        force_n = [own.mean("force_n").mean for own in by_depth.values()]
        panels.append(("depth: mean force (N)", force_n, by_depth, [], []))
    if not panels:
        return ""
    with figures.figure(2.7, columns=len(panels)) as drawing:
        for axes, (label, at, groups, line, model) in zip(drawing.axes, panels, strict=True):
            axes.plot(line, model, color=FAINT, lw=1.4, label="single link (the paper's equation)")
            for name, look, said in (("loop", "paper", "the loop"), ("ringing", "ours", "ringing")):
                seen_hz = [own.mean(SEEN[name]).mean for own in groups.values()]
                axes.plot(at, seen_hz, ls="", **LOOKS[look], label=said)
            axes.set(xlabel=label, xscale="log" if label.startswith("stiff") else "linear")
        if len(stiff) > 1:
            printed = [row for row in table("backus_model") if row["stiffness_n_m"]]
            hz = [row["frequency_hz"] for row in printed]
            crosses: Any = {"ls": "", "marker": "+", "ms": 9, "color": INK, "label": "printed"}
            drawing.axes[0].plot([row["stiffness_n_m"] for row in printed], hz, **crosses)
        drawing.axes[0].set_ylabel("frequency (Hz)")
        drawing.legend(drawing.axes[0], 4)
        return drawing.save("frequency_against_contact")
