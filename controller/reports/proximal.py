"""The part of the page on A4: which link was touched."""

from collections.abc import Sequence

from controller.recording.reader import Run
from controller.reports.counts import Trials, decided
from controller.reports.figures import Figures
from controller.reports.run_account import acting_of, criterion_of
from controller.reports.section import Section, measured, rated, told

RELIABLY = 0.9
"""Share of contacts that is called so (assumption): the paper prints no figure."""

MEANS = ("ratio_db", "delay_s", "force_n")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The confusion table, and delay and force by link."""
    rows = Trials.of(runs)
    near = rows.where(location="p")
    of = {"proximal": near, "distal": rows.where(lambda row: row.get("location") != "p")}
    names = {link: [row.get("identified") for row in own] for link, own in of.items()}
    named = sum(bool(row.get("identified")) for row in rows)
    right = sum(names[link].count(link) for link in of)
    felt = sum(row.get("outcome") == "contact" for row in near)
    content = {
        "criterion": criterion_of(runs[0], acting_of(runs[0])),
        "felt": (felt, len(near)),
        "told": (right, named),
        "met": decided(felt, len(near), RELIABLY),
        "confusion": [
            {
                "touched": link,
                "named": {each: names[link].count(each) for each in of},
                "false": own.total("false_contacts"),
                **measured([own], (), MEANS)[0],
            }
            for link, own in of.items()
        ],
    }
    headline = rated("contacts whose link was named right", right, named) if named else None
    if headline and decided(right, named, RELIABLY) is False:
        headline = headline._replace(state="partly")
    heading = "Contact on either link (A4)"
    return told(runs, heading, "proximal", content, paper="backus", headline=headline)
