"""Every figure that README and docs state, recomputed and compared: `make claims`.

docs/claims.txt has, under the name of each page, lines of `words := source; source`. The words stand on the
page as they are, with a `#` for each figure that has a source; a figure spelled out in them is a definition, a
goal or a printed value. docs/papers.csv has the items of the three papers: the tables of docs/results.md are
made from it, with sources in braces.

A source is an expression: a stored result (`contact.levels.hard.ours.in_time`), a setting
(`profile("mock/slip").loop`), or a column of a run of the papers' profiles (`run("mock/static").frequency_hz`).
Values of runs are kept in benchmarks/results/papers.json. `--stored` takes them from there, seconds instead of
minutes; `--write` writes them, and the tables, anew; with both, only values that are not there yet are run for.
"""

import csv
import json
import math
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from config.profile import load_profile
from controller.reports.locating import located
from simulator.physics.finger_settings import FingerSettings

ROOT = Path(__file__).resolve().parents[1]
RESULTS = ROOT / "benchmarks" / "results"
STORED = RESULTS / "papers.json"
CLAIMS = ROOT / "docs" / "claims.txt"
PAPERS = ROOT / "docs" / "papers.csv"
TABLES = "docs/results.md"
WHOLE = ("README.md", TABLES)
"""Pages of which every figure needs a source; of others, those are checked that docs/claims.txt lists."""

WRITE = "python -m tests.claims --write"
BEGIN, END = "<!-- from papers.csv -->\n", "<!-- to here -->\n"
AUTHORS = {
    "A": "Backus and Dollar: contact",
    "B": "Fernandez et al.: slip",
    "C": "Rupavatharam et al.: sonic fingers",
}

FIGURE = r"[−-]?\d+(?:,\d{3})*(?:\.\d+)?(?:e[−-]?\d+)?"
ALONE = re.compile(rf"(?<![\w.,^/\[]){FIGURE}(?![\w/]|\.\d)")
NO_FIGURES = re.compile(
    r"```.*?```|`[^`\n]*`|\$\$.*?\$\$|\$[^$\n]*\$|\]\([^)\n]*\)|<!--.*?-->|^#.*?$", re.S | re.M
)
SOURCE = re.compile(r"\{(.*?):([^:{}]+)\}")


class Row(dict[str, Any]):
    """A table of a JSON or TOML file; its keys are attributes as well."""

    __getattr__ = dict.__getitem__


def rows(value: Any) -> Any:
    """The same with every table as a `Row`."""
    if isinstance(value, dict):
        return Row({key: rows(part) for key, part in value.items()})
    return [rows(part) for part in value] if isinstance(value, list) else value


def one(listed: list[Row], **keys: Any) -> Row:
    """The one row of a list with these values."""
    (row,) = (row for row in listed if all(row[key] == value for key, value in keys.items()))
    return row


def share(frame: pd.DataFrame, some: str, of: str) -> float:
    """The sum of one column over that of another, %."""
    return float(100.0 * frame[some].sum() / frame[of].sum())


def misplaced_m(trials: pd.DataFrame, column: str) -> float:
    """The largest error of a place from e to h in trials of `locating`, by phase or frequency, m."""
    listed = trials.astype(object).where(trials.notna(), None).to_dict("records")
    found = [each for each in located(listed, column) if each.location != "d" and each.contact_n_m is None]
    return max(abs(each.found_m - each.true_m) for each in found)


@cache
def profile(name: str) -> Row:
    """A profile's settings, defaults included."""
    found: Row = rows(load_profile(name).resolved)
    return found


@cache
def run(name: str) -> pd.DataFrame:
    """The trials of a profile as a paper's profile runs it, kept in build/claims."""
    papers = (ROOT / "config" / "profiles" / "papers").glob("*.toml")
    parts = [part for path in sorted(papers) for part in tomllib.loads(path.read_text("utf-8"))["parts"]]
    part = next((part for part in parts if part.split()[0] == name), name)
    out = ROOT / "build" / "claims" / re.sub(r"\W+", "_", part)
    if not out.exists():
        begun = out.with_suffix(".begun")
        shutil.rmtree(begun, ignore_errors=True)
        command = [sys.executable, "run.py", "run", *part.split(), "--no-report", "--out", str(begun)]
        subprocess.run(command, cwd=ROOT, check=True, stdout=subprocess.DEVNULL)
        begun.rename(out)
    (found,) = out.glob("*/trials.csv")
    return pd.read_csv(found)


