"""What `pip install .` takes along, and what the project states about itself."""

import ast
import fnmatch
import re
import sys
import tomllib
from collections import defaultdict
from importlib import metadata
from itertools import chain
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
        assert (ROOT / package / "py.typed").is_file(), "a type checker takes what it gives for Any"
        for path in files_of(package):
            if path.suffix == ".py":
                assert (path.parent / "__init__.py").exists(), f"{path.parent} is no package"
            else:
                name = path.relative_to(ROOT / package).as_posix()
                assert any(fnmatch.fnmatch(name, each) for each in SETUPTOOLS["package-data"][package]), path
    assert SETUPTOOLS["py-modules"] == ["run"]
    assert PROJECT["project"]["scripts"] == {"touchbench": "touchbench.__main__:main"}


def statements(node):
    """All statements in it; in an expression nothing is imported."""
    for child in ast.iter_child_nodes(node):
        if not isinstance(child, ast.expr):
            yield child
            yield from statements(child)


def test_what_is_imported_is_named_and_what_is_named_is_imported():
    project = PROJECT["project"]
    wanted = [*project["dependencies"], *chain(*project["optional-dependencies"].values())]
    named = {re.split(r"[<>=[]", each)[0] for each in wanted}
    ours = {"run", *(path.name for path in ROOT.iterdir() if (path / "__init__.py").exists())}
    files = [ROOT / "run.py", *(path for room in ours - NOT_INSTALLED for path in files_of(room))]
    trees = [ast.parse(path.read_text("utf-8")) for path in files if path.suffix == ".py"]
    nodes = [node for tree in trees for node in statements(tree)]
    modules = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    modules |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom) and node.level == 0}
    others = {module.partition(".")[0] for module in modules} - ours - sys.stdlib_module_names
    bringing = {"rtde_control": ["ur-rtde"], "rtde_receive": ["ur-rtde"], **metadata.packages_distributions()}
    assert {name.lower() for module in others for name in bringing[module]} == named


def test_the_version_is_the_projects_and_the_citations():
    printed = CliRunner().invoke(cli, ["--version"], standalone_mode=False)
    version = PROJECT["project"]["version"]
    assert printed.output == f"touchbench {version}\n"
    assert f"\nversion: {version}\n" in (ROOT / "CITATION.cff").read_text("utf-8")
    assert f"\n## {version}" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_messages_call_the_program_by_its_present_name(monkeypatch):
    monkeypatch.setattr("config.verbs.PROGRAM", "touchbench")
    for arguments in ["--help"], ["list", "--help"]:
        printed = CliRunner().invoke(cli, arguments, standalone_mode=False, prog_name="touchbench").output
        assert "touchbench list" in printed
        assert "run.py" not in printed
    packages = {pattern.rstrip("*") for pattern in SETUPTOOLS["packages"]["find"]["include"]}
    for path in (path for package in packages for path in (ROOT / package).rglob("*.py")):
        nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
        prose = {id(node.value) for node in nodes if isinstance(node, ast.Expr)}  # docstrings
        prose |= {id(node.value) for node in nodes if isinstance(node, ast.keyword) and node.arg == "help"}
        texts = [node for node in nodes if isinstance(node, ast.Constant) and id(node) not in prose]
        named = [node.value for node in texts if isinstance(node.value, str) and "run.py" in node.value]
        assert set(named) <= {"run.py"}, path  # the name itself, where it is known


def test_each_public_class_has_a_name_of_its_own() -> None:
    places: dict[str, list[str]] = defaultdict(list)
    for room in ("config", "controller", "behaviors", "drivers", "simulator", "benchmarks"):
        for path in (ROOT / room).rglob("*.py"):
            for name in re.findall(r"^class ([A-Z]\w*)", path.read_text(encoding="utf-8"), re.MULTILINE):
                places[name].append(str(path.relative_to(ROOT)))
    assert {name: found for name, found in places.items() if len(found) > 1} == {}


def test_every_page_begins_with_what_it_is_for() -> None:
    pages = sorted((ROOT / "docs").rglob("*.md"))
    firsts = {page.name: page.read_text("utf-8").split("\n\n")[1] for page in pages}
    assert {name: first for name, first in firsts.items() if not re.match(r"For [^\n]+[.:?]", first)} == {}
    assert len((ROOT / "docs/reference/glossary.md").read_text("utf-8").splitlines()) <= 50, "one screen"
