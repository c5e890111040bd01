"""The script in the docs, as it stands there."""

import re
from pathlib import Path
from typing import Any

import pytest

from config.script import run_trials
from config.source import ProfileError

PAGE = Path(__file__).parents[2] / "docs" / "how-to" / "run_campaigns.md"


def test_the_script_in_the_docs_runs(tmp_path, monkeypatch, capsys):
    code, reading = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), re.DOTALL)
    monkeypatch.chdir(tmp_path)
    scope: dict[str, object] = {}
    exec(compile(code, str(PAGE), "exec"), scope)
    run: Any = scope["run"]
    assert [row["speed_m_s"] for row in run.trials] == pytest.approx([0.002, 0.003, 0.0045, 0.00675])
    assert "0.002 contact" in capsys.readouterr().out
    exec(compile(reading.replace("signal(5,", "signal(2,"), str(PAGE), "exec"), scope)  # it has four trials
    force: Any = scope["force"]
    assert len(force.times_s) == len(force.values) > 0


def test_a_bad_factor_is_refused_before_anything_is_written(tmp_path):
    with pytest.raises(ProfileError, match="speed_m_s"):
        run_trials("mock/transient", [{"location": "f", "speed_m_s": -1.0}], out=tmp_path / "runs")
    assert not (tmp_path / "runs").exists()
