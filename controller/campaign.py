"""A campaign: all trials of a profile, one after the other, measured, recorded and reported."""

from __future__ import annotations

import gc
import json
import os
import platform
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field
from datetime import datetime
from functools import cache
from importlib import metadata
from itertools import chain, islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from behaviors.machine import Behavior
from controller.console import Console
from controller.detectors.protocol import Compiled, Detector, Quantity, quantities_of
from controller.guard import Guard, GuardRefusal
from controller.live_view import LiveView
from controller.loop import Aborted, Loop, LoopSettings, UnfitStreamError
from controller.measures.trial import MissingDataError, TrialEvidence
from controller.outcomes import counted, exit_of
from controller.own_modules import KindError, as_error
from controller.recording.run_folder import RecordingError, RunFolder
from controller.recording.series import TrialRecording
from controller.rig import Rig, TrialScene, opened, streams_of
from controller.signals.protocol import Signal
from drivers.core.clock import utc_now
from drivers.core.errors import DeviceError, RefusedError
from drivers.core.messages import DeviceInfo, StreamInfo

if TYPE_CHECKING:
    from controller.recording.joining import ResumedRun
    from controller.recording.recorder import Recorder
    from controller.watching.between import Between
    from controller.watching.foxglove import FoxgloveStream

EXIT_DONE, EXIT_FAILED, EXIT_USAGE, EXIT_DEVICE, EXIT_GUARD, EXIT_INTERRUPTED = 0, 1, 2, 3, 4, 130
"""Exit codes of a run."""

_EXIT_OF_OUTCOME = {"guard": EXIT_GUARD, "fault": EXIT_DEVICE, "aborted": EXIT_FAILED}

Measure = Callable[[TrialEvidence, str], tuple[str, dict[str, Any]]]


@dataclass(frozen=True)
class TrialPlan:
    """One trial, ready to run: what `config.assemble` makes of a profile and a trial's factors.

    Attributes:
        factors: Flat, in the order of the columns.
        behavior: Fresh, in its initial state.
        detectors: Fresh, by name.
        signals: Fresh; what is computed from the devices' own streams.
        measure: From evidence and the behavior's outcome to the final outcome and the row.
    """

    trial: int
    factors: Mapping[str, Any]
    scene: TrialScene
    behavior: Behavior
    detectors: Mapping[str, Detector]
    guard: Guard
    measure: Measure
    signals: Sequence[Signal] = ()


@dataclass(frozen=True)
class CampaignPlan:
    """What is to be run.

    Attributes:
        manifest: What the manifest says of it before anything is run: profile, experiment, seed, roles, successes.
        left: The trials that are to be run, in the order of running, as the profile has them.
        trials: The same, ready to run; made one by one, when their turn has come.
        factors: Names of the factors, in the order of the columns.
        signals: What comes out of the signals, by stream.
        leading: The most informative columns, to be shown first.
        devices: Those that the trials use, also the trials that were run before; no other is opened.
    """

    manifest: Mapping[str, Any]
    left: Sequence[Any]
    trials: Iterable[TrialPlan]
    factors: Sequence[str]
    columns: Sequence[str]
    loop: LoopSettings
    signals: Mapping[str, StreamInfo] = field(default_factory=dict)
    leading: Sequence[str] = ()
    devices: Collection[str] = ()

    @property
    def seed(self) -> int:
        """Of order and noise."""
        return int(self.manifest["seed"])

    @property
    def heading(self) -> str:
        """What it measures and its profile, for people."""
        profile = self.manifest["profile"]
        return ", ".join(filter(None, (profile["resolved"].get("title"), profile["name"])))

    @property
    def count(self) -> int:
        """How many trials are to be run."""
        return len(self.left)


def foremost(row: Mapping[str, Any], leading: Sequence[str]) -> dict[str, Any]:
    """A row with its leading columns first; columns that it does not have are left out."""
    return {name: row[name] for name in leading if name in row} | dict(row)


@dataclass(frozen=True)
class Outcome:
    """How a campaign ended.

    Attributes:
        exit_code: As in the reference of the command line.
        line: One line for the person at the bench.
        error: A fault of the program itself, which ended the run; to be raised after the report.
        unwritten: Why the folder is not whole; None where it is.
        not_at_rest: Movers that were not seen standing still at its end.
    """

    exit_code: int
    folder: Path
    line: str
    error: Exception | None = None
    not_at_rest: Sequence[str] = ()
    unwritten: RecordingError | None = None


