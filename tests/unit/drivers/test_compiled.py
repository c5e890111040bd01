"""Compiled code is found by its content: never what other sources gave, always what equal ones did."""

import importlib
import os
import re
import shutil
import subprocess
import sys
import time
from pathlib import Path

import pytest

from drivers.core.compiled import compiled, make_signed
from drivers.core.compiling import DAY_S, KEPT_S

ROOT = Path(__file__).parents[3]

FAR = """
from drivers.core.compiled import compiled

BASE = 2.0
SHARED = BASE + 0.5


@compiled(error_model="python")
def far(x):
    return 10.0 * x
"""

NEAR = """
from typing import NamedTuple

from drivers.core.compiled import compiled

from far import SHARED, far


class Pair(NamedTuple):
    first: float
    second: float


@compiled()
def near(pair):
    return far(pair.first) + SHARED


def result():
    return near(Pair(first=1.0, second=3.0)), sum(near.stats.cache_hits.values())
"""


@pytest.fixture(autouse=True)
def kept(tmp_path, monkeypatch):
    folder = tmp_path / "kept"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(folder))
    # two edits of one length within a second look alike to Python's own cache of bytecode
    monkeypatch.setattr(sys, "dont_write_bytecode", True)
    monkeypatch.setenv("PYTHONDONTWRITEBYTECODE", "1")
    return folder


def tree(folder, far=FAR, near=NEAR):
    folder.mkdir(exist_ok=True)
    (folder / "far.py").write_text(far)
    (folder / "near.py").write_text(near)
    return folder


def result(folder):
    """Of a tree as a new process would see it: the number, and how many kernels were loaded instead of compiled."""
    for name in ("far", "near"):
        sys.modules.pop(name, None)
    importlib.invalidate_caches()
    sys.path.insert(0, str(folder))
    try:
        return importlib.import_module("near").result()
    finally:
        sys.path.remove(str(folder))
        for name in ("far", "near"):
            sys.modules.pop(name, None)


@pytest.mark.parametrize(
    ("file", "old", "new", "expected"),
    [
        pytest.param("far", "10.0 * x", "20.0 * x", 22.5, id="the code of a kernel that is called"),
        pytest.param("far", "BASE = 2.0", "BASE = 7.0", 17.5, id="what a constant of another file is made of"),
        pytest.param("near", "    first: float\n    second: float", "    second: float\n    first: float", 12.5,
                     id="the order of a tuple's fields"),
    ],
)  # fmt: skip
def test_an_edit_of_what_a_kernel_takes_in_is_never_answered_with_what_was_compiled_before(
    tmp_path, file, old, new, expected
):
    sources = {"far": FAR, "near": NEAR}
    assert result(tree(tmp_path / "tree")) == (12.5, 0)
    edited = {**sources, file: sources[file].replace(old, new)}
    assert edited != sources
    assert result(tree(tmp_path / "tree", **edited)) == (expected, 0)
    assert result(tree(tmp_path / "tree")) == (12.5, 1), "the old sources' code is still there"


def test_another_option_is_another_kernel(tmp_path):
    divided = FAR.replace("10.0 * x", "10.0 / (x - x)")
    with pytest.raises(ZeroDivisionError):
        result(tree(tmp_path / "tree", far=divided))
    assert result(tree(tmp_path / "tree", far=divided.replace('"python"', '"numpy"'))) == (float("inf"), 0)


def test_an_equal_tree_elsewhere_loads_and_another_one_does_not_disturb_it(tmp_path):
    one, other = tree(tmp_path / "one"), tree(tmp_path / "other", far=FAR.replace("10.0", "30.0"))
    assert result(one) == (12.5, 0)
    assert result(other) == (32.5, 0)
    assert result(tree(tmp_path / "third")) == (12.5, 1)
    assert result(one) == (12.5, 1)
    moved = "\n\n\n# moved down\n" + NEAR
    assert result(tree(one, near=moved)) == (12.5, 1), "where code stands in its file is not its content"


