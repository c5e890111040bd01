"""The part of the page on A4: which link was touched."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from controller.recording.reader import Run
from controller.reports.approaches import mean_of
from controller.reports.counts import rate, total, values
from controller.reports.figures import Figures
from controller.reports.paper import CITATION, SETTLE
from controller.reports.run_account import acting_of, criterion_of
from controller.reports.section import Kind, Result, Section
from controller.reports.section_texts import SectionTexts

TEXTS = SectionTexts("proximal")

LINKS = ("proximal", "distal")


def section(runs: Sequence[Run], figures: Figures) -> Section:
    """The confusion table, and delay and force by link."""
    rows: list[dict[str, Any]] = [dict(row) for run in runs for row in run.trials]
    for row in rows:
        row["link"] = "proximal" if row.get("location") == "p" else "distal"
    named = [row for row in rows if row.get("identified")]
    right = sum(row["identified"] == row["link"] for row in named)
    near = [row for row in rows if row["link"] == "proximal"]
    kind = Kind.PREDICTED if runs[0].simulated else Kind.MEASURED
    felt = sum(row.get("outcome") == "contact" for row in near)
    return Section(
        title="Contact on either link (A4)",
        body=[
            TEXTS.text("intro", criterion=criterion_of(runs[0], acting_of(runs[0]))),
            TEXTS.table("confusion", [_row(link, rows) for link in LINKS]),
        ],
        citation=CITATION,
        summary=[
            Result(
                kind,
                TEXTS.sentence("felt", felt=rate(felt, len(near))),
                felt > 0.9 * len(near) if near else None,
            ),
            Result(kind, TEXTS.sentence("right", right=rate(right, len(named)))),
        ],
        not_the_papers=TEXTS.each("ours"),
        printed=SETTLE,
    )


def _row(link: str, rows: Sequence[dict[str, Any]]) -> dict[str, Any]:
    own = [row for row in rows if row["link"] == link]
    named = [row.get("identified") for row in own]
    means = {name: mean_of(values(own, name)) for name in ("delay_s", "force_n", "ratio_db")}
    return means | {
        "link": link,
        "n": len(own),
        "proximal": named.count("proximal"),
        "distal": named.count("distal"),
        "false": total(own, "false_contacts"),
    }
