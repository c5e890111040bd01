"""The figures on the benchmarks' pages, from results/*.json and a few passages: `python -m benchmarks.drawings`.

`python -m benchmarks.drawings pictures` takes those of README and tutorial.

Colours and markers are the reports': ours, the paper's, rivals, the truth or a bound (`controller.reports.figures`).
"""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from shutil import which
from subprocess import DEVNULL, PIPE, Popen, check_call
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from benchmarks.pretouch import SPEEDS_M_S, Event, PassageRecord, passage, template
from benchmarks.results import FOLDER, ROOT
from controller.reports.figures import FAINT, INK, LOOKS, OURS, PAPER, RIVAL, TRUTH, Drawing, Figures
from simulator.physics.aura_settings import OBJECTS, SIDES

OUT, PICTURES = FOLDER.parent / "figures", ROOT / "docs" / "pictures"
SCREEN: Any = {"width": 1280, "height": 800}
"""Of the pictures of README and tutorial."""

WAIT_MS = 120_000
"""For a trial on the wire."""

SEED = 7
"""Of the passages that are shown."""


def main(names: Sequence[str]) -> None:
    """Draw those of these names, or all."""
    if "pictures" in names:
        pictures()
    if {"pictures", "timeline"} & set(names):
        timeline()
    for figure in (skipped, sides, undulations, grasp_front):
        if names and figure.__name__ not in names:
            continue
        with TemporaryDirectory() as folder:
            figures = Figures(Path(folder), simulated="" if figure is skipped else "simulated", also=("png",))
            name = figure(figures)
            (OUT / f"{name}.png").write_bytes((Path(folder) / f"{name}.png").read_bytes())


def saved(drawing: Drawing, name: str) -> str:
    """Write it under a name, which is returned."""
    drawing.save(name)
    return name


def skipped(figures: Figures) -> str:
    """Processor time a bench second of each experiment, cycle by cycle and with what is skipped."""
    loop = json.loads((FOLDER / "loop.json").read_text(encoding="utf-8"))
    before = loop["earlier"]["cycle_by_cycle_virtual_s_per_s"]
    names = sorted(before, key=lambda name: float(loop["campaigns"][name]["virtual_s_per_s"]))
    with figures.figure(3.4) as drawing:
        (axes,) = drawing.axes
        for place, name in enumerate(names):
            whole = 1e3 / float(np.mean(before[name]))
            now = 1e3 / loop["campaigns"][name]["virtual_s_per_s"]
            axes.plot([now, whole], [place, place], color=FAINT, lw=1.0, zorder=1)
            axes.plot(whole, place, "s", color=RIVAL, ms=5, label="" if place else "cycle by cycle")
            axes.plot(now, place, "o", color=OURS, ms=5, label="" if place else "with what is skipped")
            axes.text(whole * 1.2, place, f"{whole / now:.1f} times", color=INK, fontsize=8, va="center")
        axes.set(xscale="log", xlabel="processor time a second of bench (ms)", xlim=(0.2, 500))
        axes.set_yticks(range(len(names)), names)
        axes.legend(loc="lower left", fontsize=8, frameon=False)
        return saved(drawing, "loop_skipped")


def mixed(colour: str, share: float) -> tuple[float, ...]:
    """A colour with a share of ink in it: rivals have one hue, and differ by lightness and marker."""
    from matplotlib.colors import to_rgb

    return tuple((1.0 - share) * a + share * b for a, b in zip(to_rgb(colour), to_rgb(INK), strict=True))


def below(drawing: Drawing, columns: int) -> None:
    """One legend for all panels."""
    handles, names = drawing.axes[0].get_legend_handles_labels()
    drawing.figure.legend(handles, names, loc="outside lower center", ncols=columns)


def change(record: PassageRecord) -> Any:
    """Change since the rest before the motion, in thousandths of full scale."""
    return 1e3 * (record.z - record.z[: record.begun].mean())


