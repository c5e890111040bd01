"""Coverage-guided fuzzing of every decoder: `python -m tests.fuzz [TARGET …] [--seconds S]`.

Each target runs in a process of its own, from the corpus beside this file and the target's seeds. What it finds that
no decoder may do (another error than its own, more than `MEMORY_MB`, more than `INPUT_S` for one input) stays in
`build/fuzz/TARGET/` and ends that target; its inputs are kept there too, and `--keep` takes the smallest ones that
reach more lines into the corpus, which `make test` replays.
"""

import argparse
import hashlib
import re
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import FrameType
from typing import Any

CORPUS = Path(__file__).resolve().parent / "corpus"

ROOM = str(CORPUS.parents[2])

WORK = Path("build/fuzz")

SECONDS = 600
"""For each target."""

MEMORY_MB = 1024
"""Of the whole process, of which the program with its libraries is a third."""

INPUT_S = 10
"""For one input of some kilobytes, instrumented (assumption: a thousand times what is common)."""

CORPUS_BYTES = 6000
"""Of each target, at most."""

INSTRUMENTED = ("config", "controller", "drivers", "simulator", "mcap", "tomllib")

COMPILED = ("simulator/physics/*", "controller/signals/*", "controller/detectors/*")
"""What numba compiles as it is written; it decodes nothing."""

STATS = re.compile(r"stat::(\w+):\s+(\d+)")


def main() -> int:
    """Fuzz what is asked for, one target after the other; 1 where anything was found."""
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz", description=__doc__.splitlines()[0])
    parser.add_argument("targets", nargs="*", help="all, if none is named")
    parser.add_argument("--seconds", type=int, default=SECONDS, help=f"for each target ({SECONDS})")
    parser.add_argument("--keep", action="store_true", help="merge what was found into the corpus")
    arguments = parser.parse_args()
    from tests.fuzz.targets import TARGETS

    found = [_run(name, arguments.seconds, arguments.keep) for name in arguments.targets or TARGETS]
    return int(any(found))


def _fuzz(name: str, options: list[str]) -> None:
    """Never returns."""
    import atheris

    files = (file for pattern in COMPILED for file in Path().glob(f"{pattern}.py"))
    compiled = [".".join(file.with_suffix("").parts) for file in files]
    with atheris.instrument_imports(include=list(INSTRUMENTED), exclude=compiled):
        from tests.fuzz.targets import TARGETS
    atheris.Setup([sys.argv[0], *options], TARGETS[name].run)
    atheris.Fuzz()


def _run(name: str, seconds: int, keep: bool) -> bool:
    from tests.fuzz.targets import BYTES_MAX, TARGETS

    work, kept = WORK / name, CORPUS / name
    inputs = work / "inputs"
    inputs.mkdir(parents=True, exist_ok=True)
    kept.mkdir(parents=True, exist_ok=True)
    for seed in TARGETS[name].seeds():
        (inputs / hashlib.sha1(seed).hexdigest()).write_bytes(seed)
    limits = [f"-max_len={BYTES_MAX}", f"-rss_limit_mb={MEMORY_MB}", f"-timeout={INPUT_S}"]
    limits += [f"-artifact_prefix={work}/", "-print_final_stats=1", "-close_fd_mask=0"]
    begin_s, code, log = time.monotonic(), 0, work / "log.txt"
    with log.open("w") as opened:
        child = _child(name, [*limits, f"-max_total_time={seconds}", str(inputs), str(kept)])
        code = subprocess.run(child, stderr=opened, check=False).returncode
    stats = dict(STATS.findall(log.read_text(errors="replace")))
    print(
        f"{name:14s} {stats.get('number_of_executed_units', '?'):>9s} executions in"
        f" {time.monotonic() - begin_s:5.0f} s, {stats.get('peak_rss_mb', '?'):>4s} MB:"
        f" {'nothing found' if code == 0 else f'see {log}'}",
        flush=True,
    )
    if keep:
        _keep(name, inputs, kept)
    return code != 0


def _child(name: str, options: list[str]) -> list[str]:
    return [sys.executable, "-m", "tests.fuzz", "--child", name, *options]


def _keep(name: str, inputs: Path, kept: Path) -> None:
    """The smallest inputs that reach lines which neither a seed nor a smaller one reaches, up to `CORPUS_BYTES`."""
    from tests.fuzz.targets import TARGETS

    target, left = TARGETS[name], CORPUS_BYTES
    reached = {line for seed in target.seeds() for line in _lines(target.run, seed)}
    found = sorted({path.read_bytes() for folder in (inputs, kept) for path in folder.iterdir()}, key=len)
    for old in kept.iterdir():
        old.unlink()
    for data in found:
        lines = _lines(target.run, data) if len(data) <= left else set()
        if lines - reached:
            reached |= lines
            left -= len(data)
            (kept / hashlib.sha1(data).hexdigest()[:12]).write_bytes(data)


def _lines(run: Callable[[bytes], None], data: bytes) -> set[tuple[str, int]]:
    """Lines of the program that an input reaches."""
    reached: set[tuple[str, int]] = set()

    def trace(frame: FrameType, event: str, _: object) -> Any:
        file = frame.f_code.co_filename
        if not file.startswith(ROOM) or "/.venv/" in file:
            return None
        reached.add((file, frame.f_lineno))
        return trace

    sys.settrace(trace)
    try:
        run(data)
    finally:
        sys.settrace(None)
    return reached


if __name__ == "__main__":
    if sys.argv[1:2] == ["--child"]:
        _fuzz(sys.argv[2], sys.argv[3:])
    sys.exit(main())
