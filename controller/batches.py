"""A campaign whose trials are run elsewhere: batches of them are put into one run folder as they come, in order."""

import tempfile
from collections.abc import Callable, Iterator, Mapping
from datetime import datetime
from pathlib import Path
from threading import Event
from typing import Any, NamedTuple

from controller.campaign import EXIT_DONE, Campaign, foremost
from controller.console import PAUSED
from controller.loop import Aborted
from controller.recording.joining import EndedRun
from controller.recording.recorder import Recorder
from controller.recording.run_folder import RunFolder, RunFolderError
from controller.recording.trial_rows import read_rows

POLL_S = 0.1
"""How often the operator is polled while a campaign is paused, seconds (assumption: Enter is not pressed faster)."""


class Batch(NamedTuple):
    """Some trials that were run one after the other.

    Attributes:
        files: Of their run folder, by name.
        error: What the program failed by, "" where it did not.
        took_s: Wall time that they took, s.
    """

    files: Mapping[str, bytes]
    error: str
    took_s: float


class CampaignInBatches(Campaign):
    """A campaign that has its trials run elsewhere.

    Args:
        *campaign: As of `Campaign`; the rig has no devices.
        batches: Gives the trials in order; calls what it is given while it waits.
    """

    def __init__(self, *campaign: Any, batches: Callable[[Callable[[], None]], Iterator[Batch]]) -> None:
        super().__init__(*campaign)
        self._batches = batches

    def _on_bench(self, folder: RunFolder, started: datetime) -> tuple[int, str, str]:
        plan = self._plan
        recorder = Recorder(folder, started, streams={}, factors=plan.factors, measures=plan.columns)
        ended = EXIT_DONE, "done", ""
        try:
            self._console.campaign_started(plan.profile, plan.count, folder.path)
            for batch in self._batches(self._poll):
                with tempfile.TemporaryDirectory() as text:
                    for name, data in batch.files.items():
                        (Path(text) / name).write_bytes(data)
                    found, whole = self._taken(recorder, RunFolder(Path(text)))
                    recorder.flush()
                if batch.error:
                    raise RuntimeError(batch.error)
                if found[1] != "done":
                    ended = found
                    if found[1] != "failed" or not whole:  # nothing more is run after an error
                        break
        finally:
            for attached in self._attached():
                recorder.attach(*attached)
            recorder.close()
        return ended

    def _taken(self, recorder: Recorder, folder: RunFolder) -> tuple[tuple[int, str, str], bool]:
        """Take over what a batch has; returns how it ended, and whether that is all of its trials."""
        manifest = folder.read_manifest()
        end = manifest["exit"]
        ended = end["code"], end["status"], end["reason"]
        try:
            trials = EndedRun(folder).trials
        except RunFolderError:
            if end["status"] == "failed":  # its own disk took no more: nothing else is to be reported
                return ended, False
            raise
        rows, _ = read_rows(folder.trials_path)
        for trial, row in zip(trials.values(), rows, strict=True):
            self._console.trial_started(trial.number, {name: row[name] for name in self._plan.factors})
            recorder.take_over(trial)
            self._manifest["loop"]["bench_s"] += trial.recorded.length_s
            measured = {name: row[name] for name in self._plan.columns}
            self._console.trial_ended(trial.number, trial.outcome, foremost(measured, self._plan.leading))
        add_manifest(self._manifest, manifest)
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


def add_manifest(manifest: dict[str, Any], more: Mapping[str, Any]) -> None:
    """Add to a campaign's manifest what some of its trials did, but for the time: that is added trial by trial.

    Raises:
        RunFolderError: they were run by another program.
    """
    for key in ("commit", "versions"):
        if manifest["devices"] and manifest[key] != more[key]:
            raise RunFolderError(
                f"some trials were run by another program ({key}: {more[key]}, the others: {manifest[key]}); "
                "install the same one everywhere"
            )
        manifest[key] = more[key]
    manifest["devices"] = more["devices"]
    loop = manifest["loop"]
    late_s = max(loop["worst_late_s"], more["loop"]["worst_late_s"])
    kept = {"bench_s": loop["bench_s"], "worst_late_s": late_s}
    manifest["loop"] = {**_sum(loop, more["loop"], True), **kept}
    for key in ("loss", "outcomes", "plant"):
        manifest[key] = _sum(manifest[key], more[key], key != "plant")
    for key in ("signals", "detectors"):
        manifest[key] = {**manifest.get(key, {}), **more.get(key, {})}


def _sum(before: Mapping[str, Any], after: Mapping[str, Any], counts: bool) -> dict[str, Any]:
    """Numbers are added where they count something: in a plant's account those in tables of their own."""
    total = {**before, **after}
    for key, value in after.items():
        if isinstance(value, Mapping):
            total[key] = _sum(before.get(key, {}), value, True)
        elif counts and isinstance(value, int | float) and not isinstance(value, bool):
            total[key] = before.get(key, 0) + value
    return total
