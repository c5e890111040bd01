"""The limits of a bench, each driven past once, slowly: what was done, what acted, after how long, how far it went.

Loop, guard, drivers and devices are those that a run has. What goes wrong, goes wrong between drivers and loop
(`Seam`): readings are replaced, withheld or held, or the program is away for a while; below that all is real. Stop
comes first: a bench that does not stop is driven past nothing.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, fields, replace
from functools import partial
from itertools import chain
from typing import Any, Literal, NamedTuple

import numpy as np

from behaviors.events import Event, GuardStopped, Retreated
from controller.arrivals import REST, stuck_after_s
from controller.by_hand import HandResult, HandSession, Script, scripted, until
from controller.forecast import refusal
from controller.guard import Guard
from controller.limits import MoverLimits
from controller.loop import HandOperator
from controller.redundancy import FOLLOW_S
from controller.signals.protocol import Signal
from drivers.core.axis import AxisLimits
from drivers.core.errors import CommandError
from drivers.core.messages import (
    Command,
    Failed,
    Grip,
    Gripped,
    Home,
    Listen,
    MoveAt,
    MovePose,
    MoveTo,
    Reached,
    Release,
    SampleBlock,
    Saturated,
    SetTendon,
    Stalled,
    Standstill,
    Status,
    Stop,
    Twist,
)
from drivers.core.protocols import Device
from drivers.core.settings import Settings

CREEP_M_S = 1e-3
"""Speed of every motion in which something goes wrong. A bench's own approaches are several times as fast."""

JAWS_M_S = 2e-3
"""The same of a gripper's opening, of which each jaw makes a half."""

GENTLE_N = 7.0
"""How hard empty jaws may press meanwhile. Source: the least at which the SSG-48 is stable (data sheet, 150 mA)."""

RUN_S = 0.4
"""How long a mover moves before something goes wrong."""

PATIENCE_S = 2.0
"""How long a limit is waited for beyond its own time; meanwhile the mover creeps on."""

SLACK_S = 0.5
"""How much later than in its own time a limit may act, braking included (assumption: some late turns of a loop)."""

SLACK_M = 2e-4
"""How much farther than creeping for that time a mover may go: an arm's repeatability, a gripper's count."""

ROOM_M = 0.005
"""What a mover needs free before it: its farthest motion here."""

ATTEND_S = 0.02
"""How often devices are looked at while a person is waited for: as an idle loop does."""

REST_S = 0.3
"""How long a mover is watched afterwards: creeping on, it would go farther than `STILL_M` in a third of that."""

STILL_M, STILL_JAWS_M = 1e-4, 2.5e-4
"""What stands still stays within this: above an arm's noise, and above a count of a gripper (0.19 mm)."""

BEYOND = 1.5
"""How far past a limit what is asked for or read is, as a share of it."""

AWAY_S = 1.0
"""After a longer absence the devices are opened anew."""

GIVE_UP_S = 90.0
"""Longest way to where a case begins."""

PRESS_N = 0.5
"""A force limit up to this is pressed for as well, by the mover itself (assumption: no probe is the worse for it)."""

NOT_AT_REST = "NOT seen standing still: look at the bench"
UNKNOWN = "how it moves is not known here (the settings of a stage of your own are an `AxisLimits`)"

Verdict = Literal["acted", "failed", "not shown", "nothing to bound", "not tried"]


class Proof(NamedTuple):
    """What became of one limit.

    Attributes:
        limit: As it stands in a profile, `limits.force_n`; or what a person does, `stop of stage`.
        value: Its value, with its unit; "" where there is none.
        acted: What acted, and what it said; or why nothing did, or nothing was tried.
        after_s: From then to standstill; None where nothing moved.
        way_m: How far the mover went meanwhile, likewise.
    """

    limit: str
    value: str
    done: str
    verdict: Verdict = "not tried"
    acted: str = ""
    after_s: float | None = None
    way_m: float | None = None

    def judged(
        self, sound: bool, still: bool, text: str, after_s: float | None = None, way_m: float | None = None
    ) -> Proof:
        """The limit acted where what was seen is sound, and the mover then stands still."""
        rest = "" if still else f"; {NOT_AT_REST}"
        return self.found("acted" if sound and still else "failed", text + rest, after_s, way_m)

    def found(self, verdict: Verdict, acted: str, *seen: float | None) -> Proof:
        """What became of it; see the attributes."""
        return Proof(self.limit, self.value, self.done, verdict, acted, *seen)


Case = tuple[Proof, Callable[[Proof], Proof]]
"""One limit that is to be driven past, and what does it and gives what became of it."""


# --- what goes wrong ---------------------------------------------------------------------------------

Change = Callable[[SampleBlock, Any], SampleBlock | None]
"""What the loop gets in place of a block, given the last value before; None withholds it."""


@dataclass
class Wrong:
    """What goes wrong between drivers and loop, or is commanded, once it has begun.

    Attributes:
        change: What becomes of a block of them.
        beyond: What is reported to be beyond the stream's range, once.
        away_s: How long the program is away, once.
        away_from: Before which device is read.
        pauses: Whether the operator pauses, and ends the trial once something stands still.
        said: What the guard must say then; "" of what the device itself must do.
        past_s: Since when, s of bench time; nan before.
    """

    what: str = ""
    stream: str = ""
    change: Change | None = None
    beyond: float | None = None
    away_s: float = 0.0
    away_from: str = ""
    command: Command | None = None
    pauses: bool = False
    said: str = ""
    own_s: float = 0.0
    past_s: float = math.nan
    _last: Any = None
    _request: str | None = "pause"

    @property
    def begun(self) -> bool:
        """Whether it has begun."""
        return self.past_s >= 0.0

    def passed_on(self, block: SampleBlock) -> Sequence[SampleBlock]:
        """What is passed on of a block."""
        if block.stream != self.stream or self.change is None or not len(block):
            return (block,)
        if not self.begun or self._last is None:
            self._last = block.values[-1]
            return (block,)
        changed = self.change(block, self._last)
        return () if changed is None else (changed,)

    def reported(self, t_s: float, device: str) -> Sequence[Saturated]:
        """What is reported besides."""
        if not self.begun or self.beyond is None:
            return ()
        value, self.beyond = self.beyond, None
        return (Saturated(t_s, device, self.stream, value),)

    def requested(self) -> str | None:
        """What the operator asks for."""
        if not (self.pauses and self.begun):
            return None
        request, self._request = self._request, None
        return request

    def see(self, statuses: Sequence[Status]) -> None:
        """End a trial that is paused, once something stands still."""
        if self._request is None and any(isinstance(status, Standstill) for status in statuses):
            self._request = "abort"


