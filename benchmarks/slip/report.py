"""The study as a page, from its JSON file: what was compared, how often it alarmed falsely, how late it was."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.results import FOLDER, table
from benchmarks.slip import scenes
from benchmarks.slip.study import PAPER_THRESHOLDS, Result
from benchmarks.slip.wording import (
    PAPER_VERDICTS,
    Figures,
    alarm_words,
    bound_words,
    delay_s,
    endurance_words,
    extrapolated_words,
    found,
    found_h,
    verdict_words,
)
from controller.reports.slip_verdicts import VERDICTS

RATIOS = {("fingertip", "clean"): 5, ("flexible_finger", "clean"): 4, ("barrett_finger", "clean"): 3}
RAMP_RATIO = 2
"""How many times faster than the paper's detector is asked for."""

NUISANCE_LIMIT_S, NUISANCE_MISSED = 0.060, 0.05
"""Asked for with bumps and load steps: median delay and share of missed slips."""

COST_LIMIT_NS = 1000.0
"""Asked for: at most, a sample a channel."""

HEAD = (
    "sensor",
    "nuisance",
    "detector",
    "threshold (95 %)",
    "false-alarm interval found, h (95 %)",
    "median, ms",
    "p95, ms",
    "missed",
    "slips / early",
)
"""Of the tables of results."""


def milliseconds(seconds: float) -> str:
    """A delay for a table; a quantile that falls among the missed has none."""
    return "missed" if math.isinf(seconds) else "–" if math.isnan(seconds) else f"{1e3 * seconds:.0f}"


