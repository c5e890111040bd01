"""The package: what is installed, imported and named, in public and in docs/troubleshooting.md."""

import ast
import fnmatch
import os
import re
import subprocess
import sys
import tomllib
from collections import defaultdict
from importlib import import_module, metadata
from itertools import chain
from pathlib import Path

import pytest
from click.testing import CliRunner

import touchbench
from run import cli
from tests import messages
from touchbench.lookup import PLACES, ROOMS

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
    named = {re.split(r"[<>=[;]", each)[0] for each in wanted}
    ours = {"run", *(path.name for path in ROOT.iterdir() if (path / "__init__.py").exists())}
    files = [ROOT / "run.py", *(path for room in ours - NOT_INSTALLED for path in files_of(room))]
    trees = [messages.parsed(path) for path in files if path.suffix == ".py"]
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
        nodes = list(ast.walk(messages.parsed(path)))
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
    assert len(pages) <= 30
    led_to = set(re.findall(r'"(docs/.+?\.md)"', (ROOT / "zensical.toml").read_text("utf-8")))
    assert {page.relative_to(ROOT).as_posix() for page in pages} == led_to
    firsts = {page.name: page.read_text("utf-8").split("\n\n")[1] for page in pages}
    assert {name: first for name, first in firsts.items() if not re.match(r"For [^\n]+[.:?]", first)} == {}
    assert len((ROOT / "docs/reference/glossary.md").read_text("utf-8").splitlines()) <= 50, "one screen"


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


def test_every_message_is_an_entry_and_every_entry_a_message() -> None:
    written = messages.PAGE.read_text().partition(messages.MARK)[2]
    lines = {line for line in written.splitlines() if line.startswith("| ")}
    entries = {line for line in messages.tables().splitlines() if line.startswith("| ")}
    assert not entries - lines, f"python -m tests.messages adds: {sorted(entries - lines)[:5]}"
    assert not lines - entries, f"python -m tests.messages removes: {sorted(lines - entries)[:5]}"
    assert len(entries) > 300


def test_no_kind_of_error_is_left_out_of_the_page() -> None:
    listed = {kind for kinds in messages.SYMPTOMS.values() for kind in kinds} | {"LinkError"}
    assert messages.raised() - listed == messages.UNSEEN


def test_a_message_that_is_put_together_in_branches_is_found_in_each() -> None:
    refused = messages.messages()["A device, its driver or the guard refuses"]
    leash = {remedy for reason, remedy in refused if reason == "its leash is … m"}
    assert leash == {"choose a place inside it, or give [devices.…] more leash_m"}
    assert ("it has no such command", "a gripper can Home, Grip, Release, Stop and Listen") in refused


def test_a_message_is_found_with_its_remedy_and_what_varies() -> None:
    arm = messages.messages()["A device does not answer"]
    assert ("the controller's time has stood still for … s", "is the cable in, and the controller up?") in arm
