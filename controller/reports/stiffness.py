"""The part of the page on A6: frequency against the contact's stiffness, location and depth."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from behaviors.static import StaticFactors
from controller.recording.reader import Run
from controller.reports.counts import (
    Row,
    grouped,
    is_number,
    larger,
    mean_of,
    near,
    number,
    rows_of,
    signed,
    under,
    values,
)
from controller.reports.figures import FAINT, INK, LOOKS, Figures
from controller.reports.papers import table
from controller.reports.run_account import setting_of
from controller.reports.section import Kind, Result, Section, judged, kind_of
from controller.scales import NOTHING

INERTIA_KG_M2, JOINT_N_M_RAD, ARM_M = 1.2e-4, 2.5, 0.05
"""The paper's single link (II): I, k1, and l1, taken to mean location f."""

STIFFNESS, DEPTH = "plant.pad_n_m", "behavior.full_m"
"""Settings that trials vary."""

SEEN = {"loop": "frequency_hz", "ringing": "ring_hz"}
"""What is read in two ways, by its column: while the loop drives the finger, and after."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The paper's model, the loop and the ringing over stiffness, location and depth."""
    rows, kind = rows_of(runs, StaticFactors), kind_of(runs)
    usual_n_m = setting_of(runs[0], "plant", "pad_n_m")
    full = [row for row in rows if row.get("condition") == "full"]
    plain = [row for row in full if row.get(STIFFNESS) is None and row.get(DEPTH) is None]
    by_stiffness: dict[float, Sequence[Row]] = {
        0.0: [row for row in rows if row.get("condition") == "none"],
        **{n_m: own for (n_m,), own in grouped(full, STIFFNESS).items() if is_number(n_m)},
    }
    by_location = {key[0]: own for key, own in grouped(plain, "location").items()}
    by_depth = {key[0]: own for key, own in grouped(full, DEPTH).items() if is_number(key[0])}
    stiff = [_stiffness_row(n_m, own) for n_m, own in sorted(by_stiffness.items()) if own]
    return Section(
        title="Frequency against stiffness, location and depth (A6)",
        content={
            "stiffness": stiff,
            "location": [_location_row(str(where), own, usual_n_m) for where, own in by_location.items()],
            "depth": [_depth_row(place_m, own) for place_m, own in by_depth.items()],
            "figure": _draw(figures, by_stiffness, by_location, by_depth, usual_n_m),
            "usual": number(usual_n_m, 0) if is_number(usual_n_m) else "",
        },
        template="stiffness",
        paper="backus",
        summary=[*_beside_the_model(by_stiffness, kind), *_trends(by_location, by_depth, kind)],
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


def _mean(rows: Sequence[Row], column: str) -> float:
    return mean_of(values(rows, column)).mean


def _seen(rows: Sequence[Row]) -> Row:
    """How the finger oscillated, by both ways to read it."""
    seen = {name: number(_mean(rows, column), 1) for name, column in SEEN.items()}
    return {"finger, Hz": {**seen, "σ of a period": number(_mean(rows, "frequency_sd_hz"), 2)}}


def _stiffness_row(contact_n_m: float, own: Sequence[Row]) -> Row:
    printed = next((row for row in table("backus_model") if row["stiffness_n_m"] == contact_n_m), None)
    return {
        "contact, N/m": number(contact_n_m, 0) if contact_n_m else "none",
        "n": len(own),
        "single link, Hz": {
            "paper": f"{printed['frequency_hz']:g}" if printed else NOTHING,
            "its equation": number(model_hz(contact_n_m), 1),
        },
        **_seen(own),
        **under("amplitude_m_s2", _mean(own, "amplitude_m_s2"), digits=2),
    }


def _location_row(location: str, own: Sequence[Row], usual_n_m: Any) -> Row:
    model = number(model_hz(usual_n_m, arm_of(location)), 1) if is_number(usual_n_m) else NOTHING
    return {
        "location": location,
        **under("from_joint_m", arm_of(location), digits=1),
        "n": len(own),
        "single link, Hz": {"its equation": model},
        **_seen(own),
        **under("force_n", _mean(own, "force_n"), digits=2),
    }


def _depth_row(place_m: float, own: Sequence[Row]) -> Row:
    return {
        **under("probe_at_m", place_m, digits=1),
        "n": len(own),
        **under("force_n", _mean(own, "force_n"), digits=3),
        "touches": f"{number(_mean(own, 'touching'), 0, 100.0)} %",
        **_seen(own),
        **under("amplitude_m_s2", _mean(own, "amplitude_m_s2"), digits=2),
    }


def _beside_the_model(by_stiffness: Mapping[float, Sequence[Row]], usual: Kind) -> list[Result]:
    """The printed frequencies of the model, beside what rings."""
    results = []
    for printed in table("backus_model"):
        own, stiff = by_stiffness.get(printed["stiffness_n_m"], ()), printed["stiffness_n_m"] == 10000.0
        ring = mean_of(values(own, "ring_hz"))
        ring_hz = ring.mean
        if math.isnan(ring_hz):
            continue
        text = f"{printed['contact'].capitalize()}"
        text += f" ({number(printed['stiffness_n_m'], 0)} N/m)" if printed["stiffness_n_m"] else ""
        text += f": the finger rings at {number(ring_hz, 1)} Hz, the paper's single link at {printed['frequency_hz']:g}"
        text += f" ({signed(ring_hz - printed['frequency_hz'], 1)})"
        # free, the base's inertia was fitted to what the paper measured, 28 Hz, and not to its model
        kind = usual if stiff or usual is Kind.MEASURED else Kind.FITTED
        met = near(ring, printed["frequency_hz"], printed["tolerance_hz"])
        results.append(judged(kind, text, met, ring.n))
        loop_hz = _mean(own, "frequency_hz")
        if stiff and abs(loop_hz - ring_hz) > 5.0:
            lost = f"The loop does not follow to there: it stays at {number(loop_hz, 0)} Hz, where the accelerometer's "
            lost += f"amplitude is {number(_mean(own, 'amplitude_m_s2'), 2)} m/s²."
            results.append(Result(usual, lost))
    return results


def _trends(
    by_location: Mapping[Any, Sequence[Row]], by_depth: Mapping[Any, Sequence[Row]], kind: Kind
) -> list[Result]:
    """V.A: location and depth shift the frequency too."""
    results = []
    ends = [mean_of(values(by_location[where], "ring_hz")) for where in ("d", "h") if where in by_location]
    if len(ends) == 2:
        far, close = ends
        text = f"The same contact rings at {number(far.mean, 1)} Hz at the distal end and at "
        text += f"{number(close.mean, 1)} at location h, 25.4 mm nearer the joint; "
        text += "the paper's model says that location matters"
        results.append(judged(kind, text, larger(far, close), min(far.n, close.n)))
    deep = [(_mean(own, "force_n"), mean_of(values(own, "frequency_hz"))) for own in by_depth.values()]
    if len(deep) > 1:
        (low_n, low), (high_n, high) = min(deep), max(deep)
        text = f"From {number(low_n, 2)} N to {number(high_n, 2)} N the loop rises from {number(low.mean, 1)} to "
        text += f"{number(high.mean, 1)} Hz; the paper: between light and full contact frequency rises with "
        text += "force"
        results.append(judged(kind, text, larger(high, low), min(high.n, low.n)))
    return results


def _draw(
    figures: Figures,
    by_stiffness: Mapping[float, Sequence[Row]],
    by_location: Mapping[Any, Sequence[Row]],
    by_depth: Mapping[Any, Sequence[Row]],
    usual_n_m: Any,
) -> str:
    stiff = {n_m: own for n_m, own in by_stiffness.items() if n_m}
    panels = []
    if len(stiff) > 1:
        line = np.geomspace(min(stiff), max(stiff), 61).tolist()
        curve = (line, [model_hz(n_m) for n_m in line])
        panels.append(("stiffness of the contact (N/m)", list(stiff), list(stiff.values()), curve))
    if len(by_location) > 1:
        at_mm = [1e3 * arm_of(str(where)) for where in by_location]
        line = np.linspace(min(at_mm), max(at_mm), 61).tolist() if is_number(usual_n_m) else []
        curve = (line, [model_hz(usual_n_m, mm / 1e3) for mm in line])
        panels.append(("location: from the joint (mm)", at_mm, list(by_location.values()), curve))
    if len(by_depth) > 1:
        force_n = [_mean(own, "force_n") for own in by_depth.values()]
        panels.append(("depth: mean force (N)", force_n, list(by_depth.values()), ([], [])))
    if not panels:
        return ""
    with figures.figure(2.7, columns=len(panels)) as drawing:
        for axes, (label, at, groups, curve) in zip(drawing.axes, panels, strict=True):
            axes.plot(*curve, color=FAINT, lw=1.4, label="single link (the paper's equation)")
            for name, look, said in (("loop", "paper", "the loop"), ("ringing", "ours", "ringing")):
                seen_hz = [_mean(own, SEEN[name]) for own in groups]
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
