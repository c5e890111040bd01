"""Joins the shards of a run into the run folder that one run would have written."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from datetime import datetime
from pathlib import Path
from typing import Any

from config.assemble import Table
from config.profile import load_resolved
from config.resuming import differing
from config.trials import chosen
from controller.named import own_folders
from controller.parts import add_part
from controller.recording.joining import Joiner, Parts
from controller.recording.resuming import AGAIN
from controller.recording.run_folder import RunFolder, RunFolderError

SHOWN = 5
"""How many trials are named at once."""

COMMIT_TRIALS = 100
"""How many trials are taken over between two writes to the disk."""


def merged(names: Sequence[str], out: Path) -> RunFolder:
    """Write the run that shards are of.

    Args:
        names: Their run folders.
        out: Folder of all runs.

    Raises:
        RunFolderError: they are not of one run, or do not make up a whole one: why, and what to do.
        RecordingError: the run cannot be written.
    """
    shards = [Parts(RunFolder.find(name, out)) for name in names]
    manifest = _common(shards)
    kept = manifest["profile"]
    folders = own_folders(manifest)
    profile = load_resolved(kept["name"], kept["resolved"], table=Table(), folders=folders)
    asked = manifest["profile"]["asked"]
    order = [trial.id for trial in chosen(profile.trials(manifest["seed"]), asked.get("only", ()), None)]
    holders = _holders(shards, order)
    manifest["exit"] = _exit(holders, order)
    started = min(datetime.fromisoformat(shard.manifest["started_utc"]) for shard in shards)
    folder = RunFolder.create(out, manifest["profile"]["name"], started)
    manifest |= {"trials": len(order), "started_utc": started.isoformat()}
    folder.write_manifest({**manifest, "exit": {"status": "running", "code": None, "reason": ""}})
    joiner = Joiner(folder, started, shards[0].columns[2:])
    try:
        for number, trial in enumerate(order):
            manifest["loop"]["bench_s"] += joiner.add(holders[trial], trial)
            if number % COMMIT_TRIALS == 0:
                joiner.commit()
    finally:
        joiner.close()
    folder.write_manifest(manifest)
    return folder


def _common(shards: Sequence[Parts]) -> dict[str, Any]:
    """The manifest of the whole run."""
    first = shards[0].manifest
    total = {**first, "devices": {}, "plant": {}, "loss": {}, "outcomes": {}, "signals": {}}
    total["loop"] = {**first["loop"], **dict.fromkeys(("turns", "overruns", "bench_s"), 0)}
    total["profile"] = {**first["profile"], "asked": _asked(first)}
    total.pop("resumed_utc", None)
    for shard in shards:
        other = differing(_identity(first), _identity(shard.manifest))
        if other:
            raise RunFolderError(
                f"{shard.folder.path}: not of the same run as {shards[0].folder.path} ({other})"
            )
        add_part(total, shard.manifest)
    return total


def _asked(manifest: dict[str, Any]) -> dict[str, Any]:
    asked = manifest["profile"].get("asked") or {}
    return {key: value for key, value in asked.items() if key != "shard"}


def _identity(manifest: dict[str, Any]) -> dict[str, Any]:
    """What all shards of a run have in common."""
    return {
        "profile": manifest["profile"]["name"],
        "sha256": manifest["profile"]["hash"],
        "seed": manifest["seed"],
        "only": _asked(manifest).get("only", []),
        "own": {name: entry["sha256"] for name, entry in (manifest["profile"].get("own") or {}).items()},
    }


def _holders(shards: Sequence[Parts], order: Sequence[int]) -> dict[int, Parts]:
    """Which shard has which trial."""
    holders: dict[int, Parts] = {}
    for shard in shards:
        twice = [trial for trial in shard.trials if trial in holders]
        if twice:
            also = holders[twice[0]].folder.path
            raise RunFolderError(
                f"{shard.folder.path}: {_named(twice)} in {also} as well; give each shard once"
            )
        holders |= dict.fromkeys(shard.trials, shard)
    missing = [trial for trial in order if trial not in holders]
    if missing:
        broken = [shard.folder.path.name for shard in shards if shard.manifest["exit"]["status"] != "done"]
        advice = f"resume {', '.join(broken)}" if broken else "give the other shards as well"
        raise RunFolderError(f"{_named(missing)} in none of {len(shards)} shards; {advice}")
    return holders


def _exit(holders: Mapping[int, Parts], order: Sequence[int]) -> Mapping[str, Any]:
    """How the whole run ended: as the shard that ended worst, or where trials were given up, the last of these.

    Raises:
        RunFolderError: at a trial that ended its shard the whole run would have ended as well.
    """

    def weight(trial: int) -> tuple[int, bool]:
        return holders[trial].manifest["exit"]["code"] or 0, holders[trial].outcome(trial) == "aborted"

    for trial, shard in holders.items():
        ended, outcome = shard.manifest["exit"], shard.outcome(trial)
        if outcome in AGAIN and (outcome != "aborted" or ended["status"] != "failed"):
            name, again, advice = shard.folder.path.name, "", "resume it first"
            if shard.manifest.get("resumed_utc"):
                again, advice = " again", "one run would end there, too: change that trial, and run all anew"
            raise RunFolderError(f"{name}: ended at trial {trial}{again} ({ended['reason']}); {advice}")
    worst = holders[max(reversed(order), key=weight)].manifest["exit"]
    return worst if worst["code"] else {"status": "done", "code": 0, "reason": ""}


def _named(trials: Iterable[int]) -> str:
    numbers = [str(trial) for trial in trials]
    more = ["…"] if len(numbers) > SHOWN else []
    return f"trial{'s' * (len(numbers) > 1)} {', '.join([*numbers[:SHOWN], *more])}"