def test_a_kernel_of_the_program_follows_an_edit_of_the_file_that_it_calls_into(tmp_path, kept):
    def copied(name):
        for room in ("drivers", "simulator"):
            shutil.copytree(ROOT / room, tmp_path / name / room, ignore=shutil.ignore_patterns("__pycache__"))
        return tmp_path / name

    def echoed(folder):
        code = (
            "import numpy as np; from simulator.physics.aura_kernel import echoed; out = np.zeros(1000);"
            "echoed(1, 2, 3, np.arange(1000), np.array([1.0, 0.7, 0.4, 0.1]), out); print(out.tolist())"
        )
        done = subprocess.run(
            [sys.executable, "-c", code], cwd=folder, capture_output=True, text=True, check=True, timeout=100,
            env={**os.environ, "NUMBA_CACHE_DIR": str(kept)},
        )  # fmt: skip
        return done.stdout, done.stderr

    first, printed = echoed(copied("first"))
    assert "compiling what this machine has not compiled before" in printed
    assert echoed(copied("second")) == (first, ""), "loaded: nothing is compiled, and no digit differs"
    noise = tmp_path / "second" / "simulator" / "physics" / "noise.py"
    noise.write_text(noise.read_text().replace("_ROUNDS = 10", "_ROUNDS = 9"))
    assert echoed(tmp_path / "second")[0] != first


def test_damaged_code_is_made_anew(tmp_path, kept):
    result(tree(tmp_path / "tree"))
    for file in kept.glob("*/*.compiled"):
        file.write_bytes(file.read_bytes()[:-1] + b"?")
    assert result(tmp_path / "tree") == (12.5, 0)
    assert result(tmp_path / "tree") == (12.5, 1)


def test_without_a_folder_to_keep_it_in_everything_still_runs(tmp_path, kept, capsys):
    kept.write_text("a file in its place")
    assert result(tree(tmp_path / "tree")) == (12.5, 0)
    assert capsys.readouterr().err.count("is not kept, set NUMBA_CACHE_DIR") <= 1  # once a process
    assert kept.read_text() == "a file in its place"


def test_what_was_not_loaded_for_a_month_goes_and_what_is_in_use_stays(tmp_path, kept):
    result(tree(tmp_path / "tree"))
    (folder,) = kept.iterdir()
    version = kept / "an older version"
    version.mkdir()
    now = time.time()
    for file, age_s in (
        (version / "unused", KEPT_S + 60.0),
        (folder / "unused", KEPT_S + 60.0),
        (folder / "of another tree", KEPT_S - 60.0),
        *((file, 2.0 * DAY_S) for file in folder.glob("near*")),
    ):
        file.touch()
        os.utime(file, (now - age_s, now - age_s))
    assert result(tmp_path / "tree") == (12.5, 1)
    (used,) = folder.glob("near*")
    assert used.stat().st_mtime > now - DAY_S, "loading marks it as in use"
    result(tree(tmp_path / "tree", far=FAR.replace("10.0", "40.0")))
    assert not version.exists()
    assert not (folder / "unused").exists()
    assert (folder / "of another tree").exists()
    assert used.exists()


def test_a_kernel_names_nothing_whose_content_is_unknown(tmp_path):
    far = FAR.replace("10.0 * x", "len(OPEN) * x").replace("BASE = 2.0", "BASE = 2.0\nOPEN = [1.0, 2.0]")
    with pytest.raises(
        TypeError, match=r"far\.far is compiled with \[1\.0, 2\.0\], whose content is not known"
    ):
        result(tree(tmp_path / "tree", far=far))


def test_a_kernel_with_a_signature_can_be_compiled_before_it_is_called(kept, monkeypatch):
    monkeypatch.setattr("drivers.core.compiled._signed", [])  # those of the program take seconds

    @compiled("f8(f8)")
    def twice(x):
        return 2.0 * x

    assert not kept.exists()
    make_signed()
    assert list(kept.glob("*/*twice*.compiled"))
    assert twice(2) == 4.0


def test_a_kernel_calls_itself_and_one_in_an_enclosing_function(kept):
    @compiled()
    def inner(n):
        return 2 * n

    @compiled("i8(i8)")
    def outer(n):
        return inner(n) if n < 2 else outer(n - 1)

    assert outer(3) == 2


def test_all_compiled_code_of_the_program_is_kept_by_its_content():
    direct = [
        str(file.relative_to(ROOT))
        for room in ("config", "controller", "behaviors", "drivers", "simulator")
        for file in (ROOT / room).rglob("*.py")
        if re.search(r"^\s*(import|from) numba", file.read_text(), re.MULTILINE)
        and file.name != "compiling.py"
    ]
    assert direct == []
