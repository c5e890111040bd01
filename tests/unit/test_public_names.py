"""`touchbench`, the module that scripts and classes of a user's own import."""

import os
import re
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import pytest

import touchbench
from touchbench.lookup import PLACES, ROOMS

ROOT = Path(__file__).parents[2]


def python(*arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    """Python in a folder, with touchbench behind it on the import path."""
    path = {**os.environ, "PYTHONPATH": str(ROOT)}
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=folder, env=path, capture_output=True, text=True, check=False)


@pytest.mark.parametrize("name", PLACES)
def test_each_name_is_there(name):
    assert getattr(touchbench, name) is getattr(import_module(PLACES[name]), name)


def test_what_is_not_there_is_an_attribute_that_is_not_there():
    assert not hasattr(touchbench, "nothing_such")


def test_importing_it_loads_no_module_of_the_program(tmp_path):
    loaded = f"import sys, touchbench; print(sys.modules.keys() & {set(ROOMS) | {'numpy', 'pydantic'}})"
    assert python("-c", loaded, folder=tmp_path).stdout == "set()\n"


def test_docs_and_the_example_import_it_alone():
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    texts = [
        block for page in pages for block in re.findall(r"```python\n(.*?)```", page.read_text(), re.DOTALL)
    ]
    texts += [path.read_text() for path in (ROOT / "tests" / "data" / "force_sensor").glob("*.py")]
    found = re.findall(r"^ *(?:from|import) (\w+)", "\n".join(texts), re.MULTILINE)
    ours = {"run", "tests", *(path.parent.name for path in ROOT.glob("*/__init__.py"))}
    assert {name for name in found if name in ours} == {"touchbench"}


@pytest.mark.parametrize("own", ["config/__init__.py", "drivers.py", "run.py"])
def test_a_module_of_the_users_own_that_takes_the_place_of_one_is_one_line(tmp_path, own):
    (tmp_path / own).parent.mkdir(exist_ok=True)
    (tmp_path / own).write_text("")
    ended = python("-m", "touchbench", "list", folder=tmp_path)
    (line,) = ended.stderr.splitlines()
    place = own.removesuffix("/__init__.py")
    assert ended.returncode == 2
    assert f"{tmp_path / place} takes the place of" in line
    assert "rename it" in line
    (tmp_path / "campaign.py").write_text("from touchbench import run_trials\n")
    script = python("campaign.py", folder=tmp_path)
    assert (script.returncode == 0) == (own == "run.py")  # a script runs no command
    assert script.returncode == 0 or line in script.stderr.splitlines()[-1]


def test_a_folder_that_is_no_package_is_in_nobodys_way(tmp_path):
    (tmp_path / "config").mkdir()
    (tmp_path / "config" / "mine.toml").write_text("")
    assert "  transient " in python("-m", "touchbench", "list", folder=tmp_path).stdout
