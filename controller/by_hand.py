"""A bench by hand: what a person asks for goes through the loop and the guard of a trial; nothing is recorded."""

from __future__ import annotations

import gc
import math
from collections import deque
from collections.abc import Callable, Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any

import numpy as np

from behaviors.events import Event, GuardStopped, Resumed, Tick
from behaviors.machine import Behavior, StatePlan, on
from controller.detectors.protocol import Compiled
from controller.guard import Guard, GuardRefusal, GuardSettings
from controller.holding import Holding
from controller.loop import Aborted, HandOperator, Loop, LoopSettings, UnfitStreamError
from controller.rig import Rig, TrialScene, streams_of
from controller.signals.protocol import Signal, Signals
from drivers.core.clock import monotonic_s, rest
from drivers.core.errors import DeviceError
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Failed,
    Floats,
    Home,
    Listen,
    Lost,
    Reached,
    SampleBlock,
    Status,
    StreamInfo,
    Tare,
)

Steer = Callable[[Event], Sequence[Command] | None]
"""What is commanded upon an event, a `Tick` in every turn among them; None ends."""

Script = Generator[Sequence[Command], Event, None]
"""Steers likewise, step after step: what it yields is commanded, and it is sent the next event."""

WINDOW_S = 1.0
"""How much of each stream is kept: what its noise and rate are told from."""

LISTEN_S = 0.01
"""How often what has come is taken where nothing moves."""

LEVEL_S = 0.5
"""How long a stream's level is measured before and after a tare. Assumption: hundreds of samples of a force sensor."""


HOME_S = 120.0
"""Longest way home. Assumption: twice a stage of 0.5 m at a slow 10 mm/s, and an arm that is unlocked before."""

FORCES = ("N", "N m")
"""Units of streams that a `Tare` is offered for."""


class ByHand(Behavior):
    """Commands what its steering function makes of each event; a failure, or a refusal, ends it as it ends a trial.

    Args:
        steer: Is asked at every event, and in every turn.
        mover: Is stopped where something fails; "" where nothing moves.
        streams: What is read meanwhile, beside what the guard watches.
    """

    def __init__(
        self, steer: Steer, mover: str, streams: frozenset[str], deadline_s: float = math.inf
    ) -> None:
        self._steer = steer
        super().__init__({"BY_HAND": StatePlan(deadline_s, measures=streams)}, mover)

    @property
    def due_s(self) -> float:
        """In every turn."""
        return -math.inf

    def handle(self, event: Event) -> Sequence[Command]:
        """The commands that follow from an event; those after the guard's stop lead the mover out."""
        if isinstance(event, GuardStopped) and (way_out := self._steer(event)):
            return way_out
        commands = super().handle(event)
        if self.done:
            return commands
        asked = self._steer(event)
        if asked is None:
            self.conclude("done")
            self._fire("finished")
        return [*commands, *(asked or ())]

    table = (on("finished", "BY_HAND", "DONE"),)


class Latest:
    """The last second of every stream, or more where that is asked for: the loop's witness of what is not recorded."""

    failure = None

    def __init__(self, kept_s: float = WINDOW_S) -> None:
        self._kept_s = kept_s
        self._blocks: dict[str, deque[SampleBlock]] = {}

    def record(self, blocks: Sequence[SampleBlock]) -> None:
        """Keep the blocks of a turn."""
        for block in blocks:
            if len(block):
                kept = self._blocks.setdefault(block.stream, deque())
                kept.append(block)
                while kept[-1].last_s - kept[0].last_s > self._kept_s:
                    kept.popleft()

    @property
    def blocks(self) -> Sequence[SampleBlock]:
        """All that is kept, in the order of time."""
        return sorted(chain.from_iterable(self._blocks.values()), key=lambda block: block.last_s)

    def values(self, stream: str) -> Floats:
        """What has come of it, in its unit, shape (n, channels); (0, 0) where nothing has."""
        blocks = self._blocks.get(stream)
        return np.concatenate([block.physical for block in blocks]) if blocks else np.empty((0, 0))

    def times(self, stream: str) -> Floats:
        """The bench time of each of them, shape (n,)."""
        blocks = self._blocks.get(stream)
        return np.concatenate([block.times for block in blocks]) if blocks else np.empty(0)

    def _nothing(self, *_: object, **__: object) -> None:
        """Nothing else is kept."""

    readings = skip = event = _nothing


