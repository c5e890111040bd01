"""The examples and the docs' script run."""

import json
import re
import runpy
import sys
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

from config.source import ProfileError
from tests.scenarios.conftest import QUICK
from touchbench import open_run, run_trials

EXAMPLES = Path(__file__).parents[2] / "examples"
PLOTS = {
    "delay_by_factor.py": "delay_s_by_speed_m_s.png",
    "around_the_decision.py": "around_the_decision.png",
    "other_thresholds.py": "other_thresholds.png",
    "first_look.ipynb": "first_look.png",
}


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    root = tmp_path_factory.mktemp("runs")
    trials = [{"location": "f", "speed_m_s": speed} for speed in (0.003, 0.01)]
    run_trials("mock/transient", trials, settings=QUICK, out=root / "runs", say=lambda line: None)
    return root


@pytest.fixture
def folder(root, tmp_path, monkeypatch):
    """An empty folder with a run; what is drawn goes into files."""
    (tmp_path / "runs").symlink_to(root / "runs")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["example"])
    before = mpl.get_backend()
    plt.switch_backend("agg")
    yield tmp_path
    plt.close("all")
    plt.switch_backend(before)


def test_every_example_is_named_here():
    assert {path.name for path in EXAMPLES.iterdir() if path.is_file()} == set(PLOTS)


@pytest.mark.parametrize("name", PLOTS)
def test_it_runs_and_draws(folder, name):
    if name.endswith(".py"):
        runpy.run_path(str(EXAMPLES / name))
    else:
        cells = json.loads((EXAMPLES / name).read_text("utf-8"))["cells"]
        known = {}
        for cell in cells:
            if cell["cell_type"] == "code":
                assert cell["outputs"] == [], "a notebook is kept without what it printed"
                exec("".join(cell["source"]), known)
    image = plt.imread(folder / PLOTS[name])
    lines = image[..., :3].std(axis=2) > 0.05
    assert lines.sum() > 100, "something is drawn in colour"


def test_a_signal_keeps_its_times_and_unit_in_pandas_and_xarray(folder):
    run = open_run("latest")
    force = run.signal(1, "board.load_cell")
    frame, array = force.to_pandas(), force.to_xarray()
    assert frame.attrs["units"] == {"t_s": "s", "board.load_cell": "N"}
    assert (array.attrs["units"], array.t_s.attrs["units"], array.name) == ("N", "s", "board.load_cell")
    np.testing.assert_array_equal(frame.index, force.times_s)
    np.testing.assert_array_equal(array.values, force.values)
    reading = run.signal(1, "detector.contact").to_pandas()
    assert list(reading) == ["statistic", "threshold"]
    assert run.table.attrs["units"]["speed_m_s"] == "m/s"
    with pytest.raises(KeyError, match=r"trial 1 has no stream board\.lamp; it has: .*board\.load_cell"):
        run.signal(1, "board.lamp")


def test_a_run_and_a_signal_are_short_in_a_notebook(folder):
    run = open_run("latest")
    assert len(repr(run)) < 200
    assert "contact: 2" in repr(run)
    assert len(repr(run.signal(1, "board.load_cell"))) < 120
    assert "<table" in run._repr_html_()
    assert "board.load_cell" in run._repr_html_()


def test_a_missing_xarray_is_one_clear_line(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "xarray", None)
    with pytest.raises(
        ImportError, match=r"xarray is not installed; install it: pip install 'touchbench\[xarray\]'"
    ):
        open_run("latest").signal(1, "board.load_cell").to_xarray()


PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "run_campaigns.md"


def test_the_script_in_the_docs_runs(tmp_path, monkeypatch, capsys):
    code, reading, _ = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    exec(compile(code, str(PAGE), "exec"), scope)
    run: Any = scope["run"]
    assert [row["speed_m_s"] for row in run.trials] == pytest.approx([0.002, 0.003, 0.0045, 0.00675])
    assert "0.002 contact" in capsys.readouterr().out
    second = reading.replace("signal(5,", "signal(2,").replace("loc[5,", "loc[2,")  # it has four trials
    exec(compile(second, str(PAGE), "exec"), scope)
    near: Any = scope["near"]
    assert len(near) > 0
    assert not near.skipped, "no line is drawn across what was not recorded"


def test_a_bad_factor_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ProfileError, match="speed_m_s"):
        run_trials("mock/transient", [{"location": "f", "speed_m_s": -1.0}], out=tmp_path / "runs")
    assert not (tmp_path / "runs").exists()
