"""The trials of a simulated campaign on several cores or machines, in batches that come back in order.

A batch is run as a campaign of its own, so that nothing in it knows that there are others. Nothing heavy is imported
here: it is the first module that a worker loads.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import TYPE_CHECKING, NamedTuple

from config.costs import cost
from drivers.core.errors import PROGRAM, lacking

if TYPE_CHECKING:
    from config.profile import Profile
    from config.trials import Trial
    from controller.batches import Batch
    from controller.campaign import Campaign, CampaignPlan
    from controller.console import Console
    from controller.recording.joining import ResumedRun

BATCH_S = 1.0
"""What a batch is to take, s of wall time: beginning one costs 0.02 s, and at the end no worker waits long."""

BATCH_MOST = 256
"""Most trials of a batch: what it holds passes through memory."""

WORTH_S = 10.0
"""Computing from which on workers are started unasked, s: starting them takes 2 s of each."""

AHEAD = 3
"""Batches that are handed out for each worker: none waits while the first one is put into the folder."""

WAIT_S = 0.1
"""How often the operator is asked meanwhile, s."""

CONNECT_S = 30.0
"""How long a scheduler is waited for, s; assumption: on a machine with much to do one answers in a few seconds."""

END_S = 5.0
"""How long a worker is given to end, s; assumption: the system ends a process in far less."""

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
        own: SHA-256 of the modules of the user's own, by name.
    """

    name: str
    resolved: str
    folders: tuple[Path, ...]
    factors: tuple[str, ...]
    seed: int
    devices: tuple[str, ...]
    own: tuple[tuple[str, str], ...] = ()


def order_of(profile: Profile, plan: CampaignPlan) -> Order:
    """What a worker is told of a campaign.

    The trials themselves come with each batch: of the profile's own one is kept, which validates.
    """
    from config.assemble import own_modules

    one = {"list": [dict(plan.left[0].factors)], "grid": {}, "repeats": 1, "order": "listed"}
    resolved = json.dumps({**profile.resolved, "trials": one})
    own = tuple((name, entry["sha256"]) for name, entry in own_modules(profile).items())
    folders, devices = tuple(profile.source.folders), tuple(sorted(plan.devices))
    return Order(profile.name, resolved, folders, tuple(plan.factors), plan.seed, devices, own)


def run_batch(order: Order, trials: Sequence[Trial]) -> Batch:
    """Run some trials of a campaign here; the same rows, events and samples wherever that is.

    Raises:
        JobsError: the modules of the user's own that are here are not those of the campaign.
    """
    from config.assemble import build_rig, plan_campaign
    from controller.batches import Batch
    from controller.campaign import Campaign
    from controller.console import Console
    from drivers.core.clock import monotonic_s

    begun_s = monotonic_s()
    with _at_work():
        profile = _profile(order)
        plan = plan_campaign(profile, trials, order.seed, devices=order.devices)
        plan = replace(plan, factors=order.factors)
        with (
            tempfile.TemporaryDirectory(prefix="touchbench-batch-") as folder,
            closing(build_rig(profile, devices=order.devices)) as rig,
        ):
            outcome = Campaign(plan, rig, Console(), Path(folder)).run()
            files = {path.name: path.read_bytes() for path in outcome.folder.iterdir() if path.is_file()}
            failure = f"{type(outcome.error).__name__}: {outcome.error}" if outcome.error else ""
            return Batch(files, failure, monotonic_s() - begun_s)


@lru_cache(maxsize=1)
def _profile(order: Order) -> Profile:
    """The campaign's profile; a worker that lives longer than a campaign loads the user's own code anew."""
    from config.assemble import own_modules
    from config.profile import load_resolved
    from controller.own_modules import forget_own

    forget_own()
    profile = load_resolved(order.name, json.loads(order.resolved), folders=order.folders)
    here = {top: entry["sha256"] for top, entry in own_modules(profile).items()}
    if other := [top for top, digest in order.own if here.get(top) != digest]:
        raise JobsError(f"{', '.join(other)} is another one at a worker than here; give all the same files")
    return profile


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

    _executor: Executor | None = None

    def submit(self, order: Order, trials: Sequence[Trial]) -> Future[Batch]:
        """Have some trials run; where a worker has died, the batch is lost as if it had been with that one."""
        if self._executor is None:
            self._executor = self.begin()
        # a worker that is begun here inherits the mask: Ctrl+C at the terminal goes to it, too, also while it loads
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._executor.submit(run_batch, order, trials)
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
        children = set(multiprocessing.active_children()) - others
        for child in children:
            child.terminate()
        for child in children:
            child.join(END_S)
            if child.is_alive():  # it is busy, and takes no signal
                child.kill()
                child.join()

    return Crew(count, begin, end)


def _in_a_worker() -> None:
    import ctypes

    pr_set_pdeathsig = 1  # prctl(2)
    ctypes.CDLL(None).prctl(pr_set_pdeathsig, signal.SIGKILL)
    for library in ("OPENBLAS", "OMP", "MKL"):  # a worker is a core
        os.environ[f"{library}_NUM_THREADS"] = "1"
    signal.signal(signal.SIGTERM, _leave)


_WORKER = SimpleNamespace(working=False, leaving=False)
"""What this process is at, where it is a worker."""


@contextmanager
def _at_work() -> Iterator[None]:
    if _WORKER.leaving:
        os._exit(0)
    _WORKER.working = True
    try:
        yield
    finally:
        _WORKER.working = False


def _leave(number: int, frame: FrameType | None) -> None:
    """End a worker at its work at once; one that hands over a result does that to its end, and begins nothing more.

    The pool reads a result whole: cut off in the middle of one, it would wait for the rest for ever, and with it the
    program's exit.
    """
    _WORKER.leaving = True
    if _WORKER.working:
        os._exit(0)


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

    return Crew(count, client.get_executor, end, (KilledWorker,))


# --- the batches ---------------------------------------------------------------------------------


def batches(
    crew: Crew, order: Order, trials: Sequence[Trial], waiting: Callable[[], None]
) -> Iterator[Batch]:
    """Have trials run, and give their batches in the order of the trials; every trial once, even where workers die.

    The crew stays when all is done, for a next campaign; where this ends before, it is shut down at once.

    Args:
        trials: In the order of running.
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
                given.append((crew.submit(order, some), some))
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
                    (done if _well(done) else crew.submit(order, these), these) for done, these in given
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
    from controller.batches import CampaignInBatches
    from controller.rig import Rig
    from drivers.core.clock import VirtualClock

    order, rig = order_of(profile, plan), Rig("mock", {}, VirtualClock())
    return CampaignInBatches(
        plan, rig, console, out, resumed, batches=lambda poll: batches(crew, order, plan.left, poll)
    )


def jobs_for(profile: Profile, plan: CampaignPlan, asked: int | None) -> int:
    """In how many processes a campaign is run.

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
        expected = cost(profile.name, profile.experiment, plan.count)
        worth = expected is not None and expected.computing_s > WORTH_S
        asked = len(os.sched_getaffinity(0)) if worth else 1
    return max(1, min(asked, plan.count))