@dataclass(frozen=True)
class HandResult:
    """How it ended.

    Attributes:
        outcome: "done", "guard", "fault" or "interrupted".
        not_at_rest: Movers that were not seen standing still at the end.
    """

    outcome: str
    reason: str
    events: Sequence[Event] = ()
    not_at_rest: Sequence[str] = ()


@dataclass
class HandSession:
    """Some devices of a bench, open, and what a person has done with them. Use as a context manager.

    Args:
        rig: Has the devices that are needed, and no others.
        limits: Of the guard, which every command goes through.
        make_signals: Makes the profile's signals, fresh.
        kept_s: How much of each stream is kept.
        paced: Whether virtual time passes as the wall clock does, for a person who looks on.
        holding: The note by which `stop` finds this program.
        absent: Takes why devices did not open, for what goes on with the others; None goes on without none.

    Attributes:
        infos: What `open` found, by device.
        latest: What came last, of every stream that is read.
    """

    rig: Rig
    limits: GuardSettings
    operator: HandOperator
    loop: LoopSettings = field(default_factory=LoopSettings)
    make_signals: Callable[[], Sequence[Signal]] = tuple
    scene: TrialScene = field(default_factory=lambda: TrialScene(0, 0, {}))
    paced: bool = False
    absent: dict[str, DeviceError] | None = None
    holding: Holding | None = None
    kept_s: float = WINDOW_S
    infos: dict[str, DeviceInfo] = field(default_factory=dict)
    latest: Latest = field(default_factory=Latest)
    lost: Mapping[str, int] = field(default_factory=dict)

    def __enter__(self) -> HandSession:
        """Opens every device.

        Raises:
            DeviceError: one does not open; those that did are closed.
        """
        if self.holding is not None:
            self.holding.__enter__()
        if not self.rig.clock.virtual:
            # While nothing moves yet: a loop that stands still for it would be late.
            for signal in self._signals(self.rig.devices):
                if isinstance(signal, Compiled):
                    signal.warm_up()
            gc.collect()
            gc.freeze()
        try:
            for name, device in self.rig.devices.items():
                try:
                    self.infos[name] = device.open()
                except DeviceError as error:
                    if self.absent is None:
                        raise
                    self.absent[name] = error
            self.rig = replace(self.rig, devices={name: self.rig.devices[name] for name in self.infos})
            self.rig.clock.leave()
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """Closes every device, and the bench."""
        for device in self.rig.devices.values():
            with suppress(Exception):
                device.close()
        self.rig.close()
        gc.unfreeze()
        if self.holding is not None:
            self.holding.__exit__()

    @property
    def signals(self) -> Sequence[Signal]:
        """The signals whose sources are open, fresh."""
        return self._signals(self.infos)

    def _signals(self, devices: Collection[str]) -> Sequence[Signal]:
        made = {signal.info.name: signal for signal in self.make_signals()}
        return [signal for signal in made.values() if sources([signal.info.name], made) <= {*devices}]

    @property
    def streams(self) -> Mapping[str, StreamInfo]:
        """All that can be read."""
        return streams_of(self.infos) | {signal.info.name: signal.info for signal in self.signals}

    @property
    def movers(self) -> Sequence[str]:
        """The devices that can move."""
        return [name for name, info in self.infos.items() if info.mover]

    def run(
        self,
        steer: Steer,
        mover: str = "",
        streams: Collection[str] = (),
        *,
        limits: GuardSettings | None = None,
        deadline_s: float = math.inf,
    ) -> HandResult:
        """Have something done; every mover stands still when this returns.

        Args:
            streams: To be read, beside the guard's own.
            limits: Others than the session's.

        Raises:
            UnfitStreamError: a stream that the bench does not have.
        """
        self._begin()
        guard = Guard(limits or self.limits, 1.0 / self.loop.rate_hz)
        operator = _Operator(self.operator, self.rig, self.paced)
        loop = Loop(self.rig, self.infos, guard, self.latest, operator, self.loop)
        self.lost = loop.account.lost
        behavior = ByHand(steer, mover, frozenset(streams), deadline_s)
        outcome = reason = ""
        try:
            loop.run(behavior, {}, self.signals)
        except (Aborted, KeyboardInterrupt):
            outcome = "interrupted"
        except GuardRefusal as refusal:
            outcome, reason = "guard", f"guard: {refusal}"
        except DeviceError as error:
            outcome, reason = "fault", str(error)
        outcome = outcome or loop.account.outcome or behavior.outcome
        reason = reason or loop.account.reason or behavior.reason
        if self.holding is not None:
            self.holding.tell(not_at_rest=loop.account.not_at_rest)
        if loop.account.not_at_rest:
            still = f"NOT seen standing still: {', '.join(loop.account.not_at_rest)}: look at the bench"
            failures = [each.reason for each in loop.events if isinstance(each, Failed)]
            others = [failure for failure in failures if failure not in reason]
            outcome, reason = "fault", "; ".join(filter(None, (reason, *others, still)))
        return HandResult(outcome, reason, loop.events, loop.account.not_at_rest)

    def listen(self, streams: Collection[str]) -> Iterator[tuple[float, Sequence[Status]]]:
        """Read these streams, turn by turn, into `latest`; nothing is commanded but to send them.

        Gives bench time and what the devices reported. Ends when the operator has it end.

        Raises:
            UnfitStreamError: a signal cannot use the stream that the profile gives it.
        """
        self._begin()
        self.lost = lost = dict[str, int]()
        clock, signals = self.rig.clock, Signals(self.signals)
        asked = signals.subscribe(frozenset(streams))
        operator = _Operator(self.operator, self.rig, self.paced)
        self.rig.listen(asked)
        try:
            while (request := operator.poll()) != "abort":
                if request == "suspend":
                    operator.suspend()
                clock.wait_until(clock.now() + LISTEN_S)
                blocks, statuses = self.rig.gathered()
                try:
                    made, saturated = signals.push(blocks)
                except ValueError as error:
                    raise UnfitStreamError(str(error)) from error
                for status in statuses:
                    if isinstance(status, Lost):
                        lost[status.stream] = lost.get(status.stream, 0) + status.samples
                self.latest.record([*blocks, *made])
                yield clock.now(), [*statuses, *saturated]
        finally:
            for name, device in self.rig.devices.items():
                with suppress(DeviceError):
                    device.apply(Listen(name, frozenset()))
            clock.leave()

    def _begin(self) -> None:
        """A new bench time, as before a trial."""
        self.rig.clock.restart()
        self.rig.begin_trial(self.scene)
        self.latest = Latest(self.kept_s)


