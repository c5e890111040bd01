"""The trials of a simulated campaign on several cores or machines, in batches that come back in order.

A batch is run as a campaign of its own, so that nothing in it knows that there are others. Nothing heavy is imported
here: it is the first module that a worker loads.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import shutil
import signal
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from config.costs import cost
from drivers.core.errors import PROGRAM, lacking

if TYPE_CHECKING:
    from config.profile import Profile
    from config.trials import Trial
    from controller.campaign import Campaign, CampaignPlan
    from controller.console import Console
    from controller.recording.joining import ResumedRun

BATCH_S = 1.0
"""What a batch is to take, s of wall time: beginning one costs 0.02 s, and at the end no worker waits long."""

BATCH_MOST = 256
"""Most trials of a batch: from another machine it comes through memory."""

WORTH_S = 10.0
"""Computing from which on workers are started unasked, s: starting them takes 2 s of each."""

AHEAD = 3
"""Batches that are handed out for each worker: none waits while the first one is put into the folder."""

WAIT_S = 0.1
"""How often the operator is asked meanwhile, s."""

CONNECT_S = 30.0
"""How long a scheduler is waited for, s; assumption: on a machine with much to do one answers in a few seconds."""

DEATHS = 3
"""How often workers may die in a row before any trial of theirs is done: by then the trial is the cause."""


class JobsError(RuntimeError):
    """Trials cannot be run elsewhere."""


class Order(NamedTuple):
    """What a worker has to know of a campaign beside the trials.

    Attributes:
        resolved: All its settings, as JSON.
        folders: Where modules of the user's own that it names are looked for.
        factors: Names of what all trials vary, in the order of the columns.
        own: SHA-256 of the modules of the user's own, by name: of others the profile is loaded anew.
    """

    name: str
    resolved: str
    folders: tuple[Path, ...]
    factors: tuple[str, ...]
    seed: int
    devices: tuple[str, ...]
    own: tuple[tuple[str, str], ...] = ()


class Batch(NamedTuple):
    """Some trials that were run one after the other.

    It goes through a pipe in one piece, which nothing cuts off: a worker may be killed at any time.

    Attributes:
        folder: Their run folder.
        error: What the program failed by, "" where it did not.
        took_s: Wall time that they took, s.
        files: Of the folder, by name, where it is on another machine.
    """

    folder: Path
    error: str
    took_s: float
    files: Mapping[str, bytes] = {}


def order_of(profile: Profile, plan: CampaignPlan) -> Order:
    """What a worker is told of a campaign.

    The trials themselves come with each batch: of the profile's own one is kept, which validates.
    """
    one = {"list": [dict(plan.left[0].factors)], "grid": {}, "repeats": 1, "order": "listed"}
    resolved = json.dumps({**profile.resolved, "trials": one})
    own = tuple((name, entry["sha256"]) for name, entry in plan.manifest["profile"]["own"].items())
    folders, devices = tuple(profile.source.folders), tuple(sorted(plan.devices))
    return Order(profile.name, resolved, folders, tuple(plan.factors), plan.seed, devices, own)


def run_batch(order: Order, trials: Sequence[Trial], scratch: Path) -> Batch:
    """Run some trials of a campaign here; the same rows, events and samples wherever that is.

    Args:
        scratch: Folder for their run folder.

    Raises:
        RecordingError: it cannot be written.
    """
    from config.assemble import build_rig, plan_campaign
    from controller.campaign import Campaign
    from controller.console import Console
    from drivers.core.clock import monotonic_s

    begun_s = monotonic_s()
    profile = _profile(order)
    plan = plan_campaign(profile, trials, order.seed, devices=order.devices)
    plan = replace(plan, factors=order.factors)
    with closing(build_rig(profile, devices=order.devices)) as rig:
        outcome = Campaign(plan, rig, Console(), scratch).run()
    if outcome.unwritten is not None:
        raise outcome.unwritten
    failure = f"{type(outcome.error).__name__}: {outcome.error}" if outcome.error else ""
    return Batch(outcome.folder, failure, monotonic_s() - begun_s)


def run_batch_afar(order: Order, trials: Sequence[Trial]) -> Batch:
    """The same on another machine: its files come with it."""
    with tempfile.TemporaryDirectory(prefix="touchbench-batch-") as scratch:
        batch = run_batch(order, trials, Path(scratch))
        return batch._replace(files={path.name: path.read_bytes() for path in batch.folder.iterdir()})


@lru_cache(maxsize=1)
def _profile(order: Order) -> Profile:
    """The campaign's profile; a worker that lives longer than a campaign loads the user's own code anew."""
    from config.profile import load_resolved
    from controller.own_modules import forget_own

    forget_own()
    return load_resolved(order.name, json.loads(order.resolved), folders=order.folders)


# --- the workers ---------------------------------------------------------------------------------


@dataclass
class Crew:
    """Workers, and a way to get new ones where some died."""

    count: int
    """How many there are."""

    begin: Callable[[], Executor]
    """Starts them."""

    end: Callable[[Executor], None]
    """Shuts them down without waiting for what they are at."""

    given_up: tuple[type[Exception], ...] = ()
    """What a batch fails by where its workers died and others were tried already."""

    afar: bool = False
    """Whether they are on other machines."""

    _executor: Executor | None = None

    def submit(self, order: Order, trials: Sequence[Trial], scratch: Path) -> Future[Batch]:
        """Have some trials run; where a worker has died, the batch is lost as if it had been with that one."""
        if self._executor is None:
            self._executor = self.begin()
        # a worker that is begun here inherits the mask: Ctrl+C at the terminal goes to it, too, also while it loads
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            if self.afar:
                return self._executor.submit(run_batch_afar, order, trials)
            return self._executor.submit(run_batch, order, trials, scratch)
        except BrokenExecutor as error:
            lost: Future[Batch] = Future()
            lost.set_exception(error)
            return lost
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def close(self) -> None:
        """Shut all down; new ones are started when they are needed."""
        executor, self._executor = self._executor, None
        if executor is not None:
            self.end(executor)


def cores(asked: int | None = None) -> Crew:
    """Processes on this machine, as many as it has cores unless asked; each ends with this one, whatever ends it."""
    count = asked or len(os.sched_getaffinity(0))
    others = set(multiprocessing.active_children())

    def begin() -> Executor:
        spawn = multiprocessing.get_context("spawn")  # this process has threads, and is not to be copied
        return ProcessPoolExecutor(count, spawn, initializer=_in_a_worker)

    def end(executor: Executor) -> None:
        executor.shutdown(wait=False, cancel_futures=True)
        for child in set(multiprocessing.active_children()) - others:
            child.kill()
            child.join()

    return Crew(count, begin, end)


def _in_a_worker() -> None:
    import ctypes

    pr_set_pdeathsig = 1  # prctl(2)
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    for library in ("OPENBLAS", "OMP", "MKL"):  # a worker is a core
        os.environ[f"{library}_NUM_THREADS"] = "1"


def cluster(address: str) -> Crew:
    """The workers of a Dask scheduler.

    Raises:
        JobsError: Dask is not installed, no scheduler answers there, or it has no workers.
    """
    try:
        from distributed import Client, KilledWorker
    except ImportError:
        raise JobsError(f"--scheduler: {'; '.join(lacking('Dask', 'cluster'))}") from None
    try:
        client = Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        raise JobsError(
            f"--scheduler {address}: {error or f'no answer in {CONNECT_S:g} s'}; is it running?"
        ) from None
    count = sum(client.nthreads().values())
    if not count:
        client.close()
        raise JobsError(f"--scheduler {address}: it has no workers; start some with `dask worker {address}`")

    def end(executor: Executor) -> None:
        executor.shutdown(wait=False)
        client.close()

    return Crew(count, client.get_executor, end, (KilledWorker,), afar=True)


def crew_of(jobs: int | None, scheduler: str | None) -> Crew:
    """The workers that are asked for."""
    return cluster(scheduler) if scheduler else cores(jobs)


# --- the batches ---------------------------------------------------------------------------------


def batches(
    crew: Crew, order: Order, trials: Sequence[Trial], scratch: Path, waiting: Callable[[], None]
) -> Generator[Batch]:
    """Have trials run, and give their batches in the order of the trials; every trial once, even where workers die.

    The crew stays when all is done, for a next campaign; where this ends before, it is shut down at once.

    Args:
        trials: In the order of running.
        scratch: Folder for the batches' own.
        waiting: Called again and again meanwhile.

    Raises:
        JobsError: workers die of it, or the scheduler is gone.
    """
    left = deque(trials)
    given: deque[tuple[Future[Batch], list[Trial]]] = deque()
    size, deaths = 1, 0
    died: tuple[type[Exception], ...] = (BrokenExecutor, *crew.given_up)
    try:
        while left or given:
            while left and len(given) < crew.count * AHEAD:
                even = -(-len(left) // crew.count)  # at the end everyone gets a share
                some = [left.popleft() for _ in range(min(size, even))]
                given.append((crew.submit(order, some, scratch), some))
            future, some = given[0]
            waiting()
            wait([future], WAIT_S)
            if not future.done():
                continue
            try:
                batch = future.result()
            except CancelledError:  # not by this program
                raise JobsError(
                    f"the scheduler is gone, and what it had been given with it; start it again, then: {PROGRAM} resume"
                ) from None
            except died as error:
                deaths += 1
                if deaths >= DEATHS or isinstance(error, crew.given_up):
                    numbers = ", ".join(str(trial.id) for trial in some)
                    raise JobsError(
                        f"workers died again and again at one of the trials {numbers} or beside them; "
                        "is there memory enough? try --jobs 1"
                    ) from None
                crew.close()
                given = deque(
                    (done if _well(done) else crew.submit(order, these, scratch), these)
                    for done, these in given
                )
                continue
            given.popleft()
            deaths = 0
            size = max(1, min(BATCH_MOST, round(BATCH_S / max(batch.took_s / len(some), 1e-6))))
            yield batch
    finally:
        if left or given:
            crew.close()


def _well(future: Future[Batch]) -> bool:
    """Whether a batch is done; one that was lost with its worker is run again."""
    return future.done() and not future.cancelled() and future.exception() is None


def in_batches(
    crew: Crew,
    profile: Profile,
    plan: CampaignPlan,
    console: Console,
    out: Path,
    resumed: ResumedRun | None = None,
) -> Campaign:
    """A campaign that a crew runs; its arguments are those of `Campaign`, besides."""
    from config.joined import JoinedCampaign, Part
    from controller.recording.joining import EndedRun
    from controller.recording.run_folder import RunFolder
    from controller.rig import Rig
    from drivers.core.clock import VirtualClock

    order = order_of(profile, plan)

    def parts(waiting: Callable[[], None]) -> Generator[Part]:
        with (
            tempfile.TemporaryDirectory(prefix="touchbench-batches-") as scratch,
            closing(batches(crew, order, plan.left, Path(scratch), waiting)) as ended,
        ):
            for batch in ended:
                folder = Path(tempfile.mkdtemp(dir=scratch)) if batch.files else batch.folder
                for name, data in batch.files.items():
                    (folder / name).write_bytes(data)
                run = EndedRun(RunFolder(folder))
                end = run.manifest["exit"]
                yield Part(run.trials.values(), [run.manifest], end)
                if batch.error:
                    raise RuntimeError(batch.error)
                # nothing more is run after an error; a trial that was given up is none
                if end["status"] not in ("done", "failed") or len(run.trials) < run.manifest["trials"]:
                    return
                shutil.rmtree(folder)

    rig = Rig("mock", {}, VirtualClock())
    return JoinedCampaign(plan, rig, console, out, resumed, parts=parts)


def jobs_for(profile: Profile, trials: int, asked: int | None) -> int:
    """In how many processes so many trials are run.

    Raises:
        JobsError: it is no simulation, and several were asked for.
    """
    if profile.bench != "mock":
        if asked is not None and asked > 1:
            raise JobsError(
                f"{profile.name}: there is one {profile.bench} bench; leave --jobs and --scheduler out"
            )
        return 1
    if asked is None:
        expected = cost(profile.name, profile.experiment, trials)
        worth = expected is not None and expected.computing_s > WORTH_S
        asked = len(os.sched_getaffinity(0)) if worth else 1
    return max(1, min(asked, trials))
