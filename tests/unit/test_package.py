"""What `pip install .` takes along, and what the project states about itself."""

import fnmatch
import re
import tomllib
from collections import defaultdict
from pathlib import Path

from click.testing import CliRunner

from run import cli

ROOT = Path(__file__).parents[2]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
SETUPTOOLS = PROJECT["tool"]["setuptools"]
NOT_INSTALLED = {"benchmarks", "docs", "requirements", "tests"}


def files_of(package):
    return [
        path for path in (ROOT / package).rglob("*") if path.is_file() and "__pycache__" not in path.parts
    ]


def test_every_folder_of_the_program_is_installed_with_all_that_is_in_it():
    folders = {path.name for path in ROOT.iterdir() if (path / "__init__.py").exists()} - NOT_INSTALLED
    assert {pattern.rstrip("*") for pattern in SETUPTOOLS["packages"]["find"]["include"]} == folders
    for package in folders:
        for path in files_of(package):
            if path.suffix == ".py":
                assert (path.parent / "__init__.py").exists(), f"{path.parent} is no package"
            else:
                name = path.relative_to(ROOT / package).as_posix()
                assert any(fnmatch.fnmatch(name, each) for each in SETUPTOOLS["package-data"][package]), path
    assert SETUPTOOLS["py-modules"] == ["run"]
    assert PROJECT["project"]["scripts"] == {"touchbench": "run:cli"}


def test_what_is_installed_needs_what_the_program_needs():
    (file,) = SETUPTOOLS["dynamic"]["dependencies"]["file"]
    assert (ROOT / file).is_file()
    assert not any(line.startswith("-") for line in (ROOT / file).read_text("utf-8").splitlines())


def test_the_version_is_the_projects_and_the_citations():
    printed = CliRunner().invoke(cli, ["--version"], standalone_mode=False)
    version = PROJECT["project"]["version"]
    assert printed.output == f"touchbench {version}\n"
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\n## {version}" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_each_public_class_has_a_name_of_its_own() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for room in ("config", "controller", "behaviors", "drivers", "benchmarks"):
        for path in (ROOT / room).rglob("*.py"):
            for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE):
                places[name].append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}
