"""What the outcome of a trial means: which words are success, and what older runs called the same."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import Any

from controller.registry import EXPERIMENTS

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


def successes_in(manifest: Mapping[str, Any]) -> Sequence[str] | None:
    """A run's words of success: as its manifest has them, of an older run as its experiment declares them today."""
    if "successes" in manifest:
        successes: Sequence[str] | None = manifest["successes"]
        return successes
    experiment = EXPERIMENTS.get(str(manifest.get("experiment")))
    return experiment.successes if experiment else None


def counted(outcomes: Mapping[str, int], successes: Collection[str] | None) -> str:
    """How often each outcome was, and where not all succeeded how many did: `dropped: 1, held: 5; 5 of 6 succeeded`."""
    counts = ", ".join(f"{name.replace('_', ' ')}: {number}" for name, number in sorted(outcomes.items()))
    total = sum(outcomes.values())
    good = sum(number for name, number in outcomes.items() if is_success(name, successes))
    return counts if good == total else f"{counts}; {good} of {total} succeeded"


def exit_of(manifest: Mapping[str, Any]) -> tuple[int, str]:
    """Exit code and reason of a run whose trials were measured: it failed where not one succeeded. An older run, whose
    outcomes are in other words, is not judged."""
    if "successes" not in manifest or not manifest["outcomes"]:
        return 0, ""
    good = any(is_success(name, manifest["successes"]) for name in manifest["outcomes"])
    told = [f"; {remedy}" for name, remedy in REMEDIES.items() if name in manifest["outcomes"]]
    return (0, "") if good else (1, "".join(["no trial succeeded", *told]))


def word_of(manifest: Mapping[str, Any], row: Mapping[str, Any]) -> str:
    """The outcome in a row of trials.csv, in today's words: there was a time when every trial that came to its end was
    `contact` or `no_contact`."""
    said = str(row["outcome"])
    of_old = _OF_OLD.get(str(manifest.get("experiment")))
    return said if of_old is None or said not in ("contact", "no_contact") else of_old(said, row, manifest)


def _searched(said: str, row: Mapping[str, Any], found: str) -> str:
    """A search that came to the middle has a duration; one that closed the jaws there says what they got."""
    if row.get("search_s") is None:
        return "touched" if said == "contact" else "not_found"
    return found if said == "contact" or row.get("gripped") is None else "not_gripped"


def _approached(said: str, row: Mapping[str, Any], manifest: Mapping[str, Any]) -> str:
    """Without an object, or where it is not to be touched, an approach without contact is what was wanted."""
    settings: Any = manifest
    for name in ("profile", "resolved", "behavior"):
        settings = settings.get(name) if isinstance(settings, Mapping) else None
    touches = isinstance(settings, Mapping) and bool(settings.get("touch"))
    wanted = touches and row.get("object", "pipe") != "none"
    return said if wanted or said == "contact" else "approached"


_OF_OLD: Mapping[str, Callable[[str, Mapping[str, Any], Mapping[str, Any]], str]] = {
    "aura": _approached,
    "centering": lambda said, row, manifest: _searched(said, row, "centered"),
    "chirp": lambda said, row, manifest: "swept",
    # it was not known whether the object had left the table: `felt` is no success
    "grasp": lambda said, row, manifest: _searched(said, row, "felt"),
    "static": lambda said, row, manifest: "recorded",
    "tradeoff": lambda said, row, manifest: "recorded" if said == "contact" else said,
    "weights": lambda said, row, manifest: "calibrated",
}
"""What `contact` and `no_contact` of older runs are called now, by experiment."""
