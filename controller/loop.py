"""One thread: samples in, guard, detectors, behavior, commands out, turn after turn until the trial ends."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import Protocol

from pydantic import Field

from behaviors.events import Detected, Event, GuardStopped, Paused, Resumed, Tick
from behaviors.machine import Behavior
from controller.detectors.protocol import Detector, Reading, reading_of
from controller.fit import misfits
from controller.guard import Guard
from controller.look_ahead import LONGEST_S, Acting, Leashed, Reach, Snapshot, UnkeptError, turns_before
from controller.rig import Rig
from controller.signals.protocol import Signal, Signals
from drivers.clock import rest
from drivers.messages import (
    ANSWERED,
    ANSWERS,
    MOTION,
    Command,
    DeviceInfo,
    Failed,
    Listen,
    Lost,
    SampleBlock,
    Saturated,
    Stalled,
    Standstill,
    Status,
    Stop,
)
from drivers.settings import Settings

STANDSTILL_TIMEOUT_S = 2.0
"""How long closing waits to see every mover stand still. Assumption: ten times a stage's slowest halt."""

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

    def reading(self, detector: str, reading: Reading) -> None:
        """Keep what a detector held against its threshold."""

    def skip(self, stream: str, t0_s: float, t1_s: float) -> None:
        """Keep that a stream had no subscriber in this span."""

    def event(self, event: Event, *, state: str, next_state: str, commands: Sequence[Command]) -> None:
        """Keep one event and what followed from it."""


