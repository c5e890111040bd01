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
    extrapolated_words,
    found,
    found_h,
    fresh_words,
    moved_words,
    per_reset,
    verdict_words,
)
from controller.reports.counts import rate
from controller.reports.slip_verdicts import LEAST, VERDICTS

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

FRESH_HEAD = (
    "sensor",
    "nuisance",
    "detector",
    "resets",
    "alarms in 100 resets (95 %)",
    "of them in second 2, 3, 4, 5",
    "threshold for these seconds (95 %)",
    "median, ms",
    "p95, ms",
    "missed",
)
"""Of the table of the first seconds after a reset."""


def milliseconds(seconds: float) -> str:
    """A delay for a table; a quantile that falls among the missed has none."""
    return "missed" if math.isinf(seconds) else "–" if math.isnan(seconds) else f"{1e3 * seconds:.0f}"


def _spoken(seconds: float) -> str:
    return "a miss" if math.isinf(seconds) else f"{1e3 * seconds:.0f} ms"


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
        "trials": result.trials,
        "moved_before": int(s.moved_before.sum()),
        "missed_moved_before": s.missed_moved_before,
        "fresh": _fresh_figures(result),
    }


def _fresh_figures(result: Result) -> dict[str, Any]:
    fresh, s = result.fresh, result.fresh_score
    c = fresh.calibration
    return {
        "resets": fresh.resets,
        "alarms": list(fresh.alarms),
        "threshold": c.threshold,
        "threshold_low": c.low,
        "threshold_high": _number(c.high),
        "extrapolated": c.extrapolated,
        "slips": int(s.delays_s.size),
        "early": s.early,
        "median_s": _number(s.quantile_s(0.5)),
        "p95_s": _number(s.quantile_s(0.95)),
        "missed": _number(s.missed),
    }


def _number(value: float) -> float | None:
    return value if math.isfinite(value) else None


def _row(r: Figures) -> list[str]:
    hours, low_h, high_h = found_h(r)
    said_h = f"> {r['checked_h']:.1f}" if math.isinf(hours) else f"{hours:.1f}"
    return [
        r["sensor"],
        r["nuisance"],
        r["detector"],
        _threshold(r),
        f"{said_h} ({low_h:.1f} to {'∞' if math.isinf(high_h) else f'{high_h:.1f}'})",
        milliseconds(delay_s(r, "median_s")),
        milliseconds(delay_s(r, "p95_s")),
        "–" if r["missed"] is None else f"{100 * r['missed']:.1f} %",
        f"{r['slips']} / {r['early']}",
    ]


def _threshold(r: Figures) -> str:
    high = "∞" if r["threshold_high"] is None else f"{r['threshold_high']:.3g}"
    label = ", extrapolated" if r["extrapolated"] else ""
    return f"{r['threshold']:.3g} ({r['threshold_low']:.3g} to {high}){label}"


def _fresh_row(r: Figures) -> list[str]:
    fresh = r["fresh"]
    mean, low, high = (100.0 * value for value in per_reset(fresh))
    return [
        r["sensor"],
        r["nuisance"],
        r["detector"],
        str(fresh["resets"]),
        f"{mean:.2f} ({low:.2f} to {high:.2f})",
        ", ".join(str(count) for count in fresh["alarms"]),
        _threshold(fresh),
        milliseconds(delay_s(fresh, "median_s")),
        milliseconds(delay_s(fresh, "p95_s")),
        "–" if fresh["missed"] is None else f"{100 * fresh['missed']:.1f} %",
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
        _scored_of(ours, theirs),
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
        _scored_of(ours, theirs),
        f"median {_spoken(median_s)}, p95 {_spoken(p95_s)}, "
        f"{rate(round(ours['missed'] * ours['slips']), ours['slips'])} missed; "
        f"the paper's misses {100 * theirs['missed']:.0f} %",
        "missed" if not met else "met by the median, not by p95" if late else "met",
    ]


def _scored_of(ours: Figures, theirs: Figures) -> str:
    """`398 of 400, 2 early`: what the figures beside it rest on; both detectors where they differ."""
    said = []
    for r in (ours, theirs):
        early = f", {r['early']} early" if r["early"] else ""
        still = r["trials"] - r["slips"] - r["early"]
        never = f", {still} never slid" if still else ""
        said.append(f"{r['slips']} of {r['trials']}{early}{never}")
    return said[0] if said[0] == said[1] else f"{said[0]}; the paper's {said[1]}"