def sides(figures: Figures) -> str:
    """Each side approaches the pipe, touches it and retracts, whole and enlarged."""
    with figures.figure(7.5, rows=len(SIDES), columns=2, sharex="col") as drawing:
        for place, side in enumerate(SIDES):
            record = passage(Event(SEED, 0, "touch", "pipe", side, 0.01))
            whole, far = drawing.axes[2 * place : 2 * place + 2]
            z, t = change(record), record.times_s - record.times_s[record.begun]
            for axes, part in (
                (whole, slice(0, None, 8)),
                (far, slice(record.begun, record.begun + 4800, 4)),
            ):
                axes.plot(t[part], z.real[part], color=INK, lw=0.7, label="in phase")
                axes.plot(t[part], z.imag[part], color=PAPER, lw=0.7, ls=(0, (3, 1)), label="in quadrature")
            whole.axvspan(t[record.touched or 0], t[(record.released or 1) - 1], color=TRUTH, alpha=0.2, lw=0)
            whole.set_ylabel(side)
            far.set_ylim(-1.5, 1.5)
        for axes in drawing.axes[-2:]:
            axes.set_xlabel("time since the arm set out (s)")
        drawing.figure.supylabel("change (1e-3 of full scale)", fontsize=9.5)
        below(drawing, 2)
        return saved(drawing, "aura_sides")


def undulations(figures: Figures) -> str:
    """The same undulations at two speeds over distance, and the echo of each object."""
    with figures.figure(3.2, columns=2) as drawing:
        speeds, echoes = drawing.axes
        for place, speed_m_s in enumerate(SPEEDS_M_S):
            record = passage(Event(SEED, 0, "near", "pipe", "normal", speed_m_s))
            way = slice(record.begun, record.arrived)
            style: Any = {"color": (INK, PAPER)[place], "lw": 0.8, "label": f"{100.0 * speed_m_s:g} cm/s"}
            speeds.plot(1e3 * record.gap_m[way], change(record).real[way] - 4.0 * place, **style)
        for place, name in enumerate(OBJECTS):
            event = Event(SEED, 0, "near", name, "normal", 0.01)
            record, (echo, _, _) = passage(event), template(event)
            way = slice(record.begun, record.arrived, 20)
            style = {"color": mixed(FAINT, place / len(OBJECTS)), "marker": "o^v<>sDPXhd"[place], "ms": 3.0}
            soft = {"ls": (0, (2, 2))} if OBJECTS[name].absorption > 0.5 else {}
            size = 1e3 * np.abs(echo[way])
            about = {"markevery": 40, "lw": 0.8, "label": name.replace("_", " "), **style, **soft}
            echoes.semilogy(1e3 * record.gap_m[way], size, **about)
        speeds.set_ylabel("change in phase (1e-3 FS), one 4 lower")
        echoes.set_ylabel("sent back (1e-3 FS)")
        for axes in drawing.axes:
            axes.set_xlabel("distance (mm)")
            axes.invert_xaxis()
            axes.legend(ncols=2, fontsize=7.5)
        return saved(drawing, "aura_speeds")


# --- the README's picture ---------------------------------------------------------------------------


def timeline() -> None:
    """README's grasp: the figure of the report on one, at twice its size."""
    from playwright.sync_api import sync_playwright

    chromium = which("chromium") or which("chromium-browser") or which("google-chrome")
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        run = [sys.executable, "run.py", "run", "mock/grasp", "--only", "2", "--out", folder]
        check_call(run, cwd=ROOT, stdout=DEVNULL)
        (figure,) = Path(folder).rglob("grasp.svg")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        screen = browser.new_page(viewport={"width": 690, "height": 348}, device_scale_factor=2)
        screen.goto(figure.as_uri())
        screen.screenshot(path=PICTURES / "grasp.png")