class LoopOperator(Protocol):
    """The person at the bench."""

    def poll(self) -> str | None:
        """Returns "pause", "suspend" (pause, and call `suspend` once nothing moves), "resume", "abort" or None; never
        waits."""

    def suspend(self) -> None:
        """Suspend the program until it is continued."""

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
        turns: How many turns it took.
        overruns: Turns that began more than a whole period late (wall clock only).
        worst_late_s: The latest of them.
        lost: Samples lost, by stream.
        paused_s: Time spent paused.
        missing: Which stream did not arrive and so ended the trial, and why; "" where all did.
        unstill: Movers that were not seen standing still at the end.
    """

    turns: int = 0
    overruns: int = 0
    worst_late_s: float = 0.0
    paused_s: float = 0.0
    missing: str = ""
    lost: dict[str, int] = field(default_factory=dict)
    unstill: list[str] = field(default_factory=list)


class Loop:
    """Runs one behavior on a rig.

    Args:
        rig: Open devices and their clock.
        infos: What `open` returned, by device.
        guard: The last gate.
        witness: The recorder.
        operator: Who may pause and abort.
        settings: Rates.
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
        self._streams = {name: stream for info in infos.values() for name, stream in info.streams.items()}
        self._acting = [device for device in rig.devices.values() if isinstance(device, Acting)]
        self._leashed = [device for device in rig.devices.values() if isinstance(device, Leashed)]
        self._guard = guard
        self._witness = witness
        self._operator = operator
        self._settings = settings
        self.account = LoopAccount()
        self.events: list[Event] = []
        self.entered_s: dict[str, float] = {}
        self.visits: list[tuple[str, float]] = []

    def run(
        self, behavior: Behavior, detectors: Mapping[str, Detector], signals: Sequence[Signal] = ()
    ) -> LoopAccount:
        """Run one trial to its end; every mover stands still when this returns or raises.

        Args:
            behavior: What is done.
            detectors: By the names that the behavior's states know them by.
            signals: What is computed from the devices' own streams.

        Raises:
            GuardRefusal: the guard would not let a command through.
            DeviceError: a device cannot do its part.
            UnfitStreamError: a signal or detector cannot use the stream that the profile gives it.
            Aborted: the operator ended the run.
            Exception: the witness's failure; a trial that is not recorded does not go on.
        """
        self._behavior = behavior
        self._detectors = detectors
        self._signals = Signals(signals)
        self._armed: frozenset[str] = frozenset()
        self._subscribed: frozenset[str] = frozenset()
        self._asked: frozenset[str] = frozenset()
        self._behind: frozenset[str] = frozenset()
        self._silent_since = dict.fromkeys(self._streams.keys() | self._signals.streams, 0.0)
        self._numbers = itertools.count(1)
        self._newest: dict[str, int] = {}  # of the commands that are answered, by device
        self._moving: set[str] = set()
        self._paused_s: float | None = None
        self._resuming = self._suspending = False
        self._turns = 0
        self._reach = Reach()
        self._guard.reset(behavior.range_streams)
        try:
            self._guard.check_streams(
                self._streams | {signal.info.name: signal.info for signal in signals},
                {signal.info.name: signal.inputs for signal in signals},
            )
            for line in misfits(self._streams.keys(), behavior, detectors, signals):
                raise UnfitStreamError(line)
            self._poll_operator_first()
            self._begin()
            while not behavior.done:
                if not self._pass_quietly():
                    self._turns, late_s = self._wait(self._next(self._turns))
                    self._turn(self._clock.now(), late_s)
        finally:
            self.halt()
            self._clock.leave()
        return self.account

    def halt(self) -> None:
        """Stop every mover, see that it stands still, end all subscriptions.

        Each step runs for each device whatever fails; a mover that was not seen standing still is named in
        `account.unstill`.
        """
        self._stop_all()
        pending = set(self._movers)
        give_up_s = self._clock.now() + STANDSTILL_TIMEOUT_S
        while pending and self._clock.now() < give_up_s:
            self._clock.wait_until(self._clock.now() + 1.0 / self._settings.rate_hz)
            for name, device in self._rig.devices.items():
                with suppress(Exception):
                    self._perceive(device.read())
                with suppress(Exception):
                    for status in device.poll():
                        self._note(status)
                        self._record_event(status, self._behavior.state, self._behavior.state, ())
                        if isinstance(status, Standstill) and not self._outdated(status):
                            pending.discard(name)
                        elif isinstance(status, Failed) and name in pending:
                            pending.discard(name)
                            self.account.unstill.append(name)
        self.account.unstill += sorted(pending)
        with suppress(Exception):
            self._subscribe(frozenset())
        for stream, since_s in sorted(self._silent_since.items()):
            self._witness.skip(stream, since_s, self._clock.now())

    # time

    def _next(self, turn: int) -> int:
        """Number of the next turn; turn k is due at k / rate."""
        stride = self._stride()
        if stride:
            return (turn // stride + 1) * stride
        wake_s = self._behavior.wake_s
        following = math.ceil(wake_s * self._settings.rate_hz - 1e-9) if math.isfinite(wake_s) else 0
        return max(following, turn + 1)

    def _stride(self) -> int:
        """How many periods a turn takes; 0 where nothing happens before the deadline."""
        if self._moving or (self._subscribed and self._behavior.plan.prompt):
            return 1
        if self._subscribed or not self._clock.virtual or self._paused_s is not None:
            return max(1, round(self._settings.rate_hz / self._settings.idle_rate_hz))
        return 0

    def _wait(self, planned: int) -> tuple[int, float]:
        """Wait for a turn; returns the number of the one that it has become, and how late it is."""
        rate_hz = self._settings.rate_hz
        self._clock.wait_until(planned / rate_hz)
        now_s = self._clock.now()
        late_s = now_s - planned / rate_hz
        self.account.turns += 1
        if late_s > 1.0 / rate_hz:
            self.account.overruns += 1
            self.account.worst_late_s = max(self.account.worst_late_s, late_s)
        # What was missed meanwhile is not made up for by a burst of turns.
        return max(planned, math.floor(now_s * rate_hz)), late_s

    # many turns at once

    def _pass_quietly(self) -> bool:
        """Take the next turns at once where nothing happens in them: what is observed, sampled and recorded in them is
        the same, however it is cut. Where something does, time is taken back, and False means that turns are due."""
        stride, reach, rate_hz = self._stride(), self._reach, self._settings.rate_hz
        plants = self._rig.plants()
        if plants is None or not stride or self._paused_s is not None or reach.turns < 2 or self._guard.bears:
            return False
        first = self._next(self._turns)
        if any(each.blind_s <= stride / rate_hz for each in self._leashed):
            return False
        alone_s = min((each.alone_s for each in self._acting), default=math.inf)
        until_s = min(self._behavior.wake_s, self._clock.now() + min(alone_s, LONGEST_S))
        turns = min(reach.turns, turns_before(until_s, first, stride, rate_hz))
        if turns < 2:
            return False
        devices = self._rig.devices.values()
        armed = [self._detectors[name] for name in self._armed]
        try:
            before = Snapshot([self._clock, *plants, *devices, self._guard, *self._signals.awake, *armed])
        except UnkeptError:
            return False
        last = first + (turns - 1) * stride
        for each in self._leashed:
            each.watched_until_s = last / rate_hz
        happened_s = self._try_until(last / rate_hz)
        if happened_s is not None:
            before.restore()
            reach.happened(turns, turns_before(happened_s, first, stride, rate_hz))
            return self._pass_quietly()
        self._turns = last
        self.account.turns += turns
        reach.quiet(bool(self._armed))
        self._attend(self._clock.now())
        return True

    def _try_until(self, t_s: float) -> float | None:
        """Let time pass; when the first thing happened, or None where nothing did and all is recorded."""
        self._clock.wait_until(t_s)
        gathered: list[SampleBlock] = []
        statuses: list[Status] = []
        try:
            for device in self._rig.devices.values():
                gathered += device.read()
                statuses += device.poll()
            made, saturated = self._signals.push(gathered)
            blocks = [*gathered, *made]
            found, readings = self._detect(blocks)
            events: list[Event] = [*statuses, *saturated, *found]
        except Exception:  # what it is, and when, the turn that meets it reports
            return t_s
        if events:
            return min(event.t_s for event in events)
        moving, whole_s = bool(self._moving), self._guard.whole_until_s(t_s, blocks)
        if whole_s < math.inf:
            return whole_s
        if self._guard.watch(t_s, blocks, moving) or self._guard.missing(t_s, blocks, moving):
            return t_s
        self._record_blocks(gathered)
        self._record_blocks(made)
        self._record_readings(readings)
        return None

    # one turn

    def _poll_operator_first(self) -> None:
        """A request from before the trial counts before anything moves."""
        request = self._operator.poll()
        if request in ("pause", "suspend"):
            self._operator.state("PAUSED", self._clock.now())
            while request not in ("resume", "abort"):
                if request == "suspend":
                    self._operator.suspend()
                rest(KEY_INTERVAL_S)
                request = self._operator.poll()
        if request == "abort":
            raise Aborted

    def _begin(self) -> None:
        t_s = self._clock.now()
        commands = self._behavior.begin(t_s)
        self._entered(self._behavior.state, t_s)
        self._operator.state(self._behavior.state, t_s)
        self._obey(commands)

    def _turn(self, t_s: float, late_s: float) -> None:
        gathered: list[SampleBlock] = []
        statuses: list[Status] = []
        for device in self._rig.devices.values():
            gathered += device.read()
            statuses += device.poll()
        blocks, saturated = self._perceive(gathered)
        statuses += saturated
        if self._witness.failure is not None:
            raise self._witness.failure
        for status in statuses:
            self._note(status)
        self._attend(t_s)
        beyond = [status for status in statuses if isinstance(status, Saturated)]
        reason = self._guard.watch(t_s, blocks, bool(self._moving), late_s, beyond)
        missing = self._guard.missing(t_s, blocks, bool(self._moving), late_s)
        if reason is not None or missing is not None:
            self._stop_all()
        found, readings = self._detect(blocks)
        self._record_readings(readings)
        events: list[Event] = [*statuses, *found]
        events.sort(key=lambda event: event.t_s)
        if missing is not None:
            self.account.missing = missing.reason
            events.insert(0, missing)
        if reason is not None:
            events.insert(0, GuardStopped(t_s, reason))
        before = len(self.events)
        for event in [*events, Tick(t_s)]:
            if self._heeds(event):
                self._handle(event)
            elif not isinstance(event, Tick):
                self._record_event(event, self._behavior.state, self._behavior.state, ())
        if len(self.events) > before:
            self._reach.begin()
        else:
            self._reach.quiet(bool(self._armed))
        while self._waits_for_operator():
            # Virtual time stands still while a person thinks; the processor may as well rest.
            rest(KEY_INTERVAL_S)
            self._attend(t_s)
        self._go_on(t_s)

    def _heeds(self, event: Event) -> bool:
        """Whether the behavior gets it: never after its end, no answer to an older command, a tick only
        from its wake time on (turns before may be taken together), and while paused only what ends the trial."""
        if self._behavior.done or (isinstance(event, ANSWERS) and self._outdated(event)):
            return False
        if isinstance(event, Tick) and event.t_s < self._behavior.wake_s - 1e-9:
            return False
        return self._paused_s is None or isinstance(event, GuardStopped | Failed | Stalled)

    def _perceive(self, gathered: Sequence[SampleBlock]) -> tuple[list[SampleBlock], list[Saturated]]:
        """What arrived, and what the signals make of it, recorded.

        The input of a signal alone is not recorded: the signal is, in its place.
        """
        self._record_blocks(gathered)
        try:
            made, saturated = self._signals.push(gathered)
        except ValueError as error:
            raise UnfitStreamError(str(error)) from error
        self._record_blocks(made)
        return [*gathered, *made], saturated

    def _record_blocks(self, blocks: Sequence[SampleBlock]) -> None:
        self._witness.record([block for block in blocks if block.stream not in self._behind])

    def _note(self, status: Status) -> None:
        if isinstance(status, (*ANSWERS, Stalled, Failed)) and not self._outdated(status):
            self._moving.discard(status.device)
        elif isinstance(status, Lost):
            self.account.lost[status.stream] = self.account.lost.get(status.stream, 0) + status.samples

    def _outdated(self, status: Status) -> bool:
        """Whether it is about a command that a newer one to the same device has replaced."""
        if isinstance(status, Stalled | Failed) and not status.command_id:
            return False
        return status.command_id != self._newest.get(status.device, 0)

    def _detect(self, blocks: Iterable[SampleBlock]) -> tuple[list[Detected], list[tuple[str, Reading]]]:
        """The armed detectors' events from new blocks, and what they held against their thresholds."""
        found: list[Detected] = []
        readings: list[tuple[str, Reading]] = []
        armed = [self._detectors[name] for name in sorted(self._armed)]
        for block in blocks:
            for detector in armed:
                if block.stream in detector.inputs:
                    try:
                        found += detector.push(block)
                    except ValueError as error:
                        raise UnfitStreamError(f"{detector.name}: {error}") from error
                    reading = reading_of(detector)
                    if reading is not None:
                        readings.append((detector.name, reading))
        return found, readings

    def _record_readings(self, readings: Iterable[tuple[str, Reading]]) -> None:
        for name, reading in readings:
            self._witness.reading(name, reading)

    def _handle(self, event: Event) -> None:
        before = self._behavior.state
        commands = self._behavior.handle(event)
        after = self._behavior.state
        changed = bool(commands) or after != before
        try:
            if changed:
                self._obey(commands)
        finally:
            if changed or not isinstance(event, Tick):
                self._record_event(event, before, after, commands)
            if after != before:
                self._operator.state(after, event.t_s)

    def _obey(self, commands: Sequence[Command]) -> None:
        """Stop first, then change the subscriptions, then the rest in order."""
        self._apply([command for command in commands if isinstance(command, Stop)])
        self._arrange(commands)
        self._apply([command for command in commands if not isinstance(command, Stop)])

    def _record_event(self, event: Event, before: str, after: str, commands: Sequence[Command]) -> None:
        self.events.append(event)
        if before != after:
            self._entered(after, event.t_s)
        self._witness.event(event, state=before, next_state=after, commands=commands)

    def _entered(self, state: str, t_s: float) -> None:
        self.entered_s[state] = t_s
        self.visits.append((state, t_s))

    # what follows from a decision

    def _arrange(self, commands: Sequence[Command]) -> None:
        """Arm the detectors of the present state, and subscribe to what it needs."""
        plan = self._behavior.plan
        for name in plan.detectors - self._armed:
            self._detectors[name].reset()
        self._armed = plan.detectors
        decisive = frozenset(stream for name in plan.detectors for stream in self._detectors[name].inputs)
        self._guard.arm(decisive)
        wanted = plan.measures | decisive
        moves = self._moving or any(isinstance(command, MOTION) for command in commands)
        if wanted or moves or self._paused_s is not None:
            wanted |= self._guard.inputs
        self._subscribe(wanted)

    def _subscribe(self, streams: frozenset[str]) -> None:
        if streams == self._subscribed:
            return
        now_s = self._clock.now()
        asked = self._signals.subscribe(streams)
        for name in self._rig.devices:
            wanted = frozenset(stream for stream in asked if stream.partition(".")[0] == name)
            present = frozenset(stream for stream in self._asked if stream.partition(".")[0] == name)
            if wanted != present:
                self._send(Listen(name, wanted))
        self._asked, self._behind = asked, asked - streams
        self._guard.expect(asked | streams, now_s)
        for stream in sorted(streams - self._subscribed):
            self._witness.skip(stream, self._silent_since.pop(stream, now_s), now_s)
        for stream in self._subscribed - streams:
            self._silent_since[stream] = now_s
        self._subscribed = streams

    def _apply(self, commands: Sequence[Command]) -> None:
        for command in commands:
            admitted = self._guard.admit(command)
            self._send(admitted)
            # A mover with a command to stop is waited for like one that moves: it reports its standstill either way.
            if isinstance(admitted, MOTION) or (
                isinstance(admitted, Stop) and command.device in self._movers
            ):
                self._moving.add(command.device)

    def _send(self, command: Command) -> None:
        """Number a command, and hand it to its device."""
        numbered = replace(command, id=next(self._numbers))
        if isinstance(command, ANSWERED):
            self._newest[command.device] = numbered.id
        self._rig.devices[command.device].apply(numbered)

    def _stop_all(self) -> None:
        for name in self._movers:
            # Whatever is wrong with one mover, the next one is stopped too.
            with suppress(Exception):
                self._send(Stop(name))
                # Its answer is waited for even where it stood.
                self._moving.add(name)

    def _waits_for_operator(self) -> bool:
        paused = self._paused_s is not None and not self._resuming and not self._behavior.done
        return paused and self._clock.virtual and not self._moving

    def _attend(self, t_s: float) -> None:
        """Poll the operator: pause stops every mover, the guard goes on watching."""
        request = self._operator.poll()
        if request == "abort":
            raise Aborted
        if request in ("pause", "suspend") and self._paused_s is None:
            self._paused_s = t_s
            self._resuming = False
            self._stop_all()
            self._arrange(())
            name = self._behavior.state
            self._record_event(Paused(t_s), name, name, ())
            self._operator.state("PAUSED", t_s)
        elif request == "resume":
            self._resuming = True
        self._suspending |= request == "suspend"
        if self._suspending and not self._moving:
            self._suspend()

    def _suspend(self) -> None:
        """Suspend the program, now that every mover is seen standing still."""
        self._suspending = False
        self._operator.suspend()
        rest(KEY_INTERVAL_S)  # the drivers' threads were suspended too, and take now what came meanwhile
        now_s = self._clock.now()
        self._turns = math.floor(now_s * self._settings.rate_hz)  # no turn was late
        # Nor was any stream silent: the program was suspended.
        self._guard.expect(frozenset(), now_s)
        self._guard.expect(self._asked | self._subscribed, now_s)

    def _go_on(self, t_s: float) -> None:
        """End a pause, once the movers' answers to its stop have been passed over.

        A mover that is still braking would answer the next command with the old one's standstill.
        """
        if self._behavior.done:
            return
        if self._paused_s is not None and self._resuming and not self._moving:
            self.account.paused_s += t_s - self._paused_s
            self._paused_s = None
            self._operator.state(self._behavior.state, t_s)
            self._handle(Resumed(t_s))