class _Operator:
    """The session's operator, as the loop knows one; where he is to look on, virtual time keeps to the wall clock."""

    def __init__(self, operator: HandOperator, rig: Rig, paced: bool) -> None:
        self._operator, self._clock = operator, rig.clock
        self._begun_s = monotonic_s() if paced and rig.clock.virtual else -math.inf
        self.suspend = operator.suspend

    def poll(self) -> str | None:
        """Waits for the wall clock, then asks."""
        rest(max(0.0, self._clock.now() - (monotonic_s() - self._begun_s)))
        return self._operator.poll()

    def state(self, name: str, t_s: float) -> None:
        """There is nothing to show."""


# --- which devices -------------------------------------------------------------------------------


def limits_of(limits: GuardSettings, mover: str) -> GuardSettings:
    """The limits that hold while one mover alone moves: with its own table, those of the other movers watch nothing."""
    if mover not in limits.movers:
        return limits.model_copy(update={"movers": {}})
    unwatched = dict.fromkeys(("position_stream", "pose_stream", "workspace_min_m", "workspace_max_m"))
    return limits.model_copy(update={**unwatched, "movers": {mover: limits.movers[mover]}})


def sources(streams: Iterable[str], signals: Mapping[str, Signal]) -> frozenset[str]:
    """The devices that streams come from, through signals or not."""
    return frozenset(
        device
        for stream in streams
        for device in (sources(signals[stream].inputs, signals) if stream in signals else (_owner(stream),))
    )


