"""Results of the study, and rates from them."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from benchmarks.pretouch.scoring import Rate, figures, quantiles, rate
from benchmarks.pretouch.study import (
    CLAIRVOYANT,
    MATCHED,
    STATISTICS,
    PretouchSize,
    Verdict,
    contact_judges,
    pretouch_judges,
)
from drivers.mock.physics.aura_objects import SIX, SOFT

PRETOUCH, CONTACT = tuple(pretouch_judges({})), tuple(contact_judges({}))
OURS, OURS_CONTACT = "pretouch", "level"
PAPERS_CONTACT = tuple(name for name in CONTACT if name.startswith("level.paper"))

SHORT = (MATCHED, OURS)
"""Of the tables that compare two."""


@dataclass(frozen=True)
class RatesStudy:
    """Results of the study."""

    size: PretouchSize
    weaker_db: int
    found_db: Mapping[int, float]
    thresholds: Mapping[str, float]
    plain_thresholds: Mapping[str, float]
    matched: Sequence[Verdict]
    plain: Sequence[Verdict]
    soft: Mapping[int, Sequence[Verdict]]
    sweep: Mapping[int, Sequence[Verdict]]
    afar: Sequence[Verdict]
    by_envelope: Sequence[Verdict]
    by_carrier: Sequence[Verdict]
    blind: Mapping[str, float]
    cost_ns: Mapping[str, float] = field(default_factory=dict)
    wall_s: float = math.nan
    cpu_s: float = math.nan


Chosen = Callable[[Verdict], bool]


def everything(verdict: Verdict) -> bool:
    """All of them."""
    return True


def pretouch_rates(
    verdicts: Sequence[Verdict], name: str, chosen: Chosen = everything
) -> tuple[Rate, Rate, dict[str, float | None]]:
    """True positives, true negatives, and the distances (m) of the first."""
    seen = [v.seen_m[name] for v in verdicts if name in v.seen_m and chosen(v)]
    quiet = [not v.near[name] for v in verdicts if name in v.near and chosen(v)]
    return rate(not math.isnan(d) for d in seen), rate(quiet), quantiles(seen)


def contact_rates(
    verdicts: Sequence[Verdict], name: str, chosen: Chosen = everything
) -> tuple[Rate, Rate, dict[str, Rate], dict[str, float | None]]:
    """True positives, true negatives, outcomes of the touches, and the delays (s)."""
    touches = [v.touch[name] for v in verdicts if name in v.touch and chosen(v)]
    quiet = [not v.touched[name] for v in verdicts if name in v.touched and chosen(v)]
    delays_s = [t.delay_s for t in touches]
    more = {
        "early": rate(t.early for t in touches),
        "held": rate(t.held for t in touches),
        "ended": rate(t.ended for t in touches),
    }
    return rate(not math.isnan(d) for d in delays_s), rate(quiet), more, quantiles(delays_s)


def best_paper_contact(verdicts: Sequence[Verdict]) -> str:
    """The best window of the paper's z-score."""
    return max(PAPERS_CONTACT, key=lambda name: contact_rates(verdicts, name)[0].share)


def by_object(names: Sequence[str]) -> dict[str, Chosen]:
    """Verdicts by object."""

    def of(name: str) -> Chosen:
        return lambda verdict: verdict.event.object == name

    return {name: of(name) for name in names}


def _not_the_top(verdict: Verdict) -> bool:
    return verdict.event.side != "top"


def disagreements(study: RatesStudy) -> dict[str, int]:
    """Passages in which a detector's result differs between carrier and envelope level, by detector."""
    found = {}
    paper = best_paper_contact(study.matched)
    for name in (MATCHED, OURS, paper, OURS_CONTACT):
        found[name] = sum(
            _detected(a, name) != _detected(b, name)
            for a, b in zip(study.by_envelope, study.by_carrier, strict=True)
        )
    return found


def _detected(verdict: Verdict, name: str) -> bool:
    if name in verdict.seen_m:
        return not math.isnan(verdict.seen_m[name])
    if name in verdict.touch:
        return not math.isnan(verdict.touch[name].delay_s)
    return verdict.near[name] if name in verdict.near else verdict.touched[name]


def numbers(study: RatesStudy) -> dict[str, Any]:
    """The JSON file."""
    return {
        "simulated": True,
        "weaker_db": study.weaker_db,
        "found_db": {str(db): share for db, share in study.found_db.items()},
        "passages": len(study.matched),
        "matched": _all_rates(study.matched, study.thresholds),
        "matched_but_top": _contact_numbers(study.matched, _not_the_top),
        "beside_the_bound": _pretouch_numbers(
            [v for v in study.matched if CLAIRVOYANT in v.seen_m], (CLAIRVOYANT, OURS)
        ),
        "plain": _all_rates(study.plain, study.plain_thresholds),
        "soft": {
            str(db): _all_rates(verdicts, study.thresholds if db else study.plain_thresholds, SOFT)
            for db, verdicts in study.soft.items()
        },
        "sweep": {str(db): _pretouch_numbers(verdicts, SHORT) for db, verdicts in study.sweep.items()},
        "afar": _pretouch_numbers(study.afar, PRETOUCH),
        "carrier": {"passages": len(study.by_carrier), "disagreements": disagreements(study)},
        "blind": dict(study.blind),
        "ns_per_sample": dict(study.cost_ns),
        "wall_s": study.wall_s,
        "cpu_s": study.cpu_s,
    }


def _pretouch_numbers(
    verdicts: Sequence[Verdict], names: Sequence[str], chosen: Chosen = everything
) -> dict[str, Any]:
    found = {}
    for name in names:
        positive, negative, distances = pretouch_rates(verdicts, name, chosen)
        found[name] = {"tpr": figures(positive), "tnr": figures(negative), "distance_m": distances}
    return found


def _contact_numbers(verdicts: Sequence[Verdict], chosen: Chosen = everything) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in CONTACT:
        positive, negative, more, delays = contact_rates(verdicts, name, chosen)
        found[name] = {"tpr": figures(positive), "tnr": figures(negative), "delay_s": delays}
        found[name] |= {key: figures(value) for key, value in more.items()}
    return found


def _all_rates(
    verdicts: Sequence[Verdict], thresholds: Mapping[str, float], objects: Sequence[str] = SIX
) -> dict[str, Any]:
    return {
        "thresholds": {name: float(np.float64(value)) for name, value in thresholds.items()},
        "pretouch": _pretouch_numbers(verdicts, (*PRETOUCH, *STATISTICS)),
        "contact": _contact_numbers(verdicts),
        "objects": {
            name: {
                "pretouch": _pretouch_numbers(verdicts, SHORT, chosen),
                "contact": _contact_numbers(verdicts, chosen),
            }
            for name, chosen in by_object(objects).items()
        },
    }
