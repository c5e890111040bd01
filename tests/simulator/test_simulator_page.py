"""The simulator's page: its example runs, and says what it says."""

import re
from pathlib import Path

import pytest

PAGE = Path(__file__).parents[2] / "simulator" / "README.md"


def test_the_example_meets_the_probe_when_and_as_hard_as_the_page_says():
    page = PAGE.read_text("utf-8")
    (code,) = re.findall(r"```python\n(.*?)```", page, re.DOTALL)
    names = {}
    exec(code.replace("print(", "shown = ("), names)
    (t_s, made), force_n = names["shown"]
    at_s, about_n = map(
        float, re.findall(r"at ([\d.]+) s, and in the end presses it with ([\d.]+) N", page)[0]
    )
    assert (t_s, made) == (pytest.approx(at_s, abs=1e-9), True)
    assert force_n == pytest.approx(about_n, abs=5e-5)


def test_each_folder_is_on_the_page():
    folders = {path.parent.name for path in PAGE.parent.glob("*/__init__.py")}
    assert set(re.findall(r"^\| `(\w+)/`", PAGE.read_text("utf-8"), re.MULTILINE)) == folders
