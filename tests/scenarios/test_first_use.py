"""The run that compiles the plant and the run that finds it compiled give the same file, to the byte."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_compiling_changes_no_digit(verb, tmp_path):
    """Fused multiply-adds, for one, would fall differently into the two, and a bounce magnifies the last bit."""
    asked = ("run", "mock/transient", "--only", "1", "--set", "behavior.settle_s=2.0", "--no-report", "--out")
    subprocess.run(
        [sys.executable, "run.py", *asked, tmp_path / "compiling"],
        cwd=ROOT,
        env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
        check=True,
        capture_output=True,
    )
    assert verb(*asked, tmp_path / "compiled")[0] == 0
    compiling, compiled = (next((tmp_path / name).glob("*/trials.csv")) for name in ("compiling", "compiled"))
    assert compiling.read_bytes() == compiled.read_bytes()
