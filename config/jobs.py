"""The trials of a simulated campaign on several cores or machines, in parts that come back in order.

A part is run as a campaign of its own, so that nothing in it knows that there are others. Nothing heavy is imported
here: it is the first module that a worker loads.
"""

from __future__ import annotations

import json
import multiprocessing
import os
import signal
import tempfile
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ProcessPoolExecutor, wait
from contextlib import closing, contextmanager
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import TYPE_CHECKING, Any

from config.costs import cost
from drivers.core.errors import PROGRAM, lacking

if TYPE_CHECKING:
    from config.profile import Profile
    from config.trials import Trial
    from controller.campaign import Campaign, CampaignPlan, Console
    from controller.parts import RunPart
    from controller.recording.resuming import ResumedRun

PART_S = 1.0
"""What a part is to take, s of wall time: beginning one costs 0.02 s, and at the end no worker waits long."""

PART_MOST = 256
"""Most trials of a part: what it holds passes through memory."""

WORTH_S = 10.0
"""Computing from which on workers are started unasked, s: starting them takes 2 s of each."""

AHEAD = 3
"""Parts that are handed out for each worker: none waits while the first one is put into the folder."""

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


@dataclass(frozen=True)
class Order:
    """What a worker has to know of a campaign beside the trials.

    Attributes:
        name: Of the profile.
        resolved: All its settings, as JSON.
        folders: Where modules of the user's own that it names are looked for.
        factors: Names of what all trials vary, in the order of the columns.
        seed: Of the noise.
        own: SHA-256 of the modules of the user's own, by name.
    """

    name: str
    resolved: str
    folders: tuple[Path, ...]
    factors: Sequence[str]
    seed: int
    own: tuple[tuple[str, str], ...] = ()

    @classmethod
    def of(cls, profile: Profile, trials: Sequence[Trial], factors: Sequence[str], seed: int) -> Order:
        """The trials themselves come with each part: of the profile's own one is kept, which validates."""
        from config.assemble import own_modules

        one = {"list": [dict(trials[0].factors)], "grid": {}, "repeats": 1, "order": "listed"}
        resolved = json.dumps({**profile.resolved, "trials": one})
        own = tuple((name, entry["sha256"]) for name, entry in own_modules(profile).items())
        return cls(profile.name, resolved, profile.source.folders, tuple(factors), seed, own)


class Silent:
    """A console without output, and an operator who never interrupts."""

    def poll(self) -> None:
        """Nothing."""

    def suspend(self) -> None:
        """Nothing."""

    def state(self, name: str, t_s: float) -> None:
        """Nothing."""

    def campaign_started(self, title: str, trials: int, folder: Path) -> None:
        """Nothing."""

    def trial_started(self, trial: int, factors: Mapping[str, Any]) -> None:
        """Nothing."""

    def trial_ended(self, trial: int, outcome: str, row: Mapping[str, Any]) -> None:
        """Nothing."""

    def campaign_ended(self, line: str) -> None:
        """Nothing."""


def run_part(order: Order, trials: Sequence[Trial]) -> RunPart:
    """Run some trials of a campaign here; the same rows, events and samples wherever that is.

    Raises:
        JobsError: the modules of the user's own that are here are not those of the campaign.
    """
    from config.assemble import build_rig, plan_campaign
    from controller.campaign import Campaign
    from controller.parts import RunPart
    from drivers.core.clock import monotonic_s

    begun_s = monotonic_s()
    with _at_work():
        profile = _profile(order.name, order.resolved, order.folders, order.own)
        plan = replace(plan_campaign(profile, trials, order.seed), factors=order.factors)
        with (
            tempfile.TemporaryDirectory(prefix="touchbench-part-") as folder,
            closing(build_rig(profile)) as rig,
        ):
            outcome = Campaign(plan, rig, Silent(), Path(folder)).run()
            return RunPart.of(outcome.folder, outcome.error, monotonic_s() - begun_s)


@lru_cache(maxsize=1)
def _profile(
    name: str, resolved: str, folders: tuple[Path, ...], own: tuple[tuple[str, str], ...]
) -> Profile:
    """The campaign's profile; a worker that lives longer than a campaign loads the user's own code anew."""
    from config.assemble import own_modules
    from config.profile import load_resolved
    from controller.own_modules import forget_own

    forget_own()
    profile = load_resolved(name, json.loads(resolved), folders=folders)
    here = {top: entry["sha256"] for top, entry in own_modules(profile).items()}
    if other := [top for top, digest in own if here.get(top) != digest]:
        raise JobsError(f"{', '.join(other)} is another one at a worker than here; give all the same files")
    return profile


