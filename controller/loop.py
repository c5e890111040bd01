"""One thread: samples in, guard, detectors, behavior, commands out, turn after turn until the trial ends."""

import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Protocol

from pydantic import Field

from behaviors.events import (
    Approached,
    BaselineRefused,
    Detected,
    Event,
    Forecast,
    GuardStopped,
    Paused,
    Resumed,
    Retreated,
    Tick,
)
from behaviors.machine import Behavior, verdict_of
from controller.detectors.protocol import Detector, readings_of
from controller.guard import Guard, GuardRefusal
from controller.own_modules import pushed
from controller.rig import Rig, streams_of
from controller.signals.protocol import Signal, Signals
from controller.subscriptions import unknown_streams
from drivers.core.clock import rest
from drivers.core.errors import PROGRAM, DeviceError
from drivers.core.messages import (
    ANSWERED,
    ANSWERS,
    MOTION,
    Command,
    DeviceInfo,
    Failed,
    Floats,
    Listen,
    Lost,
    Reached,
    SampleBlock,
    Saturated,
    Sent,
    Stalled,
    Standstill,
    Status,
    Stop,
)
from drivers.core.settings import Settings

STOP_AGAIN_S = 0.2
"""How often a stop is sent that is not answered: a line that was cut off does not hear the first one."""

STANDSTILL_TIMEOUT_S = 2.0
"""How long closing waits to see every mover stand still. Assumption: ten times a stage's slowest halt."""

WAY_OUT_S = 10.0
"""How long a behavior may retract or open after what ended its trial. Assumption: 0.1 m at 10 mm/s."""

ENDING = (GuardStopped, Failed, Stalled)
"""Events that end a trial, whatever its behavior makes of them."""

UNORDERED_S = 0.1
"""Events of two sources may be seen in either order where they are nearer in time. Assumption: a block is shorter."""

KEY_INTERVAL_S = 0.05
"""How often a paused virtual bench looks for a key: faster than anyone notices."""


class LoopSettings(Settings):
    """How often the loop turns."""

    rate_hz: float = Field(default=200.0, ge=1.0, le=2000.0)
    """Turns a second while something moves, or a state whose decisions may not wait has subscriptions."""

    idle_rate_hz: float = Field(default=50.0, ge=1.0, le=2000.0)
    """Turns a second otherwise. Without any subscription, virtual time jumps to the next deadline instead."""


