"""Whether a run can go on: the same settings, the same program."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from config.assemble import own_modules
from config.profile import Profile, load_profile, load_resolved
from config.source import ProfileError, flatten
from config.trials import Trial, chosen, read_csv
from controller.campaign import program
from controller.own_modules import own_folders
from controller.recording.run_folder import RunFolderError

SHOWN = 5
"""How many differences are named at once."""


def profile_of(manifest: Mapping[str, Any], name: str) -> tuple[Profile, list[Trial]]:
    """The profile of a run, and all its trials in the order in which they are run.

    Args:
        name: Of the run, for errors.

    Raises:
        RunFolderError: profile or program are not those that the run began with: what differs, and what to do.
    """
    kept = manifest["profile"]
    began = {"versions": manifest["versions"], "commit": manifest["commit"]}
    _check_program(name, began, program(began["versions"]))
    asked = kept.get("asked") or {}
    try:
        rows, labels = read_csv(asked["trials"]) if asked.get("trials") else (None, None)
        present = load_profile(asked.get("profile", kept["name"]), asked.get("set"), rows=rows, labels=labels)
        folders = own_folders(manifest)
        loaded = load_resolved(kept["name"], kept["resolved"], folders=folders)
    except ProfileError as error:
        raise RunFolderError(f"{name}: its profile can no longer be loaded: {error.problems[0]}") from None
    _check_program(name, {"own": kept.get("own", {})}, {"own": own_modules(present)})
    other = differing(kept["resolved"], present.resolved)
    if other:
        raise RunFolderError(
            f"{name}: its profile was changed since ({other}); change it back, or run it anew"
        )
    trials = loaded.trials(int(manifest["seed"]))
    return loaded, chosen(trials, asked.get("only", ()), asked.get("shard"))


def _check_program(name: str, began: Mapping[str, Any], present: Mapping[str, Any]) -> None:
    other = differing(began, present)
    if other:
        raise RunFolderError(f"{name}: was run by another program ({other}); go back to that, or run it anew")


def differing(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Settings that are not the same, "key: before → after" each; "" where all are."""
    old, new = dict(flatten(before)), dict(flatten(after))
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    changes = [f"{key}: {old.get(key, 'absent')} → {new.get(key, 'absent')}" for key in keys[:SHOWN]]
    return ", ".join([*changes, *(["…"] if len(keys) > SHOWN else [])])
