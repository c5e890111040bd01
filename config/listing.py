"""What `run.py list` shows: names and summaries, nothing validated and nothing heavy imported."""

import math
import re
import shutil
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

from config.costs import counted, duration
from config.source import UNSET, ProfileError, bench_of, flatten, profile_names, read_source
from controller.registry import KINDS
from drivers.core.errors import PROGRAM

BENCHES = ("mock", "emulated", "hardware")

SUBJECTS = {
    "A": "contact from a finger's resonance (Backus and Dollar)",
    "B": "slip from micro-vibration (Fernandez et al.)",
    "C": "pre-touch and contact by ultrasound (Rupavatharam et al.)",
    "D": "both of the last: a grasp",
    "": "before the first experiment",
}
"""What the letter of an item, as A2 of the first paper's experiments, stands for."""

SCREEN = 40
"""Lines that a list may have (assumption: a screen)."""


class Listed(NamedTuple):
    """A profile as it is listed.

    Attributes:
        item: Of its paper, `A2`; "" for none.
        line: What it takes: devices, trials, time.
    """

    name: str
    item: str
    title: str
    line: str

    @property
    def bench(self) -> str:
        """The folder that it lies in."""
        return self.name.partition("/")[0]

    def fits(self, words: Iterable[str], benches: Collection[str]) -> bool:
        """Whether all words stand in it, on one of the benches, none of which means any."""
        text = f"{self.name} {self.item} {self.title} {self.line}".lower()
        return all(word.lower() in text for word in words) and (not benches or self.bench in benches)


def profiles() -> Iterator[Listed]:
    """Every profile that can be run; benches, which others extend, are none."""
    for name in profile_names():
        try:
            data = read_source(name).data
        except ProfileError as error:
            yield Listed(name, "", f"broken: {error.problems[0]}", "")
            continue
        title = str(data.get("title", ""))
        if "parts" in data:
            parts = [str(part).split()[0] for part in data["parts"]]
            item = next(_item(read_source(part).data.get("title", "")) for part in parts)[:1]
            yield Listed(name, item, title, f"one report of {', '.join(parts)}")
        elif "experiment" in data:
            yield Listed(name, _item(title), title, f"{_needs(data)}; {_trials_of(name, data)}")


def listed_profiles(words: Sequence[str] = (), benches: Collection[str] = ()) -> list[str]:
    """Profiles by the item of the paper that they repeat, or those that fit, with what they take.

    Raises:
        ProfileError: none fits.
    """
    every = list(profiles())
    found = [each for each in every if each.fits(words, benches)]
    if not found:
        asked = " ".join([*words, *(f"--{bench}" for bench in benches)])
        raise ProfileError(f"no profile fits {asked!r}; see: {PROGRAM} list")
    width = shutil.get_terminal_size((120, SCREEN)).columns
    if len(found) == len(every):
        lines = _overview(every, width)
    else:  # what they take, of as many as fill the screen
        room = SCREEN - 1 - len(found)
        lines = [f"{each.name:<28}{each.title}" for each in found]
        lines[: max(0, room)] = [
            line
            for each in found[: max(0, room)]
            for line in (f"{each.name:<28}{each.title}", f"    {each.line}")
        ]
    last = f"More: {PROGRAM} list WORD, list --hardware (--mock, --emulated); of one: {PROGRAM} check PROFILE"
    whole = "    "  # of what a profile takes nothing is cut off
    return [
        *(
            line if len(line) <= width or line.startswith(whole) else f"{line[: width - 1]}…"
            for line in lines
        ),
        last,
    ]


def _overview(every: Sequence[Listed], width: int) -> list[str]:
    """One line for a name, whatever benches have it; its variants, as `transient_arm`, stand in the same."""
    lines = [f"{'BENCH/NAME':<17}on m(ock) e(mulated) h(ardware), item of the paper, what it does"]
    together: list[str] = []
    for letter, subject in SUBJECTS.items():
        of_it = [each for each in every if each.item[:1] == letter]
        names = dict.fromkeys(
            each.name.partition("/")[2] if each.bench in BENCHES else each.name for each in of_it
        )
        whole = [each.name for each in of_it if each.item == letter and each.bench not in BENCHES]
        single = [name for name in names if name not in whole]
        if len(single) > 1:  # one line needs no heading
            lines.append(f"{letter}: {subject}" if letter else subject)
        together += [name.partition("/")[2] for name in whole]
        rows = []
        for name in single:
            if any(name.startswith(f"{other}_") for other in single):
                continue
            same = [each for each in of_it if each.name in (name, *(f"{bench}/{name}" for bench in BENCHES))]
            one = next((each for each in same if each.bench == "mock"), same[0])
            where = " ".join(
                bench[0] if any(each.bench == bench for each in same) else " " for bench in BENCHES
            )
            title = re.sub(r" \([A-D]\d[^)]*\)$", "", one.title)
            also = ", ".join(each.removeprefix(name) for each in single if each.startswith(f"{name}_"))
            before, after = f"  {name:<15}{where}  {one.item:<5}", f"; also {also}" if also else ""
            room = width - len(before) - len(after)
            rows.append(
                (one.item, f"{before}{title if len(title) <= room else f'{title[: room - 1]}…'}{after}")
            )
        lines += [line for _, line in sorted(rows, key=lambda row: row[0])]
    return [*lines, f"Several in one report: papers/ {', '.join(together)}"]


def listed_kinds(family: str, words: Sequence[str] = ()) -> list[str]:
    """Every driver, detector or signal in whose line all words stand."""
    lines = [f"{name:<20}{kind.summary}" for name, kind in KINDS[family].items()]
    return [line for line in lines if all(word.lower() in line.lower() for word in words)]


def _item(title: str) -> str:
    """`A2` of a title that ends in `(A2)` or in `(A2, along y)`."""
    found = re.search(r"\(([A-D]\d\w?)[^)]*\)$", title)
    return found[1] if found else ""


def _trials(data: Mapping[str, Any]) -> int:
    """How many a profile asks for."""
    asked = data.get("trials", {})
    cells = math.prod(len(values) for _, values in flatten(asked.get("grid", {})))
    return int(asked.get("repeats", 1)) * len(asked.get("list", [{}])) * cells


def _trials_of(name: str, data: Mapping[str, Any]) -> str:
    count = _trials(data)
    return f"{counted(count)}: {duration(name, data['experiment'], bench_of(data), count)}"


def _needs(data: Mapping[str, Any]) -> str:
    """Experiment and devices; which ports the lab has to set."""
    devices = data.get("devices", {})
    drivers = ", ".join(f"{name} ({table.get('driver')})" for name, table in devices.items())
    unset = [name for name, table in devices.items() if str(table.get("port")).startswith(UNSET)]
    ports = f"; port to set: {'all' if len(unset) == len(devices) else ', '.join(unset)}" if unset else ""
    return f"{data['experiment']} with {drivers}{ports}"