class Sources:
    """What sources are evaluated with."""

    def __init__(self, fresh: bool, new: bool = False) -> None:
        self._fresh, self._new = fresh, new
        self.stored: dict[str, list[float]] = json.loads(STORED.read_text("utf-8")) if STORED.exists() else {}
        self.used: dict[str, list[float]] = {}
        table_1 = pd.read_csv(ROOT / "controller/reports/papers/backus_table_1.csv")
        self._names = {path.stem: rows(json.loads(path.read_text("utf-8"))) for path in RESULTS.glob("*.json")} | {
            "run": run if fresh or new else self._no_run, "profile": profile, "one": one, "share": share,
            "misplaced_m": misplaced_m, "table_1": table_1, "finger": FingerSettings(),
            "np": np, "sqrt": math.sqrt, "pi": math.pi,
        }  # fmt: skip
        self._names["fitted"] = rows(json.loads((RESULTS / "table_1.json").read_text("utf-8")))

    @staticmethod
    def _no_run(name: str) -> pd.DataFrame:
        """With --stored alone nothing runs: a run that a definition hides would, each time.

        Raises:
            ValueError: always.
        """
        raise ValueError(
            f"{CLAIMS.name}: a source runs {name} without saying run(...): write it in the source"
        )

    def define(self, line: str) -> None:
        """Take in a name that several sources use: `@name = expression`."""
        name, _, expression = line[1:].partition(" = ")
        self._names[name] = eval(expression, self._names)

    def values(self, source: str) -> list[float]:
        """The values of one source: one, or a list."""
        if "run(" not in source:
            return self._evaluated(source)
        if source not in self.used:
            anew = self._fresh or (self._new and source not in self.stored)
            self.used[source] = self._evaluated(source) if anew else self.stored.get(source, [math.nan])
        return self.used[source]

    def _evaluated(self, source: str) -> list[float]:
        found: list[float] = np.ravel(eval(source, self._names)).astype(float).tolist()
        return found

    def changed(self) -> Iterator[str]:
        """The stored values that runs no longer give, and those that nothing uses."""
        for source in sorted(self.used.keys() | self.stored.keys()):
            then, now = self.stored.get(source), self.used.get(source)
            if then is None or now is None or not np.allclose(then, now, rtol=1e-6, atol=1e-12):
                yield f"{STORED.name}: {source}: {then} stored, {now} now: {WRITE}"


def agrees(printed: str, value: float) -> bool:
    """Whether a figure is a value, rounded to the digits that are printed."""
    plain = printed.replace(",", "").replace("−", "-")
    mantissa, _, power = plain.partition("e")
    decimals = len(mantissa.partition(".")[2])
    return abs(float(plain) - value) <= 0.5001 * 10.0 ** (int(power or 0) - decimals)


def claims(sources: Sources) -> dict[str, list[tuple[str, list[str]]]]:
    """By page: the words of each claim, and its sources."""
    pages: dict[str, list[tuple[str, list[str]]]] = {}
    listed: list[tuple[str, list[str]]] = []
    for line in CLAIMS.read_text("utf-8").splitlines():
        if line.startswith("[") and line.endswith(".md]"):
            listed = pages.setdefault(line.strip("[]"), [])
        elif line.startswith("@"):
            sources.define(line)
        elif line and not line.startswith("//"):
            words, _, wanted = line.partition(" := ")
            listed.append((words.strip(), [source.strip() for source in wanted.split(";") if source.strip()]))
    return pages


