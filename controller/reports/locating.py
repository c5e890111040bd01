"""The part of the page on A4b: location along the link from the phase between two accelerometers."""

import math
from collections.abc import Iterator, Sequence
from typing import NamedTuple

import numpy as np

from behaviors.static import StaticFactors
from controller.recording.reader import Run
from controller.reports.counts import (
    Row,
    Trials,
    is_number,
    quantity,
    three,
    within_all,
)
from controller.reports.figures import FAINT, LOOKS, Figures
from controller.reports.run_account import setting_of
from controller.reports.section import Headline, Section, measured, told
from controller.reports.stiffness import ARM_M, STIFFNESS, arm_of, from_tip_m

METHODS = {"phase_rad": "phase", "frequency_hz": "frequency, loop", "ring_hz": "frequency, ringing"}
"""What the location is read from, by column."""

FACTORS = ("location", STIFFNESS)

LOST_HZ = 1.0
"""Standard deviation of the frequency from period to period from which the loop is taken to have lost its lock.
Assumption: 0.2 to 0.6 Hz where it holds."""


class Found(NamedTuple):
    """A trial's location as it was, and as it was found, from the distal end."""

    location: str
    true_m: float
    found_m: float
    contact_n_m: float | None


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """Errors of location by method, where the contact is as stiff as the line knows, and where it is not."""
    rows = Trials.of(runs, StaticFactors).where(lambda row: is_number(row.get("phase_rad")))
    found = {column: list(located(rows, column)) for column in METHODS}
    usual = {column: [each for each in own if each.contact_n_m is None] for column, own in found.items()}
    other = {column: [each for each in own if each.contact_n_m is not None] for column, own in found.items()}
    held = sorted({each.location for each in usual["phase_rad"]})
    heldby = {column: [each for each in own if each.location in held] for column, own in usual.items()}
    others_n_m = sorted({each.contact_n_m or 0.0 for each in other["phase_rad"]})
    pad_n_m = setting_of(runs[0], "plant", "pad_n_m")
    times = " or ".join(three(n_m / (pad_n_m or 1.0)) for n_m in others_n_m)
    content = {
        "held": held,
        "lost": sorted(
            {str(row["location"]) for row in rows} - {str(row["location"]) for row in rows if _holds(row)}
        ),
        "others": f"{times} times as stiff" if pad_n_m else f"of {' or '.join(map(three, others_n_m))} N/m",
        "n": len(usual["phase_rad"]),
        "worst_m": {METHODS[column]: _worst_m(own) for column, own in heldby.items()},
        "worst_other_m": {
            METHODS[column]: _worst_m(own) for column, own in other.items() if other["phase_rad"]
        },
        "measured": measured(rows.by(*FACTORS).values(), FACTORS, METHODS),
        "figure": _draw(figures, rows, usual["phase_rad"], other["phase_rad"]) if held else "",
    }
    heading = "Location along the link from two accelerometers (A4b)"
    if not held:
        return told(runs, heading, "locating", content, paper="backus")
    phase, ringing = (quantity("error_m", _worst_m(heldby[column]), 1) for column in ("phase_rad", "ring_hz"))
    headline = Headline(
        "location from the phase, worst error",
        phase,
        f"largest of {content['n']}",
        ringing,
        "from the ringing frequency instead",
        within_all(len(usual["phase_rad"])),
        f"the phase finds a location within {phase}, the ringing frequency within {ringing}",
    )
    return told(runs, heading, "locating", content, paper="backus", headline=headline)


def located(rows: Sequence[Row], column: str) -> Iterator[Found]:
    """Each trial's location by a line through the trials at all other locations, squared arm against squared frequency
    or phase; a contact of another stiffness than the pad's is in no line, and is sought with all that are."""
    known = [row for row in rows if is_number(row.get(column)) and (column == "ring_hz" or _holds(row))]
    curves = [row for row in known if row.get(STIFFNESS) is None]
    for row in known:
        odd = row.get(STIFFNESS)
        others = [each for each in curves if is_number(odd) or each["location"] != row["location"]]
        if len({each["location"] for each in others}) < 3:
            continue
        arms = [arm_of(str(each["location"])) ** 2 for each in others]
        slope, offset = np.polyfit([_abscissa(each, column) for each in others], arms, 1)
        arm_m = math.sqrt(max(0.0, slope * _abscissa(row, column) + offset))
        found_m = from_tip_m("f") + ARM_M - arm_m
        true_m = from_tip_m(str(row["location"]))
        yield Found(str(row["location"]), true_m, found_m, float(odd) if is_number(odd) else None)


def _abscissa(row: Row, column: str) -> float:
    """In what the square of the contact's arm is a straight line: a frequency's square (II), and so the phase."""
    return float(row[column]) ** (1 if column == "phase_rad" else 2)


def _holds(row: Row) -> bool:
    """Whether the loop holds its lock: what is read while it does not is of no frequency."""
    return is_number(wander_hz := row.get("frequency_sd_hz")) and wander_hz < LOST_HZ


def _worst_m(found: Sequence[Found]) -> float:
    return max((abs(each.found_m - each.true_m) for each in found), default=math.nan)


def _draw(figures: Figures, rows: Trials, usual: Sequence[Found], other: Sequence[Found]) -> str:
    with figures.figure(2.8, columns=2) as drawing:
        near, far = drawing.axes
        for odd, found, look, label in (
            (False, usual, LOOKS["ours"], "the pad's stiffness"),
            (True, other, LOOKS["rival"], "another"),
        ):
            own = Trials(row for row in rows if is_number(row.get(STIFFNESS)) == odd and _holds(row))
            near.plot(
                own.values("frequency_hz"), np.degrees(own.values("phase_rad")), ls="", **look, label=label
            )
            far.plot([1e3 * e.true_m for e in found], [1e3 * e.found_m for e in found], ls="", **look)
        ends = [0.0, 25.4]
        far.plot(ends, ends, color=FAINT, lw=1.0, zorder=0)
        near.set(xlabel="frequency of the loop (Hz)", ylabel="phase, distal before proximal (°)")
        far.set(xlabel="true location, from the distal end (mm)", ylabel="found by the phase (mm)")
        drawing.legend(near, 2)
        return drawing.save("location_from_phase")
