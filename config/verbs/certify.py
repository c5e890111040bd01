"""The verb `certify`: the bench whose limits are proved, and the certificate that is written of it."""

from __future__ import annotations

import json
import select
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import click

from config import verbs
from config.abandoned import abandoned
from config.assemble import plan_campaign
from config.parts import parts_of
from config.profile import Profile
from config.trials import distinct
from config.verbs.by_hand import session_on
from controller.by_hand import HandSession
from controller.campaign import described, program
from controller.certify import Certifier, Proof
from controller.console import EndingOperator
from controller.loop import HandOperator
from controller.recording.run_folder import RecordingError, RunFolder
from drivers.core.clock import utc_now

PAGE = "certificate.md"
DATA = "certificate.json"


@click.command(cls=verbs.Verb)
@click.argument("profile")
@verbs.set_option
@verbs.out_option
def certify(profile: str, overrides: Mapping[str, str], out: Path) -> int:
    """Drive each limit of a PROFILE past once, slowly, stop first, and write a certificate of what acted.

    On hardware each motion waits for Enter, and none is faster than 1 mm/s but the way home, which has the device's own
    speed. Stand clear, with the emergency stop in reach and 5 mm free before each mover.

    \b
    Example:
      run.py certify mock/transient
      run.py certify hardware/first_contact

    Exit codes: 0 every limit acted, 1 one did not or was not shown, 2 usage or profile, 3 device, 130 interrupted.
    """
    import termios

    if parts := parts_of(profile):
        return verbs.for_each_part(certify, parts, [*verbs.sets(overrides), "--out", str(out)])
    loaded, started = verbs.loaded_profile(profile, overrides), utc_now()
    hardware = loaded.bench == "hardware"

    def consent(text: str) -> Callable[[], bool] | None:
        if not hardware:
            return None
        question = f"{text}: press Enter, or n and Enter or Ctrl+C to end"

        def agreed() -> bool:
            if not select.select([sys.stdin], [], [], 0.0)[0]:
                return False
            line = sys.stdin.readline()
            if not line:
                raise click.UsageError(
                    "each motion waits for Enter, and the input has ended; run it in a terminal, or pipe an empty line"
                    " for each"
                )
            if line.strip().lower() in ("n", "no"):
                raise KeyboardInterrupt
            if line.strip():
                click.echo(question)
            return not line.strip()

        if sys.stdin.isatty():
            termios.tcflush(sys.stdin, termios.TCIFLUSH)  # what was typed before is no answer
        click.echo(question)
        return agreed

    proofs: list[Proof] = []
    ended = ""
    failure: BaseException | None = None
    with EndingOperator() as operator:
        certifier = certifier_of(loaded, consent, lambda: operator.stopped)
        folder = RunFolder.create(out, f"certify-{loaded.name}", started)
        try:
            for proof in certifier.proofs():
                proofs.append(proof)
                _, row = rows([proof])
                verbs.say(
                    "  ".join(cell for cell in (f"{row[3]:>9}", f"{row[0]:32}", *row[1:3], *row[4:]) if cell)
                )
        except (click.UsageError, KeyboardInterrupt) as error:
            ended, failure = str(error) or "interrupted", error
        except Exception as error:
            ended, failure = verbs.explained(error)[1], error
        about = {
            "profile": loaded.name,
            "profile_hash": loaded.hash,
            "bench": loaded.bench,
            "started_utc": started.isoformat(),
            "devices": {name: described(info) for name, info in certifier.session.infos.items()},
            **program(),
        }
        write(folder.path, about, proofs, ended)
    verbs.say(f"{summary(proofs, ended)}\ncertificate: {folder.path / 'certificate.md'}")
    if failure is not None:
        raise failure
    return verbs.DONE if certified(proofs) else verbs.FAILED


def certifier_of(
    profile: Profile,
    consent: Callable[[str], Callable[[], bool] | None] = lambda text: None,
    stopped: Callable[[], bool] = lambda: False,
) -> Certifier:
    """What proves the bench of a profile, with the limits of its first trial; see `Certifier`.

    Raises:
        ProfileError: a trial that its behavior cannot run, or a value that the lab has to give.
    """
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

    certifier = Certifier(session, settings, consent, stopped=stopped)
    if certifier.session.rig.kind != "mock":
        certifier.abandoned = partial(abandoned, profile, certifier.session, stopped)
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
