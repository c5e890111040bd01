"""A certificate of a profile's limits: the bench that is proved, and what is written of it."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from config.profile import Profile
    from controller.by_hand import HandSession
    from controller.certify import Certifier, Proof
    from controller.loop import HandOperator

PAGE = "certificate.md"
DATA = "certificate.json"


def certifier_of(
    profile: Profile, consent: Callable[[str], Callable[[], bool] | None] = lambda text: None
) -> Certifier:
    """What proves the bench of a profile, with the limits of its first trial.

    Raises:
        ProfileError: a trial that its behavior cannot run, or a value that the lab has to give.
    """
    from config.abandoned import abandoned
    from config.assemble import plan_campaign
    from config.trials import distinct
    from config.verbs.by_hand import session_on
    from controller.certify import Certifier

    listed = profile.trials(0)
    plan = plan_campaign(profile, distinct(listed), 0)
    trials = list(plan.trials)
    limits = trials[0].guard.settings
    watched = {*limits.range_streams}.union(*(trial.behavior.range_streams for trial in trials))
    own = profile.for_trial(listed[0])
    settings = {name: each.settings for name, each in profile.devices.items() if name in plan.devices}

    def session(operator: HandOperator) -> HandSession:
        return session_on(
            own,
            plan.devices,
            operator,
            doing="certify",
            limits=limits.model_copy(update={"range_streams": tuple(sorted(watched))}),
            scene=trials[0].scene,
        )

    certifier = Certifier(session, settings, consent)
    rig = certifier.session.rig
    if rig.kind != "mock":
        certifier.abandoned = partial(abandoned, profile, rig.endpoints)
    return certifier


def rows(proofs: Sequence[Proof]) -> Iterator[tuple[str, ...]]:
    """The certificate as a table, its heading first."""
    yield ("limit", "value", "done", "verdict", "what acted", "after", "way")
    for proof in proofs:
        after = "" if proof.after_s is None else f"{proof.after_s:.3f} s"
        way = "" if proof.way_m is None else f"{1e3 * proof.way_m:.2f} mm"
        yield (proof.limit, proof.value, proof.done, proof.verdict, proof.acted, after, way)


def summary(proofs: Sequence[Proof], ended: str = "") -> str:
    """One line: how many limits acted, and how many did not."""
    counts = {verdict: sum(proof.verdict == verdict for proof in proofs) for verdict in (*BAD, "acted")}
    total = sum(counts.values())
    bad = ", ".join(f"{count} {verdict}" for verdict, count in counts.items() if count and verdict in BAD)
    line = f"{counts['acted']} of {total} limits acted"
    return "; ".join(part for part in (line, bad, ended) if part)


BAD = ("failed", "not shown", "not tried")
"""Verdicts with which a bench is not certified."""


def certified(proofs: Sequence[Proof], ended: str = "") -> bool:
    """Whether every limit acted."""
    return bool(proofs) and not ended and not any(proof.verdict in BAD for proof in proofs)


def write(folder: Path, about: Mapping[str, Any], proofs: Sequence[Proof], ended: str) -> None:
    """Write the certificate into a folder, for programs and for people.

    Raises:
        RecordingError: it cannot be written.
    """
    from controller.recording.run_folder import RecordingError

    sound = certified(proofs, ended)
    document = {
        **about,
        "certified": sound,
        "summary": summary(proofs, ended),
        "limits": [proof._asdict() for proof in proofs],
    }
    heading, *body = (
        "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |" for row in rows(proofs)
    )
    page = [
        f"# Limits of {about['profile']}: {'certified' if sound else 'NOT certified'}",
        "",
        f"{summary(proofs, ended)}. {about['started_utc']}, {about['bench']} bench,"
        f" profile {about['profile_hash'][:12]}.",
        "",
        *[f"- {name}: {described}" for name, described in about["devices"].items()],
        "",
        heading,
        "| --- " * 7 + "|",
        *body,
        "",
        "Shown are the limits of the first trial, once each. Readings that a limit is held against are replaced,"
        " withheld or held between driver and loop; the mover, its driver and its device are those of the bench.",
    ]
    try:
        (folder / DATA).write_text(json.dumps(document, indent=2, default=str) + "\n", encoding="utf-8")
        (folder / PAGE).write_text("\n".join(page) + "\n", encoding="utf-8")
    except OSError as error:
        raise RecordingError(folder / DATA, "writing", error) from error
