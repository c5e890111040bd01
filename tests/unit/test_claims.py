"""The check of stated figures: a figure that is off by one per cent, or has no source, is found."""

import re

from tests.claims import FIGURE, NO_FIGURES, ROOT, Sources, claims, problems

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