def withheld(block: SampleBlock, last: Any) -> None:
    """Samples do not arrive."""


def held(block: SampleBlock, last: Any) -> SampleBlock:
    """A sensor repeats its last value."""
    return replace(block, values=np.broadcast_to(last, block.values.shape).copy())


def reading(value: float, channel: int = 0) -> Change:
    """A sensor reads this value, in its unit."""

    def changed(block: SampleBlock, last: Any) -> SampleBlock:
        values = block.values.copy()
        values[:, channel] = value / block.scale
        return replace(block, values=values)

    return changed


class Seam:
    """A device as the loop sees it; what it really sends is kept.

    Attributes:
        shown: The stream that is kept.
        seen: Time and value of its samples' first channel.
    """

    def __init__(self, device: Device, clock: Any) -> None:
        self.real, self._clock = device, clock
        self.restart(Wrong(), "")

    def __getattr__(self, name: str) -> Any:
        return getattr(self.real, name)

    def restart(self, wrong: Wrong, shown: str) -> None:
        """Begin a case."""
        self.wrong, self.shown, self.last_s = wrong, shown, -math.inf
        self.seen: list[tuple[float, float]] = []

    def read(self) -> Sequence[SampleBlock]:
        """What the loop gets of what has arrived."""
        wrong = self.wrong
        if wrong.begun and wrong.away_s and self.name == wrong.away_from:
            away_s, wrong.away_s = wrong.away_s, 0.0
            self._clock.rest(away_s)
        blocks: list[SampleBlock] = []
        for block in self.real.read():
            self.last_s = max(self.last_s, block.last_s if len(block) else -math.inf)
            if block.stream == self.shown:
                self.seen += zip(block.times.tolist(), block.physical[:, 0].tolist(), strict=True)
            blocks += wrong.passed_on(block)
        return blocks

    def place_m(self, t_s: float) -> float:
        """Where it was at a time, by what is kept; nan before that."""
        return next((x_m for seen_s, x_m in reversed(self.seen) if seen_s <= t_s), math.nan)

    def poll(self) -> Sequence[Status]:
        """Likewise of the statuses."""
        own = self.wrong.stream.partition(".")[0] == self.name
        statuses = self.real.poll()
        self.wrong.see(statuses)
        return [*statuses, *(self.wrong.reported(self._clock.now(), self.name) if own else ())]


class SignalSeam:
    """A signal as the loop sees it."""

    def __init__(self, signal: Signal, wrong: Wrong) -> None:
        self._signal, self._wrong = signal, wrong

    def __getattr__(self, name: str) -> Any:
        return getattr(self._signal, name)

    def push(self, block: SampleBlock) -> Sequence[SampleBlock | Saturated]:
        """What the loop gets of what the signal makes."""
        made: list[SampleBlock | Saturated] = []
        for each in self._signal.push(block):
            made += self._wrong.passed_on(each) if isinstance(each, SampleBlock) else (each,)
        if self._wrong.stream == self._signal.info.name and len(block):
            made += self._wrong.reported(block.last_s, self._signal.name)
        return made


# --- how a mover creeps ------------------------------------------------------------------------------


class Mover(NamedTuple):
    """A mover and how it creeps.

    Attributes:
        shown: The stream that shows where it is.
        ready: Has it know where it is, first of all: jaws are sent home, which moves none that know.
        start: Goes to where each case begins.
        drive: Creeps from there, a few millimetres.
        still_m: Within what it stands still.
        where: Where these limits stand in the profile.
    """

    name: str
    shown: str
    ready: Command
    start: Command
    drive: Command
    speed_m_s: float
    still_m: float
    limits: MoverLimits
    where: str
    settings: Any

    def over(self, event: Event) -> bool:
        """Whether its motion is over by an event."""
        return isinstance(event, Reached | Gripped | Standstill) and event.device == self.name

    @property
    def doing(self) -> str:
        """For a person."""
        return f"{self.name} at {1e3 * self.speed_m_s:g} mm/s"

    def readied(self) -> Script:
        """The script that has it know where it is, and go where it begins."""
        yield from until(self.ready, Reached)
        yield from until(self.start, Reached)

    def creeping(self, wrong: Wrong, patience_s: float) -> Script:
        """The script that creeps, lets something go wrong, and waits for what stops the mover."""
        yield from self.readied()
        event = yield [self.drive]
        begun_s = event.t_s
        while event.t_s < begun_s + RUN_S:
            if self.over(event):
                return
            event = yield ()
        wrong.past_s = event.t_s
        event = yield [wrong.command] if wrong.command is not None else ()
        while event.t_s < wrong.past_s + patience_s and not self.over(event):
            event = yield ()

    def pressing(self, wrong: Wrong, patience_s: float) -> Script:
        """The script that presses until the guard stops it, stands still, and goes back."""
        yield from self.readied()
        event = yield [self.drive]
        while not isinstance(event, GuardStopped):
            if self.over(event):
                return
            event = yield ()
        wrong.past_s = event.t_s
        yield from until(Stop(self.name), Standstill)
        yield from until(self.start, Reached)