def grasp_front(figures: Figures) -> str:
    """What each rule of the grasp drops against what it crushes: fixed grips trade one for the other."""
    rules = json.loads((FOLDER / "grasp.json").read_text(encoding="utf-8"))["rules"]
    own: dict[str, Any] = {"ours": {**LOOKS["ours"], "label": "ours", "ms": 10.0, "mfc": "white", "mew": 1.5}}
    own["oracle, fixed at 1.65 of the least"] = {**LOOKS["truth"], "label": "fixed, the least known"}
    with figures.figure(3.2) as drawing:
        (axes,) = drawing.axes
        fixed = [name for name in rules if name.startswith("fixed")]
        axes.plot(*zip(*(_lost(rules[name]) for name in fixed), strict=True), color=RIVAL, lw=0.9)
        for name in (each for each in rules if not each.startswith("ours, ")):
            dropped, crushed = _lost(rules[name])
            rival = {"color": RIVAL, "marker": "o" if name in fixed else "s", "ls": ""}
            axes.plot(dropped, crushed, **{**rival, **own.get(name, {}), "ls": ""})
            if name in fixed or "steps" in name or "ramp" in name:
                said = name.removeprefix("fixed, ").replace(" slip detector", "").partition(", 25")[0]
                axes.annotate(
                    said,
                    (dropped, crushed),
                    (5, -11 if "ramp" in name else 3),
                    textcoords="offset points",
                    fontsize=7.5,
                )
        axes.set(
            xlabel="dropped or not lifted, of 100", ylabel="crushed, of 100", xlim=(-4, 110), ylim=(-4, 80)
        )
        axes.legend(loc="upper right")
        return saved(drawing, "grasp_front")


def _lost(rule: Any) -> tuple[float, float]:
    """Of a hundred objects, what was dropped or not lifted, and what was crushed."""
    n = rule["objects"]
    return 100 * rule["dropped"]["count"] / n, 100 * rule["crushed"]["count"] / n


def pictures() -> None:
    """Take README's and the tutorial's: the first screen of the report of approaches that our detector stops, light and
    dark, and the live page of an emulated run, before and after Pause."""
    from playwright.sync_api import sync_playwright  # with the tests' Chromium

    chromium = which("chromium") or which("chromium-browser") or which("google-chrome")
    with TemporaryDirectory() as folder, sync_playwright() as playwright:
        run = [sys.executable, "run.py", "run", "--out", folder]
        ours = ["mock/transient", "--set", "behavior.detector=ours"]
        check_call([*run, *ours], cwd=ROOT, stdout=DEVNULL)
        (page,) = Path(folder).rglob("report.html")
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        for scheme in ("light", "dark"):
            screen = browser.new_page(viewport=SCREEN, color_scheme=scheme)
            screen.goto(page.as_uri())
            screen.screenshot(path=PICTURES / f"report_{scheme}.png")
        asked = [word for trial in (1, 2, 3) for word in ("--only", str(trial))]
        watched = [*run, "emulated/transient", "--watch", "--no-report", *asked]
        with Popen(watched, cwd=ROOT, stdout=PIPE, text=True) as going:
            link = next(
                word for line in going.stdout or () for word in line.split() if word.startswith("http")
            )
            screen = browser.new_page(viewport=SCREEN)
            screen.goto(link)
            screen.locator("#verdict", has_text="1 of 3").wait_for(timeout=WAIT_MS)
            running, seen = b"", ""
            while seen != "APPROACH":  # a busy machine takes the picture of a later state
                screen.wait_for_selector('body[data-state="APPROACH"]', timeout=WAIT_MS)
                running = screen.screenshot()
                seen = screen.locator("#state").inner_text()
            (PICTURES / "live_running.png").write_bytes(running)
            screen.get_by_role("button", name="Pause").click()
            screen.wait_for_selector('body[data-state="PAUSED"]')
            screen.wait_for_timeout(2000)
            screen.screenshot(path=PICTURES / "live_paused.png")
            screen.get_by_role("button", name="Stop").click()


if __name__ == "__main__":
    main(sys.argv[1:])
