"""The part of the page on A4: which link was touched."""

from collections.abc import Sequence
from typing import Any

from controller.measures.proximal import COLUMNS
from controller.recording.reader import Run
from controller.reports.counts import Row, decided, mean_of, rate, total, under, values
from controller.reports.figures import Figures
from controller.reports.run_account import acting_of, criterion_of
from controller.reports.section import Result, Section, judged, kind_of, rated

RELIABLY = 0.9
"""Share of contacts that is called so (assumption): the paper prints no figure."""


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The confusion table, and delay and force by link."""
    rows = [row for run in runs for row in run.trials]
    near, far = ([row for row in rows if (row.get("location") == "p") == own] for own in (True, False))
    of = {"proximal": near, "distal": far}
    named = sum(bool(row.get("identified")) for row in rows)
    right = sum(row.get("identified") == link for link, own in of.items() for row in own)
    felt = sum(row.get("outcome") == "contact" for row in near)
    kind, met = kind_of(runs), decided(felt, len(near), RELIABLY)
    detected = (
        f"Contact on the proximal link is detected in {rate(felt, len(near))} of the approaches; the paper: "
    )
    told = f"The right link was named for {rate(right, named)} of the detected contacts; the paper has no figure."
    return Section(
        title="Contact on either link (A4)",
        content={
            "criterion": criterion_of(runs[0], acting_of(runs[0])),
            "confusion": [_row(link, own) for link, own in of.items()],
        },
        template="proximal",
        paper="backus",
        summary=[
            judged(kind, f"{detected}reliably, by preliminary results", met, len(near)),
            Result(kind, told),
        ],
        headline=rated("contacts whose link was named right", right, named) if named else None,
    )


def _row(link: str, own: Sequence[Row]) -> Row:
    named = [row.get("identified") for row in own]
    line: dict[str, Any] = {}
    for name in ("ratio_db", "delay_s", "force_n"):
        line |= under(name, mean_of(values(own, name)), digits=COLUMNS[name].digits)
    return {
        "touched": link,
        "n": len(own),
        "named": {each: named.count(each) for each in ("proximal", "distal")},
        "false": total(own, "false_contacts"),
        **line,
    }
