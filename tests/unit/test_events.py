"""Kept events and claimed figures: what differs is found."""

import re

import pytest

from tests.claims import FIGURE, NO_FIGURES, ROOT, Sources, claims, problems
from tests.events import CASES, FOLDER, TIME_S, changes, detected, kept


@pytest.mark.parametrize("case", CASES)
def test_a_detectors_events_on_a_recording_are_the_kept_ones(case):
    found = list(changes(kept()[case], detected(case)))
    assert not found, f"{case}; if that is meant: python -m tests.events\n" + "\n".join(found)


def event(t_s, name="Contact", value=1.0):
    return {"t_s": t_s, "event": name, "value": value, "threshold": 0.5}


def test_a_change_is_shown_with_its_size_and_what_is_allowed():
    before = [event(1.0), event(2.0, "ContactLost"), event(3.0)]
    after = [event(1.0 + TIME_S / 2), event(3.002, value=1.1), event(4.0, "ContactHeld")]
    assert list(changes(before, before)) == []
    assert list(changes(before, after)) == [
        "- 2.000000 s ContactLost 1.0",
        "~ 3.000000 s Contact 1.0: +0.002000 s (at most 1e-06), value 1 → 1.1 (at most 0.0001 of it)",
        "+ 4.000000 s ContactHeld 1.0",
    ]


def test_the_recordings_are_small():
    assert sum(path.stat().st_size for path in FOLDER.iterdir()) < 200_000


SOURCES = Sources(fresh=False)
CLAIMED = claims(SOURCES)
README = (ROOT / "README.md").read_text("utf-8")


def test_each_figure_of_the_readme_that_is_one_per_cent_off_is_found() -> None:
    """Each in turn; those of names, versions and code are not figures."""
    named = [match.span() for match in NO_FIGURES.finditer(README)]
    figures = [
        match
        for match in re.finditer(rf"(?<![\w.,]){FIGURE} (?:%|ms|mm|kHz|held-out|approaches)", README)
        if not any(begin <= match.start() < end for begin, end in named)
    ]
    assert len(figures) >= 10
    for figure in figures:
        printed, unit = figure[0].split(" ")
        off = f"{1.01 * float(printed.replace(',', '')):.6g} {unit}"
        changed = README[: figure.start()] + off + README[figure.end() :]
        assert list(problems("README.md", changed, CLAIMED["README.md"], SOURCES)), figure[0]


def test_a_figure_without_a_source_is_found() -> None:
    (found,) = problems("README.md", "It takes 3.7 ms.", [], SOURCES)
    assert "3.7 has no source" in found
