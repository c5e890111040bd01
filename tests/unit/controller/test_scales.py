"""Heading times cell is the SI value of the column's name, wherever a column is shown."""

import json
import math
import re
from importlib import import_module
from types import SimpleNamespace

import pandas as pd
import pytest
from hypothesis import given
from hypothesis import strategies as st

from config.profile import load_profile
from config.source import profile_names
from controller import comparing
from controller.console import ConsoleOperator, PlainConsole
from controller.live import LiveConsole
from controller.registry import EXPERIMENTS
from controller.reports import generic
from controller.reports.counts import under
from controller.reports.section import ROWS
from controller.reports.trial_signals import is_instant, shown_as, trial_table
from controller.scales import SHOWN, SUFFIXES, scale_of, shown_in
from controller.watching.feed import Watched, _Client

SIZE = {"mm": 1e-3, "mm/s": 1e-3, "ms": 1e-3, "°": math.pi / 180.0, "°/s": math.pi / 180.0} | dict.fromkeys(
    ("s", "N", "V", "Hz", "dB", "FS", "kg", "ppm", "m/s²", "m/s²/√Hz", "V/N", "dB/m", "kg m²"), 1.0
)
"""SI units in a unit that is shown (the ones of decibel, full scale and ppm are themselves)."""

KIND = {"m": "mm", "m_s": "mm/s", "rad": "°", "rad_s": "°/s", "s": "s", "n": "N", "v": "V", "hz": "Hz"}
KIND |= {"v_n": "V/N"}

COLUMNS = sorted(
    {name for each in EXPERIMENTS.values() for name in import_module(each.measures).COLUMNS}
    | {
        factor
        for profile in profile_names()
        if profile.startswith("mock/") and "bench" not in profile
        for trial in load_profile(profile, None).trials(0)
        for factor in trial.factors
    }
)
"""Of every shipped measure, and every factor of every profile of the mock bench."""

VALUE = 0.0123456


def read(heading, cell):
    """The SI value that a reader makes of a heading and a cell below it."""
    number = float(re.findall(r"^[−+\d.]+(?:e[−\d]+)?", cell)[0].replace("−", "-"))
    return number * SIZE.get(heading.rpartition(", ")[2] if ", " in heading else heading, 1.0)


def near(value):
    return pytest.approx(value, rel=5e-4)


@given(suffix=st.sampled_from(sorted(SUFFIXES)), value=st.floats(-1e6, 1e6).filter(lambda x: abs(x) > 1e-12))
def test_heading_times_cell_is_the_si_value_for_every_unit_that_a_name_can_end_in(suffix, value):
    scale = scale_of(f"some_thing_{suffix}")
    assert scale.unit == KIND.get(suffix, scale.unit)
    assert scale.unit in SIZE
    assert scale.heading == f"some thing, {scale.unit}"
    assert read(scale.heading, scale.cell(value)) == near(value)


@pytest.mark.parametrize("unit", SHOWN)
def test_a_signal_is_shown_in_the_unit_of_the_columns(unit):
    shown, factor = shown_in(unit)
    assert SIZE[shown] * factor == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("name", "heading"),
    [
        ("distance_m_paper", "distance paper, mm"),
        ("seen_to_stop_left_s", "seen to stop left, ms"),
        ("detectors.contact.sample_hz", "detectors.contact.sample, Hz"),
        ("plant.pad_n_m", "plant.pad n m"),
        ("contact_n_s_m", "contact n s m"),
        ("imbalance_per_k", "imbalance per k"),
        ("undulations_per_cm", "undulations per cm"),
        ("n", "n"),
        ("outcome", "outcome"),
    ],
)
def test_a_unit_that_a_name_does_not_state_is_never_made_up(name, heading):
    assert scale_of(name).heading == heading


def test_what_is_no_number_is_shown_as_it_is():
    cells = map(scale_of("extent_m").cell, (None, math.nan, True, 2, "f"))
    assert list(cells) == ["–", "–", "True", "2000", "f"]


# --- every place that shows a column --------------------------------------------------------------------


