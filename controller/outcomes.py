"""What the outcome of a trial means: which words are success."""

from collections.abc import Collection, Mapping
from typing import Any

UNMEASURED = ("guard", "fault", "aborted")
"""What every experiment can end in: the trial was broken off. Never success; such a trial is run again."""

MISSED = frozenset({"no_contact", "false_contact", "not_found", "touched", "not_gripped", "dropped"})
"""What the fragments conclude where a trial came to its end without success: no success where nothing is declared."""

REMEDIES = {
    "wrong_sign": "the force sensor reads a push as negative: give its scale, or normal, the other sign"
}
"""What a run says that failed, of outcomes that one setting causes."""


def is_success(outcome: object, successes: Collection[str] | None) -> bool:
    """Whether a trial succeeded.

    Args:
        successes: Words of success; None of an experiment that declares none: all but `MISSED`.
    """
    if outcome in UNMEASURED:
        return False
    return outcome not in MISSED if successes is None else outcome in successes


def counted(outcomes: Mapping[str, int], successes: Collection[str] | None) -> str:
    """How often each outcome was, and where not all succeeded how many did: `dropped: 1, held: 5; 5 of 6 succeeded`."""
    counts = ", ".join(f"{name.replace('_', ' ')}: {number}" for name, number in sorted(outcomes.items()))
    total = sum(outcomes.values())
    good = sum(number for name, number in outcomes.items() if is_success(name, successes))
    return counts if good == total else f"{counts}; {good} of {total} succeeded"


def exit_of(manifest: Mapping[str, Any]) -> tuple[int, str]:
    """Exit code and reason of a run whose trials were measured: it failed where not one succeeded."""
    if not manifest["outcomes"]:
        return 0, ""
    good = any(is_success(name, manifest["successes"]) for name in manifest["outcomes"])
    told = [f"; {remedy}" for name, remedy in REMEDIES.items() if name in manifest["outcomes"]]
    return (0, "") if good else (1, "".join(["no trial succeeded", *told]))
