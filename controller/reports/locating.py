"""The part of the page on A4b: location along the link from the phase between two accelerometers."""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from behaviors.static import StaticFactors
from controller.recording.reader import Run
from controller.reports.counts import (
    Row,
    is_number,
    mean_of,
    number,
    quantity,
    rows_of,
    under,
    values,
    within_all,
)
from controller.reports.figures import FAINT, LOOKS, Figures
from controller.reports.section import Headline, Kind, Result, Section, kind_of
from controller.reports.stiffness import ARM_M, STIFFNESS, arm_of, from_tip_m

METHODS = {"phase_rad": "phase", "frequency_hz": "frequency, loop", "ring_hz": "frequency, ringing"}
"""What the location is read from, by column."""

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
    rows = [row for row in rows_of(runs, StaticFactors) if is_number(row.get("phase_rad"))]
    found = {column: list(located(rows, column)) for column in METHODS}
    usual = {column: [each for each in own if each.contact_n_m is None] for column, own in found.items()}
    other = {column: [each for each in own if each.contact_n_m is not None] for column, own in found.items()}
    kind = kind_of(runs)
    summary = []
    if usual["phase_rad"]:
        summary += [_said(kind, usual), *_said_of_stiffness(kind, other)]
    return Section(
        title="Location along the link from two accelerometers (A4b)",
        content={
            "by_location": list(_by_location(rows, usual)),
            "by_stiffness": list(_by_stiffness(other)),
            "figure": _draw(figures, rows, usual, other) if usual["phase_rad"] else "",
        },
        template="locating",
        paper="backus",
        summary=summary,
        headline=_headline(usual) if usual["phase_rad"] else None,
    )


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


def _errors(found: Sequence[Found]) -> list[float]:
    return [abs(each.found_m - each.true_m) for each in found]


def _holds(row: Row) -> bool:
    """Whether the loop holds its lock: what is read while it does not is of no frequency."""
    return is_number(wander_hz := row.get("frequency_sd_hz")) and wander_hz < LOST_HZ


def _headline(usual: Mapping[str, Sequence[Found]]) -> Headline:
    """The worst error of the phase, beside that of the ringing frequency."""
    worst = {column: max(_errors(found), default=math.nan) for column, found in usual.items()}
    phase, ringing = (quantity("error_m", worst[column], 1) for column in ("phase_rad", "ring_hz"))
    n = len(usual["phase_rad"])
    return Headline(
        "location from the phase, worst error",
        phase,
        f"largest of {n}",
        ringing,
        "from the ringing frequency instead",
        within_all(n),
        f"the phase finds a location within {phase}, the ringing frequency within {ringing}",
    )


def _said(kind: Kind, usual: Mapping[str, Sequence[Found]]) -> Result:
    held = {str(each.location) for each in usual["phase_rad"]}
    worst = {
        name: max(_errors([each for each in usual[column] if each.location in held]), default=math.nan)
        for column, name in METHODS.items()
    }
    text = f"A location that the line has not seen, {min(held)} to {max(held)}, is found within "
    text += ", ".join(f"{quantity('error_m', error_m, 1)} from the {name}" for name, error_m in worst.items())
    text += f" (worst of {len(usual['phase_rad'])}); the paper proposes the phase and prints no figure."
    return Result(kind, text)


def _said_of_stiffness(kind: Kind, other: Mapping[str, Sequence[Found]]) -> list[Result]:
    errors = {column: _errors(found) for column, found in other.items()}
    if not errors["phase_rad"]:
        return []
    text = "A contact 0.8 or 1.25 times as stiff is misplaced by as much as "
    text += ", ".join(f"{quantity('error_m', max(errors[c]), 1)} ({name})" for c, name in METHODS.items())
    text += ": the phase tells stiffness and location no better apart than the frequency does."
    return [Result(kind, text)]


def _by_location(rows: Sequence[Row], usual: Mapping[str, Sequence[Found]]) -> Iterator[Row]:
    for place in sorted({str(row["location"]) for row in rows}):
        own = [row for row in rows if row["location"] == place and row.get(STIFFNESS) is None]
        errors = {}
        for column, name in METHODS.items():
            here = [each for each in usual[column] if each.location == place]
            errors[name] = number(mean_of(_errors(here)).mean, 2, 1e3)
        yield {
            "location": place,
            **under("from_tip_m", from_tip_m(place), digits=2),
            "n": len(own),
            **under("phase_rad", mean_of(values(own, "phase_rad"))),
            **under("frequency_hz", mean_of(values(own, "frequency_hz"))),
            "mean error, mm, from the": errors,
        }


def _by_stiffness(other: Mapping[str, Sequence[Found]]) -> Iterator[Row]:
    for contact_n_m in sorted({each.contact_n_m or 0.0 for each in other["phase_rad"]}):
        off = {}
        for column, name in METHODS.items():
            off_m = [e.found_m - e.true_m for e in other[column] if e.contact_n_m == contact_n_m]
            off[name] = number(mean_of(off_m).mean, 1, 1e3)
        own = [each for each in other["phase_rad"] if each.contact_n_m == contact_n_m]
        yield {"contact, N/m": number(contact_n_m, 0), "n": len(own), "found minus true, mm, from the": off}


def _draw(
    figures: Figures,
    rows: Sequence[Row],
    usual: Mapping[str, Sequence[Found]],
    other: Mapping[str, Sequence[Found]],
) -> str:
    with figures.figure(2.8, columns=2) as drawing:
        near, far = drawing.axes
        for odd, found, look, label in (
            (False, usual["phase_rad"], LOOKS["ours"], "the pad's stiffness"),
            (True, other["phase_rad"], LOOKS["rival"], "another"),
        ):
            own = [row for row in rows if is_number(row.get(STIFFNESS)) == odd and _holds(row)]
            at_hz, phase = values(own, "frequency_hz"), np.degrees(values(own, "phase_rad"))
            near.plot(at_hz, phase, ls="", **look, label=label)
            far.plot([1e3 * e.true_m for e in found], [1e3 * e.found_m for e in found], ls="", **look)
        ends = [0.0, 25.4]
        far.plot(ends, ends, color=FAINT, lw=1.0, zorder=0)
        near.set(xlabel="frequency of the loop (Hz)", ylabel="phase, distal before proximal (°)")
        far.set(xlabel="true location, from the distal end (mm)", ylabel="found by the phase (mm)")
        drawing.legend(near, 2)
        return drawing.save("location_from_phase")