@pytest.fixture
def run(tmp_path):
    """Two trials in which every column and factor that is shipped has the same value."""
    cells = dict.fromkeys(COLUMNS, VALUE)
    rows = [{"trial": number, **cells, "outcome": "contact"} for number in (1, 2)]
    read = {"folder": SimpleNamespace(path=tmp_path), "table": pd.DataFrame(rows), "manifest": {}}
    about = {"resolved": {}, "succeeded": bool, "events_of": lambda trial: ()}
    return SimpleNamespace(trials=rows, factors=COLUMNS[::2], **read, **about)


def check(pairs, count=None):
    """Each column once, and each as the value that it has."""
    found = [read(heading, cell) for heading, cell in pairs]
    assert len(found) == (len(COLUMNS) if count is None else count)
    assert found == [near(VALUE)] * len(found)


def test_in_the_section_of_any_experiment_and_in_a_cell_of_its_own_factors_and_results_alike(
    run, monkeypatch
):
    monkeypatch.setattr(generic, "_draw", lambda *_: "")
    (row,) = generic.section("poke", [run], None).content["measured"]
    check([pair for pair in row.items() if pair[0] not in ("n", ROWS)])
    check([pair for name in COLUMNS for pair in under(name, VALUE).items()])


def test_in_the_table_of_all_trials(run):
    names, rows = trial_table([run])
    lasting = [name for name in COLUMNS if not is_instant(name)]
    for row in rows:
        cells = list(zip(names, row.cells, strict=True))
        pairs = [(heading, cell[0]) for (name, heading, _), cell in cells if name in lasting]
        check(pairs, len(lasting))
        at_the_event = {cell[0] for each, cell in cells if is_instant(each.name)}
        assert at_the_event == {"0"}, "an instant counts from the trial's event, at the same time here"


def test_on_a_terminal_and_off_it(run, monkeypatch):
    lines = []
    factors = dict.fromkeys(run.factors, VALUE)
    monkeypatch.setattr("controller.console.RESULTS", len(COLUMNS))
    plain = PlainConsole(ConsoleOperator(), lines.append)
    plain.campaign_started("poke", 1, run.folder.path)
    plain.trial_started(1, factors)
    plain.trial_ended(1, "contact", {name: VALUE for name in COLUMNS if name not in factors})
    plain.campaign_ended("")
    said = lines[-1].partition("trial 1 ")[2].replace(": contact", "").split(", ")
    parted = [re.fullmatch(r"(.*?) ([\d.]+) ?(\D*)", each).groups() for each in said]
    check([(f"{label}, {unit}" if unit else label, cell) for label, cell, unit in parted])


def test_in_the_live_view_and_on_the_live_page(run):
    factors = dict.fromkeys(run.factors, VALUE)
    results = {name: VALUE for name in COLUMNS if name not in factors}
    live = LiveConsole(ConsoleOperator(), SimpleNamespace(width=10**6))
    feed = Watched(live, ConsoleOperator())
    live.trial_started(1, factors)
    live.trial_ended(1, "contact", results)
    ((_, _, row, _),) = json.loads(feed.news(_Client()))["rows"]
    check(row.items())
    head, cells = (line.plain for line in live._table())
    edges = [match.span() for match in re.finditer(r"\S+", cells)]
    pairs = [(head[: edge[1]].rpartition("  ")[2], cells[edge[0] : edge[1]]) for edge in edges]
    found = [read(heading, cell) for heading, cell in pairs if heading.strip() not in ("trial", "outcome")]
    assert found == [near(VALUE)] * len(found)
    assert len(found) > len(factors)


def test_in_two_runs_beside_each_other(run):
    run.recorded_trials = [1]
    run.trial = lambda _: SimpleNamespace(factors=dict.fromkeys(run.factors, VALUE))
    means, (first, _) = comparing._tables(run, run)
    measured = [name for name in COLUMNS if name not in run.factors and not is_instant(name)]
    headings = {shown_as(name, [VALUE]).heading for name in measured}
    shown = [read(row["measured"], row["second"]) for row in means if row["measured"] in headings]
    assert shown == [near(VALUE)] * len(measured)
    cells = [cell.values() if isinstance(cell, dict) else [cell] for cell in first.values()]
    whose = [(head, each) for head, own in zip(first, cells, strict=True) for each in own]
    found = [read(head, cell) for head, cell in whose if head not in ("trial", "outcome")]
    assert found == [near(VALUE)] * (len(run.factors) + 2 * len(measured))