def listening(wrong: Wrong, patience_s: float) -> Script:
    """The script that listens where nothing can move, while something goes wrong."""
    event = yield ()
    while event.t_s < RUN_S:
        event = yield ()
    wrong.past_s = event.t_s
    while event.t_s < wrong.past_s + patience_s:
        event = yield ()


# --- the bench ---------------------------------------------------------------------------------------


class Certifier:
    """Drives past the limits of a bench, one by one; what goes wrong stands between its devices and the loop.

    Args:
        session: The bench, closed, with the limits of a trial; makes it for its operator.
        consent: Called before each motion with what will move, and how; gives what says whether a person agrees by now,
            None where none is asked. Both may raise, to end the certificate.
        stopped: Whether somebody has ended the certificate: what moves is stopped, and no other case begins.
        abandoned: Has another program creep with a mover, whose device is closed here, and kills it, or freezes it
            while the context lasts; gives where the mover was last. None where devices live in this process.
    """

    def __init__(
        self,
        session: Callable[[HandOperator], HandSession],
        settings: Mapping[str, Settings],
        consent: Callable[[str], Callable[[], bool] | None] = lambda text: None,
        abandoned: Callable[[Mover, bool], AbstractContextManager[float]] | None = None,
        stopped: Callable[[], bool] = lambda: False,
    ) -> None:
        self.session = made = session(self)
        self._settings, self._consent, self._stopped = settings, consent, stopped
        self.abandoned = abandoned
        self._seams = {name: Seam(device, made.rig.clock) for name, device in made.rig.devices.items()}
        made.rig = replace(made.rig, devices=dict[str, Any](self._seams), ahead=None)
        fresh = made.make_signals
        made.make_signals = lambda: [SignalSeam(signal, self._wrong) for signal in fresh()]
        self._limits, self._guarded = made.limits, sorted(Guard(made.limits).inputs)
        self._wrong, self._left_alone, self._end_m, self._gone = Wrong(), False, math.nan, ""

    def poll(self) -> str | None:
        """The operator's request."""
        return "abort" if self._stopped() else self._wrong.requested()

    def suspend(self) -> None:
        """Never asked for."""

    def proofs(self) -> Iterator[Proof]:
        """Each limit in turn; every device is closed at the end, whatever happens.

        Raises:
            DeviceError: a device does not open, or fails between two cases.
            KeyboardInterrupt: somebody has ended it; says what was not seen standing still.
        """
        with self.session as session:
            movers = [mover for name in session.movers if (mover := self._mover(name)) is not None]
            ended = ""
            first = [case for mover in movers for case in self._stops(mover)]  # all else depends on these
            for number, (proof, tried) in enumerate(chain(first, self._cases(movers))):
                self._go_on()
                if ended:
                    yield proof._replace(done="nothing", acted=ended)
                    continue
                yield (found := tried(proof))
                grave = number < len(first) or NOT_AT_REST in found.acted
                if self._gone:
                    ended = f"{self._gone}: a bench without it is driven past nothing"
                elif found.verdict == "failed" and grave:
                    ended = f"{proof.limit} failed: a bench that does not stop is driven past nothing"
            for name in sorted({*session.movers} - {mover.name for mover in movers}):
                reason = f"{UNKNOWN}; drive it past its limits by hand"
                yield Proof(f"limits of {name}", "", "nothing", "not shown", reason)

    def _mover(self, name: str) -> Mover | None:
        """How a mover creeps, or None where that is not known."""
        limits, own = self._limits, self._limits.movers.get(name)
        bounds, where = (limits, "limits") if own is None else (own, f"limits.movers.{name}")
        settings = self._settings[name]
        fast_m_s = CREEP_M_S if self.session.rig.kind == "hardware" else bounds.speed_m_s
        details: Mapping[str, Any] = self.session.infos[name].details
        if isinstance(open_m := details.get("open_width_m"), float):
            jaws_m_s = max(min(JAWS_M_S, bounds.speed_m_s), details.get("least_speed_m_s", 0.0))
            gentle_n = max(GENTLE_N, details.get("least_force_n", 0.0))
            room_m = max(ROOM_M, 3.0 * RUN_S * jaws_m_s)
            drive = Grip(name, open_m - room_m, jaws_m_s, min(gentle_n, limits.grip_n))
            start = Release(name, max(fast_m_s, jaws_m_s))
            return Mover(
                name,
                f"{name}.width",
                Home(name),
                start,
                drive,
                jaws_m_s,
                STILL_JAWS_M,
                bounds,
                where,
                settings,
            )
        if not isinstance(settings, AxisLimits):
            return None
        creep_m_s = min(CREEP_M_S, bounds.speed_m_s)
        # Away from the object, where there is room.
        back = max(bounds.travel_min_m, settings.travel_min_m) <= -ROOM_M
        farthest_m = -ROOM_M if back else min(ROOM_M, bounds.travel_m, settings.travel_max_m)
        begin = MoveTo(name, 0.0, min(fast_m_s, bounds.speed_m_s))
        moved = MoveAt(name, math.copysign(creep_m_s, farthest_m), farthest_m)
        shown = bounds.position_stream if self._of(bounds.position_stream, name) else f"{name}.position"
        assert shown is not None
        return Mover(name, shown, begin, begin, moved, creep_m_s, STILL_M, bounds, where, settings)

    @staticmethod
    def _of(stream: str | None, device: str) -> bool:
        return stream is not None and stream.partition(".")[0] == device

    # --- which cases ---------------------------------------------------------------------------------

    def _cases(self, movers: Sequence[Mover]) -> Iterator[Case]:
        yield from self._streams(movers)
        for mover in movers:
            late_s = self._limits.late_s
            # after which the mover's process stops it
            own_s = getattr(mover.settings, "loop_timeout_s", math.inf)
            beyond_s = min(BEYOND * late_s, (late_s + own_s) / 2.0) if own_s > late_s else BEYOND * late_s
            away_s = beyond_s + 2.0 / self.session.loop.rate_hz
            yield self._case([mover], "late_s", f"{late_s:g} s", self._away(mover.name, away_s, own_s=away_s))
        yield from self._forces(movers)
        for mover in movers:
            yield from self._travel(mover)
        for mover in movers:
            yield from self._asked(mover)
        for name, settings in self._settings.items():
            own = next((mover for mover in movers if mover.name == name), None)
            yield from self._of_device(name, settings, own)
        for mover in movers:
            yield from self._alone(mover)
        yield from self._watchdogs(movers)
        for mover in movers:
            yield from self._ended(mover)

    def _stops(self, mover: Mover) -> Iterator[Case]:
        """A person's stop and pause, after the way home."""
        name = mover.name
        yield Proof(f"home of {name}", "", "sent home, at its own speed"), partial(self._homed, mover)
        for what, wrong in (
            ("stop", Wrong("commanded to stop", command=Stop(name))),
            ("pause", Wrong("paused by the operator", pauses=True)),
        ):
            planned = Proof(f"{what} of {name}", "", f"{mover.doing}: {wrong.what}")
            yield planned, partial(self._moving, mover, wrong)

    def _streams(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """Streams that fall silent, or stick."""
        limits, infos = self._limits, self.session.streams
        regular = sorted(name for name, info in infos.items() if info.longest_s is not None)
        for stream in self._guarded or regular[:1]:
            known = infos.get(stream)  # of one that no device sends, its case says so
            resting_s = max(REST * limits.stale_s, 2.0 * ((known and known.longest_s) or 0.0))
            own_s = limits.stale_s if movers else resting_s
            wrong = Wrong(f"{stream} withheld", stream, withheld, own_s=own_s)
            yield self._case(movers, "stale_s", f"{limits.stale_s:g} s", wrong)
        noisy = [name for name in [*self._guarded, *regular] if name in infos and infos[name].noisy]
        if limits.stuck_s is not None and noisy:
            own_s = stuck_after_s(infos[noisy[0]], limits.stuck_s)
            wrong = Wrong(f"{noisy[0]} repeats a value", noisy[0], held, own_s=own_s)
            yield self._case(movers, "stuck_s", f"{limits.stuck_s:g} s", wrong)
        else:
            reason = "no stream of this bench has a noise that would tell"
            yield _nothing("limits.stuck_s", f"{limits.stuck_s or 'none'}", reason)

    def _forces(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """Force, and sensors that leave their range."""
        limits, value = self._limits, f"{self._limits.force_n:g} N" if self._limits.force_n else "none"
        if limits.force_n is None or limits.force_stream is None or not movers:
            still = UNKNOWN if self.session.movers else "nothing moves on this bench"
            reason = "this bench has no stream of forces" if movers else still
            yield _nothing("limits.force_n", f"{limits.force_n or 'none'}", reason)
        else:
            for force_n in (BEYOND * limits.force_n, -BEYOND * limits.force_n):
                change = reading(force_n, limits.force_channels[0])
                what, own_s = f"{limits.force_stream} reads {force_n:g} N", limits.force_median_s
                wrong = Wrong(what, limits.force_stream, change, own_s=own_s)
                yield self._case(movers, "force_n", value, wrong)
            mover = movers[0]
            if limits.force_n <= PRESS_N and isinstance(mover.drive, MoveAt):
                end_m = min(mover.limits.travel_m, mover.settings.travel_max_m)
                drive = MoveAt(mover.name, mover.speed_m_s, end_m)
                done = f"{mover.doing}: presses on, at most to {1e3 * end_m:g} mm"
                pressed = partial(self._pressed, mover._replace(drive=drive))
                yield Proof("limits.force_n", value, done), pressed
        yield from self._retreats([mover for mover in movers if isinstance(mover.drive, MoveAt)])
        for stream in limits.range_streams:
            wrong = Wrong(f"{stream} leaves its range", stream, beyond=1e9, said="beyond its range")
            yield self._case(movers, "range_streams", stream, wrong)

    def _retreats(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """A force for which a stop is not enough, on the way in; and sensors that disagree."""
        limits = self._limits
        if limits.retreat_n is None or limits.force_stream is None or not movers:
            yield _nothing(
                "limits.retreat_n", f"{limits.retreat_n or 'none'}", "it is not set, or nothing moves"
            )
        else:
            mover = movers[0]
            end_m = min(ROOM_M, mover.limits.travel_m, mover.settings.travel_max_m)
            mover = mover._replace(drive=MoveAt(mover.name, mover.speed_m_s, end_m))
            force_n = BEYOND * limits.retreat_n
            change = reading(force_n, limits.force_channels[0])
            what = f"{limits.force_stream} reads {force_n:g} N"
            wrong = Wrong(what, limits.force_stream, change)
            done = f"{mover.doing}, farther in: {what}"
            planned = Proof("limits.retreat_n", f"{limits.retreat_n:g} N", done)
            yield planned, partial(self._retreated, mover, wrong)
        for name, agreement in limits.agree.items():
            side = 0 if agreement.streams[1] == limits.force_stream else 1
            stream, value = agreement.streams[side], 2.0 * BEYOND * agreement.most
            value /= abs(agreement.factor) if side else 1.0
            change, key = reading(value, agreement.channels[side]), f"agree.{name}"
            wrong = Wrong(f"{stream} reads {value:g}", stream, change, own_s=agreement.for_s)
            yield self._case(movers, key, f"{agreement.most:g}", wrong)

    def _travel(self, mover: Mover) -> Iterator[Case]:
        """Places that a mover must not be at."""
        limits, where = mover.limits, mover.where
        places = []
        if self._of(limits.position_stream, mover.name):
            ends = (("travel_m", limits.travel_m, 1e-3), ("travel_min_m", limits.travel_min_m, -1e-3))
            places += [(*end, limits.position_stream, 0, "travel_min_m") for end in ends]
        if self._of(limits.pose_stream, mover.name):
            places += [
                (key, place_m, by_m, limits.pose_stream, channel, "workspace")
                for key, by_m in (("workspace_max_m", 1e-3), ("workspace_min_m", -1e-3))
                for channel, place_m in enumerate(getattr(limits, key))
            ]
        for key, place_m, by_m, stream, channel, said in places:
            axis = f" {'xyz'[channel]} =" if said == "workspace" else ""
            what, change = f"{stream} reads{axis} {place_m + by_m:g} m", reading(place_m + by_m, channel)
            wrong = Wrong(what, stream or "", change, said=f"{where}.{said}")
            yield self._case([mover], key, f"{place_m:g} m", wrong, where)
        follow_m = limits.follow_m
        if follow_m is not None and isinstance(mover.drive, MoveAt) and places:
            what, stream = f"{limits.position_stream} repeats a value", limits.position_stream or ""
            own_s = FOLLOW_S + follow_m / mover.speed_m_s
            wrong = Wrong(what, stream, held, said=f"{where}.follow_m", own_s=own_s)
            yield self._case([mover], "follow_m", f"{follow_m:g} m", wrong, where)
        else:
            reason = "no measured position is compared with the commanded one"
            yield _nothing(f"{where}.follow_m", f"{follow_m or 'none'}", reason)

    def _asked(self, mover: Mover) -> Iterator[Case]:
        """Commands that the guard must refuse."""
        limits, name, where = mover.limits, mover.name, mover.where
        fast_m_s = BEYOND * limits.speed_m_s
        rows: list[tuple[str, float, str, Command]] = []
        if isinstance(mover.drive, Grip):
            grip_n = self._limits.grip_n
            hard = replace(mover.drive, force_n=BEYOND * grip_n)
            rows += [
                ("limits.grip_n", grip_n, "N", hard),
                (f"{where}.speed_m_s", limits.speed_m_s, "m/s", Release(name, fast_m_s)),
            ]
        else:
            assert isinstance(mover.drive, MoveAt)
            quick_m_s = math.copysign(fast_m_s, mover.drive.velocity_m_s)
            quick = replace(mover.drive, limit_m=mover.drive.limit_m / 5.0, velocity_m_s=quick_m_s)
            beyond = MoveTo(name, limits.travel_m + 1e-3, mover.speed_m_s)
            before = MoveTo(name, limits.travel_min_m - 1e-3, mover.speed_m_s)
            turning = Twist(name, (0.0, 0.0, 0.0, 0.0, 0.0, BEYOND * limits.turn_rad_s), 0.1)
            way_s = (BEYOND * limits.reach_m + 1e-3) / mover.speed_m_s
            leading = Twist(name, (mover.speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0), way_s)
            slow_rad_s = min(0.01, limits.turn_rad_s)
            turned_s = (BEYOND * limits.reach_rad + 1e-3) / slow_rad_s if limits.reach_m else 0.0
            turned = Twist(name, (0.0, 0.0, 0.0, 0.0, 0.0, slow_rad_s), turned_s)
            rows += [
                (f"{where}.speed_m_s", limits.speed_m_s, "m/s", quick),
                (f"{where}.travel_m", limits.travel_m, "m", beyond),
                (f"{where}.travel_min_m", limits.travel_min_m, "m", before),
                (f"{where}.turn_rad_s", limits.turn_rad_s, "rad/s", turning),
                (f"{where}.reach_m", limits.reach_m, "m", leading),
            ]
            peak_n, turn_s = self._limits.peak_n, 1.0 / self.session.loop.rate_hz
            if peak_n is None or not refusal(self._limits, limits.speed_m_s, turn_s):
                reason = "it is not set, or no speed that is admitted would press so hard"
                yield _nothing("limits.peak_n", f"{peak_n or 'none'}", reason)
            else:
                fast = MoveAt(name, limits.speed_m_s, min(1e-3, limits.travel_m))
                rows.append(("limits.peak_n", peak_n, "N", fast))
            if limits.reach_m:
                rows.append((f"{where}.reach_rad", limits.reach_rad, "rad", turned))
        for limit, value, unit, command in rows:
            # the guard names both ends of the travel, the lower one in full
            said = f"{where}.travel_min_m" if limit == f"{where}.travel_m" else limit
            planned = Proof(limit, f"{value:g} {unit}", f"{_short(command)} asked for")
            yield planned, partial(self._refused, mover, command, said)

    def _of_device(self, name: str, settings: Settings, mover: Mover | None) -> Iterator[Case]:
        """What a driver must refuse, or clamp."""
        for key in type(settings).model_fields:
            value = getattr(settings, key)
            command = asked_of_driver(key, value, name, mover)
            if command is not None:
                done = f"a {type(command).__name__} beyond it given to the driver"
                tried = partial(self._given, name, key, value, mover)
                yield Proof(f"devices.{name}.{key}", f"{value:g}", done), tried

    def _alone(self, mover: Mover) -> Iterator[Case]:
        """The program is away for so long that the device must end the motion."""
        if not isinstance(mover.drive, MoveAt):
            return
        speed_m_s, room_m = mover.speed_m_s, abs(mover.drive.limit_m) - RUN_S * mover.speed_m_s
        blind_m, timeout_s = mover.limits.blind_travel_m, getattr(mover.settings, "loop_timeout_s", None)
        bounds = [(f"{mover.where}.blind_travel_m", f"{blind_m:g} m", blind_m)]
        if timeout_s is not None:
            timeout_m = speed_m_s * (timeout_s + SLACK_S)
            bounds.append((f"devices.{mover.name}.loop_timeout_s", f"{timeout_s:g} s", timeout_m))
        for limit, value, most_m in bounds:
            if most_m + 2.0 * SLACK_M > room_m:
                reason = f"left alone it might go {1e3 * most_m:g} mm; {1e3 * room_m:.3g} mm are free here"
                yield _nothing(limit, value, reason, "not shown")
            else:
                wrong = self._away(mover.name, most_m / speed_m_s + 1.0, digits=1)
                planned = Proof(limit, value, f"{mover.doing}: {wrong.what}")
                yield planned, partial(self._left, mover, wrong, most_m)

    def _ended(self, mover: Mover) -> Iterator[Case]:
        """A program that is killed in the middle of a motion, or frozen with all that it has started."""
        if self.abandoned is None or not isinstance(mover.drive, MoveAt):
            return
        name, blind_m = mover.name, mover.limits.blind_travel_m
        if blind_m < abs(mover.drive.limit_m) - 2.0 * RUN_S * mover.speed_m_s:
            done = f"{mover.doing}: its program is killed"
            planned = Proof(f"{mover.where}.blind_travel_m", f"{blind_m:g} m", done)
            yield planned, partial(self._abandoned, mover, False, blind_m)
        watchdog_hz = getattr(mover.settings, "watchdog_hz", None)
        if watchdog_hz is not None:
            done = f"{mover.doing}: its program and its process are frozen"
            planned = Proof(f"devices.{name}.watchdog_hz", f"{watchdog_hz:g} Hz", done)
            most_m = mover.speed_m_s * (1.0 / watchdog_hz + SLACK_S)
            yield planned, partial(self._abandoned, mover, True, most_m)

    def _watchdogs(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """A program that is away for so long that a device's own watchdog must act."""
        for name, settings in self._settings.items():
            watchdog_s = getattr(settings, "watchdog_s", None)
            if watchdog_s is None:
                continue
            own = [mover for mover in movers if mover.name == name]
            sent = [each for each in (*self._guarded, *sorted(self.session.streams)) if self._of(each, name)]
            wrong = self._away(name, watchdog_s + 1.0, stream=sent[0], digits=1)
            planned = Proof(f"devices.{name}.watchdog_s", f"{watchdog_s:g} s", wrong.what)
            yield planned, partial(self._guarded_by, name, own or movers[:1], wrong, watchdog_s)

    @staticmethod
    def _away(device: str, away_s: float, stream: str = "", own_s: float = 0.0, digits: int = 3) -> Wrong:
        what = f"the program is away for {away_s:.{digits}f} s"
        return Wrong(what, stream, away_s=away_s, away_from=device, own_s=own_s)

    def _case(
        self, movers: Sequence[Mover], key: str, value: str, wrong: Wrong, where: str = "limits"
    ) -> Case:
        """Something that goes wrong while the first mover moves, or at rest where there is none."""
        wrong.said = wrong.said or f"limits.{key}"
        doing, tried = "at rest", partial(self._resting, wrong)
        if movers:
            doing, tried = movers[0].doing, partial(self._moving, movers[0], wrong)
        return Proof(f"{where}.{key}", value, f"{doing}: {wrong.what}"), tried

    # --- trying them ---------------------------------------------------------------------------------

    def _run(
        self, script: Script, wrong: Wrong, mover: str = "", shown: str = "", deadline_s: float = math.inf
    ) -> HandResult:
        """Run a script in the loop while something goes wrong; `shown` is kept of the devices' streams."""
        if self._left_alone:  # a driver whose device switched off has failed
            for device in self._seams.values():
                device.close()
                device.open()
        self._left_alone, self._wrong = wrong.away_s > AWAY_S, wrong
        for seam in self._seams.values():
            seam.restart(wrong, shown)
        streams = {shown, wrong.stream} - {""}
        result = self.session.run(scripted(script), mover, streams, deadline_s=deadline_s)
        failed = [each for each in result.events if isinstance(each, Failed) and not wrong.begun]
        self._gone = f"{failed[0].device} failed ({failed[0].reason})" if failed else ""
        self._go_on(result.reason)
        if result.outcome == "interrupted" and not wrong.pauses:
            raise KeyboardInterrupt
        return result

    def _go_on(self, reason: str = "") -> None:
        if self._stopped():
            raise KeyboardInterrupt("; ".join(filter(None, ("interrupted", reason))))

    def _agree(self, text: str) -> None:
        """Wait until the person agrees; meanwhile the devices are attended to, for their watchdogs wait for nobody."""
        answered, clock = self._consent(text), self.session.rig.clock
        while answered is not None and not answered():
            self._go_on()
            for seam in self._seams.values():
                seam.real.read()
                seam.real.poll()
            clock.rest(ATTEND_S)

    def _homed(self, mover: Mover, proof: Proof) -> Proof:
        self._agree(f"{mover.name} goes home, at its own speed")
        result = self._run(until(Home(mover.name), Reached), Wrong(), mover.name, deadline_s=GIVE_UP_S)
        still, sound = self._at_rest(result, mover), result.outcome == "done"
        return proof.judged(sound, still, "it is home, and stands still" if sound else result.reason)

    def _refused(self, mover: Mover, command: Command, said: str, proof: Proof) -> Proof:
        self._agree(f"{mover.name} must refuse {_short(command)}: nothing should move")
        result = self._run(until(command, Reached, Gripped), Wrong(), mover.name, deadline_s=PATIENCE_S)
        still = self._at_rest(result, mover)
        let_through = any(isinstance(each, GuardStopped | Reached | Gripped) for each in result.events)
        if said not in result.reason or let_through:
            reason = result.reason or "it was carried out"
            return proof.judged(False, still, f"the guard did not refuse it: {reason}")
        failures = [each.reason for each in result.events if isinstance(each, Failed)]
        return proof.judged(not failures, still, "; ".join(["guard refused", *failures]))

    def _moving(self, mover: Mover, wrong: Wrong, proof: Proof) -> Proof:
        """Let something go wrong while a mover creeps: what must act says so; else it is the mover's own standstill."""
        result, still, way_m = self._crept(mover, wrong, wrong.own_s + PATIENCE_S)
        if not wrong.begun:
            return proof.judged(False, still, f"it did not come that far: {result.reason}")
        after = [event for event in result.events if event.t_s >= wrong.past_s]
        rests = [each.t_s for each in after if isinstance(each, Standstill) and each.device == mover.name]
        ends = [each for each in after if isinstance(each, GuardStopped | Failed | Stalled)]
        acting = [each for each in ends if wrong.said in each.reason] if wrong.said else []
        first_s = min([each.t_s for each in acting] if wrong.said else rests, default=math.inf)
        after_s = max(rests) - wrong.past_s if rests else None
        if first_s == math.inf:
            reason = "; ".join(dict.fromkeys(each.reason for each in ends)) or "nothing acted"
            late = f"{reason} within {wrong.own_s + PATIENCE_S:g} s"
            return proof.judged(False, still, late, after_s, way_m)
        within_s = wrong.own_s + SLACK_S
        quick = first_s - wrong.past_s <= within_s and way_m <= mover.speed_m_s * within_s + SLACK_M
        told = f"guard: {acting[0].reason}" if wrong.said else "device: it stands still"
        return proof.judged(quick, still, told if quick else f"{told}; too late, or too far", after_s, way_m)

    def _pressed(self, mover: Mover, proof: Proof) -> Proof:
        """Press on until the force limit acts."""
        assert isinstance(mover.drive, MoveAt)
        wrong = Wrong("presses until the force limit acts")
        patience_s = mover.drive.limit_m / mover.speed_m_s + PATIENCE_S
        result, still, _ = self._crept(mover, wrong, patience_s, Mover.pressing)
        stops = [each for each in result.events if isinstance(each, GuardStopped)]
        if not stops and still:
            return proof.found("not shown", "nothing presses so hard within the travel: put something there")
        if not stops or "limits.force_n" not in stops[0].reason:
            return proof.judged(False, still, stops[0].reason if stops else "nothing stopped it")
        stopped_s, seam = stops[0].t_s, self._seams[mover.name]
        rests = [each.t_s - stopped_s for each in result.events if isinstance(each, Standstill)]
        after_s = min((rest_s for rest_s in rests if rest_s >= 0.0), default=math.inf)
        at_m = seam.place_m(stopped_s)
        way_m = max([x_m - at_m for t_s, x_m in seam.seen if t_s >= stopped_s], default=0.0)
        quick = after_s <= SLACK_S and way_m <= mover.speed_m_s * SLACK_S + SLACK_M
        return proof.judged(quick, still, f"guard: {stops[0].reason}", after_s, way_m)

    def _retreated(self, mover: Mover, wrong: Wrong, proof: Proof) -> Proof:
        """Let a force appear for which a stop is not enough: the guard says so, and the mover goes back."""
        result, still, _ = self._crept(mover, wrong, PATIENCE_S)
        stops = [each for each in result.events if isinstance(each, GuardStopped)]
        went = any(isinstance(each, Retreated) for each in result.events)
        if not (wrong.begun and stops and went):
            reason = stops[0].reason if stops else result.reason or "nothing stopped it"
            return proof.judged(False, still, f"{reason}; it was not sent back")
        at_m = self._seams[mover.name].place_m(wrong.past_s)
        back_m, room_m = at_m - self._end_m, max(at_m, 0.0)
        sound = back_m >= min(self._limits.retreat_m, room_m) - SLACK_M
        reason = stops[0].reason
        text = f"guard: {reason}; it went back" if sound else f"{reason}; it did not go back"
        return proof.judged(sound, still, text, None, back_m)

    def _left(self, mover: Mover, wrong: Wrong, most_m: float, proof: Proof) -> Proof:
        """Leave a mover alone: it must end its motion by itself within a distance."""
        result, still, way_m = self._crept(mover, wrong, PATIENCE_S)
        if not wrong.begun:
            return proof.judged(False, still, f"it did not come that far: {result.reason}")
        return self._alone_for(still, way_m, most_m, proof)

    @staticmethod
    def _alone_for(still: bool, way_m: float, most_m: float, proof: Proof) -> Proof:
        sound = way_m <= most_m + SLACK_M
        on = f"it went on, left alone, for {1e3 * way_m:.2f} mm"
        text = "device: it stopped by itself" if sound else on
        return proof.judged(sound, still, text, None, way_m)

    def _abandoned(self, mover: Mover, frozen: bool, most_m: float, proof: Proof) -> Proof:
        """Have the program of a mover end: the device must end the motion by itself within a distance."""
        assert self.abandoned is not None
        self._agree(f"{mover.name} moves, and its program is {'frozen' if frozen else 'killed'}")
        for device in self._seams.values():
            device.close()
        try:
            with self.abandoned(mover, frozen) as place_m:
                self.session.rig.clock.rest(most_m / mover.speed_m_s + 1.0)
        except (EOFError, TimeoutError) as error:
            return proof.found("not shown", str(error) or "the program that was to be ended ended by itself")
        finally:
            for device in self._seams.values():
                device.open()
        still = self._stands(mover)
        return self._alone_for(still, abs(self._end_m - place_m), most_m, proof)

    def _guarded_by(
        self, name: str, movers: Sequence[Mover], wrong: Wrong, watchdog_s: float, proof: Proof
    ) -> Proof:
        """Leave a device alone: it must say that its watchdog tripped, or have stopped to send in time."""
        if movers:
            result, still, _ = self._crept(movers[0], wrong, PATIENCE_S)
        else:
            result, still = self._run(listening(wrong, PATIENCE_S), wrong), True
        if not wrong.begun:
            return proof.judged(False, still, f"it did not come that far: {result.reason}")
        told = [each for each in result.events if getattr(each, "device", "") == name]
        if movers and movers[0].name == name:
            said = [reason for each in told if "watchdog" in (reason := getattr(each, "reason", ""))]
            found = f"device: {said[0]}" if said else ""
        else:
            sent_s = self._seams[name].last_s - wrong.past_s
            if sent_s < -SLACK_S:
                return proof.found("not shown", "it sent nothing before it was left alone")
            found = f"device: it sent for {sent_s:.2f} s more" if sent_s <= watchdog_s + SLACK_S else ""
        return proof.judged(bool(found), still, found or "it went on, left alone")

    def _crept(
        self,
        mover: Mover,
        wrong: Wrong,
        patience_s: float,
        how: Callable[[Mover, Wrong, float], Script] = Mover.creeping,
    ) -> tuple[HandResult, bool, float]:
        """Creep; whether the mover stands still then, and how far it went since something was wrong."""
        way_mm, speed_mm_s = 1e3 * getattr(mover.drive, "limit_m", ROOM_M), 1e3 * mover.speed_m_s
        self._agree(f"{mover.name} moves {way_mm:g} mm at {speed_mm_s:g} mm/s; then: {wrong.what}")
        longest_s = 2.0 * GIVE_UP_S + patience_s
        result = self._run(how(mover, wrong, patience_s), wrong, mover.name, mover.shown, longest_s)
        last_m = self._seams[mover.name].place_m(wrong.past_s)
        still = self._at_rest(result, mover)
        return result, still, abs(self._end_m - last_m)

    def _resting(self, wrong: Wrong, proof: Proof) -> Proof:
        """Where nothing moves: a trial must end where what it listens to goes wrong."""
        result = self._run(listening(wrong, wrong.own_s + PATIENCE_S), wrong)
        if wrong.said in result.reason:
            ended_s = next(each.t_s for each in result.events if isinstance(each, GuardStopped | Failed))
            return proof.found("acted", f"the trial ended: {result.reason}", ended_s - wrong.past_s)
        went_on = f"the trial went on for {wrong.own_s + PATIENCE_S:g} s"
        return proof.found("failed", result.reason or went_on)

    def _given(self, name: str, key: str, value: float, mover: Mover | None, proof: Proof) -> Proof:
        """Give a driver what it must refuse or clamp, past the guard, where the mover already is."""
        here_m = 0.0
        if mover is not None:
            self._agree(f"{name} must refuse more than its {key}, or clamp it: nothing should move")
            self._run(until(mover.ready, Reached), Wrong(), mover.name, deadline_s=GIVE_UP_S)
            self._stands(mover)
            here_m = self._end_m
        command = asked_of_driver(key, value, name, mover, here_m)
        assert command is not None
        try:
            sent = self._seams[name].apply(command)
            speed = getattr(sent, "speed_m_s", math.inf)
            sound = speed <= value * (1.0 + 1e-9)
            text = f"driver made it {speed:.3g}" if sound else "the driver took it"
        except CommandError as error:
            sound, text = True, f"driver refused: {error.reason}"
        return proof.judged(sound, mover is None or self._stands(mover), text)

    # --- standing still ------------------------------------------------------------------------------

    def _at_rest(self, result: HandResult, mover: Mover) -> bool:
        return self._stands(mover) and mover.name not in result.not_at_rest

    def _stands(self, mover: Mover) -> bool:
        """Whether a mover stands still: by its own stream, and on a simulated bench in truth. Where is `_end_m`."""
        name, shown = mover.name, mover.shown
        rig, device = self.session.rig, self._seams[name].real
        before = rig.place()
        device.apply(Listen(name, frozenset({shown})))
        places_m: list[float] = []
        end_s = rig.clock.now() + REST_S
        while rig.clock.now() < end_s:
            rig.clock.wait_until(rig.clock.now() + 0.01)
            for block in device.read():
                places_m += block.physical[:, 0].tolist() if block.stream == shown else []
            device.poll()
        device.apply(Listen(name, frozenset()))
        after = rig.place()
        self._end_m = places_m[-1] if places_m else math.nan
        moved_m = max(places_m) - min(places_m) if places_m else math.inf
        truly_m = max((abs(after[each] - before[each]) for each in before.keys() & after.keys()), default=0.0)
        return max(moved_m, truly_m) <= mover.still_m


def asked_of_driver(
    key: str, value: Any, name: str, mover: Mover | None, here_m: float = 0.0
) -> Command | None:
    """What is beyond a driver's own bound, so that nothing moves even where it is taken; None where `key` is none."""
    if key in ("tendon_min_m", "tendon_max_m"):
        return SetTendon(name, value + (1e-3 if key == "tendon_max_m" else -1e-3))
    if mover is None or not isinstance(value, float):
        return None
    if isinstance(mover.drive, Grip):
        here = replace(mover.drive, width_m=here_m)
        asked: dict[str, Command] = {
            "max_force_n": replace(here, force_n=BEYOND * value),
            "max_speed_m_s": replace(here, speed_m_s=BEYOND * value),
        }
    else:
        fastest = max(value, mover.settings.max_speed_m_s)
        asked = {
            "travel_max_m": MoveAt(name, mover.speed_m_s, value + 1e-3),
            "travel_min_m": MoveAt(name, -mover.speed_m_s, value - 1e-3),
            "max_speed_m_s": MoveTo(name, here_m, BEYOND * value),
            "leash_m": MovePose(name, (BEYOND * value, 0.0, 0.0, 0.0, 0.0, 0.0), mover.speed_m_s),
            "max_turn_rad_s": MovePose(name, (0.0, 0.0, 0.0, 0.0, 0.0, 1e-6), BEYOND * fastest),
        }
    return asked.get(key)


def _nothing(limit: str, value: str, reason: str, verdict: Verdict = "nothing to bound") -> Case:
    return Proof(limit, value, "nothing"), lambda proof: proof.found(verdict, reason)


def _short(command: Command) -> str:
    """A command in a table: its name and numbers."""
    names = [each.name for each in fields(command) if each.name not in ("device", "id", "blind_travel_m")]
    values = [(name, getattr(command, name)) for name in names]
    shown = [
        f"{name} {value:.6g}" if isinstance(value, float) else f"{name} {value}" for name, value in values
    ]
    return f"{type(command).__name__} {', '.join(shown)}"
