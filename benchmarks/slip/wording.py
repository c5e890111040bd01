"""Of figures of the slip study: the sentences that go with them."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any

from benchmarks.slip.scenes import ARMED_S, SETTLE_S
from controller.detectors.calibration import poisson_interval
from controller.reports.slip_verdicts import VERDICTS

Figures = Mapping[str, Any]
"""One result as `benchmarks.slip.report.figures` makes it."""

PAPER_VERDICTS = {
    "fingertip": "good",
    "flexible_finger": "good",
    "barrett_finger": "regular",
    "jr3_wrist": "bad",
    "dsa_taxel": "bad",
}
"""Table 1."""


def delay_s(r: Figures, name: str) -> float:
    """`median_s` or `p95_s` of a result, infinite where it falls among the missed, NaN without slips."""
    value = r[name]
    return float(value) if value is not None else math.inf if r["slips"] else math.nan


def found(
    results: Sequence[Figures], sensor: str, nuisance: str, detector: str, population: str = "off"
) -> Figures:
    """The one result with these names."""
    wanted = (sensor, nuisance, detector, population)
    return next(r for r in results if (r["sensor"], r["nuisance"], r["detector"], r["population"]) == wanted)


def found_h(r: Figures) -> tuple[float, float, float]:
    """Hours between false alarms on recordings that did not set the threshold, and their 95 % interval (Poisson)."""
    k, hours = r["false_alarms"], r["checked_h"]
    fewest, most = poisson_interval(k)
    low, high = hours / most, hours / fewest if fewest else math.inf
    return hours / k if k else math.inf, low, high


def per_reset(fresh: Figures) -> tuple[float, float, float]:
    """False alarms of a reset, from when a detector decides until it has settled, and their 95 % interval (Poisson)."""
    alarms, resets = sum(fresh["alarms"]), fresh["resets"]
    low, high = poisson_interval(alarms)
    return alarms / resets, low / resets, high / resets


def extrapolated_words(results: Sequence[Figures]) -> str:
    count = sum(r["extrapolated"] for r in results)
    return (
        f"{count} of {len(results)} thresholds are extrapolated, and labelled so."
        if count
        else (f"None of the {len(results)} thresholds is extrapolated.")
    )


def alarm_words(results: Sequence[Figures], half_h: float) -> str:
    """Where the false alarms were not equal, in words."""
    from scipy.stats import nbinom

    asked_h = VERDICTS["false_alarm_interval_s"] / 3600.0
    # n alarms set the threshold; how many come in as much time again is then negative binomial
    most = nbinom.ppf(0.975, max(1, round(half_h / asked_h)), 0.5)
    # the ramp has the clean recordings' threshold and alarms: not a row of its own here
    rows = [r for r in results if r["nuisance"] != "ramp"]
    outside, beyond = [], []
    for r in rows:
        hours, low_h, high_h = found_h(r)
        if high_h < asked_h or low_h > asked_h:
            name = f"{r['sensor']} {r['nuisance']} {r['detector']}"
            nominal = " (nominal)" if r["population"] == "nominal" else ""
            outside.append(f"{name}{nominal}, {hours:.2g} h ({low_h:.2g} to {high_h:.2g})")
            beyond += [f"{name}{nominal}"] if r["false_alarms"] > most else []
    if not outside:
        return f"No interval found excludes the {asked_h:g} h that was asked for."
    words = (
        f"In {len(outside)} of {len(rows)} rows the interval found excludes {asked_h:g} h: {'; '.join(outside)}. "
        f"A threshold that rests on {half_h / asked_h:.0f} alarms is itself uncertain: by chance alone up to "
        f"{most:.0f} alarms in the check, {half_h / most:.2g} h, are within 95 %."
    )
    if beyond:
        words += (
            f" Beyond that, so not at equal false alarms but at more than was asked for: {', '.join(beyond)}."
        )
    return words


def moved_words(results: Sequence[Figures]) -> str:
    """Whether slips of a tip that a push had moved before are harder, in words."""
    said = []
    for r in results:
        moved, missed = r["moved_before"], r["missed_moved_before"]
        if r["detector"] != "slip" or r["population"] != "off" or r["nuisance"] != "loads" or not moved:
            continue
        rest, others = r["slips"] - moved, round(r["missed"] * r["slips"]) - missed
        said.append(f"{r['sensor']} {moved} ({missed} missed; of the other {rest}, {others})")
    if not said:
        return "No tip had been moved by a load step before the arm started."
    return f"Tips that a load step had moved before the arm started: {'; '.join(said)}."


def fresh_words(results: Sequence[Figures]) -> str:
    """What the first seconds after a reset are like, what would help, and what it would cost."""
    rows = [r for r in results if r["population"] == "off" and r["nuisance"] != "ramp"]
    words = []
    for detector in ("slip", "slip.paper"):
        theirs = [r["fresh"] for r in rows if r["detector"] == detector]
        shares = [100.0 * per_reset(fresh)[0] for fresh in theirs]
        seconds = [sum(counts) for counts in zip(*(fresh["alarms"] for fresh in theirs), strict=True)]
        words.append(
            f"`{detector}` alarms in {min(shares):.2f} to {max(shares):.2f} of 100 resets, row by row; of its "
            f"{sum(seconds)} alarms {', '.join(str(count) for count in seconds)} come in the second, third, fourth and "
            "fifth second."
        )
    dearer_s = [
        delay_s(r["fresh"], "median_s") - delay_s(r, "median_s")
        for r in rows
        if r["detector"] == "slip" and delay_s(r["fresh"], "median_s") < math.inf
    ]
    blind_s = SETTLE_S - ARMED_S
    if dearer_s:
        words.append(
            f"To arm it only after {SETTLE_S:g} s would be no better answer: a slip that begins as soon as it is armed "
            f"now would be told {blind_s:g} s late, and all that begin more than {VERDICTS['missed_after_s']:g} s "
            "before it is armed would be missed, whereas the threshold that keeps these seconds as quiet costs at most "
            f"{1e3 * max(dearer_s):.0f} ms in the median. Where a trial is short and each arms anew, take that "
            "threshold, or let the detector listen while the tip rolls before the slip."
        )
    return " ".join(words)


def bound_words(nominal: Sequence[Figures], bounds: Mapping[str, Figures]) -> str:
    words = []
    for sensor, bound in bounds.items():
        clairvoyant = found(nominal, sensor, "clean", "clairvoyant", "nominal")
        if bound["bound_s"] is None:
            words.append(
                f"{sensor}: on slips that it was not fitted to, the clairvoyant's mean is not above zero. What slip "
                f"adds is less than the fit's own error: no bound can be stated, it misses "
                f"{100 * clairvoyant['missed']:.0f} % itself, and there is little for any algorithm to find."
            )
        if clairvoyant["early"] > clairvoyant["slips"]:
            words.append(
                f"{sensor}: the clairvoyant alarms early in {clairvoyant['early']} of "
                f"{clairvoyant['early'] + clairvoyant['slips']} trials, presumably because it was fitted to rolling "
                "without the arm's start; the delays of the rest are no fair yardstick."
            )
    return "\n\n".join(words)


def verdict_words(nominal: Sequence[Figures]) -> str:
    words = []
    for sensor, word in PAPER_VERDICTS.items():
        theirs = found(nominal, sensor, "clean", "slip.paper", "nominal")
        if theirs["verdict"] != word:
            words.append(
                f"{sensor} comes out {theirs['verdict']} where the paper says {word}: its noise is not printed and is "
                f"assumed here, and the detector is judged at its own threshold, on {theirs['slips']} slips instead of "
                "one."
            )
    return "\n\n".join(words) if words else "All five come out as the paper says."