class Campaign:
    """Opens the bench, runs the trials, closes the bench, whatever happens.

    Args:
        rig: The bench, closed.
        runs: Folder under which the run's own folder is made.
        resumed: A run that goes on; None begins one.
    """

    def __init__(
        self,
        plan: CampaignPlan,
        rig: Rig,
        console: Console,
        runs: Path,
        resumed: ResumedRun | None = None,
        mirror: FoxgloveStream | None = None,
    ) -> None:
        self._mirror = mirror
        self._plan = plan
        self._resumed = resumed
        self._rig = rig
        self._console = console
        self._runs = runs
        self._not_at_rest: list[str] = []
        self._warm: set[type] = set()

    def run(self, started: datetime | None = None) -> Outcome:
        """Run every trial.

        Args:
            started: When it began; None is now.

        Whatever ends the run, the bench stands still and the recording is closed when this returns. Errors of
        devices, guard and disk come back as a line and an exit code, a fault of the program itself as `error`.

        Raises:
            RecordingError: no run folder can be made.
            RunFolderError: the run that is to be resumed goes on, or went on, in another program.
        """
        from controller.recording.joining import hold

        started = started or utc_now()
        if self._resumed is None:
            folder = RunFolder.create(self._runs, self._plan.manifest["profile"]["name"], started)
        else:
            folder = self._resumed.folder
        held = hold(folder)
        try:
            return self._run(folder, started)
        finally:
            os.close(held)

    def _run(self, folder: RunFolder, started: datetime) -> Outcome:
        self._manifest = self._first_manifest(started)
        if self._resumed is not None:
            from controller.recording.joining import clear

            clear(self._resumed)
            self._manifest = _going_on(self._resumed, started)
        folder.write_manifest(self._manifest)
        folder.keep_room()
        fault: Exception | None = None
        unwritten: RecordingError | None = None
        counts = ""
        try:
            code, status, line = self._on_bench(folder, started)
            if code == EXIT_DONE:
                code, line = exit_of(self._manifest)
            counts = counted(self._manifest["outcomes"], self._manifest["successes"])
        except (Aborted, KeyboardInterrupt):
            still = "" if self._not_at_rest else ": the bench is still"
            code, status, line = EXIT_INTERRUPTED, "aborted", f"interrupted{still}"
        except GuardRefusal as refusal:
            code, status, line = EXIT_GUARD, "guard", f"guard: {refusal}"
        except DeviceError as error:
            code, status, line = EXIT_DEVICE, "fault", str(error)
        except UnfitStreamError as error:
            code, status, line = EXIT_USAGE, "fault", str(error)
        except KindError as error:
            code, status, line = EXIT_FAILED, "failed", str(error)
        except RecordingError as error:
            code, status, line, unwritten = EXIT_FAILED, "failed", str(error), error
        except (Exception, SystemExit) as error:
            code, status, line, fault = (
                EXIT_FAILED,
                "failed",
                f"{type(error).__name__}: {error}",
                as_error(error),
            )
        if self._not_at_rest:
            line = f"{line}; NOT seen standing still: {', '.join(self._not_at_rest)}: look at the bench"
        links = (found.get("link", {}) for found in self._manifest["devices"].values())
        accounts = [*self._manifest["signals"].values(), *links]
        counts_of = Counter(account["warning"] for account in accounts if "warning" in account)
        new = {text: n for text, n in counts_of.items() if text not in line}  # of where trials were run
        warnings = [f"{text} ({n} signals)" if n > 1 else text for text, n in new.items()]
        line = "; ".join(part for part in (line, *warnings) if part)
        self._manifest["exit"] = {"status": status, "code": code, "reason": line if code else ""}
        if counts:
            line = f"{line} ({counts})" if line else counts
        with suppress(Exception):  # the recording has them all
            from controller.recording.layouts import write_layouts

            write_layouts(folder.recordings[-1])
        try:
            folder.end(self._manifest)
        except RecordingError as error:
            code, line, unwritten = code or EXIT_FAILED, f"{line}; {error}", error
        self._console.campaign_ended(line)
        return Outcome(code, folder.path, line, fault, self._not_at_rest, unwritten)

    def _on_bench(self, folder: RunFolder, started: datetime) -> tuple[int, str, str]:
        from controller.recording import recorder as recording  # what only plans a campaign writes nothing

        recorder: Recorder | None = None
        try:
            trials = self._warmed()
            # while no device is open whose own watchdog would wait for it: a program with much in memory takes seconds
            self._settle_memory()
            infos = {name: opened(name, device) for name, device in self._rig.devices.items()}
            self._rig.clock.leave()
            if self._resumed is not None:
                _check_devices(self._resumed.manifest["devices"], infos)
            self._manifest["devices"] = {name: described(info) for name, info in infos.items()}
            folder.write_manifest(self._manifest)
            recorder = recording.Recorder(
                folder,
                started,
                streams={**streams_of(infos), **self._plan.signals},
                factors=self._plan.factors,
                measures=self._plan.columns,
                patient=self._rig.clock.virtual,
                mirror=self._mirror,
                busy_s=self._rig.disk,
            )
            return self._trials(folder, recorder, infos, trials)
        finally:
            gc.unfreeze()
            try:
                self._close()
            finally:  # last: a device may have to be released in time, a disk may take long
                if recorder is not None:
                    for attached in self._attached():
                        recorder.attach(*attached)
                    recorder.close()

    def _attached(self) -> Iterator[tuple[str, bytes]]:
        """For the recording: the profile as it is resolved, and the manifest as it is before the run's end is known."""
        profile = self._manifest["profile"]["resolved"]
        for name, document in (("profile.json", profile), ("manifest.json", self._manifest)):
            yield name, json.dumps(document, default=str).encode()

    def _close(self) -> None:
        """Close every device, then the bench; each even where another one fails."""
        for name, device in self._rig.devices.items():
            if name in self._manifest["devices"]:  # while the link can still be queried
                with suppress(Exception):
                    self._manifest["devices"][name]["link"] = dict(device.account())
        for device in self._rig.devices.values():
            with suppress(Exception):
                device.close()
        with suppress(Exception):
            self._manifest["plant"] = dict(self._rig.account())
        self._rig.close()

    def _trials(
        self,
        folder: RunFolder,
        recorder: Recorder,
        infos: Mapping[str, DeviceInfo],
        trials: Iterable[TrialPlan],
    ) -> tuple[int, str, str]:
        plan = self._plan
        self._console.campaign_started(plan.heading, plan.count, folder.path)
        offset_s = 0.0
        code, status, line = EXIT_DONE, "done", ""
        for trial in trials:
            feed = self._console.feed
            if feed is not None and (stopped := self._held(feed.between, trial, infos)):
                code, status, line = stopped
                break
            self._console.trial_started(trial.trial, trial.factors)
            outcome, reason, row, length_s = self._trial(trial, recorder, infos, offset_s)
            offset_s += length_s
            self._console.trial_ended(trial.trial, outcome, foremost(row, self._plan.leading))
            if outcome in _EXIT_OF_OUTCOME:
                code = _EXIT_OF_OUTCOME[outcome]
                status = "failed" if outcome == "aborted" else outcome
                line = f"trial {trial.trial}: {reason}"
                if outcome != "aborted":  # nothing on the bench moves after an error
                    break
            if self._not_at_rest:
                code, status = EXIT_DEVICE, "fault"
                line = line or f"trial {trial.trial}"
                break
        return code, status, line

    def _held(
        self, held: Between, trial: TrialPlan, infos: Mapping[str, DeviceInfo]
    ) -> tuple[int, str, str] | None:
        """Before a trial, where it is to be held: what a person does by hand, through the trial's guard; noted in the
        manifest. What ended badly ends the campaign: its exit code, status and line."""
        held.possible = True
        if not held.hold:
            return None
        from controller.by_hand import HandSession

        session = HandSession(
            self._rig,
            trial.guard.settings,
            held,
            self._plan.loop,
            make_signals=lambda: deepcopy(trial.signals),  # the trial's own stay fresh
            scene=trial.scene,
            paced=True,
            infos=dict(infos),
        )
        for did, result in held.wait(session):
            note = {"before_trial": trial.trial, "did": did, "outcome": result.outcome}
            self._manifest.setdefault("by_hand", []).append(note)
            self._not_at_rest = list(dict.fromkeys([*self._not_at_rest, *result.not_at_rest]))
            if result.outcome == "interrupted":
                raise Aborted
            if result.outcome != "done":
                code = EXIT_GUARD if result.outcome == "guard" else EXIT_DEVICE
                return code, result.outcome, f"{did}, by hand before trial {trial.trial}: {result.reason}"
        return None

    def _trial(
        self, trial: TrialPlan, recorder: Recorder, infos: Mapping[str, DeviceInfo], offset_s: float
    ) -> tuple[str, str, dict[str, Any], float]:
        """Run one trial; its row is on the disk when this returns or raises."""
        self._warm_up(trial)
        self._settle_memory()
        self._rig.clock.restart()
        limits, quantities = trial.guard.settings, self._quantities(trial, infos)
        recording = recorder.begin_trial(trial.trial, trial.factors, offset_s, limits, quantities)
        loop = Loop(self._rig, infos, trial.guard, recorder, self._console, self._plan.loop)
        lost, now = loop.account.lost, self._rig.clock.now
        self._console.watch(
            LiveView(recording, trial.detectors, limits, trial.behavior, loop.events, lost, now)
        )
        evidence = self._evidence(trial, recording, infos)
        verdict = ""
        try:
            self._rig.begin_trial(trial.scene)
            loop.run(trial.behavior, trial.detectors, trial.signals)
        except BaseException as error:
            aborted, guarded = (Aborted, KeyboardInterrupt), isinstance(error, GuardRefusal)
            verdict = "aborted" if isinstance(error, aborted) else "guard" if guarded else "fault"
            raise
        finally:
            evidence.events, evidence.entered_s, evidence.visits = loop.events, dict(loop.visits), loop.visits
            evidence.notes = trial.behavior.notes
            for name, known in self._rig.known().items():
                setattr(evidence, name, known)
            self._account(loop, trial.signals)
            ended = verdict or loop.account.outcome
            outcome, row = ended or trial.behavior.outcome, dict[str, Any]()
            reason = loop.account.reason or trial.behavior.reason
            try:
                if not loop.account.missing:  # without its samples there is nothing to measure
                    outcome, reason, row = _measured(trial, evidence, ended, reason)
            except BaseException:
                outcome = ended or "fault"  # a trial without its row is run again
                raise
            finally:
                try:
                    recorder.end_trial(outcome, row, self._rig.clock.now())
                except RecordingError:
                    outcome = "fault"  # as its row says
                    raise
                finally:
                    self._count(outcome)
        return outcome, reason, row, self._rig.clock.now()

    def _quantities(self, trial: TrialPlan, infos: Mapping[str, DeviceInfo]) -> Mapping[str, Quantity]:
        """What the detectors' readings are; the manifest has it too."""
        streams = streams_of(infos) | {signal.info.name: signal.info for signal in trial.signals}
        found = quantities_of(trial.detectors, {name: stream.unit for name, stream in streams.items()})
        noted = self._manifest.setdefault("detectors", {})
        for name, each in found.items():
            inputs = list(trial.detectors[name].inputs)
            noted[name] = {"statistic": each.name, "unit": each.unit, "inputs": inputs}
        return found

    def _evidence(
        self, trial: TrialPlan, recording: TrialRecording, infos: Mapping[str, DeviceInfo]
    ) -> TrialEvidence:
        """What the trial will leave behind, and what is known of its streams."""
        made = {signal.info.name: signal for signal in trial.signals}
        return TrialEvidence(
            trial.factors,
            recording,
            detectors=trial.detectors,
            streams=streams_of(infos) | {name: signal.info for name, signal in made.items()},
            sources={name: signal.inputs for name, signal in made.items()},
        )

    def _warmed(self) -> Iterable[TrialPlan]:
        """The trials, warmed up for the first one: no device is open yet whose own watchdog would wait for it."""
        trials = iter(self._plan.trials)
        first = list(islice(trials, 1))
        for trial in first:
            self._warm_up(trial)
        return chain(first, trials)

    def _warm_up(self, trial: TrialPlan) -> None:
        """Let code that compiles, or loads, when it is first needed do so before the trial.

        A loop that stood still for it while something moves would be stopped by the guard; virtual time waits.
        """
        if self._rig.clock.virtual:
            return
        for thing in (*trial.signals, *trial.detectors.values()):
            kind = type(thing)
            if isinstance(thing, Compiled) and kind not in self._warm:
                thing.warm_up()
                self._warm.add(kind)

    def _settle_memory(self) -> None:
        """Collect garbage now and exempt what is left: a full collection in the middle of a trial took 0.11 s
        (measured, in a trial with sound), longer than the guard tolerates. Virtual time waits."""
        if not self._rig.clock.virtual:
            gc.collect()
            gc.freeze()

    # the manifest

    def _count(self, outcome: str) -> None:
        counts = self._manifest["outcomes"]
        counts[outcome] = counts.get(outcome, 0) + 1

    def _account(self, loop: Loop, signals: Sequence[Signal]) -> None:
        account = loop.account
        self._not_at_rest = list(dict.fromkeys([*self._not_at_rest, *account.not_at_rest]))
        total = self._manifest["loop"]
        total["turns"] += account.turns
        total["overruns"] += account.overruns
        total["worst_late_s"] = max(total["worst_late_s"], account.worst_late_s)
        total["paused_s"] += account.paused_s
        total["bench_s"] += self._rig.clock.now()
        for stream, samples in account.lost.items():
            self._manifest["loss"][stream] = self._manifest["loss"].get(stream, 0) + samples
        for signal in signals:
            watched: Mapping[str, object] = getattr(signal, "account", dict)()
            if watched:  # a short trial reports nothing, and withdraws nothing
                self._manifest["signals"][signal.name] = dict(watched)

    def _first_manifest(self, started: datetime) -> dict[str, Any]:
        return {
            "format": 1,
            **self._plan.manifest,
            "bench": self._rig.kind,
            "trials": self._plan.count,
            **program(),
            "started_utc": started.isoformat(),
            "clock": self._rig.time,
            "devices": {},
            "plant": {},
            "loop": {"turns": 0, "overruns": 0, "worst_late_s": 0.0, "paused_s": 0.0, "bench_s": 0.0},
            "loss": {},
            "outcomes": {},
            "signals": {},
            "detectors": {},
            "exit": {"status": "running", "code": None, "reason": ""},
        }


