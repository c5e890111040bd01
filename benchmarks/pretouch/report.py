"""The study as a page: what was asked, what came out, and what it was measured on."""

from __future__ import annotations

from collections.abc import Mapping

from benchmarks.pretouch.rates import (
    OURS,
    PRETOUCH,
    SHORT,
    Study,
    best_paper_contact,
    by_object,
    by_side_and_speed,
    disagreements,
    pretouch_rates,
    targets,
)
from benchmarks.pretouch.scenes import KINDS, POSITIVE, SOUND_ERROR, SPEEDS_M_S, START_M
from benchmarks.pretouch.scoring import EARLY_S, LATE_S, Rate, quantiles
from benchmarks.pretouch.study import (
    BOTH,
    CLAIRVOYANT,
    CONTACT_TNR,
    IN_MOTION,
    PAPER_TPR,
    PRETOUCH_TNR,
    SET_OUT_S,
    Size,
)
from benchmarks.pretouch.tables import (
    cm,
    contact_split,
    contact_table,
    pretouch_split,
    pretouch_table,
    quiet_table,
)
from benchmarks.results import table
from drivers.mock.physics.aura_objects import SIDES, SIX, SOFT


def document(study: Study) -> str:
    """The page."""
    paper = best_paper_contact(study.matched)
    db = study.weaker_db
    sweep = [
        [f"{step} dB", *(text for n in SHORT for text in _two(pretouch_rates(verdicts, n)))]
        for step, verdicts in study.sweep.items()
    ]
    shifts = [
        abs(a.seen_m[OURS] - b.seen_m[OURS])
        for a, b in zip(study.by_envelope, study.by_carrier, strict=True)
        if OURS in a.seen_m
    ]
    shift = quantiles(shifts)["median"]
    parts = [
        "# Pre-touch and contact at the paper's true-negative rates\n",
        "Simulated, all of it: passages of a finger from the aura's plant (docs/explanation/aura.md says what"
        " is assumed"
        " there), made by `python -m benchmarks pretouch`. docs/explanation/pretouch.md explains the detectors."
        " The paper"
        " is Rupavatharam et al., SonicFinger.\n",
        table(["asked", "found", ""], targets(study)),
        "\nHow it was made:\n",
        f"- Thresholds are set on {sum(1 for _ in _calibration(study.size)):,} passages of their own so that"
        f" {100 * PRETOUCH_TNR:.1f} % (pre-touch) and {100 * CONTACT_TNR:.1f} % (contact) of those without an"
        f" event stay"
        " quiet, the paper's TNR. The rates below are of other passages, with other noise. The detectors' form was"
        " worked out on a third set.",
        "- A passage is scored whole: one false word anywhere in some 5 to 15 s makes it a false positive.",
        f"- The air is {100 * SOUND_ERROR:.0f} % faster or slower than the detectors believe, in turn; the"
        f" echo's phase and"
        " strength vary from passage to passage and are unknown to them, and so is its decay.",
        f"- An approach begins {100 * START_M:.1f} cm before the object, so nothing can be seen from farther;"
        f" ours says"
        " nothing in the first 5 mm.",
        f"- A touch is felt if contact is said from {1e3 * EARLY_S:.0f} ms before it to {1e3 * LATE_S:.0f} ms"
        f" after it;"
        " `too early` counts touches with a contact said before that.",
        f"- **The echo's strength is a fit.** The paper prints neither it nor the noise, and with the plant's"
        f" assumed echo"
        f" the paper's detector misses nothing either (first line of the table of strengths). So the echo was"
        f" made weaker"
        f" until the paper's own detector (alpha = 0.5 s) had the paper's own rate, {100 * PAPER_TPR:.1f} %, on"
        f" passages"
        f" used for nothing else (to 0.4 cm; in the test those that touch come nearer, and it sees more): {db} dB."
        " Ours had no part in that. Contact is reported at both strengths.\n",
        _kinds(study),
        f"\n## Pre-touch, echo {db} dB below the plant's\n",
        pretouch_table(study.matched, study.thresholds),
        f"\n`{BOTH}` is no detector of the paper's: its statistic summed over both channels. `{CLAIRVOYANT}` is"
        f" a matched"
        " filter with the plant's own echo, drift and noise level, a bound; it heard one passage in four. With"
        " DC kept"
        " the statistic is the bridge's imbalance squared.\n",
        "![Share of approaches in which the object is seen, by distance](../figures/pretouch_distance.png)\n",
        pretouch_split(study.matched, "object", by_object(SIX)),
        "",
        pretouch_split(study.matched, "side, speed", by_side_and_speed()),
        "\nOf passages without an event:\n",
        quiet_table(study.matched, paper),
        "\n## Strength of the echo\n",
        table(
            ["weaker by", "paper: TPR, %", "paper: distance, cm", "ours: TPR, %", "ours: distance, cm"], sweep
        ),
        "\n![Rate and distance against the strength of the echo](../figures/pretouch_strength.png)\n\nWhere few are"
        " seen, they are seen by chance: a false word in the approach counts as well, from wherever it"
        " comes.\n\nWith the"
        " plant's own echo, other passages:\n",
        pretouch_table(study.plain, study.plain_thresholds),
        "\nFrom 12 cm away, normal side, with the plant's own echo:\n",
        table(
            ["detector", "TPR, %", "distance, cm: median (p10 to p90)"],
            [[n, *_two(pretouch_rates(study.afar, n))] for n in (*PRETOUCH, BOTH)],
        ),
        f"\n## Contact, echo {db} dB below the plant's\n",
        contact_table(study.matched, study.thresholds),
        f"\n`{IN_MOTION.strip(', ')}`: of the approach alone, begun {SET_OUT_S:g} s after the arm has set out. Else"
        " the noise of setting out, which comes after a quiet rest, sets the threshold; in 5 s it is over before the"
        " window is full, and at 0.03 m/s so is the touch.\n",
        "![A touch: envelope, z-score, what ours says](../figures/pretouch_contact.png)\n",
        contact_split(study.matched, "object", by_object(SIX)),
        "",
        contact_split(study.matched, "side, speed", by_side_and_speed()),
        "\n## Contact with the plant's own echo\n",
        contact_table(study.plain, study.plain_thresholds),
        "",
        contact_split(study.plain, "side, speed", by_side_and_speed()),
        "\n## Soft objects, as they are\n",
        *(
            line
            for step, verdicts in study.soft.items()
            for line in (
                f"Echo {step} dB below the plant's:\n" if step else "With the plant's own echo:\n",
                pretouch_split(verdicts, "object", by_object(SOFT)),
                "",
                contact_split(verdicts, "object", by_object(SOFT)),
                "",
            )
        ),
        "## Blind spots\n",
        "Places between 1 and 5 cm before the pipe, all sides, at which a small motion changes the envelope by"
        " less than"
        " a share of what it could:\n",
        table(["channels", "places, %"], [[k, f"{100 * v:.1f}"] for k, v in study.blind.items()]),
        "\n## Carrier level\n",
        f"{len(study.by_carrier)} of the passages again at 96 kHz and 24 bits through `controller.signals.iq`,"
        f" the same"
        " noise of arm and drift, the converter's own noise drawn at its own rate. Other words than at envelope"
        " level:"
        f" {', '.join(f'{k} {v}' for k, v in disagreements(study).items())}. Our distance differs by"
        f" {1e3 * (shift or 0.0):.2f} mm (median).\n",
        "## Cost\n",
        table(["detector", "ns a sample"], [[k, f"{v:.0f}"] for k, v in study.cost_ns.items()]),
        f"\nThe study took {study.wall_s:.0f} s and {study.cpu_s:.0f} s of processor, on a machine that others"
        f" were using"
        " too.\n",
    ]
    return "\n".join(parts)


def _two(found: tuple[Rate, Rate, Mapping[str, float | None]]) -> tuple[str, str]:
    return str(found[0]), cm(found[2])


def _calibration(size: Size) -> range:
    nears, others = size.calibration
    return range(len(SIDES) * len(SPEEDS_M_S) * (nears * len(SIX) + 3 * others))


def _kinds(study: Study) -> str:
    rows = [
        [kind, what, sum(v.event.kind == kind for v in study.matched), _role(kind)]
        for kind, what in KINDS.items()
    ]
    return table(["passage", "what happens", "how many", "counts as"], rows)


def _role(kind: str) -> str:
    pretouch = "positive" if kind in POSITIVE else "negative"
    contact = "positive" if kind == "touch" else "negative"
    return f"{pretouch} of pre-touch, {contact} of contact"
