"""Shards joined into the run folder that one run would have written; and whether a run can go on."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path
from typing import Any

from config.assemble import own_modules
from config.joined import SHOWN, JoinedCampaign, Part, differing, identity
from config.profile import Profile, load_profile, load_resolved
from config.source import ProfileError
from config.trials import Trial, chosen, read_csv
from controller.campaign import CampaignPlan, program
from controller.console import Console
from controller.loop import LoopSettings
from controller.outcomes import UNMEASURED
from controller.own_modules import own_folders
from controller.recording.joining import EndedRun
from controller.recording.run_folder import RunFolder, RunFolderError
from controller.rig import Rig
from drivers.core.clock import VirtualClock


@contextmanager
def _of_this_version() -> Iterator[None]:
    """A manifest that lacks something was written by a program that did not know it yet."""
    try:
        yield
    except KeyError as error:
        reason = f"a manifest has no {error}: another version of this program wrote it"
        raise RunFolderError(f"{reason}; run it anew, or go back to the commit that it names") from error


@_of_this_version()
def merged(names: Sequence[str], out: Path) -> RunFolder:
    """Write the run that the shards make up, as far as one run would have come; later trials of a shard are left out.

    Raises:
        RunFolderError: they are not of one run, or do not make up a whole one: why, and what to do.
        RecordingError: the run cannot be written.
    """
    shards = [EndedRun(RunFolder.find(name, out)) for name in names]
    first = shards[0].manifest
    holders: dict[int, EndedRun] = {}
    for shard in shards:
        if other := differing(identity(first), identity(shard.manifest)):
            raise RunFolderError(
                f"{shard.folder.path}: not of the same run as {shards[0].folder.path} ({other})"
            )
        if twice := [trial for trial in shard.trials if trial in holders]:
            also = holders[twice[0]].folder.path
            raise RunFolderError(
                f"{shard.folder.path}: {_named(twice)} in {also} as well; give each shard once"
            )
        holders |= dict.fromkeys(shard.trials, shard)
    kept, asked = first["profile"], dict(first["profile"].get("asked") or {})
    asked.pop("shard", None)
    profile = load_resolved(kept["name"], kept["resolved"], folders=own_folders(first))
    trials = chosen(profile.trials(int(first["seed"])), asked.get("only", ()))
    done, end = _as_one_run(shards, holders, [trial.id for trial in trials])
    whole = Part(
        [holders[number].trials[number] for number in done], [shard.manifest for shard in shards], end
    )
    same = {key: first[key] for key in ("experiment", "seed", "roles", "successes")}
    plan = CampaignPlan(
        manifest={"profile": {**kept, "asked": asked}, **same},
        left=trials,
        trials=(),
        factors=(),
        columns=shards[0].columns[2:],
        loop=LoopSettings(),
    )
    rig = Rig(first["bench"], {}, VirtualClock(), time=first["clock"])
    ran = {key: first[key] for key in ("versions", "commit")}
    campaign = JoinedCampaign(plan, rig, Console(), out, parts=lambda _: (each for each in [whole]), ran=ran)
    joined = campaign.run(min(datetime.fromisoformat(shard.manifest["started_utc"]) for shard in shards))
    if joined.unwritten is not None:
        raise joined.unwritten
    return RunFolder(joined.folder)


def _as_one_run(
    shards: Sequence[EndedRun], holders: Mapping[int, EndedRun], order: Sequence[int]
) -> tuple[Sequence[int], Mapping[str, Any]]:
    """The trials that one run would have done, and how it would have ended.

    It ends at the first trial that ended its shard, also when that was resumed. Else it ends as the shard that ended
    worst, or where trials were given up, the last of these.

    Raises:
        RunFolderError: a trial is missing, or one that ended its shard was not tried again.
    """
    done = order
    for number, trial in enumerate(order):
        if trial in holders and _ended(holders[trial], trial):
            shard = holders[trial]
            if not shard.manifest.get("resumed_utc"):
                name, reason = shard.folder.path.name, shard.manifest["exit"]["reason"]
                raise RunFolderError(f"{name}: ended at trial {trial} ({reason}); resume it first")
            done = order[: number + 1]
            break
    missing = [trial for trial in done if trial not in holders]
    if missing:
        broken = [shard.folder.path.name for shard in shards if shard.manifest["exit"]["status"] != "done"]
        advice = f"resume {', '.join(broken)}" if broken else "give the other shards as well"
        raise RunFolderError(f"{_named(missing)} in none of {len(shards)} shards; {advice}")

    def weight(trial: int) -> tuple[bool, int, bool]:
        shard = holders[trial]
        return (
            _ended(shard, trial),
            shard.manifest["exit"]["code"] or 0,
            shard.trials[trial].outcome == "aborted",
        )

    return done, holders[max(reversed(done), key=weight)].manifest["exit"]


def _ended(shard: EndedRun, trial: int) -> bool:
    """Whether a trial ended the run that it was in."""
    outcome = shard.trials[trial].outcome
    return outcome in UNMEASURED and (outcome != "aborted" or shard.manifest["exit"]["status"] != "failed")


def _named(trials: Iterable[int]) -> str:
    numbers = [str(trial) for trial in trials]
    more = ["…"] if len(numbers) > SHOWN else []
    return f"trial{'s' * (len(numbers) > 1)} {', '.join([*numbers[:SHOWN], *more])}"


@_of_this_version()
def profile_of(manifest: Mapping[str, Any], name: str) -> tuple[Profile, list[Trial]]:
    """The profile of a run, and all its trials in the order in which they are run.

    Raises:
        RunFolderError: profile or program are not those that the run began with: what differs, and what to do.
    """
    kept = manifest["profile"]
    began = {"versions": manifest["versions"], "commit": manifest["commit"]}
    _check_program(name, began, program(began["versions"]))
    asked = kept.get("asked") or {}
    try:
        rows = read_csv(asked["trials"]) if asked.get("trials") else None
        if asked.get("scripted"):  # the script's own trials
            rows = {f"row {number}": row for number, row in enumerate(kept["resolved"]["trials"]["list"], 1)}
        present = load_profile(asked.get("profile", kept["name"]), asked.get("set"), rows=rows)
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
