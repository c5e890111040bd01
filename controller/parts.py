"""A campaign whose trials are run elsewhere: its parts are put into one run folder as they come, in order."""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path
from threading import Event
from typing import Any

from controller.campaign import EXIT_DONE, Campaign, foremost
from controller.console import PAUSED
from controller.loop import Aborted
from controller.recording.joining import Joiner, Parts
from controller.recording.ledger import read_ledger
from controller.recording.run_folder import RunFolder, RunFolderError

POLL_S = 0.1
"""How often the operator is polled while a campaign is paused, seconds (assumption: Enter is not pressed faster)."""


class PartError(RuntimeError):
    """The program failed where a part was run."""


@dataclass(frozen=True)
class RunPart:
    """Some trials that were run one after the other.

    Attributes:
        files: Of their run folder, by name.
        error: What the program failed by, "" where it did not.
        took_s: Wall time that they took, s.
    """

    files: Mapping[str, bytes]
    error: str
    took_s: float

    @classmethod
    def of(cls, folder: Path, error: Exception | None, took_s: float) -> RunPart:
        """What stands in a run's folder."""
        failure = "" if error is None else f"{type(error).__name__}: {error}"
        return cls(
            {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}, failure, took_s
        )


class CampaignInParts(Campaign):
    """A campaign that has its trials run elsewhere.

    Args:
        *campaign: As of `Campaign`; the rig has no devices.
        parts: Gives the trials' parts in order; calls what it is given while it waits.
    """

    def __init__(self, *campaign: Any, parts: Callable[[Callable[[], None]], Iterator[RunPart]]) -> None:
        super().__init__(*campaign)
        self._parts = parts

    def _on_bench(self, folder: RunFolder, started: datetime) -> tuple[int, str, str]:
        plan = self._plan
        joiner = Joiner(folder, started, (*plan.factors, *plan.columns))
        ended = EXIT_DONE, "done", ""
        try:
            self._console.campaign_started(plan.profile, plan.count, folder.path)
            for part in self._parts(self._poll):
                with tempfile.TemporaryDirectory() as text:
                    for name, data in part.files.items():
                        (Path(text) / name).write_bytes(data)
                    found, whole = self._taken(joiner, RunFolder(Path(text)))
                joiner.commit()
                if part.error:
                    raise PartError(part.error)
                if found[1] != "done":
                    ended = found
                    if found[1] != "failed" or not whole:  # nothing more is run after an error
                        break
        finally:
            with suppress(OSError):  # closing reports a full disk
                for attached in self._attached():
                    joiner.attach(*attached)
            joiner.close()
        return ended

    def _taken(self, joiner: Joiner, folder: RunFolder) -> tuple[tuple[int, str, str], bool]:
        """Take over what a part has; returns how it ended, and whether that is all of its trials."""
        manifest = folder.read_manifest()
        end = manifest["exit"]
        ended = end["code"], end["status"], end["reason"]
        try:
            parts = Parts(folder)
        except RunFolderError:
            if end["status"] == "failed":  # its own disk took no more: nothing else is to be reported
                return ended, False
            raise
        rows, _ = read_ledger(parts.folder.trials_path)
        for trial, row in zip(parts.trials, rows, strict=True):
            factors = {name: row[name] for name in self._plan.factors}
            self._console.trial_started(trial, factors)
            self._manifest["loop"]["bench_s"] += joiner.add(parts, trial)
            measured = {name: row[name] for name in self._plan.columns}
            self._console.trial_ended(trial, str(row["outcome"]), foremost(measured, self._plan.leading))
        add_part(self._manifest, manifest)
        return ended, len(rows) == manifest["trials"]

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


def add_part(manifest: dict[str, Any], part: Mapping[str, Any]) -> None:
    """Add to a campaign's manifest what one of its parts did, but for the time: that is added trial by trial.

    Raises:
        RunFolderError: it was run by another program.
    """
    for key in ("commit", "versions"):
        if manifest["devices"] and manifest[key] != part[key]:
            raise RunFolderError(
                f"a part was run by another program ({key}: {part[key]}, the others: {manifest[key]}); "
                "install the same one everywhere"
            )
        manifest[key] = part[key]
    manifest["devices"] = part["devices"]
    loop, more = manifest["loop"], part["loop"]
    kept = {"bench_s": loop["bench_s"], "worst_late_s": max(loop["worst_late_s"], more["worst_late_s"])}
    manifest["loop"] = {**_sum(loop, more, True), **kept}
    for key in ("loss", "outcomes", "plant"):
        manifest[key] = _sum(manifest[key], part[key], key != "plant")
    for key in ("signals", "detectors"):
        manifest[key] = {**manifest.get(key, {}), **part.get(key, {})}


def _sum(before: Mapping[str, Any], after: Mapping[str, Any], counts: bool) -> dict[str, Any]:
    """Numbers are added where they count something: in a plant's account those in tables of their own."""
    total = {**before, **after}
    for key, value in after.items():
        if isinstance(value, Mapping):
            total[key] = _sum(before.get(key, {}), value, True)
        elif counts and isinstance(value, int | float) and not isinstance(value, bool):
            total[key] = before.get(key, 0) + value
    return total
