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
from typing import Any, ClassVar, Literal, NamedTuple

import numpy as np

from behaviors.events import GuardStopped
from behaviors.machine import Behavior, Row, StatePlan, from_mover, on
from controller.arrivals import REST
from controller.guard import Guard, GuardRefusal
from controller.limits import MoverLimits
from controller.loop import Aborted, Loop, LoopSettings
from controller.rig import Rig, TrialScene
from controller.signals.protocol import Signal
from drivers.core.axis import AxisLimits
from drivers.core.errors import CommandError
from drivers.core.messages import (
    Command,
    DeviceInfo,
    Failed,
    Grip,
    Home,
    Listen,
    MoveAt,
    MovePose,
    MoveTo,
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

Verdict = Literal["acted", "failed", "not shown", "nothing to bound", "not tried"]


class Proof(NamedTuple):
    """What became of one limit.

    Attributes:
        limit: As it stands in a profile, `limits.force_n`; or what a person does, `stop of stage`.
        value: Its value, with its unit; "" where there is none.
        done: What was done.
        verdict: Whether it acted.
        acted: What acted, and what it said; or why nothing did, or nothing was tried.
        after_s: From then to standstill; None where nothing moved.
        way_m: How far the mover went meanwhile, likewise.
    """

    limit: str
    value: str
    done: str
    verdict: Verdict
    acted: str
    after_s: float | None = None
    way_m: float | None = None


class Tried(NamedTuple):
    """What became of a case; see `Proof`."""

    verdict: Verdict
    acted: str
    after_s: float | None = None
    way_m: float | None = None


def judged(
    sound: bool, still: bool, text: str, after_s: float | None = None, way_m: float | None = None
) -> Tried:
    """A limit acted where what was seen is sound, and the mover then stands still."""
    rest = "" if still else f"; {NOT_AT_REST}"
    return Tried("acted" if sound and still else "failed", text + rest, after_s, way_m)


class Case(NamedTuple):
    """One limit that is to be driven past; see `Proof`. Where one that is `first` fails, nothing else is tried."""

    limit: str
    value: str
    done: str
    tried: Callable[[], Tried]
    first: bool = False


# --- what goes wrong ---------------------------------------------------------------------------------

Change = Callable[[SampleBlock, Any], SampleBlock | None]
"""What the loop gets in place of a block, given the last value before; None withholds it."""


@dataclass
class Wrong:
    """What goes wrong between drivers and loop, once it has begun.

    Attributes:
        stream: Whose samples.
        change: What becomes of a block of them.
        beyond: What is reported to be beyond the stream's range, once.
        away_s: How long the program is away, once.
        away_from: Before which device is read.
        begun: Whether it has begun.
    """

    stream: str = ""
    change: Change | None = None
    beyond: float | None = None
    away_s: float = 0.0
    away_from: str = ""
    begun: bool = False
    _last: Any = None

    @property
    def said(self) -> str:
        """For a person."""
        if self.away_s:
            return f"the program is away for {self.away_s:.2f} s"
        return f"{self.stream} goes wrong" if self.stream else "must stop"

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
    """A device as the loop sees it; what it really sends of one stream is kept.

    Args:
        device: The real one.
        clock: Of the bench.
        wrong: What goes wrong.
        shown: The stream that is kept.

    Attributes:
        seen: Time and value of its samples' first channel.
        last_s: Time of the device's latest sample.
    """

    def __init__(self, device: Device, clock: Any, wrong: Wrong, shown: str) -> None:
        self.name = device.name
        self.seen: list[tuple[float, float]] = []
        self.last_s = -math.inf
        self._device, self._clock, self._wrong, self._shown = device, clock, wrong, shown
        self.open, self.close, self.account = device.open, device.close, device.account
        self.apply = device.apply

    def read(self) -> Sequence[SampleBlock]:
        """What the loop gets of what has arrived."""
        wrong = self._wrong
        if wrong.begun and wrong.away_s and self.name == wrong.away_from:
            away_s, wrong.away_s = wrong.away_s, 0.0
            self._clock.rest(away_s)
        blocks: list[SampleBlock] = []
        for block in self._device.read():
            self.last_s = max(self.last_s, block.last_s if len(block) else -math.inf)
            if block.stream == self._shown:
                self.seen += zip(block.times.tolist(), block.physical[:, 0].tolist(), strict=True)
            blocks += wrong.passed_on(block)
        return blocks

    def poll(self) -> Sequence[Status]:
        """Likewise of the statuses."""
        own = self._wrong.stream.partition(".")[0] == self.name
        return [*self._device.poll(), *(self._wrong.reported(self._clock.now(), self.name) if own else ())]


class SignalSeam:
    """A signal as the loop sees it."""

    def __init__(self, signal: Signal, wrong: Wrong) -> None:
        self.name, self.info, self.inputs = signal.name, signal.info, signal.inputs
        self.reset = signal.reset
        self._signal, self._wrong = signal, wrong

    def push(self, block: SampleBlock) -> Sequence[SampleBlock | Saturated]:
        """What the loop gets of what the signal makes."""
        made: list[SampleBlock | Saturated] = []
        for each in self._signal.push(block):
            made += self._wrong.passed_on(each) if isinstance(each, SampleBlock) else (each,)
        if self._wrong.stream == self.info.name and len(block):
            made += self._wrong.reported(block.last_s, self.name)
        return made


# --- what is done ------------------------------------------------------------------------------------


class Creep(Behavior):
    """Move slowly; let something go wrong, or command something; wait for what stops the mover.

    Args:
        mover: Who moves, and how.
        wrong: What goes wrong.
        command: What is commanded then.
        patience_s: How long it is waited for.
        range_streams: See `Behavior`.

    Attributes:
        past_s: When it began.
    """

    table: ClassVar[Sequence[Row]] = (
        on("reached", "READYING", "STARTING", from_mover),
        on("reached", "STARTING", "MOVING", from_mover),
        on("deadline", "MOVING", "PAST"),
        on("reached", ["MOVING", "PAST"], "OVER", from_mover),
        on("gripped", ["MOVING", "PAST"], "OVER", from_mover),
        on("standstill", "PAST", "OVER", from_mover),
        on("deadline", "PAST", "OVER"),
    )

    def __init__(
        self,
        mover: Mover,
        wrong: Wrong,
        command: Command | None,
        patience_s: float,
        range_streams: frozenset[str],
    ) -> None:
        self.past_s = math.nan
        self.range_streams = range_streams
        self._creeping, self._wrong, self._late = mover, wrong, command
        shown = frozenset({mover.shown, wrong.stream} - {""})
        deadlines_s = {"READYING": GIVE_UP_S, "STARTING": GIVE_UP_S, "MOVING": RUN_S, "PAST": patience_s}
        deadlines_s |= {"STOPPING": PATIENCE_S, "BACK": GIVE_UP_S}
        states = [state for state in self.states if state not in self.final]
        plans = {state: StatePlan(deadlines_s[state], measures=shown) for state in states}
        super().__init__(plans, mover=mover.name)

    def enter_READYING(self) -> None:
        """Know where it is."""
        self.command(self._creeping.ready)

    def enter_STARTING(self) -> None:
        """Go where it begins."""
        self.command(self._creeping.start)

    def enter_MOVING(self) -> None:
        """Creep."""
        self.command(self._creeping.drive)

    def enter_PAST(self) -> None:
        """From here on something is wrong."""
        self.past_s, self._wrong.begun = self.event.t_s, True
        if self._late is not None:
            self.command(self._late)


class Press(Creep):
    """Press until the guard stops it, stand still, go back."""

    table = (
        *Creep.table,
        on("guard_stopped", ["MOVING", "PAST"], "STOPPING"),
        on("standstill", "STOPPING", "BACK", from_mover),
        on("reached", "BACK", "OVER", from_mover),
    )

    enter_BACK = Creep.enter_STARTING


class Once(Behavior):
    """Command one thing, and wait until it is done."""

    table = (on(("reached"), "DOING", "OVER", from_mover), on("gripped", "DOING", "OVER", from_mover))

    def __init__(self, command: Command, patience_s: float = GIVE_UP_S) -> None:
        self._once = command
        super().__init__({"DOING": StatePlan(patience_s)}, mover=command.device)

    def enter_DOING(self) -> None:
        """Command it."""
        self.command(self._once)


class Resting(Behavior):
    """Where nothing can move: listen to a stream, which goes wrong."""

    table = (on("deadline", "LISTENING", "PAST"), on("deadline", "PAST", "OVER"))

    def __init__(self, wrong: Wrong, patience_s: float) -> None:
        self.past_s, self._wrong = math.nan, wrong
        plan = StatePlan(RUN_S, measures=frozenset((wrong.stream,)))
        super().__init__({"LISTENING": plan, "PAST": replace(plan, deadline_s=patience_s)})

    def enter_PAST(self) -> None:
        """From here on something is wrong."""
        self.past_s, self._wrong.begun = self.event.t_s, True


class Bystander:
    """Witness and operator of a case: keeps nothing, and pauses once something is wrong where that is the case.

    Args:
        wrong: Says when.
        pauses: Whether that is the case.
    """

    failure = None

    def __init__(self, wrong: Wrong, pauses: bool = False) -> None:
        self._wrong, self._pauses = wrong, pauses
        self._asked = self._still = False

    def record(self, blocks: Sequence[SampleBlock]) -> None:
        """Nothing is kept."""

    def readings(self, *_: object) -> None:
        """Nothing is kept."""

    def skip(self, *_: object) -> None:
        """Nothing is kept."""

    def event(self, event: object, **_: object) -> None:
        """See whether the mover stands still after the pause."""
        self._still |= self._asked and isinstance(event, Standstill)

    def poll(self) -> str | None:
        """Pause; end the case once the mover stands still."""
        if not (self._pauses and self._wrong.begun):
            return None
        if not self._asked:
            self._asked = True
            return "pause"
        return "abort" if self._still else None

    def suspend(self) -> None:
        """Never asked for."""

    def state(self, name: str, t_s: float) -> None:
        """Nothing is shown."""


class Mover(NamedTuple):
    """A mover and how it creeps.

    Attributes:
        name: In the profile.
        shown: The stream that shows where it is.
        ready: Has it know where it is, first of all: jaws are sent home, which moves none that know.
        start: Goes to where each case begins.
        drive: Creeps from there, a few millimetres.
        speed_m_s: How fast.
        still_m: Within what it stands still.
        limits: What the guard holds it to.
        where: Where these limits stand in the profile.
        settings: Its own.
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


# --- the bench ---------------------------------------------------------------------------------------


@dataclass(frozen=True)
class BenchToProve:
    """A bench whose limits are to be proved.

    Attributes:
        rig: Its devices, closed.
        scene: For a simulated bench.
        settings: Of its devices, by name.
        fresh: Makes a trial's guard and signals.
        loop: Rates.
        range_streams: That its trials have watched beside the guard's own.
        consent: Called before each motion with what will move, and how; gives what says whether a person agrees by now,
            None where none is asked. Both may raise, to end the certificate.
        abandoned: Has another program creep with a mover, whose device is closed here, and kills it, or freezes it
            while the context lasts; gives where the mover was last. None where devices live in this process.
    """

    rig: Rig
    scene: TrialScene
    settings: Mapping[str, Settings]
    fresh: Callable[[], tuple[Guard, Sequence[Signal]]]
    loop: LoopSettings
    range_streams: frozenset[str] = frozenset()
    consent: Callable[[str], Callable[[], bool] | None] = lambda text: None
    abandoned: Callable[[Mover, bool], AbstractContextManager[float]] | None = None


class Ran(NamedTuple):
    """A case that was run: its loop, the devices as it saw them, and what the guard refused."""

    loop: Loop
    seams: Mapping[str, Seam]
    refusal: str


class Certifier:
    """Drives past the limits of a bench, one by one.

    Args:
        bench: Which.

    Attributes:
        infos: What its devices said of themselves.
    """

    def __init__(self, bench: BenchToProve) -> None:
        self.bench = bench
        self.infos: dict[str, DeviceInfo] = {}
        guard, _ = bench.fresh()
        self._limits = guard.settings
        self._left_alone, self._end_m = False, math.nan
        self._guarded = sorted(guard.inputs | bench.range_streams)

    def proofs(self) -> Iterator[Proof]:
        """Each limit in turn; every device is closed at the end, whatever happens.

        Raises:
            DeviceError: a device does not open, or fails on the way.
        """
        devices = self.bench.rig.devices
        try:
            for name, device in devices.items():
                self.infos[name] = device.open()
            self.bench.rig.clock.leave()
            yield from self._proofs()
        finally:
            for device in devices.values():
                device.close()

    def _proofs(self) -> Iterator[Proof]:
        names = [name for name, info in self.infos.items() if info.mover]
        movers = [mover for name in names if (mover := self._mover(name)) is not None]
        ended = ""
        for case in self._cases(movers):
            if ended:
                yield Proof(case.limit, case.value, "nothing", "not tried", ended)
                continue
            found = case.tried()
            yield Proof(case.limit, case.value, case.done, *found)
            if found.verdict == "failed" and (case.first or NOT_AT_REST in found.acted):
                ended = f"{case.limit} failed: a bench that does not stop is driven past nothing"
        for name in sorted(set(names) - {mover.name for mover in movers}):
            reason = "how this device moves is not known here; drive it past its limits by hand"
            yield Proof(f"limits of {name}", "", "nothing", "not shown", reason)

    def _mover(self, name: str) -> Mover | None:
        """How a mover creeps, or None where that is not known."""
        limits, own = self._limits, self._limits.movers.get(name)
        bounds, where = (limits, "limits") if own is None else (own, f"limits.movers.{name}")
        settings = self.bench.settings[name]
        fast_m_s = CREEP_M_S if self.bench.rig.kind == "hardware" else bounds.speed_m_s
        details: Mapping[str, Any] = self.infos[name].details
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
        for mover in movers:
            yield from self._stops(mover)
        yield from self._streams(movers)
        for mover in movers:
            yield from self._late(mover)
        yield from self._forces(movers)
        for mover in movers:
            yield from self._travel(mover)
        for mover in movers:
            yield from self._asked(mover)
        for name, settings in self.bench.settings.items():
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
        yield Case(f"home of {name}", "", "sent home, at its own speed", partial(self._homed, mover), True)
        done = f"{name} at {1e3 * mover.speed_m_s:g} mm/s: "
        stopped = partial(self._moving, mover, "", Wrong(), command=Stop(name))
        yield Case(f"stop of {name}", "", done + "commanded to stop", stopped, True)
        paused = partial(self._moving, mover, "", Wrong(), pauses=True)
        yield Case(f"pause of {name}", "", done + "paused by the operator", paused, True)

    def _streams(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """Streams that fall silent, or stick."""
        limits, infos = self._limits, self._infos()
        regular = sorted(name for name, info in infos.items() if info.longest_s is not None)
        for stream in self._guarded or regular[:1]:
            wrong = Wrong(stream, withheld)
            resting_s = max(REST * limits.stale_s, 2.0 * (infos[stream].longest_s or 0.0))
            own_s = limits.stale_s if movers else resting_s
            yield self._case(movers, "stale_s", f"{limits.stale_s:g} s", f"{stream} withheld", wrong, own_s)
        noisy = [name for name in [*self._guarded, *regular] if name in infos and infos[name].noisy]
        if limits.stuck_s is not None and noisy:
            wrong = Wrong(noisy[0], held)
            value = f"{limits.stuck_s:g} s"
            yield self._case(movers, "stuck_s", value, f"{noisy[0]} repeats a value", wrong, limits.stuck_s)
        else:
            reason = "no stream of this bench has a noise that would tell"
            yield _nothing("limits.stuck_s", f"{limits.stuck_s or 'none'}", reason)

    def _late(self, mover: Mover) -> Iterator[Case]:
        """A late loop."""
        late_s = self._limits.late_s
        away_s = BEYOND * late_s + 2.0 / self.bench.loop.rate_hz
        done = f"the program is away for {away_s:.3f} s"
        yield self._case(
            [mover], "late_s", f"{late_s:g} s", done, Wrong(away_s=away_s, away_from=mover.name), away_s
        )

    def _forces(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """Force, and sensors that leave their range."""
        limits = self._limits
        if limits.force_n is None or limits.force_stream is None or not movers:
            reason = "nothing moves on this bench" if not movers else "this bench has no stream of forces"
            yield _nothing("limits.force_n", f"{limits.force_n or 'none'}", reason)
        else:
            for sign in (1.0, -1.0):
                force_n = sign * BEYOND * limits.force_n
                wrong = Wrong(limits.force_stream, reading(force_n, limits.force_channels[0]))
                done = f"{limits.force_stream} reads {force_n:g} N"
                yield self._case(
                    movers, "force_n", f"{limits.force_n:g} N", done, wrong, limits.force_median_s
                )
            mover = movers[0]
            if limits.force_n <= PRESS_N and isinstance(mover.drive, MoveAt):
                end_m = min(mover.limits.travel_m, mover.settings.travel_max_m)
                drive = MoveAt(mover.name, mover.speed_m_s, end_m)
                done = f"{mover.name} at {1e3 * mover.speed_m_s:g} mm/s: presses on, at most to {1e3 * end_m:g} mm"
                tried = partial(self._pressed, mover._replace(drive=drive))
                yield Case("limits.force_n", f"{limits.force_n:g} N", done, tried)
        for stream in sorted({*limits.range_streams, *self.bench.range_streams}):
            wrong = Wrong(stream, beyond=1e9)
            yield self._case(
                movers, "range_streams", stream, f"{stream} leaves its range", wrong, 0.0, "beyond its range"
            )

    def _travel(self, mover: Mover) -> Iterator[Case]:
        """Places that a mover must not be at."""
        limits, where = mover.limits, mover.where
        if self._of(stream := limits.position_stream, mover.name):
            for key, position_m in (
                ("travel_m", limits.travel_m + 1e-3),
                ("travel_min_m", limits.travel_min_m - 1e-3),
            ):
                value, done = f"{getattr(limits, key):g} m", f"{stream} reads {position_m:g} m"
                wrong = Wrong(stream or "", reading(position_m))
                yield self._case([mover], key, value, done, wrong, 0.0, f"{where}.travel_min_m", where)
        if self._of(stream := limits.pose_stream, mover.name):
            for key, by_m, corner in (
                ("workspace_max_m", 1e-3, limits.workspace_max_m),
                ("workspace_min_m", -1e-3, limits.workspace_min_m),
            ):
                assert corner is not None
                for channel, place_m in enumerate(corner):
                    done = f"{stream} reads {'xyz'[channel]} = {place_m + by_m:g} m"
                    wrong = Wrong(stream or "", reading(place_m + by_m, channel))
                    yield self._case(
                        [mover], key, f"{place_m:g} m", done, wrong, 0.0, f"{where}.workspace", where
                    )

    def _asked(self, mover: Mover) -> Iterator[Case]:
        """Commands that the guard must refuse."""
        limits, name, where = mover.limits, mover.name, mover.where
        fast_m_s = BEYOND * limits.speed_m_s
        if isinstance(mover.drive, Grip):
            grip_n, speed = self._limits.grip_n, f"{limits.speed_m_s:g} m/s"
            hard = replace(mover.drive, force_n=BEYOND * grip_n)
            yield self._refused(mover, "limits.grip_n", f"{grip_n:g} N", hard)
            yield self._refused(mover, f"{where}.speed_m_s", speed, Release(name, fast_m_s))
            return
        assert isinstance(mover.drive, MoveAt)
        near = replace(mover.drive, limit_m=mover.drive.limit_m / 5.0)
        quick = replace(near, velocity_m_s=math.copysign(fast_m_s, near.velocity_m_s))
        yield self._refused(mover, f"{where}.speed_m_s", f"{limits.speed_m_s:g} m/s", quick)
        for key, by_m in (("travel_m", 1e-3), ("travel_min_m", -1e-3)):
            end_m = getattr(limits, key)
            command = MoveTo(name, end_m + by_m, mover.speed_m_s)
            yield self._refused(mover, f"{where}.{key}", f"{end_m:g} m", command, f"{where}.travel_min_m")
        turn_rad_s = BEYOND * limits.turn_rad_s
        turning = Twist(name, (0.0, 0.0, 0.0, 0.0, 0.0, turn_rad_s), 0.1)
        yield self._refused(mover, f"{where}.turn_rad_s", f"{limits.turn_rad_s:g} rad/s", turning)
        way_s = (BEYOND * limits.reach_m + 1e-3) / mover.speed_m_s
        leading = Twist(name, (mover.speed_m_s, 0.0, 0.0, 0.0, 0.0, 0.0), way_s)
        yield self._refused(mover, f"{where}.reach_m", f"{limits.reach_m:g} m", leading)
        if limits.reach_m:
            slow_rad_s = min(0.01, limits.turn_rad_s)
            angle_s = (BEYOND * limits.reach_rad + 1e-3) / slow_rad_s
            turned = Twist(name, (0.0, 0.0, 0.0, 0.0, 0.0, slow_rad_s), angle_s)
            yield self._refused(mover, f"{where}.reach_rad", f"{limits.reach_rad:g} rad", turned)

    def _of_device(self, name: str, settings: Settings, mover: Mover | None) -> Iterator[Case]:
        """What a driver must refuse, or clamp."""
        for key in type(settings).model_fields:
            value = getattr(settings, key)
            command = asked_of_driver(key, value, name, mover)
            if command is not None:
                done = f"a {type(command).__name__} beyond it given to the driver"
                tried = partial(self._given, name, key, value, mover)
                yield Case(f"devices.{name}.{key}", f"{value:g}", done, tried)

    def _alone(self, mover: Mover) -> Iterator[Case]:
        """The program is away for so long that the device must end the motion."""
        if not isinstance(mover.drive, MoveAt):
            return
        speed_m_s, room_m = mover.speed_m_s, abs(mover.drive.limit_m) - RUN_S * mover.speed_m_s
        bounds = [(f"{mover.where}.blind_travel_m", mover.limits.blind_travel_m, "m")]
        timeout_s = getattr(mover.settings, "loop_timeout_s", None)
        if timeout_s is not None:
            bounds.append((f"devices.{mover.name}.loop_timeout_s", timeout_s, "s"))
        for limit, value, unit in bounds:
            most_m = value if unit == "m" else speed_m_s * (value + SLACK_S)
            away_s, shown = most_m / speed_m_s + 1.0, f"{value:g} {unit}"
            if most_m + 2.0 * SLACK_M > room_m:
                reason = f"left alone it might go {1e3 * most_m:g} mm; {1e3 * room_m:.3g} mm are free here"
                yield Case(limit, shown, "nothing", partial(Tried, "not shown", reason))
            else:
                done = f"{mover.name} at {1e3 * speed_m_s:g} mm/s: the program is away for {away_s:.1f} s"
                wrong = Wrong(away_s=away_s, away_from=mover.name)
                yield Case(limit, shown, done, partial(self._left, mover, wrong, most_m))

    def _ended(self, mover: Mover) -> Iterator[Case]:
        """A program that is killed in the middle of a motion, or frozen with all that it has started."""
        if self.bench.abandoned is None or not isinstance(mover.drive, MoveAt):
            return
        name, blind_m = mover.name, mover.limits.blind_travel_m
        killed = partial(self._abandoned, mover, False, blind_m)
        done = f"{name} at {1e3 * mover.speed_m_s:g} mm/s: its program is killed"
        if blind_m < abs(mover.drive.limit_m) - 2.0 * RUN_S * mover.speed_m_s:
            yield Case(f"{mover.where}.blind_travel_m", f"{blind_m:g} m", done, killed)
        watchdog_hz = getattr(mover.settings, "watchdog_hz", None)
        if watchdog_hz is not None:
            done = f"{name} at {1e3 * mover.speed_m_s:g} mm/s: its program and its process are frozen"
            most_m = mover.speed_m_s * (1.0 / watchdog_hz + SLACK_S)
            frozen = partial(self._abandoned, mover, True, most_m)
            yield Case(f"devices.{name}.watchdog_hz", f"{watchdog_hz:g} Hz", done, frozen)

    def _watchdogs(self, movers: Sequence[Mover]) -> Iterator[Case]:
        """A program that is away for so long that a device's own watchdog must act."""
        infos = self._infos()
        for name, settings in self.bench.settings.items():
            watchdog_s = getattr(settings, "watchdog_s", None)
            if watchdog_s is None:
                continue
            own = [mover for mover in movers if mover.name == name]
            sent = [stream for stream in (*self._guarded, *sorted(infos)) if self._of(stream, name)]
            wrong = Wrong(sent[0], away_s=watchdog_s + 1.0, away_from=name)
            done = f"the program is away for {watchdog_s + 1.0:g} s"
            tried = partial(self._guarded_by, name, own or movers[:1], wrong, watchdog_s)
            yield Case(f"devices.{name}.watchdog_s", f"{watchdog_s:g} s", done, tried)

    def _case(
        self,
        movers: Sequence[Mover],
        key: str,
        value: str,
        done: str,
        wrong: Wrong,
        own_s: float,
        said: str = "",
        where: str = "limits",
    ) -> Case:
        """Something that goes wrong while the first mover moves, or at rest where there is none."""
        said = said or f"limits.{key}"
        if movers:
            mover = movers[0]
            doing = f"{mover.name} at {1e3 * mover.speed_m_s:g} mm/s: {done}"
            return Case(f"{where}.{key}", value, doing, partial(self._moving, mover, said, wrong, own_s))
        return Case(f"{where}.{key}", value, f"at rest: {done}", partial(self._resting, said, wrong, own_s))

    def _refused(self, mover: Mover, limit: str, value: str, command: Command, said: str = "") -> Case:
        def tried() -> Tried:
            self._agree(f"{mover.name} must refuse {_short(command)}: nothing should move")
            ran = self._run(Once(command, PATIENCE_S), Wrong(), "")
            still = self._at_rest(ran, mover)
            sound = (said or limit) in ran.refusal
            return judged(sound, still, "guard refused" if sound else "the guard let it through")

        return Case(limit, value, f"{_short(command)} asked for", tried)

    # --- trying them ---------------------------------------------------------------------------------

    def _infos(self) -> Mapping[str, Any]:
        made = {signal.info.name: signal.info for signal in self.bench.fresh()[1]}
        return {name: each for info in self.infos.values() for name, each in info.streams.items()} | made

    def _run(self, behavior: Behavior, wrong: Wrong, shown: str, pauses: bool = False) -> Ran:
        """Run a behavior in the loop, with seams between it and all devices and signals."""
        rig = self.bench.rig
        self._reopened()
        self._left_alone = wrong.away_s > AWAY_S
        rig.clock.restart()
        guard, signals = self.bench.fresh()
        seams = {name: Seam(device, rig.clock, wrong, shown) for name, device in rig.devices.items()}
        someone = Bystander(wrong, pauses)
        loop = Loop(
            replace(rig, devices=seams, ahead=None), self.infos, guard, someone, someone, self.bench.loop
        )
        refusal = ""
        rig.begin_trial(self.bench.scene)
        try:
            loop.run(behavior, {}, [SignalSeam(signal, wrong) for signal in signals])
        except GuardRefusal as error:
            refusal = str(error)
        except Aborted:
            pass
        return Ran(loop, seams, refusal)

    def _agree(self, text: str) -> None:
        """Wait until the person agrees; meanwhile the devices are attended to, for their watchdogs wait for nobody."""
        answered, rig = self.bench.consent(text), self.bench.rig
        while answered is not None and not answered():
            for device in rig.devices.values():
                device.read()
                device.poll()
            rig.clock.rest(ATTEND_S)

    def _reopened(self) -> None:
        """Open the devices anew where the last case left them alone: a driver whose device switched off has failed."""
        for device in self.bench.rig.devices.values() if self._left_alone else ():
            device.close()
            device.open()

    def _homed(self, mover: Mover) -> Tried:
        self._agree(f"{mover.name} goes home, at its own speed")
        ran = self._run(behavior := Once(Home(mover.name)), Wrong(), "")
        still = self._at_rest(ran, mover)
        sound = behavior.state == "OVER"
        return judged(sound, still, "it is home, and stands still" if sound else _why(ran, behavior))

    def _moving(
        self,
        mover: Mover,
        said: str,
        wrong: Wrong,
        own_s: float = 0.0,
        command: Command | None = None,
        pauses: bool = False,
    ) -> Tried:
        """Let something go wrong while a mover creeps: what must act `said` this; "" is the mover's own standstill."""
        behavior, ran, still, way_m = self._crept(mover, wrong, own_s + PATIENCE_S, command, pauses)
        if not behavior.past_s >= 0.0:
            return judged(False, still, f"it did not come that far: {_why(ran, behavior)}")
        past_s = behavior.past_s
        after = [event for event in ran.loop.events if event.t_s >= past_s]
        rests = [each.t_s for each in after if isinstance(each, Standstill) and each.device == mover.name]
        ends = [each for each in after if isinstance(each, GuardStopped | Failed | Stalled)]
        acting = [each for each in ends if said in each.reason] if said else []
        first_s = min([each.t_s for each in acting] if said else rests, default=math.inf)
        after_s = max(rests) - past_s if rests else None
        if first_s == math.inf:
            reason = "; ".join(dict.fromkeys(each.reason for each in ends)) or "nothing acted"
            return judged(False, still, f"{reason} within {own_s + PATIENCE_S:g} s", after_s, way_m)
        within_s = own_s + SLACK_S
        quick = first_s - past_s <= within_s and way_m <= mover.speed_m_s * within_s + SLACK_M
        told = f"guard: {acting[0].reason}" if said else "device: it stands still"
        return judged(quick, still, told if quick else f"{told}; too late, or too far", after_s, way_m)

    def _pressed(self, mover: Mover) -> Tried:
        """Press on until the force limit acts."""
        assert isinstance(mover.drive, MoveAt)
        patience_s = mover.drive.limit_m / mover.speed_m_s + PATIENCE_S
        _, ran, still, _ = self._crept(mover, Wrong(), patience_s, None, False, Press)
        stops = [each for each in ran.loop.events if isinstance(each, GuardStopped)]
        if not stops and still:
            return Tried("not shown", "nothing presses so hard within the travel: put something there")
        if not stops or "limits.force_n" not in stops[0].reason:
            return judged(False, still, stops[0].reason if stops else "nothing stopped it")
        rests = [each.t_s for each in ran.loop.events if isinstance(each, Standstill)]
        after_s = min((t_s for t_s in rests if t_s >= stops[0].t_s), default=math.inf) - stops[0].t_s
        seen = ran.seams[mover.name].seen
        at_m = next(x_m for t_s, x_m in reversed(seen) if t_s <= stops[0].t_s)
        way_m = max([x_m - at_m for t_s, x_m in seen if t_s >= stops[0].t_s], default=0.0)
        quick = after_s <= SLACK_S and way_m <= mover.speed_m_s * SLACK_S + SLACK_M
        return judged(quick, still, f"guard: {stops[0].reason}", after_s, way_m)

    def _left(self, mover: Mover, wrong: Wrong, most_m: float) -> Tried:
        """Leave a mover alone: it must end its motion by itself within a distance."""
        behavior, ran, still, way_m = self._crept(mover, wrong, PATIENCE_S, None, False)
        if not behavior.past_s >= 0.0:
            return judged(False, still, f"it did not come that far: {_why(ran, behavior)}")
        return self._alone_for(still, way_m, most_m)

    @staticmethod
    def _alone_for(still: bool, way_m: float, most_m: float) -> Tried:
        sound = way_m <= most_m + SLACK_M
        text = (
            "device: it stopped by itself" if sound else f"it went on, left alone, for {1e3 * way_m:.2f} mm"
        )
        return judged(sound, still, text, None, way_m)

    def _abandoned(self, mover: Mover, frozen: bool, most_m: float) -> Tried:
        """Have the program of a mover end: the device must end the motion by itself within a distance."""
        assert self.bench.abandoned is not None
        self._agree(f"{mover.name} moves, and its program is {'frozen' if frozen else 'killed'}")
        devices, clock = self.bench.rig.devices, self.bench.rig.clock
        for device in devices.values():
            device.close()
        try:
            with self.bench.abandoned(mover, frozen) as place_m:
                clock.rest(most_m / mover.speed_m_s + 1.0)
        except (EOFError, TimeoutError) as error:
            reason = str(error) or "the program that was to be ended ended by itself"
            return Tried("not shown", reason)
        finally:
            for device in devices.values():
                device.open()
        still = self._stands(mover)
        return self._alone_for(still, abs(self._end_m - place_m), most_m)

    def _guarded_by(self, name: str, movers: Sequence[Mover], wrong: Wrong, watchdog_s: float) -> Tried:
        """Leave a device alone: it must say that its watchdog tripped, or have stopped to send in time."""
        still = True
        behavior: Creep | Resting = Resting(wrong, PATIENCE_S)
        if movers:
            behavior, ran, still, _ = self._crept(movers[0], wrong, PATIENCE_S, None, False)
        else:
            ran = self._run(behavior, wrong, "")
        if not behavior.past_s >= 0.0:
            return judged(False, still, f"it did not come that far: {_why(ran, behavior)}")
        told = [each for each in ran.loop.events if getattr(each, "device", "") == name]
        if movers and movers[0].name == name:
            said = [reason for each in told if "watchdog" in (reason := getattr(each, "reason", ""))]
            found = f"device: {said[0]}" if said else ""
        else:
            sent_s = ran.seams[name].last_s - behavior.past_s
            found = f"device: it sent for {sent_s:.2f} s more" if sent_s <= watchdog_s + SLACK_S else ""
        return judged(bool(found), still, found or "it went on, left alone")

    def _crept(
        self,
        mover: Mover,
        wrong: Wrong,
        patience_s: float,
        command: Command | None,
        pauses: bool,
        how: type[Creep] = Creep,
    ) -> tuple[Creep, Ran, bool, float]:
        """Run a `Creep`; whether the mover stands still then, and how far it went since something was wrong."""
        way_mm, speed_mm_s = 1e3 * getattr(mover.drive, "limit_m", ROOM_M), 1e3 * mover.speed_m_s
        then = "presses until the force limit acts" if how is Press else wrong.said
        self._agree(f"{mover.name} moves {way_mm:g} mm at {speed_mm_s:g} mm/s, and {then}")
        behavior = how(mover, wrong, command, patience_s, self.bench.range_streams)
        ran = self._run(behavior, wrong, mover.shown, pauses)
        seen = ran.seams[mover.name].seen
        last_m = next((x_m for t_s, x_m in reversed(seen) if t_s <= behavior.past_s), math.nan)
        still = self._at_rest(ran, mover)
        return behavior, ran, still, abs(self._end_m - last_m)

    def _resting(self, said: str, wrong: Wrong, own_s: float) -> Tried:
        """Where nothing moves: a trial must end where what it listens to goes wrong."""
        ran = self._run(behavior := Resting(wrong, own_s + PATIENCE_S), wrong, "")
        account = ran.loop.account
        if said in account.reason and account.outcome:
            after_s = ran.loop.visits[-1][1] - behavior.past_s
            return Tried("acted", f"the trial ended: {account.reason}", after_s)
        return Tried("failed", f"the trial went on for {own_s + PATIENCE_S:g} s")

    def _given(self, name: str, key: str, value: float, mover: Mover | None) -> Tried:
        """Give a driver what it must refuse or clamp, past the guard, where the mover already is."""
        here_m = 0.0
        if mover is not None:
            self._agree(f"{name} must refuse more than its {key}, or clamp it: nothing should move")
            self._run(Once(mover.ready), Wrong(), "")
            self._stands(mover)
            here_m = self._end_m
        command = asked_of_driver(key, value, name, mover, here_m)
        assert command is not None
        try:
            sent = self.bench.rig.devices[name].apply(command)
            speed = getattr(sent, "speed_m_s", math.inf)
            sound = speed <= value * (1.0 + 1e-9)
            text = f"driver made it {speed:.3g}" if sound else "the driver took it"
        except CommandError as error:
            sound, text = True, f"driver refused: {error.reason}"
        return judged(sound, mover is None or self._stands(mover), text)

    # --- standing still ------------------------------------------------------------------------------

    def _at_rest(self, ran: Ran, mover: Mover) -> bool:
        return self._stands(mover) and mover.name not in ran.loop.account.not_at_rest

    def _stands(self, mover: Mover) -> bool:
        """Whether a mover stands still: by its own stream, and on a simulated bench in truth. Where is `_end_m`."""
        name, shown = mover.name, mover.shown
        rig, device = self.bench.rig, self.bench.rig.devices[name]
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


def _nothing(limit: str, value: str, reason: str) -> Case:
    return Case(limit, value, "nothing", partial(Tried, "nothing to bound", reason))


def _why(ran: Ran, behavior: Behavior) -> str:
    return ran.refusal or ran.loop.account.reason or behavior.reason or f"it ended in {behavior.state}"


def _short(command: Command) -> str:
    """A command in a table: its name and numbers."""
    numbers = [
        f"{each.name} {value:.6g}" if isinstance(value, float) else f"{each.name} {value}"
        for each in fields(command)
        if each.name not in ("device", "id", "blind_travel_m")
        for value in (getattr(command, each.name),)
    ]
    return f"{type(command).__name__} {', '.join(numbers)}"