def _measured(
    trial: TrialPlan, evidence: TrialEvidence, ended: str, reason: str
) -> tuple[str, str, dict[str, Any]]:
    """Outcome, reason and row of a trial.

    What the guard, a failure or an error `ended` is no success, whatever behavior and measure make of it, and a measure
    that does not expect a trial to end there hides nothing.
    """
    outcome = ended or trial.behavior.outcome
    try:
        measured, row = trial.measure(evidence, outcome)
    except MissingDataError as error:
        # Another cause of the trial's end stands; there is no row with numbers either way.
        return (outcome, reason, {}) if outcome in _EXIT_OF_OUTCOME else ("fault", str(error), {})
    except Exception as error:
        if not ended:
            raise
        return outcome, f"{reason}; not measured: {type(error).__name__}: {error}", {}
    return ended or measured, reason, row


def _going_on(resumed: ResumedRun, started: datetime) -> dict[str, Any]:
    """The manifest of a run that goes on: of what was done its outcomes, and when it was resumed."""
    since = [*resumed.manifest.get("resumed_utc", ()), started.isoformat()]
    running = {"status": "running", "code": None, "reason": ""}
    outcomes = dict(Counter(resumed.done.values()))
    return {**resumed.manifest, "outcomes": outcomes, "resumed_utc": since, "exit": running}