class Witness(Protocol):
    """Keeps everything, controls nothing, never waits: the recorder's side of the loop."""

    @property
    def failure(self) -> Exception | None:
        """Why what it sees is no longer kept, or None."""

    def record(self, blocks: Sequence[SampleBlock]) -> None:
        """Keep the blocks of one turn."""

    def readings(self, detector: str, readings: Floats, decided_s: Sequence[float]) -> None:
        """Keep what a detector held against its threshold, and when an event followed from it."""

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Keep that a stream had no subscriber in this span."""

    def event(self, event: Event, *, state: str, next_state: str, commands: Sequence[Command]) -> None:
        """Keep one event and what followed from it."""


class HandOperator(Protocol):
    """Who may interrupt."""

    def poll(self) -> str | None:
        """Returns "pause", "suspend" (pause, and call `suspend` once nothing moves), "resume", "abort" or None; never
        waits."""

    def suspend(self) -> None:
        """Suspend the program until it is continued."""


class LoopOperator(HandOperator, Protocol):
    """The person at the bench."""

    def state(self, name: str, t_s: float) -> None:
        """Show the state that the trial is in."""


class Aborted(Exception):  # noqa: N818 - asked for, not an error
    """The operator ended the run."""


class UnfitStreamError(Exception):
    """A stream is missing, or unfit for the signal or detector that subscribes to it: profile and bench do not fit."""


@dataclass(slots=True)
class LoopAccount:
    """What the loop did in a trial.

    Attributes:
        overruns: Turns that began more than a whole period late (wall clock only).
        worst_late_s: The latest of them.
        missing: Which stream did not arrive and so ended the trial, and why; "" where all did.
        not_at_rest: Movers that were not seen standing still at the end.
        outcome: Of a trial that the guard or a failure ended, "guard" or "fault", whatever its behavior says; else "".
    """

    turns: int = 0
    overruns: int = 0
    worst_late_s: float = 0.0
    paused_s: float = 0.0
    missing: str = ""
    outcome: str = ""
    reason: str = ""
    lost: dict[str, int] = field(default_factory=dict)
    not_at_rest: list[str] = field(default_factory=list)


@dataclass(slots=True)
class TrialState:
    """A trial under way.

    Attributes:
        detectors: By the names that the behavior's states know them by.
        signals: What is computed from the devices' own streams.
        silent_since: Since when each stream without a subscriber has none.
        subscribed: Streams that the state, its detectors and the guard need.
        asked: The devices' streams that are needed for it.
        behind: Those of them that are only the input of a signal.
        sent: How many commands were sent: the number of the last one.
        decisions: How often the behavior went on or commanded anything.
        newest: Number of the newest command that is answered, by device.
        paused_s: Since when it is paused.
        suspending: Whether the program is to be suspended.
        end_s: When a trial ends that the guard or a failure ended.
        foreseen: What is expected of approaches that have begun, not recorded yet.
    """

    behavior: Behavior
    detectors: Mapping[str, Detector]
    signals: Signals
    silent_since: dict[str, float]
    armed: frozenset[str] = frozenset()
    subscribed: frozenset[str] = frozenset()
    asked: frozenset[str] = frozenset()
    behind: frozenset[str] = frozenset()
    sent: int = 0
    newest: dict[str, int] = field(default_factory=dict)
    moving: set[str] = field(default_factory=set)
    turn: int = 0
    decisions: int = 0
    paused_s: float | None = None
    resuming: bool = False
    suspending: bool = False
    end_s: float = math.inf
    foreseen: list[Forecast] = field(default_factory=list)

    @property
    def wake_s(self) -> float:
        """Before it nothing happens by itself."""
        return min(self.behavior.wake_s, self.end_s)

    def listening(self) -> Sequence[Detector]:
        """The armed detectors."""
        return [self.detectors[name] for name in sorted(self.armed)]

    def outdated(self, status: Status) -> bool:
        """Whether it is about a command that a newer one to the same device has replaced."""
        return status.command_id != self.newest.get(status.device, 0)


class Loop:
    """Runs one behavior on a rig.

    Args:
        infos: What `open` returned, by device.
    """

    def __init__(
        self,
        rig: Rig,
        infos: Mapping[str, DeviceInfo],
        guard: Guard,
        witness: Witness,
        operator: LoopOperator,
        settings: LoopSettings,
    ) -> None:
        self._rig = rig
        self._clock = rig.clock
        self._movers = [name for name, info in infos.items() if info.mover]
        self._streams = streams_of(infos)
        self._guard = guard
        self._witness = witness
        self._operator = operator
        self._settings = settings
        self.account = LoopAccount()
        self.events: list[Event] = []
        self.visits: list[tuple[str, float]] = []

    def run(
        self, behavior: Behavior, detectors: Mapping[str, Detector], signals: Sequence[Signal] = ()
    ) -> LoopAccount:
        """Run one trial to its end; every mover stands still when this returns or raises.

        Args:
            detectors: By the names that the behavior's states know them by.
            signals: What is computed from the devices' own streams.

        Raises:
            GuardRefusal: the guard would not let a command through.
            DeviceError: a device cannot do its part.
            UnfitStreamError: a signal or detector cannot use the stream that the profile gives it.
            Aborted: the operator ended the run.
            Exception: the witness's failure; a trial that is not recorded does not go on.
        """
        made = Signals(signals)
        silent_since = dict.fromkeys(self._streams.keys() | made.streams, 0.0)
        self._trial = TrialState(behavior, detectors, made, silent_since)
        self._guard.reset(behavior.range_streams)
        try:
            self._guard.check_streams(
                self._streams | {signal.info.name: signal.info for signal in signals},
                {signal.info.name: signal.inputs for signal in signals},
            )
            for line in unknown_streams(self._streams.keys(), behavior, detectors, signals):
                raise UnfitStreamError(line)
            self._poll_operator_first()
            self._begin()
            while not self._over:
                if not self._skip():
                    late_s = self._wait()
                    self._turn(self._clock.now(), late_s)
        finally:
            self.halt()
            self._clock.leave()
        return self.account

    @property
    def _over(self) -> bool:
        trial = self._trial
        return trial.behavior.done or (trial.end_s < math.inf and self._clock.now() >= trial.end_s)

    def halt(self) -> None:
        """Stop every mover, see that it stands still, end all subscriptions.

        Each step runs for each device whatever fails; a mover that was not seen standing still is named in
        `account.not_at_rest`.
        """
        self._stop_and_see(self._guard.looks_on_s)
        way_out = self._guard.way_out()
        if way_out is not None:
            self._go_back(*way_out)
        with suppress(Exception):
            self._subscribe(frozenset())
        for stream, since_s in sorted(self._trial.silent_since.items()):
            self._witness.skip(stream, since_s, self._clock.now())

    def _go_back(self, command: Command, for_s: float) -> None:
        """Where a stop was not enough: take the load away."""
        what = "; it pressed beyond limits.retreat_n"
        try:
            self._send(command)
            self._record_aside(Retreated(self._clock.now(), command.device), (command,))
            grows = self._see({command.device}, for_s, falls=True)
            self.account.reason += f"{what}: {command.device} was sent back"
            self.account.reason += f", until {grows}" if grows else ""
        except Exception as error:
            self.account.reason += f"{what}, and {command.device} could not be sent back: {error}"
        self._stop_and_see()

    def _stop_and_see(self, least_s: float = 0.0) -> None:
        """Stop every mover, and see for a while that it stands still."""
        self._stop_all()
        pending = set(self._movers)
        self._see(pending, STANDSTILL_TIMEOUT_S, least_s, STOP_AGAIN_S)
        self.account.not_at_rest += sorted(pending)

    def _see(
        self,
        pending: set[str],
        for_s: float,
        least_s: float = 0.0,
        again_s: float = math.inf,
        *,
        falls: bool = False,
    ) -> str | None:
        """Look at the devices until those pending have answered their last command, or for a while.

        Args:
            falls: Look no longer than what presses falls; returns why it does not.
            again_s: How often a stop that is not answered is sent again, under its number: whatever answers it, the
                mover stands.
        """
        begun_s = self._clock.now()
        due_s = begun_s + again_s
        while self._clock.now() < begun_s + (for_s if pending else least_s):
            self._clock.wait_until(self._clock.now() + 1.0 / self._settings.rate_hz)
            if self._clock.now() >= due_s:
                due_s += again_s
                for name in sorted(pending):
                    with suppress(Exception):
                        self._rig.devices[name].apply(replace(Stop(name), id=self._trial.newest[name]))
            for name, device in self._rig.devices.items():
                with suppress(Exception):
                    blocks, _ = self._perceive(device.read())
                    grows = self._guard.see_braking(blocks)
                    if falls and grows:
                        return grows
                with suppress(Exception):
                    for status in device.poll():
                        self._note(status)
                        self._record_aside(status)
                        if isinstance(status, Standstill | Reached) and not self._trial.outdated(status):
                            pending.discard(name)
                        elif isinstance(status, Failed) and name in pending:
                            pending.discard(name)
                            self.account.not_at_rest.append(name)
        return None

    # time

    def _stride(self) -> int:
        """How many periods a turn takes; 0 where nothing happens before the deadline."""
        trial = self._trial
        if trial.moving or (trial.subscribed and trial.behavior.plan.prompt):
            return 1
        if trial.subscribed or not self._clock.virtual or trial.paused_s is not None:
            return max(1, round(self._settings.rate_hz / self._settings.idle_rate_hz))
        return 0

    def _next(self, stride: int) -> int:
        """Number of the next turn; turn k is due at k / rate."""
        turn = self._trial.turn
        if stride:
            return (turn // stride + 1) * stride
        wake_s = self._trial.wake_s
        following = math.ceil(wake_s * self._settings.rate_hz - 1e-9) if math.isfinite(wake_s) else 0
        return max(following, turn + 1)

    def _wait(self) -> float:
        """Wait for the next turn; returns how late it is."""
        rate_hz, planned = self._settings.rate_hz, self._next(self._stride())
        self._clock.wait_until(planned / rate_hz)
        now_s = self._clock.now()
        late_s = now_s - planned / rate_hz
        self.account.turns += 1
        if late_s > 1.0 / rate_hz:
            self.account.overruns += 1
            self.account.worst_late_s = max(self.account.worst_late_s, late_s)
        # What was missed meanwhile is not made up for by a burst of turns.
        self._trial.turn = max(planned, math.floor(now_s * rate_hz))
        return late_s

    def _skip(self) -> bool:
        """Take the next turns as one, where the bench can and nothing follows from what happens in them: what is
        observed, sampled and recorded is the same, however it is cut."""
        trial, stride = self._trial, self._stride()
        watched = self._guard.in_contact_from_start or self.account.outcome or trial.paused_s is not None
        if self._rig.ahead is None or not stride or watched:
            return False
        first, rate_hz = self._next(stride), self._settings.rate_hz
        self._guard.arrivals.move(first / rate_hz, bool(trial.moving))
        turns = self._rig.ahead(
            first,
            stride,
            rate_hz,
            until_s=trial.wake_s,
            changed=[self._guard, trial.behavior, *trial.signals.awake, *trial.listening()],
            look=self._look,
            armed=bool(trial.armed),
            decisions=trial.decisions,
        )
        if not turns:
            return False
        trial.turn = first + (turns - 1) * stride
        self.account.turns += turns
        self._attend(self._clock.now())
        return True

    def _look(self) -> float | None:
        """See what has come since the last turn; when the first thing that anything follows from happened in it, or
        None where nothing did and all is recorded."""
        t_s = self._clock.now()
        try:
            gathered, statuses = self._rig.gathered()
            made, saturated = self._trial.signals.push(gathered)
            blocks = [*gathered, *made]
            found, readings = self._detect(blocks)
            events: list[Event] = sorted([*statuses, *saturated, *found], key=lambda event: event.t_s)
            decided = self._deciding(events)
        except Exception:  # what it is, and when, the turn that meets it reports
            return t_s
        if decided is not None:
            return decided.t_s
        moving, whole_s = bool(self._trial.moving), self._guard.arrivals.whole_until_s(t_s, blocks)
        if whole_s < math.inf:
            return whole_s
        if self._guard.check(t_s, blocks, moving) or self._guard.arrivals.check(t_s, blocks, moving):
            return t_s
        self._record_blocks(gathered)
        self._record_blocks(made)
        self._record_readings(readings)
        for event in events:
            self._record_aside(event)
        return None

    def _deciding(self, events: Sequence[Event]) -> Event | None:
        """Let the behavior handle events in order of time; the first one that anything follows from, or that the turns
        might have seen in another order, or None. Where there is one, who looks ahead puts the behavior back."""
        behavior = self._trial.behavior
        stays = behavior.state, behavior.plan, behavior.wake_s
        for before, event in pairwise(events):
            apart = _source(before) != _source(event)
            if apart and event.t_s - before.t_s < UNORDERED_S:
                return before
        for event in events:
            commands = not isinstance(event, Sent | Detected) or behavior.handle(event)
            if commands or (behavior.state, behavior.plan, behavior.wake_s) != stays:
                return event
        return None

    # one turn

    def _poll_operator_first(self) -> None:
        """A request from before the trial counts before anything moves."""
        request = self._request()
        if request in ("pause", "suspend"):
            self._operator.state("PAUSED", self._clock.now())
            while request not in ("resume", "abort"):
                if request == "suspend":
                    self._operator.suspend()
                rest(KEY_INTERVAL_S)
                for status in self._rig.gathered()[
                    1
                ]:  # what is sent meanwhile is taken, and watchdogs are fed
                    if isinstance(status, Failed | Stalled):
                        advice = f"mend it, then: {PROGRAM} resume"
                        raise DeviceError(status.device, "waiting for the operator", status.reason, advice)
                request = self._request()
        if request == "abort":
            raise Aborted

    def _begin(self) -> None:
        t_s = self._clock.now()
        commands = self._trial.behavior.begin(t_s)
        self.visits.append((self._trial.behavior.state, t_s))
        self._rig.entered(self._trial.behavior.state, t_s)
        self._operator.state(self._trial.behavior.state, t_s)
        self._obey(commands)
        self._record_foreseen()

    def _record_foreseen(self) -> None:
        for forecast in self._trial.foreseen:
            self._record_aside(forecast)
        self._trial.foreseen.clear()

    def _turn(self, t_s: float, late_s: float) -> None:
        """Gather, guard, detect, decide and command."""
        trial, guard = self._trial, self._guard
        gathered, statuses = self._rig.gathered()
        blocks, saturated = self._perceive(gathered)
        statuses += saturated
        if self._witness.failure is not None:
            raise self._witness.failure
        approached = [each for status in statuses if (each := self._note(status)) is not None]
        try:
            self._attend(t_s)
        except Aborted:
            come: list[Event] = [*statuses, *approached]
            for event in come:  # by now: it belongs to the trial
                self._record_aside(event)
            raise
        statuses += self._unanswered(t_s)
        moving = bool(trial.moving)
        beyond = [status for status in statuses if isinstance(status, Saturated)]
        reason = guard.check(t_s, blocks, moving, late_s, beyond)
        missing = guard.arrivals.check(t_s, blocks, moving, late_s)
        if reason is not None or missing is not None or any(isinstance(each, ENDING) for each in statuses):
            guard.latch(t_s)
            self._stop_all()
        found, readings = self._detect(blocks)
        self._record_readings(readings)
        events: list[Event] = [*statuses, *found, *approached]
        # What ends the trial comes first: nothing that happened before it is acted on any more.
        events.sort(key=lambda event: (not isinstance(event, ENDING), event.t_s))
        if missing is not None:
            self.account.missing = missing.reason
            events.insert(0, missing)
        if reason is not None:
            events.insert(0, GuardStopped(t_s, reason))
        for event in [*events, Tick(t_s)]:
            if self._passes_on(event):
                self._handle(event)
            elif not isinstance(event, Tick):
                self._record_aside(event)
        while self._waits_for_operator():
            # Virtual time stands still while a person thinks; the processor may as well rest.
            rest(KEY_INTERVAL_S)
            self._attend(t_s)
        self._go_on(t_s)

    def _passes_on(self, event: Event) -> bool:
        """Whether the behavior gets it: never after its end, no answer to an older command, a tick only
        from its wake time on (turns before may be taken together), and while paused only what ends the trial."""
        if self._over or isinstance(event, Approached):
            return False
        if isinstance(event, ANSWERS) and self._trial.outdated(event):
            return False
        if isinstance(event, Tick) and event.t_s < self._trial.behavior.wake_s - 1e-9:
            return False
        return self._trial.paused_s is None or isinstance(event, ENDING)

    def _perceive(self, gathered: Sequence[SampleBlock]) -> tuple[list[SampleBlock], list[Saturated]]:
        """What arrived, and what the signals make of it, recorded.

        The input of a signal alone is not recorded: the signal is, in its place.
        """
        self._record_blocks(gathered)
        try:
            made, saturated = self._trial.signals.push(gathered)
        except ValueError as error:
            raise UnfitStreamError(str(error)) from error
        self._record_blocks(made)
        return [*gathered, *made], saturated

    def _record_blocks(self, blocks: Sequence[SampleBlock]) -> None:
        self._witness.record([block for block in blocks if block.stream not in self._trial.behind])

    def _note(self, status: Status) -> Approached | None:
        """Note what a status says of a mover, or of a stream; what an approach did that it ends."""
        if isinstance(status, ANSWERS) and not self._trial.outdated(status):
            self._trial.moving.discard(status.device)
            return self._guard.answered(status)
        if isinstance(status, Lost):
            self.account.lost[status.stream] = self.account.lost.get(status.stream, 0) + status.samples
        return None

    def _detect(
        self, blocks: Iterable[SampleBlock]
    ) -> tuple[list[Detected], list[tuple[str, Floats, list[float]]]]:
        """The armed detectors' events from new blocks; what each held against its threshold, and when it decided."""
        found: list[Detected] = []
        readings: list[tuple[str, Floats, list[float]]] = []
        armed = self._trial.listening()
        for block in blocks:
            for detector in armed:
                if block.stream in detector.inputs:
                    events = self._pushed(detector, block)
                    found += events
                    read = readings_of(detector)
                    if len(read):
                        readings.append((detector.name, read, [event.t_s for event in events]))
        return found, readings

    def _pushed(self, detector: Detector, block: SampleBlock) -> list[Detected]:
        """What a detector found in a block."""
        try:
            events = pushed(detector, detector.name, block, _dated, "events, each at its sample's time")
        except ValueError as error:
            raise UnfitStreamError(str(error)) from error
        return [self._named(event, detector) for event in events]

    def _named(self, event: Detected, detector: Detector) -> Detected:
        """Of what a refused baseline was: the device that is wrong is to be found in the reason."""
        if not isinstance(event, BaselineRefused):
            return event
        of = ", ".join(map(self._guard.arrivals.named, detector.inputs))
        return replace(event, reason=f"{of}: {event.reason}")

    def _record_readings(self, readings: Iterable[tuple[str, Floats, list[float]]]) -> None:
        for reading in readings:
            self._witness.readings(*reading)

    def _handle(self, event: Event) -> None:
        before = self._trial.behavior.state
        ends = isinstance(event, ENDING)
        if ends:
            self._give_up(event)
        commands = self._trial.behavior.handle(event)
        after = self._trial.behavior.state
        changed = bool(commands) or after != before
        if after != before:
            self._rig.entered(after, self._clock.now())
        if ends and not changed:
            self._trial.end_s = -math.inf  # there is no way out to wait for
        try:
            if changed:
                self._obey(commands)
        finally:
            if changed or not isinstance(event, Tick):
                self._record_event(event, before, after, commands)
            self._record_foreseen()
            if after != before:
                self._operator.state(after, event.t_s)

    def _give_up(self, event: Event) -> None:
        """The trial ends by this event: its behavior may lead the movers out of it, for a while, from standing still.
        A second such event, or one in a pause, leaves no time for that."""
        again = bool(self.account.outcome)
        hurried = again or self._trial.paused_s is not None
        self._trial.end_s = -math.inf if hurried else self._clock.now() + WAY_OUT_S
        if not again:
            self.account.outcome, self.account.reason = verdict_of(event)

    def _obey(self, commands: Sequence[Command]) -> None:
        """Stop first, then change the subscriptions, then the rest in order."""
        self._trial.decisions += 1
        self._apply([command for command in commands if isinstance(command, Stop)])
        self._arrange(commands)
        self._apply([command for command in commands if not isinstance(command, Stop)])

    def _record_event(self, event: Event, before: str, after: str, commands: Sequence[Command]) -> None:
        self.events.append(event)
        if before != after:
            self.visits.append((after, event.t_s))
        self._witness.event(event, state=before, next_state=after, commands=commands)

    def _record_aside(self, event: Event, commands: Sequence[Command] = ()) -> None:
        """An event that leads to no other state."""
        self._record_event(event, self._trial.behavior.state, self._trial.behavior.state, commands)

    # what follows from a decision

    def _arrange(self, commands: Sequence[Command]) -> None:
        """Arm the detectors of the present state, and subscribe to what it needs."""
        plan = self._trial.behavior.plan
        for name in plan.detectors - self._trial.armed:
            self._trial.detectors[name].reset()
        self._trial.armed = plan.detectors
        decisive = frozenset(
            stream for name in plan.detectors for stream in self._trial.detectors[name].inputs
        )
        self._guard.arm(decisive)
        wanted = plan.measures | decisive
        moves = self._trial.moving or any(isinstance(command, MOTION) for command in commands)
        if wanted or moves or self._trial.paused_s is not None:
            wanted |= self._guard.inputs
        self._subscribe(wanted)

    def _subscribe(self, streams: frozenset[str]) -> None:
        if streams == self._trial.subscribed:
            return
        now_s = self._clock.now()
        asked = self._trial.signals.subscribe(streams)
        for name in self._rig.devices:
            wanted = frozenset(stream for stream in asked if stream.partition(".")[0] == name)
            present = frozenset(stream for stream in self._trial.asked if stream.partition(".")[0] == name)
            if wanted != present:
                self._send(Listen(name, wanted))
        self._trial.asked, self._trial.behind = asked, asked - streams
        self._guard.arrivals.expect(asked | streams, now_s)
        for stream in sorted(streams - self._trial.subscribed):
            self._witness.skip(stream, self._trial.silent_since.pop(stream, now_s), now_s)
        for stream in self._trial.subscribed - streams:
            self._trial.silent_since[stream] = now_s
        self._trial.subscribed = streams

    def _apply(self, commands: Sequence[Command]) -> None:
        for command in commands:
            try:
                if command.device not in self._rig.devices:
                    known = ", ".join(self._rig.devices)
                    raise GuardRefusal(f"{command}: there is no such device; the bench has {known}")
                admitted = self._guard.admit(command)
            except GuardRefusal as refusal:
                if not self.account.outcome:
                    raise
                self.account.reason += f"; then the guard refused {refusal}"
                self._trial.end_s = -math.inf
                continue
            foreseen = self._guard.foreseen(self._clock.now(), admitted)
            if foreseen is not None:
                self._trial.foreseen.append(foreseen)
            self._send(admitted)
            # A mover with a command to stop is waited for like one that moves: it reports its standstill either way.
            stops = isinstance(admitted, Stop) and command.device in self._movers
            if stops or isinstance(admitted, MOTION):
                self._trial.moving.add(command.device)

    def _send(self, command: Command) -> None:
        """Number a command, and hand it to its device."""
        trial = self._trial
        trial.sent += 1
        numbered = replace(command, id=trial.sent)
        if isinstance(command, ANSWERED):
            trial.newest[command.device] = numbered.id
        self._guard.sent(self._rig.devices[command.device].apply(numbered) or numbered)

    def _stop_all(self) -> None:
        for name in self._movers:
            # Whatever is wrong with one mover, the next one is stopped too.
            with suppress(Exception):
                self._send(Stop(name))
                # Its answer is waited for even where it stood.
                self._trial.moving.add(name)

    def _unanswered(self, t_s: float) -> Sequence[Failed]:
        """A mover that does not answer the stop of a pause, which has no deadline of its own: its line was gone."""
        paused_s, moving = self._trial.paused_s, sorted(self._trial.moving)
        if paused_s is None or not moving or t_s - paused_s < STANDSTILL_TIMEOUT_S:
            return ()
        reason = f"it was not seen standing still within {STANDSTILL_TIMEOUT_S:g} s of the pause; look at its cable"
        return [Failed(t_s, moving[0], reason)]

    def _waits_for_operator(self) -> bool:
        paused = self._trial.paused_s is not None and not self._trial.resuming and not self._over
        return paused and self._clock.virtual and not self._trial.moving

    def _request(self) -> str | None:
        """What the person at the bench wants, or a simulated one."""
        return self._operator.poll() or self._rig.pressed()

    def _attend(self, t_s: float) -> None:
        """Poll the operator: pause stops every mover, the guard goes on watching."""
        request = self._request()
        if request == "abort":
            raise Aborted
        if request in ("pause", "suspend"):
            self._trial.resuming = False  # also where it was to go on as soon as every mover stands
        if request in ("pause", "suspend") and self._trial.paused_s is None:
            self._trial.paused_s = t_s
            self._stop_all()
            self._arrange(())
            self._record_aside(Paused(t_s))
            self._operator.state("PAUSED", t_s)
        elif request == "resume":
            self._trial.resuming = True
        self._trial.suspending |= request == "suspend"
        if self._trial.suspending and not self._trial.moving:
            self._suspend()

    def _suspend(self) -> None:
        """Suspend the program, now that every mover is seen standing still."""
        self._trial.suspending = False
        self._operator.suspend()
        rest(KEY_INTERVAL_S)  # the drivers' threads were suspended too, and take now what came meanwhile
        now_s = self._clock.now()
        self._trial.turn = math.floor(now_s * self._settings.rate_hz)  # no turn was late
        # Nor was any stream silent: the program was suspended.
        self._guard.arrivals.expect(frozenset(), now_s)
        self._guard.arrivals.expect(self._trial.asked | self._trial.subscribed, now_s)

    def _go_on(self, t_s: float) -> None:
        """End a pause, once the movers' answers to its stop have been passed over.

        A mover that is still braking would answer the next command with the old one's standstill.
        """
        if self._over:
            return
        if self._trial.paused_s is not None and self._trial.resuming and not self._trial.moving:
            self.account.paused_s += t_s - self._trial.paused_s
            self._trial.paused_s = None
            self._operator.state(self._trial.behavior.state, t_s)
            self._handle(Resumed(t_s))


def _source(event: Event) -> tuple[str, str]:
    """The detector or device that it comes from."""
    return getattr(event, "detector", ""), getattr(event, "device", "")


def _dated(thing: object) -> bool:
    return isinstance(thing, Detected) and math.isfinite(thing.t_s)
