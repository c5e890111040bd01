"""Reference pages name every outcome, column and factor of the shipped experiments."""

import re
from pathlib import Path

import pytest

from controller.measures import columns_of
from controller.own_modules import found
from controller.registry import EXPERIMENTS, settings_of

DOCS = Path(__file__).resolve().parents[3] / "docs/reference"
FOLDER = (DOCS / "run_folder.md").read_text(encoding="utf-8")
PROFILES = (DOCS / "profiles.md").read_text(encoding="utf-8")


def rows(page, heading):
    """First cell -> the others, of the table under a heading."""
    (table,) = re.findall(rf"^\| experiment \| {heading}.*\n\| ---.*\n((?:\|.*\n)+)", page, re.MULTILINE)
    cells = [line.strip("|").split("|", 1) for line in table.splitlines()]
    return {name: rest for names, rest in cells for name in re.findall(r"\w+", names)}


def columns_section(experiment):
    """What stands under the heading of an experiment's columns, and under those of the ones that it refers to."""
    pattern = rf"^## Columns of .*\b{experiment}\b.*\n((?:(?!## ).*\n)+)"
    (text,) = re.findall(pattern, FOLDER, re.MULTILINE)
    return text + "".join(map(columns_section, re.findall(r"Those of a (\w+) trial", text)))


def named(column, words):
    """Whether a column stands there, alone or in parts: `paper_…` and `missed`, `…_paper` and `seen_…`."""
    for word in words:
        parts = [re.escape(part) for part in word.split("…")]
        found = re.fullmatch("(.*)".join(parts), column)
        varied = "".join(found.groups()) if found else None
        if varied is not None and (not found.groups() or {varied, f"{varied}_…", f"…_{varied}"} & words):
            return True
    return False


@pytest.mark.parametrize("experiment", EXPERIMENTS)
def test_outcomes_columns_and_factors_are_on_the_pages(experiment):
    told = rows(FOLDER, "success")[experiment]
    assert {f"`{outcome}`" for outcome in EXPERIMENTS[experiment].outcomes} <= set(re.findall(r"`\w+`", told))
    words = set(re.findall(r"`([\w…]+)`", columns_section(experiment)))
    assert [column for column in columns_of(experiment) if not named(column, words)] == []
    factors = rows(PROFILES, "factors")
    told = factors[experiment]
    told += "".join(factors[other] for other in re.findall(r"as `(\w+)`", told))
    given = set(re.findall(r"`(\w+)`", told))
    assert set(settings_of(found(EXPERIMENTS[experiment].made), "factors").model_fields) <= given
