"""A campaign whose trials are run elsewhere, by workers or as shards: taken over into one run folder, in order.

Every run is one map over the numbers of its trials. Which are left, the plan says. Each is run by a `Campaign`: in this
process, at a worker (`config.jobs`), or on another machine (`config.merging`). What others ran is taken over here.
"""

from collections.abc import Callable, Collection, Generator, Mapping, Sequence
from contextlib import closing
from datetime import datetime
from threading import Event
from typing import Any, NamedTuple

from config.source import flatten
from controller.campaign import EXIT_DONE, Campaign, foremost
from controller.console import PAUSED
from controller.loop import Aborted
from controller.recording.joining import EndedTrial
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder, RunFolderError

POLL_S = 0.1
"""How often the operator is polled while a campaign is paused, seconds (assumption: Enter is not pressed faster)."""

SHOWN = 5
"""How many trials, or differences, are named at once."""


class Part(NamedTuple):
    """Trials that were run elsewhere.

    Attributes:
        trials: In the order of the plan; their files stay until the next part is asked for.
        manifests: Of the run folders that they come from.
        exit: How these trials ended, as in a manifest.
    """

    trials: Collection[EndedTrial]
    manifests: Sequence[Mapping[str, Any]]
    exit: Mapping[str, Any]


class JoinedCampaign(Campaign):
    """A campaign that has its trials run elsewhere.

    Args:
        *campaign: As of `Campaign`; the rig has no devices.
        parts: Gives the trials in order; calls what it is given while it waits.
        ran: Commit and versions of the program that ran the trials; None is this one.
    """

    def __init__(
        self,
        *campaign: Any,
        parts: Callable[[Callable[[], None]], Generator[Part]],
        ran: Mapping[str, Any] | None = None,
    ) -> None:
        super().__init__(*campaign)
        self._parts = parts
        self._ran = ran or {}

    def _first_manifest(self, started: datetime) -> dict[str, Any]:
        return {**super()._first_manifest(started), **self._ran}

    def _on_bench(self, folder: RunFolder, started: datetime) -> tuple[int, str, str]:
        plan = self._plan
        recorder = Recorder(folder, started, streams={}, factors=plan.factors, measures=plan.columns)
        end: Mapping[str, Any] = {"code": EXIT_DONE, "status": "done", "reason": ""}
        try:
            self._console.campaign_started(plan.manifest["profile"]["name"], plan.count, folder.path)
            with closing(self._parts(self._poll)) as parts:
                for part in parts:
                    for manifest in part.manifests:
                        add_manifest(self._manifest, manifest)
                    for trial in part.trials:
                        self._take(recorder, trial)
                    recorder.flush()
                    if part.exit["code"] and part.exit["status"] != "done":
                        end = part.exit
        finally:
            for attached in self._attached():
                recorder.attach(*attached)
            recorder.close()
        return end["code"], end["status"], end["reason"]

    def _take(self, recorder: Recorder, trial: EndedTrial) -> None:
        """Take a trial over, as one that ended here."""
        cells = trial.cells
        self._console.trial_started(trial.number, {name: cells[name] for name in self._plan.factors})
        recorder.take_over(trial)
        self._count(trial.outcome)
        self._manifest["loop"]["bench_s"] += trial.recorded.length_s
        measured = {name: cells[name] for name in self._plan.columns}
        self._console.trial_ended(trial.number, trial.outcome, foremost(measured, self._plan.leading))

    def _poll(self) -> None:
        """Do what the operator wants: what is being run goes on to its end, nothing more is begun."""
        request = self._console.poll()
        paused = request in ("pause", "suspend")
        while request != "resume" and (paused or request):
            if request == "abort":
                raise Aborted
            if request == "suspend":
                self._console.suspend()
            self._console.state(PAUSED, 0.0)
            Event().wait(POLL_S)
            request = self._console.poll()


def add_manifest(manifest: dict[str, Any], more: Mapping[str, Any]) -> None:
    """Add to a campaign's manifest what some of its trials did, but for what is counted trial by trial: outcomes, time.

    Raises:
        RunFolderError: they were run by another program.
    """
    began, ran = _program_of(manifest), _program_of(more)
    ran["own"] = {name: ran["own"].get(name) for name in began["own"]}  # a trial may have loaded more
    if not manifest["devices"]:  # the first: what takes trials over loads other packages than what runs them
        own = {name: version for name, version in began["versions"].items() if name in ran["versions"]}
        began["versions"] = {**ran["versions"], **own, "platform": ran["versions"]["platform"]}
    if other := differing(began, ran):
        raise RunFolderError(
            f"some trials were run by another program ({other}); install the same one everywhere"
        )
    for key in ("commit", "versions", "devices"):
        manifest[key] = more[key]
    loop = manifest["loop"]
    late_s = max(loop["worst_late_s"], more["loop"]["worst_late_s"])
    kept = {"bench_s": loop["bench_s"], "worst_late_s": late_s}
    manifest["loop"] = {**_sum(loop, more["loop"], True), **kept}
    for key in ("loss", "plant"):
        manifest[key] = _sum(manifest[key], more[key], key != "plant")
    for key in ("signals", "detectors"):
        manifest[key] = {**manifest.get(key, {}), **more.get(key, {})}
    if did := more.get("by_hand"):
        manifest["by_hand"] = [*manifest.get("by_hand", ()), *did]


def _program_of(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """What ran: the program, and files of the user's own wherever they lie."""
    own = manifest["profile"].get("own") or {}
    digests = {name: entry["sha256"] for name, entry in own.items()}
    return {"commit": manifest["commit"], "versions": manifest["versions"], "own": digests}


def identity(manifest: Mapping[str, Any]) -> dict[str, Any]:
    """What all shards of a run have in common."""
    profile = manifest["profile"]
    asked = (profile.get("asked") or {}).get("only", [])
    named = {"profile": profile["name"], "sha256": profile["hash"], "seed": manifest["seed"], "only": asked}
    return named | _program_of(manifest)


def differing(before: Mapping[str, Any], after: Mapping[str, Any]) -> str:
    """Settings that are not the same, "key: before → after" each; "" where all are."""
    old, new = dict(flatten(before)), dict(flatten(after))
    keys = [key for key in {**old, **new} if old.get(key) != new.get(key)]
    changes = [f"{key}: {old.get(key, 'absent')} → {new.get(key, 'absent')}" for key in keys[:SHOWN]]
    return ", ".join([*changes, *(["…"] if len(keys) > SHOWN else [])])


def _sum(before: Mapping[str, Any], after: Mapping[str, Any], counts: bool) -> dict[str, Any]:
    """Numbers are added where they count something: in a plant's account those in tables of their own."""
    total = {**before, **after}
    for key, value in after.items():
        if isinstance(value, Mapping):
            total[key] = _sum(before.get(key, {}), value, True)
        elif counts and isinstance(value, int | float) and not isinstance(value, bool):
            total[key] = before.get(key, 0) + value
    return total