def _check_devices(before: Mapping[str, Any], infos: Mapping[str, DeviceInfo]) -> None:
    """See that a run goes on with the devices that it began with, before anything moves.

    Raises:
        RefusedError: another device; one that the run never opened is not compared.
    """
    for name, info in infos.items():
        for key in ("model", "serial", "version") if name in before else ():
            old, new = before[name].get(key), getattr(info, key)
            if old != new:
                reason = f"its {key} was {old} and is {new}"
                raise RefusedError(name, "resuming", reason, "connect the one before, or run it anew")


def described(info: DeviceInfo) -> dict[str, Any]:
    """What a device said of itself, for a manifest."""
    return {
        "model": info.model,
        "serial": info.serial,
        "version": info.version,
        "clock": info.clock,
        "streams": sorted(info.streams),
        **dict(info.details),
    }


PACKAGES = {
    "numpy": "numpy",
    "numba": "drivers.core.compiled",
    "pyserial": "serial",
    "mcap": "controller.campaign",
}
"""Packages whose versions a manifest lists, with the module that shows whether one is used; two load later."""


def program(packages: Collection[str] | None = None) -> dict[str, Any]:
    """What runs: the program's own commit, and versions.

    Args:
        packages: Whose; None is those that are loaded.
    """
    if packages is None:
        packages = [package for package, module in PACKAGES.items() if module in sys.modules]
    versions = {"python": platform.python_version(), "platform": platform.platform()}
    versions |= {package: _version(package) for package in PACKAGES if package in packages}
    return {"versions": versions, "commit": _commit()}


@cache
def _version(package: str) -> str:
    """Of an installed package; what is loaded stays so."""
    return metadata.version(package)


@cache
def _commit() -> str:
    """The program's own commit, with "+" where files were changed since; "" where that is not known.

    Queried once: a commit made during the run is not what runs.
    """
    here = Path(__file__).resolve().parent.parent
    try:
        described = subprocess.run(
            ["git", "-C", str(here), "describe", "--always", "--dirty=+", "--abbrev=12"],
            capture_output=True,
            text=True,
            timeout=5.0,
            check=False,
        )
    except (OSError, subprocess.SubprocessError):
        return ""
    return described.stdout.strip()