# --- the workers ---------------------------------------------------------------------------------


class Crew:
    """Workers, and a way to get new ones where some died.

    Args:
        count: How many there are.
        begin: Starts them.
        end: Shuts them down without waiting for what they are at.
        given_up: What a part fails by where its workers died and others were tried already.
    """

    def __init__(
        self,
        count: int,
        begin: Callable[[], Executor],
        end: Callable[[Executor], None],
        given_up: tuple[type[Exception], ...] = (),
    ) -> None:
        self.count = count
        self.given_up = given_up
        self.lost: tuple[type[Exception], ...] = (BrokenExecutor, *given_up)
        self._begin = begin
        self._end = end
        self._executor: Executor | None = None

    def submit(self, order: Order, trials: Sequence[Trial]) -> Future[RunPart]:
        """Have some trials run; where a worker has died, the part is lost as if it had been with that one."""
        if self._executor is None:
            self._executor = self._begin()
        # a worker that is begun here inherits the mask: Ctrl+C at the terminal goes to it, too, also while it loads
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            return self._executor.submit(run_part, order, trials)
        except BrokenExecutor as error:
            lost: Future[RunPart] = Future()
            lost.set_exception(error)
            return lost
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)

    def close(self) -> None:
        """Shut all down; new ones are started when they are needed."""
        executor, self._executor = self._executor, None
        if executor is not None:
            self._end(executor)


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


# --- the parts -----------------------------------------------------------------------------------


def parts(
    crew: Crew, order: Order, trials: Sequence[Trial], waiting: Callable[[], None]
) -> Iterator[RunPart]:
    """Have trials run, and give their parts in the order of the trials; every trial once, even where workers die.

    The crew stays when all is done, for a next campaign; where this ends before, it is shut down at once.

    Args:
        crew: The workers.
        order: What they are of.
        trials: In the order of running.
        waiting: Called again and again meanwhile.

    Raises:
        JobsError: workers die of it, or the scheduler is gone.
    """
    left = deque(trials)
    given: deque[tuple[Future[RunPart], list[Trial]]] = deque()
    size, deaths = 1, 0
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
                part = future.result()
            except CancelledError:  # not by this program
                raise JobsError(
                    f"the scheduler is gone, and what it had been given with it; start it again, then: {PROGRAM} resume"
                ) from None
            except crew.lost as error:
                deaths += 1
                if deaths >= DEATHS or isinstance(error, crew.given_up):
                    numbers = ", ".join(str(trial.id) for trial in some)
                    raise JobsError(
                        f"workers died again and again at one of the trials {numbers} or beside them; "
                        "is there memory enough? try --jobs 1"
                    ) from None
                crew.close()
                given = deque((_again(crew, order, *each), each[1]) for each in given)
                continue
            given.popleft()
            deaths = 0
            size = max(1, min(PART_MOST, round(PART_S / max(part.took_s / len(some), 1e-6))))
            yield part
    finally:
        if left or given:
            crew.close()


def _again(crew: Crew, order: Order, future: Future[RunPart], trials: list[Trial]) -> Future[RunPart]:
    """A part that was lost with its worker is run again, one that is done stays."""
    if future.done() and not future.cancelled() and future.exception() is None:
        return future
    return crew.submit(order, trials)


def in_parts(
    crew: Crew,
    profile: Profile,
    plan: CampaignPlan,
    console: Console,
    out: Path,
    resumed: ResumedRun | None = None,
) -> Campaign:
    """A campaign that a crew runs.

    Args:
        crew: The workers.
        profile: Of the campaign.
        plan: What is run.
        console: The person's side.
        out: Folder of all runs.
        resumed: A run that goes on.
    """
    from controller.parts import CampaignInParts
    from controller.rig import Rig
    from drivers.core.clock import VirtualClock

    order = Order.of(profile, plan.left, plan.factors, plan.seed)
    rig = Rig("mock", {}, VirtualClock())
    return CampaignInParts(
        plan, rig, console, out, resumed, parts=lambda poll: parts(crew, order, plan.left, poll)
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
