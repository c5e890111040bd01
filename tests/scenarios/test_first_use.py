"""The run that compiles the plant and the run that finds it compiled give the same file, to the byte."""

import os
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]


def test_compiling_changes_no_digit(tmp_path):
    """Fused multiply-adds, for one, would fall differently into the two, and a bounce magnifies the last bit."""
    ledgers = []
    for name in ("compiling", "compiled"):
        out = tmp_path / name
        subprocess.run(
            [
                sys.executable,
                "run.py",
                "run",
                "mock/transient",
                "--only",
                "1",
                "--no-report",
                "--out",
                str(out),
            ],
            cwd=ROOT,
            env={**os.environ, "NUMBA_CACHE_DIR": str(tmp_path / "cache")},
            check=True,
            capture_output=True,
            timeout=110,
        )
        (ledger,) = out.glob("*/trials.csv")
        ledgers.append(ledger.read_bytes())
    assert ledgers[0] == ledgers[1]