def figures(result: Result) -> dict[str, Any]:
    """One result for the JSON file."""
    c, s = result.calibration, result.score
    return {
        "sensor": result.sensor,
        "nuisance": result.nuisance,
        "population": result.population,
        "detector": result.detector,
        "threshold": c.threshold,
        "threshold_low": c.low,
        "threshold_high": None if math.isinf(c.high) else c.high,
        "calibrated_h": c.recording_s / 3600.0,
        "extrapolated": c.extrapolated,
        "false_alarms": result.false_alarms,
        "checked_h": result.checked_h,
        "slips": int(s.delays_s.size),
        "early": s.early,
        "median_s": _number(s.quantile_s(0.5)),
        "p95_s": _number(s.quantile_s(0.95)),
        "missed": _number(s.missed),
        "verdict": result.verdict,
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _row(r: Figures) -> list[str]:
    hours, low_h, high_h = found_h(r)
    high = "∞" if r["threshold_high"] is None else f"{r['threshold_high']:.3g}"
    said_h = f"> {r['checked_h']:.1f}" if math.isinf(hours) else f"{hours:.1f}"
    return [
        r["sensor"],
        r["nuisance"],
        r["detector"],
        f"{r['threshold']:.3g} ({r['threshold_low']:.3g} to {high}){', extrapolated' if r['extrapolated'] else ''}",
        f"{said_h} ({low_h:.1f} to {'∞' if math.isinf(high_h) else f'{high_h:.1f}'})",
        milliseconds(delay_s(r, "median_s")),
        milliseconds(delay_s(r, "p95_s")),
        "–" if r["missed"] is None else f"{100 * r['missed']:.1f} %",
        f"{r['slips']} / {r['early']}",
    ]


def targets(results: Sequence[Figures]) -> list[list[str]]:
    """What was asked for and what came out."""
    rows = []
    for (sensor, nuisance), asked in RATIOS.items():
        rows.append(_ratio_row(results, sensor, nuisance, asked))
        rows.append(_ratio_row(results, sensor, "ramp", RAMP_RATIO))
    for sensor, _ in RATIOS:
        for nuisance in ("bumps", "loads"):
            rows.append(_nuisance_row(results, sensor, nuisance))
    return rows


def _ratio_row(results: Sequence[Figures], sensor: str, nuisance: str, asked: float) -> list[str]:
    ours = found(results, sensor, nuisance, "slip")
    theirs = found(results, sensor, nuisance, "slip.paper")
    said, ratios = [], []
    for word, name in (("median", "median_s"), ("p95", "p95_s")):
        theirs_s, ours_s = delay_s(theirs, name), delay_s(ours, name)
        # a miss is later than the time after which a slip counts as missed: the ratio is at least this
        ratio = min(theirs_s, VERDICTS["missed_after_s"]) / ours_s
        ratios.append(ratio)
        if math.isinf(ours_s):
            said.append(f"{word}: ours is a miss")
        elif math.isinf(theirs_s):
            said.append(
                f"{word}: the paper's is a miss ({100 * theirs['missed']:.1f} % missed), ours {1e3 * ours_s:.0f} ms: "
                f"more than {ratio:.0f}"
            )
        else:
            said.append(f"{word} {1e3 * theirs_s:.0f} to {1e3 * ours_s:.0f} ms: {ratio:.1f}")
    return [
        f"{sensor}, {nuisance}",
        f"{asked} times faster",
        "; ".join(said),
        "met" if min(ratios) >= asked else "median met, p95 not" if ratios[0] >= asked else "missed",
    ]


def _nuisance_row(results: Sequence[Figures], sensor: str, nuisance: str) -> list[str]:
    ours = found(results, sensor, nuisance, "slip")
    theirs = found(results, sensor, nuisance, "slip.paper")
    median_s, p95_s = delay_s(ours, "median_s"), delay_s(ours, "p95_s")
    met = median_s <= NUISANCE_LIMIT_S and ours["missed"] <= NUISANCE_MISSED
    late = p95_s > NUISANCE_LIMIT_S
    return [
        f"{sensor}, {nuisance}",
        f"at most {1e3 * NUISANCE_LIMIT_S:.0f} ms, {100 * NUISANCE_MISSED:.0f} % missed",
        f"median {milliseconds(median_s)} ms, p95 {milliseconds(p95_s)} ms, {100 * ours['missed']:.1f} % missed; "
        f"the paper's misses {100 * theirs['missed']:.0f} %",
        "missed" if not met else "met by the median, not by p95" if late else "met",
    ]


def document(study: Mapping[str, Any], endurance: Mapping[str, Any] | None) -> str:
    """The page.

    Args:
        study: What is in the study's JSON file.
        endurance: What is in that of the run of 1e9 samples, where there is one.
    """
    results: Sequence[Figures] = study["results"]
    scored = [r for r in results if r["population"] == "off"]
    nominal = [r for r in results if r["population"] == "nominal"]
    nuisances = "\n".join(f"- *{name}*: {what}." for name, what in scenes.NUISANCES.items())
    interval_h, half_h = VERDICTS["false_alarm_interval_s"] / 3600.0, study["hours"] / 2.0
    late_s = VERDICTS["missed_after_s"]
    asked = table(["case", "asked", "found", ""], targets(results))
    off_rows = table(HEAD, [_row(r) for r in scored])
    nominal_rows = table(HEAD, [_row(r) for r in nominal])
    bound_head = ["sensor", "nat a sample", "bound, ms", "slip, ms above it", "slip.paper, ms above it"]
    bound_rows = table(bound_head, _bound_rows(nominal, study["bounds"]))
    verdict_head = ["sensor", "the paper says", "slip.paper", "slip", "the printed threshold"]
    verdict_rows = table(verdict_head, _verdict_rows(nominal))
    costs: Mapping[str, float] = study["ns_per_sample"]
    cost_rows = table(
        ["detector", "ns a sample a channel", f"asked: at most {COST_LIMIT_NS:.0f}"],
        [[name, f"{ns:.0f}", "met" if ns <= COST_LIMIT_NS else "missed"] for name, ns in costs.items()],
    )
    return f"""# Slip: at equal false alarms

Everything on this page is simulated: [what, and what is assumed](../../docs/explanation/slip.md).

Thresholds are set for one false alarm in {interval_h:g} h, on {half_h:.1f} h without slip for each sensor, nuisance
and detector, and checked on {half_h:.1f} h more ("found"). {extrapolated_words(results)}
The detectors are scored on structures whose frequency is off by 30 % and whose damping by a factor of 3, either way,
{study["slips_each"]} trials each; a trial in which the contact never slid, or slid before the arm started, is left out.
`slip` has the same settings everywhere and knows no sensor; its threshold is calibrated per sensor and nuisance. A
slip that is not reported within {late_s:g} s is missed. Delays run from the first motion of the contact
to the sample that decided.

{nuisances}
- *ramp*: clean, and the arm takes 50 ms to its speed; thresholds of clean.

![Share of slips reported after a time](../figures/slip_delays.png)

## What was asked for

{asked}

## All of it

"early" counts trials with an alarm between the arm's start and the slip; they are not among the delays. The interval
of a threshold comes from the recordings that set it, that of the false-alarm interval from those that check it.

{off_rows}

{alarm_words(results, half_h)}

Bumps are sized in slip events. On the JR3 and the taxel they are as far below the noise as slip is, and change nothing.

![A slip among bumps](../figures/slip_example.png)

## With the plant's own parameters

Nominal structures, clean. *clairvoyant* is a Gaussian likelihood-ratio CUSUM fitted to the very plant that it is scored
on: a yardstick, not a method. The bound is log(ARL)/KL with the clairvoyant's mean log-likelihood ratio in slip for KL,
one sample at least. It holds for a slip that has its full strength at once; these ring up first.

{nominal_rows}

{bound_rows}

{bound_words(nominal, study["bounds"])}

## Verdicts

By `controller/reports/slip_verdicts.toml`, fixed before the first run. Clean recordings, nominal structures.

{verdict_rows}

{verdict_words(nominal)}

## Cost

{cost_rows}

{endurance_words(endurance)}

The study took {study["cpu_s"]:.0f} s of one core.
"""


def _bound_rows(nominal: Sequence[Figures], bounds: Mapping[str, Figures]) -> list[list[str]]:
    rows = []
    for sensor, bound in bounds.items():
        nats, bound_s = bound["nats_per_sample"], bound["bound_s"]
        said = ["none"] * 3
        if bound_s is not None:
            delays = [
                delay_s(found(nominal, sensor, "clean", name, "nominal"), "median_s")
                for name in ("slip", "slip.paper")
            ]
            said = [f"{1e3 * bound_s:.3g}", *(milliseconds(value - bound_s) for value in delays)]
        rows.append([sensor, f"{nats:.3g}", *said])
    return rows


def _verdict_rows(nominal: Sequence[Figures]) -> list[list[str]]:
    rows = []
    for sensor, word in PAPER_VERDICTS.items():
        theirs, ours = (found(nominal, sensor, "clean", name, "nominal") for name in ("slip.paper", "slip"))
        printed = PAPER_THRESHOLDS.get(sensor)
        said = "none printed"
        if printed is not None:
            said = f"{printed:g}; ours for an hour is {theirs['threshold']:.3g}"
        rows.append([sensor, word, theirs["verdict"], ours["verdict"], said])
    return rows


def write_page(name: str) -> str:
    """Write `results/NAME.md` from `results/NAME.json` and that of the endurance run; returns the page."""
    study = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    long = FOLDER / "slip_endurance.json"
    page = document(study, json.loads(long.read_text(encoding="utf-8")) if long.exists() else None)
    (FOLDER / f"{name}.md").write_text(page, encoding="utf-8")
    return page