def problems(page: str, text: str, listed: list[tuple[str, list[str]]], sources: Sources) -> Iterator[str]:
    """What does not hold on a page: claims that are gone or false, and figures without a source."""
    covered = [match.span() for match in NO_FIGURES.finditer(text)]
    for words, wanted in listed:
        pattern = r"\s+".join(re.escape(word).replace(r"\#", f"({FIGURE})") for word in words.split())
        matches = list(re.finditer(pattern, text))
        if not matches:
            yield f"{page}: “{words}” no longer stands there"
        for match in matches:
            covered.append(match.span())
            known = [(source, value) for source in wanted for value in sources.values(source)]
            if len(match.groups()) != len(known):
                yield f"{page}: “{words}”: {len(match.groups())} figures, {len(known)} from sources"
            for printed, (source, value) in zip(match.groups(), known, strict=False):
                if not agrees(printed, value):
                    yield f"{page}: “{' '.join(match[0].split())}” states {printed}, {source} is {value:.6g}"
    for figure in ALONE.finditer(text) if page in WHOLE else ():
        if not any(begin <= figure.start() and figure.end() <= end for begin, end in covered):
            line = text.count("\n", 0, figure.start()) + 1
            around = text[max(0, figure.start() - 40) : figure.end() + 20]
            yield f"{page}:{line}: {figure[0]} has no source: {around!r}"


def tables(sources: Sources) -> str:
    """The papers' items as docs/results.md shows them."""
    with PAPERS.open(encoding="utf-8", newline="") as file:
        items = list(csv.DictReader(file, strict=True))
    lines = []
    for paper, title in AUTHORS.items():
        lines += [
            "",
            f"### {title}",
            "",
            "| | | item | paper | ours | | why different, or how |",
            "| --- " * 7 + "|",
        ]
        for item in (item for item in items if item["paper"] == paper):
            theirs, ours, why = (
                SOURCE.sub(lambda found: f"{sources.values(found[1])[0]:{found[2]}}", item[side])
                for side in ("theirs", "ours", "why")
            )
            if (item["kind"], item["mark"]) == ("setting", "●"):
                continue  # checked with the others, and counted
            place = item["where"] and (f"`{item['where']}`" if "/" in item["where"] else _link(item["where"]))
            cells = (item["mark"], item["place"], item["item"], theirs, ours, place, why)
            lines.append(f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |")
    said = []
    for kind, names in (
        ("result", "results, statements and proposals"),
        ("setting", "settings and procedures"),
    ):
        marks = [item["mark"] for item in items if item["kind"] == kind]
        said.append(f"{len(marks)} {names}: {', '.join(f'{marks.count(mark)} {mark}' for mark in '●◐○')}")
    listed = f"{said[0]}. {said[1]}; those that are as printed stand in [papers.csv](papers.csv) alone."
    return "\n".join([listed, *lines, ""])


def _link(page: str) -> str:
    inside = ROOT / "docs" / "explanation" / f"{page}.md"
    return (
        f"[{page}](explanation/{page}.md)"
        if inside.exists()
        else f"[{page}](../benchmarks/results/{page}.md)"
    )


def main(arguments: list[str]) -> int:
    """Check all pages; with --write, first write what is made from runs."""
    write, stored = "--write" in arguments, "--stored" in arguments
    sources = Sources(fresh=not stored, new=write)
    found: list[str] = []
    listed = claims(sources)
    path = ROOT / TABLES
    before, _, rest = path.read_text("utf-8").partition(BEGIN)
    made = before + BEGIN + tables(sources) + END + rest.partition(END)[2]
    if write:
        path.write_text(made, "utf-8")
    elif made != path.read_text("utf-8"):
        found.append(f"{TABLES}: its tables are not those of {PAPERS.name}: {WRITE}")
    for page, claimed in listed.items():
        text = (ROOT / page).read_text("utf-8")
        if page == TABLES:  # the tables are compared as a whole
            text = text.partition(BEGIN)[0] + text.partition(END)[2]
        found += problems(page, text, claimed, sources)
    if write:
        STORED.write_text(json.dumps(dict(sorted(sources.used.items())), indent=1) + "\n", "utf-8")
    elif not stored:
        found += sources.changed()
    print(
        "\n".join(found)
        or f"every figure of {' and '.join(WHOLE)} has its source, and so have those listed of others"
    )
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