def document(study: Mapping[str, Any]) -> str:
    """The page.

    Args:
        study: What is in the study's JSON file.
    """
    results: Sequence[Figures] = study["results"]
    scored = [r for r in results if r["population"] == "off"]
    nominal = [r for r in results if r["population"] == "nominal"]
    nuisances = "\n".join(f"- *{name}*: {what}." for name, what in scenes.NUISANCES.items())
    interval_h, half_h = VERDICTS["false_alarm_interval_s"] / 3600.0, study["hours"] / 2.0
    late_s = VERDICTS["missed_after_s"]
    armed_s, settle_s = scenes.ARMED_S, scenes.SETTLE_S
    settled = 100.0 * (settle_s - armed_s) / VERDICTS["false_alarm_interval_s"]
    asked = table(["case", "asked", "slips scored", "found", ""], targets(results))
    off_rows = table(HEAD, [_row(r) for r in scored])
    nominal_rows = table(HEAD, [_row(r) for r in nominal])
    # the ramp's recordings are those of clean
    fresh_rows = table(FRESH_HEAD, [_fresh_row(r) for r in scored if r["nuisance"] != "ramp"])
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
{study["slips_each"]} trials each. Every trial in which the contact slides after the arm has started is scored, whether
or not a push had moved the tip on before: a choice of those that nothing had moved would be a choice of the calm.
`slip` has the same settings everywhere and knows no sensor; its threshold is calibrated per sensor and nuisance. A
slip that is not reported within {late_s:g} s is missed. Delays run from the contact's first motion after the arm has
started to the sample that decided.

{nuisances}
- *ramp*: clean, and the arm takes 50 ms to its speed; thresholds of clean.

![Share of slips reported after a time](../figures/slip_delays.png)

## What was asked for

{asked}

{moved_words(results)}

## All of it

"early" counts trials with an alarm between the arm's start and the slip; they are not among the delays. The interval
of a threshold comes from the recordings that set it, that of the false-alarm interval from those that check it.

{off_rows}

{alarm_words(results, half_h)}

Bumps are sized in slip events. On the JR3 and the taxel they are as far below the noise as slip is, and change nothing.

![A slip among bumps](../figures/slip_example.png)

## In the first seconds after a reset

"One in {interval_h:g} h" above is a detector that runs on: the first {settle_s:g} s of each recording are left out
there. Here it is begun anew every {settle_s:g} s, in the recordings that check, and its false alarms from
{armed_s:g} to {settle_s:g} s after each reset are counted, at the thresholds above. As often as later would be
{settled:.2f} in 100 resets. The last columns are the threshold that keeps one in {interval_h:g} h in these seconds, and
what it costs.

{fresh_rows}

{fresh_words(results)}

## With the plant's own parameters

Nominal structures, clean. *clairvoyant* is a Gaussian likelihood-ratio CUSUM fitted to the very plant that it is scored
on: a yardstick, not a method. The bound is log(ARL)/KL with the clairvoyant's mean log-likelihood ratio in slip for KL,
one sample at least. It holds for a slip that has its full strength at once; these ring up first.

{nominal_rows}

{bound_rows}

{bound_words(nominal, study["bounds"])}

## Verdicts

By `controller/reports/slip_verdicts.toml`, fixed before the first run. Clean recordings, nominal structures. Judged are
the slips that were told or missed, at least {LEAST} of them; those called early are a failure beside the verdict.

{verdict_rows}

{verdict_words(nominal)}

## Cost

{cost_rows}

The study took {study["wall_s"] / 60:.0f} minutes; {study["cpu_s"] / 60:.0f} of processor time on all cores together.
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
        rows.append([sensor, word, *(_verdict(r) for r in (theirs, ours)), said])
    return rows


def _verdict(r: Figures) -> str:
    """`good`, or `good, 1 of 100 early`."""
    return (
        f"{r['verdict']}, {r['early']} of {r['early'] + r['slips']} early"
        if r["early"]
        else str(r["verdict"])
    )


def write_page(name: str) -> str:
    """Write `results/NAME.md` from `results/NAME.json`; returns the page."""
    study = json.loads((FOLDER / f"{name}.json").read_text(encoding="utf-8"))
    page = document(study)
    (FOLDER / f"{name}.md").write_text(page, encoding="utf-8")
    return page