def _owner(stream: str) -> str:
    return stream.partition(".")[0]


# --- what a person asks for ----------------------------------------------------------------------


def scripted(script: Script) -> Steer:
    """What steers by a script."""
    begun = False

    def steer(event: Event) -> Sequence[Command] | None:
        nonlocal begun
        sent, begun = event if begun else None, True
        try:
            return script.send(sent)  # type: ignore[arg-type]  # a generator's first is None
        except StopIteration:
            return None

    return steer


def until(command: Command, *ends: type[Status]) -> Script:
    """The script that commands something, anew after a pause, and waits for one of these of its device."""
    event = yield [command]
    while not (isinstance(event, ends) and event.device == command.device):
        event = yield [command] if isinstance(event, Resumed) else ()


def home(session: HandSession, mover: str, deadline_s: float) -> HandResult:
    """Send a mover to its reference position; it stands there, or the reason says why not."""
    limits = limits_of(session.limits, mover)
    return session.run(scripted(until(Home(mover), Reached)), mover, limits=limits, deadline_s=deadline_s)


def forces(infos: Mapping[str, DeviceInfo]) -> Sequence[StreamInfo]:
    """The streams that can be tared."""
    return [each for each in streams_of(infos).values() if each.unit in FORCES and each.tared]


def tare(session: HandSession, stream: str) -> tuple[HandResult, Sequence[Floats]]:
    """Take a stream's level for zero, where nothing moves; how it went, and its levels before and after, by channel."""
    levels: list[Any] = []

    def measured(commands: Sequence[Command]) -> Script:
        event = yield commands
        until_s = event.t_s + 2.0 * LEVEL_S
        while not isinstance(event, Tick) or event.t_s < until_s:
            event = yield ()
        recent = session.latest.times(stream) > event.t_s - LEVEL_S
        levels.append(session.latest.values(stream)[recent].mean(axis=0) if recent.any() else np.array(()))

    def script() -> Script:
        yield from measured(())
        yield from measured([Tare(_owner(stream), stream)])

    return session.run(scripted(script()), streams=[stream], limits=unwatched(session.limits)), levels


def unwatched(limits: GuardSettings) -> GuardSettings:
    """Limits that look at no stream, for what moves nothing."""
    none = ("force_n", "position_stream", "pose_stream", "workspace_min_m", "workspace_max_m")
    return limits.model_copy(update={**dict.fromkeys(none), "movers": {}, "agree": {}, "range_streams": ()})


PLACES = (
    ("pose", "start_pose", "in [devices.{}]"),
    ("position", "start_m", "on the axis of {}, for example in [behavior]"),
    ("width", "width_m", "opening of {}"),
)
"""Streams that tell where a mover stands, the most telling first, and the settings that they are pasted into."""


def place(session: HandSession, device: str) -> str:
    """Where a mover stands, as a line of TOML for a profile; "" where it has not told."""
    for name, setting, section in PLACES:
        values = session.latest.values(f"{device}.{name}")
        if len(values):
            shown = [f"{round(value, 6) + 0.0:.7g}" for value in values[-1].tolist()]
            text = f"[{', '.join(shown)}]" if len(shown) > 1 else shown[0]
            return f"{setting} = {text}  # {section.format(device)}"
    return ""
